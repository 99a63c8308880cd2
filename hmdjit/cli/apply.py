"""The command line's `hmdjit apply`: techniques on rendered frames."""

import contextlib
import dataclasses
import itertools
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import numpy as np
import rich.console
import rich.progress
import tyro
from jaxtyping import Float

from .. import _checks, techniques
from .._files import check_can_write, write_csv
from ..camera import Camera
from ..metrics import IDS as METRICS
from ..metrics.base import check_block
from ..pages import apply as pages
from ..reports import apply as report
from ..simulation import apply as clips
from ..simulation.pose_fit import PoseFit
from .frame_channels import ChannelFolders
from .frame_files import (
    FrameFiles,
    Picture,
    codes,
    former_frames,
    replaced,
    write_png,
)
from .frame_poses import aligned, said
from .kept import typed
from .options import OK, PoseLog, shown

_FOV_DEG = 96.0
Poses = Float[np.ndarray, "frames components"]
_OUT = Path("hmdjit-displayed")
_FRAMES = "frames, before"


@dataclasses.dataclass(frozen=True, kw_only=True)
class ApplyCommand(ChannelFolders, PoseLog):
    """Run techniques on rendered frames: numbered PNGs in, displayed PNGs out.

    Prints the MTCD of what is displayed and of the 8-bit PNGs written, the camera, and
    whether the poses fit: reprojection by them must bring each frame onto the last.
    Frames go by the number in their names, with its fraction; alpha is ignored. Former
    displayed frames in the same folder are replaced, other pictures and folders never.

    For example: hmdjit apply head_movement FRAMES_DIR POSES.csv --fov 96
    """

    technique: Annotated[
        tyro.conf.Positional[str],
        shown("TECHNIQUE", "Technique's id, e.g. head_movement."),
    ]
    frames_dir: Annotated[
        tyro.conf.Positional[Path],
        shown("FRAMES_DIR", "Folder of numbered frames, PNG or JPEG."),
    ]
    poses: Annotated[
        tyro.conf.Positional[Path | None],
        shown(
            "[POSES.csv]",
            "Log of head poses, t_s,qw,qx,qy,qz, and x_m,y_m,z_m if known: a row per "
            "frame, or times that frames are named by. Without it only techniques that "
            "need none.",
        ),
    ] = None
    techniques: Annotated[
        tuple[str, ...] | None,
        shown("ID...", "Further techniques, for the same table."),
    ] = None
    out: Annotated[
        Path | None,
        shown(
            "DIR",
            "Folder for displayed frames, one in it per technique if there are several "
            f"(default: {_OUT}, with poses).",
        ),
    ] = None
    csv: Annotated[Path | None, shown("CSV", "File for the table.")] = None
    reference: Annotated[
        Path | None,
        shown(
            "DIR",
            "Frames of the same numbers that detail loss is measured against, such as "
            "SSAA 4x4 ones.",
        ),
    ] = None
    metrics: Annotated[
        tuple[str, ...] | None,
        shown(
            "ID...",
            f"What is measured, of {', '.join(METRICS)} (default: mtcd, and "
            "detail_loss where there is a --reference).",
        ),
    ] = None
    warmup: Annotated[
        int, shown("N", "Frames that are displayed but not measured (default: 0).")
    ] = 0
    fov: Annotated[
        float | None,
        shown(
            "DEG",
            "Horizontal field of view that frames were rendered with (default: "
            f"{_FOV_DEG:g}).",
        ),
    ] = None
    refresh: Annotated[
        float | None, shown("HZ", "Refresh rate (default: the poses' own).")
    ] = None
    first_row: Annotated[
        int | None,
        shown(
            "ROW",
            "The first frame's row, from 1, of a log that is longer; of one at another "
            "rate than --refresh, frames then have their poses by time.",
        ),
    ] = None
    alpha: Annotated[
        bool, shown("", "Lay frames on black by their alpha, else ignored.")
    ] = False
    no_report: Annotated[
        bool, shown("", f"Write neither {pages.NAME} nor {pages.CLIP}.")
    ] = False

    def run(self, console: rich.console.Console) -> int:
        """Show all frames, or write none."""
        chosen = [
            techniques.by_id(id) for id in (self.technique, *(self.techniques or ()))
        ]
        ids = [technique.id for technique in chosen]
        if len(set(ids)) < len(ids):
            raise ValueError(f"techniques must all differ, got {', '.join(ids)}.")
        measured_as = report.chosen_metrics(self.metrics, self.reference)
        frames = FrameFiles.of(self.frames_dir, not self.alpha)
        _checks.whole("warmup", self.warmup, 0)
        if len(frames.files) - self.warmup < 2:
            raise ValueError(
                f"{self.frames_dir}: must hold at least 2 frames after warmup = "
                f"{self.warmup}, has {len(frames.files)}."
            )
        folders = self._folders(frames, ids)
        if self.csv is not None:
            if self.csv.is_dir():
                raise ValueError(f"csv must be a file, got the folder {self.csv}.")
            check_can_write(self.csv.parent)
        size = frames.size()
        check_block(measured_as, *size)
        for note in frames.notes():
            console.out(note)
        camera, poses = self._viewing(console, frames, size)
        channels = self.of_techniques(console, chosen, frames, size)
        for technique in chosen:
            period, samples, _ = technique.sample_offsets_px.shape
            is_jittered = samples == 1 and technique.sample_offsets_px.any()
            if is_jittered and self.jitter is None:
                console.out(
                    f"{technique.id} takes frames to be jittered by its own {period} "
                    "places in turn; name theirs by --jitter, or it with _no_jitter "
                    "where they are not."
                )
        fit = None if poses is None else PoseFit(camera, poses[:, :4])
        references: Iterable[Picture | None] = itertools.repeat(None)
        if self.reference is not None:
            against = FrameFiles.of(self.reference, not self.alpha).like(frames)
            references = against.pictures(size)
        measured = {name: report.Measured(measured_as) for name in (_FRAMES, *ids)}
        is_paged = bool(folders) and not self.no_report
        watched = {name: pages.Watched() for name in measured} if is_paged else {}

        pictures, *copies = itertools.tee(frames.pictures(size), 1 + len(chosen))
        streams = [
            clips.stream(technique, camera, copy, poses, **given)
            for technique, copy, given in zip(chosen, copies, channels, strict=True)
        ]
        clip = zip(frames.files, pictures, references, *streams, strict=False)
        with contextlib.ExitStack() as stack:
            unfinished = [
                stack.enter_context(replaced(folder, former))
                for folder, former in folders.items()
            ][-len(chosen) :]
            progress = rich.progress.track(
                clip, ", ".join(ids), len(frames.files), console=console
            )
            for k, (file, picture, reference, *displayed) in enumerate(progress):
                if fit is not None:
                    fit.add(picture)
                everything = [picture, *displayed]
                rounded = [codes(picture) for picture in everything]
                if k >= self.warmup:
                    rows = zip(measured.values(), everything, rounded, strict=True)
                    for row, exact, rough in rows:
                        row.add(exact, rough, reference)
                    seen = zip(watched.values(), everything, rounded, strict=False)
                    for one, exact, rough in seen:
                        one.add(exact, rough, reference)
                for folder, picture in zip(unfinished, rounded[1:], strict=False):
                    write_png(folder / f"{file.stem}.png", picture)
        if fit is not None:
            for line in said(fit, self.axes or "openxr"):
                console.out(line)
        rows = self._report(console, measured)
        if watched:
            about = measured[_FRAMES].caption(self.reference)
            out, words = self.out or _OUT, typed("apply", self)
            written = pages.write_page(out, watched, rows, camera, words, about)
            console.out(f"Wrote {', '.join(map(str, written))}.")
        if folders:
            *_, last = folders
            out = last if len(ids) == 1 else last.parent
            console.out(f"Wrote {len(frames.files)} displayed frames to {out}.")
        return OK

    def _folders(self, frames: FrameFiles, ids: list[str]) -> dict[Path, list[Path]]:
        """Folders to write to, and the former frames in each; the techniques' last."""
        if self.out is None and self.poses is None:
            return {}
        out = self.out or _OUT
        check_can_write(out)
        folders = [out]
        if len(ids) > 1:
            folders = [out / id.replace(":", "_") for id in ids]
        taken = [
            folder.resolve() for folder in (self.frames_dir, self.reference) if folder
        ]
        for folder in (out, *folders):  # of several, former frames in `out` go too
            if folder.resolve() in taken:
                raise ValueError(
                    f"out must differ from the folder of the frames, got {folder}."
                )
        names = [f"{file.stem}.png" for file in frames.files]
        former = {folder: former_frames(folder, names) for folder in folders}
        return {out: former_frames(out, ())} | former

    def _viewing(
        self, console: rich.console.Console, frames: FrameFiles, size: tuple[int, int]
    ) -> tuple[Camera, Poses | None]:
        """Camera, and a pose per frame; says what was given and what assumed."""
        fov_deg, fov = _FOV_DEG, "assumed: --fov"
        if self.fov is not None:
            fov_deg, fov = self.fov, "as given"
        if self.poses is None:
            self.refuse("is of a log of poses: name one.")
            if self.first_row is not None:
                raise ValueError("--first-row is of a log of poses: name one.")
            rate_hz = 60.0 if self.refresh is None else self.refresh
            return Camera(*size, fov_deg, rate_hz), None
        trace = self.read_trace(self.poses)
        notes = trace.notes
        trace = aligned(
            trace, frames, self.first_row, self.refresh, lacks_rows=self.skip_damaged
        )
        rate_hz, rate = trace.rate_hz, "of the poses"
        if self.refresh is not None:
            rate = f"as given; of the poses {rate_hz:.2f} Hz"
            rate_hz = self.refresh
        camera = Camera(*size, fov_deg, rate_hz)
        for note in (
            *notes,
            *trace.remarks,
            f"Camera: {size[0]} x {size[1]} px, {fov_deg:g} deg wide ({fov}), "
            f"{rate_hz:.2f} Hz ({rate}).",
        ):
            console.out(note)
        return camera, trace.poses

    def _report(
        self, console: rich.console.Console, measured: dict[str, report.Measured]
    ) -> dict[str, dict[str, float]]:
        """Print the table, and write it where that was asked for."""
        before = measured[_FRAMES]
        rows = {name: row.values(before) for name, row in measured.items()}
        report.print_table(rows, console)
        console.out(before.caption(self.reference))
        if self.warmup:
            console.out(f"The first {self.warmup} frames were displayed, not measured.")
        if rows[_FRAMES].get("mtcd") == 0:
            console.out("MTCD 0 before: no flicker to remove.")
        if self.csv is not None:
            named = [{"technique": name} | row for name, row in rows.items()]
            console.out(f"Wrote {write_csv(self.csv, named)}.")
        return rows
