"""The parts of which a head's angle is the sum.

Each part is a linear Gaussian process of two states, its angle and its velocity:

- `wander`: an Ornstein-Uhlenbeck velocity, integrated to an angle that a weak
  spring returns, `dv = -v / tau dt + sqrt(2 s^2 / tau) dW`, `dx = (v - x / T_r) dt`;
- `resonance`: a damped mode `x'' + 2 z w0 x' + w0^2 x = sqrt(4 z w0) s dW / dt`.

A state is `(x, v)` in units of `s tau` and `s`, or of `s / w0` and `s`: without units
its numbers stay near 1 at every rate. Arrays are `(parts, 3, ...)`, axes ordered pitch
(x), yaw (y), roll (z).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._types import Scalar
from .discretisation import discretise

_ThreeNumbers = Float[Array, "3"]


class Parts(NamedTuple):
    """The parts of an angle as linear systems `dz = drift z dt + L dW`."""

    angle_unit_deg: Float[Array, "parts 3"]
    drift: Float[Array, "parts 3 2 2"]
    diffusion: Float[Array, "parts 3 2 2"]
    stationary: Float[Array, "parts 3 2 2"]

    def sampled(self, dt_s: Scalar) -> tuple[Array, Array]:
        """Transition minus identity over `dt_s`, and the covariance of its noise."""
        each = jax.vmap(jax.vmap(discretise, (0, 0, None)), (0, 0, None))
        return each(self.drift, self.diffusion, dt_s)


def wander(
    speed_rms_deg_s: _ThreeNumbers,
    correlation_time_s: _ThreeNumbers,
    return_time_s: Scalar,
) -> Parts:
    """Ornstein-Uhlenbeck velocity and its weakly sprung integral; one part."""
    # The angle is white noise through two exponentials, whose order does not matter to
    # it. The faster one comes first: else velocity and spring would nearly cancel.
    return_time_s = jnp.full_like(correlation_time_s, return_time_s)
    is_swapped = return_time_s < correlation_time_s
    fast_s = jnp.where(is_swapped, return_time_s, correlation_time_s)
    slow_s = jnp.where(is_swapped, correlation_time_s, return_time_s)
    gain = jnp.where(is_swapped, jnp.sqrt(fast_s / slow_s), 1.0)
    a, b = 1 / fast_s, 1 / slow_s
    kept = slow_s / (fast_s + slow_s)
    zero, one = jnp.zeros_like(a), jnp.ones_like(a)
    return Parts(
        (gain * speed_rms_deg_s * fast_s)[None],
        drift=_matrices([-b, a], [zero, -a]),
        diffusion=_matrices([zero, zero], [zero, 2 * a]),
        stationary=_matrices([slow_s / fast_s * kept, kept], [kept, one]),
    )


def resonance(
    speed_rms_deg_s: _ThreeNumbers,
    frequency_hz: _ThreeNumbers,
    damping: _ThreeNumbers,
) -> Parts:
    """Damped mode, driven by white noise; one part."""
    w0 = 2 * jnp.pi * frequency_hz
    zero, one = jnp.zeros_like(w0), jnp.ones_like(w0)
    return Parts(
        (speed_rms_deg_s / w0)[None],
        drift=_matrices([zero, w0], [-w0, -2 * damping * w0]),
        diffusion=_matrices([zero, zero], [zero, 4 * damping * w0]),
        stationary=_matrices([one, zero], [zero, one]),
    )


def _matrices(*rows: list[_ThreeNumbers]) -> Float[Array, "1 3 2 2"]:
    return jnp.moveaxis(jnp.array(rows), -1, 0)[None]


def joined(*parts: Parts) -> Parts:
    """All parts of an angle in one."""
    return Parts(*(jnp.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def apply(matrices: Float[Array, "... 2 2"], states: Float[Array, "... 2"]) -> Array:
    """Multiply each state by its matrix."""
    # A sum of products, as a matrix product would be rounded to TF32 on some devices.
    return jnp.sum(matrices * states[..., None, :], axis=-1)
