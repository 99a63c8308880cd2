"""What lies around each pixel: neighbours, means, sharpening.

Beyond the planes' edge lies what is at the edge.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple, TypeVar

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Shaped

AnyPlanes = Shaped[Array, "*planes height width"]
FloatPlanes = Float[Array, "*planes height width"]

AnyTree = TypeVar("AnyTree")

Reader = Callable[[int, int], AnyPlanes]
"""Planes read `dx` px to the right and `dy` px down of each pixel."""

_FARTHEST_PX = 2  # that `shifted` reads


def apart(compute: Callable[[], AnyTree], planes: AnyPlanes) -> AnyTree:
    """Compute behind a boundary that XLA does not fuse across.

    Else what is read at several places is computed anew for each. Only a choice that it
    cannot decide stops it, here between twice the same.

    **Arguments:** `planes`: any that are known when it is computed.
    """
    is_known = jnp.isfinite(planes[(0,) * planes.ndim])
    return lax.cond(is_known, compute, compute)


def around(planes: AnyPlanes, radius_px: int) -> Reader:
    """Return what reads planes some pixels away, clamped to their edge.

    **Arguments:** `radius_px`: the farthest that is asked for, in each direction.
    """
    return reader(padded(planes, radius_px, radius_px), radius_px)


def reader(planes: AnyPlanes, margin_px: int, more_px: int = 0) -> Reader:
    """Return what reads planes that have a margin.

    **Arguments:** `more_px`: columns and rows that are read beyond the planes' end.
    """
    # Kept whole, so that reads are plain slices of it: twice as fast on a CPU.
    planes = lax.optimization_barrier(planes)
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


def box_mean(planes: FloatPlanes) -> FloatPlanes:
    """Mean of each 3 x 3 block."""
    at = around(planes, 1)
    left, middle, right = (at(dx, 0) + (at(dx, -1) + at(dx, 1)) for dx in (-1, 0, 1))
    return (middle + (left + right)) / 9


def gradient_length(planes: FloatPlanes) -> FloatPlanes:
    """Length of the gradient by Sobel's kernels, 8 times that of a ramp.

    **Accuracy:** the slope where it is 0 is chosen as 0.
    """
    at = around(planes, 1)
    across = lambda dx: 2 * at(dx, 0) + (at(dx, -1) + at(dx, 1))
    down = lambda dy: 2 * at(0, dy) + (at(-1, dy) + at(1, dy))
    squared = (across(1) - across(-1)) ** 2 + (down(1) - down(-1)) ** 2
    is_flat = squared == 0
    return jnp.where(is_flat, 0, jnp.sqrt(jnp.where(is_flat, 1, squared)))


def sharpened(planes: FloatPlanes, strength: float) -> FloatPlanes:
    """Add what sets each pixel apart from its four neighbours, `strength` times.

    A kernel of `1 + 4 strength` in the centre and `-strength` beside it, which sums to
    1: 1 is Xu's, 1/4 that of Oliveros' thesis. Nothing is clipped.
    """
    above, below, left, right = neighbors(planes)
    return planes + strength * (4 * planes - ((above + below) + (left + right)))


def gaussian_mean(
    planes: FloatPlanes, center_px: Float[Array, "2"] | None, decay_px2: float
) -> FloatPlanes:
    """Mean of each 3 x 3 block, weighted by `exp(-decay distance^2)`.

    **Arguments:** `center_px`: from where distances count, from the block's centre, px;
    `decay_px2`: per px^2.
    """
    center = jnp.zeros(2, planes.dtype) if center_px is None else center_px
    distance = jnp.arange(-1, 2, dtype=planes.dtype)[:, None] - center[None]
    weights = jnp.exp(-decay_px2 * distance**2)
    across, down = (weights / weights.sum(axis=0)[None]).T
    room = padded(planes, 1, 1)

    def mean() -> FloatPlanes:
        at = reader(room, 1)
        rows = [sum(across[i] * at(i - 1, dy) for i in range(3)) for dy in (-1, 0, 1)]
        return down[0] * rows[0] + down[1] * rows[1] + down[2] * rows[2]

    return apart(mean, planes)


class Box(NamedTuple):
    """Smallest and largest values around each pixel, plane by plane."""

    low: FloatPlanes
    high: FloatPlanes

    def halfway(self, other: "Box") -> "Box":
        """Return the box midway to another one."""
        return Box((self.low + other.low) / 2, (self.high + other.high) / 2)


def plus_and_block(planes: FloatPlanes, *, margin_px: int = 0) -> tuple[Box, Box]:
    """Boxes of each pixel and its four neighbours, and of each 3 x 3 block.

    **Arguments:** `margin_px`: pixels around, 0 or 1, that are there to be read only.
    """
    room = padded(planes, 1 - margin_px, 1 - margin_px)

    def ends(extreme: Callable) -> tuple[FloatPlanes, FloatPlanes]:
        at, of = reader(room, 1), lambda *values: functools.reduce(extreme, values)
        left, middle, right = (
            of(at(dx, -1), at(dx, 0), at(dx, 1)) for dx in (-1, 0, 1)
        )
        return of(middle, at(-1, 0), at(1, 0)), of(middle, left, right)

    lows, highs = apart(lambda: (ends(jnp.minimum), ends(jnp.maximum)), planes)
    return Box(lows[0], highs[0]), Box(lows[1], highs[1])


def rounded_box(planes: FloatPlanes, *, margin_px: int = 0) -> Box:
    """Box midway between those of a plus and of a 3 x 3 block, see there."""

    def box() -> Box:
        plus, block = plus_and_block(planes, margin_px=margin_px)
        return plus.halfway(block)

    return apart(box, planes)


def plus_mean(planes: FloatPlanes) -> FloatPlanes:
    """Mean of each pixel and its four neighbours."""
    above, below, left, right = neighbors(planes)
    return (planes + ((above + below) + (left + right))) / 5


def shifted(planes: FloatPlanes, by_px: Float[Array, "2"]) -> FloatPlanes:
    """Read all pixels the same way off, bilinearly.

    **Arguments:** `by_px`: to the right and down, px, in `[-1.5, 1.5]`.
    """
    whole = jnp.clip(jnp.floor(by_px), -_FARTHEST_PX, _FARTHEST_PX - 1)
    u, v = by_px - whole
    left, top = whole.astype(jnp.int32) + _FARTHEST_PX
    room = padded(planes, _FARTHEST_PX, _FARTHEST_PX)
    zeros = [jnp.zeros_like(left)] * (planes.ndim - 2)

    def tap(dx: int, dy: int) -> FloatPlanes:
        # Each a slice of its own: many times as fast on a CPU.
        return lax.dynamic_slice(room, [*zeros, top + dy, left + dx], planes.shape)

    def shift() -> FloatPlanes:
        upper = tap(0, 0) + u * (tap(1, 0) - tap(0, 0))
        lower = tap(0, 1) + u * (tap(1, 1) - tap(0, 1))
        return upper + v * (lower - upper)

    return apart(shift, planes)


def shifted_nearest(
    planes: AnyPlanes, by_px: Float[Array, "2"] | None, *, margin_px: int = 0
) -> Shaped[Array, "*planes rows columns"]:
    """Read all pixels the same way off, each from the nearest.

    **Arguments:** `by_px`: as `shifted`; None is not at all. `margin_px`: pixels around
    the planes that are read, too.
    """
    if by_px is None:
        return padded(planes, margin_px, margin_px)
    room = padded(planes, margin_px + _FARTHEST_PX, margin_px + _FARTHEST_PX)
    whole = jnp.clip(jnp.floor(by_px + 0.5), -_FARTHEST_PX, _FARTHEST_PX)
    left, top = whole.astype(jnp.int32) + _FARTHEST_PX
    start = [jnp.zeros_like(left)] * (planes.ndim - 2) + [top, left]
    height, width = (size + 2 * margin_px for size in planes.shape[-2:])
    return lax.dynamic_slice(room, start, (*planes.shape[:-2], height, width))
