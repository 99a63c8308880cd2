"""Errors of a picture against a reference: MSE, which is detail loss; RMSD, PSNR, SNR.

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
from jaxtyping import Array, ArrayLike, DTypeLike, Float

from .. import color
from .._types import Mask, Numbers, Plane, Rgb, Scalar
from ..camera import Region
from .base import AbstractMetric, PixelMean, State, compensated, log10
from .pictures import pair, peak_of, root

PEAK = color.CODE_VALUES


class _SquaredError(PixelMean):
    """Mean squared error of displayed frames to the SSAA(4) reference of the same pose.

    Code values squared, over pixels, channels and frames.
    """

    unit: ClassVar[str] = "code values^2"
    needs_reference: ClassVar[bool] = True

    def per_pixel(
        self, shown: Rgb, previous: Rgb | None, reference: Rgb | None
    ) -> Plane:
        """Mean squared error over a pixel's channels."""
        assert reference is not None
        return PEAK**2 / 3 * color.squared_distance(shown, reference)


class DetailLoss(_SquaredError):
    """Mean squared error of displayed frames to the SSAA(4) reference of the same pose.

    Code values squared, over pixels, channels and frames.
    """

    id: ClassVar[str] = "detail_loss"


class MSE(_SquaredError):
    """Detail loss, by the name that image metrics have."""

    id: ClassVar[str] = "mse"
    about: ClassVar[str] = "MSE to the reference, which is detail loss, code values²."


class RMSD(_SquaredError):
    """Root of a session's mean squared error to the reference, code values."""

    id: ClassVar[str] = "rmsd"
    unit: ClassVar[str] = "code values"
    about: ClassVar[str] = "RMSD, the mean of sessions' roots of MSE, code values."

    def value(self, state: State) -> Scalar:
        """Root of the mean over pixels and frames; NaN of no pixel."""
        return root(super().value(state))

    def mean(self, values: Float[Array, " blocks"]) -> Array:
        """Root of the blocks' mean square."""
        return root(jnp.mean(values**2))


class PSNR(_SquaredError):
    """Peak signal-to-noise ratio of displayed frames, of MSE's mean over all frames.

    Infinite where there is no error at all, as of the reference technique.
    """

    id: ClassVar[str] = "psnr"
    unit: ClassVar[str] = "dB"
    about: ClassVar[str] = (
        "PSNR in dB, of the mean of MSE; more is better, and inf, which has no "
        "interval, is no error at all."
    )
    less_is_better: ClassVar[bool] = False
    is_in_decibels: ClassVar[bool] = True

    def value(self, state: State) -> Scalar:
        """Decibels of the mean over pixels and frames; NaN of no pixel."""
        return _decibels(super().value(state), PEAK)


class SNR(AbstractMetric):
    """Signal-to-noise ratio of displayed frames: both are means over all frames.

    Infinite where there is no error at all, -inf of one where the reference is black.
    """

    id: ClassVar[str] = "snr"
    unit: ClassVar[str] = "dB"
    about: ClassVar[str] = (
        "SNR in dB, of the mean of MSE as a share of the reference's power; more is "
        "better, and inf, which has no interval, is no error at all."
    )
    less_is_better: ClassVar[bool] = False
    needs_reference: ClassVar[bool] = True
    is_in_decibels: ClassVar[bool] = True
    is_of_tiles: ClassVar[bool] = False

    def init(self, measured: Region, dtype: DTypeLike) -> State:
        """No squares so far, of the error and of the reference."""
        return jnp.zeros((2, 2), dtype)

    def step(
        self,
        state: State,
        shown: Rgb,
        previous: Rgb | None,
        reference: Rgb | None,
        is_measured: Mask | None = None,
    ) -> State:
        """Add the pixels of a frame, or of a block of it."""
        assert reference is not None
        others = shown, jnp.zeros_like(shown)
        squares = [color.squared_distance(reference, other) for other in others]
        if is_measured is not None:
            squares = [jnp.where(is_measured, plane, 0) for plane in squares]
        return compensated(state, jnp.stack([jnp.sum(plane) for plane in squares]))

    def value(self, state: State) -> Scalar:
        """Decibels over pixels and frames; infinite of no pixel."""
        (error, signal), _ = state
        return _signal_to_noise(signal, error)


def _measured(measure: Callable[[Numbers, Numbers], Scalar]) -> Callable:
    """Compile a measure of two pictures, and check them before."""
    compiled = jax.jit(measure)

    @functools.wraps(measure)
    def checked(test: ArrayLike, reference: ArrayLike) -> Scalar:
        return compiled(*pair(test, reference))

    return checked


@_measured
def mse(test: Numbers, reference: Numbers) -> Scalar:
    """Mean squared error; any one shape."""
    return jnp.mean((test - reference) ** 2)


@_measured
def rmsd(test: Numbers, reference: Numbers) -> Scalar:
    """Root of the mean squared error; any one shape."""
    return root(mse(test, reference))


def psnr(test: ArrayLike, reference: ArrayLike, *, peak: float | None = None) -> Scalar:
    """Peak signal-to-noise ratio `10 log10(peak^2 / MSE)`, dB; inf if equal.

    **Arguments:** `peak`: the largest possible value. None is the largest code of uint8
    and uint16; else 255, of pictures whose largest value lies in `(1, 255]`.

    **Errors:** `ValueError` where it does not and pictures differ: they may be colours
    in `[0, 1]`. Inside compiled code that is not checked.
    """
    return _decibels(mse(test, reference), peak_of(test, reference, peak))


@functools.partial(jax.jit, static_argnames="peak")
def _decibels(error: Scalar, peak: float) -> Scalar:
    # Logarithms apart: the quotient of a small error is too large for float32.
    return 20 * math.log10(peak) - 10 * log10(error)


@_measured
def snr(test: Numbers, reference: Numbers) -> Scalar:
    """Signal-to-noise ratio `10 log10(mean(reference^2) / MSE)`, dB; inf if equal.

    -inf of any other picture than black to black.
    """
    return _signal_to_noise(jnp.mean(reference**2), mse(test, reference))


def _signal_to_noise(signal: Scalar, error: Scalar) -> Scalar:
    ratio = 10 * (log10(signal) - log10(error))
    return jnp.where(error == 0, jnp.inf, ratio)
