"""Whether the past shows what the present does: by depth, by what is marked."""

import jax.numpy as jnp

from .._types import Mask, Plane, Planes
from ..frames.displacement import AnyDisplacement
from ..frames.sources import History

_DEPTH_TOLERANCE = 0.01  # relative


def nearest(history: History, displacement: AnyDisplacement) -> Planes:
    """Read the pixel of a history that is nearest to each source, as fast as others.

    All that is kept must be finite.
    """
    whole = lambda px: jnp.floor(px + 0.5)
    return history.at(displacement.changed(whole, whole))


def has_depth(history: History, displacement: AnyDisplacement, depth: Plane) -> Mask:
    """Whether the nearest past depth is within 1 % of each pixel's own.

    **Arguments:** `history`: of `1 / depth`, 0 where nothing is seen.
    """
    (past,) = nearest(history, displacement)
    return jnp.abs(past - 1 / depth) <= _DEPTH_TOLERANCE * past
