"""TOML files: reading with errors of one line, and writing values."""

import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def read(path: Path) -> dict[str, Any]:
    """Content of a file.

    **Errors:** `ValueError` naming the file and what is wrong with it.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror}.") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(f"{path}: not a TOML file: {error}.") from None


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
