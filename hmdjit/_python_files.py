"""Python files of a user's own: what is named in one, as `my_taa.py:MyTAA`."""

import difflib
import importlib
import importlib.util
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")


def split(place: str) -> tuple[Path, str] | None:
    """File and name of a place such as `my_taa.py:MyTAA`; None of any other text."""
    file, _, name = place.rpartition(":")
    return (Path(file), name) if file.endswith(".py") else None


def load(file: Path, name: str) -> Any:
    """Import a file, as a script in its folder would, and give what it names.

    Its folder comes last on `sys.path`: processes that a study is handed to, and files
    that it imports, find it there.

    **Errors:** `ValueError` in one line naming the file and what is wrong with it, the
    nearest name it has, or the line at which it fails.
    """
    file = file.resolve()
    if not file.is_file():
        raise ValueError(f"{file}: there is no such file.")
    if str(file.parent) not in sys.path:
        sys.path.append(str(file.parent))
    importlib.invalidate_caches()
    module = file.stem
    known = importlib.util.find_spec(module) if module.isidentifier() else None
    if known is None or known.origin is None or Path(known.origin).resolve() != file:
        raise ValueError(
            f"{file}: must have another name: Python cannot import it as {module}, or "
            "knows another of that name."
        )
    found = made(file, lambda: vars(importlib.import_module(module)))
    if name not in found:
        public = [known for known in found if not known.startswith("_")]
        near = difflib.get_close_matches(name, public, n=1)
        hint = f" Did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"{file}: has no {name!r}.{hint}")
    return found[name]


def made(file: Path, make: Callable[[], T], name: str = "") -> T:
    """Call what a user wrote, without arguments.

    **Errors:** `ValueError` naming the file and the name in it, and the error with the
    line of the file that led to it.
    """
    try:
        return make()
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        own = [f.lineno for f in frames if Path(f.filename).resolve() == file.resolve()]
        line = error.lineno if isinstance(error, SyntaxError) else [None, *own][-1]
        where = "" if line is None else f", line {line}"
        kind = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
        reason = (str(error).splitlines() or [""])[0]
        place = f"{file}:{name}" if name else f"{file}"
        raise ValueError(f"{place}{where}: {kind}{reason}") from error
