"""Exact sampling of linear Gaussian processes, which the head models are made of."""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._types import Scalar

_Matrix = Float[Array, "states states"]

# On a step with |drift| h <= 1/16 the first term left out of both series is below
# 1e-16 of every entry of a double integrator, and 64 doublings of such a step cover
# |drift| dt up to 2^60 = 1e18: a step of 1e12 s over modes of microseconds.
_SHORT_STEP = 1 / 16
_SERIES_TERMS = 10
_DOUBLINGS = 64


@jax.jit
def discretise(
    drift: _Matrix, diffusion: _Matrix, dt_s: Scalar
) -> tuple[_Matrix, _Matrix]:
    """Sample a linear Gaussian process `dz = drift z dt + L dW` exactly.

    **Arguments:**

    - `drift`: 1/s where states have no units; shape `(states, states)`; its eigenvalues
      must not lie right of the imaginary axis.
    - `diffusion`: `L L^T`, shape `(states, states)`, symmetric, not negative.
    - `dt_s`: time between samples, s, at least 0; more than `2^60 / |drift|` counts
      as that much.

    **Returns:** `expm(drift dt) - I`, which keeps the digits that the transition matrix
    loses on short steps, and the covariance of what the noise adds in `dt`; both of
    shape `(states, states)`.

    **Accuracy:** about 20 eps. Of each entry where none of the transition's is negative
    (chains of integrators), else of the largest; what `dt` lets the process forget is
    right to 20 eps of what it was.

    **Source:** Van Loan, "Computing Integrals Involving the Matrix Exponential", IEEE
    TAC 23(3), 1978, by doubling a short step instead of a block exponential, which
    cancels in stiff systems.
    """
    matmul = partial(jnp.matmul, precision=jax.lax.Precision.HIGHEST)
    dtype = drift.dtype
    identity = jnp.eye(drift.shape[0], dtype=dtype)
    rate = jnp.max(jnp.sum(jnp.abs(jax.lax.stop_gradient(drift)), axis=1))
    dt_s = jnp.minimum(dt_s, _SHORT_STEP * 2.0**_DOUBLINGS / rate)
    # The result does not depend on how often the step is halved: no gradient is lost.
    halvings = jnp.log2(rate * jax.lax.stop_gradient(dt_s) / _SHORT_STEP)
    halvings = jnp.clip(jnp.ceil(halvings), 0, _DOUBLINGS).astype(jnp.int32)
    short_s = dt_s * jnp.ldexp(jnp.ones((), dtype), -halvings)

    # expm(A h) - I = A h + (A h)^2 / 2! + ...; Q(h) = D h + (A D + D A') h^2 / 2! + ...
    step = drift * short_s

    def add_term(terms_and_sums, order):
        power, term, change, covariance = terms_and_sums
        power = matmul(power, step) / order
        turned = matmul(step, term)
        term = (turned + turned.T) / order
        return (power, term, change + power, covariance + term), None

    first = (step, diffusion * short_s)
    orders = jnp.arange(2, _SERIES_TERMS + 2, dtype=dtype)
    (_, _, *sums), _ = jax.lax.scan(add_term, (*first, *first), orders)

    def double(i, sums):
        change, covariance = sums
        transition = identity + change
        spread = matmul(matmul(transition, covariance), transition.T)
        return (
            jnp.where(i < halvings, 2 * change + matmul(change, change), change),
            jnp.where(i < halvings, covariance + spread, covariance),
        )

    change, covariance = jax.lax.fori_loop(0, _DOUBLINGS, double, tuple(sums))
    return change, (covariance + covariance.T) / 2
