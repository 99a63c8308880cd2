"""The frozen picture: a control, not a technique."""

from .._types import Rgb
from ..frames.frame import Frame
from ..frames.motion import Motion
from ..frames.sources import History
from ..technique_contract.base import AbstractTechnique
from ..technique_contract.small_motion import Still


class Freeze(AbstractTechnique):
    """Show frame 0 for ever: no flicker at all, and all detail of later frames lost.

    It wins every comparison by MTCD alone, which is why detail loss stands beside it.
    """

    @property
    def id(self) -> str:
        """The one id, `freeze`."""
        return "freeze"

    @property
    def stencil_radius_px(self) -> int:
        """Each pixel keeps its own past."""
        return 0

    def init(self, frame: Frame) -> History:
        """Keep the first frame."""
        return History.of(frame.color[0])

    def step(self, state: History, frame: Frame, motion: Motion) -> tuple[History, Rgb]:
        """Show the first frame again."""
        kept = state.under(frame.region)
        return History.of(kept), kept

    def small_motion(self) -> Still:
        """Say that the display never changes."""
        return Still()
