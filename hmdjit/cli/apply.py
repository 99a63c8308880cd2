"""The command line's `hmdjit apply`: a technique on rendered frames."""

import dataclasses
import re
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import rich.console
import rich.progress
import tyro

from .. import metrics, scenes, techniques
from ..camera import Camera
from ..head_motion import Trace
from ..metrics.mtcd import CODE_VALUES
from ..simulation import apply as clips
from .options import OK, check_can_write


@dataclasses.dataclass(frozen=True)
class ApplyCommand:
    """Run a technique on rendered frames: numbered PNGs in, displayed PNGs out."""

    technique: tyro.conf.Positional[str]
    """Technique id, e.g. head_movement."""
    frames_dir: tyro.conf.Positional[Path]
    """Folder of numbered PNG frames, one per pose."""
    poses: tyro.conf.Positional[Path]
    """CSV of head poses, t_s,qw,qx,qy,qz, one row per frame."""
    out: Path = Path("hmdjit-displayed")
    """Folder for the displayed frames."""
    fov: float = 96.0
    """Horizontal field of view the frames were rendered with, deg."""
    refresh: float | None = None
    """Refresh rate, Hz (default: the poses' own)."""

    def run(self, console: rich.console.Console) -> int:
        """Show all frames, or write none."""
        technique = techniques.by_id(self.technique)
        trace = Trace.read(self.poses)
        files = _numbered_frames(self.frames_dir)
        if len(files) != len(trace.t_s):
            raise ValueError(
                f"{self.poses}: must have one row per frame: {len(files)} frames in "
                f"{self.frames_dir}, {len(trace.t_s)} rows."
            )
        height, width, _ = scenes.pictures.read_picture(files[0]).shape
        rate = self.refresh if self.refresh is not None else trace.rate_hz
        camera = Camera(width, height, self.fov, rate)
        out = self.out
        check_can_write(out)
        if out.resolve() == self.frames_dir.resolve():
            raise ValueError(
                f"out must differ from the folder of the frames, got {out}."
            )

        before, after = (metrics.Streamed(metrics.MTCD()) for _ in range(2))

        def pictures() -> Iterator[np.ndarray]:
            for file in rich.progress.track(files, technique.id, console=console):
                picture = scenes.pictures.read_picture(file)
                if picture.shape != (height, width, 3):
                    raise ValueError(
                        f"{file}: must be {width} x {height} px as the first frame, "
                        f"got {picture.shape[1]} x {picture.shape[0]}."
                    )
                before.add(picture)
                yield picture

        poses = trace.world_from_head
        displayed = clips.stream(technique, camera, pictures(), poses)
        # All frames or none: they move to their folder when the last one is done.
        with tempfile.TemporaryDirectory() as scratch:
            for file, picture in zip(files, displayed, strict=True):
                after.add(picture)
                _write_png(Path(scratch) / file.name, picture)
            out.mkdir(parents=True, exist_ok=True)
            for file in files:
                shutil.move(Path(scratch) / file.name, out / file.name)
        console.out(
            f"MTCD before {before.value:.3f}, after {after.value:.3f} code values "
            f"(ratio {after.value / before.value:.3f})"
            if before.value
            else "MTCD 0 before: no flicker to remove"
        )
        console.out(f"Wrote {len(files)} displayed frames to {out}.")
        return OK


def _numbered_frames(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise ValueError(f"{folder}: must be a folder of numbered PNG frames.")
    numbered = {}
    for file in folder.iterdir():
        digits = re.findall(r"\d+", file.stem)
        if file.suffix.lower() == ".png" and digits:
            number = int(digits[-1])
            if number in numbered:
                raise ValueError(f"{folder}: two frames have the number {number}.")
            numbered[number] = file
    if len(numbered) < 2:
        raise ValueError(
            f"{folder}: must hold at least 2 numbered PNG frames, has {len(numbered)}."
        )
    return [numbered[number] for number in sorted(numbered)]


def _write_png(path: Path, picture: np.ndarray) -> None:
    import PIL.Image

    codes = np.floor(CODE_VALUES * np.clip(picture, 0, 1) + 0.5).astype(np.uint8)
    PIL.Image.fromarray(codes).save(path, format="PNG")
