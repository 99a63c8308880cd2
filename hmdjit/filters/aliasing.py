"""How aliased a pixel may be: by edges of what it shows, by models, by depth.

**Source:** Oliveros, thesis, and its code, where the two differ.
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, DTypeLike, Float, Int

from .. import color
from .._types import Plane, Rgb
from . import neighborhood, temporal
from .neighborhood import Box

DEPTH_RANGES = ("paper", "code")
_OF_ALBEDO, _OF_LIGHT = 0.3, 0.7  # how much edges count, beside those of depth
_LEAST_RANGE = 0.002  # of depth: less is no edge


class Intermediates(NamedTuple):
    """What a frame's picture is made of, as images.

    - `sobel`: strength of edges, jittered as the frame is, in `[0, 1]`.
    - `temporal_sobel`: the same, un-jittered and accumulated.
    - `model_average`: share of other models around each pixel, in `[0, 8/9]`.
    - `depth_variation`, `past_depth_variation`: how far the depth of the pixel, now and
      in the past, is off what is around it.
    - `aliased`: how aliased each pixel may be, in `[0, 1]`.
    - `current`, `past`: colours, un-jittered; of the past before it is clipped.
    - `depth`: un-jittered, to be kept.
    """

    sobel: Plane
    temporal_sobel: Plane
    model_average: Plane
    depth_variation: Plane
    past_depth_variation: Plane
    aliased: Plane
    current: Rgb
    past: Rgb
    depth: Plane


def edge_strength(lit: Rgb, albedo: Rgb, depth: Plane) -> Plane:
    """Strength of edges, in `[0, 1]`, by Sobel's kernels.

    **Arguments:** `depth`: as `temporal.thesis_depth`.
    """
    lumas = color.to_ycocg(albedo)[0], color.to_ycocg(lit)[0]
    length = neighborhood.gradient_length(jnp.stack([*lumas, depth]))
    edge = jnp.clip(_OF_ALBEDO * length[0] + _OF_LIGHT * length[1] + length[2], 0, 1)
    return edge * jnp.sqrt(3 - 2 * edge)  # the root of smoothstep


def temporal_edges(edges: Float[Array, "1 rows columns"], past: Plane) -> Plane:
    """Blend past edges, limited to those around each pixel, into the present ones.

    **Arguments:** `edges`: un-jittered, with a margin of 1 px.
    """
    current = edges[0, 1:-1, 1:-1]
    box = neighborhood.rounded_box(edges, margin_px=1)
    weight = temporal.feedback_weight(current, past, *temporal.THESIS_FEEDBACK)
    return current + weight * (jnp.clip(past, box.low[0], box.high[0]) - current)


def differing_share(ids: Int[Array, "rows columns"], dtype: DTypeLike) -> Plane:
    """Share of each 3 x 3 block whose id is not that of its centre, in `[0, 8/9]`.

    **Arguments:** `ids`: with a margin of 1 px.
    """
    at = neighborhood.reader(ids, 1)
    sides = [(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
    differs = [(at(*side) != at(0, 0)).astype(dtype) for side in sides]
    return functools.reduce(jnp.add, differs) / 9


def depth_terms(
    depth: Float[Array, "rows columns"], past: Plane, depth_range: str
) -> tuple[Plane, Plane]:
    """How far each pixel's depth, and the past one, are off the mean of its block.

    In units of the block's range, squared, and to the fourth; 0 where that is small.

    **Arguments:** `depth`: as `temporal.thesis_depth`, with a margin of 1 px;
    `depth_range`: from the mean to the nearer end, `"paper"`, or to the smallest,
    `"code"`.
    """
    at = neighborhood.reader(depth, 1)
    block = [at(dx, dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
    mean = functools.reduce(jnp.add, block) / 9
    size = mean - functools.reduce(jnp.minimum, block)
    if depth_range == "paper":
        size = jnp.minimum(size, functools.reduce(jnp.maximum, block) - mean)
    is_edge = size >= _LEAST_RANGE
    safe = jnp.where(is_edge, size, 1)
    now, before = (jnp.where(is_edge, (d - mean) / safe, 0) for d in (at(0, 0), past))
    return now**2, before**4


def aliased_value(sobel: Plane, models: Plane, depth: Plane, past: Plane) -> Plane:
    """Put together how aliased each pixel may be, in `[0, 1]`.

    **Arguments:** `sobel`: edges; `models`: of `differing_share`; `depth`, `past`: of
    `depth_terms`.
    """
    width = jnp.clip(models + sobel, 0, 1)
    plus, block = neighborhood.plus_mean(sobel), neighborhood.box_mean(sobel)
    return jnp.clip(plus + width * (block - plus) + depth + past + models, 0, 1)


def narrowed(plus: Box, block: Box, current: Rgb, aliased: Plane) -> Box:
    """Box of what may be shown: the block where aliased, the pixel itself where not."""
    share = aliased[None]

    def end(near: Rgb, far: Rgb) -> Rgb:
        return current + share * (near + share * (far - near) - current)

    return Box(end(plus.low, block.low), end(plus.high, block.high))
