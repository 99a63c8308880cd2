"""Colour errors as an eye sees them: behind a blur, in linear light."""

import math
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy import stats

from .. import _checks, color
from .._types import Plane, Planes, Rgb
from ..camera import Camera
from ..metrics import PixelMean, ciede2000, lab

ACUITY_ARCMIN = 1.0
"""Full width at half maximum of the blur: 20/20 vision, 60 px/deg.

A choice: it is the detail that such eyes just resolve; what their optics spread a point
to in daylight is about as wide.
"""

_REACH = 4.0  # standard deviations; beyond them lies 6e-5 of the light


def sigma_px(camera: Camera, width_arcmin: float = ACUITY_ARCMIN) -> float:
    """Return a blur's standard deviation, px in the centre, by its width."""
    px_per_arcmin = float(camera.focal_px) * math.pi / 180 / 60
    return width_arcmin * px_per_arcmin / (2 * math.sqrt(2 * math.log(2)))


def weights(sigma_px: float) -> Float[np.ndarray, " taps"]:
    """Weights of pixels in what is seen at a pixel's centre, of a Gaussian blur.

    Pixels are squares of light: each counts with the part of the Gaussian over it. Of
    no blur it is the pixel alone.
    """
    if sigma_px == 0:
        return np.ones(1)
    reach = max(math.ceil(_REACH * sigma_px - 0.5), 1)
    edges = np.arange(-reach, reach + 2) - 0.5
    found = np.diff(stats.norm.cdf(edges / sigma_px))
    return found / found.sum()


def blurred(linear: Planes, weights: Float[np.ndarray, " taps"]) -> Planes:
    """Blur planes along both axes; at their edge colours are repeated."""
    taps = weights.tolist()
    reach = len(taps) // 2
    for axis in (-1, -2):
        size, widths = linear.shape[axis], [(0, 0)] * linear.ndim
        widths[axis] = (reach, reach)
        wide = jnp.pad(linear, widths, mode="edge")
        linear = jnp.zeros_like(linear)
        for start, tap in enumerate(taps):
            part = jax.lax.slice_in_dim(wide, start, start + size, axis=axis)
            linear = linear + tap * part
    return linear


class SeenColorError(PixelMean):
    """Mean CIEDE2000 of displayed frames to the reference, both behind an eye's blur.

    - `sigma_px`: standard deviation of the blur, a Gaussian in linear light; px, at
      least 0. At the edge of a measured block colours are repeated.
    - `is_to_scene`: whether the reference is what the eye sees of the scene, blurred
      already. Else it is pixels like those displayed, squares of light.
    - `is_squared`: whether the mean is of squares, in which few large errors, those of
      edges, count more than many small ones.
    - `id`: of this blur.
    """

    sigma_px: float = eqx.field(static=True)
    id: str = eqx.field(static=True)  # pyright: ignore
    is_to_scene: bool = eqx.field(static=True, default=False)
    is_squared: bool = eqx.field(static=True, default=False)
    needs_reference: ClassVar[bool] = True
    is_local: ClassVar[bool] = False

    def __check_init__(self):
        _checks.in_range("sigma_px", self.sigma_px, 0)

    @property
    def unit(self) -> str:  # pyright: ignore
        """Unit of the mean."""
        return "CIEDE2000" + "^2" * self.is_squared

    def per_pixel(
        self, shown: Rgb, previous: Rgb | None, reference: Rgb | None
    ) -> Plane:
        """CIEDE2000 of each pixel, or its square."""
        assert reference is not None
        taps = weights(self.sigma_px)
        light = blurred(color.decode(shown), taps)
        against = color.decode(reference)
        if not self.is_to_scene:
            against = blurred(against, taps)
        labs = (
            lab(jnp.moveaxis(planes, 0, -1), space="linear")
            for planes in (light, against)
        )
        difference = ciede2000(*labs)
        return difference**2 if self.is_squared else difference
