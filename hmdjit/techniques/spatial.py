"""Spatial techniques: no anti-aliasing, supersampling, multisampling."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .. import _checks, sample_patterns
from .._types import Rgb
from ..frames.frame import Frame
from .base import SPACES, AbstractSpatial, mean_of_samples
from .small_motion import AsRendered


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


class SSAA(_OwnSamples):
    """Supersampling: `factor` x `factor` samples per pixel, averaged (box filter).

    - `factor`: samples per axis; 4 is the reference that detail loss is measured
      against.
    - `space`: where the mean is taken, `"linear"` or `"gamma"`.
    """

    factor: int = eqx.field(static=True, default=4)
    space: str = eqx.field(static=True, default="linear")

    def __check_init__(self):
        _checks.whole("factor", self.factor, 1)
        _checks.one_of("space", self.space, SPACES)

    @property
    def id(self) -> str:
        """`ssaa4`, with the factor, and `_gamma` where that is the space."""
        return f"ssaa{self.factor}" + "_gamma" * (self.space == "gamma")

    @property
    def sample_offsets_px(self) -> Float[np.ndarray, "period samples 2"]:
        """Return an ordered grid."""
        return sample_patterns.ordered_grid(self.factor)[None]

    @property
    def reads_supersampled(self) -> bool:
        """SSAA(4) in linear light is what a texture carries ready made."""
        return self.factor == 4 and self.space == "linear"

    def resolve(self, frame: Frame) -> Rgb:
        """Mean of the samples."""
        return mean_of_samples(frame.color, self.space)


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
