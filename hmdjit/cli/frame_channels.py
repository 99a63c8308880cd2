"""Channels of frames as files: folders beside them, a file per frame."""

import csv
import dataclasses
import itertools
import math
import warnings
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import jax.numpy as jnp
import numpy as np
import rich.console
import tyro

from .. import _checks
from ..scenes.pictures import read_picture
from ..simulation.rendered import KEYWORDS, checked
from ..techniques import AbstractTechnique
from .frame_files import FrameFiles
from .options import shown

_SUFFIXES = {
    "depth": (".npy", ".png", ".tif", ".tiff"),
    "object_id": (".npy", ".png"),
    "motion_class": (".npy", ".png"),
    "albedo": (".npy", ".png", ".jpg", ".jpeg"),
    "velocity": (".npy",),
}


@dataclasses.dataclass(frozen=True)
class ChannelFolders:
    """Folders of channels, for techniques that need them; files numbered as frames."""

    depth: Annotated[
        Path | None,
        shown(
            "DIR",
            "Depths along -z, m: float NPY or TIFF, inf for nothing; or with "
            "--depth-scale 16-bit PNG, TIFF or NPY, 0 for nothing (default: depth/ in "
            "FRAMES_DIR).",
        ),
    ] = None
    depth_scale: Annotated[
        float | None, shown("M", "Metres per unit of depths in whole numbers.")
    ] = None
    id: Annotated[
        Path | None,
        shown("DIR", "Objects' ids: PNG or NPY of whole numbers (default: id/)."),
    ] = None
    class_: Annotated[
        Path | None,
        tyro.conf.arg(name="class"),
        shown(
            "DIR",
            "What moves: 0 static, 1 rigid, 2 deforming: PNG or NPY (default: class/).",
        ),
    ] = None
    albedo: Annotated[
        Path | None,
        shown("DIR", "Colours before they are lit: PNG, JPEG, NPY (default: albedo/)."),
    ] = None
    velocity: Annotated[
        Path | None,
        shown(
            "DIR",
            "How content moved since the last frame, px right and down: float NPY, "
            "(height, width, 2) (default: velocity/, else by depth and poses).",
        ),
    ] = None
    jitter: Annotated[
        Path | None,
        shown(
            "CSV",
            "Where the sample of each pixel lies, px from its centre, a row per frame: "
            "columns x, to the right, and y, down; what is seen shifts the other way "
            "(default: the technique's own places).",
        ),
    ] = None

    def of_techniques(
        self,
        console: rich.console.Console,
        techniques: Sequence[AbstractTechnique],
        frames: FrameFiles,
        size: tuple[int, int],
    ) -> list[dict[str, Any]]:
        """Return keywords of `stream` for each technique; says what is used.

        **Errors:** `ValueError` for folders that do not fit the frames; when read, for
        files of another size, kind or range, named.
        """
        if self.depth_scale is not None:
            _checks.in_range("depth_scale", self.depth_scale, 0, open_low=True)
        folders = dict(self._beside(frames.folder))
        needs = [_read_by(technique, folders) for technique in techniques]
        given: list[dict[str, Any]] = [{} for _ in techniques]
        if self.jitter is not None:
            places = {"jitter_px": _places(self.jitter, len(frames.files))}
            given = [dict(places) for _ in techniques]
            if not any(technique.reads_jitter for technique in techniques):
                console.out(f"{self.jitter} is not used: no technique here reads it.")
        for name, folder in folders.items():
            users = [
                one for one, read in zip(given, needs, strict=True) if name in read
            ]
            if not users:
                console.out(f"{folder} is not used: no technique here needs {name}.")
                continue
            kinds = ", ".join(_SUFFIXES[name])
            own = FrameFiles.of(folder, True, _SUFFIXES[name], f"files ({kinds})")
            files = own.like(frames).files
            console.out(f"{name} of {folder}, {files[0].name} to {files[-1].name}.")
            copies = itertools.tee(self._planes(name, files, size), len(users))
            for user, copy in zip(users, copies, strict=True):
                user[KEYWORDS[name][0]] = copy
        return given

    def _beside(self, frames: Path) -> Iterator[tuple[str, Path]]:
        """Folders of channels, named or found beside the frames."""
        for name, (_, option) in KEYWORDS.items():
            word = option.removeprefix("--")
            named = getattr(self, "class_" if word == "class" else word)
            if named is not None or (frames / word).is_dir():
                yield name, named or frames / word

    def _planes(
        self, name: str, files: Sequence[Path], size: tuple[int, int]
    ) -> Iterator[np.ndarray]:
        """Read a channel file by file, each checked."""
        for file in files:
            planes = _read(file, name)
            if name == "depth":
                planes = self._metres(file, planes)
            if planes.shape[1::-1] != size:
                raise ValueError(
                    f"{file}: must be {size[0]} x {size[1]} px as the first frame, got "
                    f"shape {planes.shape}."
                )
            try:
                checked(name, planes[None], (1, *size[::-1]), jnp.float32)
            except ValueError as error:
                raise ValueError(f"{file}: {error}") from None
            yield planes

    def _metres(self, file: Path, depth: np.ndarray) -> np.ndarray:
        """Depths in m, of codes by the scale."""
        is_whole = np.issubdtype(depth.dtype, np.integer)
        if is_whole != (self.depth_scale is not None):
            wrong = (
                "whole numbers: name their metres per unit by"
                if is_whole
                else ("metres in floats, which have no")
            )
            raise ValueError(f"{file}: depths are {wrong} --depth-scale.")
        if not is_whole:
            return depth
        if depth.dtype.itemsize < 2:
            raise ValueError(f"{file}: depths must have 16 bits or more, got 8.")
        scale = np.float32(self.depth_scale or math.nan)
        return np.where(depth == 0, np.float32(np.inf), depth * scale)


