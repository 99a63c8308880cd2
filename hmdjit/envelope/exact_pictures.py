"""Exact colours, blends, resampled pictures, curves and metrics in many digits.

Arguments are mpmath numbers and arrays of them, answers are flat lists.
"""

from fractions import Fraction
from typing import Any

from .exact_geometry import Numbers, angle, dot
from .row import mp

# --- colour and blending ---


def encode(linear: Any) -> list:
    """SRGB gamma of linear light."""
    if linear <= mp.mpf("0.0031308"):
        return [mp.mpf("12.92") * linear]
    return [mp.mpf("1.055") * linear ** (1 / mp.mpf("2.4")) - mp.mpf("0.055")]


def decode(gamma: Any) -> list:
    """Linear light of sRGB gamma."""
    if gamma <= mp.mpf("0.04045"):
        return [gamma / mp.mpf("12.92")]
    return [((gamma + mp.mpf("0.055")) / mp.mpf("1.055")) ** mp.mpf("2.4")]


def luma(rgb: Numbers) -> list:
    """Rec. 709 luma."""
    return [dot([mp.mpf(w) for w in ("0.2126", "0.7152", "0.0722")], rgb)]


def distance(one: Numbers, other: Numbers) -> list:
    """Euclidean distance."""
    return angle(one - other)


def past_color(samples: Numbers, weights: Numbers) -> list:
    """Equation (2), of weights that sum to 1: the last one is what the others leave."""
    rest = 1 - mp.fsum(weights[:-1])
    return [dot([*weights[:-1], rest], column) for column in samples.T]


# --- curves and sample patterns ---


def cosine(share: Any, exponent: Any) -> list:
    """Kim et al.'s equation (4) with its exponent free."""
    half = (1 - mp.cos(mp.pi * share)) / 2
    return [half**exponent if half else half]


def spline(share: Any, rises: Numbers) -> list:
    """Integral of the polygon of slopes up to a share, over all of it."""
    slopes = [2 * rises[0], *rises[1:-1], 2 * rises[-1]]
    spans = len(slopes) - 1

    def until(end: Any) -> Any:
        total = mp.mpf(0)
        for i in range(spans):
            # What is next to the ends has a derivative: there the curve goes on.
            part = end - i if i == spans - 1 else min(end - i, mp.mpf(1))
            if i == 0 or part > 0:
                total += part * slopes[i] + part**2 / 2 * (slopes[i + 1] - slopes[i])
        return total

    return [until(share * spans) / until(mp.mpf(spans))]


def radical_inverse(base: int, index: int) -> list:
    """Digits of an index, mirrored at the point."""
    mirrored, place = Fraction(0), Fraction(1, int(base))
    while index:
        index, digit = divmod(int(index), int(base))
        mirrored, place = mirrored + digit * place, place / int(base)
    return [mp.mpf(mirrored.numerator) / mirrored.denominator]


# --- resampling: positions from the centre of texel (2, 2) ---


def _texel(picture: Numbers, row: int, column: int) -> Any:
    height, width = picture.shape
    return picture[min(max(row, 0), height - 1), min(max(column, 0), width - 1)]


def _separable(kernel: Any, taps: range, picture: Numbers, dx: Any, dy: Any) -> list:
    i, j = (int(mp.floor(2 + d)) for d in (dx, dy))
    # A position so far out that it is clamped reads the same texel, whole.
    u, v = (2 + d - n if abs(n) < 10**6 else 0 for d, n in ((dx, i), (dy, j)))
    return [
        mp.fsum(
            kernel(u - m) * kernel(v - n) * _texel(picture, j + n, i + m)
            for m in taps
            for n in taps
        )
    ]


def bilinear(picture: Numbers, dx: Any, dy: Any) -> list:
    """Tents around the 2 x 2 texels."""
    return _separable(lambda t: 1 - abs(t), range(2), picture, dx, dy)


def catmull_rom(picture: Numbers, dx: Any, dy: Any) -> list:
    """Keys' kernel, a = -1/2, over the 4 x 4 texels."""

    def kernel(t: Any) -> Any:
        t = abs(t)
        if t < 1:
            return (3 * t**3 - 5 * t**2 + 2) / 2
        return (-(t**3) + 5 * t**2 - 8 * t + 4) / 2

    return _separable(kernel, range(-1, 3), picture, dx, dy)


def nearest(picture: Numbers, dx: Any, dy: Any) -> list:
    """Texel whose centre is nearest."""
    j, i = (int(mp.floor(2 + d + mp.mpf(1) / 2)) for d in (dy, dx))
    return [_texel(picture, j, i)]


# --- metrics ---


def mtcd(clip: Numbers) -> list:
    """Equation (6): mean distance of successive pixels, code values."""
    pixels = (clip[1:] - clip[:-1]).reshape(-1, 3)
    return [255 * mp.fsum(angle(pixel)[0] for pixel in pixels) / len(pixels)]


def mse(test: Numbers, reference: Numbers) -> list:
    """Mean squared error."""
    return [mp.fsum((test - reference).ravel(), squared=True) / test.size]


def rmsd(test: Numbers, reference: Numbers) -> list:
    """Root of it."""
    return [mp.sqrt(mse(test, reference)[0])]


def _decibels(power: Any, error: Any) -> list:
    if not error:
        return [mp.inf]
    return [10 * mp.log10(power / error) if power else -mp.inf]


def psnr(test: Numbers, reference: Numbers) -> list:
    """Peak signal-to-noise ratio, dB."""
    return _decibels(mp.mpf(255) ** 2, mse(test, reference)[0])


def snr(test: Numbers, reference: Numbers) -> list:
    """Signal-to-noise ratio, dB."""
    return _decibels(mse(0 * reference, reference)[0], mse(test, reference)[0])


# --- statistics of pictures ---


def difference(slope_squared: Numbers, finest_px: Any, displacement: Numbers) -> list:
    """RMS difference from the picture displaced: harmonics, between octaves."""
    (length,), direction = angle(displacement), mp.atan2(*displacement[::-1])
    if not length:
        return [mp.mpf(0)]
    octaves, directions = slope_squared.shape
    turns = [2 * n * direction for n in range(1, directions // 2 + 1)]
    waves = [mp.mpf(1), *(f(x) for x in turns for f in (mp.cos, mp.sin))][:directions]
    octave = min(max(mp.log(length / finest_px, 2), mp.mpf(0)), octaves - 1)
    below = min(int(octave), octaves - 2)
    near, far = (dot(slope_squared[below + i], waves) for i in (0, 1))
    return [length * mp.sqrt(near + (octave - below) * (far - near))]
