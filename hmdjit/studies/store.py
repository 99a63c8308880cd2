"""Finished batches on disk: written whole or not at all, found again by their content.

A key is a hash of everything that decides a scene's numbers, but for which sessions
they are of: these are in the names of its files. A study that is run again, or made
longer, therefore finds what it has and computes only what it lacks. A name also has a
SHA-256 of the content: a file that is truncated, altered or renamed counts as
unfinished.

The code of the package is what the model's version stands for. No hash knows all that
a class of a user's own computes with (helper functions, constants, parents): batches
of one are kept only if the class itself, or a function, has a `version`, anything that
is changed whenever what it computes changes.
"""

import dataclasses
import glob
import hashlib
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from .._files import written_atomically
from ..simulation.session import Result

# What a thing is called decides nothing.
_NAMES = ("name", "label")

# What no file of Windows may have in its name; ids and scenes may, and may be as long
# as a file's name, of at most 255 bytes, by themselves.
_UNNAMEABLE = re.compile(r'[<>:"/\\|?*]')
_LONGEST_NAME = 40


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
    if not _is_ours(kind) and "version" in vars(kind):
        digest.update(repr(getattr(part, "version", None)).encode())
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
    elif callable(part):
        digest.update(_called(part).encode())  # what it does, a version knows at most
        digest.update(repr(getattr(part, "version", None)).encode())
    else:
        raise TypeError(f"cannot take the fingerprint of: {type(part).__name__}.")


def without_version(*parts: Any) -> list[str]:
    """Name the classes and functions in some objects that no version knows."""
    found: list[str] = []
    for part in parts:
        if isinstance(part, Mapping):
            found += without_version(*part.values())
        elif isinstance(part, Sequence) and not isinstance(part, str):
            found += without_version(*part)
        elif dataclasses.is_dataclass(kind := type(part)):
            # A version that is inherited says nothing of what was added.
            if not _is_ours(kind) and "version" not in vars(kind):
                found.append(kind.__qualname__)
            fields = dataclasses.fields(kind)
            found += without_version(*(getattr(part, field.name) for field in fields))
        elif callable(part) and getattr(part, "version", None) is None:
            found.append(_called(part))
    return found


def _called(function: Any) -> str:
    return getattr(function, "__qualname__", type(function).__qualname__)


def _is_ours(kind: type) -> bool:
    return kind.__module__.startswith("hmdjit.")


class Store:
    """Batches of a study; in a folder, or nowhere.

    A file holds what one dispatch measured, of one technique or several. A technique
    that is added to a study later is measured alone, into a file of its own; its halo
    may be another than beside others, which moves it by less than `HALO_TOLERANCE`.

    `damaged`: files that were found not to be what they were written as.
    """

    def __init__(self, folder: Path | None):
        self._folder = None if folder is None else folder / "batches"
        self.damaged: list[Path] = []
        # Made once: a folder that vanishes meanwhile is an error, and no new one.
        if self._folder is not None:
            self._folder.mkdir(parents=True, exist_ok=True)

    def found(
        self, name: str, key: str, sessions: str = "*"
    ) -> Iterator[tuple[int, dict[str, Result]]]:
        """Read what is known of a scene, a file at a time.

        **Arguments:** `sessions`: of which batch, as `batch_words`.

        **Returns:** the first session of each, and results by fingerprints of
        techniques.
        """
        if self._folder is None:
            return
        stem = glob.escape(_stem(name, key))
        for path in sorted(self._folder.glob(f"{stem}-{sessions}-*.npz")):
            try:
                content = path.read_bytes()
            except OSError:
                content = b""
            words, _, digest = path.stem.rpartition("-")
            if digest != _digest(words, content):
                self.damaged.append(path)
                continue
            values: dict[str, dict[str, np.ndarray]] = {}
            with np.load(io.BytesIO(content)) as file:
                for entry in file.files:
                    technique, metric = entry.split(".", 1)
                    values.setdefault(technique, {})[metric] = file[entry]
            results = {key: Result(metrics) for key, metrics in values.items()}
            yield int(words.split("-")[-2]), results

    def keep(
        self, name: str, key: str, start: int, results: Mapping[str, Result]
    ) -> None:
        """Write what a dispatch measured from a session on, by the techniques."""
        if self._folder is None:
            return
        values = {
            f"{technique}.{metric}": np.asarray(value)
            for technique, result in results.items()
            for metric, value in result.metrics.items()
        }
        content = io.BytesIO()
        np.savez(content, allow_pickle=False, **values)
        size = len(next(iter(values.values())))
        words = f"{_stem(name, key)}-{batch_words(start, size)}"
        digest = _digest(words, content.getvalue())
        path = self._folder / f"{words}-{digest}.npz"
        with written_atomically(path, makes_folder=False) as unfinished:
            unfinished.write_bytes(content.getvalue())


def batch_words(start: int, size: int) -> str:
    """Name a batch of sessions."""
    return f"{start}-{size}"


def _digest(words: str, content: bytes) -> str:
    return hashlib.sha256(words.encode() + content).hexdigest()[:32]


def _stem(name: str, key: str) -> str:
    return f"{_UNNAMEABLE.sub('_', name)[:_LONGEST_NAME]}-{key[:16]}"