def _read_by(technique: AbstractTechnique, found: Collection[str]) -> frozenset[str]:
    """Channels that a technique needs, or that its velocity is derived from."""
    derives = "velocity" in technique.needs and "velocity" not in found
    return technique.needs.union(("depth", "motion_class") if derives else ())


def _places(file: Path, frames: int) -> np.ndarray:
    """Read where samples lie, px, `(frames, 2)`."""
    try:
        with file.open(encoding="utf-8-sig", newline="") as opened:
            head, *rows = [row for row in csv.reader(opened) if any(row)] or [[]]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{file}: cannot be read as CSV ({error}).") from None
    head = [name.strip() for name in head]
    if sorted(head) != ["x", "y"]:
        raise ValueError(f"{file}: columns must be x, y, got {', '.join(head)}.")
    if len(rows) != frames:
        raise ValueError(
            f"{file}: must have a row per frame ({frames}), got {len(rows)}."
        )
    places = np.empty((frames, 2), np.float32)
    for place, (number, row) in zip(places, enumerate(rows, 1), strict=True):
        try:
            named = dict(zip(head, map(float, row), strict=True))
        except ValueError:
            raise ValueError(
                f"{file}: row {number}: must be two numbers, got {','.join(row)}."
            ) from None
        for axis, value in named.items():
            _checks.in_range(f"{file}: row {number}: {axis}", value, -1, 1)
        place[:] = named["x"], named["y"]
    return places


def _read(file: Path, name: str) -> np.ndarray:
    """Read a file's numbers, `(height, width)` or with colours behind."""
    if file.suffix.lower() == ".npy":
        try:
            # Mapped, so that a header may claim no more than there is.
            return np.array(np.lib.format.open_memmap(file, mode="r"))
        except PermissionError:
            raise
        # A damaged header makes its parser raise almost anything.
        except Exception as error:
            raise ValueError(f"{file}: cannot be read as NPY ({error}).") from None
    if name == "albedo":
        return read_picture(file, opaque=True)
    import PIL.Image

    try:
        with warnings.catch_warnings(action="ignore"), PIL.Image.open(file) as image:
            mode, planes = image.mode, np.asarray(image)
    except PermissionError:
        raise
    # So does a damaged picture with Pillow's decoders; too large a one, too.
    except Exception as error:
        raise ValueError(f"{file}: cannot be read ({error}).") from None
    if mode not in ("F", "I", "L", "P", "I;16", "I;16B"):
        raise ValueError(f"{file}: must have one number per pixel, got mode {mode}.")
    return planes
