"""How far pixels beside an edge move across it: searches for the ends of its span."""

import itertools
import math
from collections.abc import Sequence

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from . import neighborhood
from .edges import TIE
from .neighborhood import FloatPlanes

Boundaries = Float[Array, "*planes rows columns"]


def reach_px(steps_px: Sequence[float]) -> int:
    """How far along an edge a search reads."""
    return math.ceil(sum(steps_px[:-1]))


def towards_ends(luma: FloatPlanes, axis: int, steps_px: Sequence[float]) -> Boundaries:
    """Search all boundaries between pixels in both directions: how far to move across.

    A boundary's luma is the mean of the pixels on both sides of it, for which it is
    searched once. Its span ends where that mean has changed by a quarter of the step
    across the boundary.

    **Arguments:**

    - `axis`: along which boundaries run: -1 between rows, -2 between columns.
    - `steps_px`: advances of the search, multiples of 1/2 px, of which the last counts
      as made but is not read any more.

    **Returns:** of all boundaries, those of the border included, `1/2 - near / (near +
    far)` px by the distances of the ends; negative where the nearer end, or the one to
    the right or below of two as near, is darker than the boundary.

    **Accuracy:** these are decisions, without derivatives.

    **Source:** Lottes, "FXAA", NVIDIA white paper, 2009.
    """
    luma = lax.stop_gradient(luma)
    reads_px = list(itertools.accumulate(steps_px[:-1]))
    size, reach = luma.shape[axis], reach_px(steps_px)
    rim = (reach, 1) if axis == -1 else (1, reach)
    one, other = _pairs(neighborhood.padded(luma, *rim), -3 - axis)
    pixels = (one + other) / 2
    one_half, other_half = _pairs(pixels, axis)
    halves = (one_half + other_half) / 2

    def read(along_px: float) -> Boundaries:
        whole = math.floor(along_px)
        planes = pixels if whole == along_px else halves
        return _part(planes, axis, reach + whole, size)

    middle = read(0.0)
    step = jnp.abs(_part(one, axis, reach, size) - _part(other, axis, reach, size))
    enough = step / 4 - TIE

    def search(sign: int) -> tuple[Boundaries, Boundaries]:
        distance_px = jnp.full_like(middle, sum(steps_px))
        change = read(sign * reads_px[-1]) - middle
        for along_px in reversed(reads_px):  # the nearest end is the last to be written
            here = read(sign * along_px) - middle
            is_end = jnp.abs(here) >= enough
            distance_px = jnp.where(is_end, along_px, distance_px)
            change = jnp.where(is_end, here, change)
        return distance_px, change

    (back_px, back), (forth_px, forth) = search(-1), search(1)
    change = jnp.where(back_px < forth_px, back, forth)
    total_px = back_px + forth_px
    offset = total_px / 2 - jnp.minimum(back_px, forth_px)
    # Divided last: XLA computes a quotient once, but all else anew for each use.
    return jnp.where(change < -TIE, -offset, offset) / total_px


def _pairs(plane: Array, axis: int) -> tuple[Array, Array]:
    """Return all but the last, and all but the first, along an axis."""
    size = plane.shape[axis] - 1
    return _part(plane, axis, 0, size), _part(plane, axis, 1, size)


def _part(plane: Array, axis: int, start: int, size: int) -> Array:
    return lax.slice_in_dim(plane, start, start + size, axis=axis)
