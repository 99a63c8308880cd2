"""What temporal techniques share: un-jittering, the past, and what it may show."""

import dataclasses
import functools
from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float

from .. import color
from .._types import Mask, Numbers, Plane, Planes, Rgb, Scalar
from ..frames.displacement import AnyDisplacement, DisplacementField
from ..frames.frame import Frame
from ..frames.motion import Motion
from ..frames.sources import History
from . import neighborhood
from .neighborhood import Box, FloatPlanes, apart

THESIS_FEEDBACK = 0.925, 0.979
"""Weights of the past in Oliveros' thesis, least and largest, see `feedback_weight`."""

_LEAST_EXTENT = 1e-6  # of a box: one of a single colour has none
_LEAST_LUMA = 0.2  # that a difference of luma is held against


def unjittered(
    planes: FloatPlanes, jitter_px: Float[Array, "2"] | None, *, margin_px: int = 0
) -> Float[Array, "*planes rows columns"]:
    """Read a jittered frame where the content of each pixel's centre went.

    **Arguments:** `jitter_px`: of `Frame`, where its samples lie; None is the centre.
    `margin_px`: pixels around the frame that are read, too.
    """
    planes = neighborhood.padded(planes, margin_px, margin_px)
    return planes if jitter_px is None else neighborhood.shifted(planes, -jitter_px)


def unjittered_reprojection(frame: Frame, motion: Motion) -> AnyDisplacement:
    """Where the content of each pixel's centre was: of a field, between samples."""
    own = frame.reprojection(motion)
    if not isinstance(own, DisplacementField):
        return own
    dx, dy = unjittered(jnp.stack([own.dx, own.dy]), frame.jitter_px)
    return dataclasses.replace(own, dx=dx, dy=dy)


def dilated(
    frame: Frame, motion: Motion, depth: Plane | None = None, tie: float = 0.0
) -> AnyDisplacement:
    """Where the nearest surface of each 3 x 3 block was, from its own pixel.

    An edge then moves with what is in front. Where only the head's turn moves the
    picture, near and far move alike, and each pixel has its own.

    **Arguments:** `depth`: what is compared, the frame's by default; `tie`: by how much
    a neighbour must be nearer than the centre, and than those above and to the left.
    """
    own = frame.reprojection(motion)
    if not isinstance(own, DisplacementField):
        return own
    depth = frame.depth if depth is None else depth
    at = neighborhood.around(jnp.stack([depth, own.dx, own.dy]), 1)
    nearest = at(0, 0)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            is_nearer = at(dx, dy)[0] < nearest[0] - tie
            nearest = jnp.where(is_nearer, at(dx, dy), nearest)
    return dataclasses.replace(own, dx=nearest[1], dy=nearest[2])


def is_finite(planes: Sequence[Plane] | Planes) -> Mask:
    """Whether all planes of a pixel are finite, `(height, width)`."""
    return functools.reduce(jnp.logical_and, map(jnp.isfinite, planes))


def past(
    history: History,
    displacement: AnyDisplacement,
    instead: Planes,
    *,
    clamps: bool = False,
) -> Planes:
    """Read a history where each pixel's content was.

    **Arguments:** `instead`: shown where that is not finite, or off screen; `clamps`:
    off screen the nearest pixel on it is shown.
    """
    shown = history.at(displacement)
    is_shown = is_finite(shown)
    if not clamps:
        is_shown = is_shown & displacement.inside()
    return jnp.where(is_shown[None], shown, instead)


def _largest(planes: Planes) -> Float[Array, "1 height width"]:
    # On CPUs XLA's own maximum over a first axis takes several times as long.
    return functools.reduce(jnp.maximum, planes)[None]


def clip_to_center(colors: Planes, box: Box) -> Planes:
    """Move colours beyond a box towards its centre, to its surface.

    **Source:** Pedersen, "Temporal reprojection anti-aliasing in INSIDE", GDC 2016.
    """
    center = (box.low + box.high) / 2
    extent = (box.high - box.low) / 2 + _LEAST_EXTENT
    beyond = apart(lambda: _largest(jnp.abs((colors - center) / extent)), colors)
    is_inside = beyond <= 1
    scale = jnp.where(is_inside, 1.0, beyond)
    return jnp.where(is_inside, colors, center + (colors - center) / scale)


def clip_towards(colors: Planes, target: Planes, box: Box) -> Planes:
    """Move colours beyond a box towards a target, to its surface.

    Where the way misses the box, to the target. A plane that is as the target counts as
    within its sides, or as beyond them for good.

    **Source:** Karis, "High-quality temporal supersampling", SIGGRAPH 2014.
    """
    way = target - colors

    def entry() -> Float[Array, "1 height width"]:
        is_level = way == 0
        safe = jnp.where(is_level, 1.0, way)
        enters = jnp.minimum((box.low - colors) / safe, (box.high - colors) / safe)
        is_within = (box.low <= colors) & (colors <= box.high)
        level = jnp.where(is_within, -jnp.inf, jnp.inf)
        return _largest(jnp.where(is_level, level, enters))

    return colors + jnp.clip(apart(entry, colors), 0, 1) * way


def feedback_weight(
    current_luma: Numbers, past_luma: Numbers, low: Scalar, high: Scalar
) -> Numbers:
    """Weight of the past: `low` where it differs from the present, `high` where not.

    **Source:** Lottes, "Temporal anti-aliasing", 2011, as in Pedersen 2016.
    """
    largest = jnp.maximum(jnp.maximum(current_luma, past_luma), _LEAST_LUMA)
    alike = 1 - jnp.abs(current_luma - past_luma) / largest
    return low + (high - low) * alike**2


def thesis_blend(current: Rgb, past: Rgb) -> Rgb:
    """Blend a past, clipped or not, into the present: Oliveros' thesis."""
    lumas = color.to_ycocg(current)[0], color.to_ycocg(past)[0]
    weight = feedback_weight(*lumas, *THESIS_FEEDBACK)
    return current + weight[None] * (past - current)


def likeness(speed: Plane, past_speed: Plane, sensitivity: float) -> Plane:
    """How alike two speeds are: 1 where equal, by the root of their difference.

    **Accuracy:** the slope where they are equal is chosen as 0.

    **Source:** Jimenez et al., "SMAA", 2012, code of the resolve of two frames.
    """
    difference = jnp.abs(speed - past_speed)
    is_zero = difference == 0
    root = jnp.sqrt(jnp.where(is_zero, 1.0, difference))
    return jnp.clip(1 - sensitivity * jnp.where(is_zero, 0.0, root), 0, 1)


def thesis_depth(depth: Plane) -> Plane:
    """Depth as Oliveros' thesis compares it, `2 / (1 + 10000 / depth)`; 2 at infinity.

    **Source:** code of the thesis, its planes at 1 and 10000.
    """
    return 2 / (1 + 1e4 / depth)
