"""Techniques as tables in TOML: of head movement in a file of its own.

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
from ..technique_contract.base import AbstractTechnique
from .head_movement import HeadMovement

FAMILIES: dict[str, type[curves.AbstractCurve]] = {
    "kim": curves.Kim,
    "linear": curves.Linear,
    "cosine": curves.Cosine,
    "spline": curves.Spline,
}

_FAMILIES = {curves.AbstractCurve: FAMILIES}
_TABLE = "head_movement"
_CHOICES = ("reprojects", "dynamic")
_OF_THE_ID = ("label", "resolve", "factor", "samples", *_CHOICES)


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
        found = parameters(HeadMovement(), content[_TABLE])
        return HeadMovement(**found, label=path.stem)
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
    the id, as `+ssaa2`), or whose id has another choice of its own (`_rigid`), for a
    curve of no known family, and for a table's wrong name.
    """
    if technique.resolve is not None:
        raise ValueError(f"resolve must be None in a file, got {technique.resolve.id}.")
    held = _toml.table(technique, _FAMILIES)
    of_curves = {
        f"{_TABLE}.{name}": held.pop(name) for name in ("ease", "localization")
    }
    held.pop("label")
    for name in _CHOICES:
        usual = getattr(HeadMovement(), name)
        if (found := held.pop(name)) != usual:
            raise ValueError(f"{name} must be {usual} in a file, got {found}.")
    if _TABLE in (about or {}):
        raise ValueError(f"about must name other tables than {_TABLE}.")
    others = {_toml.key(name): table for name, table in (about or {}).items()}
    _toml.write(path, {}, {_TABLE: held, **of_curves, **others})


def parameters(technique: AbstractTechnique, table: Any) -> dict[str, Any]:
    """Make arguments of a technique's class from the table of its id, and check them.

    What its id says is no number of the table.

    **Errors:** `ValueError` naming the key, what is allowed and the value.
    """
    name, kind = technique.id, type(technique)
    found = _toml.arguments(kind, table, name, _FAMILIES, without=_OF_THE_ID)
    try:
        dataclasses.replace(technique, **found)
    except ValueError as error:
        raise ValueError(f"{name}.{error}") from None
    return found
