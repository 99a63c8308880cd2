"""Draw paths of a head: a person, an amplitude, the parts' states, the tracker."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._types import Path, RandomKey, Scalar
from .components import Parts, apply
from .parameters import Amplitude

# Longer than a burst, and than what the velocity remembers.
_RUN_IN_STEPS, _RUN_IN_STEP_S = 16, 0.1


def draw(
    key: RandomKey,
    parts: Parts,
    tracker_noise_deg: Float[Array, "3"],
    person_sd: Float[Array, ""],
    bursts: Amplitude | None,
    frame_time_s: Scalar,
    frames: int,
) -> Path:
    """Draw a person's path, deg, shape `(frames, 3)`."""
    person_key, path_key = jax.random.split(key)
    dtype = parts.drift.dtype
    change, covariance = parts.sampled(frame_time_s)
    spread = jnp.linalg.cholesky(covariance)

    # Per frame and axis one draw for the tracker and two for each part; per frame one
    # for the amplitude. All from one call: generators are slow to compile.
    shape = (*parts.angle_unit_deg.shape, 2)
    of_parts = 2 * parts.angle_unit_deg.size
    steps = frames if bursts is None else frames + _RUN_IN_STEPS
    count = 3 + of_parts + (bursts is not None)
    noise = jax.random.normal(path_key, (steps, count), dtype)
    of_tracker = noise[-frames:, :3]
    driving = noise[:, 3 : 3 + of_parts].reshape(steps, *shape)

    def step(state: Array, driving: Array) -> tuple[Array, Array]:
        state = state + apply(change, state) + apply(spread, driving)
        return state, state[..., 0]

    run_in_s = jnp.asarray(_RUN_IN_STEP_S, dtype)
    if bursts is not None:
        # The first frame remembers former bursts: steps long enough to have them do.
        step_s = jnp.where(
            jnp.arange(steps) < _RUN_IN_STEPS + 1, run_in_s, frame_time_s
        )
        amplitude = _amplitude(bursts, noise[:, -1], step_s)
        driving = amplitude[:, None, None, None] * driving
    start = apply(jnp.linalg.cholesky(parts.stationary), driving[0])
    if bursts is not None:
        long_change, long_covariance = parts.sampled(run_in_s)
        long_spread = jnp.linalg.cholesky(long_covariance)

        def long_step(state: Array, driving: Array) -> tuple[Array, None]:
            moved = apply(long_change, state) + apply(long_spread, driving)
            return state + moved, None

        start, _ = jax.lax.scan(long_step, start, driving[1 : _RUN_IN_STEPS + 1])

    _, path = jax.lax.scan(step, start, driving[steps - frames + 1 :])
    path = jnp.concatenate([start[None, ..., 0], path])
    scale = jnp.exp(person_sd * jax.random.normal(person_key, (), dtype))
    angle_deg = jnp.sum((scale * parts.angle_unit_deg)[None] * path, axis=1)
    return angle_deg + tracker_noise_deg[None] * of_tracker


def _amplitude(
    bursts: Amplitude, noise: Float[Array, " steps"], step_s: Float[Array, " steps"]
) -> Float[Array, " steps"]:
    """Amplitude `exp(sd m - sd^2)` of each step; its square is 1 on average."""
    step = -step_s / bursts.correlation_time_s
    forgotten, spread = jnp.expm1(step), jnp.sqrt(-jnp.expm1(2 * step))

    def next_level(level: Array, inputs: tuple[Array, Array]) -> tuple[Array, Array]:
        forgotten, driven = inputs
        level = level + forgotten * level + driven
        return level, level

    inputs = (forgotten[1:], (spread * noise)[1:])
    _, levels = jax.lax.scan(next_level, noise[0], inputs)
    levels = jnp.concatenate([noise[:1], levels])
    return jnp.exp(bursts.sd * levels - bursts.sd**2)
