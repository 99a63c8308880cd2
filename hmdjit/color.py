"""Colour: sRGB encoding and luma. Colours are floats in [0, 1].

*Gamma* is sRGB-encoded light, as a display buffer holds it; *linear* is light itself.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from . import _checks
from ._types import Numbers, Plane, Rgb

CODE_VALUES = 255.0
"""Largest code value of an 8-bit display."""

STEEPEST_ENCODE = 12.92
"""Largest slope of `encode`: that of its straight line at black."""


@jax.jit
def encode(linear: Numbers) -> Numbers:
    """Encode linear light as sRGB gamma; any shape; negative values stay linear.

    **Accuracy:** gradients are finite at 0, where the curve is a straight line.

    **Source:** IEC 61966-2-1:1999, equation 6.
    """
    _checks.floating("linear", linear)
    is_line = linear <= 0.0031308
    # x^(1/2.4) has an infinite slope at 0: keep 0 out of the branch that is not taken.
    safe = jnp.where(is_line, 1.0, linear)
    curve = 1.055 * _power(safe, 1 / 2.4) - 0.055
    return jnp.where(is_line, 12.92 * linear, curve)


@jax.jit
def decode(gamma: Numbers) -> Numbers:
    """Decode sRGB gamma to linear light; any shape; negative values stay linear.

    **Source:** IEC 61966-2-1:1999, equation 7.
    """
    _checks.floating("gamma", gamma)
    is_line = gamma <= 0.04045
    safe = jnp.where(is_line, 1.0, gamma)
    curve = _power((safe + 0.055) / 1.055, 2.4)
    return jnp.where(is_line, gamma / 12.92, curve)


def _power(base: Numbers, exponent: float) -> Numbers:
    # On CPUs XLA's own power of positive numbers takes two to three times as long.
    return jnp.exp(exponent * jnp.log(base))


@jax.jit
def luma(rgb: Float[Array, "rgb=3 *size"]) -> Float[Array, " *size"]:
    """Rec. 709 luma of gamma colours (luminance, of linear ones); `(3, ...)` -> `...`.

    **Source:** ITU-R BT.709-6, table 3.2: 0.2126 R + 0.7152 G + 0.0722 B.
    """
    return 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]


def to_ycocg(rgb: Rgb) -> Rgb:
    """Luma and two chromas of RGB: `Y = R/4 + G/2 + B/4`, Co and Cg about 0."""
    red, green, blue = rgb
    mean = (red + blue) / 4
    return jnp.stack([mean + green / 2, (red - blue) / 2, green / 2 - mean])


def from_ycocg(ycocg: Rgb) -> Rgb:
    """RGB of luma and chromas: the inverse of `to_ycocg`."""
    y, co, cg = ycocg
    return jnp.stack([y + co - cg, y + cg, y - co - cg])


def squared_distance(one: Rgb, other: Rgb) -> Plane:
    """Squared Euclidean distance of each pixel's colours, `(height, width)`."""
    _checks.floating("colours", one)
    # Written out: XLA would sum over an axis of three many times as slowly.
    red, green, blue = one - other
    return red**2 + green**2 + blue**2


def distance(one: Rgb, other: Rgb) -> Plane:
    """Euclidean distance of each pixel's colours, `(height, width)`.

    **Accuracy:** the gradient where two pixels are equal is chosen as exactly 0.
    """
    squared = squared_distance(one, other)
    is_zero = squared == 0
    # sqrt has an infinite slope at 0: keep 0 out of it, then put the value back.
    root = jnp.sqrt(jnp.where(is_zero, 1.0, squared))
    return jnp.where(is_zero, 0.0, root)
