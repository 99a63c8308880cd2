"""Fit the head model to recorded heads.

Spectra are fitted by Whittle's likelihood (`whittle`); each subject has a scale, and
the spread of the scales is `person_sd`. Return time and amplitude are fitted to moments
(`moments`). Standard errors are sandwich estimates over clusters:
subjects, or windows where there are fewer than five subjects.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.stats
from jaxtyping import Float64

from .. import _checks
from ..head_motion.parameters import AXES
from ..head_motion.process import HeadMotion
from ..head_motion.trace import Trace
from . import moments, spectra, whittle
from .scoring import Scoring
from .spectra import Periodograms
from .whittle import ORDERS, Data, Search

_MIN_STILL_S = 30.0
_MIN_WINDOWS = 8
_MIN_SUBJECTS = 5
_FOLDS = 5
_LEVEL = 0.95

_PERSON_SD = 0.2  # where there are too few subjects: the presets have 0.18 to 0.23


class NotEnoughDataError(ValueError):
    """The traces hold too little still data to fit; says how much, and why."""


class Fit(NamedTuple):
    """A fitted head, and how sure it is.

    - `head`: the model.
    - `standard_error`: of each of its numbers, in the same places; NaN where the
      recordings do not tell it: where it was not fitted, or ended at a bound of its
      search (within 0.5 % of the range of its logarithm), so that it may lie beyond.
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


