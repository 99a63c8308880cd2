"""Files of head traces: tables (CSV and its kin), and pose logs in JSON.

What a file calls its columns, what separates them and which unit its times have is
detected. What could mean two things is refused, naming the option that decides it.
"""

import bisect
import math
import os
import re
from collections import Counter
from decimal import Decimal
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from .. import _checks
from .._files import written_atomically
from . import trace_log, trace_table
from .trace_clock import RATES_HZ
from .trace_columns import UNITS, parts_of_metre, plain, shown, unit_in
from .trace_table import Columns, DamagedError, Table, is_finite

COLUMNS = ("t_s", "qw", "qx", "qy", "qz", "x_m", "y_m", "z_m")
_MAX_LENGTH_ERROR = 0.01  # files carry few decimals, but more than two
_MOST_DAMAGED = 0.1  # of all rows: more is another format, not damage
_COMMENT = "comments or blank lines"
_Times = Float64[np.ndarray, " rows"]
_Quaternions = Float64[np.ndarray, "rows 4"]
_Poses = Float64[np.ndarray, "rows components"]  # positions, m, behind the quaternions


def read(
    path: Path,
    columns: Columns = None,
    time_unit: str | None = None,
    axes: str = "openxr",
    *,
    skip_damaged: bool = False,
) -> tuple[_Times, _Poses, list[str]]:
    """Read a table or a pose log; arguments and errors are those of `Trace.read`.

    **Returns:** times, s; `world_from_head`, `wxyz`, lengths as in the file, and where
    the file has it the position, m; and sentences on what was assumed or left out.
    """
    _checks.one_of("axes", axes, ("openxr", "unity"))
    if time_unit is not None:
        _checks.one_of("time_unit", time_unit, UNITS)
    lines, start = _lines(path)
    is_log = re.match(r"\s*(\{|\[\s*([{\[\]]|$))", lines[start])
    table = (trace_log if is_log else trace_table).parsed(
        path.name, lines, start, columns
    )
    rows, left_out, first = len(table.lines), Counter(), ""
    while True:
        try:
            t_s, poses, notes = _parsed(table, time_unit)
            break
        except DamagedError as damaged:
            if not skip_damaged:
                raise ValueError(str(damaged)) from None
            left_out[damaged.kind] += len(damaged.rows)
            table = table.without(damaged.rows)
            if damaged.kind != _COMMENT:
                first = first or "; the first: " + str(damaged)
    if left_out:
        notes.append(_count(path.name, left_out, rows) + first)
    if axes == "unity":  # mirrored in z: turns about x and y change their sense
        poses = poses * np.array([1.0, -1, -1, 1, 1, 1, -1])[: poses.shape[1]]
    return t_s, poses, [f"{path.name}: {note.rstrip('.')}." for note in notes]


def write(path: str | os.PathLike[str], t_s: _Times, poses: _Poses) -> None:
    """Write a table that `read` turns into the same numbers."""
    rows = np.column_stack([t_s, poses]).tolist()
    lines = [
        ",".join(COLUMNS[: len(rows[0])]),
        *(",".join(map(repr, row)) for row in rows),
        "",
    ]
    with written_atomically(path) as unfinished:
        unfinished.write_text("\n".join(lines), encoding="utf-8", newline="\n")


def _count(file: str, left_out: Counter[str], rows: int) -> str:
    """Say what was left out, or raise where that is more than damage."""
    kinds = ", ".join(f"{kind} ({count})" for kind, count in left_out.items())
    damaged, rows = left_out.total() - left_out[_COMMENT], rows - left_out[_COMMENT]
    if damaged > _MOST_DAMAGED * rows:
        raise ValueError(
            f"{file}: at most {_MOST_DAMAGED:.0%} of its rows may be damaged to be "
            f"skipped, got {damaged} of {rows}: {kinds}."
        )
    return f"left out as damaged, of {rows} rows: {kinds}"


def _parsed(table: Table, time_unit: str | None) -> tuple[_Times, _Poses, list[str]]:
    """Turn rows into numbers; `DamagedError` for those that do not allow it."""
    if table.broken:
        is_comment = lambda row: re.match(r"\s*(#|$)", table.lines[row])
        comments = {r: m for r, m in table.broken.items() if is_comment(r)}
        kind = _COMMENT if comments else "cut or of other lengths than the header"
        raise DamagedError(comments or table.broken, kind)
    numbers = _numbers(table)
    t_s, unit = _seconds(table, numbers[:, 0], time_unit or unit_in(table.names[0]))
    notes = [f"times are taken as {unit}"] if unit else []
    is_euler = numbers.shape[1] in (4, 7)
    turns, place = np.split(numbers[:, 1:], [3 if is_euler else 4], axis=1)
    names = table.names[1 : turns.shape[1] + 1]
    if is_euler:
        unit = re.search("_(deg|rad)[a-z]*$", plain(names[0]))
        if not unit and len(numbers) and np.max(np.abs(turns)) <= math.pi:
            notes.append(
                f"{', '.join(names)} are taken as degrees; "
                "of radians, names end in _rad"
            )
        is_rad = unit is not None and unit[1] == "rad"
        turns = _from_euler(turns if is_rad else np.radians(turns))
    if place.shape[1]:
        parts, (x, y, z) = parts_of_metre(table.names[-1]), table.names[-3:]
        place = place / (parts or 1)
        if parts is None:
            notes.append(f"{x}, {y}, {z} are taken as the eye's position in m")
    off = {
        row: f"{table.file}, {table.places[row]}, columns {','.join(names)}: {rule}"
        for row, rule in _wrong_lengths(turns).items()
    }
    if off:
        raise DamagedError(off, "lengths other than 1")
    return t_s, np.concatenate([turns, place], axis=1), notes


