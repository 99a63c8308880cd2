"""What a user asked for: kept in a study's folder, to make it again, and as typed."""

import dataclasses
import shlex
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tyro

from .. import _toml, techniques
from ..studies.study import Study
from .definition import build, placed, read_toml
from .options import Options

REPEAT = "repeat.toml"
"""Name of the file."""


def repeated(folder: Path) -> str:
    """Return the command that repeats the study of a folder."""
    return f"hmdjit study {shlex.quote(str(folder / REPEAT))} --out AGAIN"


def keep(options: Options, file: Path | None, folder: Path) -> Path:
    """Write what was asked for into a study's folder, as a STUDY.toml.

    Files that it names are those that were read, by their full paths. Of a study with
    a budget it asks for as many sessions again.

    **Arguments:** `file`: the STUDY.toml that numbers of techniques came from, if any.
    """
    said = placed(options.said(), Path.cwd())
    for name in ("out", "overwrite", "workers", "dask"):
        said.pop(name, None)
    if said.pop("budget", None) is not None:
        said["repeat"] = "result.nc"
    content = {} if file is None else _toml.read(file)
    numbers = {id: content[id] for id in techniques.IDS if id in content}
    path = folder / REPEAT
    _toml.write(path, _plain(said), numbers)
    return path


def kept(folder: Path) -> Study | None:
    """Return the study whose definition lies in its folder; None if there is none.

    **Errors:** those of `read_toml` and `build`, as where files are gone.
    """
    path = folder / REPEAT
    return build(*read_toml(path)) if path.exists() else None


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _plain(each) for name, each in value.items()}
    if isinstance(value, tuple):
        return [_plain(each) for each in value]
    return str(value) if isinstance(value, Path) else value


def typed(name: str, command: Any) -> str:
    """Spell a command as a user types it; defaults are left out."""
    words, options = ["hmdjit", name], []
    hints = typing.get_type_hints(type(command), include_extras=True)
    for field in dataclasses.fields(command):
        value = getattr(command, field.name)
        several = value if isinstance(value, tuple) else (value,)
        about = getattr(hints[field.name], "__metadata__", ())
        if tyro.conf.Positional in about:
            words += [] if value is None else map(str, several)
        elif value != field.default:
            option = f"--{field.name.replace('_', '-')}"
            options += [option, *(map(str, several) if value is not True else ())]
    return shlex.join([*words, *options])
