"""SSIM, structural similarity: the usual one, and that of colours as a volume.

Both weigh a window of 11 x 11 pixels by a Gaussian of 1.5 px, with K1 = 0.01 and
K2 = 0.03; the value is the mean of a map, 1 of equal pictures, and may be negative.
`ssim` is of luma, over the windows that lie inside the picture. `ssim_volume` is what
MATLAB's function makes of a colour picture: a volume, whose third axis is the channels,
with the edge repeated all around. It is far the more lenient. The functions take two
pictures `(height, width, 3)` on one scale, as `psnr` does, of at least 11 px each way.

**Source:** Wang, Bovik, Sheikh and Simoncelli, "Image Quality Assessment: From Error
Visibility to Structural Similarity", IEEE Transactions on Image Processing 13(4), 2004,
equation 13. `ssim_volume`: Oliveros' MATLAB scripts.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, DTypeLike, Float

from .._types import Numbers, Rgb, Scalar
from ..camera import Region
from ..color import CODE_VALUES
from . import pictures
from .base import PixelMean, State

_RADIUS_PX, _SIGMA_PX = 5, 1.5
WINDOW_PX = 2 * _RADIUS_PX + 1
_OFFSETS = np.arange(-_RADIUS_PX, _RADIUS_PX + 1)
_BELL = np.exp(-(_OFFSETS**2) / (2 * _SIGMA_PX**2))
_WEIGHTS = _BELL / _BELL.sum()
Windows = Float[Array, "rows columns"]
_LUMA = (0.299, 0.587, 0.114)  # ITU-R BT.601


def ssim(test: ArrayLike, reference: ArrayLike, *, peak: float | None = None) -> Scalar:
    """SSIM of luma (0.299, 0.587, 0.114), over all windows inside the picture.

    **Arguments:** `peak`: the largest possible value, as of `psnr`.

    **Errors:** `ValueError` for other shapes, below 11 px, for two scales, and where
    `peak` cannot be told.

    **Accuracy:** 1e-5 in float32.
    """
    return _mean(_luma_map, test, reference, peak)


def ssim_map(
    test: ArrayLike, reference: ArrayLike, *, peak: float | None = None
) -> Windows:
    """Map of `ssim`, `(height - 10, width - 10)`: of windows by their centres."""
    return _map(_luma_map, test, reference, peak)


def ssim_volume(
    test: ArrayLike, reference: ArrayLike, *, peak: float | None = None
) -> Scalar:
    """SSIM of a colour picture as a volume, borders and all; as `ssim` else."""
    return _mean(_volume_map, test, reference, peak)


def ssim_volume_map(
    test: ArrayLike, reference: ArrayLike, *, peak: float | None = None
) -> Float[Array, "height width 3"]:
    """Map of `ssim_volume`, `(height, width, 3)`."""
    return jnp.moveaxis(_map(_volume_map, test, reference, peak), 0, -1)


class _Similarity(PixelMean):
    """Mean over frames of a map of the measured block, which comes in one piece."""

    unit: ClassVar[str] = "1"
    less_is_better: ClassVar[bool] = False
    needs_reference: ClassVar[bool] = True
    is_local: ClassVar[bool] = False

    @abstractmethod
    def map(self, shown: Rgb, reference: Rgb) -> Numbers:
        """Return the map of code values."""

    def init(self, measured: Region, dtype: DTypeLike) -> State:
        """Sum and count of no window so far."""
        if min(measured.width, measured.height) < WINDOW_PX:
            raise ValueError(
                f"{self.id} must have blocks of at least {WINDOW_PX} px each way, got "
                f"{measured.width} x {measured.height}."
            )
        return super().init(measured, dtype)

    def per_pixel(
        self, shown: Rgb, previous: Rgb | None, reference: Rgb | None
    ) -> Numbers:
        """Return the map."""
        assert reference is not None
        return self.map(CODE_VALUES * shown, CODE_VALUES * reference)


class SSIM(_Similarity):
    """`ssim` of displayed frames to the SSAA(4) reference of the same pose.

    Over the windows that lie inside the measured block, and frames.
    """

    id: ClassVar[str] = "ssim"
    about: ClassVar[str] = (
        "SSIM of luma to the reference: 1 is equal, and more is better."
    )

    def map(self, shown: Rgb, reference: Rgb) -> Windows:
        """Return the map of luma."""
        return _luma_map(shown, reference, CODE_VALUES)


class SSIMVolume(_Similarity):
    """`ssim_volume` of displayed frames to the SSAA(4) reference of the same pose.

    Over pixels, channels and frames; around the measured block its edge is repeated.
    """

    id: ClassVar[str] = "ssim_volume"
    about: ClassVar[str] = (
        "SSIM of colours as a volume, as MATLAB has it, to the reference: 1 is equal, "
        "and more is better; more lenient than SSIM."
    )

    def map(self, shown: Rgb, reference: Rgb) -> Rgb:
        """Return the map of the volume."""
        return _volume_map(shown, reference, CODE_VALUES)


Map = Callable[..., Numbers]


def _map(of: Map, test: ArrayLike, reference: ArrayLike, peak: float | None) -> Numbers:
    planes = pictures.planes(test, reference, WINDOW_PX)
    return of(*planes, pictures.peak_of(test, reference, peak))


def _mean(of: Map, test: ArrayLike, reference: ArrayLike, peak: float | None) -> Scalar:
    return _compiled_mean(_map(of, test, reference, peak))


_compiled_mean = jax.jit(jnp.mean)


@jax.jit
def _luma_map(test: Rgb, reference: Rgb, peak: Scalar) -> Windows:
    r, g, b = _LUMA
    luma = lambda planes: r * planes[0] + g * planes[1] + b * planes[2]
    return _similarity(luma(test), luma(reference), peak, _smooth)


@jax.jit
def _volume_map(test: Rgb, reference: Rgb, peak: Scalar) -> Rgb:
    # What a window reaches of the channels, the first and the last repeated.
    reach = np.clip(np.arange(3)[:, None] + _OFFSETS, 0, 2)
    mixing = [np.bincount(row, _WEIGHTS, 3).tolist() for row in reach]
    rim = (_RADIUS_PX, _RADIUS_PX)

    def smooth(volumes: Float[Array, "moments 3 height width"]) -> Numbers:
        red, green, blue = jnp.moveaxis(volumes, 1, 0)
        mixed = [r * red + g * green + b * blue for r, g, b in mixing]
        margin = [(0, 0), (0, 0), rim, rim]
        return _smooth(jnp.pad(jnp.stack(mixed, axis=1), margin, mode="edge"))

    return _similarity(test, reference, peak, smooth)


def _similarity(
    test: Numbers,
    reference: Numbers,
    peak: Scalar,
    smooth: Callable[[Numbers], Numbers],
) -> Numbers:
    """Equation 13, with moments under a window's weights."""
    c1, c2 = (0.01 * peak) ** 2, (0.03 * peak) ** 2
    # Moments about the middle of the scale, so that variances keep their digits.
    x, y = test - peak / 2, reference - peak / 2
    mean_x, mean_y, both, product = smooth(jnp.stack([x, y, x**2 + y**2, x * y]))
    variances = both - mean_x**2 - mean_y**2
    covariance = product - mean_x * mean_y
    mean_x, mean_y = mean_x + peak / 2, mean_y + peak / 2
    luminance = (2 * mean_x * mean_y + c1) / (mean_x**2 + mean_y**2 + c1)
    return luminance * (2 * covariance + c2) / (variances + c2)


def _smooth(planes: Float[Array, "... height width"]) -> Numbers:
    """Gaussian means over the windows inside the planes, 10 px smaller each way."""
    # Left to itself the compiler would fuse both passes, and filter 11 times as often.
    whole = jax.lax.optimization_barrier(planes)
    tall = jax.lax.optimization_barrier(_along(whole, planes.ndim - 2))
    return jax.lax.optimization_barrier(_along(tall, planes.ndim - 1))


def _along(planes: Numbers, axis: int) -> Numbers:
    length = planes.shape[axis] - 2 * _RADIUS_PX
    at = lambda k: jax.lax.slice_in_dim(planes, k, k + length, axis=axis)
    total = float(_WEIGHTS[_RADIUS_PX]) * at(_RADIUS_PX)
    for k, weight in enumerate(_WEIGHTS[:_RADIUS_PX].tolist()):
        total += weight * (at(k) + at(2 * _RADIUS_PX - k))
    return total
