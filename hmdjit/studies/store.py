"""Finished batches on disk: written whole or not at all, found again by their content.

A batch's key is a hash of everything that decides its numbers. A study that is run
again, or made longer, therefore finds what it has and computes only what it lacks.
"""

import contextlib
import dataclasses
import hashlib
import inspect
import re
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from .._files import written_atomically
from ..simulation.session import Result

# What a thing is called decides nothing.
_NAMES = ("name", "label")

# What no file of Windows may have in its name; ids and scenes may.
_UNNAMEABLE = re.compile(r'[<>:"/\\|?*]')


def fingerprint(*parts: Any) -> str:
    """Return a SHA-256 over everything in some objects: types, fields, numbers, arrays.

    **Errors:** `TypeError` for an object that cannot be taken apart.
    """
    digest = hashlib.sha256()
    _absorb(digest, parts)
    return digest.hexdigest()


def _absorb(digest: Any, part: Any) -> None:
    if isinstance(part, np.generic):
        part = part.item()
    kind = type(part)
    digest.update(f"<{kind.__module__}.{kind.__qualname__}>".encode())
    if dataclasses.is_dataclass(part) and not kind.__module__.startswith("hmdjit."):
        # A technique or scene of a user's own: its code decides numbers too. That of
        # the package is what the model's version stands for.
        with contextlib.suppress(OSError, TypeError):
            digest.update(inspect.getsource(kind).encode())
    if part is None or isinstance(part, str | int | float | bool):
        digest.update(repr(part).encode())
    elif isinstance(part, np.ndarray | jax.Array):
        array = np.ascontiguousarray(part)
        digest.update(f"{array.dtype}{array.shape}".encode())
        digest.update(array.tobytes())
    elif isinstance(part, Mapping):
        for name, value in part.items():
            digest.update(repr(name).encode())
            _absorb(digest, value)
    elif isinstance(part, Sequence):
        digest.update(f"[{len(part)}]".encode())
        for value in part:
            _absorb(digest, value)
    elif dataclasses.is_dataclass(part):
        for field in dataclasses.fields(part):
            if field.name not in _NAMES:
                digest.update(field.name.encode())
                _absorb(digest, getattr(part, field.name))
    else:
        raise TypeError(f"cannot take the fingerprint of a {type(part).__name__}.")


class Store:
    """Batches of a study; in a folder, or nowhere."""

    def __init__(self, folder: Path | None):
        self._folder = None if folder is None else folder / "batches"

    def find(self, name: str, key: str) -> Result | None:
        """Return a finished batch, or None; an unreadable file counts as unfinished."""
        if self._folder is None:
            return None
        try:
            with open(self._path(name, key), "rb") as raw, np.load(raw) as file:
                return Result(file["mtcd"], file["detail_loss"])
        except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile):
            return None

    def keep(self, name: str, key: str, result: Result) -> None:
        """Write a finished batch."""
        if self._folder is not None:
            with (
                written_atomically(self._path(name, key)) as unfinished,
                open(unfinished, "wb") as file,
            ):
                np.savez(file, mtcd=result.mtcd, detail_loss=result.detail_loss)

    def _path(self, name: str, key: str) -> Path:
        assert self._folder is not None
        return self._folder / f"{_UNNAMEABLE.sub('_', name)}-{key[:16]}.npz"
