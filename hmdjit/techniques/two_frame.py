"""Two frames, weighted by how their speeds agree (CryENGINE 3)."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .. import sample_patterns
from .._types import Rgb
from ..filters import motion_blur, temporal
from ..frames.frame import Frame
from ..frames.motion import Motion
from ..frames.sources import History
from ..technique_contract.base import AbstractTemporal

_LARGEST_WEIGHT = 0.5
_SENSITIVITY = 30.0  # per square root of a frame's width and height per frame


class TwoFrame(AbstractTemporal):
    """Mean of this frame and the last one, where each pixel's speed stayed the same.

    `w = sat(1 - 30 sqrt(||v_k(p)| - |v_{k-1}(p - v)||)) / 2` is the weight of the last
    frame, as it was rendered, where the pixel was; 0 off screen. Speeds are in widths
    and heights of the camera frame per frame.

    - `jitter`: whether the camera samples a quarter pixel to both sides in turn.

    **Source:** Sousa, "Anti-aliasing methods in CryENGINE 3", SIGGRAPH 2011, in the
    form of Jimenez et al., "SMAA", 2012, whose code has the weight.
    """

    @property
    def id(self) -> str:
        """`two_frame`."""
        return self._id("two_frame")

    @property
    def needs(self) -> frozenset[str]:
        """How pixels move."""
        return frozenset({"color", "velocity"})

    @property
    def jitter_pattern_px(self) -> Float[np.ndarray, "period 2"]:
        """Quarter pixels along the diagonal; the picture goes the other way."""
        return -sample_patterns.multisample(2)

    @property
    def stencil_radius_px(self) -> int:
        """Each pixel and its own past."""
        return 0

    def init(self, frame: Frame) -> History:
        """Keep the frame, at rest."""
        color = frame.color[0]
        return History.of(jnp.concatenate([color, jnp.zeros_like(color[:1])]))

    def step(self, state: History, frame: Frame, motion: Motion) -> tuple[History, Rgb]:
        """Blend the last frame in; keep this one and its speed."""
        at = frame.reprojection(motion)
        dx, dy = at.px()
        size = frame.camera.width_px, frame.camera.height_px
        speed = motion_blur.length(dx / size[0], dy / size[1])
        current = jnp.concatenate([frame.color[0], speed[None]])
        past = temporal.past(state, at, current)
        weight = _LARGEST_WEIGHT * temporal.likeness(speed, past[3], _SENSITIVITY)
        shown = current[:3] + weight[None] * (past[:3] - current[:3])
        return History.of(current), shown
