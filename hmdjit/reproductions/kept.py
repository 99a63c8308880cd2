"""Arrays of an experiment, kept as they are finished: an interruption loses one."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from .._files import written_atomically
from ..studies.identity import MODEL_VERSION
from ..studies.store import fingerprint

_DIGITS = 16  # of a fingerprint, in a file's name


def kept(
    folder: str | os.PathLike,
    name: str,
    parts: Any,
    compute: Callable[[], np.ndarray],
) -> np.ndarray:
    """Return what a file has, or what is computed, and then kept in it.

    **Arguments:** `parts`: all that decides the numbers, but the code of the package,
    which the model's version stands for.
    """
    digest = fingerprint(MODEL_VERSION, parts)[:_DIGITS]
    path = Path(folder) / f"{name}-{digest}.npy"
    if path.exists():
        return np.load(path, allow_pickle=False)
    found = compute()
    with written_atomically(path) as unfinished, open(unfinished, "wb") as file:
        np.save(file, found, allow_pickle=False)
    return found
