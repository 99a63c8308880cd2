"""What a display does to the finished picture: sharpening, motion blur.

A stage comes after a technique and never enters its history.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .. import _checks
from .._types import Rgb, Scalar
from ..filters import motion_blur, neighborhood
from ..frames import resampling
from ..frames.frame import Frame
from ..frames.motion import Motion
from .base import AbstractTechnique, State

SHARPENING = {"thesis": 1 / 4, "xu": 1.0}
"""What the four neighbours are worth in each kernel."""


class AbstractStage(eqx.Module):
    """A stage of display: a finished picture in, a picture out, both gamma."""

    @property
    @abc.abstractmethod
    def id(self) -> str:
        """Name behind that of a technique."""

    @property
    def needs(self) -> frozenset[str]:
        """Channels of a frame that are read."""
        return frozenset()

    @property
    @abc.abstractmethod
    def stencil_radius_px(self) -> int:
        """How far around a pixel the picture is read."""

    @property
    def slope(self) -> float:
        """Largest change of a pixel per change of the picture."""
        return 1.0

    @property
    def is_valid(self) -> Bool[Array, ""] | bool:
        """Whether its numbers are in range."""
        return True

    @abc.abstractmethod
    def show(self, picture: Rgb, frame: Frame, motion: Motion) -> Rgb:
        """Return what the stage makes of a picture."""


class Displayed(AbstractTechnique):
    """A technique whose pictures pass through a stage of display.

    What the technique keeps, and so its later pictures, are as without the stage.
    """

    technique: AbstractTechnique
    stage: AbstractStage

    def __check_init__(self):
        kinds = {"technique": AbstractTechnique, "stage": AbstractStage}
        for name, kind in kinds.items():
            if not isinstance(found := getattr(self, name), kind):
                raise ValueError(f"{name} must be an {kind.__name__}, got {found!r}.")

    @property
    def id(self) -> str:
        """`none+sharpen`: the technique's and the stage's."""
        return f"{self.technique.id}+{self.stage.id}"

    @property
    def paper(self) -> str:
        """That of the technique."""
        return self.technique.paper

    @property
    def needs(self) -> frozenset[str]:
        """What either needs."""
        return self.technique.needs | self.stage.needs

    @property
    def sample_offsets_px(self) -> Float[np.ndarray, "period samples 2"]:
        """The technique's."""
        return self.technique.sample_offsets_px

    @property
    def stencil_radius_px(self) -> int | None:
        """Both together."""
        radius_px = self.technique.stencil_radius_px
        return None if radius_px is None else radius_px + self.stage.stencil_radius_px

    @property
    def history_radius_px(self) -> int | None:
        """The technique's: the stage is no part of the history."""
        radius_px = self.technique.history_radius_px
        return self.technique.stencil_radius_px if radius_px is None else radius_px

    def init(self, frame: Frame) -> State:
        """Start the technique."""
        return self.technique.init(frame)

    def step(self, state: State, frame: Frame, motion: Motion) -> tuple[State, Rgb]:
        """Step the technique, and show its picture by the stage."""
        state, picture = self.technique.step(state, frame, motion)
        return state, self.stage.show(picture, frame, motion)

    @property
    def is_valid(self) -> Bool[Array, ""] | bool:
        """Whether both are."""
        return self.technique.is_valid & self.stage.is_valid

    def history_gain(
        self, speed_deg_s: Float[np.ndarray, "*sessions frames"]
    ) -> Float[np.ndarray, "*sessions frames"]:
        """Return the technique's."""
        return self.technique.history_gain(speed_deg_s)

    @property
    def display_slope(self) -> float:
        """Both together."""
        return self.technique.display_slope * self.stage.slope

    @property
    def reads_supersampled(self) -> bool:
        """As the technique."""
        return self.technique.reads_supersampled

    @property
    def reads_static_mask(self) -> bool:
        """As the technique."""
        return self.technique.reads_static_mask

    @property
    def reads_jitter(self) -> bool:
        """As the technique."""
        return self.technique.reads_jitter

    @property
    def reads_steps(self) -> bool:
        """As the technique."""
        return self.technique.reads_steps

    @property
    def shades_once_per_pixel(self) -> bool:
        """As the technique."""
        return self.technique.shades_once_per_pixel

    def on_pictures(self) -> "Displayed":
        """Return the stage behind what the technique is on pictures."""
        return Displayed(self.technique.on_pictures(), self.stage)


