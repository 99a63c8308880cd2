"""Rival: JAX as one would write it first, `vmap` over `map_coordinates`."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.ndimage import map_coordinates
from serving import Run, serve
from task import W_LB, W_MIN, Task


def _warp(picture: jax.Array, homography: jax.Array) -> jax.Array:
    """Read planes `(3, side, side)` where a homography says, edges repeated."""
    side = picture.shape[-1]
    y, x = jnp.mgrid[:side, :side].astype(jnp.float32)
    x, y, depth = jnp.einsum("ij,jyx->iyx", homography, jnp.stack([x, y, x * 0 + 1]))
    read = lambda plane: map_coordinates(plane, [y / depth, x / depth], 1, "nearest")
    return jax.vmap(read)(picture)


def _session(texture, current, past, ease) -> jax.Array:
    def step(displayed, now):
        current, past, ease = now
        picture, history = _warp(texture, current), _warp(displayed, past)
        difference = jnp.sqrt(jnp.sum((picture - history) ** 2, axis=0) / 3)
        minimum = W_MIN - (W_MIN - W_LB) * difference
        weight = minimum + (1 - minimum) * ease
        shown = history + weight * (picture - history)
        distance = jnp.sqrt(jnp.sum((shown - displayed) ** 2, axis=0))
        return shown, jnp.mean(distance)

    first = _warp(texture, current[0])
    _, distances = jax.lax.scan(step, first, (current[1:], past[1:], ease[1:]))
    return 255 * jnp.mean(distances)


def build(task: Task) -> Run:
    """One program; XLA's own threads."""
    arrays = (np.moveaxis(task.texture, -1, 0), task.current, task.past, task.ease)
    arguments = [jnp.asarray(array, jnp.float32) for array in arrays]
    run = jax.jit(jax.vmap(_session, (None, 0, 0, 0)))
    return lambda: np.asarray(run(*arguments))


if __name__ == "__main__":
    serve(build)