def fit(
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
        *_estimate(periodograms, segments, found[order], order),
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
    if not traces:
        raise ValueError("traces must name at least one recording, got none.")
    rates = [trace.rate_hz for trace in traces]
    rate_hz = float(np.median(rates))
    for trace, rate in zip(traces, rates, strict=True):
        if abs(rate / rate_hz - 1) > 0.02:
            raise ValueError(
                f"traces must share one frame rate within 2 % to be used together: "
                f"{trace.name} has {rate:.2f} Hz, the median is {rate_hz:.2f} Hz."
            )
    segments = [s for trace in traces for s in trace.still_segments(max_speed_deg_s)]
    return segments, rate_hz


def _check_amount(
    traces: Sequence[Trace], segments: Sequence[Trace], periodograms: Periodograms
) -> None:
    still_s = sum(segment.duration_s for segment in segments)
    windows = len(periodograms.power)
    if still_s < _MIN_STILL_S or windows < _MIN_WINDOWS:
        longest_s = max((segment.duration_s for segment in segments), default=0.0)
        raise NotEnoughDataError(
            f"traces must hold at least {_MIN_STILL_S:g} s of still data, in at least "
            f"{_MIN_WINDOWS} windows of {spectra.WINDOW_S:g} s; got {still_s:.1f} s in "
            f"{len(segments)} segments of at most {longest_s:.1f} s ({windows} "
            f"windows), of {sum(trace.duration_s for trace in traces):.1f} s recorded."
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


# --- the order ---


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


# --- the estimate and its errors ---


class _Spread(NamedTuple):
    """A number, its standard error and the ends of its interval."""

    value: float
    error: float = np.nan
    low: float = np.nan
    high: float = np.nan


def _estimate(
    periodograms: Periodograms, segments: Sequence[Trace], search: Search, order: int
) -> tuple[HeadMotion, HeadMotion, HeadMotion, HeadMotion, str]:
    """Return the head, its standard errors, both ends of its intervals, their kind."""
    rate_hz, subjects = periodograms.rate_hz, len(periodograms.subjects)
    over_subjects = subjects >= _MIN_SUBJECTS
    data = whittle.data_of(periodograms, order)
    values = np.exp(_log_values(search, data))
    head = whittle.head_of(values, moments.DEFAULT_RETURN_TIME_S)
    log_scale = np.asarray(whittle.centred(search, data), float)
    scale = dict(zip(periodograms.subjects, np.exp(log_scale).tolist(), strict=True))
    returned = moments.return_time(
        segments, head, rate_hz, scale, over_subjects=over_subjects
    )

    # The spring takes a little from the lowest frequencies: fit again with it.
    data = whittle.data_of(periodograms, order, returned.value)
    search = whittle.refine(search, data)
    log_values = _log_values(search, data)
    at_bound = whittle.at_bound(log_values, data)
    # What ended at a bound is held there: the others are as sure as beside it.
    scoring = Scoring.of(periodograms, search, data).without(at_bound.ravel())
    is_told = scoring.told(log_values.size).reshape(log_values.shape)
    speeds = [0, *range(3, len(log_values), 3)]
    cluster = np.arange(len(periodograms.subject))
    person = _Spread(_PERSON_SD)
    if over_subjects:
        cluster = periodograms.subject
        log_scale = np.asarray(whittle.centred(search, data), float)
        if is_told[speeds].any():
            person = _person_sd(log_scale, scoring.noise(log_values.size))
    pulls = scoring.jackknife(cluster)[:, : log_values.size]
    pulls = pulls.reshape(-1, *log_values.shape)
    if over_subjects:
        # A subject brings its scale, which all speeds share.
        pulls[:, speeds] += log_scale[:, None, None] / (subjects - 1)
    clusters = len(pulls)
    log_error = np.sqrt(np.sum(pulls**2, axis=0) * (clusters - 1) / clusters)
    log_error = np.where(is_told, log_error, np.nan)
    bounds = np.asarray(data.log_bounds, float)[..., None]
    quantile = float(scipy.stats.t.ppf((1 + _LEVEL) / 2, clusters - 1))

    values = np.exp(log_values)
    head = whittle.head_of(values.tolist(), returned.value, person.value)
    bursts = moments.amplitude(segments, head, rate_hz, over_subjects=over_subjects)
    head = moments.with_amplitude(head, bursts.value)
    errors = _in_place(
        head,
        values * log_error,
        returned.value * returned.error,
        person.error,
        bursts.error,
    )
    low, high = (
        _in_place(
            head,
            np.exp(np.clip(log_values + step * log_error, *bounds)),
            float(
                np.clip(
                    returned.value * np.exp(step * returned.error),
                    *moments.RETURN_TIMES_S,
                )
            ),
            person_end,
            float(np.clip(bursts.value + step * bursts.error, *moments.AMPLITUDE_SDS)),
        )
        for step, person_end in ((-quantile, person.low), (quantile, person.high))
    )
    kind = (
        f"{subjects} subjects"
        if over_subjects
        else f"{clusters} windows of {subjects} subjects, between these windows only"
    )
    return head, errors, low, high, kind


def _log_values(search: Search, data: Data) -> Float64[np.ndarray, "parameters 3"]:
    log_values = np.asarray(whittle.log_values(search, data), float)
    if not np.all(np.isfinite(log_values)):
        raise ValueError(
            "traces must move so that a model can be fitted, but the search found no "
            "finite numbers."
        )
    return log_values


def _person_sd(
    log_scale: Float64[np.ndarray, " subjects"],
    noise: Float64[np.ndarray, " subjects"],
) -> _Spread:
    """Spread of the subjects' scales, beyond what each is uncertain by.

    Where nothing is left beyond that it ends at its bound, 0, and is not told.
    """
    freedom = len(log_scale) - 1
    variance = np.var(log_scale, ddof=1)
    beyond = lambda variance: float(np.sqrt(max(variance - np.mean(noise), 0.0)))
    shares = np.array([(1 + _LEVEL) / 2, (1 - _LEVEL) / 2])
    if not beyond(variance):
        return _Spread(0.0)
    ends = variance * freedom / scipy.stats.chi2.ppf(shares, freedom)
    error = variance / np.sqrt(2 * freedom) / beyond(variance)
    return _Spread(beyond(variance), float(error), *map(beyond, ends))


def _in_place(
    head: HeadMotion,
    values: Float64[np.ndarray, "parameters 3"],
    return_time_s: float,
    person_sd: float,
    amplitude_sd: float,
) -> HeadMotion:
    """Put numbers about a head in the places of the head's own, unchecked."""
    wander, modes = values[:3].ravel(), values[3:].ravel()
    flat = [*wander, return_time_s, person_sd, *modes, amplitude_sd, np.nan]
    return jax.tree.unflatten(jax.tree.structure(head), [float(x) for x in flat])
