"""Amortised supersampling (Yang et al.)."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .. import _checks, sample_patterns
from .._types import Planes, Rgb, Scalar
from ..filters import running_mean, same_surface, temporal
from ..frames.displacement import AnyDisplacement
from ..frames.frame import Frame
from ..frames.motion import Motion
from ..frames.sources import History
from ..technique_contract.base import AbstractTemporal, mean_of_samples

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
    together a picture of twice the size, where colour and age of all four are read
    bilinearly, at their own centres minus the pixel's v; rejected as the pixel is. Then
    that one takes the sample in, by the formulas above in sub-pixels (b px^2 are added
    over four frames), in whose quadrant the sample lies, the right or lower one on a
    tie; without jitter the (k mod 4)th of upper left, lower right, upper right, lower
    left. Shown is the mean of the four.

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
        cells, new = 2 if self.subpixel else 1, _new(frame)
        pixels = jnp.broadcast_to(new, (cells, cells, *new.shape))
        return Kept(History(pixels), History.of(1 / frame.depth[None]), jnp.int32(0))

    def step(self, state: Kept, frame: Frame, motion: Motion) -> tuple[Kept, Rgb]:
        """Take the sample into the running mean."""
        at, new, turn = frame.reprojection(motion), _new(frame), _turn(state, frame)
        is_past = same_surface.has_depth(state.nearness, at, frame.depth) & at.inside()

        def past(there: AnyDisplacement) -> Planes:
            shown = temporal.past(state.pixels, there, new, clamps=True)
            return jnp.where(is_past, shown, new)

        def taken(past: Planes, by: AnyDisplacement) -> Planes:
            limits = self.blur_limit_px2, self.min_weight
            return running_mean.with_sample(past, frame.color[0], by, *limits)

        def cell(row: int, column: int) -> Planes:
            # From texel (0, 0), half a pixel per texel; at first all four are alike.
            there = at.changed(lambda dx: dx + column / 2, lambda dy: dy + row / 2)
            twice = at.changed(lambda dx: 2 * dx, lambda dy: 2 * dy)
            mine = jnp.array([row, column], jnp.int32)
            is_turn, was = (turn == mine).all(), past(there)
            return jnp.where(is_turn, taken(was, twice), was)

        if self.subpixel:
            rows = [jnp.stack([cell(j, i) for i in (0, 1)]) for j in (0, 1)]
        else:
            rows = [taken(past(at), at)[None]]
        texels = jnp.stack(rows)
        shown = mean_of_samples(texels.reshape(-1, *new.shape)[:, :3], "gamma")
        return Kept(
            History(texels), History.of(1 / frame.depth[None]), state.frame + 1
        ), shown


def _turn(state: Kept, frame: Frame) -> Int[Array, "2"]:
    """Row and column of the sub-pixel that takes the sample."""
    if frame.jitter_px is None:
        return jnp.array(_CELLS, jnp.int32)[state.frame % 4]
    return (frame.jitter_px[::-1] >= 0).astype(jnp.int32)


def _new(frame: Frame) -> Float[Array, "4 height width"]:
    """Colour of a frame at age 0."""
    return jnp.concatenate([frame.color[0], jnp.zeros_like(frame.color[0, :1])])
