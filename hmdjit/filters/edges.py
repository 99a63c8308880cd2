"""Edges between pixels, and how far one can walk along them.

A pixel's *left* flag says that there is an edge between it and the pixel to its left,
its *top* flag that there is one between it and the pixel above.

Walks go by doubling over whole planes: where a walk ends does not depend on where it
starts, so what is known of `2^k` steps gives what there is of `2^(k+1)`.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from .. import color
from .._types import Mask, Plane, Rgb
from .neighborhood import shifted

TIE = 1e-5
"""Decisions that are nearer than this count as equal, in single precision too."""

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
    from_left, from_top = _difference(seen, -1, 0), _difference(seen, 0, -1)
    sides = [from_left, shifted(from_left, 1, 0), from_top, shifted(from_top, 0, 1)]
    if reach_px == 2:
        sides += [shifted(from_left, -1, 0), shifted(from_top, 0, -1)]
    strongest = sides[0]
    for side in sides[1:]:
        strongest = jnp.maximum(strongest, side)

    def kept(difference: Plane) -> Mask:
        is_strong = 2 * difference >= strongest - TIE
        return (difference >= threshold - TIE) & is_strong

    return kept(from_left), kept(from_top)


def _difference(planes: Array, dx: int, dy: int) -> Plane:
    """Largest difference of a channel from a neighbour; 0 at the planes' edge."""
    apart = jnp.abs(planes - shifted(planes, dx, dy))
    largest = apart[0]
    for plane in apart[1:]:
        largest = jnp.maximum(largest, plane)
    return largest


class Ends(NamedTuple):
    """Where a walk from each pixel ends.

    - `steps`: how many it takes, at most the longest walk.
    - `marks`: what was noted of the place where it ends, 4 bits.
    """

    steps: Steps
    marks: Steps


_MARKS = 16  # steps are counted above four bits of marks


def walk(
    goes_on: Bool[Array, "height width"],
    marks: Steps,
    dx: int,
    dy: int,
    longest: int,
) -> Ends:
    """Walk from each pixel for as long as it goes on.

    **Arguments:**

    - `goes_on`: whether there is a step from a pixel; False where it would leave the
      planes.
    - `marks`: what is noted of a pixel if the walk ends there, `[0, 16)`.
    - `dx`, `dy`: the step, -1, 0 or 1 px each.
    - `longest`: most steps, a power of two.
    """
    height, width = goes_on.shape
    reach = longest // 2
    ahead_of = shifted(marks, dx, dy)
    start = jnp.where(goes_on, _MARKS + ahead_of, marks).astype(jnp.int16)
    margins = [
        (reach * (dy < 0), reach * (dy > 0)),
        (reach * (dx < 0), reach * (dx > 0)),
    ]

    def doubled(found: Steps, steps: Int[Array, ""]) -> tuple[Steps, None]:
        # What is read beyond the edge is never taken: no walk goes there.
        around = jnp.pad(found, margins)
        place = (margins[0][0] + dy * steps, margins[1][0] + dx * steps)
        ahead = lax.dynamic_slice(around, place, (height, width))
        so_far = (_MARKS * steps).astype(jnp.int16)
        return jnp.where(found < so_far, found, ahead + so_far), None

    lengths = jnp.asarray([2**k for k in range(longest.bit_length() - 1)], jnp.int32)
    found, _ = lax.scan(doubled, start, lengths)
    return Ends(found // _MARKS, found % _MARKS)
