"""Options that several commands share, and how the help presents them."""

import os
from pathlib import Path
from typing import Annotated, Any

import tyro


def shown(metavar: str, text: str) -> Any:
    """Present an option by a metavar and a sentence, which says its default."""
    return tyro.conf.arg(metavar=metavar, help=text, help_behavior_hint="")


Width = Annotated[int | None, shown("PX", "Width of the frame (default: 1024).")]
Height = Annotated[int | None, shown("PX", "Height of the frame (default: 1024).")]
Fov = Annotated[float | None, shown("DEG", "Horizontal field of view (default: 96).")]
Seed = Annotated[int, shown("N", "Seed of all random draws (default: 0).")]


def check_can_write(folder: Path) -> None:
    """Raise unless a folder can be written, or made where it is to be."""
    existing = next(place for place in (folder, *folder.parents) if place.exists())
    if not existing.is_dir() or not os.access(existing, os.W_OK):
        raise ValueError(f"out must be a folder that can be written, got {folder}.")
