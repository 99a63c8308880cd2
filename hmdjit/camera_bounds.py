"""How far pixels of a region move when the head turns; never too narrow."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from . import quaternion
from ._types import RotationVector
from .camera import Camera, Region


class _Interval(eqx.Module):
    low: Array
    high: Array

    def __add__(self, other: "_Interval") -> "_Interval":
        return _Interval(self.low + other.low, self.high + other.high)

    def __mul__(self, other: "_Interval") -> "_Interval":
        mine, others = (self.low, self.high), (other.low, other.high)
        ends = [a * b for a in mine for b in others]
        lowest = functools.reduce(jnp.minimum, ends)
        return _Interval(lowest, functools.reduce(jnp.maximum, ends))


@jax.jit
def displacement_range(
    camera: Camera,
    region: Region,
    rotation: RotationVector,
    shift: Float[Array, ""] | None = None,
) -> Float[Array, "2 2"]:
    """Smallest and largest displacement of a region's pixels; never too narrow.

    **Arguments:**

    - `rotation`: rotation vector applied to the rays, rad, shape `(3,)`.
    - `shift`: how far what they see moves at most besides, in any direction, over its
      depth.

    **Returns:** `((dx low, dy low), (dx high, dy high))`, px; -inf to inf if a part of
    the region may turn out of the half-space in front of the camera.

    **Source:** interval arithmetic on the formula of `displacement`.
    """
    dtype = rotation.dtype
    focal = jnp.asarray(camera.focal_px, dtype)
    left = jnp.asarray(region.x0, dtype) - camera.width_px / 2
    top = camera.height_px / 2 - jnp.asarray(region.y0, dtype)
    x = _Interval(left / focal, (left + region.width) / focal)
    y = _Interval((top - region.height) / focal, top / focal)
    turn = quaternion.matrix_minus_identity(rotation)

    def constant(value: Array) -> _Interval:
        return _Interval(value, value)

    move_x, move_y, move_z = (
        constant(row[0]) * x + constant(row[1]) * y + constant(-row[2]) for row in turn
    )
    if shift is not None:
        aside = _Interval(-shift, shift)
        move_x, move_y, move_z = move_x + aside, move_y + aside, move_z + aside
    depth = _Interval(1 - move_z.high, 1 - move_z.low)
    is_in_front = depth.low > 0
    nearest = jnp.where(is_in_front, depth.low, 1.0)
    scale = _Interval(focal / jnp.where(is_in_front, depth.high, 1.0), focal / nearest)
    dx = (move_x + x * move_z) * scale
    dy = (move_y + y * move_z) * scale  # upwards
    # Rounding: a few eps of the terms that the sums are made of.
    sizes = jnp.stack([_size(x), _size(y), jnp.ones_like(focal)])
    largest_x, largest_y, largest_z = jnp.sum(jnp.abs(turn) * sizes[None], axis=1)
    terms = jnp.stack(
        [largest_x + _size(x) * largest_z, largest_y + _size(y) * largest_z]
    )
    if shift is not None:
        terms = terms + shift * (1 + jnp.stack([_size(x), _size(y)]))
    slack = 32 * jnp.finfo(dtype).eps * terms * scale.high
    low = jnp.stack([dx.low, -dy.high]) - slack
    high = jnp.stack([dx.high, -dy.low]) + slack
    span = jnp.stack([low, high])
    everything = jnp.asarray([[-jnp.inf] * 2, [jnp.inf] * 2], dtype)
    return jnp.where(is_in_front, span, everything)


def _size(interval: _Interval) -> Array:
    return jnp.maximum(jnp.abs(interval.low), jnp.abs(interval.high))


@jax.jit
def displacement_bound(
    camera: Camera, region: Region, rotation: RotationVector
) -> Float[Array, "2"]:
    """Return the largest |dx| and |dy| of `displacement_range`, px, shape `(2,)`."""
    return jnp.max(jnp.abs(displacement_range(camera, region, rotation)), axis=0)
