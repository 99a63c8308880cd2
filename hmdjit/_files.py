"""Writing files so that a name never stands for half of its content."""

import contextlib
import csv
import dataclasses
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any


@contextlib.contextmanager
def written_atomically(
    path: str | os.PathLike, *, makes_folder: bool = True
) -> Iterator[Path]:
    """Give a path to write to, which replaces `path` only once all is on the disk.

    **Errors:** `OSError` that names `path`, as on a full disk.
    """
    path = Path(path)
    if makes_folder:
        path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield unfinished
        if unfinished.is_file():
            with open(unfinished, "rb+") as file:
                os.fsync(file.fileno())
        os.replace(unfinished, path)
        _sync_folder(path.parent)
    except OSError as error:
        if error.filename not in (None, str(unfinished), unfinished):
            raise  # of another file, read in between
        reason = error.strerror or str(error)
        raise OSError(error.errno, reason, str(path)) from error
    finally:
        with contextlib.suppress(OSError):  # of what is told already
            unfinished.unlink()


def _sync_folder(folder: Path) -> None:
    """Have a new name survive a power cut, where a system can do that."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def check_can_write(folder: Path) -> None:
    """Raise unless files can be made in a folder, or where it is to be."""
    existing = next(place for place in (folder, *folder.parents) if place.exists())
    refused = f"out must be where files can be made, got {folder}: {existing}"
    if not existing.is_dir():
        raise ValueError(f"{refused} is a file.")
    try:
        # Permissions do not tell: some folders refuse everyone, and root has them all.
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        raise ValueError(f"{refused} refuses them ({error.strerror}).") from None


def files_beside(out: Path, suffix: str, *endings: str) -> list[Path]:
    """Name files beside `out`, by endings of its stem, once all of them can be made."""
    if out.suffix.lower() != suffix:
        raise ValueError(f"out must end in {suffix}, got {out}.")
    files = [out.with_name(out.stem + ending) for ending in endings]
    for file in (out, *files):
        if file.is_dir():
            raise ValueError(f"out must be a file, but {file} is a folder.")
    check_can_write(out.parent)
    return files


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
