"""What Oliveros' thesis compares with, and calls "Uncharted TAA"."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .. import _checks, sample_patterns
from .._types import Rgb
from ..filters import neighborhood, temporal
from ..frames.frame import Frame
from ..frames.motion import Motion
from ..frames.sources import History
from ..technique_contract.base import OFF_SCREEN, AbstractTemporal
from ..technique_contract.display_stages import Sharpening

_TIE = 1e-5


class ThesisBaseline(AbstractTemporal):
    """INSIDE's filter with other numbers, among un-jittered neighbours; sharpened.

    Of Xu's technique for "Uncharted 4" it has the sharpening only (5 in the centre, -1
    beside it), of what is shown and not of what is kept.

    - `off_screen`: past that is off screen is the screen's edge, `"clamp"`, or
      `"reject"`, the present.
    - `jitter`: whether the camera moves its samples, 16 points over 1.7 px.

    **Source:** code of Oliveros' thesis, whose motion blur never acts.
    """

    off_screen: str = eqx.field(static=True, default="clamp")

    def __check_init__(self):
        _checks.one_of("off_screen", self.off_screen, OFF_SCREEN)

    @property
    def id(self) -> str:
        """`thesis_baseline`, `thesis_baseline_reject`."""
        words = ["reject"] * (self.off_screen == "reject")
        return self._id("thesis_baseline", *words)

    @property
    def needs(self) -> frozenset[str]:
        """How pixels move, and which of them is in front."""
        return frozenset({"color", "depth", "velocity"})

    @property
    def jitter_pattern_px(self) -> Float[np.ndarray, "period 2"]:
        """Scrambled Halton points: as the accumulation buffer's, farther apart."""
        return sample_patterns.thesis_jitter()

    @property
    def stencil_radius_px(self) -> int:
        """Un-jittered neighbours, and once more for sharpening."""
        return 4

    @property
    def history_radius_px(self) -> int:
        """The past is read where it was shown."""
        return 0

    @property
    def display_slope(self) -> float:
        """That of sharpening."""
        return Sharpening("xu").slope

    def init(self, frame: Frame) -> History:
        """Keep the un-jittered frame."""
        return History.of(temporal.unjittered(frame.color[0], frame.jitter_px))

    def step(self, state: History, frame: Frame, motion: Motion) -> tuple[History, Rgb]:
        """Blend in the past of the nearest surface around, clipped to a rounded box."""
        at = temporal.dilated(frame, motion, temporal.thesis_depth(frame.depth), _TIE)
        around = temporal.unjittered(frame.color[0], frame.jitter_px, margin_px=1)
        current = around[:, 1:-1, 1:-1]
        past = temporal.past(state, at, current, clamps=self.off_screen == "clamp")
        box = neighborhood.rounded_box(around, margin_px=1)
        past = temporal.clip_to_center(past, box)
        kept = temporal.thesis_blend(current, past)
        return History.of(kept), Sharpening("xu").show(kept, frame, motion)
