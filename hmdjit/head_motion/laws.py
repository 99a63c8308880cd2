"""Laws of a head's angle: sums over its parts, and what the tracker adds to them.

Results are per axis, `(..., 3)`, ordered pitch, yaw, roll. `tracker_deg` is the RMS of
the white noise that each sampled frame's angle has, deg.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._types import Scalar
from .components import Parts, apply
from .parameters import Amplitude

_ThreeNumbers = Float[Array, "3"]


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
    parts: Parts, tracker_deg: _ThreeNumbers, lag_frames: Array, rate_hz: Scalar
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

    # Neighbours share one noise value, with opposite signs.
    lags = [lag_frames == 0, jnp.abs(lag_frames) == 1]
    shared = jnp.select(lags, [2, -1], 0).astype(dtype)
    return _each(law)(lag_frames) + jnp.multiply.outer(shared, tracker_deg**2)


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


def tracker_spectrum(
    tracker_deg: _ThreeNumbers, frequency_hz: Array, rate_hz: Scalar
) -> Float[Array, "*freqs 3"]:
    """Density of the tracker's noise in the frame-difference velocity."""
    filtered = 8 * rate_hz * jnp.sin(jnp.pi * frequency_hz / rate_hz) ** 2
    return jnp.multiply.outer(filtered, tracker_deg**2)


def sampled_velocity_spectrum(
    parts: Parts, tracker_deg: _ThreeNumbers, frequency_hz: Array, rate_hz: Scalar
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

    seen = tracker_spectrum(tracker_deg, frequency_hz, rate_hz)
    return _each(law)(frequency_hz) + seen


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


def increment_kurtosis(
    parts: Parts,
    tracker_deg: _ThreeNumbers,
    amplitude: Amplitude,
    rate_hz: Scalar,
    frames: int,
) -> _ThreeNumbers:
    """Excess kurtosis of frame-to-frame turns, of what `frames` remember.

    Given the amplitude an increment is normal: its kurtosis is 3 times the relative
    variance of its variance, the sum of what each frame's noise gives times a^2, with
    cov(a^2, a'^2) = exp(4 sd^2 correlation) - 1.
    """
    dtype = parts.drift.dtype
    # It has no unit: in units of the largest part no square is too small for float32.
    unit = jnp.maximum(jnp.max(parts.angle_unit_deg, axis=0), tracker_deg)
    unit = jax.lax.stop_gradient(jnp.where(unit > 0, unit, 1.0))
    parts = parts._replace(angle_unit_deg=parts.angle_unit_deg / unit[None])
    given = turn_memory(parts, rate_hz, frames)
    total = jnp.sum(given, axis=0) + 2 * (tracker_deg / unit) ** 2
    # Over its own size first: a quotient's slope divides by the square of its divisor,
    # which here is too small for float32.
    size = jax.lax.stop_gradient(jnp.where(total > 0, total, 1.0))
    given, total = given / size[None], total / size
    given = given / jnp.where(total > 0, total, 1.0)[None]
    pairs = jax.vmap(partial(jax.scipy.signal.correlate, method="fft"), 1, 1)
    pairs = pairs(given, given)  # by lag, from 1 - frames to frames - 1
    lag_s = jnp.abs(jnp.arange(1 - frames, frames)).astype(dtype) / rate_hz
    correlation = jnp.exp(-lag_s / jnp.asarray(amplitude.correlation_time_s, dtype))
    shared = jnp.expm1(4 * jnp.asarray(amplitude.sd, dtype) ** 2 * correlation)
    return 3 * jnp.sum(pairs * shared[:, None], axis=0)
