"""What lies around each pixel: shifted planes, means, sharpening.

Beyond the planes' edge lies what is at the edge. *Plus* is a pixel with its four
neighbours, *box* the 3 x 3 block.
"""

from collections.abc import Callable

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Shaped

AnyPlanes = Shaped[Array, "*planes height width"]
FloatPlanes = Float[Array, "*planes height width"]

Reader = Callable[[int, int], AnyPlanes]
"""Planes read `dx` px to the right and `dy` px down of each pixel."""


def shifted(
    planes: AnyPlanes, dx: int, dy: int, outside: float | bool | None = None
) -> AnyPlanes:
    """Planes read `dx` px to the right and `dy` px down of each pixel.

    For one or two reads; `around` is for many.

    **Arguments:**

    - `planes`: `(height, width)` or `(channels, height, width)`, of any dtype.
    - `dx`, `dy`: whole numbers that are known while compiling.
    - `outside`: what lies beyond the edge; None is what is at the edge.
    """
    return _shifted(_shifted(planes, dx, -1, outside), dy, -2, outside)


def _shifted(
    planes: AnyPlanes, by: int, axis: int, outside: float | bool | None
) -> AnyPlanes:
    size = planes.shape[axis]
    by = max(-size, min(by, size))
    if by == 0:
        return planes
    kept = lax.slice_in_dim(planes, max(by, 0), size + min(by, 0), axis=axis)
    at = size - 1 if by > 0 else 0
    edge = lax.slice_in_dim(planes, at, at + 1, axis=axis)
    if outside is not None:
        edge = jnp.full_like(edge, outside)
    beyond = jnp.repeat(edge, abs(by), axis=axis)
    return jnp.concatenate([kept, beyond] if by > 0 else [beyond, kept], axis=axis)


def around(planes: AnyPlanes, radius_px: int) -> Reader:
    """Return `shifted(planes, dx, dy)` as a function of `dx` and `dy`.

    **Arguments:** `radius_px`: the farthest that is asked for, in each direction.
    """
    # Kept whole, so that reads are plain slices of it: twice as fast on a CPU.
    return reader(
        lax.optimization_barrier(padded(planes, radius_px, radius_px)), radius_px
    )


def reader(planes: AnyPlanes, margin_px: int, more_px: int = 0) -> Reader:
    """Return what reads planes that have a margin.

    **Arguments:** `more_px`: columns and rows that are read beyond the planes' end.
    """
    height, width = (size - 2 * margin_px + more_px for size in planes.shape[-2:])

    def at(dx: int, dy: int) -> AnyPlanes:
        left, top = margin_px + dx, margin_px + dy
        return planes[..., top : top + height, left : left + width]

    return at


def padded(
    planes: AnyPlanes, columns_px: int, rows_px: int
) -> Shaped[Array, "*planes rows columns"]:
    """Repeat the edge pixels: columns to the left and right, rows above and below."""
    widths = [(0, 0)] * (planes.ndim - 2) + [(rows_px,) * 2, (columns_px,) * 2]
    return jnp.pad(planes, widths, mode="edge")


def neighbors(planes: AnyPlanes) -> tuple[AnyPlanes, AnyPlanes, AnyPlanes, AnyPlanes]:
    """Return the pixels above, below, to the left and to the right of each."""
    at = around(planes, 1)
    return at(0, -1), at(0, 1), at(-1, 0), at(1, 0)


def plus_mean(planes: FloatPlanes) -> FloatPlanes:
    """Mean of each pixel and its four neighbours."""
    above, below, left, right = neighbors(planes)
    return (planes + ((above + below) + (left + right))) / 5


def box_mean(planes: FloatPlanes) -> FloatPlanes:
    """Mean of each 3 x 3 block."""
    at = around(planes, 1)
    left, middle, right = (at(dx, 0) + (at(dx, -1) + at(dx, 1)) for dx in (-1, 0, 1))
    return (middle + (left + right)) / 9


def sharpened(planes: FloatPlanes, strength: float) -> FloatPlanes:
    """Add what sets each pixel apart from its four neighbours, `strength` times.

    A kernel of `1 + 4 strength` in the centre and `-strength` beside it, which sums to
    1: 1 is Xu's, 1/4 that of Oliveros' thesis. Nothing is clipped.
    """
    above, below, left, right = neighbors(planes)
    return planes + strength * (4 * planes - ((above + below) + (left + right)))
