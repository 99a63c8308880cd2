"""Frames as files: numbered pictures of a folder, in and out."""

import contextlib
import dataclasses
import itertools
import os
import re
import shutil
import warnings
from collections.abc import Collection, Iterable, Iterator
from decimal import Decimal
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from .._version import __version__
from ..color import CODE_VALUES
from ..scenes.pictures import read_picture

_PICTURES = (".png", ".jpg", ".jpeg")
_NUMBER = re.compile(r"\d+(?:\.\d+)?")
_MOST_NAMED = 5  # missing numbers
_MADE_BY = f"hmdjit {__version__} apply"  # tells our PNGs from others

Picture = Float[np.ndarray, "height width 3"]
Codes = UInt8[np.ndarray, "height width 3"]


@dataclasses.dataclass(frozen=True)
class FrameFiles:
    """Numbered PNG or JPEG frames of a folder, in the order of their numbers.

    - `numbers`: with their fractions, as times have.
    - `is_opaque`: whether alpha is ignored; else frames lie on black.
    """

    folder: Path
    files: tuple[Path, ...]
    numbers: tuple[Decimal, ...]
    is_opaque: bool = True

    @classmethod
    def of(
        cls,
        folder: Path,
        is_opaque: bool = True,
        suffixes: Collection[str] = _PICTURES,
        kind: str = "PNG frames (or JPEG)",
    ) -> "FrameFiles":
        """Find a folder's frames; files that begin with a dot are none.

        Names are alike but for their numbers. Of several numbers in a name the last
        that differs is the frame's; those before it count first in the order.

        **Errors:** `ValueError` for fewer than 2 frames, names that are not alike, and
        numbers that are equal.
        """
        if not folder.is_dir():
            raise ValueError(f"{folder}: must be a folder of numbered {kind}.")
        found: dict[tuple[Decimal, ...], Path] = {}
        names: dict[str, str] = {}
        files = [
            file for file in sorted(folder.iterdir()) if _is_numbered(file, suffixes)
        ]
        for file, key in zip(files, _keys(files), strict=True):
            if (other := found.setdefault(key, file)) != file:
                raise ValueError(
                    f"{folder}: two frames have the number {key[-1]}: {other.name} and "
                    f"{file.name}."
                )
            names.setdefault(_NUMBER.sub("#", file.stem.lower()), file.name)
        if len(names) > 1:
            one, other, *_ = names.values()
            raise ValueError(
                f"{folder}: frames' names must differ in their numbers only, got {one} "
                f"and {other}."
            )
        if len(found) < 2:
            raise ValueError(
                f"{folder}: must hold at least 2 numbered {kind}, has {len(found)}."
            )
        keys = sorted(found)
        columns = [column for column in zip(*keys, strict=True) if len(set(column)) > 1]
        return cls(folder, tuple(found[key] for key in keys), columns[-1], is_opaque)

    def like(self, other: "FrameFiles") -> "FrameFiles":
        """Return those with the numbers of others, in their order."""
        known = dict(zip(self.numbers, self.files, strict=True))
        for number in other.numbers:
            if number not in known:
                raise ValueError(f"{self.folder}: has no frame of number {number}.")
        files = tuple(known[number] for number in other.numbers)
        return dataclasses.replace(self, files=files, numbers=other.numbers)

    @property
    def places(self) -> list[int] | None:
        """Each frame's place, from 0, in a sequence of even steps; None for times."""
        steps = [b - a for a, b in itertools.pairwise(self.numbers)]
        step = min(steps)
        is_whole = not any(number % 1 for number in self.numbers)
        if step <= 0 or not is_whole or any(other % step for other in steps):
            return None
        return [int((number - self.numbers[0]) / step) for number in self.numbers]

    def notes(self) -> list[str]:
        """Say which frames these are, in which order, and what is odd about them."""
        import PIL.Image

        first, last = self.files[0], self.files[-1]
        notes = [
            f"{len(self.files)} frames in the order of their numbers, {first.name} to "
            f"{last.name}."
        ]
        places = self.places or [0]
        if lost := places[-1] + 1 - len(places):
            step, there = (self.numbers[-1] - self.numbers[0]) / places[-1], set(places)
            gaps = (k for k in range(places[-1]) if k not in there)
            named = [self.numbers[0] + k * step for k in gaps][:_MOST_NAMED]
            more = f" and {lost - len(named)} more" if lost > len(named) else ""
            notes.append(
                f"Warning: missing frames: {', '.join(f'{n:f}' for n in named)}{more}."
            )
        if any(file.suffix.lower() != ".png" for file in self.files):
            notes.append(
                "Warning: JPEG's compression errors differ from frame to frame and are "
                "part of every MTCD; render PNG to be rid of them."
            )
        # Of half the size that is refused Pillow warns.
        with warnings.catch_warnings(action="ignore"), PIL.Image.open(first) as image:
            if image.has_transparency_data:
                way = "ignored (--alpha lays frames on black)"
                way = way if self.is_opaque else "applied: frames lie on black"
                notes.append(f"Frames have an alpha channel: {way}.")
        return notes

    def size(self) -> tuple[int, int]:
        """Width and height of the first frame, px."""
        height, width, _ = self._read(self.files[0]).shape
        return width, height

    def pictures(self, size: tuple[int, int]) -> Iterator[Picture]:
        """Read them one by one; `ValueError` where a frame's size is another."""
        for file in self.files:
            picture = self._read(file)
            height, width, _ = picture.shape
            if (width, height) != size:
                raise ValueError(
                    f"{file}: must be {size[0]} x {size[1]} px as the first frame, got "
                    f"{width} x {height}."
                )
            yield picture

    def _read(self, file: Path) -> Picture:
        return read_picture(file, opaque=self.is_opaque)


