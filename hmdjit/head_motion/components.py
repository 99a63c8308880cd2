"""The parts of which a head's angle is the sum, and the laws of that sum.

Each part is a linear Gaussian process of two states, its angle and its velocity:

- `wander`: an Ornstein-Uhlenbeck velocity, integrated to an angle that a weak
  spring returns, `dv = -v / tau dt + sqrt(2 s^2 / tau) dW`, `dx = (v - x / T_r) dt`;
- `resonance`: a damped mode `x'' + 2 z w0 x' + w0^2 x = sqrt(4 z w0) s dW / dt`.

A state is `(x, v)` in units of `s tau` and `s`, or of `s / w0` and `s`: without units
its numbers stay near 1 at every rate. Arrays are `(parts, 3, ...)`, axes ordered pitch
(x), yaw (y), roll (z); laws are sums over the parts, `(..., 3)`.
"""

from functools import partial
from typing import Any, NamedTuple

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


def _sum(parts: Parts, law: Float[Array, "parts 3"]) -> _ThreeNumbers:
    return jnp.sum(parts.angle_unit_deg**2 * law, axis=0)


_each = partial(jnp.vectorize, signature="()->(3)")


def covariance(parts: Parts, lag_s: Array) -> Float[Array, "*lags 3"]:
    """Covariance of the angle with itself `lag_s` later, deg^2."""

    def law(lag_s: Scalar) -> _ThreeNumbers:
        # In the wander all terms are positive: nothing cancels.
        change, _ = parts.sampled(jnp.abs(lag_s))
        start = parts.stationary[..., 0]
        return _sum(parts, (start + apply(change, start))[..., 0])

    return _each(law)(lag_s)


def structure_function(parts: Parts, lag_s: Array) -> Float[Array, "*lags 3"]:
    """Mean squared turn of the angle within `lag_s`, deg^2."""

    def law(lag_s: Scalar) -> _ThreeNumbers:
        return _sum(parts, _turn_variance(parts, *parts.sampled(jnp.abs(lag_s))))

    return _each(law)(lag_s)


def _turn_variance(parts: Parts, change: Array, noise: Array) -> Array:
    # The turn is `change[0] @ state + noise`, in terms of the state before it: a sum of
    # positive terms, where differences of `covariance` would cancel.
    turn = change[..., 0, :]
    return jnp.sum(turn * apply(parts.stationary, turn), axis=-1) + noise[..., 0, 0]


def increment_covariance(
    parts: Parts, lag_frames: Array, rate_hz: Scalar
) -> Float[Array, "*lags 3"]:
    """Covariance of frame-to-frame turns `lag_frames` apart, deg^2."""
    dtype = parts.drift.dtype
    frame_time_s = 1 / jnp.asarray(rate_hz, dtype)
    change, noise = parts.sampled(frame_time_s)
    turn = change[..., 0, :]
    variance = _turn_variance(parts, change, noise)
    before = apply(parts.stationary, turn)
    after = before + apply(change, before) + noise[..., 0]
    # Stationary: the angle after a turn covaries with it by half its variance.
    after = after.at[..., 0].set(variance / 2)

    def law(lag: Array) -> _ThreeNumbers:
        lag = jnp.abs(lag)
        between_s = jnp.maximum(lag - 1, 0).astype(dtype) * frame_time_s
        later = after + apply(parts.sampled(between_s)[0], after)
        ahead = jnp.sum(turn * later, axis=-1)
        return _sum(parts, jnp.where(lag == 0, variance, ahead))

    return _each(law)(lag_frames)


