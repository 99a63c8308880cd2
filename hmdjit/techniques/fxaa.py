"""Fast approximate anti-aliasing (Lottes): pixels of edges take from across."""

import functools
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .. import _checks, color
from .._types import Rgb
from ..filters import edge_spans, neighborhood
from ..filters.edges import TIE
from ..filters.neighborhood import Reader
from ..frames.frame import Frame
from ..technique_contract.base import SPACES, AbstractSpatial

Sides = tuple[Array, Array]
Gray = Float[Array, "1 height width"]


class _Preset(NamedTuple):
    """How sensitive a preset is, and how far it searches.

    - `share`, `least`: contrast that makes an edge, of the largest luma, and at least.
    - `steps_px`: advances of the search along an edge, of which the last is not read.
    """

    share: float
    least: float
    steps_px: tuple[float, ...]


_USUAL = 0.166, 0.0833
PRESETS = {
    "white_paper": _Preset(1 / 8, 1 / 24, (1.0,) * 33),
    "10": _Preset(*_USUAL, (1.5, 3.0, 12.0)),
    "12": _Preset(*_USUAL, (1.0, 1.5, 2.0, 4.0, 12.0)),
    "15": _Preset(*_USUAL, (1.0, 1.5, 2.0, 2.0, 2.0, 2.0, 4.0, 12.0)),
    "29": _Preset(*_USUAL, (1.0, 1.5, *(2.0,) * 8, 4.0, 8.0)),
    "39": _Preset(0.063, 0.0312, (*(1.0,) * 5, 1.5, *(2.0,) * 4, 4.0, 8.0)),
}
"""The highest preset of the white paper, and five of version 3.11, by number."""

SUBPIXEL = 0.75
"""Most that version 3.11 smooths where there is no long edge, px; as published."""


class FXAA(AbstractSpatial):
    """Find edges by luma, search for their ends, and mix with the pixel across.

    - `preset`: `"white_paper"`, the first version with its longest search; or `"10"`,
      `"12"`, `"15"`, `"29"`, `"39"` of version 3.11, which search farther by number.
    - `space`: where colours are mixed, `"gamma"` or `"linear"`. Edges are found in
      gamma.

    **Source:** Lottes, "FXAA", NVIDIA white paper, 2009; version 3.11 (quality), 2011.

    **Accuracy:** comparisons that are closer than 1e-5 of luma count as equal, so that
    single and double precision decide alike. Where an edge lies and ends changes in
    jumps: gradients are those of the colours and of how much is smoothed.
    """

    preset: str = eqx.field(static=True, default="white_paper")
    space: str = eqx.field(static=True, default="gamma")

    def __check_init__(self):
        _checks.one_of("preset", self.preset, PRESETS)
        _checks.one_of("space", self.space, SPACES)

    @property
    def _is_first(self) -> bool:
        return self.preset == "white_paper"

    @property
    def id(self) -> str:
        """`fxaa`, with a preset's number, and `_linear` where that is the space."""
        number = "" if self._is_first else self.preset
        return f"fxaa{number}" + "_linear" * (self.space == "linear")

    @property
    def stencil_radius_px(self) -> int:
        """How far along an edge it reads."""
        return edge_spans.reach_px(PRESETS[self.preset].steps_px)

    def resolve(self, frame: Frame) -> Rgb:
        """Mix each pixel of an edge with the one across it."""
        gamma, preset = frame.color[0], PRESETS[self.preset]
        luma = _luma_of_white_paper(gamma) if self._is_first else _luma(gamma)
        at = neighborhood.around(luma, 1)
        plus = luma, at(0, -1), at(0, 1), at(-1, 0), at(1, 0)
        largest = functools.reduce(jnp.maximum, plus)
        contrast = largest - functools.reduce(jnp.minimum, plus)
        is_edge = contrast >= jnp.maximum(preset.least, largest * preset.share) - TIE

        # The white paper compares a quarter of these.
        tie = 4 * TIE if self._is_first else TIE
        is_level = _bend_of_columns(at) >= _bend_of_rows(at) - tie
        first, second = (
            jnp.abs(jnp.where(is_level, at(0, to), at(to, 0)) - luma) for to in (-1, 1)
        )
        across = _Across(is_level, first >= second - TIE)

        level, upright = (
            edge_spans.towards_ends(luma, axis, preset.steps_px) for axis in (-1, -2)
        )
        rows = level[:, :-1], level[:, 1:]
        columns = upright[..., :-1], upright[..., 1:]
        shift = across(rows, columns)
        is_darker = (luma - across.read(at)) / 2 < -TIE  # than their mean
        offset = jnp.where((shift < 0) != is_darker, jnp.abs(shift), 0)
        # Where there is no edge, nothing is shown of what follows.
        contrast = jnp.where(is_edge, contrast, 1)
        if not self._is_first:
            offset = jnp.maximum(offset, _subpixel_offset(at, contrast))

        colors = color.decode(gamma) if self.space == "linear" else gamma
        side = across.read(neighborhood.around(colors, 1))
        mixed = colors + offset * (side - colors)
        if self._is_first:
            share = _subpixel_share(at, contrast)
            mixed = mixed + share * (neighborhood.box_mean(colors) - mixed)
        shown = color.encode(mixed) if self.space == "linear" else mixed
        return jnp.where(is_edge, shown, gamma)


