"""The clock behind a trace's times: frames, lost ones, rate, and poses in between."""

import itertools

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial.transform import Rotation, Slerp

from .. import _checks

_Times = Float64[np.ndarray, " rows"]
_Frames = Int64[np.ndarray, " rows"]

RATES_HZ = (5.0, 2000.0)
"""What a log of poses may have: other rates are times in another unit."""

MAX_ROWS = 10**8  # 4 GB: a wrong rate must not eat the machine

# Steps of clocks that no display has: two decimals; Windows' tick, also rounded to ms.
_TICKS_S = (0.01, 0.015, 0.0156, 1 / 64, 0.016)

# An arc still bridges two lost frames (33 ms at 90 Hz). In more, a head's tremor turns
# around and the arc would invent stillness. The half is for times that jitter.
GAP_FRAMES = 3.5
# Rounding moves the times of a clock by a frame at most, in all its rows together; a
# lost frame moves all later rows for good. Fewer long steps than that tell neither, and
# more make them the median.
_LEAST_UNEVEN, _MOST_MEAN_FRAMES, _MOST_OFF_FRAMES, _LEAST_ROWS = 3, 1.6, 1.1, 512


def gaps(t_s: _Times, frame_s: float) -> Bool[np.ndarray, " _"]:
    """Which steps hide more than two lost frames."""
    return np.diff(t_s) > GAP_FRAMES * frame_s


def parts(t_s: _Times, frame_s: float) -> list[tuple[int, int]]:
    """First row, and the row after the last, of each piece between gaps."""
    edges = [0, *(np.flatnonzero(gaps(t_s, frame_s)) + 1).tolist(), len(t_s)]
    return list(itertools.pairwise(edges))


def _is_rounded(t_s: _Times, frame_s: float) -> bool:
    """Whether uneven steps are those of rounded times, with no frame lost.

    So if all rows lie within a step of `frame_s` of a clock that counts them.
    """
    uneven = np.count_nonzero(np.rint(np.diff(t_s) / frame_s) != 1)
    mean_s = (t_s[-1] - t_s[0]) / max(len(t_s) - 1, 1)
    is_tick = np.isclose(frame_s, _TICKS_S, rtol=1e-4, atol=0).any()
    if not is_tick and len(t_s) < _LEAST_ROWS:  # a few lost frames may be as regular
        return False
    # The line through a few long steps, as of a short clip, strays by up to 0.4 frames.
    least, most = (1, 1.4) if is_tick else (_LEAST_UNEVEN, _MOST_OFF_FRAMES)
    if uneven < least or mean_s > _MOST_MEAN_FRAMES * frame_s:
        return False
    rows = np.arange(len(t_s)) - (len(t_s) - 1) / 2
    elapsed = t_s - np.mean(t_s)
    off = elapsed - rows * (np.sum(rows * elapsed) / np.sum(rows**2))
    return bool(np.ptp(off) <= most * frame_s)


def _rounded(t_s: _Times, frame_s: float) -> list[tuple[int, int]]:
    """Find stretches whose times are rounded, by their first and last rows.

    They are parts, or of a part that lost frames halves and so on, down to 512 rows.
    """
    stretches, rounded = parts(t_s, frame_s), []
    while stretches:
        start, end = stretches.pop()
        if _is_rounded(t_s[start:end], frame_s):
            rounded.append((start, end - 1))
        elif end - start >= 2 * _LEAST_ROWS:
            middle = (start + end) // 2
            stretches += [(start, middle + 1), (middle, end)]
    return rounded


def rounded_frame_s(t_s: _Times, frame_s: float) -> float | None:
    """Mean step, s, where times are rounded and no frame is lost; None if nowhere."""
    if not (rounded := _rounded(t_s, frame_s)):
        return None
    starts, ends = np.array(rounded).T
    return float(np.sum(t_s[ends] - t_s[starts]) / np.sum(ends - starts))


def frame_numbers(t_s: _Times, frame_s: float) -> _Frames:
    """Frame of each row, from 0 and rising, see `Trace.frame_numbers`."""
    steps = np.diff(t_s) / frame_s
    mean_s = rounded_frame_s(t_s, frame_s)
    if mean_s is not None:  # right in the long run, to a frame
        steps = np.diff(np.rint((t_s - t_s[0]) / mean_s))
    frames = np.minimum(np.rint(steps), MAX_ROWS).astype(np.int64)
    for start, end in _rounded(t_s, frame_s):
        frames[start:end] = 1
    rows = np.arange(len(t_s))
    ahead = np.append(0, np.cumsum(frames)) - rows
    numbers = rows + np.minimum.accumulate(ahead[::-1])[::-1]
    return numbers - numbers[0]


def even_times(t_s: _Times, frame_s: float) -> _Times:
    """Return times of frames where the rows' times are rounded, else these times."""
    mean_s = rounded_frame_s(t_s, frame_s)
    return t_s if mean_s is None else t_s[0] + mean_s * frame_numbers(t_s, frame_s)


def poses_at(
    times_s: Float64[np.ndarray, " times"],
    t_s: _Times,
    poses: Float64[np.ndarray, "rows components"],
) -> Float64[np.ndarray, "times components"]:
    """Poses at times within a trace: on the shorter arcs, positions on straight lines.

    **Arguments:** `poses`: `(rows, 4)`, or `(rows, 7)` with positions.
    """
    heads = Rotation.from_quat(poses[:, :4], scalar_first=True)
    turns = Slerp(t_s - t_s[0], heads)(times_s - t_s[0]).as_quat(scalar_first=True)
    place = [np.interp(times_s, t_s, axis) for axis in poses[:, 4:].T]
    return np.column_stack([turns, *place])


def mean_square_speed(
    t_s: _Times, world_from_head: Float64[np.ndarray, "rows 4"], window_s: float
) -> Float64[np.ndarray, " rows"]:
    """Mean square angular speed in a window around each row, (rad/s)^2."""
    heads = Rotation.from_quat(world_from_head, scalar_first=True)
    angle = (heads[:-1].inv() * heads[1:]).magnitude()
    # The integral of the squared speed, which is constant from row to row.
    integral = np.append(0.0, np.cumsum(angle**2 / np.diff(t_s)))
    low = np.maximum(t_s - window_s / 2, t_s[0])
    high = np.minimum(t_s + window_s / 2, t_s[-1])
    until = lambda times_s: np.interp(times_s, t_s, integral)
    return (until(high) - until(low)) / (high - low)


def rate_hz(name: str, t_s: _Times, frame_s: float) -> float:
    """Frames per second between gaps, Hz; `ValueError` outside 5 to 2,000 Hz."""
    inside, frames = ~gaps(t_s, frame_s), np.diff(frame_numbers(t_s, frame_s))
    rate = float(np.sum(frames[inside]) / np.sum(np.diff(t_s)[inside]))
    low, high = RATES_HZ
    if not low <= rate <= high:
        raise ValueError(
            f"{name}: frame rate must lie in [{low:g}, {high:g}] Hz, got "
            f"{_checks.apart(rate, low, high)} Hz; name the unit of "
            "its times by the option time_unit (--time-unit)."
        )
    return rate
