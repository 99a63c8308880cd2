"""Which pose each frame was rendered with, and whether these poses fit."""

from collections.abc import Iterator

import numpy as np

from ..head_motion import Trace
from ..head_motion.trace_clock import gaps, poses_at
from ..simulation.pose_fit import INVERTED, WITHOUT, PoseFit
from .frame_files import FrameFiles

_TIMES = {1: (5e-4, 0.2), 10**6: (500, 2e5), 10**9: (5e5, 2e8)}
"""Steps between frames whose numbers are times, by the parts of a second they count."""
_MOST_BEYOND = 0.51  # frames behind the last row: half of one, of rounded times
_CAUSES = {
    INVERTED: "inverted quaternions: they must be world from head",
    "axes": "the other axes: --axes {other}",
    "xyzw read as wxyz": "another order of the columns, x, y, z, w: --columns",
    "wxyz read as xyzw": "another order of the columns, w, x, y, z: --columns",
    "one frame late": "poses that are one frame late",
    "one frame early": "poses that are one frame early",
}


def aligned(
    trace: Trace,
    frames: FrameFiles,
    first_row: int | None = None,
    refresh_hz: float | None = None,
    *,
    lacks_rows: bool = False,
) -> Trace:
    """Return a pose per frame.

    - From `first_row` on, from 1: row by row, or by time where frames are named by
      times, `refresh_hz` is not the log's rate within 2 %, or the log lacks rows, which
      do not count then.
    - By time, if frames are named by times within the log: s, us or ns, 0.5 ms to 0.2 s
      apart. Logs in other units than s count from their first row. Of as many rows as
      frames each must lie within half a frame of its frame.
    - Row by row, if there are as many rows as frames, or as many as numbers from the
      first frame's to the last one's.

    Where it is by time, the result's remarks say so.

    **Errors:** `ValueError` if none of these says which pose is whose, or the log does
    not reach so far.
    """
    count, rows, places = len(frames.files), len(trace.t_s), frames.places
    times = np.array(frames.numbers, float)
    step = np.median(np.diff(times))
    units = [unit for unit, (low, high) in _TIMES.items() if low <= step <= high]
    times, is_timed, half_s = times / (units or [1])[0], bool(units), trace.frame_s / 2
    if first_row is not None:
        if not 1 <= first_row <= rows:
            raise ValueError(f"first_row must lie in [1, {rows}], got {first_row}.")
        start, row = first_row - 1, np.array(places or range(count))
        if is_timed:
            return _at(trace, trace.t_s[start] + times - times[0])
        rate_hz = refresh_hz or trace.rate_hz
        if lacks_rows or abs(rate_hz / trace.rate_hz - 1) > 0.02:
            return _at(trace, trace.t_s[start] + row / rate_hz)
        row = start + row
    elif rows == count and not (is_timed and np.allclose(times, trace.t_s, 0, half_s)):
        row = np.arange(count)
    elif is_timed and np.allclose(times, _within(trace, times), 0, half_s):
        return _at(trace, times)
    elif places and rows == places[-1] + 1:
        row = np.array(places)
    else:
        raise ValueError(
            f"{trace.name}: must have one row per frame: {count} frames in "
            f"{frames.folder}, {rows} rows. Of a longer log name the first frame's row "
            "by first_row (--first-row), or name frames by its times in s."
        )
    if row[-1] >= rows:
        raise ValueError(
            f"{trace.name}: must reach the last frame's row, {row[-1] + 1}, has {rows}."
        )
    return Trace(trace.t_s[row], trace.poses[row], name=trace.name)


def _at(trace: Trace, times: np.ndarray) -> Trace:
    """Poses at times within a log, on the shorter arcs; none across a gap."""
    if times[-1] > trace.t_s[-1] + _MOST_BEYOND * trace.frame_s:
        raise ValueError(
            f"{trace.name}: must reach the last frame, at {times[-1]:.6f} s, ends at "
            f"{trace.t_s[-1]:.6f} s."
        )
    inside = _within(trace, times)
    after = np.clip(np.searchsorted(trace.t_s, inside), 1, len(trace.t_s) - 1)
    steps = np.diff(trace.t_s)[after - 1]
    is_gap = gaps(trace.t_s, trace.frame_s)[after - 1]
    for frame in np.flatnonzero(is_gap)[:1]:
        raise ValueError(
            f"{trace.name}: must have poses around each frame, got a gap of "
            f"{steps[frame]:.4g} s at {times[frame]:.6f} s."
        )
    poses = poses_at(inside, trace.t_s, trace.poses)
    remark = (
        f"Poses of the frames' times, {times[0]:.6f} to {times[-1]:.6f} s in "
        f"{trace.name}."
    )
    return Trace(times, poses, name=trace.name, remarks=[remark])


def _within(trace: Trace, times: np.ndarray) -> np.ndarray:
    """Take a log's ends for times beyond these."""
    return np.clip(times, trace.t_s[0], trace.t_s[-1])


def said(fit: PoseFit, axes: str) -> Iterator[str]:
    """Say how far the poses bring each frame onto the one before, and what is wrong."""
    yield (
        "Frame to frame, RMS of smoothed luma: "
        f"{fit.error(WITHOUT):.3f} code values without reprojection, {fit.error():.3f} "
        f"reprojected by these poses, {fit.error(INVERTED):.3f} by inverted ones."
    )
    if not fit.tells:
        yield "Head or picture move too little to tell whether these poses fit."
        return
    if (causes := fit.likely_causes()) is None:
        return
    other = "openxr" if axes == "unity" else "unity"
    named = [_CAUSES.get(name, f"--fov: {name}").format(other=other) for name in causes]
    likely = f"likely {'; or '.join(named)}"
    if not named:
        likely = "they may be another clip's, or --axes, --columns or --fov is wrong"
    yield (
        "Warning: these poses do not fit the frames, so the numbers below mislead: "
        f"{likely}."
    )