class _Across(eqx.Module):
    """Where each pixel's edge lies.

    - `is_level`: whether above or below, else to the left or right.
    - `is_first`: whether above or to the left.
    """

    is_level: Bool[Array, "1 height width"]
    is_first: Bool[Array, "1 height width"]

    def __call__(self, level: Sides, upright: Sides) -> Array:
        """Choose between what lies above and below, and to the left and right."""
        first, second = (
            jnp.where(self.is_level, *both) for both in zip(level, upright, strict=True)
        )
        return jnp.where(self.is_first, first, second)

    def read(self, at: Reader) -> Array:
        """Read planes across the edge."""
        return self((at(0, -1), at(0, 1)), (at(-1, 0), at(1, 0)))


def _luma_of_white_paper(gamma: Rgb) -> Gray:
    """Red, and green as often as luma has more of it; up to 2.963211."""
    return gamma[:1] + 1.963211 * gamma[1:2]


def _luma(gamma: Rgb) -> Gray:
    return 0.299 * gamma[:1] + 0.587 * gamma[1:2] + 0.114 * gamma[2:]


def _bend_of_columns(at: Reader) -> Gray:
    """How far the three columns of a box are from ramps, the middle one twice."""
    left, middle, right = (
        jnp.abs((at(dx, -1) + at(dx, 1)) - 2 * at(dx, 0)) for dx in (-1, 0, 1)
    )
    return (left + right) + 2 * middle


def _bend_of_rows(at: Reader) -> Gray:
    return _bend_of_columns(lambda dy, dx: at(dx, dy))


def _neighbor_sum(at: Reader) -> Gray:
    return (at(0, -1) + at(0, 1)) + (at(-1, 0) + at(1, 0))


def _subpixel_share(at: Reader, contrast: Gray) -> Gray:
    """How much of the box's mean the white paper shows, up to 3/4."""
    share = jnp.abs(_neighbor_sum(at) / 4 - at(0, 0)) / contrast
    return jnp.clip((share - 1 / 4) * (4 / 3), 0, 3 / 4)


def _subpixel_offset(at: Reader, contrast: Gray) -> Gray:
    """How far version 3.11 moves across where a pixel stands out, px."""
    corners = (at(-1, -1) + at(1, -1)) + (at(-1, 1) + at(1, 1))
    apart = jnp.abs((2 * _neighbor_sum(at) + corners) / 12 - at(0, 0)) / contrast
    share = jnp.clip(apart, 0, 1)
    return (share**2 * (3 - 2 * share)) ** 2 * SUBPIXEL
