"""Errors of a picture against a reference: detail loss; MSE, RMSD, PSNR, SNR.

The functions take values on whatever scale they are given and average over pixels and
channels. PSNR and SNR of identical pictures are infinite: average MSE over frames
first. The gradients of RMSD, PSNR and SNR there are chosen as exactly 0.
"""

import math
from typing import ClassVar

import jax
import jax.numpy as jnp

from .. import color
from .._types import Numbers, Plane, Rgb, Scalar
from .base import PixelMean

PEAK = color.CODE_VALUES


class DetailLoss(PixelMean):
    """Mean squared error of displayed frames to the SSAA(4) reference of the same pose.

    Code values squared, over pixels, channels and frames.
    """

    id: ClassVar[str] = "detail_loss"
    unit: ClassVar[str] = "code values^2"
    needs_reference: ClassVar[bool] = True

    def per_pixel(
        self, shown: Rgb, previous: Rgb | None, reference: Rgb | None
    ) -> Plane:
        """Mean squared error over a pixel's channels."""
        assert reference is not None
        return PEAK**2 / 3 * color.squared_distance(shown, reference)


@jax.jit
def mse(test: Numbers, reference: Numbers) -> Scalar:
    """Mean squared error; any one shape."""
    return jnp.mean((test - reference) ** 2)


@jax.jit
def rmsd(test: Numbers, reference: Numbers) -> Scalar:
    """Root of the mean squared error; any one shape."""
    error = mse(test, reference)
    is_zero = error == 0
    # sqrt has an infinite slope at 0: keep 0 out of it, then put the value back.
    return jnp.where(is_zero, 0.0, jnp.sqrt(jnp.where(is_zero, 1.0, error)))


@jax.jit
def psnr(test: Numbers, reference: Numbers) -> Scalar:
    """Peak signal-to-noise ratio `10 log10(255^2 / MSE)`, dB; inf if equal."""
    # Logarithms apart: the quotient of a small error is too large for float32.
    return 20 * math.log10(PEAK) - 10 * _log10(mse(test, reference))


@jax.jit
def snr(test: Numbers, reference: Numbers) -> Scalar:
    """Signal-to-noise ratio `10 log10(mean(reference^2) / MSE)`, dB; inf if equal.

    -inf of any other picture than black to black.
    """
    error = mse(test, reference)
    ratio = 10 * (_log10(jnp.mean(reference**2)) - _log10(error))
    return jnp.where(error == 0, jnp.inf, ratio)


def _log10(power: Scalar) -> Scalar:
    """Logarithm; of 0 it is -inf, with a gradient of 0."""
    is_zero = power == 0
    return jnp.where(is_zero, -jnp.inf, jnp.log10(jnp.where(is_zero, 1.0, power)))
