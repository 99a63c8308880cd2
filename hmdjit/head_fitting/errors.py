"""What a fit is sure of: standard errors and intervals of a head's numbers.

Standard errors are sandwich estimates over clusters: subjects, or windows where there
are fewer than five subjects.
"""

import dataclasses
from collections.abc import Sequence

import jax
import numpy as np
import scipy.stats
from jaxtyping import Float64

from ..head_motion.parameters import FitError
from ..head_motion.process import HeadMotion
from ..head_motion.trace import Trace
from . import moments, whittle
from .moments import Estimate
from .scoring import Scoring
from .spectra import Periodograms
from .whittle import Data, Search

_MIN_SUBJECTS = 5
_LEVEL = 0.95
_PERSON_SD = 0.2  # where there are too few subjects: the presets have 0.18 to 0.23


def estimate(
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
    is_identifiable = scoring.identifiable(log_values.size).reshape(log_values.shape)
    speeds = [0, *range(3, len(log_values), 3)]
    cluster = np.arange(len(periodograms.subject))
    person = Estimate(_PERSON_SD)
    if over_subjects:
        cluster = periodograms.subject
        log_scale = np.asarray(whittle.centred(search, data), float)
        if is_identifiable[speeds].any():
            person = person_sd(log_scale, scoring.noise(log_values.size))
    influence = scoring.jackknife(cluster)[:, : log_values.size]
    influence = influence.reshape(-1, *log_values.shape)
    if over_subjects:
        # A subject brings its scale, which all speeds share.
        influence[:, speeds] += log_scale[:, None, None] / (subjects - 1)
    clusters = len(influence)
    log_error = np.sqrt(np.sum(influence**2, axis=0) * (clusters - 1) / clusters)
    log_error = np.where(is_identifiable, log_error, np.nan)
    bounds = np.asarray(data.log_bounds, float)[..., None]
    quantile = float(scipy.stats.t.ppf((1 + _LEVEL) / 2, clusters - 1))

    values = np.exp(log_values)
    head = whittle.head_of(values.tolist(), returned.value, person.value)
    bursts = moments.amplitude(segments, head, rate_hz, over_subjects=over_subjects)
    head = moments.with_amplitude(head, bursts.value)
    relative = values * log_error, returned.value * returned.error
    errors = _in_place(head, *relative, person.error, bursts.error)

    def end(steps: float, person_end: float) -> HeadMotion:
        log_time = np.log(returned.value) + steps * returned.error
        return _in_place(
            head,
            np.exp(np.clip(log_values + steps * log_error, *bounds)),
            np.clip(np.exp(log_time), *moments.RETURN_TIMES_S),
            person_end,
            np.clip(bursts.value + steps * bursts.error, *moments.AMPLITUDE_SDS),
        )

    kind = f"{subjects} subjects"
    if not over_subjects:
        kind = f"{clusters} windows of {kind}, between these windows only"
    # What is not identifiable moves no spectrum.
    influence = np.where(is_identifiable, influence, 0.0)
    rotation = _rotation_error(log_values, influence, rate_hz)
    sure = dataclasses.replace(head, fit_error=FitError(rotation, clusters, kind))
    return sure, errors, end(-quantile, person.low), end(quantile, person.high), kind


def _rotation_error(
    log_values: Float64[np.ndarray, "parameters 3"],
    influence: Float64[np.ndarray, "clusters parameters 3"],
    rate_hz: float,
) -> float:
    """Relative standard error of the RMS rotation per frame, by the jackknife."""
    turns = []
    for moved in (np.zeros_like(log_values), *influence):
        values = np.exp(log_values + moved).tolist()
        head = whittle.head_of(values, moments.DEFAULT_RETURN_TIME_S)
        turns.append(float(head.increment_rms_deg(rate_hz)))
    change = np.log(turns[1:]) - np.log(turns[0])
    share = (len(influence) - 1) / len(influence)
    return min(1.0, float(np.sqrt(share * np.sum(change**2))))


def _log_values(search: Search, data: Data) -> Float64[np.ndarray, "parameters 3"]:
    log_values = np.asarray(whittle.log_values(search, data), float)
    if not np.all(np.isfinite(log_values)):
        raise ValueError(
            "traces must move so that a model can be fitted, but the search found no "
            "finite numbers."
        )
    return log_values


def person_sd(
    log_scale: Float64[np.ndarray, " subjects"],
    noise: Float64[np.ndarray, " subjects"],
) -> Estimate:
    """Spread of the subjects' scales, beyond what each is uncertain by.

    **Arguments:** `log_scale`: of each subject; `noise`: its variance between windows.

    **Returns:** 0, its bound, and no error where nothing is left beyond the noise.
    """
    freedom = len(log_scale) - 1
    variance = np.var(log_scale, ddof=1)
    beyond = lambda variance: float(np.sqrt(max(variance - np.mean(noise), 0.0)))
    shares = np.array([(1 + _LEVEL) / 2, (1 - _LEVEL) / 2])
    if not beyond(variance):
        return Estimate(0.0)
    ends = variance * freedom / scipy.stats.chi2.ppf(shares, freedom)
    error = variance / np.sqrt(2 * freedom) / beyond(variance)
    return Estimate(beyond(variance), float(error), *map(beyond, ends))


def _in_place(
    head: HeadMotion,
    values: Float64[np.ndarray, "parameters 3"],
    return_time_s: float,
    person: float,
    amplitude_sd: float,
) -> HeadMotion:
    """Put numbers about a head in the places of the head's own, unchecked."""
    wander, modes = values[:3].ravel(), values[3:].ravel()
    flat = [*wander, return_time_s, person, *modes, amplitude_sd, np.nan]
    return jax.tree.unflatten(jax.tree.structure(head), [float(x) for x in flat])