class Sharpening(AbstractStage):
    """Add what sets a pixel apart from its four neighbours; clipped to `[0, 1]`.

    - `kernel`: `"thesis"`, 2 in the centre and -1/4 beside it; or `"xu"`, 5 and -1.

    **Source:** Oliveros, thesis; Xu, "Temporal antialiasing in Uncharted 4", 2016.
    """

    kernel: str = eqx.field(static=True, default="thesis")

    def __check_init__(self):
        _checks.one_of("kernel", self.kernel, SHARPENING)

    @property
    def id(self) -> str:
        """`sharpen`, or `sharpen_xu`."""
        return "sharpen" + "_xu" * (self.kernel == "xu")

    @property
    def stencil_radius_px(self) -> int:
        """The neighbours."""
        return 1

    @property
    def slope(self) -> float:
        """Sum of the kernel's absolute weights."""
        return 1 + 8 * SHARPENING[self.kernel]

    def show(self, picture: Rgb, frame: Frame, motion: Motion) -> Rgb:
        """Sharpen."""
        return jnp.clip(neighborhood.sharpened(picture, SHARPENING[self.kernel]), 0, 1)


class MotionBlur(AbstractStage):
    """Smear each pixel along its motion, as a camera of fewer pictures per second.

    Of n taps, one is the pixel itself, and the others reach from `1 / (n - 1)` of the
    smear after its beginning to its end: a moving picture is shifted by `1 / (2 n)` of
    its smear, as published.

    - `target_fps`: of that camera, whose shutter is always open; above 0.
    - `most_taps`: per pixel, about one px apart; at least 1. Half as many pixels is how
      far a smear reaches: where it would be longer, it is cut to `most_taps` px.

    **Source:** Chapman, "Per-object motion blur", 2012, by Oliveros' thesis, 3.6.6.
    """

    target_fps: Scalar = eqx.field(converter=_checks.number, default=25.0)
    most_taps: int = eqx.field(static=True, default=64)

    def __check_init__(self):
        _checks.in_range("target_fps", self.target_fps, 0, open_low=True)
        _checks.whole("most_taps", self.most_taps, 1)

    @property
    def id(self) -> str:
        """`motion_blur`, and what is not its default: `motion_blur30_taps8`."""
        fps = self.target_fps
        known = "" if _checks.is_traced(fps) or fps == 25 else f"{float(fps):g}"
        return f"motion_blur{known}" + f"_taps{self.most_taps}" * (self.most_taps != 64)

    @property
    def needs(self) -> frozenset[str]:
        """How pixels move."""
        return frozenset({"velocity"})

    @property
    def stencil_radius_px(self) -> int:
        """Half of the longest smear, and one between pixels."""
        return self.most_taps // 2 + 1

    @property
    def is_valid(self) -> Bool[Array, ""] | bool:
        """Whether the rate is above 0."""
        return self.target_fps > 0

    def show(self, picture: Rgb, frame: Frame, motion: Motion) -> Rgb:
        """Mean of the taps."""
        region, dtype = frame.region, picture.dtype
        exposure = frame.camera.refresh_hz / self.target_fps
        dx, dy = (
            (-exposure * plane).astype(dtype)
            for plane in frame.reprojection(motion).px()
        )
        length = motion_blur.length(dx, dy)
        taps = jnp.clip(jnp.floor(jax.lax.stop_gradient(length)), 1, self.most_taps)
        dx, dy = motion_blur.cut(dx, dy, self.most_taps)
        spacing = 1 / jnp.maximum(taps - 1, 1)
        columns = jnp.arange(region.width, dtype=jnp.int32)[None, :]
        rows = jnp.arange(region.height, dtype=jnp.int32)[:, None]

        def add(total: Rgb, i: Array) -> Rgb:
            along = i * spacing - 0.5
            read = resampling.bilinear(
                picture[None, None], columns, rows, along * dx, along * dy
            )
            return total + jnp.where((i < taps)[None], read, 0)

        def tap(total: Rgb, i: Array) -> tuple[Rgb, None]:
            if frame.reading.sampler == "plain":  # see `sources.read`
                return add(total, i), None
            is_used = i < jnp.max(taps)
            return jax.lax.cond(is_used, add, lambda total, _: total, total, i), None

        others = jnp.arange(1, self.most_taps, dtype=dtype)
        total, _ = jax.lax.scan(tap, picture, others)
        return total / taps[None]
