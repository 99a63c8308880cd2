"""CIEDE2000: how different two colours look, from their Lab values.

Lab is of CIE 1976, in the white that the display shows: that of sRGB, by the matrix of
its standard. The parametric factors kL, kC and kH are 1. About 1 is just noticed.
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from .. import _checks, color
from .._types import Numbers, Plane, Rgb, Scalar
from . import pictures
from .base import PixelMean, at_least_single
from .pictures import root

# IEC 61966-2-1:1999, equation 5: XYZ of linear light.
_XYZ_FROM_LINEAR = np.array(
    [
        [0.4124, 0.3576, 0.1805],
        [0.2126, 0.7152, 0.0722],
        [0.0193, 0.1192, 0.9505],
    ]
)
_SHARE_OF_WHITE = _XYZ_FROM_LINEAR / _XYZ_FROM_LINEAR.sum(axis=1, keepdims=True)


def lab(colors: ArrayLike, *, space: str = "gamma") -> Float[Array, "*size 3"]:
    """CIE 1976 L*a*b* of sRGB colours.

    **Arguments:**

    - `colors`: `(..., 3)`; floating in `[0, 1]`, or uint8 or uint16, whose largest code
      is 1.
    - `space`: whether they are gamma or linear light.

    **Returns:** L* in `[0, 100]`, a* and b*, `(..., 3)`; at least float32.

    **Errors:** `ValueError` for any other shape, dtype, range or space. Inside compiled
    code the range is not checked.

    **Accuracy:** in float32 to 1e-4.

    **Source:** IEC 61966-2-1:1999, equations 5 and 7; CIE 15:2004, section 8.2.1.
    """
    _checks.one_of("space", space, ("gamma", "linear"))
    values = at_least_single(_checks.colors("colors", colors))
    planes = _planes("colors", values)
    return jnp.moveaxis(_lab(planes, space), 0, -1)


def ciede2000(
    test_lab: ArrayLike, reference_lab: ArrayLike
) -> Float[Array, "*size"] | Float[Array, ""]:
    """CIEDE2000 of colours given by their L*a*b*; symmetric.

    **Arguments:** both floating, of one shape `(..., 3)`, with L* in `[0, 100]`.

    **Returns:** difference of each pair of colours, `(...)`, at least float32; about 1
    is just noticed, and 0 is equal. Their mean is that of a picture.

    **Errors:** `ValueError` for other shapes, dtypes, or lightness. Inside compiled
    code lightness is not checked.

    **Accuracy:** 3e-5 in float32, of large ones 1e-6. The formula itself jumps where
    hues are opposite. At equal colours and at grey its slope is not unique: gradients
    are chosen as 0 there, of a grey one by a* and b*.

    **Source:** Sharma, Wu and Dalal, "The CIEDE2000 Color-Difference Formula:
    Implementation Notes, Supplementary Test Data, and Mathematical Observations", Color
    Research and Application 30(1), 2005, equations 2 to 22.
    """
    test, reference = jnp.asarray(test_lab), jnp.asarray(reference_lab)
    if test.shape != reference.shape:
        raise ValueError(
            f"test_lab and reference_lab must have one shape, got {test.shape} and "
            f"{reference.shape}."
        )
    return _ciede2000(
        _lab_planes("test_lab", test), _lab_planes("reference_lab", reference)
    )


def ciede2000_map(
    test: ArrayLike, reference: ArrayLike, *, peak: float | None = None
) -> Plane:
    """CIEDE2000 of each pixel of two gamma pictures, `(height, width)`.

    **Arguments:** both `(height, width, 3)`, on one scale; `peak`: its largest possible
    value, as of `psnr`.

    **Errors:** `ValueError` for other shapes, for two scales, and where `peak` cannot
    be told.
    """
    planes = pictures.planes(test, reference)
    return _map(*planes, pictures.peak_of(test, reference, peak))


def mean_ciede2000(
    test: ArrayLike, reference: ArrayLike, *, peak: float | None = None
) -> Scalar:
    """Mean of `ciede2000_map` over pixels."""
    return jnp.mean(ciede2000_map(test, reference, peak=peak))


class CIEDE2000(PixelMean):
    """Mean CIEDE2000 of displayed frames to the SSAA(4) reference of the same pose."""

    id: ClassVar[str] = "ciede2000"
    unit: ClassVar[str] = "delta E"
    about: ClassVar[str] = (
        "CIEDE2000: how different colours look from the reference's, about 1 is just "
        "noticed."
    )
    needs_reference: ClassVar[bool] = True

    def per_pixel(
        self, shown: Rgb, previous: Rgb | None, reference: Rgb | None
    ) -> Plane:
        """Difference of a pixel's colours."""
        assert reference is not None
        return _map(shown, reference, 1.0)


@jax.jit
def _map(test: Rgb, reference: Rgb, peak: Scalar) -> Plane:
    # Compiled, two equal pictures may have Labs that differ in the last digit.
    is_equal = jnp.all(test == reference, axis=0)
    reference = jnp.where(is_equal[None], jax.lax.stop_gradient(reference), reference)
    labs = (_lab(p / peak, "gamma") for p in (test, reference))
    return jnp.where(is_equal, 0, _ciede2000(*labs))


