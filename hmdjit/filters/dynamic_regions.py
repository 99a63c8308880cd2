"""What moved by itself, found from frames alone: no ids, no classes, no velocities."""

import functools

import jax.numpy as jnp

from .._types import Mask, Planes
from . import neighborhood

REACH_PX = 4
"""How far around a pixel the current frame counts."""

PAST_REACH_PX = 3
"""How far around a pixel the past counts."""

_MARGIN = 0.03  # of the colour range: 8 code values
_SHARE = 3.5 / 9  # of the pixels of a block: 4 are enough


def unexplained(current: Planes, past: Planes) -> Mask:
    """Where the head's motion explains no longer what the reprojected past shows.

    It lies beyond the range of the current 3 x 3 block, by a margin, in some colour:
    aliasing and sub-pixel motion bring colours that the block has. Where 4 of the 9
    pixels of a block say so there is more than an edge that flickers; what lies up to
    2 px around counts as well, as edges of things that move do.

    **Arguments:** `current`, `past`: colours in `[0, 1]`, `(3, height, width)`.

    **Returns:** True where the past is not to be blended in, `(height, width)`. What is
    uniform and moves within itself cannot be found, nor does it need to be.
    """
    _, block = neighborhood.plus_and_block(current)
    is_near = (block.low - _MARGIN <= past) & (past <= block.high + _MARGIN)
    is_beyond = ~functools.reduce(jnp.logical_and, is_near)
    share = neighborhood.box_mean(is_beyond.astype(current.dtype))
    found = (share > _SHARE).astype(current.dtype)
    for _ in range(2):
        _, block = neighborhood.plus_and_block(found)
        found = block.high
    return found > 0
