"""Spatial techniques: none, super- and multisampling, the accumulation buffer."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .. import _checks, color, sample_patterns
from .._types import Rgb
from ..filters import downsampling
from ..frames.frame import Frame
from ..technique_contract.base import SPACES, AbstractSpatial, mean_of_samples
from ..technique_contract.small_motion import AsRendered

FILTERS = ("box", "lanczos2")


class _OwnSamples(AbstractSpatial):
    """Each pixel shows what its own samples see."""

    @property
    def stencil_radius_px(self) -> int:
        """No neighbour is read."""
        return 0

    def small_motion(self) -> AsRendered:
        """Move with the scene."""
        return AsRendered()


class NoAntialiasing(_OwnSamples):
    """One sample at the pixel centre."""

    @property
    def id(self) -> str:
        """The one id, `none`."""
        return "none"

    def resolve(self, frame: Frame) -> Rgb:
        """Return the one sample."""
        return frame.color[0]


class SSAA(AbstractSpatial):
    """Supersampling: `factor` x `factor` samples per pixel, filtered.

    BL, BG, LL and LG of the source are `SSAA(2, space, filter)`: the filter's letter
    comes first.

    - `factor`: samples per axis; 4 is the reference that detail loss is measured
      against.
    - `space`: what is filtered, `"linear"` light, encoded afterwards, or `"gamma"`.
    - `filter`: `"box"`, the mean of a pixel's own samples, or `"lanczos2"`.
    - `taps`: of Lanczos, `"exact"` or 11; see `downsampling.lanczos2_weights`.

    **Source:** Maruszczuk et al., who compare these forms of it.
    """

    factor: int = eqx.field(static=True, default=4)
    space: str = eqx.field(static=True, default="linear")
    filter: str = eqx.field(static=True, default="box")
    taps: downsampling.Taps = eqx.field(static=True, default="exact")

    def __check_init__(self):
        _checks.whole("factor", self.factor, 1)
        _checks.one_of("space", self.space, SPACES)
        _checks.one_of("filter", self.filter, FILTERS)
        downsampling.check_taps(self.taps)
        if self.filter == "box" and self.taps != "exact":
            raise ValueError(
                f"taps must be 'exact' with filter = 'box', got {self.taps!r}."
            )

    @property
    def id(self) -> str:
        """`ssaa4`, with the factor, and what is not the default: filter, taps, space.

        `ssaa2_lanczos2_taps11_gamma` has all of them.
        """
        words = [f"ssaa{self.factor}"]
        words += ["lanczos2"] * (self.filter == "lanczos2")
        words += [f"taps{self.taps}"] * (self.taps != "exact")
        words += ["gamma"] * (self.space == "gamma")
        return "_".join(words)

    @property
    def sample_offsets_px(self) -> Float[np.ndarray, "period samples 2"]:
        """Return an ordered grid."""
        return sample_patterns.ordered_grid(self.factor)[None]

    @property
    def stencil_radius_px(self) -> int:
        """Lanczos reads the samples of neighbours."""
        if self.filter == "box":
            return 0
        return downsampling.lanczos2_radius_px(self.factor, self.taps)

    @property
    def reads_supersampled(self) -> bool:
        """SSAA(4), box and linear light, is what a texture carries ready made."""
        return self.id == "ssaa4"

    def small_motion(self) -> AsRendered | None:
        """Move with the scene; of Lanczos that is not all."""
        return AsRendered() if self.filter == "box" else None

    def resolve(self, frame: Frame) -> Rgb:
        """Filter the samples."""
        if self.filter == "box":
            return mean_of_samples(frame.color, self.space)
        if self.space == "gamma":
            return downsampling.lanczos2(frame.color, self.factor, self.taps)
        light = color.decode(frame.color)
        return color.encode(downsampling.lanczos2(light, self.factor, self.taps))


class MSAA(_OwnSamples):
    """Multisampling: coverage per sample, shading once per pixel and surface.

    Inside a surface, and so everywhere on a picture, it shows exactly what no
    anti-aliasing shows: it smooths the edges of geometry, not textures. That is why
    Kim et al. measure their technique against it on flickering textures.

    - `samples`: 1, 2, 4, 8 or 16, in the standard patterns.
    - `space`: where samples are averaged, `"linear"` or `"gamma"`.
    """

    samples: int = eqx.field(static=True, default=4)
    space: str = eqx.field(static=True, default="linear")

    def __check_init__(self):
        sample_patterns.multisample(self.samples)
        _checks.one_of("space", self.space, SPACES)

    @property
    def id(self) -> str:
        """`msaa4`, with the number of samples; `_gamma` where that is the space."""
        return f"msaa{self.samples}" + "_gamma" * (self.space == "gamma")

    @property
    def sample_offsets_px(self) -> Float[np.ndarray, "period samples 2"]:
        """Where coverage is tested."""
        return sample_patterns.multisample(self.samples)[None]

    def resolve(self, frame: Frame) -> Rgb:
        """Mean over samples of the surface's shade; one shade where nothing ends."""
        return mean_of_samples(frame.color, self.space)

    @property
    def shades_once_per_pixel(self) -> bool:
        """A surface has one shade per pixel."""
        return True

    def on_pictures(self) -> NoAntialiasing:
        """No anti-aliasing: the run is shared."""
        return NoAntialiasing()


class AccumulationBuffer(_OwnSamples):
    """Reference picture: the mean of many renders, each moved by part of a pixel.

    - `samples`: renders, 1 to 1024, at a scrambled Halton sequence's places; the thesis
      has 128, and compares them with 16.
    - `space`: where the mean is taken, `"linear"` or `"gamma"`.

    **Accuracy:** a whole region is held at once, 12 `samples` bytes per pixel.

    **Source:** Oliveros, master's thesis, 2018, section 4.1, and its code.
    """

    samples: int = eqx.field(static=True, default=128)
    space: str = eqx.field(static=True, default="linear")

    def __check_init__(self):
        _checks.whole("samples", self.samples, 1)
        _checks.in_range("samples", self.samples, 1, 1024)
        _checks.one_of("space", self.space, SPACES)

    @property
    def id(self) -> str:
        """`accumulation128`, with the samples, and `_gamma` where that is the space."""
        return f"accumulation{self.samples}" + "_gamma" * (self.space == "gamma")

    @property
    def sample_offsets_px(self) -> Float[np.ndarray, "period samples 2"]:
        """Return the sequence, the same in each frame."""
        return sample_patterns.accumulation(self.samples)[None]

    def resolve(self, frame: Frame) -> Rgb:
        """Mean of the samples."""
        return mean_of_samples(frame.color, self.space)