def _lab_planes(name: str, values: Array) -> Float[Array, "channels=3 *size"]:
    _checks.floating(name, values)
    planes = _planes(name, at_least_single(values))
    if not _checks.is_traced(planes) and planes.size:
        # White of pictures may be above 100 by what they may be above 1.
        low, high = float(jnp.nanmin(planes[0])), float(jnp.nanmax(planes[0]))
        if low < -0.5 or high > 100.5:
            raise ValueError(
                f"{name} must have L* in [0, 100], got {low:g} to {high:g}."
            )
    return planes


def _planes(name: str, values: Array) -> Float[Array, "channels=3 *size"]:
    if values.ndim < 1 or values.shape[-1] != 3:
        raise ValueError(f"{name} must have the shape (..., 3), got {values.shape}.")
    return jnp.moveaxis(values, -1, 0)


def _lab(
    planes: Float[Array, "channels=3 *size"], space: str
) -> Float[Array, "channels=3 *size"]:
    linear = planes if space == "linear" else color.decode(planes)
    return _lab_of_linear(linear)


@jax.jit
def _lab_of_linear(
    linear: Float[Array, "channels=3 *size"],
) -> Float[Array, "channels=3 *size"]:
    red, green, blue = linear
    shares = [r * red + g * green + b * blue for r, g, b in _SHARE_OF_WHITE.tolist()]
    x, y, z = (_response(share) for share in shares)
    return jnp.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def _response(share: Numbers) -> Numbers:
    """Cube root, which near black is a straight line."""
    joint = 6 / 29
    is_line = share <= joint**3
    # The root has an infinite slope at 0: keep 0 out of it.
    root = jnp.exp(jnp.log(jnp.where(is_line, 1.0, share)) / 3)
    return jnp.where(is_line, share / (3 * joint**2) + 4 / 29, root)


@jax.jit
def _ciede2000(
    test: Float[Array, "channels=3 *size"], reference: Float[Array, "channels=3 *size"]
) -> Numbers:
    (l1, a1, b1), (l2, a2, b2) = reference, test
    dl, da, db = l2 - l1, a2 - a1, b2 - b1

    mean_chroma = (root(a1**2 + b1**2) + root(a2**2 + b2**2)) / 2
    stretch = 1.5 - 0.5 * _saturation(mean_chroma)
    a1, a2, da = stretch * a1, stretch * a2, stretch * da
    c1, c2 = root(a1**2 + b1**2), root(a2**2 + b2**2)
    mean_l, mean_c = (l1 + l2) / 2, (c1 + c2) / 2
    # Differences of squares by sums of differences: near colours keep their digits.
    is_grey = c1 * c2 == 0
    dc = _over(da * (a1 + a2) + db * (b1 + b2), c1 + c2)

    h1, h2 = _hue(a1, b1, c1), _hue(a2, b2, c2)
    # Rounding must not decide about hues that are opposite.
    is_wrapped = jnp.abs(h2 - h1) > jnp.pi * (1 + 8 * jnp.finfo(h1.dtype).eps)
    half_turn = jnp.where(h1 + h2 < 2 * jnp.pi, jnp.pi, -jnp.pi)
    mean_h = (h1 + h2) / 2 + jnp.where(is_wrapped, half_turn, 0.0)
    mean_h = jnp.where(is_grey, h1 + h2, mean_h)

    # 2 sqrt(c1 c2) sin(dh / 2), by the products of the two: atan2 has lost digits.
    dot, cross = a1 * a2 + b1 * b2, a1 * db - b1 * da
    is_near = dot >= 0
    near = _over(cross, root((c1 * c2 + dot) / 2))
    far = root(jnp.where(is_near, 0.0, 2 * (c1 * c2 - dot)))
    dh = jnp.where(is_near, near, jnp.where((h2 > h1) ^ is_wrapped, far, -far))
    dh = jnp.where(is_grey, 0.0, dh)

    cosine = lambda times, shift_deg: jnp.cos(times * mean_h + jnp.deg2rad(shift_deg))
    t = (
        1
        - 0.17 * cosine(1, -30.0)
        + 0.24 * cosine(2, 0.0)
        + 0.32 * cosine(3, 6.0)
        - 0.20 * cosine(4, -63.0)
    )
    from_50 = (mean_l - 50) ** 2
    scale_l = 1 + 0.015 * from_50 / jnp.sqrt(20 + from_50)
    scale_c = 1 + 0.045 * mean_c
    scale_h = 1 + 0.015 * mean_c * t
    turn = 30 * jnp.exp(-(((jnp.rad2deg(mean_h) - 275) / 25) ** 2))
    rotation = -2 * _saturation(mean_c) * jnp.sin(jnp.deg2rad(2 * turn))
    dl, dc, dh = dl / scale_l, dc / scale_c, dh / scale_h
    return root(dl**2 + dc**2 + dh**2 + rotation * dc * dh)


def _over(value: Numbers, divisor: Numbers) -> Numbers:
    """Quotient; of anything by 0 it is 0, with a gradient of 0."""
    is_zero = divisor == 0
    return jnp.where(is_zero, 0.0, value / jnp.where(is_zero, 1.0, divisor))


def _hue(a: Numbers, b: Numbers, chroma: Numbers) -> Numbers:
    """Hue in [0, 2 pi] rad; 0 of grey."""
    is_grey = chroma == 0
    angle = jnp.arctan2(jnp.where(is_grey, 0.0, b), jnp.where(is_grey, 1.0, a))
    return jnp.where(angle < 0, angle + 2 * jnp.pi, angle)


def _saturation(chroma: Numbers) -> Numbers:
    """Root of C^7 / (C^7 + 25^7)."""
    power = (chroma / 25) ** 7
    return root(power / (1 + power))
