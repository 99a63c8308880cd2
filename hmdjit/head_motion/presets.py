"""Head models as tables in TOML: the files that fits write, and the presets.

A table has the names of `HeadMotion`'s fields as keys; `source`, `fit` and
`standard_error` say where its numbers come from.
"""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .. import _toml

ABOUT = ("source", "fit", "standard_error")


def tables() -> dict[str, dict[str, Any]]:
    """All presets by name, each with its source and its standard errors."""
    return _toml.read(Path(__file__).with_name("presets.toml"))


def name_of(head: Any) -> str | None:
    """Name of the preset that has a head's numbers."""
    numbers = _toml.table(head)
    for name, table in tables().items():
        if _toml.table(from_table(type(head), table)) == numbers:
            return name
    return None


def words(head: Any) -> str:
    """Kind of a head, and its numbers with their units."""

    def listed(values: tuple[Any, ...]) -> str:
        return "/".join(f"{float(value):.3g}" for value in values)

    return (
        f"model {'B' if head.resonators else 'A'}, "
        f"speed {listed(head.speed_rms_deg_s)} deg/s, "
        f"correlation time {listed(head.correlation_time_s)} s, "
        f"tracker noise {listed(head.tracker_noise_deg)} deg (pitch/yaw/roll)"
        + "".join(
            f", resonance of {listed(mode.speed_rms_deg_s)} deg/s at "
            f"{listed(mode.frequency_hz)} Hz"
            for mode in head.resonators
        )
    )


def read(kind: type[_toml.Config], path: str | os.PathLike[str]) -> _toml.Config:
    """Read a head from a file.

    **Errors:** `ValueError`, one line, naming the file and the key.
    """
    table = _toml.read(path)
    try:
        return from_table(kind, table)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def write(path: str | os.PathLike[str], head: Any, about: Mapping[str, Any]) -> None:
    """Write a head to a file that `read` gives back, to 6 digits.

    **Arguments:** `about`: the file's `source`, `fit` and `standard_error`, if any.
    """
    _toml.write(path, {**_toml.table(head), **about}, digits=6)


def from_table(kind: type[_toml.Config], table: Mapping[str, Any]) -> _toml.Config:
    """Make a head from a table; see `_toml.config`."""
    numbers = {key: value for key, value in table.items() if key not in ABOUT}
    return _toml.config(kind, numbers)
