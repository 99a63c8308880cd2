"""Searching a space of curves: least squares by Levenberg-Marquardt.

Sessions are read by slices, which must not be vectorised, and a curve has few numbers:
so residuals and all their slopes are measured together, once per step, and what the
solver asks of derivatives are products with these slopes.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array, Float

from ..simulation.sharding import program

Numbers = Float[np.ndarray, " numbers"]
Linearize = Callable[
    [Float[Array, " numbers"]],
    tuple[Float[Array, " residuals"], Float[Array, "residuals numbers"]],
]
"""Point to residuals, whose squares are summed, and their slopes; a pytree."""

CONVERGED = "converged"

_GAIN = 10.0  # of residuals and slopes, as the solver gets them


class NoFitError(ValueError):
    """There is nothing to fit, or no curve fits; says why."""


class Found(NamedTuple):
    """Where a search ended.

    - `point`: the best one that it saw.
    - `steps`: how often residuals were measured.
    - `why`: `"converged"`, or in words why not.
    """

    point: Numbers
    steps: int
    why: str


def least_squares(
    linearize: Linearize,
    start: Numbers,
    *,
    tolerance: float = 1e-3,
    most_steps: int = 30,
) -> Found:
    """Minimise a sum of squares from a start.

    **Arguments:**

    - `linearize`: its arrays are leaves, so that others of the same shapes compile
      once. Curvatures, sums of squared slopes, should be of the order of 0.1.
    - `tolerance`: of the point, relative and absolute, between accepted steps; of the
      residuals too, ten times as large.

    **Errors:** `NoFitError` where residuals or slopes at the start are not finite.

    **Source:** Levenberg-Marquardt with a trust region, of `optimistix`.
    """
    # In JAX's own precision: the solver's other numbers have it.
    begun = jnp.asarray(start, jnp.result_type(float))
    point, steps, result, is_good = _solved(
        linearize, begun, tolerance=tolerance, most_steps=most_steps
    )
    if not is_good:
        raise NoFitError("the search met a curve that gives no finite number.")
    why = CONVERGED
    if result == optimistix.RESULTS.nonlinear_max_steps_reached:
        why = f"stopped after {steps} steps"
    elif result != optimistix.RESULTS.successful:
        why = optimistix.RESULTS[result]
    return Found(np.asarray(point), int(steps), why)


@program("tolerance", "most_steps")
def _solved(
    linearize: Linearize,
    start: Float[Array, " numbers"],
    *,
    tolerance: float,
    most_steps: int,
) -> tuple[Array, Array, optimistix.RESULTS, Array]:
    """Return the point, the steps, how it ended, and whether its start is finite."""

    # One piece to JAX, which else splits the sessions' loops into what does and what
    # does not depend on the tangents, and takes fifty times as long.
    @jax.custom_batching.sequential_vmap
    def with_slopes(point: Array, linearize: Linearize) -> tuple[Array, Array]:
        found, slopes = linearize(point)
        # Points with NaN in either are never accepted; that at the start is seen.
        is_finite = jnp.isfinite(found).all() & jnp.isfinite(slopes).all()
        # The solver's first damping is 1: a tenth of the curvatures, so enlarged.
        return jnp.where(is_finite, _GAIN * found, jnp.nan), _GAIN * slopes

    @jax.custom_jvp
    def residuals(point: Array, linearize: Linearize) -> Array:
        return with_slopes(point, linearize)[0]

    @residuals.defjvp
    def _(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
        found, slopes = with_slopes(*primals)
        return found, slopes @ tangents[0]

    def with_finiteness(point: Array, linearize: Linearize) -> tuple[Array, Array]:
        found = residuals(point, linearize)
        return found, jnp.isfinite(found).all()

    solution = optimistix.least_squares(
        with_finiteness,
        optimistix.LevenbergMarquardt(rtol=tolerance, atol=tolerance),
        start,
        args=linearize,
        has_aux=True,
        max_steps=most_steps,
        throw=False,
    )
    steps = solution.stats["num_steps"]
    return solution.value, steps, solution.result, solution.aux
