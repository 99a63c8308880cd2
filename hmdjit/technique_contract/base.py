"""The technique contract.

A technique is a frozen configuration. It must say its `id`, `init(frame) -> state` and
`step(state, frame, motion) -> (state, displayed)`: pure, per region, on planes. A
session calls `init` with its first frame and `step` with every frame, the first one
included (motion 0), so that displayed frame 0 is frame 0. Sources (history) are read
only through `source.at(displacement)`: not inside of `jit`, `vmap`, `cond` or loops.

Where it needs them it also says `needs`, the channels of a frame, and
`sample_offsets_px`. All else has a safe default: what there is to know for speed is
found by the engine, or is a hint. A wrong hint of a technique of one's own is an error
(see `check`), never a bias. A class that itself names a `version`, to be changed with
all that it computes with, has its batches kept by studies for a resume.

A large region may be stepped block by block, each with the state of the whole region:
what a state keeps per pixel is a `History`, and anything else in it, a counter say,
comes out the same for every block. Where it keeps a plane of another kind, or may read
neighbours in the current frame, the region is stepped in one piece.
"""

import abc
import functools
import re
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .. import _checks, color, sample_patterns
from .._types import Rgb, Samples
from ..frames.frame import Frame
from ..frames.motion import Motion
from .small_motion import SmallMotion

State = Any
SPACES = ("gamma", "linear")
OFF_SCREEN = ("clamp", "reject")
_UNROLLED = 16  # samples that are added without a loop


class AbstractTechnique(eqx.Module):
    """An anti-aliasing technique."""

    @property
    @abc.abstractmethod
    def id(self) -> str:
        """Name in tables and on the command line."""

    @property
    def paper(self) -> str:
        """Whose it is, and from when, by the `Source` in its class's docstring."""
        _, _, source = (type(self).__doc__ or "").partition("**Source:** ")
        authors, _, rest = source.partition("\n\n")[0].partition(",")
        year = re.search(r"\b(?:19|20)\d\d\b", rest)
        return " ".join([*authors.split(), *([year[0]] if year else [])])

    @property
    def needs(self) -> frozenset[str]:
        """Channels of a frame that are read; a scene must give them."""
        return frozenset({"color"})

    @property
    def reads_jitter(self) -> bool:
        """Whether it matters where in its pixel a frame's one sample lies."""
        return bool(self.sample_offsets_px.any())

    @property
    def reads_static_mask(self) -> bool:
        """Whether it reads `Frame.static_mask`; `apply` refuses a mask if not."""
        return False

    @property
    def reads_steps(self) -> bool:
        """Whether it reads `Frame.steps`, so that no velocity stands for them."""
        return False

    @property
    def sample_offsets_px(self) -> Float[np.ndarray, "period samples 2"]:
        """Sub-pixel samples: row k mod period, px from the centre, x right, y down."""
        return sample_patterns.centre()[None]

    @abc.abstractmethod
    def init(self, frame: Frame) -> State:
        """State before the first frame."""

    @abc.abstractmethod
    def step(self, state: State, frame: Frame, motion: Motion) -> tuple[State, Rgb]:
        """Next state, and the displayed picture, gamma, `(3, height, width)`."""

    @property
    def is_valid(self) -> Bool[Array, ""] | bool:
        """Whether its numbers are in range: known only while running inside `jit`."""
        return True

    # Hints.

    @property
    def stencil_radius_px(self) -> int | None:
        """How far around a pixel the current frame and the history are read.

        None lets the engine find it, by what a changed pixel changes. A technique whose
        reach depends on the picture, as a search along an edge does, must say it.
        """
        return None

    @property
    def history_radius_px(self) -> int | None:
        """How far around the pixels that are read of it the history counts for itself.

        What is kept, not what is shown. None is the stencil.
        """
        return None

    def history_gain(
        self, speed_deg_s: Float[np.ndarray, "*sessions frames"]
    ) -> Float[np.ndarray, "*sessions frames"]:
        """How much of an error in the history can remain in each frame; 1 is all."""
        return np.ones_like(speed_deg_s)

    @property
    def display_slope(self) -> float:
        """Largest change of the display per change of the history."""
        return 1.0

    @property
    def reads_supersampled(self) -> bool:
        """Whether one read of a scene's SSAA(4) channel is all of its samples."""
        return False

    @property
    def shades_once_per_pixel(self) -> bool:
        """Whether samples of one surface share its shade, as in multisampling."""
        return False

    def on_pictures(self) -> "AbstractTechnique":
        """Return the technique that shows exactly the same on scenes without edges."""
        return self

    def small_motion(self) -> SmallMotion | None:
        """Return how what it shows moves with a small motion; None if that is unknown.

        Predictions made of it only decide how few sessions a study needs.
        """
        return None


class AbstractSpatial(AbstractTechnique):
    """A technique that shows each frame on its own: samples in, one picture out."""

    @abc.abstractmethod
    def resolve(self, frame: Frame) -> Rgb:
        """Return the picture of a frame's samples, gamma, `(3, height, width)`."""

    def init(self, frame: Frame) -> None:
        """Spatial techniques keep nothing."""

    def step(self, state: None, frame: Frame, motion: Motion) -> tuple[None, Rgb]:
        """Show the resolved frame."""
        return None, self.resolve(frame)


class AbstractTemporal(AbstractTechnique):
    """A technique that accumulates frames, each sampled at another place of its pixels.

    - `jitter`: whether the camera moves the samples; in a headset the head does, too.
    """

    jitter: bool = eqx.field(static=True, default=True, kw_only=True)

    def __check_init__(self):
        _checks.boolean("jitter", self.jitter)

    @property
    @abc.abstractmethod
    def jitter_pattern_px(self) -> Float[np.ndarray, "period 2"]:
        """Where the camera samples, frame by frame, px from the centre, y down."""

    @property
    def sample_offsets_px(self) -> Float[np.ndarray, "period samples 2"]:
        """The pattern, or the centre without jitter."""
        pattern = self.jitter_pattern_px if self.jitter else sample_patterns.centre()
        return pattern[:, None]

    @property
    def reads_jitter(self) -> bool:
        """Frames that are rendered elsewhere may be jittered, whatever is asked for."""
        return True

    def _id(self, *words: str) -> str:
        """Join what is not a default, jitter last; empty words are left out."""
        return "_".join(filter(None, [*words, "" if self.jitter else "no_jitter"]))


def mean_of_samples(samples: Samples, space: str) -> Rgb:
    """Mean over samples in a colour space; gamma in and out, `(3, height, width)`.

    **Accuracy:** summed in float32, or float64 if samples are.
    """
    count, dtype = len(samples), samples.dtype
    if count == 1:
        return samples[0]
    is_linear, summed_in = space == "linear", np.promote_types(dtype, np.float32)

    def added(total: Rgb, gamma: Rgb) -> Rgb:
        light = color.decode(gamma) if is_linear else gamma
        return total + light.astype(summed_in)

    # On CPUs XLA's own mean over a first axis takes seven times as long, or more.
    total = jnp.zeros(samples.shape[1:], summed_in)
    if count <= _UNROLLED:
        total = functools.reduce(added, samples, total)
    else:
        add = lambda total, gamma: (added(total, gamma), None)
        total, _ = jax.lax.scan(add, total, samples)
    mean = (total / count).astype(dtype)
    return color.encode(mean) if is_linear else mean
