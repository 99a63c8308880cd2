"""Options that several commands share, and how the help presents them."""

import tempfile
from pathlib import Path
from typing import Annotated, Any

import tyro


def shown(metavar: str | None, text: str) -> Any:
    """Present an option by a metavar and a sentence, which says its default."""
    return tyro.conf.arg(metavar=metavar, help=text, help_behavior_hint="")


Width = Annotated[int | None, shown("PX", "Width of the frame (default: 1024).")]
Height = Annotated[int | None, shown("PX", "Height of the frame (default: 1024).")]
Fov = Annotated[float | None, shown("DEG", "Horizontal field of view (default: 96).")]
Seed = Annotated[int, shown("N", "Seed of all random draws (default: 0).")]


def check_can_write(folder: Path) -> None:
    """Raise unless files can be made in a folder, or where it is to be."""
    existing = next(place for place in (folder, *folder.parents) if place.exists())
    refused = f"out must be where files can be made, got {folder}: {existing}"
    if not existing.is_dir():
        raise ValueError(f"{refused} is a file.")
    try:
        # Permissions do not tell: some folders refuse everyone, and root has them all.
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        raise ValueError(f"{refused} refuses them ({error.strerror}).") from None


def files_beside(out: Path, suffix: str, *endings: str) -> list[Path]:
    """Name files beside `out`, by endings of its stem, once all of them can be made."""
    if out.suffix.lower() != suffix:
        raise ValueError(f"out must end in {suffix}, got {out}.")
    files = [out.with_name(out.stem + ending) for ending in endings]
    for file in (out, *files):
        if file.is_dir():
            raise ValueError(f"out must be a file, but {file} is a folder.")
    check_can_write(out.parent)
    return files