def _wrong_lengths(quaternions: _Quaternions) -> dict[int, str]:
    """Rows of other lengths than 1 within 1 %, and what is wrong with each."""
    with np.errstate(over="ignore"):
        length = np.linalg.norm(quaternions, axis=1)
    return {
        row: "length must lie within 1 % of 1, got "
        f"{_checks.apart(length[row], 1 - _MAX_LENGTH_ERROR, 1 + _MAX_LENGTH_ERROR)}."
        for row in np.flatnonzero(~(np.abs(length - 1) <= _MAX_LENGTH_ERROR)).tolist()
    }


def check(name: str, t_s: _Times, poses: _Poses) -> None:
    """Raise unless rows are numbers, times rise and quaternions have length 1."""
    if len(t_s) < 2:
        raise ValueError(f"{name}: must have at least 2 rows, got {len(t_s)}.")
    numbers = np.column_stack([t_s, poses])
    for row, column in np.argwhere(~(np.abs(numbers) < 1e100))[:1]:
        raise ValueError(
            f"{name}, row {row + 1}, column {COLUMNS[column]}: must be a number below "
            f"1e100, got {numbers[row, column]}."
        )
    for row in np.flatnonzero(~(t_s[1:] > t_s[:-1]))[:1] + 1:
        raise ValueError(
            f"{name}, row {row + 1}, column t_s: times must rise, got {t_s[row]} after "
            f"{t_s[row - 1]}."
        )
    for row, rule in _wrong_lengths(poses[:, :4]).items():
        raise ValueError(f"{name}, row {row + 1}, columns qw,qx,qy,qz: {rule}")


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


def _numbers(table: Table) -> Float64[np.ndarray, "rows used"]:
    """Parse the used columns in one go; hunt for the fields only when that fails."""
    if not table.lines:
        return np.empty((0, len(table.used)))
    options = {"delimiter": ",", "usecols": table.used, "comments": None, "ndmin": 2}
    try:
        numbers = np.loadtxt(table.lines, **options)
        if np.isfinite(numbers).all():
            return numbers
    except ValueError:
        pass
    wrong = {}
    for row, column in np.ndindex(len(table.lines), len(table.used)):
        field = table.field(row, column)
        if not is_finite(field):
            rule = f"must be a finite number, got {shown(field)}."
            wrong.setdefault(row, f"{table.where(row, column)}: {rule}")
    if wrong:
        raise DamagedError(wrong, "not numbers")
    raise ValueError(f"{table.file}: has a field that is not a finite number.")


def _seconds(table: Table, times: _Times, unit: str | None) -> tuple[_Times, str]:
    """Convert times to s; their steps keep all digits that the file has.

    **Returns:** the unit, too, where the steps told it, and not a name.
    """
    if len(times) < 2:
        return times, ""
    if unit != "s" and np.max(np.abs(times)) > 2**53:  # float64 skips whole numbers
        stamps = [Decimal(table.field(row, 0)) for row in range(len(times))]
        times = np.array([float(stamp - stamps[0]) for stamp in stamps])
    if not np.all(times[1:] > times[:-1]):
        raise DamagedError(_not_rising(table, times), "times that do not rise")
    with np.errstate(over="ignore"):
        steps, elapsed = np.diff(times), times - times[0]
    low, high = (1 / rate for rate in reversed(RATES_HZ))
    median = float(np.median(steps))
    fits = [name for name, (n, _) in UNITS.items() if low * n <= median <= high * n]
    if not unit and not fits:
        raise ValueError(
            f"{table.where(0, 0)}: the median step {median:g} does not tell the unit; "
            f"name it with the option time_unit, --time-unit ({', '.join(UNITS)})."
        )
    found = unit or fits[0]
    in_s = times if found == "s" else elapsed / UNITS[found][0]
    return in_s, "" if unit or found == "s" else found


def _not_rising(table: Table, times: _Times) -> dict[int, str]:
    """Fewest rows, and of such the last ones, without which times rise; what is wrong.

    One row far too late is then wrong, and not all those behind it.
    """
    # From the last row back: of the rising runs of each length, the latest start; and
    # of each row the length of the longest run that starts with it.
    starts, lengths = [], []
    for time in (-times[::-1]).tolist():
        place = bisect.bisect_left(starts, time)
        starts[place : place + 1] = [time]
        lengths.append(place + 1)
    wrong, left, latest = {}, len(starts), -math.inf
    for row, length in enumerate(reversed(lengths)):
        if length == left and times[row] > latest:
            left, latest = left - 1, times[row]
            continue
        is_early = times[row] <= latest
        beside = table.field(row - 1 if is_early else row + 1, 0)
        wrong[row] = (
            f"{table.where(row, 0)}: times must rise, got {table.field(row, 0)} "
            f"{'after' if is_early else 'before'} {beside}"
            f"{' (a duplicate)' if is_early and times[row] == times[row - 1] else ''}."
        )
    return wrong


def _from_euler(angles: Float64[np.ndarray, "rows 3"]) -> _Quaternions:
    """Multiply `q_yaw q_pitch q_roll`, from pitch, yaw and roll, rad."""
    half = angles / 2
    (cx, cy, cz), (sx, sy, sz) = np.cos(half).T, np.sin(half).T
    w, x = cy * cx * cz + sy * sx * sz, cy * sx * cz + sy * cx * sz
    y, z = sy * cx * cz - cy * sx * sz, cy * cx * sz - sy * sx * cz
    return np.stack([w, x, y, z], axis=1)
