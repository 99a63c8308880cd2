"""TOML files, and configs (dataclasses) as tables in them.

A table has a config's field names as keys; the fields' types say what each may hold:
a number, a string, a list of these, or a further table. What is None is left out. Where
a field may be any member of a family of configs, its table names it as `family`.
"""

import dataclasses
import json
import os
import tomllib
import types
import typing
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, TypeVar

from . import _checks
from ._files import written_atomically

Config = TypeVar("Config")
Families = Mapping[type, Mapping[str, type]]
"""The abstract class of each family, and its members by name."""

_NOUNS = {int: "whole number", float: "number", str: "string", Path: "string"}


def read(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Content of a file.

    **Errors:** `ValueError` naming the file and what is wrong with it.
    """
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror}.") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(f"{path}: not a TOML file: {error}.") from None


def write(
    path: str | os.PathLike[str],
    values: Mapping[str, Any],
    tables: Mapping[str, Mapping[str, Any]] | None = None,
    *,
    digits: int | None = None,
) -> None:
    """Write values, one a line, and tables by their names, as TOML spells them."""
    lines = []
    for name, entries in {"": values, **(tables or {})}.items():
        header = [f"[{name}]"] if name else []
        pairs = [f"{key(k)} = {text(value, digits)}" for k, value in entries.items()]
        lines += [*header, *pairs, ""] if header or pairs else []
    with written_atomically(path) as unfinished:
        unfinished.write_text("\n".join(lines), encoding="utf-8")


def config(
    kind: type[Config], found: Any, place: str = "", families: Families | None = None
) -> Config:
    """Make a config of a table.

    **Arguments:** `place`: where the table is, as `head_movement`; "" is the file.

    **Errors:** `ValueError` naming the key, what is allowed and the value.
    """
    given = arguments(kind, found, place, families)
    prefix = f"{place}." if place else ""
    for field in dataclasses.fields(kind):  # pyright: ignore[reportArgumentType]
        defaults = (field.default, field.default_factory)
        is_needed = all(default is dataclasses.MISSING for default in defaults)
        if is_needed and field.name not in given:
            raise ValueError(f"{prefix}{field.name} is missing.")
    try:
        return kind(**given)
    except ValueError as error:
        raise ValueError(f"{prefix}{error}") from None


def arguments(
    kind: type,
    found: Any,
    place: str = "",
    families: Families | None = None,
    *,
    without: Collection[str] = (),
) -> dict[str, Any]:
    """Arguments of a config that a table gives, each of its field's type.

    **Arguments:** `place`: as of `config`; `without`: fields that no table holds.

    **Errors:** `ValueError` naming the key, what is allowed and the value.
    """
    if not isinstance(found, Mapping):
        raise ValueError(f"{place} must be a table, got {found!r}.")
    prefix = f"{place}." if place else ""
    kinds = typing.get_type_hints(kind)
    names = [field.name for field in dataclasses.fields(kind)]
    _checks.known_keys(found, [n for n in names if n not in without], prefix)
    return {
        name: _value(kinds[name], value, f"{prefix}{name}", families or {})
        for name, value in found.items()
    }


def _value(kind: Any, found: Any, place: str, families: Families) -> Any:
    """Bring what a file holds to the type of its field."""
    kind = _without_none(kind)
    if kind in families:
        if not isinstance(found, Mapping) or "family" not in found:
            raise ValueError(f"{place} must be a table with a family, got {found!r}.")
        _checks.one_of(f"{place}.family", found["family"], families[kind])
        kind = families[kind][found["family"]]
        found = {name: value for name, value in found.items() if name != "family"}
    if dataclasses.is_dataclass(kind):
        return config(kind, found, place, families)  # pyright: ignore[reportArgumentType]
    if not _fits(kind, found):
        raise ValueError(f"{place} must be {_words(kind)}, got {found!r}.")
    if typing.get_origin(kind) is not tuple:
        return kind(found)
    entry = typing.get_args(kind)[0]
    return tuple(
        _value(entry, value, f"{place}[{i}]", families)
        for i, value in enumerate(_listed(found))
    )


def _without_none(kind: Any) -> Any:
    if typing.get_origin(kind) not in (typing.Union, types.UnionType):
        return kind
    kinds = [one for one in typing.get_args(kind) if one is not types.NoneType]
    return float if float in kinds else kinds[0]  # a number, or an array of one


def _listed(found: Any) -> Any:
    return [found] if isinstance(found, str) else found


def _fits(kind: Any, found: Any) -> bool:
    kind = _without_none(kind)
    if typing.get_origin(kind) is tuple:
        entry, *others = typing.get_args(kind)
        found = _listed(found)
        if not isinstance(found, list) or not all(_fits(entry, v) for v in found):
            return False
        if others != [...]:
            return len(found) == 1 + len(others)
        return bool(found) or dataclasses.is_dataclass(entry)
    if dataclasses.is_dataclass(kind):
        return True  # its keys are checked with names of their own
    if kind is float:
        # An int may be too large for a float.
        return type(found) is float or (_fits(int, found) and abs(found) < 2**1023)
    # In Python a bool is an int, in TOML it is not.
    return type(found) is (str if kind is Path else kind)


def _words(kind: Any) -> str:
    if typing.get_origin(kind) is not tuple:
        return "true or false" if kind is bool else f"a {_NOUNS[kind]}"
    entry, *others = typing.get_args(kind)
    noun = _NOUNS.get(_without_none(entry), "table")
    if others != [...]:
        return f"a list of {1 + len(others)} {noun}s"
    return "a list of tables" if noun == "table" else f"a list of at least one {noun}"


def table(value: Any, families: Families | None = None, place: str = "") -> Any:
    """Fields of a config by name, as plain values and tables of them.

    **Errors:** `ValueError` for a config of no known family where there is one.
    """
    if isinstance(value, list | tuple):
        return [table(entry, families, place) for entry in value]
    if not dataclasses.is_dataclass(value):
        return value if isinstance(value, str | bool | int) else float(value)
    found = {}
    for family, members in (families or {}).items():
        if isinstance(value, family):
            names = [name for name, kind in members.items() if kind is type(value)]
            if not names:
                raise ValueError(
                    f"{place} must be of the families {', '.join(members)}, "
                    f"got a {type(value).__name__}."
                )
            found["family"] = names[0]
    for field in dataclasses.fields(value):
        held = getattr(value, field.name)
        if held is not None:
            where = f"{place}.{field.name}" if place else field.name
            found[field.name] = table(held, families, where)
    return found


def text(value: Any, digits: int | None = None) -> str:
    """Return a value as TOML, on one line.

    **Arguments:** `digits`: significant ones of floats; None is all that they have.
    """
    if isinstance(value, Mapping):
        pairs = (f"{key(k)} = {text(entry, digits)}" for k, entry in value.items())
        return "{ " + ", ".join(pairs) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(text(entry, digits) for entry in value) + "]"
    if isinstance(value, str | bool):
        # Escapes what TOML wants escaped, but for one control character.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, int):
        return str(value)
    number = float(value)
    shown = repr(number) if digits is None else f"{number:.{digits}g}"
    is_whole = isinstance(value, float) and shown.lstrip("-").isdigit()
    return f"{shown}.0" if is_whole else shown


def key(name: str) -> str:
    """Return a key as TOML: bare where it may be."""
    is_bare = name.isascii() and name.replace("-", "").replace("_", "").isalnum()
    return name if is_bare else text(name)
