"""Draw paths of a head: a person, an amplitude, the parts' states, the tracker."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._types import Path, RandomKey, Scalar
from .components import Parts, apply

_Series = Float[Array, " frames"]


class Bursts(NamedTuple):
    """Spread and correlation time, s, of the logarithm of the amplitude."""

    sd: Float[Array, ""]
    correlation_time_s: Float[Array, ""]


def draw(
    key: RandomKey,
    parts: Parts,
    tracker_noise_deg: Float[Array, "3"],
    person_sd: Float[Array, ""],
    bursts: Bursts | None,
    frame_time_s: Scalar,
    frames: int,
) -> Path:
    """Draw a person's path, deg, shape `(frames, 3)`."""
    person_key, path_key = jax.random.split(key)
    dtype = parts.drift.dtype
    change, covariance = parts.sampled(frame_time_s)
    spread = jnp.linalg.cholesky(covariance)

    # Per frame and axis one draw for the tracker and two for each part, the first
    # frame's for its start; per frame one for the amplitude. All from one call:
    # generators are slow to compile.
    shape = (frames, *parts.angle_unit_deg.shape, 2)
    of_parts = 2 * parts.angle_unit_deg.size
    count = 3 + of_parts + (bursts is not None)
    noise = jax.random.normal(path_key, (frames, count), dtype)
    of_tracker = noise[:, :3]
    driving = noise[:, 3 : 3 + of_parts].reshape(shape)
    if bursts is not None:
        amplitude = _amplitude(bursts, noise[:, -1], frame_time_s)
        driving = amplitude[:, None, None, None] * driving
    start = apply(jnp.linalg.cholesky(parts.stationary), driving[0])

    def step(state: Array, driving: Array) -> tuple[Array, Array]:
        state = state + apply(change, state) + apply(spread, driving)
        return state, state[..., 0]

    _, path = jax.lax.scan(step, start, driving[1:])
    path = jnp.concatenate([start[None, ..., 0], path])
    scale = jnp.exp(person_sd * jax.random.normal(person_key, (), dtype))
    angle_deg = jnp.sum((scale * parts.angle_unit_deg)[None] * path, axis=1)
    return angle_deg + tracker_noise_deg[None] * of_tracker


def _amplitude(bursts: Bursts, noise: _Series, frame_time_s: Scalar) -> _Series:
    """Amplitude `exp(sd m - sd^2)` of each frame; its square is 1 on average."""
    step = -frame_time_s / bursts.correlation_time_s
    forgotten, spread = jnp.expm1(step), jnp.sqrt(-jnp.expm1(2 * step))

    def next_level(level: Array, noise: Array) -> tuple[Array, Array]:
        level = level + forgotten * level + spread * noise
        return level, level

    _, levels = jax.lax.scan(next_level, noise[0], noise[1:])
    levels = jnp.concatenate([noise[:1], levels])
    return jnp.exp(bursts.sd * levels - bursts.sd**2)
