"""Files of head traces: tables (CSV and its kin), and OpenXR pose logs as JSON lines.

What a file calls its columns, what separates them and which unit its times have is
detected. What could mean two things is refused, naming the option that decides it.
"""

import json
import math
import re
from collections.abc import Callable, Iterator, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from .. import _checks

# Columns' names, as `_plain` writes them: `Time [s]` is time_s, `HMD.qW` is hmd_q_w. An
# orientation's first group tells one from another: hmd_q, rot, "" for bare w, x, y, z.
_TIMES = {"t", "ts", "time", "timestamp", "time_stamp", "xr_time", "xrtime"}
_TIMES |= {"display_time", "predicted_display_time"}
_UNITS = {  # parts of a second; names
    "s": (1, {"s", "sec", "second", "seconds"}),
    "ms": (10**3, {"ms", "msec", "millis", "milliseconds"}),
    "us": (10**6, {"us", "usec", "micros", "microseconds"}),
    "ns": (10**9, {"ns", "nsec", "nanos", "nanoseconds"}),
}
_ROTATION = "q|quat|quaternion|rot|rotation|orientation"
_XYZW = re.compile(rf"(.*_)?({_ROTATION})")
_ORIENTATIONS = {
    ("qw", "qx", "qy", "qz"): rf"((?:.*_)?(?:{_ROTATION})?_?)([wxyz])",
    ("pitch", "yaw", "roll"): r"((?:.*_)?)(pitch|yaw|roll)(?:_deg|_degrees)?",
}

_STEP_RANGE_S = (5e-4, 0.2)  # 5 to 2000 Hz: the ranges of two units do not meet
_MAX_LENGTH_ERROR = 0.01  # files carry few decimals, but more than two
_Times = Float64[np.ndarray, " rows"]
_Quaternions = Float64[np.ndarray, "rows 4"]
_Columns = Sequence[str] | None


class _Table(NamedTuple):
    """Lines of fields between commas; which are used, time first; their names."""

    file: str
    lines: list[str]
    first_line: int
    used: list[int]
    names: list[str]

    def field(self, row: int, column: int) -> str:
        return self.lines[row].split(",")[self.used[column]].strip()

    def where(self, row: int, column: int) -> str:
        line = self.first_line + row
        return f"{self.file}, line {line}, column {self.names[column]}"


def read(
    path: Path, columns: _Columns, time_unit: str | None, axes: str
) -> tuple[_Times, _Quaternions]:
    """Read a table or a pose log; arguments and errors are those of `Trace.read`.

    **Returns:** times, s, and `world_from_head`, `wxyz`, lengths as in the file.
    """
    _checks.one_of("axes", axes, ("openxr", "unity"))
    if time_unit is not None:
        _checks.one_of("time_unit", time_unit, _UNITS)
    lines, start = _lines(path)
    parse = _log if lines[start].lstrip().startswith("{") else _table
    table = parse(path.name, lines, start, columns)
    numbers = _numbers(table)
    t_s = _seconds(table, numbers[:, 0], time_unit or _unit_in(table.names[0]))
    world_from_head = numbers[:, 1:]
    if world_from_head.shape[1] == 3:
        world_from_head = _from_euler_deg(world_from_head)
    if axes == "unity":  # mirrored in z: turns about x and y change their sense
        world_from_head = world_from_head * np.array([1.0, -1.0, -1.0, 1.0])
    where = lambda row: f"{path.name}, line {table.first_line + row}"
    check_lengths(where, ",".join(table.names[1:]), world_from_head)
    return t_s, world_from_head


def check_lengths(
    where: Callable[[int], str], columns: str, quaternions: _Quaternions
) -> None:
    """Raise unless all quaternions have length 1 within 1 %."""
    with np.errstate(over="ignore"):
        length = np.linalg.norm(quaternions, axis=1)
    for row in np.flatnonzero(~(np.abs(length - 1) <= _MAX_LENGTH_ERROR))[:1].tolist():
        raise ValueError(
            f"{where(row)}, columns {columns}: length must lie within 1 % of 1, got "
            f"{length[row]:.6g}."
        )


def _lines(path: Path) -> tuple[list[str], int]:
    """Lines of a file, and the first that is neither blank nor a comment."""
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise ValueError(f"{path.name}: cannot be read ({error.strerror}).") from None
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path.name}: must be text in UTF-8, but byte {error.start + 1} is not."
        ) from None
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    for start, line in enumerate(lines):
        if line.strip() and not line.lstrip().startswith("#"):
            return lines, start
    raise ValueError(f"{path.name}: is empty.")


