"""The technique contract.

A technique is a frozen configuration with `init(frame) -> state` and `step(state,
frame, motion) -> (state, displayed)`: pure, per region, on planes. A session calls
`init` with its first frame and `step` with every frame, the first one included (motion
0), so that displayed frame 0 is frame 0. Sources (history) are read only through
`source.at(displacement)`.

A large region may be stepped block by block, each with the state of the whole region:
what a state keeps per pixel is a `History`, and anything else in it, a counter say,
comes out the same for every block. Where it keeps a plane of another kind, or reads
neighbours in the current frame, the region is stepped in one piece.
"""

import abc
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .. import color, sample_patterns
from .._types import Rgb, Samples
from ..frames.frame import Frame
from ..frames.motion import Motion

State = Any
SPACES = ("gamma", "linear")


class HistoryReach(eqx.Module):
    """How what a frame shows depends on the frame before, for sizing halos.

    - `inwards_px`: how far history may come in through a region's left, top, right and
      bottom edge in each frame, px; negative where it is read from farther inside.
    - `gain`: how much of an error in the history can remain.
    - `display_slope`: largest change of the display per change of the history.
    """

    inwards_px: Float[np.ndarray, "*sessions frames 4"]
    gain: Float[np.ndarray, "*sessions frames"]
    display_slope: float = 1.0


class AbstractTechnique(eqx.Module):
    """An anti-aliasing technique."""

    remembers: ClassVar[bool] = True
    """Whether frames before the measured ones can matter (else they are not run)."""

    @property
    @abc.abstractmethod
    def id(self) -> str:
        """Name in tables and on the command line."""

    @property
    def sample_offsets_px(self) -> Float[np.ndarray, "period samples 2"]:
        """Sub-pixel samples: row k mod period, px from the centre, x right, y down."""
        return sample_patterns.centre()[None]

    @property
    def stencil_radius_px(self) -> int:
        """How far around a pixel the current frame is read; widens halos."""
        return 0

    @property
    def reads_supersampled(self) -> bool:
        """Whether one read of a texture's SSAA(4) channel is all of its samples."""
        return False

    @property
    def displays_history(self) -> bool:
        """Whether its state is one `History`, of exactly what it displays."""
        return False

    @property
    def is_valid(self) -> Bool[Array, ""] | bool:
        """Whether its numbers are in range: known only while running inside `jit`."""
        return True

    @abc.abstractmethod
    def init(self, frame: Frame) -> State:
        """State before the first frame."""

    @abc.abstractmethod
    def step(self, state: State, frame: Frame, motion: Motion) -> tuple[State, Rgb]:
        """Next state, and the displayed picture, gamma, `(3, height, width)`."""

    def on_pictures(self) -> "AbstractTechnique":
        """Return the technique that shows exactly the same on scenes without edges."""
        return self

    @abc.abstractmethod
    def history_reach(
        self,
        speed_deg_s: Float[np.ndarray, "*sessions frames"],
        span_px: Callable[[float], Float[np.ndarray, "*sessions frames 2 2"]],
    ) -> HistoryReach | None:
        """How far history reaches in each frame; None where there is none.

        **Arguments:** `speed_deg_s`: head speed; `span_px`: what a share of each
        increment displaces, as `camera.displacement_range` gives it.
        """


class AbstractSpatial(AbstractTechnique):
    """A technique that shows each frame on its own: samples in, one picture out."""

    remembers: ClassVar[bool] = False

    @abc.abstractmethod
    def resolve(self, frame: Frame) -> Rgb:
        """Return the picture of a frame's samples, gamma, `(3, height, width)`."""

    def init(self, frame: Frame) -> None:
        """Spatial techniques keep nothing."""

    def history_reach(self, speed_deg_s: object, span_px: object) -> None:
        """Spatial techniques read no history."""

    def step(self, state: None, frame: Frame, motion: Motion) -> tuple[None, Rgb]:
        """Show the resolved frame."""
        return None, self.resolve(frame)


def mean_of_samples(samples: Samples, space: str) -> Rgb:
    """Mean over samples in a colour space; gamma in and out, `(3, height, width)`."""
    if samples.shape[0] == 1:
        return samples[0]
    if space == "linear":
        return color.encode(jnp.mean(color.decode(samples), axis=0))
    return jnp.mean(samples, axis=0)