def velocity_spectrum(parts: Parts, frequency_hz: Array) -> Float[Array, "*freqs 3"]:
    """One-sided spectral density of the angle's velocity, (deg/s)^2/Hz."""
    # dx = (m00 x + m01 v) dt, dv = (m10 x + m11 v) dt + sqrt(d) dW, by Cramer's rule.
    m00, m01 = parts.drift[..., 0, 0], parts.drift[..., 0, 1]
    m10, m11 = parts.drift[..., 1, 0], parts.drift[..., 1, 1]
    speed_deg_s = parts.angle_unit_deg * m01

    def law(frequency_hz: Scalar) -> _ThreeNumbers:
        w = 2 * jnp.pi * frequency_hz
        real = m00 * m11 - m01 * m10 - w**2
        imaginary = w * (m00 + m11)
        # Over the larger one: w^4 and its slope span more than float32 does.
        size = jnp.maximum(jnp.abs(real), jnp.abs(imaginary))
        over = jax.lax.stop_gradient(jnp.where(size > 0, size, 1.0))
        squares = (real / over) ** 2 + (imaginary / over) ** 2
        response = parts.diffusion[..., 1, 1] * (speed_deg_s * (w / over)) ** 2
        return 2 * jnp.sum(response / squares, axis=0)

    return _each(law)(frequency_hz)


def sampled_velocity_spectrum(
    parts: Parts, frequency_hz: Array, rate_hz: Scalar
) -> Float[Array, "*freqs 3"]:
    """One-sided density of the frame-difference velocity, (deg/s)^2/Hz."""
    rate_hz = jnp.asarray(rate_hz, parts.drift.dtype)
    change, noise = parts.sampled(1 / rate_hz)
    spread = jnp.linalg.cholesky(noise)
    c00, c01 = change[..., 0, 0], change[..., 0, 1]
    c10, c11 = change[..., 1, 0], change[..., 1, 1]

    def law(frequency_hz: Scalar) -> _ThreeNumbers:
        # The state is (z - transition)^-1 spread w of white w, z on the unit circle;
        # the turn is (z - 1) x. All in squares, by z - 1 = real + i imaginary.
        phase = 2 * jnp.pi * frequency_hz / rate_hz
        real, imaginary = -2 * jnp.sin(phase / 2) ** 2, jnp.sin(phase)
        first = (real - c11) * spread[..., 0, 0] + c01 * spread[..., 1, 0]
        second = c01 * spread[..., 1, 1]
        across = imaginary * spread[..., 0, 0]
        determinant_real = (real - c00) * (real - c11) - c01 * c10 - imaginary**2
        determinant_imaginary = imaginary * (2 * real - c00 - c11)
        # All over the determinant's size: its square may be too small for float32.
        size = jnp.maximum(jnp.abs(determinant_real), jnp.abs(determinant_imaginary))
        size = jax.lax.stop_gradient(size)
        over = lambda *terms: sum((term / size) ** 2 for term in terms)
        turn_deg = 2 * jnp.sin(phase / 2) * parts.angle_unit_deg
        power = over(turn_deg * first, turn_deg * across, turn_deg * second)
        power = power / over(determinant_real, determinant_imaginary)
        return 2 * rate_hz * jnp.sum(power, axis=0)

    return _each(law)(frequency_hz)


def turn_memory(
    parts: Parts, rate_hz: Scalar, frames: int
) -> Float[Array, "{frames} 3"]:
    """Variance that one frame's noise gives to the turn `lag` frames later, deg^2."""
    change, noise = parts.sampled(1 / jnp.asarray(rate_hz, parts.drift.dtype))
    spread = jnp.linalg.cholesky(noise)
    unit_deg = parts.angle_unit_deg[None, :, :, None]
    first = unit_deg * jnp.moveaxis(spread, -1, 0)  # (2 sources, parts, 3, 2)
    moved = jax.vmap(apply, (None, 0))

    def later(state: Array, _: Any) -> tuple[Array, Array]:
        turn = moved(change, state)
        return state + turn, turn[..., 0]

    _, turns = jax.lax.scan(later, first, length=frames - 1)
    turns = jnp.concatenate([first[None, ..., 0], turns])
    return jnp.sum(turns**2, axis=(1, 2))
