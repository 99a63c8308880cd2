"""Observers, who compare pictures in pairs: intervals over them, how many one needs."""

import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.stats import norm
from jaxtyping import Array, ArrayLike, Float, Num
from scipy import stats

from .. import _checks
from .._types import RandomKey, Scalar
from .jod_scaling import JOD_SD, Scores, check_fixed, checked, jod, scaled_each, shifted

Votes = Float[Array, "observers conditions conditions"]

_MOST_FAILED = 0.01  # of resamples or studies: others would look too sure


class JodIntervals(NamedTuple):
    """Scores and their intervals, JOD.

    - `scores`, `low`, `high`: `(conditions,)`; bounds are NaN if too many failed.
    - `failed`: share of resamples whose votes have no scores; up to 1 % are left out.
    """

    scores: Scores
    low: Scores
    high: Scores
    failed: Scalar


def jod_intervals(
    key: RandomKey,
    counts: ArrayLike,
    *,
    prior: bool = True,
    fixed: tuple[int, float] | None = None,
    resamples: int = 500,
    level: float = 0.95,
) -> JodIntervals:
    """Scores, with intervals by a bootstrap that draws observers anew.

    **Arguments:**

    - `counts`: of each observer, `(observers, conditions, conditions)`.
    - `prior`, `fixed`: as of `jod`.
    - `level`: how often an interval shall hold the score.

    **Errors:** as of `jod`, and for fewer than two observers.

    **Source:** expanded percentiles: Hesterberg, "What Teachers Should Know About the
    Bootstrap", The American Statistician 69(4), 2015.
    """
    _checks.random_key(key)
    _checks.whole("resamples", resamples, 1)
    _checks.in_range("level", level, 0, 1, open_low=True, open_high=True)
    votes = checked(counts, 3, prior=prior)
    check_fixed(fixed, votes.shape[-1])
    scores = jod(jnp.sum(votes, axis=0), prior=prior, fixed=fixed)
    again = shifted(scaled_each(_resampled(key, votes, resamples), prior), fixed)
    observers = len(votes)
    reach = stats.t.ppf((1 + level) / 2, observers - 1)
    reach = float(stats.norm.cdf(reach * math.sqrt(observers / (observers - 1))))
    failed = jnp.mean(jnp.isnan(again[:, 0]))
    bounds = jnp.nanquantile(again, jnp.array([1 - reach, reach]), axis=0)
    low, high = jnp.where(failed > _MOST_FAILED, jnp.nan, bounds)
    return JodIntervals(scores, low, high, failed)


def votes(
    key: RandomKey,
    scores: ArrayLike,
    observers: int,
    repetitions: int = 1,
    *,
    spread_jod: float = 0.0,
) -> Votes:
    """Draw votes of observers who compare all pairs.

    **Arguments:**

    - `scores`: of the conditions, JOD, `(conditions,)`, two or more.
    - `repetitions`: how often each observer compares each pair.
    - `spread_jod`: standard deviation, over observers, of each condition's score.

    **Returns:** counts, `(observers, conditions, conditions)`: `[k, i, j]` is how often
    observer k preferred i to j, with probability `Phi((q_i - q_j) / 1.4826)`.
    """
    _checks.random_key(key)
    known = _known(scores, spread_jod)
    _checks.whole("observers", observers, 1)
    _checks.whole("repetitions", repetitions, 1)
    return _votes(key, known, observers, repetitions, spread_jod)


class Plan(NamedTuple):
    """What studies of several sizes would find.

    - `observers`: sizes, ascending.
    - `half_widths_jod`: of 95 % intervals, of the least certain score of all.
    - `needed`: the smallest size that meets what was asked for; None if none does.
    """

    observers: tuple[int, ...]
    half_widths_jod: tuple[float, ...]
    needed: int | None


