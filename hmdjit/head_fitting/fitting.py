"""Fit the head model to recorded heads.

Spectra are fitted by Whittle's likelihood (`whittle`); each subject has a scale, and
the spread of the scales is `person_sd`. Return time and amplitude are fitted to moments
(`moments`). Standard errors are sandwich estimates over clusters (`errors`).
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float64

from .. import _checks
from ..head_motion.parameters import AXES
from ..head_motion.process import HeadMotion
from ..head_motion.replay import shared_rate_hz
from ..head_motion.trace import Trace
from . import errors, spectra, whittle
from .spectra import Periodograms
from .whittle import ORDERS, Search

_MIN_STILL_S, _ROUNDING_S = 30.0, 1e-6  # of sums of durations
_MIN_WINDOWS = 8
_FOLDS = 5


class NotEnoughDataError(ValueError):
    """The traces hold too little still data to fit; says how much, and why."""


class Fit(NamedTuple):
    """A fitted head, and how sure it is.

    - `head`: the model.
    - `standard_error`: of each of its numbers, in the same places; NaN where a number
      is not identifiable: not fitted, or at a bound of its search (within 0.5 % of the
      range of its logarithm), so that it may lie beyond.
    - `low`, `high`: 95 % intervals in the same places, within the bounds of the search;
      NaN likewise.
    - `clusters`: what the errors are over, in words.
    - `held_out_deviance`: by order, its mean per window, frequency and axis of data
      that were left out; empty when the order was given.
    - `subjects`, `windows`, `still_s`, `recorded_s`, `rate_hz`: what was fitted to.
    """

    head: HeadMotion
    standard_error: HeadMotion
    low: HeadMotion
    high: HeadMotion
    clusters: str
    held_out_deviance: dict[int, float]
    subjects: int
    windows: int
    still_s: float
    recorded_s: float
    rate_hz: float


def fit_heads(
    traces: Sequence[Trace],
    *,
    order: int | None = None,
    max_speed_deg_s: float = 5.0,
) -> Fit:
    """Fit head motion to the still segments of recorded traces.

    **Arguments:**

    - `traces`: recordings at one frame rate (within 2 %); `Trace.subject` says whose.
    - `order`: resonances per axis, 0 (model A), 1 or 2; None takes the smallest whose
      deviance on held-out subjects (blocks of time, of fewer than 3 subjects) is within
      a standard error of the best.
    - `max_speed_deg_s`: what is still, see `Trace.still_segments`.

    **Errors:** `NotEnoughDataError`, a `ValueError`, for less than 30 s of still data
    or 8 windows of 4 s; `ValueError` for mixed rates, `order`, subjects that do not
    move in some axis, and resonances at rates below 1.6 Hz.

    **Source:** Whittle's likelihood, debiased (Sykulski et al., Biometrika 106(2),
    2019), of the spectrum of sampled frame differences.
    """
    if order is not None:
        _checks.one_of("order", str(order), map(str, ORDERS))
    segments, rate_hz = still_data(traces, max_speed_deg_s)
    periodograms = Periodograms.of(segments, rate_hz)
    _check_amount(traces, segments, periodograms)
    _check_moves(periodograms)
    orders = ORDERS if order is None else (order,)
    found = {
        order: whittle.best_search(whittle.data_of(periodograms, order), order)
        for order in orders
    }
    held_out = {}
    if order is None:
        scores = {
            order: _held_out(periodograms, order, search)
            for order, search in found.items()
        }
        held_out = {order: float(np.mean(score)) for order, score in scores.items()}
        order = _smallest_good(scores)
    return Fit(
        *errors.estimate(periodograms, segments, found[order], order),
        held_out,
        len(periodograms.subjects),
        len(periodograms.power),
        sum(segment.duration_s for segment in segments),
        sum(trace.duration_s for trace in traces),
        rate_hz,
    )


def still_data(
    traces: Sequence[Trace], max_speed_deg_s: float = 5.0
) -> tuple[list[Trace], float]:
    """Still segments of traces that share a frame rate, and that rate, Hz."""
    rate_hz = shared_rate_hz(traces)
    segments = [s for trace in traces for s in trace.still_segments(max_speed_deg_s)]
    return segments, rate_hz


def _check_amount(
    traces: Sequence[Trace], segments: Sequence[Trace], periodograms: Periodograms
) -> None:
    still_s = sum(segment.duration_s for segment in segments)
    windows = len(periodograms.power)
    if still_s < _MIN_STILL_S - _ROUNDING_S or windows < _MIN_WINDOWS:
        longest_s = max((segment.duration_s for segment in segments), default=0.0)
        recorded_s = sum(trace.duration_s for trace in traces)
        raise NotEnoughDataError(
            f"traces must hold at least {_MIN_STILL_S:g} s of still data, in at least "
            f"{_MIN_WINDOWS} windows of {spectra.WINDOW_S:g} s; got "
            f"{_checks.apart(still_s, _MIN_STILL_S, spec='1f')} s in {len(segments)} "
            "segments of at most "
            f"{_checks.apart(longest_s, spectra.WINDOW_S, spec='1f')} s ({windows} "
            f"windows), of {recorded_s:.1f} s recorded."
        )


def _check_moves(periodograms: Periodograms) -> None:
    """Refuse axes without any power: no model has a likelihood there."""
    moves = np.all(periodograms.by_subject() > 0, axis=1)
    for axis, of_subjects in zip(AXES, moves.T, strict=True):
        if not of_subjects.all():
            still = np.array(periodograms.subjects)[~of_subjects]
            who = f"{still[0]} does not" if of_subjects.any() else "none does"
            raise ValueError(
                f"traces must move in all axes to be fitted, {who} in {axis}."
            )


def _held_out(
    periodograms: Periodograms, order: int, found: Search
) -> Float64[np.ndarray, " units"]:
    """Deviance per window, frequency and axis of each unit, when it is left out."""
    if len(periodograms.subjects) < 3:
        periodograms = periodograms.in_blocks(_FOLDS)
        found = eqx.tree_at(lambda s: s.log_scale, found, jnp.zeros(_FOLDS))
    data = whittle.data_of(periodograms, order)
    units = len(data.weight)
    fold = np.arange(units) % min(_FOLDS, units)
    deviance = np.zeros(units)
    for i in range(fold.max() + 1):
        left_out = jnp.asarray(fold == i, float) * data.weight
        rest = eqx.tree_at(lambda d: d.weight, data, data.weight - left_out)
        trained = whittle.refine(found, rest)
        deviance += np.asarray(whittle.held_out_deviances(trained, data, left_out))
    return deviance / (np.asarray(data.weight) * data.power[0].size)


def _smallest_good(scores: dict[int, Float64[np.ndarray, " units"]]) -> int:
    best = min(scores, key=lambda order: np.mean(scores[order]))
    for order in sorted(scores):
        worse = scores[order] - scores[best]
        if np.mean(worse) <= np.std(worse, ddof=1) / np.sqrt(len(worse)):
            return order
    return best
