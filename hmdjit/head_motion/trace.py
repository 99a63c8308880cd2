"""Recorded head traces: read and write them, resample them, cut them into sessions.

Traces are float64 NumPy: rounding belongs after re-basing to the first pose.
"""

import itertools
import os
from collections.abc import Sequence
from pathlib import Path

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial.transform import Rotation, Slerp

from .. import _checks
from .._files import written_atomically
from . import trace_formats

_COLUMNS = ("t_s", "qw", "qx", "qy", "qz")
_MAX_ROWS = 10**8  # 4 GB: a wrong rate must not eat the machine

# An arc still bridges two lost frames (33 ms at 90 Hz). In more, a head's tremor turns
# around and the arc would invent stillness. The half is for times that jitter.
_GAP_FRAMES = 3.5
_STILL_WINDOW_S = 0.5
_ROUNDING = 1e-6  # of a count or a duration, s, made of rounded times

_Times = Float64[np.ndarray, " rows"]
_Orientations = Float64[np.ndarray, "rows 4"]


class Trace(eqx.Module):
    """One person's recorded head rotation.

    - `t_s`: times, s, rising; shape `(rows,)`, at least 2 rows.
    - `world_from_head`: unit quaternions `wxyz`, shape `(rows, 4)`. Lengths within 1 %
      of 1 are normalised, and of `q` and `-q` the one nearer to the former row is kept.
    - `subject`: who wore the headset: the cluster of intervals over traces.
    - `name`: what messages call this trace.
    - `frame_s`: median time step, s, of the whole that this trace was cut from. A step
      above 3.5 of it is a *gap*: one or two lost frames are bridged, more never.

    **Errors:** `ValueError` naming the row (from 1), the rule and the value.
    """

    t_s: _Times
    world_from_head: _Orientations
    subject: str = eqx.field(static=True)
    name: str = eqx.field(static=True)
    frame_s: float

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
        _check_numbers(name, t_s, world_from_head)
        where = lambda row: f"{name}, row {row + 1}"
        trace_formats.check_lengths(where, "qw,qx,qy,qz", world_from_head)
        world_from_head /= np.linalg.norm(world_from_head, axis=1, keepdims=True)
        flips = np.sum(world_from_head[1:] * world_from_head[:-1], axis=1) < 0
        world_from_head[1:] *= np.cumprod(np.where(flips, -1.0, 1.0))[:, None]
        t_s.setflags(write=False)
        world_from_head.setflags(write=False)
        self.t_s, self.world_from_head = t_s, world_from_head
        self.subject, self.name = subject, name
        self.frame_s = float(np.median(np.diff(t_s)))

    @classmethod
    def read(
        cls,
        path: str | os.PathLike[str],
        *,
        subject: str | None = None,
        columns: Sequence[str] | None = None,
        time_unit: str | None = None,
        axes: str = "openxr",
    ) -> "Trace":
        """Read a table with a header, or a log of poses as JSON lines.

        Tables have commas, semicolons, tabs or blanks between fields, and decimal
        points or commas. Columns in any order and case; others are skipped:

        - time: `t`, `time`, `timestamp`, ... alone or with its unit (`t_s`, `time_ms`);
          s are kept as recorded, other units count from the first row;
        - `qw`, `qx`, `qy`, `qz`; or `w`, ...; `rot_w`, ...; `orientation.w`, ...;
        - or `pitch`, `yaw`, `roll`: degrees about x, y, z, for `q_yaw q_pitch q_roll`.

        Logs have such keys, nested or not; a list is `[x, y, z, w]`.

        **Arguments:**

        - `path`: file in UTF-8; comments (`#`) before the header are skipped.
        - `subject`: who wore the headset; by default the first two parts of the file's
          name (`crom_p04_t014_still.csv` is of `crom_p04`).
        - `columns`: such names for all columns of a table in their order, `-` for
          others, in place of its header, if any; of a log, the dotted keys to use.
        - `time_unit`: `s`, `ms`, `us` or `ns`; by default the one that the column
          names, else the one that makes the median step one of 5 to 2000 Hz.
        - `axes`: `openxr` (x right, y up, z back; WebXR too) or `unity` (left-handed,
          z forward).

        **Errors:** `ValueError`, one line: file, line (from 1), column, rule, value.
        """
        path = Path(path)
        subject = subject or "_".join(path.stem.split("_")[:2])
        rows = trace_formats.read(path, columns, time_unit, axes)
        return cls(*rows, subject=subject, name=path.name)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write a trace file that `read` turns into the same numbers."""
        rows = np.column_stack([self.t_s, self.world_from_head]).tolist()
        lines = [",".join(_COLUMNS), *(",".join(map(repr, row)) for row in rows), ""]
        with written_atomically(path) as unfinished:
            unfinished.write_text("\n".join(lines), encoding="utf-8", newline="\n")

    @property
    def duration_s(self) -> float:
        """Time from the first to the last row, s."""
        return float(self.t_s[-1] - self.t_s[0])

    @property
    def frame_numbers(self) -> Int64[np.ndarray, " rows"]:
        """Frame of each row, from 0 and rising: steps rounded to frames, summed.

        A row so late that the next one has its number takes the number before.
        """
        with np.errstate(over="ignore"):
            frames = np.minimum(np.rint(np.diff(self.t_s) / self.frame_s), _MAX_ROWS)
        rows = np.arange(len(self.t_s))
        ahead = np.concatenate([[0], np.cumsum(frames.astype(np.int64))]) - rows
        numbers = rows + np.minimum.accumulate(ahead[::-1])[::-1]
        return numbers - numbers[0]

    @property
    def rate_hz(self) -> float:
        """Frames per second by `frame_numbers`, Hz; gaps are left out.

        Right for lost frames, jitter, times rounded to 1 ms (60 Hz: a median of 17 ms).
        """
        inside, frames = ~self._gaps, np.diff(self.frame_numbers)
        return float(np.sum(frames[inside]) / np.sum(np.diff(self.t_s)[inside]))

    @property
    def _gaps(self) -> Bool[np.ndarray, " steps"]:
        return np.diff(self.t_s) > _GAP_FRAMES * self.frame_s

    @property
    def _rotations(self) -> Rotation:
        return Rotation.from_quat(self.world_from_head, scalar_first=True)

    def _rows(self, start: int, end: int) -> "Trace":
        leaves = lambda trace: (trace.t_s, trace.world_from_head)
        rows = tuple(leaf[start:end] for leaf in leaves(self))
        return eqx.tree_at(leaves, self, rows)

    def parts(self) -> list["Trace"]:
        """Return the pieces between gaps that have at least 2 rows, as recorded."""
        edges = [0, *(np.flatnonzero(self._gaps) + 1).tolist(), len(self.t_s)]
        return [self._rows(a, b) for a, b in itertools.pairwise(edges) if b - a > 1]

    def still_segments(
        self, max_speed_deg_s: float = 5.0, min_duration_s: float = 2.0
    ) -> list["Trace"]:
        """Find where the head is held still.

        **Arguments:**

        - `max_speed_deg_s`: limit of the angular speed, deg/s, above 0: of its root
          mean square over the 0.5 s around each row, or what the part has of them.
        - `min_duration_s`: shortest segment, s, above 0.

        **Returns:** the longest runs below the limit, none across a gap; rows and times
        as recorded.
        """
        _checks.in_range("max_speed_deg_s", max_speed_deg_s, 0, open_low=True)
        _checks.in_range("min_duration_s", min_duration_s, _ROUNDING, open_low=True)
        least_s, segments = min_duration_s - _ROUNDING, []
        for part in self.parts():
            still = part._mean_square_speed() < np.radians(max_speed_deg_s) ** 2
            edges = np.flatnonzero(np.diff(still, prepend=False, append=False))
            runs = [part._rows(*pair) for pair in edges.reshape(-1, 2).tolist()]
            segments += [run for run in runs if run.duration_s > least_s]
        return segments

    def _mean_square_speed(self) -> _Times:
        """Mean square angular speed around each row, (rad/s)^2."""
        angle = (self._rotations[:-1].inv() * self._rotations[1:]).magnitude()
        # The integral of the squared speed, which is constant from row to row.
        integral = np.append(0.0, np.cumsum(angle**2 / np.diff(self.t_s)))
        low = np.maximum(self.t_s - _STILL_WINDOW_S / 2, self.t_s[0])
        high = np.minimum(self.t_s + _STILL_WINDOW_S / 2, self.t_s[-1])
        until = lambda t_s: np.interp(t_s, self.t_s, integral)
        return (until(high) - until(low)) / (high - low)

    def resample(self, rate_hz: float) -> "Trace":
        """Read the trace at a fixed rate, from its first time to its last.

        **Arguments:** `rate_hz`: rows per second of the result, Hz, above 0.

        **Returns:** rows on the shorter arcs, also where one or two frames were lost.

        **Errors:** `ValueError` at a gap, or if `rate_hz` leaves < 2 or > 1e8 rows.
        """
        _checks.in_range("rate_hz", rate_hz, 0, open_low=True)
        for row in np.flatnonzero(self._gaps)[:1]:
            start, end = self.t_s[row : row + 2]
            raise ValueError(
                f"{self.name}: must have no gap to be resampled, got one of "
                f"{end - start:.4g} s at {start:.6g} s; resample its parts()."
            )
        # A last row that rounding put behind the trace's end still counts.
        steps = np.floor(self.duration_s * rate_hz + _ROUNDING)
        if not 1 <= steps < _MAX_ROWS:
            raise ValueError(
                f"rate_hz must leave 2 to {_MAX_ROWS:g} rows of {self.name} "
                f"({self.duration_s:g} s), got {rate_hz:g}."
            )
        elapsed_s = np.minimum(np.arange(steps + 1) / rate_hz, self.duration_s)
        along = Slerp(self.t_s - self.t_s[0], self._rotations)
        poses = along(elapsed_s).as_quat(scalar_first=True)
        t_s = self.t_s[0] + elapsed_s
        return Trace(t_s, poses, subject=self.subject, name=self.name)

    def windows(
        self, frames: int, rate_hz: float | None = None
    ) -> Float64[np.ndarray, "count {frames} 4"]:
        """Cut the trace into consecutive sessions that do not overlap.

        **Arguments:**

        - `frames`: poses of each session, at least 2.
        - `rate_hz`: resample to this rate, Hz. None replays the rows as they are; where
          frames were lost (a step above 1.5 `frame_s`), it is `self.rate_hz`.

        **Returns:** `world_from_head`, shape `(count, frames, 4)`; none holds a gap;
        rows left over at the end of a part are dropped.

        **Errors:** `ValueError` when no part is as long as a window.
        """
        _checks.whole("frames", frames, 2)
        parts = self.parts()
        longest_s = max(np.max(np.diff(part.t_s)) for part in parts)
        if rate_hz is None and longest_s > 1.5 * self.frame_s:
            rate_hz = self.rate_hz
        if rate_hz is not None:
            _checks.in_range("rate_hz", rate_hz, 0, open_low=True)
            long = [part for part in parts if part.duration_s * rate_hz > 1 - _ROUNDING]
            parts = [part.resample(rate_hz) for part in long]
        heads = [part.world_from_head for part in parts]
        longest = max(map(len, heads), default=1)
        if longest < frames:
            raise ValueError(
                f"frames must be at most the {longest} without a gap of {self.name} at "
                f"{rate_hz or self.rate_hz:.4g} Hz, got {frames}."
            )
        whole = [head[: len(head) // frames * frames] for head in heads]
        return np.concatenate([head.reshape(-1, frames, 4) for head in whole])


def _check_numbers(name: str, t_s: _Times, world_from_head: _Orientations) -> None:
    if len(t_s) < 2:
        raise ValueError(f"{name}: must have at least 2 rows, got {len(t_s)}.")
    numbers = np.column_stack([t_s, world_from_head])
    for row, column in np.argwhere(~(np.abs(numbers) < 1e100))[:1]:
        raise ValueError(
            f"{name}, row {row + 1}, column {_COLUMNS[column]}: must be a number below "
            f"1e100, got {numbers[row, column]}."
        )
    for row in np.flatnonzero(~(t_s[1:] > t_s[:-1]))[:1] + 1:
        raise ValueError(
            f"{name}, row {row + 1}, column t_s: times must rise, got {t_s[row]} after "
            f"{t_s[row - 1]}."
        )


def shared_rate_hz(traces: Sequence[Trace], advice: str = "") -> float:
    """Median frame rate of recordings, Hz; `ValueError` for none and mixed rates."""
    if not traces:
        raise ValueError("traces must name at least one recording, got none.")
    rates = [trace.rate_hz for trace in traces]
    median = float(np.median(rates))
    for trace, rate in zip(traces, rates, strict=True):
        if abs(rate / median - 1) > 0.02:
            raise ValueError(
                f"traces must share one rate within 2 %: {trace.name} has {rate:.2f} "
                f"Hz, the median is {median:.2f} Hz{advice}."
            )
    return median
