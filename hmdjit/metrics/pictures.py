"""What measures of two pictures take: one shape, one scale, and how large it is."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from .. import _checks, color
from .._types import Numbers, Scalar
from .base import at_least_single


def pair(test: ArrayLike, reference: ArrayLike) -> list[Numbers]:
    """Both on their own scale, as floats that do not wrap around or overflow.

    **Errors:** `ValueError` for two shapes, and for two scales: they are both floating,
    or whole numbers of one dtype.
    """
    both = jnp.asarray(test), jnp.asarray(reference)
    shape, other_shape = (picture.shape for picture in both)
    if shape != other_shape:
        raise ValueError(
            f"test and reference must have one shape, got {shape} and {other_shape}."
        )
    dtype, other = (picture.dtype for picture in both)
    are_floats = all(jnp.issubdtype(d, jnp.floating) for d in (dtype, other))
    if not (are_floats or (dtype == other and jnp.issubdtype(dtype, jnp.integer))):
        raise ValueError(
            "test and reference must both be floating, or whole numbers of one dtype: "
            f"else their scales differ. Got {dtype} and {other}."
        )
    return [at_least_single(p if are_floats else p.astype(float)) for p in both]


def planes(test: ArrayLike, reference: ArrayLike, least_px: int = 1) -> list[Numbers]:
    """Both as planes, `(3, height, width)`, on their own scale.

    **Errors:** those of `pair`; `ValueError` for another shape than `(height, width,
    3)`, and for sides below `least_px`.
    """
    both = pair(test, reference)
    shape = both[0].shape
    if len(shape) != 3 or shape[-1] != 3 or min(shape[:2]) < least_px:
        raise ValueError(
            "test and reference must have the shape (height, width, 3), of at least "
            f"{least_px} px each way, got {shape}."
        )
    return [jnp.moveaxis(picture, -1, 0) for picture in both]


def peak_of(test: ArrayLike, reference: ArrayLike, peak: float | None) -> float:
    """Largest value of a scale, if it is not named: see `image_error.psnr`.

    **Errors:** `ValueError` where it cannot be told, and for one that is not positive.
    """
    dtype = jnp.asarray(test).dtype
    if peak is None:
        is_code = dtype in (jnp.uint8, jnp.uint16)
        peak = float(jnp.iinfo(dtype).max) if is_code else color.CODE_VALUES
        is_known = is_code or any(map(_checks.is_traced, (test, reference)))
        is_known = is_known or np.array_equal(test, reference)
        largest = 255 if is_known else _largest(test, reference)
        # Colours in [0, 1] may overshoot.
        if largest <= 2 or largest > peak:
            raise ValueError(
                f"peak must be named for values up to {largest:g}: "
                "1 of colours in [0, 1], 255 of code values of 8 bits."
            )
    _checks.in_range("peak", peak, 0, open_low=True)
    is_traced = any(map(_checks.is_traced, (test, reference, peak)))
    if not is_traced and (largest := _largest(test, reference)) > 2 * peak:
        raise ValueError(
            f"peak must be the scale's largest value, got {peak:g} for values up to "
            f"{largest:g}."
        )
    return float(peak)


def _largest(test: ArrayLike, reference: ArrayLike) -> float:
    return float(max(np.max(test), np.max(reference)))


def root(square: Numbers | Scalar) -> Numbers:
    """Square root; its gradient at 0, where the slope is infinite, is chosen as 0."""
    is_zero = square <= 0
    return jnp.where(is_zero, 0.0, jnp.sqrt(jnp.where(is_zero, 1.0, square)))
