"""Recorded head traces: read and write them, resample them, cut them into sessions.

A trace file is a CSV with the header `t_s,qw,qx,qy,qz`: seconds, and the unit
quaternion `world_from_head`, axes as OpenXR (x right, y up, z back). Traces are float64
NumPy: rounding belongs after re-basing to the first pose.
"""

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import equinox as eqx
import numpy as np
from jaxtyping import Float64

from .. import _checks

_COLUMNS = ("t_s", "qw", "qx", "qy", "qz")
_MAX_LENGTH_ERROR = 0.01  # files carry few decimals, but more than two
_MAX_ROWS = 10**8  # 4 GB: a wrong rate must not eat the machine

_Times = Float64[np.ndarray, " rows"]
_Orientations = Float64[np.ndarray, "rows 4"]


class Trace(eqx.Module):
    """One person's recorded head rotation.

    - `t_s`: times, s, rising; shape `(rows,)`, at least 2 rows.
    - `world_from_head`: unit quaternions `wxyz`, shape `(rows, 4)`. Lengths within 1 %
      of 1 are normalised, and of `q` and `-q` the one nearer to the former row is kept.
    - `subject`: who wore the headset: the cluster of intervals over traces.
    - `name`: what messages call this trace.

    **Errors:** `ValueError` naming the row (from 1), the rule and the value.
    """

    t_s: _Times
    world_from_head: _Orientations
    subject: str = eqx.field(static=True)
    name: str = eqx.field(static=True)

    def __init__(
        self,
        t_s: np.ndarray,
        world_from_head: np.ndarray,
        *,
        subject: str = "unknown",
        name: str = "trace",
    ):
        t_s = np.array(t_s, np.float64)
        world_from_head = np.array(world_from_head, np.float64)
        if t_s.ndim != 1 or world_from_head.shape != (t_s.size, 4):
            raise ValueError(
                f"{name}: t_s must have shape (rows,) and world_from_head (rows, 4), "
                f"got {t_s.shape} and {world_from_head.shape}."
            )
        _check_rows(name, t_s, world_from_head, lambda row: f"{name}, row {row + 1}")
        world_from_head /= np.linalg.norm(world_from_head, axis=1, keepdims=True)
        flips = np.sum(world_from_head[1:] * world_from_head[:-1], axis=1) < 0
        world_from_head[1:] *= np.cumprod(np.where(flips, -1.0, 1.0))[:, None]
        t_s.setflags(write=False)
        world_from_head.setflags(write=False)
        self.t_s, self.world_from_head = t_s, world_from_head
        self.subject, self.name = subject, name

    @classmethod
    def read(
        cls, path: str | os.PathLike[str], *, subject: str | None = None
    ) -> "Trace":
        """Read a trace file.

        **Arguments:**

        - `path`: CSV in UTF-8 with a header; columns `t_s`, `qw`, `qx`, `qy`, `qz` in
          any order, others are skipped; blank lines at the end too.
        - `subject`: who wore the headset; by default the first two parts of the file's
          name (`crom_p04_t014_still.csv` is of `crom_p04`).

        **Errors:** `ValueError`, one line, naming the file, and the line (from 1, the
        header) and column where it applies.
        """
        path = Path(path)
        if subject is None:
            subject = "_".join(path.stem.split("_")[:2])
        name = path.name
        lines = _lines(name, path)
        header = [column.strip() for column in lines[0].split(",")]
        for column in _COLUMNS:
            if header.count(column) != 1:
                what = "appears twice" if column in header else "is missing"
                raise ValueError(
                    f"{name}, line 1, column {column}: {what}; "
                    f"the header is {_shown(lines[0])}."
                )
        for row, line in enumerate(lines[1:]):
            if line.count(",") != len(header) - 1:
                raise ValueError(
                    f"{name}, line {row + 2}: must have {len(header)} fields like the "
                    f"header, got {line.count(',') + 1}."
                )
        used = [header.index(column) for column in _COLUMNS]
        numbers = _numbers(name, lines[1:], used)
        t_s, world_from_head = numbers[:, 0], numbers[:, 1:]
        _check_rows(name, t_s, world_from_head, lambda row: f"{name}, line {row + 2}")
        return cls(t_s, world_from_head, subject=subject, name=name)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write a trace file that `read` turns into the same numbers."""
        rows = np.column_stack([self.t_s, self.world_from_head]).tolist()
        lines = [",".join(map(repr, row)) for row in rows]
        text = "\n".join([",".join(_COLUMNS), *lines, ""])
        Path(path).write_text(text, encoding="utf-8", newline="\n")

    @property
    def duration_s(self) -> float:
        """Time from the first to the last row, s."""
        return float(self.t_s[-1] - self.t_s[0])

    @property
    def rate_hz(self) -> float:
        """Frames per second by the median time step, Hz: lost frames do not count."""
        return float(1 / np.median(np.diff(self.t_s)))

    def resample(self, rate_hz: float) -> "Trace":
        """Read the trace at a fixed rate, from its first time to its last.

        **Arguments:** `rate_hz`: rows per second of the result, Hz, above 0.

        **Returns:** rows interpolated along the shorter arc.

        **Errors:** `ValueError` when `rate_hz` leaves less than 2 or above 1e8 rows.
        """
        _checks.in_range("rate_hz", rate_hz, 0, open_low=True)
        # A last row that rounding put behind the trace's end still counts.
        steps = np.floor(self.duration_s * rate_hz + 1e-6)
        if not 1 <= steps < _MAX_ROWS:
            raise ValueError(
                f"rate_hz must leave 2 to {_MAX_ROWS:g} rows of {self.name} "
                f"({self.duration_s:g} s), got {rate_hz:g}."
            )
        elapsed_s = np.minimum(np.arange(steps + 1) / rate_hz, self.duration_s)
        recorded_s = self.t_s - self.t_s[0]
        last = np.searchsorted(recorded_s, elapsed_s, side="right") - 1
        last = np.minimum(last, len(recorded_s) - 2)
        step_s = recorded_s[last + 1] - recorded_s[last]
        fraction = (elapsed_s - recorded_s[last]) / step_s
        start, end = self.world_from_head[last], self.world_from_head[last + 1]
        return Trace(
            self.t_s[0] + elapsed_s,
            _slerp(start, end, fraction[:, None]),
            subject=self.subject,
            name=self.name,
        )

    def windows(
        self, frames: int, rate_hz: float | None = None
    ) -> Float64[np.ndarray, "count {frames} 4"]:
        """Cut the trace into consecutive sessions that do not overlap.

        **Arguments:**

        - `frames`: poses of each session, at least 2.
        - `rate_hz`: resample to this rate, Hz. None replays the rows as they are; where
          frames were lost (a time step above 1.5 median ones), it is `self.rate_hz`.

        **Returns:** `world_from_head`, shape `(count, frames, 4)`; rows left over at
        the end are dropped.

        **Errors:** `ValueError` when the trace is shorter than one window.
        """
        _checks.whole("frames", frames, 2)
        trace = self
        if rate_hz is not None:
            trace = self.resample(rate_hz)
        elif np.max(np.diff(self.t_s)) * self.rate_hz > 1.5:
            trace = self.resample(self.rate_hz)
        count = len(trace.t_s) // frames
        if count == 0:
            raise ValueError(
                f"frames must be at most the {len(trace.t_s)} of {self.name} at "
                f"{trace.rate_hz:.4g} Hz, got {frames}."
            )
        return trace.world_from_head[: count * frames].reshape(count, frames, 4)


def _check_rows(
    name: str, t_s: np.ndarray, world_from_head: np.ndarray, where: Callable[[int], str]
) -> None:
    if len(t_s) < 2:
        raise ValueError(f"{name}: must have at least 2 rows, got {len(t_s)}.")
    numbers = np.column_stack([t_s, world_from_head])
    for row, column in np.argwhere(~np.isfinite(numbers))[:1]:
        raise ValueError(
            f"{where(row)}, column {_COLUMNS[column]}: must be a finite number, "
            f"got {numbers[row, column]}."
        )
    for row in np.flatnonzero(~(t_s[1:] > t_s[:-1]))[:1] + 1:
        raise ValueError(
            f"{where(row)}, column t_s: times must rise, got {t_s[row]} after "
            f"{t_s[row - 1]}."
        )
    with np.errstate(over="ignore"):
        length = np.linalg.norm(world_from_head, axis=1)
    for row in np.flatnonzero(~(np.abs(length - 1) <= _MAX_LENGTH_ERROR))[:1]:
        raise ValueError(
            f"{where(row)}, columns qw,qx,qy,qz: length must lie within 1 % of 1, "
            f"got {length[row]:.6g}."
        )


def _lines(name: str, path: Path) -> list[str]:
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise ValueError(f"{name}: cannot be read ({error.strerror}).") from None
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{name}: must be text in UTF-8, but byte {error.start + 1} is not."
        ) from None
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    if not lines:
        raise ValueError(f"{name}: is empty.")
    return lines


def _numbers(name: str, lines: list[str], used: list[int]) -> np.ndarray:
    """Parse the used columns in one go; hunt for the field only when that fails."""
    if not lines:
        return np.empty((0, len(used)))
    try:
        numbers = np.loadtxt(lines, delimiter=",", usecols=used, comments=None, ndmin=2)
    except ValueError:
        _raise_at_bad_field(name, lines, used)
    if not np.isfinite(numbers).all():
        _raise_at_bad_field(name, lines, used)
    return numbers


def _raise_at_bad_field(name: str, lines: list[str], used: list[int]) -> NoReturn:
    for row, line in enumerate(lines):
        fields = line.split(",")
        for column, index in zip(_COLUMNS, used, strict=True):
            if not _is_finite(fields[index]):
                raise ValueError(
                    f"{name}, line {row + 2}, column {column}: must be a finite "
                    f"number, got {_shown(fields[index])}."
                )
    raise ValueError(f"{name}: has a field that is not a finite number.")


def _is_finite(field: str) -> bool:
    # Python alone reads `1_000` and digits of other scripts as numbers.
    if "_" in field or not field.isascii():
        return False
    try:
        return math.isfinite(float(field))
    except ValueError:
        return False


def _shown(text: str) -> str:
    return repr(text if len(text) <= 60 else text[:57] + "...")


def _slerp(start: np.ndarray, end: np.ndarray, fraction: np.ndarray) -> np.ndarray:
    """Rows of quaternions at most half a turn apart, `start . end >= 0`."""
    chord = np.linalg.norm(end - start, axis=1, keepdims=True)
    angle = 2 * np.arctan2(chord, np.linalg.norm(end + start, axis=1, keepdims=True))
    # sin(f a) / sin(a) by ratios to their angle, which are smooth at 0.
    ratio = lambda share: share * np.sinc(share * angle / np.pi)
    return (ratio(1 - fraction) * start + ratio(fraction) * end) / ratio(1.0)
