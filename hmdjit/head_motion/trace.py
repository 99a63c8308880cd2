"""Recorded head traces: read and write them, resample them, cut them into sessions.

Traces are float64 NumPy: rounding belongs after re-basing to the first pose.
"""

import os
import warnings
from collections.abc import Sequence
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float64, Int64

from .. import _checks
from . import trace_clock, trace_formats, trace_notes

_STILL_WINDOW_S = 0.5
_ROUNDING = 1e-6  # of a count or a duration, s, made of rounded times

_Times = Float64[np.ndarray, " rows"]


class Trace(eqx.Module):
    """One person's recorded head: its rotation, and where it is known its position.

    - `t_s`: times, s, rising; shape `(rows,)`, at least 2 rows.
    - `world_from_head`: unit quaternions `wxyz`, shape `(rows, 4)`. Lengths within 1 %
      of 1 are normalised, and of `q` and `-q` the one nearer to the former row is kept.
    - `position_m`: the eye's x, y and z in that world, m, `(rows, 3)`, or None.
    - `subject`: who wore the headset: the cluster of intervals over traces.
    - `name`: what messages call this trace.
    - `frame_s`: median time step, s, of the whole that this trace was cut from. A step
      above 3.5 of it is a *gap*: one or two lost frames are bridged, more never.
    - `remarks`: sentences on what was assumed or left out when its file was read.

    **Arguments:** `world_from_head`: with positions `(rows, 7)`, as `poses`.

    **Errors:** `ValueError` naming the row (from 1), the rule and the value.
    """

    t_s: _Times
    world_from_head: Float64[np.ndarray, "rows 4"]
    position_m: Float64[np.ndarray, "rows 3"] | None
    subject: str = eqx.field(static=True)
    name: str = eqx.field(static=True)
    frame_s: float
    remarks: tuple[str, ...] = eqx.field(static=True)

    def __init__(
        self,
        t_s: np.ndarray,
        world_from_head: np.ndarray,
        *,
        subject: str = "unknown",
        name: str = "trace",
        remarks: Sequence[str] = (),
    ):
        t_s = np.array(t_s, np.float64)
        poses = np.array(world_from_head, np.float64)
        if t_s.ndim != 1 or poses.shape not in ((t_s.size, 4), (t_s.size, 7)):
            raise ValueError(
                f"{name}: t_s must have shape (rows,) and world_from_head (rows, 4), "
                f"or (rows, 7) with positions, got {t_s.shape} and {poses.shape}."
            )
        trace_formats.check(name, t_s, poses)
        turns = poses[:, :4]
        turns /= np.linalg.norm(turns, axis=1, keepdims=True)
        flips = np.sum(turns[1:] * turns[:-1], axis=1) < 0
        turns[1:] *= np.cumprod(np.where(flips, -1.0, 1.0))[:, None]
        t_s.setflags(write=False)
        poses.setflags(write=False)
        self.t_s, self.world_from_head = t_s, poses[:, :4]
        self.position_m = poses[:, 4:] if poses.shape[1] == 7 else None
        self.subject, self.name, self.remarks = subject, name, tuple(remarks)
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
        skip_damaged: bool = False,
        skip_held: bool = False,
    ) -> "Trace":
        """Read a table with a header, or a log of poses in JSON.

        Tables have commas, semicolons, tabs or blanks between fields, and decimal
        points or commas. Columns in any order and case; others are skipped:

        - time: `t`, `time`, `timestamp`, ... alone or with its unit (`t_s`, `time_ms`);
          s are kept as recorded, other units count from the first row;
        - `qw`, `qx`, `qy`, `qz`; or `w`, ...; `rot_w`, ...; `orientation.w`, ...;
        - or `pitch`, `yaw`, `roll`: degrees (radians: `pitch_rad`, ...) about x, y, z,
          for `q_yaw q_pitch q_roll`;
        - where they stand beside it, the eye's `x`, `y`, `z`; or `pos_x`, ...;
          `position.x`, ...; `hmd_pos_x`, ... by `hmd_qw`: m (mm or cm: `x_mm`, ...).

        Logs are samples, one a line or in an array, with such keys, nested or not; a
        list is `[x, y, z, w]` or `[x, y, z]`. Matrices are not read.

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
        - `skip_damaged`: leave out comments, and rows that are cut, that are no numbers
          or whose time or length is wrong: at most 10 % of all; `notes` count them.
        - `skip_held`: leave out held rows, see `without_held`.

        **Errors:** `ValueError`, one line: file, line (from 1), column, rule, value.
        Warns of held poses.
        """
        path = Path(path)
        subject = subject or "_".join(path.stem.split("_")[:2])
        t_s, poses, remarks = trace_formats.read(
            path, columns, time_unit, axes, skip_damaged=skip_damaged
        )
        trace = cls(t_s, poses, subject=subject, name=path.name, remarks=remarks)
        if skip_held:
            return trace.without_held()
        if trace_notes.is_held(trace.poses):
            warnings.warn(trace.notes[-1], stacklevel=2)
        return trace

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write a trace file that `read` turns into the same numbers."""
        trace_formats.write(path, self.t_s, self.poses)

    @property
    def poses(self) -> Float64[np.ndarray, "rows components"]:
        """Rotation `wxyz`, and where it is known the position, `(rows, 4)` or 7."""
        place = [] if self.position_m is None else [self.position_m]
        return np.concatenate([self.world_from_head, *place], axis=1)

    @property
    def duration_s(self) -> float:
        """Time from the first to the last row, s."""
        return float(self.t_s[-1] - self.t_s[0])

    @property
    def frame_numbers(self) -> Int64[np.ndarray, " rows"]:
        """Frame of each row, from 0 and rising: steps rounded to frames, summed.

        A row so late that the next one has its number takes the number before; where
        times are rounded to about a frame and none is lost, rows are counted.
        """
        return trace_clock.frame_numbers(self.t_s, self.frame_s)

    @property
    def rate_hz(self) -> float:
        """Frames per second by `frame_numbers`, Hz; gaps are left out.

        Right for lost frames, for jitter, and for rounded times (60 Hz in ms: a median
        of 17; 90 Hz in hundredths of a second) while no frame is lost.

        **Errors:** `ValueError` outside 5 to 2,000 Hz, as of milliseconds taken for s.
        """
        return trace_clock.rate_hz(self.name, self.t_s, self.frame_s)

    @property
    def _gaps(self) -> Bool[np.ndarray, " steps"]:
        return trace_clock.gaps(self.t_s, self.frame_s)

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences for the user: `remarks`, rounded times, positions, held poses."""
        rows = self.t_s, self.poses
        return (*self.remarks, *trace_notes.of(self.name, *rows, self.frame_s))

    def without_held(self) -> "Trace":
        """Leave out rows that repeat the pose before them: a tracker's own rate.

        **Errors:** `ValueError` when the pose never changes.
        """
        kept = trace_notes.renewed(self.name, self.poses)
        repeats = f"{np.count_nonzero(~kept)} of {len(kept)} rows"
        return Trace(
            self.t_s[kept],
            self.poses[kept],
            subject=self.subject,
            name=self.name,
            remarks=(*self.remarks, f"{self.name}: left out {repeats} as held."),
        )

    def _rows(self, start: int, end: int) -> "Trace":
        cut = lambda leaf: leaf[start:end] if np.ndim(leaf) else leaf
        return jax.tree.map(cut, self)

    def parts(self) -> list["Trace"]:
        """Return the pieces between gaps that have at least 2 rows, as recorded."""
        parts = trace_clock.parts(self.t_s, self.frame_s)
        return [self._rows(a, b) for a, b in parts if b - a > 1]

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

        **Errors:** `ValueError` where `rate_hz` has one.
        """
        _checks.in_range("max_speed_deg_s", max_speed_deg_s, 0, open_low=True)
        _checks.in_range("min_duration_s", min_duration_s, _ROUNDING, open_low=True)
        self.rate_hz  # noqa: B018  raises for a wrong unit of time
        least_s, segments = min_duration_s - _ROUNDING, []
        for part in self.parts():
            rows = part.t_s, part.world_from_head
            square = trace_clock.mean_square_speed(*rows, _STILL_WINDOW_S)
            still = square < np.radians(max_speed_deg_s) ** 2
            edges = np.flatnonzero(np.diff(still, prepend=False, append=False))
            runs = [part._rows(*pair) for pair in edges.reshape(-1, 2).tolist()]
            segments += [run for run in runs if run.duration_s > least_s]
        return segments

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
        times_s = trace_clock.even_times(self.t_s, self.frame_s) - self.t_s[0]
        steps = np.floor(times_s[-1] * rate_hz + _ROUNDING)
        if not 1 <= steps < trace_clock.MAX_ROWS:
            raise ValueError(
                f"rate_hz must leave 2 to {trace_clock.MAX_ROWS:g} rows of {self.name} "
                f"({self.duration_s:g} s), got {rate_hz:g}."
            )
        elapsed_s = np.minimum(np.arange(steps + 1) / rate_hz, times_s[-1])
        poses = trace_clock.poses_at(elapsed_s, times_s, self.poses)
        t_s = self.t_s[0] + elapsed_s
        return Trace(t_s, poses, subject=self.subject, name=self.name)

    def windows(
        self, frames: int, rate_hz: float | None = None
    ) -> Float64[np.ndarray, "count {frames} components"]:
        """Cut the trace into consecutive sessions that do not overlap.

        **Arguments:**

        - `frames`: poses of each session, at least 2.
        - `rate_hz`: resample to this rate, Hz. None replays the rows as they are; where
          frames were lost (a step above 1.5 `frame_s`), it is `self.rate_hz`.

        **Returns:** `poses`, shape `(count, frames, 4)` or `(count, frames, 7)`; none
        holds a gap; rows left over at the end of a part are dropped.

        **Errors:** `ValueError` when no part is as long as a window.
        """
        _checks.whole("frames", frames, 2)
        parts, own_hz = self.parts(), self.rate_hz
        even = (trace_clock.even_times(part.t_s, self.frame_s) for part in parts)
        longest_s = max(np.max(np.diff(times)) for times in even)
        if rate_hz is None and longest_s > 1.5 * self.frame_s:
            rate_hz = own_hz
        if rate_hz is not None:
            _checks.in_range("rate_hz", rate_hz, 0, open_low=True)
            long = [part for part in parts if part.duration_s * rate_hz > 1 - _ROUNDING]
            parts = [part.resample(rate_hz) for part in long]
        heads = [part.poses for part in parts]
        longest = max(map(len, heads), default=1)
        if longest < frames:
            raise ValueError(
                f"frames must be at most the {longest} without a gap of {self.name} at "
                f"{rate_hz or own_hz:.4g} Hz, got {frames}."
            )
        whole = [head[: len(head) // frames * frames] for head in heads]
        return np.concatenate(
            [head.reshape(-1, frames, head.shape[1]) for head in whole]
        )