def _table(file: str, lines: list[str], start: int, columns: _Columns) -> _Table:
    """Find the header, or take `columns` for it, and check the rows' lengths."""
    lines = _with_commas(lines, start, columns)
    is_number = [_is_finite(field) for field in lines[start].split(",")]
    header, where = start, f"{file}, option columns"
    if not columns:
        header -= start > 0 and all(is_number)  # `numpy.savetxt` comments it out
        columns = re.sub(r"^\s*#[#, ]*", "", lines[header]).split(",")
        where = f"{file}, line {header + 1}"
    names = [" ".join(name.split()) for name in columns]
    used = _used(names, where)
    if header == start:
        header -= any(is_number[i] for i in used if i < len(is_number))
    rows = lines[header + 1 :]
    for row, line in enumerate(rows, header + 2):
        if line.count(",") != len(names) - 1:
            raise ValueError(
                f"{file}, line {row}: must have {len(names)} fields like the header, "
                f"got {line.count(',') + 1}."
            )
    return _Table(file, rows, header + 2, used, [names[i] for i in used])


def _log(file: str, lines: list[str], start: int, columns: _Columns) -> _Table:
    """Turn a log of JSON lines into a table of the keys that are used."""
    rows, names = [], []
    for number, line in enumerate(lines[start:], start + 1):
        where = f"{file}, line {number}"
        try:
            leaves = dict(_leaves(json.loads(line)))
        except (ValueError, RecursionError):  # not JSON, or nested without end
            message = f"{where}: must be a JSON object, got {_shown(line)}."
            raise ValueError(message) from None
        if not rows:
            keys = [key for key in leaves if not columns or key in columns]
            names = [keys[i] for i in _used(keys, where)]
        for name in names:
            if name not in leaves:
                raise ValueError(f"{where}, column {name}: is missing.")
        rows.append(",".join([repr(leaves[name]) for name in names]))
    return _Table(file, rows, start + 1, list(range(len(names))), names)


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield values in nested objects by dotted keys; a quaternion's list is `xyzw`."""
    if isinstance(value, list):
        is_xyzw = len(value) == 4 and _XYZW.fullmatch(_plain(path))
        keys = "xyzw" if is_xyzw else map(str, range(len(value)))
        value = dict(zip(keys, value, strict=True))
    if not isinstance(value, dict):
        yield " ".join(path.split()), value
    else:
        for key, item in value.items():
            yield from _leaves(item, f"{path}.{key}" if path else key)


def _used(names: Sequence[str], where: str) -> list[int]:
    """Find the columns of time and orientation (`wxyz`, or pitch, yaw, roll)."""
    times = [i for i, name in enumerate(names) if _unit_in(name) is not None]
    groups: dict[tuple[str, ...], dict[str, list[int]]] = {}
    for i, name in enumerate(names):
        for parts, pattern in _ORIENTATIONS.items():
            if match := re.fullmatch(pattern, _plain(name)):
                group = groups.setdefault((match[1].rstrip("_"), *parts), {})
                part = next(part for part in parts if part.endswith(match[2]))
                group.setdefault(part, []).append(i)
    # What lacks a part is something else, such as a position's x, y and z.
    full = [group for group in groups if len(groups[group]) == len(group) - 1]
    whole = [[groups[group][part] for part in group[1:]] for group in full]
    header = f"the header is {_shown(','.join(names))}"
    if not times or not whole:
        nearest = max(groups, key=lambda group: len(groups[group]), default=("", "qw"))
        lacks = [part for part in nearest[1:] if part not in groups.get(nearest, ())]
        column = lacks[0] if times else "t_s"
        raise ValueError(f"{where}, column {column}: is missing; {header}.")
    for rivals in (times, *whole[0], [group[0][0] for group in whole]):
        one, other = names[rivals[0]], names[rivals[-1]]
        if one == other and len(rivals) > 1:
            raise ValueError(f"{where}, column {one}: appears twice; {header}.")
        if one != other:
            both = f"columns {one} and {other}: either could be meant"
            raise ValueError(f"{where}, {both}; choose by the option columns.")
    return [times[0], *(part[0] for part in whole[0])]


def _plain(name: str) -> str:
    """Lower case, with one `_` between words, whatever stood there."""
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name.replace("µ", "u"))
    return re.sub(r"[^a-z0-9]+", "_", words.lower()).strip("_")


