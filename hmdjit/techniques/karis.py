"""Temporal supersampling of a game engine (Karis)."""

import numpy as np
from jaxtyping import Float

from .. import color, sample_patterns
from .._types import Plane, Rgb
from ..filters import neighborhood, temporal
from ..frames.frame import Frame
from ..frames.motion import Motion
from ..frames.sources import History
from ..technique_contract.base import AbstractTemporal

_CURRENT_WEIGHT = 0.1
_DECAY_PX2 = 2.29  # a fit of a Blackman-Harris window of 3.3 px


class Karis(AbstractTemporal):
    """Recursive mean in YCoCg, its past clipped towards the present; dark counts more.

    - `jitter`: whether the camera moves its samples, 8 points.

    **Source:** Karis, "High-quality temporal supersampling", SIGGRAPH 2014, from the
    published course notes.
    """

    @property
    def id(self) -> str:
        """`karis`."""
        return self._id("karis")

    @property
    def needs(self) -> frozenset[str]:
        """How pixels move, and which of them is in front."""
        return frozenset({"color", "depth", "velocity"})

    @property
    def jitter_pattern_px(self) -> Float[np.ndarray, "period 2"]:
        """Halton points."""
        return sample_patterns.jitter(8)

    @property
    def stencil_radius_px(self) -> int:
        """The block around a pixel."""
        return 1

    @property
    def history_radius_px(self) -> int:
        """The past is read where it was shown."""
        return 0

    def init(self, frame: Frame) -> History:
        """Keep the filtered frame, in YCoCg."""
        return History.of(_filtered(_sampled(frame), frame))

    def step(self, state: History, frame: Frame, motion: Motion) -> tuple[History, Rgb]:
        """Blend in the past of the nearest surface around, clipped to a rounded box."""
        at = temporal.dilated(frame, motion)
        sampled = _sampled(frame)
        current = _filtered(sampled, frame)
        past = temporal.past(state, at, current)
        past = temporal.clip_towards(past, current, neighborhood.rounded_box(sampled))
        now = _CURRENT_WEIGHT * _tone_weight(current)
        weight = now / (now + (1 - _CURRENT_WEIGHT) * _tone_weight(past))
        kept = past + weight[None] * (current - past)
        return History.of(kept), color.from_ycocg(kept)


def _sampled(frame: Frame) -> Rgb:
    rgb = frame.color[0]
    return neighborhood.apart(lambda: color.to_ycocg(rgb), rgb)


def _filtered(ycocg: Rgb, frame: Frame) -> Rgb:
    """Un-jitter by a Gaussian about the samples' places."""
    return neighborhood.gaussian_mean(ycocg, frame.content_px, _DECAY_PX2)


def _tone_weight(ycocg: Rgb) -> Plane:
    """Less weight of what is bright, so that it flickers less."""
    return 1 / (1 + ycocg[0])
