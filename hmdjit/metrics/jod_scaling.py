"""Scores of pictures that people compared in pairs, in just-objectionable differences.

Thurstone's model, case V: condition i is preferred to j with probability
`Phi((q_i - q_j) / 1.4826)`, so that of two conditions 1 JOD apart three quarters of
people prefer the better one. Votes are counts `(conditions, conditions)`: `counts[i,
j]` is how often i was preferred to j.

**Source:** Perez-Ortiz and Mantiuk, "A practical guide and software for analysing
pairwise comparison experiments", arXiv:1712.03686, and its software `pwcmp`.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jax.scipy.special import log_ndtr, ndtri
from jax.scipy.stats import norm
from jaxtyping import Array, ArrayLike, Bool, DTypeLike, Float, Num, Shaped

from .. import _checks
from .._types import Scalar

JOD_SD = 1.4826
"""Standard deviation of how much better one of two seems to be, JOD."""

Scores = Float[Array, " conditions"]
Counts = Num[Array, "conditions conditions"]
Pairs = Float[Array, " pairs"]

_FLOOR = 0.1  # that a prior of distances is lifted by, 1/JOD
_FARTHEST_JOD = 6.0  # of a compared pair: one vote in 40,000 is for the worse one
_MOST_STEPS = 200
_AT_A_TIME = 100  # studies


def jod(
    counts: ArrayLike, *, prior: bool = True, fixed: tuple[int, float] | None = None
) -> Scores:
    """Scale votes to the scores that are most probable, by BFGS.

    **Arguments:**

    - `counts`: `(conditions, conditions)`, whole numbers of votes.
    - `prior`: whether distances that all pairs' votes make likely are preferred, which
      keeps unanimous votes from moving conditions infinitely far apart (not where many
      other pairs were judged alike, and one condition is placed by such votes alone).
    - `fixed`: number of a condition, from 0, and its score; None has a mean of 0.

    **Returns:** JOD, `(conditions,)`. Inside compiled code NaN stands for an error.

    **Errors:** `ValueError` for counts that are no votes, for conditions that no chain
    of comparisons connects, and for votes that put conditions infinitely far apart.

    **Accuracy:** 1e-6 JOD in float64. In float32 a loss of thousands of votes rounds:
    a tenth of a standard error at worst, and mostly a hundredth.
    """
    votes = checked(counts, 2, prior=prior)
    check_fixed(fixed, votes.shape[-1])
    found = shifted(scaled(votes, prior), fixed)
    if not _checks.is_traced(found) and not np.isfinite(found).all():
        raise ValueError(
            "counts must place all conditions, got some that no votes keep near."
        )
    return found


@functools.partial(jax.jit, static_argnames="prior")
def negative_log_posterior(scores: Scores, counts: Counts, *, prior: bool) -> Scalar:
    """Return what `jod` minimises: each pair counts twice, and the mean is drawn to 0.

    For both orders of each pair that was compared `log(P^wins (1 - P)^losses)` and,
    with a prior p of distances, `log(p + 0.1)`: p is the mean over all these pairs of
    the likelihood of the distance by their votes, normalised over distances. One vote
    of unanimous pairs is moved there; a single vote, which says nothing of a distance,
    counts as 0. To minus the sum `0.01 mean(q)^2` is added. `pwcmp` floors
    probabilities at 1e-400; logarithms need none, and a pair of 2,000 votes would lie
    below it.
    """
    return _objective(scores, _Likelihoods.of(counts, scores.dtype), prior)


class _Likelihoods(NamedTuple):
    """Votes on each pair, and likelihoods of a distance by those that say something.

    - `wins`, `losses`: of the first of each pair.
    - `says`: whether they bound the distance, one vote of unanimous ones being moved.
    - `moved`: these wins and losses.
    - `log_area`: logarithm of the likelihood's integral over distances, JOD.
    """

    wins: Pairs
    losses: Pairs
    says: Bool[Array, " pairs"]
    moved: tuple[Pairs, Pairs]
    log_area: Pairs

    @classmethod
    def of(cls, counts: Counts, dtype: DTypeLike) -> "_Likelihoods":
        first, second = _pairs(len(counts))
        counts = counts.astype(dtype)
        wins, losses = counts[first, second], counts[second, first]
        move = lambda mine, other: jnp.where(
            mine == 0, 1, jnp.where(other == 0, mine - 1, mine)
        )
        moved = move(wins, losses), move(losses, wins)
        says = (wins + losses > 0) & (moved[0] > 0) & (moved[1] > 0)
        w, k = (jnp.where(says, votes, 1) for votes in moved)
        # On a grid around the peak, as wide as the peak: of what is smooth and fades
        # away on both sides, the sum is the integral, to rounding.
        peak = ndtri(w / (w + k))
        step = 0.06 * jnp.sqrt(w * k / (w + k)) / (w + k) / norm.pdf(peak)
        grid = peak[None] + jnp.arange(-200, 201).astype(dtype)[:, None] * step[None]
        at_peak = _log_likelihood(peak, w, k)
        around = _log_likelihood(grid, w[None], k[None]) - at_peak[None]
        area = jnp.sum(jnp.exp(around), axis=0) * step * JOD_SD
        return cls(wins, losses, says, (w, k), at_peak + jnp.log(area))

    def density(self, z: Pairs) -> Pairs:
        """Prior of distances, 1/JOD: the mean over both orders of each pair."""
        wins, losses, log_area = (x[None] for x in (*self.moved, self.log_area))
        by = lambda z: jnp.exp(_log_likelihood(z[:, None], wins, losses) - log_area)
        both = jnp.where(self.says[None], by(z) + by(-z), 0)
        asked = jnp.sum((self.wins + self.losses > 0).astype(z.dtype))
        return jnp.sum(both, axis=1) / (2 * asked)


def _objective(scores: Scores, votes: _Likelihoods, prior: bool) -> Scalar:
    first, second = _pairs(len(scores))
    z = (scores[first] - scores[second]) / JOD_SD
    total = _log_likelihood(z, votes.wins, votes.losses)
    if prior:
        total = total + jnp.log(votes.density(z) + _FLOOR)
    total = jnp.where(votes.wins + votes.losses > 0, total, 0)
    return 0.01 * jnp.mean(scores) ** 2 - 2 * jnp.sum(total)


def _pairs(conditions: int) -> tuple[np.ndarray, np.ndarray]:
    return np.triu_indices(conditions, 1)


def _log_likelihood(z: Array, wins: Array, losses: Array) -> Array:
    return wins * log_ndtr(z) + losses * log_ndtr(-z)


@functools.partial(jax.jit, static_argnames="prior")
def scaled(counts: Counts, prior: bool) -> Scores:
    """Scores of counts with a mean of 0; NaN where there are none; see `jod`.

    All that is minimised but the mean's part depends on distances alone: the others are
    searched for against condition 0, and the mean is taken off.
    """
    votes = counts.astype(jnp.result_type(float))
    start, information = _guess(votes)
    # In units of standard errors, where curvatures are 1.
    factor = jnp.linalg.cholesky(2 * information)
    is_double = votes.dtype == jnp.float64

    def scores(steps: Array) -> Scores:
        moved = jax.scipy.linalg.solve_triangular(factor, steps, lower=True, trans=1)
        found = jnp.concatenate([jnp.zeros(1, votes.dtype), start + moved])
        return found - jnp.mean(found)

    known = _Likelihoods.of(votes, votes.dtype)

    def objective(steps: Array, known: _Likelihoods) -> Array:
        return jnp.asarray(_objective(scores(steps), known, prior))

    tolerance = 1e-9 if is_double else 1e-4
    solver = optimistix.BFGS(rtol=tolerance, atol=tolerance)
    begun = jnp.zeros_like(start)
    steps = optimistix.minimise(
        objective, solver, begun, known, max_steps=_MOST_STEPS, throw=False
    ).value
    found = scores(steps)
    # However the search ended: is it at a minimum, and is that not at infinity?
    slope = jnp.max(jnp.abs(jax.grad(objective)(steps, known)))
    # Pairs that far apart say nothing of how far: nearer ones must connect all.
    is_near = jnp.abs(found[:, None] - found[None]) < _FARTHEST_JOD
    near = jnp.where(is_near, votes + votes.T, 0.0)
    is_found = (slope < (1e-3 if is_double else 0.1)) & _is_connected(votes, prior)
    is_found = is_found & _is_connected(near, True)
    return jnp.where(is_found, found, jnp.nan)


@functools.partial(jax.jit, static_argnames="prior")
def scaled_each(
    counts: Num[Array, "studies n n"], prior: bool
) -> Float[Array, "studies n"]:
    """Scores of several studies; see `scaled`."""
    batch_size = min(len(counts), _AT_A_TIME)
    return jax.lax.map(lambda one: scaled(one, prior), counts, batch_size=batch_size)


def _guess(votes: Counts) -> tuple[Array, Array]:
    """Least squares of the distances that pairs have alone; its normal equations."""
    count = votes + votes.T
    # Half a vote more on either side keeps distances finite.
    z = ndtri((votes + 0.5) / (count + 1))
    share = norm.cdf(z)
    weight = count * norm.pdf(z) ** 2 / (share * (1 - share)) / JOD_SD**2
    pull = jnp.sum(weight * z * JOD_SD, axis=1)
    information = jnp.diag(jnp.sum(weight, axis=1)) - weight
    information = information[1:, 1:]
    return jnp.linalg.solve(information, pull[1:]), information


def _is_connected(votes: Shaped[Array, "n n"], prior: bool) -> Bool[Array, ""]:
    """Whether comparisons lead from each condition to each other one.

    Without a prior only won ones count: else one group has won all its comparisons
    with the others, and has no finite score (Ford 1957).
    """
    won = votes > 0
    step = (won | won.T) if prior else won
    reach = step | np.eye(len(votes), dtype=bool)
    for _ in range(len(votes).bit_length()):
        reach = (reach.astype(jnp.int32) @ reach.astype(jnp.int32)) > 0
    return jnp.all(reach)


def shifted(scores: Array, fixed: tuple[int, float] | None) -> Array:
    """Give a condition its score, and move all others with it."""
    if fixed is None:
        return scores
    index, value = fixed
    return scores - scores[..., index, None] + value


def check_fixed(fixed: tuple[int, float] | None, conditions: int) -> None:
    """Raise unless there is such a condition, and its score is finite."""
    if fixed is None:
        return
    if not isinstance(fixed, tuple | list) or len(fixed) != 2:
        raise ValueError(
            f"fixed must be a pair, a condition's number and score, got {fixed!r}."
        )
    _checks.whole("fixed[0]", fixed[0], 0)
    _checks.in_range("fixed[0]", fixed[0], 0, conditions - 1)
    _checks.in_range("fixed[1]", fixed[1])


def checked(counts: ArrayLike, axes: int, *, prior: bool) -> Array:
    """Votes as an array, if they are votes; `axes`: 3 of several observers.

    **Errors:** `ValueError`, see `jod`.
    """
    votes = jnp.asarray(counts)
    several = "observers, " * (axes == 3)
    size = votes.shape[-1] if votes.ndim else 0
    if votes.ndim != axes or votes.shape[-2] != size or size < 2:
        raise ValueError(
            f"counts must be ({several}conditions, conditions), of two or more, got "
            f"{votes.shape}."
        )
    if axes == 3 and len(votes) < 2:
        raise ValueError(f"counts must be of two observers or more, got {len(votes)}.")
    if _checks.is_traced(votes):
        return votes
    known = np.asarray(votes)
    is_vote = np.isfinite(known) & (known >= 0) & (known == np.round(known))
    if not is_vote.all():
        raise ValueError(
            "counts must be whole numbers >= 0 of votes, got "
            f"{known[~is_vote].flat[0]:g}."
        )
    if (own := np.diagonal(known, axis1=-2, axis2=-1)).any():
        raise ValueError(
            "counts must be 0 on the diagonal, where a condition is compared with "
            f"itself, got {own[own != 0].flat[0]:g}."
        )
    total = jnp.sum(votes > 0, axis=0, dtype=jnp.int32) if axes == 3 else votes
    if not _is_connected(total, True):
        raise ValueError(
            "counts must connect all conditions by comparisons, got some that were "
            "never compared with the others, not even through others."
        )
    if not prior and not _is_connected(total, False):
        raise ValueError(
            "counts must have votes both ways between any two groups of conditions "
            "with prior=False, got a group that won all its comparisons."
        )
    return votes
