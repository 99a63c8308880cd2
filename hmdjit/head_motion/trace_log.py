"""Pose logs in JSON: a sample a line, an array of samples, or an object with one."""

import contextlib
import json
from collections.abc import Iterator
from typing import Any

from .trace_columns import is_xyz, is_xyzw, shown, used
from .trace_table import Columns, Table


def parsed(file: str, lines: list[str], start: int, columns: Columns) -> Table:
    """Turn JSON lines, or a JSON array of samples, into a table of the keys in use."""
    rows, places, broken, names = [], [], {}, []
    for place, text, sample in _samples(lines, start):
        where = f"{file}, {place}"
        leaves = dict(_leaves(sample))
        try:
            if not isinstance(sample, dict):
                raise ValueError(f"{where}: must be a JSON object, got {shown(text)}.")
            if not names:
                keys = [key for key in leaves if not columns or key in columns]
                names = [keys[i] for i in used(keys, where)]
            text = ",".join([repr(leaves[name]) for name in names])
        except KeyError as error:
            broken[len(rows)] = f"{where}, column {error.args[0]}: is missing."
        except ValueError as error:
            broken[len(rows)] = str(error)
        rows.append(text)
        places.append(place)
    if not names:
        raise ValueError(broken[0] if broken else f"{file}: has no samples.")
    return Table(file, rows, places, list(range(len(names))), names, broken)


def _samples(lines: list[str], start: int) -> Iterator[tuple[str, str, Any]]:
    """Yield each sample's place, text and content, None where that is no JSON."""
    text = "\n".join(lines[start:]).strip()
    whole = _decoded(text) if text.startswith("{") else None
    lists = [
        value
        for value in (whole or {}).values()
        if isinstance(value, list) and value and isinstance(value[0], dict)
    ]
    if text.startswith("["):
        yield from _in_array(text)
    elif len(lists) == 1:
        for number, sample in enumerate(lists[0], 1):
            yield f"sample {number}", repr(sample), sample
    else:
        for number, line in enumerate(lines[start:], start + 1):
            yield f"line {number}", line, _decoded(line)


def _in_array(text: str) -> Iterator[tuple[str, str, Any]]:
    """Decode one sample after another, so that damage ends with its line."""
    decode, at, number = json.JSONDecoder().raw_decode, 1, 0
    text = text.removesuffix("]")
    while at < len(text):
        if text[at].isspace() or text[at] == ",":
            at += 1
            continue
        number += 1
        sample, end = None, text.find("\n", at) + 1 or len(text)
        with contextlib.suppress(ValueError, RecursionError):
            sample, end = decode(text, at)
        yield f"sample {number}", text[at:end].strip(), sample
        at = end


def _decoded(text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):  # not JSON, or nested without end
        return None


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield values in nested objects by dotted keys; lists of a pose by their axes."""
    if isinstance(value, list):
        keys = "xyzw" if len(value) == 4 and is_xyzw(path) else range(len(value))
        keys = "xyz" if len(value) == 3 and is_xyz(path) else keys
        value = dict(zip(map(str, keys), value, strict=True))
    if not isinstance(value, dict):
        yield " ".join(path.split()), value
    else:
        for key, item in value.items():
            yield from _leaves(item, f"{path}.{key}" if path else key)
