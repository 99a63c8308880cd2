"""An approximation of the temporal filter of "Uncharted 4" (Xu)."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import sample_patterns
from .._types import Rgb
from ..filters import neighborhood, same_surface, temporal
from ..frames.frame import Frame
from ..frames.motion import Motion
from ..frames.sources import History
from ..technique_contract.base import AbstractTemporal
from ..technique_contract.display_stages import Sharpening

_CURRENT_WEIGHT = 0.05

Kept = tuple[History, History]


class Uncharted4(AbstractTemporal):
    """Recursive mean of un-jittered frames, cut to the 3 x 3 block, and by objects.

    An approximation: the slides could not be had. Known are 16 jitters, the velocity of
    the nearest surface, the clamp to the un-jittered block, no past where the marks of
    objects, widened by a pixel, differ from those of the last frame, and sharpening of
    what is shown (5 in the centre, -1 beside it). Chosen are the weight of the present,
    0.05, and object ids as marks.

    - `jitter`: whether the camera moves its samples, 16 points.

    **Source:** Xu, "Temporal antialiasing in Uncharted 4", SIGGRAPH 2016, as others
    tell of it.
    """

    @property
    def id(self) -> str:
        """`uncharted4`."""
        return self._id("uncharted4")

    @property
    def needs(self) -> frozenset[str]:
        """How pixels move, which of them is in front, and what it belongs to."""
        return frozenset({"color", "depth", "object_id", "velocity"})

    @property
    def jitter_pattern_px(self) -> Float[np.ndarray, "period 2"]:
        """Halton points."""
        return sample_patterns.jitter(16)

    @property
    def stencil_radius_px(self) -> int:
        """Un-jittered neighbours, and once more for sharpening."""
        return 3

    @property
    def history_radius_px(self) -> int:
        """The past is read where it was shown."""
        return 0

    @property
    def display_slope(self) -> float:
        """That of sharpening."""
        return Sharpening("xu").slope

    def init(self, frame: Frame) -> Kept:
        """Keep the un-jittered frame, and its marks."""
        current = temporal.unjittered(frame.color[0], frame.jitter_px)
        return History.of(current), History.of(_marks(frame))

    def step(self, state: Kept, frame: Frame, motion: Motion) -> tuple[Kept, Rgb]:
        """Blend in the past of the nearest surface around, clamped to the block."""
        at = temporal.dilated(frame, motion)
        around = temporal.unjittered(frame.color[0], frame.jitter_px, margin_px=1)
        current = around[:, 1:-1, 1:-1]
        colors, marks = state
        past = temporal.past(colors, at, current)
        _, block = neighborhood.plus_and_block(around, margin_px=1)
        past = jnp.clip(past, block.low, block.high)
        now = _marks(frame)
        is_same = same_surface.nearest(marks, at) == now
        kept = current + (1 - _CURRENT_WEIGHT) * (past - current)
        kept = jnp.where(is_same, kept, current)
        shown = Sharpening("xu").show(kept, frame, motion)
        return (History.of(kept), History.of(now)), shown


def _marks(frame: Frame) -> Float[Array, "1 height width"]:
    """Largest object id of each 3 x 3 block."""
    marks = frame.object_id[None].astype(frame.color.dtype)
    return neighborhood.plus_and_block(marks)[1].high
