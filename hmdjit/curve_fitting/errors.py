"""How sure a fitted curve is: sandwich errors and a bootstrap over sessions.

The point minimises a sum over sessions, `sum_i c_i(x)`. With gradients `g_i` and
curvatures `H_i` of each session's term there, other sessions would have moved it by
`-(sum w_i H_i)^-1 sum w_i g_i`, w_i being how often each was drawn.

**Source:** sandwich estimate of M-estimators: White, "Maximum Likelihood Estimation of
Misspecified Models", Econometrica 50(1), 1982; bootstrap by one Newton step: Davidson
and MacKinnon, "Bootstrap Tests in Nonlinear Models", 1999. Both with the degrees of
freedom of MacKinnon and White's HC1.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .space import CurveSpace

_LEVEL = 0.95
_REPLICATES = 1000
_SEED = 20260101
_FLAT = 1e-6  # of a number's own curvature: what is flatter is not determined
_MOSTLY = (
    0.5  # a number's share of a flat direction, from which on it is not identifiable
)
_FARTHEST = 3.0  # logits; Newton's step beyond is cut there

Gradients = Float[np.ndarray, "sessions numbers"]
Curvatures = Float[np.ndarray, "sessions numbers numbers"]


class Errors(NamedTuple):
    """Of each natural number of a curve, in the order of its space's names.

    - `standard_error`: sandwich estimate over sessions, to first order; infinite where
      the sessions do not tell a number.
    - `low`, `high`: 95 % interval by the bootstrap over sessions; there all its range.
    - `drawn`: the bootstrap's numbers, for bands about a curve.
    """

    standard_error: Float[np.ndarray, " names"]
    low: Float[np.ndarray, " names"]
    high: Float[np.ndarray, " names"]
    drawn: Float[np.ndarray, "replicates names"]


def newton_step(
    gradients: Gradients, curvatures: Curvatures
) -> Float[np.ndarray, " numbers"]:
    """Step to where the sum over sessions is least, if it is quadratic."""
    step = -_inverse(curvatures.sum(axis=0))[0] @ gradients.sum(axis=0)
    return np.clip(step, -_FARTHEST, _FARTHEST)


def errors(
    space: CurveSpace,
    point: Float[np.ndarray, " numbers"],
    gradients: Gradients,
    curvatures: Curvatures,
) -> Errors:
    """Errors of a fitted point, from each session's gradient and curvature there."""
    sessions, count = gradients.shape
    # As many numbers were fitted to the sessions: their residuals are that much short.
    centred = gradients - gradients.mean(axis=0)
    centred = centred * np.sqrt(sessions / max(sessions - count, 1))
    at = jnp.asarray(point)
    # Natural numbers move by their slopes: near a bound a logit says little, but where
    # a number may lie beside the bound is plain.
    slopes = np.asarray(jax.jacfwd(space.natural)(at), float)
    inverse, unit, flat = _inverse(curvatures.sum(axis=0))
    moves = centred @ inverse @ slopes.T
    is_untold = np.any(np.abs(_directions(slopes @ unit) @ flat) > _MOSTLY, axis=1)

    rng = np.random.default_rng(_SEED)
    steps = []
    for _ in range(_REPLICATES):
        weight = rng.multinomial(sessions, np.full(sessions, 1 / sessions))
        curvature = np.einsum("i,ipq->pq", weight, curvatures)
        steps.append(-slopes @ _inverse(curvature)[0] @ (weight @ centred))
    drawn = space.within(np.asarray(space.natural(at), float), np.array(steps))
    low, high = np.quantile(drawn, [(1 - _LEVEL) / 2, (1 + _LEVEL) / 2], axis=0)
    error = np.where(is_untold, np.inf, np.sqrt(np.sum(moves**2, axis=0)))
    least, most = space.ranges
    return Errors(
        error, np.where(is_untold, least, low), np.where(is_untold, most, high), drawn
    )


def _directions(rows: Float[np.ndarray, "rows n"]) -> Float[np.ndarray, "rows n"]:
    length = np.linalg.norm(rows, axis=1, keepdims=True)
    return rows / np.where(length > 0, length, 1.0)


def _inverse(
    curvature: Float[np.ndarray, "n n"],
) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n n"], np.ndarray]:
    """Inverse over the directions that are curved; the units; the flat directions.

    Each number counts in the unit that its own curvature gives it. Next to a bound the
    sum may be curved downwards in a logit: then the size of its curvature counts, so
    that Newton's step leads down as well.
    """
    curvature = (curvature + curvature.T) / 2
    own = np.abs(np.diag(curvature))
    unit = np.diag(1 / np.sqrt(np.where(own > 0, own, max(own.max(), 1.0))))
    values, vectors = np.linalg.eigh(unit @ curvature @ unit)
    size = np.abs(values)
    is_curved = size > _FLAT * size.max()
    scale = np.where(is_curved, 1 / np.where(is_curved, size, 1.0), 0.0)
    inverse = unit @ (vectors * scale) @ vectors.T @ unit
    return inverse, unit, vectors[:, ~is_curved]
