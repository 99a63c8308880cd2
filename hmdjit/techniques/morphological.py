"""Morphological anti-aliasing, of one picture: MLAA and SMAA.

Steps of whole pixels are drawn again without steps, in four parts: edges between
pixels, the lines that they were sampled from, what those lines cut off of each pixel,
and a mix with the neighbour at the other side of the edge. Edges are sought in gamma
colours. They are decisions, and so constant where one differentiates: colours are not.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import DTypeLike

from .. import _checks, color
from .._types import Mask, Plane, Rgb
from ..filters import edges, line_coverage
from ..filters.line_coverage import Shares
from ..filters.neighborhood import neighbors
from ..frames.frame import Frame
from ..technique_contract.base import SPACES, AbstractSpatial


class Preset(NamedTuple):
    """How edges are sought.

    - `threshold`: smallest difference that is an edge, in `(0, 1]`.
    - `longest_px`: how far the ends of a line are looked for, to each side.
    - `diagonal_px`: how far those of a diagonal are; 0 looks for none.
    - `rounding`: how much less is cut off at corners.
    """

    threshold: float
    longest_px: int
    diagonal_px: int = 0
    rounding: float = 0.0


PRESETS = {
    "low": Preset(0.15, 8),
    "medium": Preset(0.1, 16),
    "high": Preset(0.1, 32, 8, 0.25),
    "ultra": Preset(0.05, 64, 16, 0.25),
}
"""Those of SMAA's authors; their searches go two pixels per step."""

EDGES = ("luma", "color")

_MLAA = Preset(0.1, 32)


class MLAA(AbstractSpatial):
    """Morphological anti-aliasing: straight lines through edges of luma.

    - `space`: where colours are mixed, `"gamma"`, as most do, or `"linear"`.

    **Source:** Reshetov, "Morphological antialiasing", HPG 2009, as restated by Jimenez
    et al., "Practical morphological antialiasing", GPU Pro 2, 2011. Shapes that turn
    off to the same side at both ends are not softened.
    """

    space: str = eqx.field(static=True, default="gamma")

    def __check_init__(self):
        _checks.one_of("space", self.space, SPACES)

    @property
    def id(self) -> str:
        """`mlaa`, and `_linear` where that is the space."""
        return "mlaa" + "_linear" * (self.space == "linear")

    @property
    def stencil_radius_px(self) -> int:
        """The longest walk, the edges at its end, and what these are compared with."""
        return _MLAA.longest_px + 2

    def resolve(self, frame: Frame) -> Rgb:
        """Return the picture with each edge's four neighbours mixed in, cubed."""
        gamma = frame.color[0]
        seen = lax.stop_gradient(gamma)
        flags = edges.flags(seen, _MLAA.threshold, reach_px=1)
        taken = _taken(*flags, gamma.dtype, _MLAA, softens=False)
        cubes = [share**3 for share in taken]
        total = (cubes[0] + cubes[1]) + (cubes[2] + cubes[3])
        is_changed = total >= edges.TIE
        scale = 1 / jnp.where(is_changed, total, 1)
        weights = [(c * a * scale)[None] for c, a in zip(cubes, taken, strict=True)]

        def mixed(colors: Rgb) -> Rgb:
            shown = colors
            for weight, near in zip(weights, neighbors(colors), strict=True):
                shown += weight * (near - colors)
            return shown

        return _blended(gamma, is_changed, mixed, self.space)