def _is_numbered(file: Path, suffixes: Collection[str]) -> bool:
    is_picture = file.suffix.lower() in suffixes and file.name[0] != "."
    return is_picture and _NUMBER.search(file.stem) is not None


def _keys(files: Iterable[Path]) -> list[tuple[Decimal, ...]]:
    """Numbers in files' names; `shot1.9` comes before `shot1.10`."""
    numbers = [_NUMBER.findall(file.stem) for file in files]
    lasts = [last.partition(".") for *_, last in numbers]
    counts = sorted(int(fraction or 0) for *_, fraction in lasts)
    lengths = {len(fraction) for *_, fraction in lasts}
    # Digits behind one whole number, of several lengths, that leave out no number: they
    # count. No times are such.
    is_count = len({whole for whole, *_ in lasts}) == 1 and 0 not in lengths
    if is_count and len(lengths) > 1 and counts[-1] - counts[0] == len(counts) - 1:
        numbers = [
            [*others, fraction]
            for (*others, _), (*_, fraction) in zip(numbers, lasts, strict=True)
        ]
    return [tuple(map(Decimal, of_file)) for of_file in numbers]


def codes(picture: Picture) -> Codes:
    """Round colours to 8 bits."""
    return np.floor(CODE_VALUES * np.clip(picture, 0, 1) + 0.5).astype(np.uint8)


def write_png(path: Path, picture: Codes) -> None:
    """Write a PNG that says who made it."""
    import PIL.Image
    import PIL.PngImagePlugin

    made_by = PIL.PngImagePlugin.PngInfo()
    made_by.add_text("Software", _MADE_BY)
    PIL.Image.fromarray(picture).save(path, format="PNG", pnginfo=made_by)


def _is_ours(path: Path) -> bool:
    import PIL.Image

    try:
        # Pillow warns of large pictures, and of a damaged one raises almost anything.
        with warnings.catch_warnings(action="ignore"), PIL.Image.open(path) as image:
            return image.info.get("Software", "").startswith("hmdjit ")
    except Exception:
        return False


def former_frames(folder: Path, names: Iterable[str]) -> list[Path]:
    """Name the frames that `apply` left in a folder, which new ones replace.

    **Errors:** `ValueError` for a file that new ones would overwrite, but `apply` has
    not made.
    """
    found = [file for file in folder.glob("*.png") if file.name[0] != "."]
    ours = [file for file in found if _is_ours(file)]
    for name in names:
        if (file := folder / name).exists() and file not in ours:
            raise ValueError(f"out must not overwrite what apply has not made: {file}.")
    return ours


@contextlib.contextmanager
def replaced(folder: Path, former: Iterable[Path]) -> Iterator[Path]:
    """Give a folder for new files: they replace former ones when all are written.

    **Errors:** `OSError` names the folder, never the unfinished one, as of a full disk.
    """
    is_new = not folder.exists()
    unfinished = folder / f".{os.getpid()}.part"
    try:
        unfinished.mkdir(parents=True)
        yield unfinished
        new = [folder / file.name for file in unfinished.iterdir()]
        for file in new:
            os.replace(unfinished / file.name, file)
        for file in set(former) - set(new):
            file.unlink()
    except OSError as error:
        name = error.filename
        if name is not None and not Path(name).is_relative_to(unfinished):
            raise
        raise OSError(error.errno, error.strerror, str(folder)) from error
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
        if is_new:  # and empty, if something went wrong
            with contextlib.suppress(OSError):
                folder.rmdir()