def _unit_in(name: str) -> str | None:
    """Read the unit in a time column's name, "" if it has none; None for others."""
    plain = _plain(name.rpartition(".")[2])
    word, _, last = plain.rpartition("_")
    for unit, (_, names) in _UNITS.items():
        if last in names and (not word or word in _TIMES):
            return unit
    return "" if plain in _TIMES else None


def _with_commas(lines: list[str], start: int, columns: _Columns) -> list[str]:
    """Put commas between fields, points into numbers, and take quotes off."""
    lines = [_unquoted(line) if '"' in line else line for line in lines]
    signs = [sign for sign in ";\t," if sign in lines[start]]
    if columns:  # numbers may hold decimal commas, so their count decides
        fit = lambda sign: len(lines[start].split(sign)) == len(columns)
        signs = [*filter(fit, [*signs, None]), *signs]
    separator = signs[0] if signs else None
    if separator == ",":
        return lines
    return [",".join(line.replace(",", ".").split(separator)) for line in lines]


def _unquoted(line: str) -> str:
    """Take the quotes off, and make what they protect neither separator nor comma."""
    plain = lambda match: re.sub(r"[;\s]", "_", match[1].strip()).replace(",", ".")
    return re.sub(r'"([^"]*)"', plain, line)


def _numbers(table: _Table) -> Float64[np.ndarray, "rows used"]:
    """Parse the used columns in one go; hunt for the field only when that fails."""
    if not table.lines:
        return np.empty((0, len(table.used)))
    options = {"delimiter": ",", "usecols": table.used, "comments": None, "ndmin": 2}
    try:
        numbers = np.loadtxt(table.lines, **options)
        if np.isfinite(numbers).all():
            return numbers
    except ValueError:
        pass
    for row, column in np.ndindex(len(table.lines), len(table.used)):
        field = table.field(row, column)
        if not _is_finite(field):
            where = table.where(row, column)
            raise ValueError(f"{where}: must be a finite number, got {_shown(field)}.")
    raise ValueError(f"{table.file}: has a field that is not a finite number.")


def _seconds(table: _Table, times: _Times, unit: str | None) -> _Times:
    """Convert times to s; their steps keep all digits that the file has."""
    if len(times) < 2:
        return times
    if unit != "s" and np.max(np.abs(times)) > 2**53:  # float64 skips whole numbers
        stamps = [Decimal(table.field(row, 0)) for row in range(len(times))]
        times = np.array([float(stamp - stamps[0]) for stamp in stamps])
    with np.errstate(over="ignore"):
        steps, elapsed = np.diff(times), times - times[0]
    for row in (np.flatnonzero(~(steps > 0))[:1] + 1).tolist():
        raise ValueError(
            f"{table.where(row, 0)}: times must rise, got {table.field(row, 0)} after "
            f"{table.field(row - 1, 0)}{'' if steps[row - 1] else ' (a duplicate)'}."
        )
    low, high = _STEP_RANGE_S
    median = float(np.median(steps))
    fits = [name for name, (n, _) in _UNITS.items() if low * n <= median <= high * n]
    if not unit and not fits:
        raise ValueError(
            f"{table.where(0, 0)}: the median step {median:g} does not tell the unit; "
            f"name it with the option time_unit ({', '.join(_UNITS)})."
        )
    return times if (unit or fits[0]) == "s" else elapsed / _UNITS[unit or fits[0]][0]


def _from_euler_deg(angles_deg: Float64[np.ndarray, "rows 3"]) -> _Quaternions:
    """Multiply `q_yaw q_pitch q_roll`, from pitch, yaw and roll."""
    half = np.radians(angles_deg) / 2
    (cx, cy, cz), (sx, sy, sz) = np.cos(half).T, np.sin(half).T
    w, x = cy * cx * cz + sy * sx * sz, cy * sx * cz + sy * cx * sz
    y, z = sy * cx * cz - cy * sx * sz, cy * cx * sz - sy * sx * cz
    return np.stack([w, x, y, z], axis=1)


def _is_finite(field: str) -> bool:
    try:  # Python alone reads `1_000` and digits of other scripts as numbers.
        return "_" not in field and field.isascii() and math.isfinite(float(field))
    except ValueError:
        return False


def _shown(text: str) -> str:
    return repr(text if len(text) <= 60 else text[:57] + "...")
