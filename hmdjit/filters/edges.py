"""Edges between pixels, and how far one can walk along them.

A pixel's *left* flag says that there is an edge between it and the pixel to its left,
its *top* flag that there is one between it and the pixel above.

Walks go by doubling over whole planes: where a walk ends does not depend on where it
starts, so what is known of `2^k` steps gives what there is of `2^(k+1)`.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

from .. import color
from .._types import Mask, Plane, Rgb

TIE = 1e-5
"""Decisions that are nearer than this count as equal, in single precision too."""

Reader = Callable[[int, int], Array]
"""Planes read `dx` px to the right and `dy` px down of each pixel."""

Steps = Int[Array, "height width"]
"""Whole numbers of 16 bits."""


def flags(
    gamma: Rgb, threshold: float, *, by: str = "luma", reach_px: int = 2
) -> tuple[Mask, Mask]:
    """Whether there is an edge to the left of each pixel, and above it.

    An edge is kept only if it is at least half as strong as the strongest around it.

    **Arguments:**

    - `gamma`: what is looked at, gamma colours.
    - `threshold`: smallest difference that is an edge.
    - `by`: how two pixels differ: `"luma"`, or `"color"`, the largest difference of a
      channel.
    - `reach_px`: what is around it: all sides of the pixel, 1, and the edges one pixel
      farther to the left and above, 2.

    **Source:** Jimenez et al., "SMAA: Enhanced Subpixel Morphological Antialiasing",
    Eurographics 2012, section 4.1.
    """
    seen = color.luma(gamma)[None] if by == "luma" else gamma
    width_px = ((0, 0), (2, 2), (2, 2))
    at = reading(jnp.pad(seen, width_px, mode="edge"), 2)

    def difference(one: tuple[int, int], other: tuple[int, int]) -> Plane:
        """Largest difference of a channel between two places; 0 beyond the edge."""
        channels = jnp.abs(at(*one) - at(*other))
        largest = channels[0]
        for channel in channels[1:]:
            largest = jnp.maximum(largest, channel)
        return largest

    here = (0, 0)
    from_left, from_top = difference(here, (-1, 0)), difference(here, (0, -1))
    around = [difference(here, (1, 0)), difference(here, (0, 1))]
    if reach_px == 2:
        around += [difference((-1, 0), (-2, 0)), difference((0, -1), (0, -2))]
    strongest = jnp.maximum(from_left, from_top)
    for found in around:
        strongest = jnp.maximum(strongest, found)

    def kept(found: Plane) -> Mask:
        return (found >= threshold - TIE) & (2 * found >= strongest - TIE)

    return kept(from_left), kept(from_top)


def reading(padded: Array, margin_px: int, more_px: int = 0) -> Reader:
    """Return what reads planes that have a margin.

    **Arguments:** `more_px`: columns and rows that are read beyond the planes' end.
    """
    # Kept as they are, so that reads are plain slices of them.
    padded = lax.optimization_barrier(padded)
    height, width = (size - 2 * margin_px + more_px for size in padded.shape[-2:])

    def at(dx: int, dy: int) -> Array:
        y, x = margin_px + dy, margin_px + dx
        return padded[..., y : y + height, x : x + width]

    return at


class Ends(NamedTuple):
    """Where a walk from each pixel ends.

    - `steps`: how many it takes, at most the longest walk.
    - `marks`: what was noted of the place where it ends, 4 bits.
    """

    steps: Steps
    marks: Steps


_MARKS = 16  # steps are counted above four bits of marks


def walk(
    goes_on: Mask, marks: Steps, marks_ahead: Steps, dx: int, dy: int, longest: int
) -> Ends:
    """Walk from each pixel for as long as it goes on.

    **Arguments:**

    - `goes_on`: whether there is a step from a pixel; False where it would leave the
      planes.
    - `marks`: what is noted of a pixel if the walk ends there, `[0, 16)`.
    - `marks_ahead`: that of the pixel a step ahead.
    - `dx`, `dy`: the step, -1, 0 or 1 px each.
    - `longest`: most steps, a power of two.
    """
    height, width = goes_on.shape
    reach = longest // 2
    start = jnp.where(goes_on, _MARKS + marks_ahead, marks)
    above, left = reach * (dy < 0), reach * (dx < 0)
    margins = [(above, reach * (dy > 0)), (left, reach * (dx > 0))]

    def doubled(found: Steps, steps: Int[Array, ""]) -> tuple[Steps, None]:
        # What is read beyond the edge is never taken: no walk goes there.
        place = (above + dy * steps, left + dx * steps)
        ahead = lax.dynamic_slice(jnp.pad(found, margins), place, (height, width))
        so_far = (_MARKS * steps).astype(found.dtype)
        return jnp.where(found < so_far, found, ahead + so_far), None

    lengths = [2**k for k in range(longest.bit_length() - 1)]
    found, _ = lax.scan(doubled, start, jnp.asarray(lengths, jnp.int32))
    return Ends(found // _MARKS, found % _MARKS)