class SMAA(AbstractSpatial):
    """Subpixel morphological anti-aliasing, on one sample per pixel (SMAA 1x).

    - `preset`: `"low"`, `"medium"`, `"high"` or `"ultra"`. The last two look for
      diagonals and keep corners.
    - `edges`: what is an edge, a difference of `"luma"` or of any channel (`"color"`).
    - `space`: where colours are mixed, `"gamma"` or `"linear"`.

    **Source:** Jimenez et al., "SMAA: Enhanced Subpixel Morphological Antialiasing",
    Eurographics 2012; thresholds, searches and patterns are those of its published
    code. Areas are exact integrals, where that reads tables of 8 bits.
    """

    preset: str = eqx.field(static=True, default="high")
    edges: str = eqx.field(static=True, default="luma")
    space: str = eqx.field(static=True, default="gamma")

    def __check_init__(self):
        _checks.one_of("preset", self.preset, PRESETS)
        _checks.one_of("edges", self.edges, EDGES)
        _checks.one_of("space", self.space, SPACES)

    @property
    def id(self) -> str:
        """`smaa`, with what is not its default: `smaa_ultra_color_linear`."""
        defaults = {"preset": "high", "edges": "luma", "space": "gamma"}
        own = {name: getattr(self, name) for name in defaults}
        return "_".join(["smaa", *(v for k, v in own.items() if v != defaults[k])])

    @property
    def stencil_radius_px(self) -> int:
        """The longest walk, the edges at its end, and what these are compared with."""
        return PRESETS[self.preset].longest_px + 2

    def resolve(self, frame: Frame) -> Rgb:
        """Return the picture with neighbours across the stronger edges mixed in."""
        gamma, preset = frame.color[0], PRESETS[self.preset]
        seen = lax.stop_gradient(gamma)
        flags = edges.flags(seen, preset.threshold, by=self.edges)
        above, below, left, right = _taken(*flags, gamma.dtype, preset, softens=True)
        is_changed = (above + below) + (left + right) >= edges.TIE
        is_level = jnp.maximum(left, right) > jnp.maximum(above, below) + edges.TIE
        one = jnp.where(is_level, left, above)
        other = jnp.where(is_level, right, below)
        scale = 1 / jnp.where(is_changed, one + other, 1)
        weights = [(share**2 * scale)[None] for share in (one, other)]

        def mixed(colors: Rgb) -> Rgb:
            above, below, left, right = neighbors(colors)
            before = jnp.where(is_level[None], left, above)
            after = jnp.where(is_level[None], right, below)
            one, other = weights
            return colors + one * (before - colors) + other * (after - colors)

        return _blended(gamma, is_changed, mixed, self.space)


class _Taken(NamedTuple):
    """What a pixel takes from its neighbours."""

    above: Plane
    below: Plane
    left: Plane
    right: Plane


def _taken(
    left: Mask, top: Mask, dtype: DTypeLike, preset: Preset, *, softens: bool
) -> _Taken:
    """Shares of all lines through a picture's edges."""

    def found(left: Mask, top: Mask) -> tuple[Shares, Shares]:
        options = {"softens": softens, "rounding": preset.rounding}
        options |= {"longest": preset.longest_px, "dtype": dtype}
        rows = line_coverage.of_lines(top, left, **options)
        columns = line_coverage.of_lines(left, top, upright=True, **options)
        if preset.diagonal_px:
            cut = line_coverage.of_diagonals(left, top, preset.diagonal_px, dtype)
            cut, rows, columns = lax.optimization_barrier((cut, rows, columns))
            is_diagonal = cut.down + cut.up >= edges.TIE
            rows = Shares(
                *(jnp.where(is_diagonal, *s) for s in zip(cut, rows, strict=True))
            )
            columns = Shares(*(jnp.where(is_diagonal, 0, s) for s in columns))
        return rows, columns

    def nothing(left: Mask, top: Mask) -> tuple[Shares, Shares]:
        margin = 2 * line_coverage.MARGIN_PX - 1
        none = jnp.zeros([size - margin for size in left.shape], dtype)
        return Shares(none, none), Shares(none, none)

    # A picture without edges is left alone. The choice is also a boundary that XLA does
    # not fuse across: it would walk anew for each use of what is found.
    left, top = (jnp.pad(flags, line_coverage.MARGIN_PX) for flags in (left, top))
    rows, columns = lax.cond(jnp.any(left | top), found, nothing, left, top)
    return _Taken(
        rows.down[:-1, :-1],
        rows.up[1:, :-1],
        columns.down[:-1, :-1],
        columns.up[:-1, 1:],
    )


def _blended(
    gamma: Rgb, is_changed: Mask, mixed: Callable[[Rgb], Rgb], space: str
) -> Rgb:
    """Mix colours in a space; pixels that do not change are not touched."""
    if space == "linear":
        shown = color.encode(mixed(color.decode(gamma)))
    else:
        shown = mixed(gamma)
    return jnp.where(is_changed[None], shown, gamma)
