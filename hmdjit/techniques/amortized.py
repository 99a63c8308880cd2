"""Amortised supersampling (Yang et al.)."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .. import _checks, sample_patterns
from .._types import Mask, Planes, Rgb, Scalar
from ..filters import running_mean, same_surface, temporal
from ..frames.displacement import AnyDisplacement
from ..frames.frame import Frame
from ..frames.motion import Motion
from ..frames.sources import History
from ..technique_contract.base import AbstractTemporal

_CELLS = ((0, 0), (1, 1), (0, 1), (1, 0))  # (row, column) of sub-pixels, by turns


class Kept(NamedTuple):
    """What stays of a frame.

    - `pixels`: colour and age; with sub-pixels those of the 2 x 2 in each pixel.
    - `nearness`: 1 / depth.
    - `frame`: its number.
    """

    pixels: History
    nearness: History
    frame: Int[Array, ""]


class Amortized(AbstractTemporal):
    """Running mean of jittered samples along the motion, as long as resampling allows.

    `F_k(p) = a s_k(p) + (1 - a) F_{k-1}(p - v)` with `a = max(1 / (N + 1), a_blur,
    min_weight)`. The age N, read as the colour is, counts samples: `min(N + 1,
    1 / min_weight)` is kept. `a_blur = b / (b + blur_limit_px2)`, where `b = (fx (1 -
    fx) + fy (1 - fy)) / 2` px^2 is the variance that one bilinear read adds, at the
    displacement's fractions of a pixel. History off screen, or whose depth (nearest
    pixel at p - v) is not within 1 % of the pixel's own, is the sample s_k at age 0.
    The first frame is such a history, too.

    With sub-pixels, each pixel has 2 x 2, centred a quarter pixel from its centre and
    together a picture of twice the size. Colour and age of all four come from there,
    bilinearly (a tent of half a pixel), at their own centres minus the pixel's v; what
    is off screen, or of other depth, is told by the pixel. Then one of the four takes
    the sample in by the formulas above, but with fx and fy as fractions of a sub-pixel
    (b px^2 are added over the four frames of a turn); the others stay as they were
    read. It is that in whose quadrant the sample lies, the right or lower one on a tie;
    without jitter the (k mod 4)th of upper left, lower right, upper right, lower left.
    Shown is the mean of the four.

    - `subpixel`: whether there are sub-pixels.
    - `blur_limit_px2`: largest variance that resampling may add, px^2; above 0.
    - `min_weight`: least weight of the sample; in `[0, 1]`.
    - `jitter`: whether the camera moves its samples, 16 points.

    **Source:** Yang et al., "Amortized supersampling", SIGGRAPH Asia 2009: its
    recursion; limits and constants are derived here.
    """

    subpixel: bool = eqx.field(static=True, default=False)
    blur_limit_px2: Scalar = eqx.field(converter=_checks.number, default=0.5)
    min_weight: Scalar = eqx.field(converter=_checks.number, default=1 / 16)

    def __check_init__(self):
        _checks.boolean("subpixel", self.subpixel)
        _checks.in_range("blur_limit_px2", self.blur_limit_px2, 0, open_low=True)
        _checks.in_range("min_weight", self.min_weight, 0, 1)

    @property
    def id(self) -> str:
        """`amortized`, `amortized_subpixel`."""
        return self._id("amortized", "subpixel" if self.subpixel else "")

    @property
    def needs(self) -> frozenset[str]:
        """How pixels move, and what they show."""
        return frozenset({"color", "depth", "velocity"})

    @property
    def jitter_pattern_px(self) -> Float[np.ndarray, "period 2"]:
        """Halton points."""
        return sample_patterns.jitter(16)

    @property
    def stencil_radius_px(self) -> int:
        """Each pixel and its own past; sub-pixels reach into the next pixel."""
        return int(self.subpixel)

    @property
    def history_radius_px(self) -> int:
        """The past is read where it was shown."""
        return 0

    @property
    def is_valid(self) -> Bool[Array, ""] | bool:
        """Whether its numbers are in range."""
        is_share = (self.min_weight >= 0) & (self.min_weight <= 1)
        return is_share & (self.blur_limit_px2 > 0)

    def init(self, frame: Frame) -> Kept:
        """Keep the frame, at age 0."""
        cells = 2 if self.subpixel else 1
        pixels = jnp.broadcast_to(_new(frame), (cells, cells, *_new(frame).shape))
        return Kept(History(pixels), _nearness(frame), jnp.int32(0))

    def step(self, state: Kept, frame: Frame, motion: Motion) -> tuple[Kept, Rgb]:
        """Take the sample into the running mean."""
        at = frame.reprojection(motion)
        is_same = same_surface.has_depth(state.nearness, at, frame.depth)
        is_past = at.inside() & is_same
        if not self.subpixel:
            pixels = self._taken(self._past(state, at, frame, is_past), at, frame)
            texels, shown = pixels[None, None], pixels[:3]
        else:
            rows = [
                [self._cell((j, i), state, at, frame, is_past) for i in (0, 1)]
                for j in (0, 1)
            ]
            texels = jnp.stack([jnp.stack(row) for row in rows])
            shown = (texels[0, 0] + texels[0, 1] + texels[1, 0] + texels[1, 1])[:3] / 4
        return Kept(History(texels), _nearness(frame), state.frame + 1), shown

    def _past(
        self, state: Kept, at: AnyDisplacement, frame: Frame, is_past: Mask
    ) -> Planes:
        """Colour and age where each pixel was."""
        new = _new(frame)
        past = temporal.past(state.pixels, at, new, clamps=True)
        return jnp.where(is_past, past, new)

    def _taken(self, past: Planes, at: AnyDisplacement, frame: Frame) -> Planes:
        """Take the sample into a past; colour and age."""
        limits = self.blur_limit_px2, self.min_weight
        return running_mean.with_sample(past, frame.color[0], at, *limits)

    def _cell(
        self,
        cell: tuple[int, int],
        state: Kept,
        at: AnyDisplacement,
        frame: Frame,
        is_past: Mask,
    ) -> Planes:
        """Sub-pixel of each pixel after this frame."""
        row, column = cell
        # From texel (0, 0) of a pixel, half a pixel per texel. Before the first frame
        # all four are alike, and may be read as if the first were meant.
        there = at.changed(lambda dx: dx + column / 2, lambda dy: dy + row / 2)
        past = self._past(state, there, frame, is_past)
        if frame.jitter_px is None:
            is_turn = state.frame % 4 == _CELLS.index(cell)
        else:
            right, lower = frame.jitter_px >= 0
            is_turn = (right == bool(column)) & (lower == bool(row))
        twice = at.changed(lambda dx: 2 * dx, lambda dy: 2 * dy)
        return jnp.where(is_turn, self._taken(past, twice, frame), past)


def _new(frame: Frame) -> Float[Array, "4 height width"]:
    """Colour of a frame at age 0."""
    color = frame.color[0]
    return jnp.concatenate([color, jnp.zeros_like(color[:1])])


def _nearness(frame: Frame) -> History:
    return History.of(1 / frame.depth[None])
