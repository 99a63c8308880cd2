"""What is fitted to moments of the recordings: not identifiable from spectra.

The spectrum of windows of 4 s says nothing about the slow return to the hold pose, and
no spectrum distinguishes bursts from a Gaussian process. So the return time is the one
whose wander within 10 s was recorded, and the amplitude's spread the one that gives
velocities the recorded shape.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np
import scipy.optimize
from jaxtyping import Float64

from ..head_motion.parameters import AXES, Amplitude
from ..head_motion.process import HeadMotion
from ..head_motion.trace import Trace
from .spectra import Turns
from .statistics import block_variances, expected_block_variance

DEFAULT_RETURN_TIME_S = 15.0  # where the recordings are too short to tell
RETURN_TIMES_S = (1.0, 100.0)
_BLOCK_S = 10.0
_MIN_BLOCKS = 10
_MAX_LOG_ERROR = 1.0  # an estimate that may be e times too large or small says nothing
_AMPLITUDE_TIME_S = 0.4  # squared speeds of two axes covary for 0.3 to 0.5 s
AMPLITUDE_SDS = (0.0, 1.5)
_BURST_BLOCK = 360  # frames, far longer than a burst
_QUADRATURE = 40


class Estimate(NamedTuple):
    """A number, its standard error and interval; NaN where it is not identifiable."""

    value: float
    error: float = np.nan
    low: float = np.nan
    high: float = np.nan


def return_time(
    segments: Sequence[Trace],
    head: HeadMotion,
    rate_hz: float,
    scale: Mapping[str, float],
    *,
    over_subjects: bool,
) -> Estimate:
    """Return time, s, whose wander in 10 s is the recorded one; error of its logarithm.

    Axes count alike: it is the geometric mean of their mean squares that agrees.

    **Arguments:** `head`: of the median person; `scale`: how much more each subject
    moves, 1 for those not named.
    """
    blocks, owners = [], []
    for segment in segments:
        found = block_variances([Turns.of(segment).path_deg], _BLOCK_S * rate_hz)
        blocks.append(found / scale.get(segment.subject, 1.0) ** 2)
        owners += [segment.subject] * len(found)
    variances = np.concatenate(blocks)
    if len(variances) < _MIN_BLOCKS:
        return Estimate(DEFAULT_RETURN_TIME_S)
    recorded = variances.mean(axis=0)
    influence = np.mean(variances / recorded - 1, axis=1) / len(variances)

    def excess(log_time: float) -> float:
        sprung = eqx.tree_at(lambda h: h.return_time_s, head, float(np.exp(log_time)))
        expected = expected_block_variance(sprung, _BLOCK_S * rate_hz, rate_hz)
        return float(np.mean(np.log(expected / recorded)))

    groups = owners if over_subjects else range(len(influence))
    low, high = np.log(RETURN_TIMES_S)
    root, error = _root(excess, (low, high), _spread(influence, groups))
    if not error <= _MAX_LOG_ERROR:
        return Estimate(DEFAULT_RETURN_TIME_S)
    return Estimate(float(np.exp(root)), error if low < root < high else np.nan)


def amplitude(
    segments: Sequence[Trace], head: HeadMotion, rate_hz: float, *, over_subjects: bool
) -> Estimate:
    """Spread of the amplitude whose mean absolute velocity over RMS was recorded.

    Geary's ratio, of each axis and subject by itself, averaged. It tells a Gaussian
    process (0.798) from one in bursts by the bulk of its velocities, where kurtosis
    hangs on the few largest bursts. 0 without an error where the ratio is
    uninformative.
    """
    velocities: dict[str, list[np.ndarray]] = {}
    for segment in segments:
        turns = Turns.of(segment)
        whole = turns.velocity_deg_s[turns.frames == 1]
        velocities.setdefault(segment.subject, []).append(whole)
    ratios, weights, owners = [], [], []
    for subject, parts in velocities.items():
        velocity = np.concatenate(parts)
        of_blocks = geary_pseudo_values(velocity)
        ratios.append(of_blocks)
        weights.append(np.full(len(of_blocks), len(velocity) / len(of_blocks)))
        owners += [subject] * len(of_blocks)
    ratio, weight = np.concatenate(ratios), np.concatenate(weights)
    weight /= np.sum(weight)
    recorded = np.sum(weight * ratio)

    def excess(sd: float) -> float:
        expected = geary_ratio(with_amplitude(head, sd), rate_hz)
        return float(recorded - np.mean(expected))

    groups = owners if over_subjects else range(len(ratio))
    low, high = AMPLITUDE_SDS
    spread = _spread(weight * (ratio - recorded), groups)
    if excess(high) - excess(low) <= spread:
        return Estimate(low)  # the tracker's noise hides any bursts
    root, error = _root(excess, (low, high), spread)
    return Estimate(root, error if low < root < high else np.nan)


def geary_pseudo_values(
    velocity: Float64[np.ndarray, "frames 3"],
) -> Float64[np.ndarray, " blocks"]:
    """Jackknife pseudo-values of one subject's ratio, mean over axes.

    Their mean lacks the bias that taking velocities by their own RMS has.
    """
    # The last block takes the rest, so that no block is short.
    starts = np.arange(max(len(velocity) // _BURST_BLOCK, 1)) * _BURST_BLOCK
    count = np.diff(np.append(starts, len(velocity)))[:, None]
    first = np.add.reduceat(np.abs(velocity), starts)
    second = np.add.reduceat(velocity**2, starts)
    ratio = lambda first, second, count: np.mean(
        first / np.sqrt(second * count), axis=1
    )
    whole = [np.sum(x, axis=0, keepdims=True) for x in (first, second, count)]
    if len(starts) == 1:
        return ratio(*whole)
    rest = [total - x for total, x in zip(whole, (first, second, count), strict=True)]
    return len(starts) * ratio(*whole) - (len(starts) - 1) * ratio(*rest)


def geary_ratio(head: HeadMotion, rate_hz: float) -> Float64[np.ndarray, "3"]:
    """Mean absolute velocity over RMS, of one person's frame differences per axis.

    Given the amplitude a velocity is normal. Its variance is taken as the tracker's
    plus a log-normal one of the spread that `increment_kurtosis` tells; for amplitudes
    up to 0.6 the ratio is then 0.6 % low at most.
    """
    none = (0.0,) * len(AXES)
    steady = eqx.tree_at(lambda h: h.tracker_noise_deg, head, none)
    variance = np.asarray(steady.increment_covariance(0, rate_hz), float)
    tracker = 2 * np.square(np.array(head.tracker_noise_deg, float))
    # What the head moves, without differences; a head that does not has no bursts.
    moved = variance / np.where(variance > 0, variance + tracker, 1.0)
    kurtosis = np.asarray(head.increment_kurtosis(rate_hz), float)
    spread = np.sqrt(np.log1p(kurtosis / 3 / np.where(moved > 0, moved, 1.0) ** 2))
    levels, weights = np.polynomial.hermite_e.hermegauss(_QUADRATURE)
    shares = np.exp(np.outer(spread, levels) - spread[:, None] ** 2 / 2)
    variance = moved[:, None] * shares + (1 - moved)[:, None]
    mean_root = np.sqrt(variance) @ (weights / np.sum(weights))
    return np.sqrt(2 / np.pi) * mean_root


def with_amplitude(head: HeadMotion, sd: float) -> HeadMotion:
    """Let a head move in bursts and lulls."""
    bursts = Amplitude(sd, _AMPLITUDE_TIME_S)
    return eqx.tree_at(
        lambda h: h.amplitude, head, bursts, is_leaf=lambda leaf: leaf is None
    )


def _spread(influence: Float64[np.ndarray, " units"], groups: Sequence) -> float:
    """Return the standard error of a sum whose units come in groups; NaN of one."""
    _, group = np.unique(np.asarray(groups), return_inverse=True)
    of_group = np.bincount(group, weights=influence)
    if len(of_group) == 1:
        return np.nan
    return float(np.sqrt(np.sum(of_group**2) * len(of_group) / (len(of_group) - 1)))


def _root(
    excess: Callable[[float], float], ends: tuple[float, float], error: float
) -> tuple[float, float]:
    """Root of a rising function, and its error; the nearer end where it is beyond."""
    low, high = map(float, ends)
    if excess(low) >= 0:
        root = low
    elif excess(high) <= 0:
        root = high
    else:
        root = float(scipy.optimize.brentq(excess, low, high, xtol=1e-4))  # pyright: ignore[reportArgumentType]
    step = 1e-2 * (high - low)
    below, above = max(root - step, low), min(root + step, high)
    slope = (excess(above) - excess(below)) / (above - below)
    return root, error / slope if slope > 0 else np.nan
