"""The frozen picture: a control, not a technique."""

from .._types import Rgb
from ..frames.frame import Frame
from ..frames.motion import Motion
from ..frames.sources import History
from .base import AbstractTechnique


class Freeze(AbstractTechnique):
    """Show frame 0 for ever: no flicker at all, and all detail of later frames lost.

    It wins every comparison by MTCD alone, which is why detail loss stands beside it.
    """

    @property
    def id(self) -> str:
        """`freeze`."""
        return "freeze"

    @property
    def displays_history(self) -> bool:
        """It does."""
        return True

    def init(self, frame: Frame) -> History:
        """Keep the first frame."""
        return History.of(frame.color[0])

    def history_reach(self, speed_deg_s: object, span_px: object) -> None:
        """Each pixel keeps its own past: nothing reaches another."""

    def step(self, state: History, frame: Frame, motion: Motion) -> tuple[History, Rgb]:
        """Show it again."""
        kept = state.under(frame.region)
        return History.of(kept), kept
