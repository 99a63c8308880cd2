"""Errors of a picture against a reference: detail loss; MSE, RMSD, PSNR, SNR.

The functions take two pictures of one shape on one scale, whatever it is: both
floating, or whole numbers of one dtype, whose codes count as they are. They average
over pixels and channels, in float32 at least. PSNR and SNR of identical pictures are
infinite: average MSE over frames first. The gradients of RMSD, PSNR and SNR there are
chosen as exactly 0.
"""

import functools
import math
from collections.abc import Callable
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from .. import _checks, color
from .._types import Numbers, Plane, Rgb, Scalar
from .base import PixelMean, at_least_single

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


def _measured(measure: Callable[[Numbers, Numbers], Scalar]) -> Callable:
    """Compile a measure of two pictures, and check them before."""
    compiled = jax.jit(measure)

    @functools.wraps(measure)
    def checked(test: ArrayLike, reference: ArrayLike) -> Scalar:
        return compiled(*_floats(test, reference))

    return checked


def _floats(test: ArrayLike, reference: ArrayLike) -> list[Numbers]:
    """Both on their own scale, as floats that do not wrap around or overflow."""
    pair = jnp.asarray(test), jnp.asarray(reference)
    shape, other_shape = (picture.shape for picture in pair)
    if shape != other_shape:
        raise ValueError(
            f"test and reference must have one shape, got {shape} and {other_shape}."
        )
    dtype, other = (picture.dtype for picture in pair)
    are_floats = all(jnp.issubdtype(d, jnp.floating) for d in (dtype, other))
    if not (are_floats or (dtype == other and jnp.issubdtype(dtype, jnp.integer))):
        raise ValueError(
            "test and reference must both be floating, or whole numbers of one dtype: "
            f"else their scales differ. Got {dtype} and {other}."
        )
    return [at_least_single(p if are_floats else p.astype(float)) for p in pair]


@_measured
def mse(test: Numbers, reference: Numbers) -> Scalar:
    """Mean squared error; any one shape."""
    return jnp.mean((test - reference) ** 2)


@_measured
def rmsd(test: Numbers, reference: Numbers) -> Scalar:
    """Root of the mean squared error; any one shape."""
    error = mse(test, reference)
    is_zero = error == 0
    # sqrt has an infinite slope at 0: keep 0 out of it, then put the value back.
    return jnp.where(is_zero, 0.0, jnp.sqrt(jnp.where(is_zero, 1.0, error)))


def psnr(test: ArrayLike, reference: ArrayLike, *, peak: float | None = None) -> Scalar:
    """Peak signal-to-noise ratio `10 log10(peak^2 / MSE)`, dB; inf if equal.

    **Arguments:** `peak`: the largest possible value. None is the largest code of uint8
    and uint16; else 255, of pictures whose largest value lies in `(1, 255]`.

    **Errors:** `ValueError` where it does not and pictures differ: they may be colours
    in `[0, 1]`. Inside compiled code that is not checked.
    """
    error, dtype = mse(test, reference), jnp.asarray(test).dtype
    if peak is None:
        is_code = dtype in (jnp.uint8, jnp.uint16)
        peak = float(jnp.iinfo(dtype).max) if is_code else PEAK
        is_known = is_code or _checks.is_traced(error) or error == 0
        largest = 255 if is_known else float(max(np.max(test), np.max(reference)))
        if largest <= 1 or largest > peak:
            raise ValueError(
                f"peak must be named for values up to {largest:g}: "
                "1 of colours in [0, 1], 255 of code values of 8 bits."
            )
    _checks.in_range("peak", peak, 0, open_low=True)
    return _decibels(error, float(peak))


@functools.partial(jax.jit, static_argnames="peak")
def _decibels(error: Scalar, peak: float) -> Scalar:
    # Logarithms apart: the quotient of a small error is too large for float32.
    return 20 * math.log10(peak) - 10 * _log10(error)


@_measured
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
