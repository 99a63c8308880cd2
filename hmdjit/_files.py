"""Writing files so that a name never stands for half of its content."""

import contextlib
import csv
import dataclasses
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any


@contextlib.contextmanager
def written_atomically(path: str | os.PathLike) -> Iterator[Path]:
    """Give a path to write to, which replaces `path` only once all is written.

    **Errors:** `OSError` that names `path`, as on a full disk.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield unfinished
        os.replace(unfinished, path)
    except OSError as error:
        if error.filename not in (None, str(unfinished), unfinished):
            raise  # of another file, read in between
        reason = error.strerror or str(error)
        raise OSError(error.errno, reason, str(path)) from error
    finally:
        unfinished.unlink(missing_ok=True)


def write_csv(path: str | os.PathLike, rows: Sequence[Any]) -> Path:
    """Write rows as comma-separated values (RFC 4180), numbers to the last digit.

    **Arguments:** `rows`: at least one; mappings, named tuples or dataclasses of one
    kind. Their keys are the columns; those of a mapping within stand in its place.

    **Returns:** the path. The file appears at once and whole.
    """
    table = [_columns(row) for row in rows]
    with (
        written_atomically(path) as unfinished,
        open(unfinished, "w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.DictWriter(file, list(table[0]))
        writer.writeheader()
        writer.writerows(table)
    return Path(path)


def _columns(row: Any) -> dict[str, Any]:
    if hasattr(row, "_asdict"):
        row = row._asdict()
    elif not isinstance(row, Mapping):
        row = dataclasses.asdict(row)
    found = {}
    for name, value in row.items():
        found |= value if isinstance(value, Mapping) else {name: value}
    return found
