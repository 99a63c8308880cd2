"""The temporal filter of the game INSIDE (Pedersen)."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .. import _checks, color, sample_patterns
from .._types import Rgb
from ..filters import motion_blur, neighborhood, temporal
from ..filters.neighborhood import Box
from ..frames.displacement import AnyDisplacement, DisplacementField
from ..frames.frame import Frame
from ..frames.motion import Motion
from ..frames.sources import History
from ..technique_contract.base import OFF_SCREEN, AbstractTemporal

_FEEDBACK = 0.88, 0.97  # weight of the past, least and largest
_CHROMA = 0.125  # half the extent of chroma's box, of luma's extent
_TRUST_PX = 2.0, 15.0  # speeds up to which, and from which, blur is not, and all
_TAPS = 7
_LONGEST_PX = 64  # smear
_REACH_PX = _LONGEST_PX // 2 + 2  # of it, jittered


class Inside(AbstractTemporal):
    """Recursive mean of un-jittered frames, its past clipped to what is around now.

    - `ycocg`: clip luma and chroma apart, chroma about the pixel's own.
    - `motion_blur`: show what moves by more than 2 px per frame smeared, from 15 on
      nothing else; what is kept is sharp. Smears are cut to 64 px.
    - `off_screen`: past that is off screen is the screen's edge, `"clamp"`, or
      `"reject"`, the present.
    - `jitter`: whether the camera moves its samples, 16 points. In headsets the public
      code does not.

    **Source:** Pedersen, "Temporal reprojection anti-aliasing in INSIDE", GDC 2016,
    with the defaults of its public code; neither its noise nor its 8 bits are kept.
    """

    ycocg: bool = eqx.field(static=True, default=False)
    motion_blur: bool = eqx.field(static=True, default=False)
    off_screen: str = eqx.field(static=True, default="clamp")

    def __check_init__(self):
        _checks.boolean("ycocg", self.ycocg)
        _checks.boolean("motion_blur", self.motion_blur)
        _checks.one_of("off_screen", self.off_screen, OFF_SCREEN)

    @property
    def id(self) -> str:
        """`inside`, and what is not its default: `inside_ycocg_motion_blur_reject`."""
        words = ["ycocg"] * self.ycocg + ["motion_blur"] * self.motion_blur
        words += ["reject"] * (self.off_screen == "reject")
        return self._id("inside", *words)

    @property
    def needs(self) -> frozenset[str]:
        """How pixels move, and which of them is in front."""
        return frozenset({"color", "depth", "velocity"})

    @property
    def jitter_pattern_px(self) -> Float[np.ndarray, "period 2"]:
        """Halton points."""
        return sample_patterns.jitter(16)

    @property
    def stencil_radius_px(self) -> int:
        """The block around a pixel, un-jittered; or how far a smear reaches."""
        return _REACH_PX if self.motion_blur else 2

    @property
    def history_radius_px(self) -> int:
        """The past is read where it was shown."""
        return 0

    def init(self, frame: Frame) -> History:
        """Keep the un-jittered frame."""
        return History.of(temporal.unjittered(self._sampled(frame), frame.jitter_px))

    def step(self, state: History, frame: Frame, motion: Motion) -> tuple[History, Rgb]:
        """Blend in the past of the nearest surface around, clipped to a rounded box."""
        at, sampled = temporal.dilated(frame, motion), self._sampled(frame)
        current = temporal.unjittered(sampled, frame.jitter_px)
        past = temporal.past(state, at, current, clamps=self.off_screen == "clamp")
        around = neighborhood.rounded_box(sampled)
        own = lambda: _about_chroma(around, current)
        box = neighborhood.apart(own, current) if self.ycocg else around
        past = temporal.clip_to_center(past, box)
        luma = (lambda ycocg: ycocg[0]) if self.ycocg else color.luma
        weight = temporal.feedback_weight(luma(current), luma(past), *_FEEDBACK)
        kept = neighborhood.apart(
            lambda: current + weight[None] * (past - current), current
        )
        shown = color.from_ycocg(kept) if self.ycocg else kept
        shown = _blurred(shown, at, frame) if self.motion_blur else shown
        return History.of(kept), shown

    def _sampled(self, frame: Frame) -> Rgb:
        """Colours as they are filtered and kept."""
        rgb = frame.color[0]
        return (
            neighborhood.apart(lambda: color.to_ycocg(rgb), rgb) if self.ycocg else rgb
        )


def _about_chroma(box: Box, current: Rgb) -> Box:
    """Box of luma, with one of chroma about the current pixel's."""
    extent = jnp.broadcast_to(
        _CHROMA * (box.high - box.low)[:1], (2, *box.low.shape[1:])
    )
    ends = [current[1:] - extent, current[1:] + extent]
    low, high = (
        jnp.concatenate([luma[:1], chroma])
        for luma, chroma in zip(box, ends, strict=True)
    )
    return Box(low, high)


def _blurred(sharp: Rgb, at: AnyDisplacement, frame: Frame) -> Rgb:
    """Smear what is fast, along its motion."""
    speed_px = motion_blur.length(*at.px())
    slow, fast = _TRUST_PX
    share = jnp.clip((speed_px - slow) / (fast - slow), 0, 1)[None]

    def blurred() -> Rgb:
        ways = motion_blur.cut(*at.px(), _LONGEST_PX)
        way = DisplacementField(frame.camera, frame.region, *ways, None, frame.reading)
        return motion_blur.smeared(frame.color[0], way, frame.content_px, _TAPS)

    def mixed() -> Rgb:
        return sharp + share * (blurred() - sharp)

    if frame.reading.sampler == "plain":  # see `sources.read`
        return mixed()
    return jax.lax.cond(jnp.any(share > 0), mixed, lambda: sharp)
