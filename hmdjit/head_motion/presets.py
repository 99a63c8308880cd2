"""Head models as tables in TOML: the files that fits write, and the presets.

A table has the names of `HeadMotion`'s fields as keys; `source`, `fit` and
`standard_error` say where its numbers come from.
"""

import dataclasses
import os
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx

from .. import _checks, _toml
from .._files import written_atomically
from .parameters import Amplitude, PerAxis, Resonator
from .process import HeadMotion

_ABOUT = ("source", "fit", "standard_error")


def tables() -> dict[str, dict[str, Any]]:
    """All presets by name, each with its source and its standard errors."""
    path = Path(__file__).with_name("presets.toml")
    return tomllib.loads(path.read_text(encoding="utf-8"))


def preset(name: str) -> HeadMotion:
    """Head of a preset.

    **Errors:** `ValueError` for an unknown name, with the nearest known one.
    """
    known = tables()
    _checks.one_of("head", name, known)
    return from_table(known[name])


def read(path: str | os.PathLike[str]) -> HeadMotion:
    """Read a head from a file.

    **Errors:** `ValueError`, one line, naming the file and the key.
    """
    try:
        return from_table(tomllib.loads(Path(path).read_text(encoding="utf-8")))
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror}.") from None
    except (ValueError, OverflowError, RecursionError) as error:  # also of TOML, UTF-8
        raise ValueError(f"{path}: {error}") from None


def write(
    path: str | os.PathLike[str], head: HeadMotion, about: Mapping[str, Any]
) -> None:
    """Write a head to a file that `read` gives back, to 6 digits.

    **Arguments:** `about`: the file's `source`, `fit` and `standard_error`, if any.
    """
    table = {**to_table(head), **about}
    lines = [f"{key} = {_toml.text(value, 6)}" for key, value in table.items()]
    with written_atomically(path) as unfinished:
        unfinished.write_text("\n".join([*lines, ""]), encoding="utf-8")


def to_table(config: Any) -> Any:
    """Fields of a head by name, as nested tables of plain numbers."""
    if isinstance(config, eqx.Module):
        held = {f.name: getattr(config, f.name) for f in dataclasses.fields(config)}
        return {
            key: to_table(value) for key, value in held.items() if value is not None
        }
    if isinstance(config, tuple):
        return [to_table(entry) for entry in config]
    return float(config)


def from_table(table: Mapping[str, Any]) -> HeadMotion:
    """Make a head from a table.

    **Errors:** `ValueError` naming the key, what is allowed and the value.
    """
    numbers = {key: table[key] for key in table if key not in _ABOUT}
    modes = numbers.pop("resonators", [])
    if not isinstance(modes, list):
        raise ValueError(f"resonators must be a list of tables, got {modes!r}.")
    resonators = [
        _config(Resonator, mode, f"resonators[{i}].") for i, mode in enumerate(modes)
    ]
    amplitude = numbers.pop("amplitude", None)
    if amplitude is not None:
        amplitude = _config(Amplitude, amplitude, "amplitude.")
    nested = {"resonators": resonators, "amplitude": amplitude}
    return _config(HeadMotion, numbers, "", _ABOUT, **nested)


def _config(
    kind: Any, table: Any, place: str, about: Sequence[str] = (), **nested: Any
) -> Any:
    if not isinstance(table, Mapping):
        raise ValueError(f"{place.rstrip('.')} must be a table, got {table!r}.")
    fields = {f.name: f for f in dataclasses.fields(kind) if f.name not in nested}
    for key, value in table.items():
        _checks.one_of(f"{place}key", key, [*fields, *nested, *about])
        what, numbers = "a number", [value]
        if fields[key].type == PerAxis:
            what = "3 numbers (pitch, yaw, roll)"
            numbers = value if isinstance(value, list) else [None]
        if not all(type(number) in (int, float) for number in numbers):
            raise ValueError(f"{place}{key} must be {what}, got {value!r}.")
    for name, field in fields.items():
        if field.default is dataclasses.MISSING and name not in table:
            raise ValueError(f"{place}{name} is missing.")
    try:
        return kind(**table, **nested)
    except ValueError as error:
        raise ValueError(f"{place}{error}") from None
