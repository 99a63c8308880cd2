"""Head models as tables in TOML: the files that fits write, and the presets.

A table has the names of `HeadMotion`'s fields as keys; `source`, `fit` and
`standard_error` say where its numbers come from.
"""

import dataclasses
import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin

import equinox as eqx

from .. import _checks, _toml
from .._files import written_atomically
from .parameters import AXES, PerAxis

ABOUT = ("source", "fit", "standard_error")

_Config = TypeVar("_Config", bound=eqx.Module)


def tables() -> dict[str, dict[str, Any]]:
    """All presets by name, each with its source and its standard errors."""
    path = Path(__file__).with_name("presets.toml")
    return tomllib.loads(path.read_text(encoding="utf-8"))


def read(kind: type[_Config], path: str | os.PathLike[str]) -> _Config:
    """Read a head from a file.

    **Errors:** `ValueError`, one line, naming the file and the key.
    """
    table = _toml.read(Path(path))
    try:
        return from_table(kind, table)
    except (ValueError, OverflowError) as error:
        raise ValueError(f"{path}: {error}") from None


def write(
    path: str | os.PathLike[str], head: eqx.Module, about: Mapping[str, Any]
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


def from_table(kind: type[_Config], table: Any, place: str = "") -> _Config:
    """Make a config from a table with its fields' names as keys.

    **Arguments:** `kind`: the config's class; `place`: where a nested table stands.

    **Errors:** `ValueError` naming the key, what is allowed and the value.
    """
    if not isinstance(table, Mapping):
        raise ValueError(f"{place} must be a table, got {table!r}.")
    prefix = f"{place}." if place else ""
    about = () if place else ABOUT
    fields = {f.name: f for f in dataclasses.fields(kind)}
    held = {}
    for key, value in table.items():
        _checks.one_of(f"{prefix}key", key, [*fields, *about])
        if key in fields:
            held[key] = _value(fields[key].type, value, prefix + key)
    for name, field in fields.items():
        if field.default is dataclasses.MISSING and name not in table:
            raise ValueError(f"{prefix}{name} is missing.")
    try:
        return kind(**held)
    except ValueError as error:
        raise ValueError(f"{prefix}{error}") from None


def _value(kind: Any, value: Any, place: str) -> Any:
    """Read a field that holds numbers, another config or several of them."""
    for inner in get_args(kind):
        if not (isinstance(inner, type) and issubclass(inner, eqx.Module)):
            continue
        if get_origin(kind) is not tuple:
            return from_table(inner, value, place)
        if not isinstance(value, list):
            raise ValueError(f"{place} must be a list of tables, got {value!r}.")
        return [from_table(inner, v, f"{place}[{i}]") for i, v in enumerate(value)]
    what, numbers = "a number", [value]
    if kind == PerAxis:
        what = f"3 numbers ({', '.join(AXES)})"
        numbers = value if isinstance(value, list) else [None]
    if not all(type(number) in (int, float) for number in numbers):
        raise ValueError(f"{place} must be {what}, got {value!r}.")
    return value
