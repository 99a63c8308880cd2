"""What a user should be told of a trace: its times are rounded, its poses are held."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float64

from . import trace_clock

# Rounding alone repeats 2.5 % of a still head's rows: more, and of few rows an eighth.
_LEAST_HELD, _ENOUGH_HELD, _LEAST_HELD_SHARE = 3, 10, 0.05
_Times = Float64[np.ndarray, " rows"]
_Poses = Float64[np.ndarray, "rows components"]


def held(poses: _Poses) -> Bool[np.ndarray, " steps"]:
    """Which steps repeat the pose before them."""
    return np.all(poses[1:] == poses[:-1], axis=1)


def renewed(name: str, poses: _Poses) -> Bool[np.ndarray, " rows"]:
    """Which rows do not repeat the pose before them; `ValueError` if all do."""
    repeats = held(poses)
    if repeats.all():
        raise ValueError(f"{name}: poses must change to be told from held ones.")
    return np.append(True, ~repeats)


def is_held(poses: _Poses) -> bool:
    """Whether so many poses are repeated that a tracker holds them."""
    repeats = held(poses)
    count = int(np.count_nonzero(repeats))
    enough = max(_LEAST_HELD, min(_ENOUGH_HELD, len(repeats) / 8))
    least = max(enough, _LEAST_HELD_SHARE * len(repeats))
    return least <= count < len(repeats)


def of(name: str, t_s: _Times, poses: _Poses, frame_s: float) -> Iterator[str]:
    """Yield sentences, the one on held poses last."""
    mean_s = trace_clock.rounded_frame_s(t_s, frame_s)
    if mean_s is not None:
        yield (
            f"{name}: times are rounded to about a frame (steps of {1e3 * frame_s:.4g} "
            f"ms, on average {1e3 * mean_s:.4g} ms): no frame is taken for lost."
        )
    if (place := poses[:, 4:]).size:
        sides = " x ".join(f"{side:.3g}" for side in np.ptp(place, axis=0))
        yield f"{name}: has positions: the eye moves within {sides} m."
    is_repeat = held(poses)
    if is_repeat.all():
        yield f"{name}: the pose never changes."
    elif is_held(poses):
        new_s = np.diff(t_s[np.append(True, ~is_repeat)])
        rate_hz = 1 / np.mean(new_s[new_s <= trace_clock.GAP_FRAMES * np.median(new_s)])
        yield (
            f"{name}: poses are held: {is_repeat.sum()} of {len(poses)} rows repeat "
            f"the pose before them; new ones come at {rate_hz:.4g} Hz. What moves in "
            "such steps flickers as no head does: the option skip_held (--skip-held) "
            "leaves them out."
        )
