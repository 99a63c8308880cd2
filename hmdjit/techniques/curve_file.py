"""Head-movement techniques in TOML files, with their numbers and curves.

A file has a table `[head_movement]` with the technique's fields as keys, and in it
tables `ease` and `localization`: a `family` of curves and its numbers. What is not said
is Kim et al.'s. All other tables are the writer's own, such as `[fit]`.
"""

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .. import _checks, _toml, curves
from .._files import written_atomically
from ..curves import AbstractCurve
from .head_movement import HeadMovement

FAMILIES: dict[str, type[AbstractCurve]] = {
    "kim": curves.Kim,
    "linear": curves.Linear,
    "cosine": curves.Cosine,
    "spline": curves.Spline,
}

_TABLE = "head_movement"
_CURVES = ("ease", "localization")
_WORDS = ("difference", "space")
_LISTS = ("closeness", "weights", "increments")
_KEYS = [
    field.name
    for field in dataclasses.fields(HeadMovement)
    if field.name not in ("resolve", "label")
]


def read(path: str | os.PathLike[str]) -> HeadMovement:
    """Read a technique from a file; its label is the file's name, without `.toml`.

    **Errors:** `ValueError`, one line, naming the file, the key, its range and value.
    """
    path = Path(path)
    content = _toml.read(path)
    try:
        tables = {key for key, value in content.items() if isinstance(value, Mapping)}
        _checks.known_keys(content, tables | {_TABLE}, "")
        if _TABLE not in content:
            raise ValueError(f"table {_TABLE} is missing.")
        return HeadMovement(**parameters(content[_TABLE]), label=path.stem)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def write(
    path: str | os.PathLike[str],
    technique: HeadMovement,
    about: Mapping[str, Mapping[str, Any]] | None = None,
) -> None:
    """Write a technique to a file, of which `read` makes the same to the last bit.

    Its label is not written: it is the file's name.

    **Arguments:** `about`: further tables by name, such as where the numbers are from.

    **Errors:** `ValueError` for a technique that resolves samples (a study adds that to
    the id, as `+ssaa2`), for a curve of no known family, and for a table's wrong name.
    """
    if technique.resolve is not None:
        raise ValueError(f"resolve must be None in a file, got {technique.resolve.id}.")
    held = {name: getattr(technique, name) for name in _KEYS}
    plain = {
        name: _plain(value)
        for name, value in held.items()
        if name not in _CURVES and value is not None
    }
    tables: dict[str, Mapping[str, Any]] = {_TABLE: plain}
    for name in _CURVES:
        tables[f"{_TABLE}.{name}"] = _of_curve(name, held[name])
    for name, table in (about or {}).items():
        if name == _TABLE:
            raise ValueError(f"about must name other tables than {_TABLE}.")
        tables[_toml.key(name)] = table
    with written_atomically(path) as unfinished:
        text = "\n".join(_block(name, table) for name, table in tables.items())
        unfinished.write_text(text, encoding="utf-8")


def _block(name: str, table: Mapping[str, Any]) -> str:
    lines = [f"{_toml.key(key)} = {_toml.text(value)}" for key, value in table.items()]
    return "\n".join([f"[{name}]", *lines, ""])


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    return value if isinstance(value, str) else float(value)


def _of_curve(name: str, curve: AbstractCurve) -> dict[str, Any]:
    families = {kind: family for family, kind in FAMILIES.items()}
    if type(curve) not in families:
        raise ValueError(
            f"{name} must be a curve of the families {', '.join(FAMILIES)}, "
            f"got a {type(curve).__name__}."
        )
    numbers = {
        field.name: _plain(getattr(curve, field.name))
        for field in dataclasses.fields(curve)
    }
    return {"family": families[type(curve)], **numbers}


def parameters(table: Any) -> dict[str, Any]:
    """Make arguments of `HeadMovement` from a `[head_movement]` table, and check them.

    **Errors:** `ValueError` naming the key, what is allowed and the value.
    """
    found = _checked(table, _TABLE, _KEYS)
    for name in _CURVES:
        if name in found:
            found[name] = _curve(found[name], f"{_TABLE}.{name}")
    try:
        HeadMovement(**found)
    except ValueError as error:
        raise ValueError(f"{_TABLE}.{error}") from None
    return found


def _curve(table: Any, place: str) -> AbstractCurve:
    if not isinstance(table, Mapping) or "family" not in table:
        raise ValueError(f"{place} must be a table with a family, got {table!r}.")
    numbers = {key: value for key, value in table.items() if key != "family"}
    _checks.one_of(f"{place}.family", table["family"], FAMILIES)
    family = FAMILIES[table["family"]]
    fields = dataclasses.fields(family)
    numbers = _checked(numbers, place, [field.name for field in fields])
    for field in fields:
        if field.default is dataclasses.MISSING and field.name not in numbers:
            raise ValueError(f"{place}.{field.name} is missing.")
    try:
        return family(**numbers)
    except ValueError as error:
        raise ValueError(f"{place}.{error}") from None


def _checked(table: Any, place: str, known: list[str]) -> dict[str, Any]:
    """Copy a table whose keys are known and whose values are of their types."""
    if not isinstance(table, Mapping):
        raise ValueError(f"{place} must be a table, got {table!r}.")
    _checks.known_keys(table, known, f"{place}.")
    for key, value in table.items():
        if key in _CURVES:
            continue
        if key in _WORDS:
            what, is_right = "a string", isinstance(value, str)
        elif key in _LISTS:
            is_list = isinstance(value, list)
            what, is_right = (
                "a list of numbers",
                is_list and all(map(_is_number, value)),
            )
        else:
            what, is_right = "a number", _is_number(value)
        if not is_right:
            raise ValueError(f"{place}.{key} must be {what}, got {value!r}.")
    return dict(table)


def _is_number(value: Any) -> bool:
    # In Python a bool is an int, and an int may be too large for a float.
    return type(value) is float or (type(value) is int and abs(value) < 2**1023)