def plan(
    key: RandomKey,
    scores: ArrayLike,
    half_width_jod: float,
    *,
    observers: Sequence[int] = (5, 10, 15, 20, 30, 40, 60, 80),
    repetitions: int = 1,
    spread_jod: float = 0.0,
    prior: bool = True,
    fixed: tuple[int, float] | None = None,
    studies: int = 200,
) -> Plan:
    """Find out by simulation how many observers a study needs.

    **Arguments:**

    - `scores`, `repetitions`, `spread_jod`: of the observers, as of `votes`.
    - `half_width_jod`: what 95 % intervals of all scores shall reach on either side.
    - `observers`: sizes of a study that are tried.
    - `prior`, `fixed`: how its votes will be scaled, as of `jod`.
    - `studies`: that are simulated, of each size.

    **Returns:** half-widths, 1.96 standard deviations of a score over the studies; NaN
    where the votes of more than 1 % of them have no scores.

    **Accuracy:** half-widths err by `1 / sqrt(2 studies)` of themselves, 5 % of 200;
    the largest of several errs upwards.
    """
    _checks.random_key(key)
    known = _known(scores, spread_jod)
    _checks.in_range("half_width_jod", half_width_jod, 0, open_low=True)
    _checks.whole("repetitions", repetitions, 1)
    _checks.whole("studies", studies, 2)
    check_fixed(fixed, len(known))
    if not isinstance(observers, Sequence) or isinstance(observers, str):
        raise ValueError(f"observers must be sizes of studies, got {observers!r}.")
    sizes = tuple(sorted(set(observers)))
    if not sizes:
        raise ValueError("observers must name at least one size, got none.")
    for size in sizes:
        _checks.whole("observers", size, 1)
    drawn = _studies(key, known, sizes, repetitions, spread_jod, studies)
    found = scaled_each(drawn.reshape(-1, *drawn.shape[2:]), prior)
    found = shifted(found.reshape(drawn.shape[:3]), fixed)
    failed = np.isnan(np.asarray(found)[..., 0]).mean(axis=0) > _MOST_FAILED
    z = float(stats.norm.ppf(0.975))
    width = z * np.max(np.nanstd(found, axis=0, ddof=1), axis=-1)
    width = np.where(failed, np.nan, width)
    meeting = [
        size for size, w in zip(sizes, width, strict=True) if w <= half_width_jod
    ]
    return Plan(sizes, tuple(width.tolist()), min(meeting, default=None))


def _known(scores: ArrayLike, spread_jod: float) -> Scores:
    known = jnp.asarray(scores, jnp.result_type(float))
    if known.ndim != 1 or len(known) < 2:
        raise ValueError(
            f"scores must be (conditions,), of two or more, got {known.shape}."
        )
    for number, score in enumerate(known):
        _checks.in_range(f"scores[{number}]", score)
    _checks.in_range("spread_jod", spread_jod, 0)
    return known


@functools.partial(jax.jit, static_argnames="resamples")
def _resampled(
    key: RandomKey, votes: Num[Array, "observers n n"], resamples: int
) -> Num[Array, "resamples n n"]:
    """Votes of observers who are drawn anew."""
    drawn = jax.random.randint(key, (resamples, len(votes)), 0, len(votes))
    return jax.lax.map(lambda chosen: jnp.sum(votes[chosen], axis=0), drawn)


@functools.partial(jax.jit, static_argnames=("observers", "repetitions"))
def _votes(
    key: RandomKey,
    scores: Scores,
    observers: int,
    repetitions: int,
    spread_jod: Scalar,
) -> Votes:
    of_people, of_votes = jax.random.split(key)
    size, dtype = (observers, len(scores)), scores.dtype
    own = scores[None] + spread_jod * jax.random.normal(of_people, size, dtype)
    share = norm.cdf((own[:, :, None] - own[:, None, :]) / JOD_SD)
    luck = jax.random.uniform(of_votes, (repetitions, *share.shape), dtype)
    drawn = jnp.sum((luck < share[None]).astype(dtype), axis=0)
    upper = jnp.triu(drawn, 1)  # wins of the first of each pair
    losses = jnp.triu(repetitions - drawn, 1)
    return upper + jnp.swapaxes(losses, -1, -2)


@functools.partial(jax.jit, static_argnames=("sizes", "repetitions", "studies"))
def _studies(
    key: RandomKey,
    scores: Scores,
    sizes: tuple[int, ...],
    repetitions: int,
    spread_jod: Scalar,
    studies: int,
) -> Float[Array, "studies sizes conditions conditions"]:
    """Votes of simulated studies; larger ones have the smaller ones' observers too."""

    def study(key: RandomKey) -> Float[Array, "sizes conditions conditions"]:
        drawn = _votes(key, scores, sizes[-1], repetitions, spread_jod)
        return jnp.cumsum(drawn, axis=0)[np.array(sizes) - 1]

    return jax.lax.map(study, jax.random.split(key, studies))
