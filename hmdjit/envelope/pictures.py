"""The envelope's rows of colours, blends, curves, resampling and metrics.

Oracles are of mpmath numbers and arrays of them, answers are flat lists.
"""

from collections.abc import Callable
from fractions import Fraction
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from .. import blending, color, curves, metrics, sample_patterns
from ..frames import resampling
from ..theory.picture_statistics import PictureStatistics
from . import arguments as of
from .exact_geometry import Numbers, angle, dot
from .row import Bound, Row, eps, mp, one, own_size, path

mpf = mp.mpf
_scaled = partial(Row, slope_unit=own_size)
_numpy = partial(Row, eager=True, quick=0)
_HDR, _SHOWN, _PAIR = [of.two_colours()], [of.two_colours(1.0)], [of.TWO_PICTURES]

# --- colour and blending ---


def _pixel(function: Callable, *given: Any, kind: str = "", **options: Any) -> Row:
    """Row of one pixel's colours, by what a function says of planes."""
    chosen = partial(function, kind=kind) if kind else function
    of_pixel = lambda *colours: chosen(*(c[..., None, None] for c in colours))
    name = path(function) + f" ({kind})" * bool(kind)
    return Row(of_pixel, *given, name=name, **options)


def _encode(linear: Any) -> list:
    if linear <= mpf("0.0031308"):
        return [mpf("12.92") * linear]
    return [mpf("1.055") * linear ** (1 / mpf("2.4")) - mpf("0.055")]


def _decode(gamma: Any) -> list:
    if gamma <= mpf("0.04045"):
        return [gamma / mpf("12.92")]
    return [((gamma + mpf("0.055")) / mpf("1.055")) ** mpf("2.4")]


def _past_color(samples: Numbers, weights: Numbers) -> list:
    """Equation (2), of weights that sum to 1: the last one is what the others leave."""
    rest = 1 - mp.fsum(weights[:-1])
    return [dot([*weights[:-1], rest], column) for column in samples.T]


_at_joint = lambda x: any(abs(x / joint - 1) < 1e-6 for joint in (0.0031308, 0.04045))
_equal = lambda one, other: np.max(np.abs(one - other)) < 1e-17
_past = lambda x, weights: blending.past_color(list(x[..., None, None]), list(weights))
_ease = lambda speed, h_max: _cosine(min(speed, h_max) / h_max, 2)
_luma = lambda rgb: [dot([mpf(w) for w in ("0.2126", "0.7152", "0.0722")], rgb)]
_distance = lambda one, other: angle(one - other)
_squared = lambda one, other: [_distance(one, other)[0] ** 2]
_euclidean = lambda *two: [min(_distance(*two)[0] / mp.sqrt(3), mpf(1))]
_largest = lambda one, other: [min(max(abs(one - other)), mpf(1))]
_minimum = lambda w_min, w_lb, difference: [w_min - (w_min - w_lb) * difference]
_weight = lambda minimum, easing: [minimum + (1 - minimum) * easing]
_blend = lambda now, past, weight: list(weight * now + (1 - weight) * past)
_black = lambda now, past, weight: not (now.any() or past.any())
# What is smaller squares to 0 in float32.
_dark = partial(_pixel, floor=1e-17, kink=_equal)
_difference = partial(_dark, blending.color_difference)
_mixed = partial(Row, floor=1.0)
_BLENDED = [*_HDR, of.WEIGHT]

COLOURS = [
    # A power by logarithms loses as many eps as the exponent is large.
    Row(color.encode, _encode, [of.COLOUR], eps(24, 24), kink=_at_joint),
    Row(color.decode, _decode, [of.COLOUR], eps(64, 64), kink=_at_joint),
    Row(color.luma, _luma, [of.ONE_COLOUR], eps(4, 2)),
    _pixel(color.squared_distance, _squared, _HDR, eps(8, 4), floor=1e-34),
    _dark(color.distance, _distance, _HDR, eps(6, 8)),
    _difference(_euclidean, _SHOWN, eps(8, 8), kind="euclidean"),
    _difference(_largest, _SHOWN, eps(8, 8), kind="max_channel"),
    _scaled(blending.ease, _ease, [of.SPEED], eps(16, 32), floor=1e-30, count=66),
    _mixed(blending.localized_minimum, _minimum, [of.WEIGHT] * 3, eps(4, 2)),
    _mixed(blending.current_weight, _weight, [of.WEIGHT] * 2, eps(2, 2)),
    Row(_past, _past_color, [of.PAST], eps(16, 16), name="blending.past_color"),
    _pixel(
        blending.blend, _blend, _BLENDED, eps(4, 4), slope_unit=own_size, kink=_black
    ),
]

# --- curves and sample patterns ---


def _cosine(share: Any, exponent: Any) -> list:
    """Kim et al.'s equation (4) with its exponent free."""
    half = (1 - mp.cos(mp.pi * share)) / 2
    return [half**exponent if half else half]


def _spline(share: Any, rises: Numbers) -> list:
    """Integral of the polygon of slopes up to a share, over all of it."""
    slopes = [2 * rises[0], *rises[1:-1], 2 * rises[-1]]
    spans = len(slopes) - 1

    def until(end: Any) -> Any:
        total = mpf(0)
        for i in range(spans):
            # What is next to the ends has a derivative: there the curve goes on.
            part = end - i if i == spans - 1 else min(end - i, mpf(1))
            if i == 0 or part > 0:
                total += part * slopes[i] + part**2 / 2 * (slopes[i + 1] - slopes[i])
        return total

    return [until(share * spans) / until(mpf(spans))]


def _radical_inverse(base: int, index: int) -> list:
    """Digits of an index, mirrored at the point."""
    mirrored, place = Fraction(0), Fraction(1, int(base))
    while index:
        index, digit = divmod(int(index), int(base))
        mirrored, place = mirrored + digit * place, place / int(base)
    return [mpf(mirrored.numerator) / mirrored.denominator]


def _curve(name: str, *given: Any, **options: Any) -> Row:
    # Curves rise from 0; what is smaller counts as this large.
    return _scaled(*given, name=f"curves.{name}", floor=1e-30, **options)


_cosine_curve = lambda share, exponent: curves.Cosine(exponent)(share)
_spline_curve = lambda share, rises: curves.Spline(tuple(rises))(share)
_up_both_ways = lambda share, exponent: share == 0 and exponent == 0.5
_POWER, _RISES = [of.SHARE, of.EXPONENT], [of.SHARE, of.RISES]
_INVERSE = sample_patterns.radical_inverse, _radical_inverse, [of.BASE, of.INDEX]

CURVES = [
    _curve("Kim", curves.Kim(), lambda d: _cosine(d, 2), [of.SHARE], eps(8, 16)),
    # A power takes its base's rounding times its exponent.
    _curve("Cosine", _cosine_curve, _cosine, _POWER, eps(128, 256), kink=_up_both_ways),
    _curve("Spline", _spline_curve, _spline, _RISES, eps(16, 64)),
    _numpy(*_INVERSE, {"float64": Bound(4 * 2.0**-52)}, "absolute"),
]

# --- resampling: positions from the centre of texel (2, 2) ---


def _separable(kernel: Callable, taps: range) -> Callable[..., list]:
    def read(picture: Numbers, dx: Any, dy: Any) -> list:
        i, j = (int(mp.floor(2 + d)) for d in (dx, dy))
        # A position so far out that it is clamped reads the same texel, whole.
        u, v = (2 + d - n if abs(n) < 10**6 else 0 for d, n in ((dx, i), (dy, j)))
        rows, columns = (
            [min(max(n + tap, 0), end - 1) for tap in taps]
            for n, end in zip((j, i), picture.shape, strict=True)
        )
        across, down = ([kernel(x - tap) for tap in taps] for x in (u, v))
        return [dot(down, picture[np.ix_(rows, columns)].dot(across))]

    return read


def _keys(t: Any) -> Any:
    """Keys' kernel, a = -1/2."""
    t = abs(t)
    if t < 1:
        return (3 * t**3 - 5 * t**2 + 2) / 2
    return (-(t**3) + 5 * t**2 - 8 * t + 4) / 2


def _reader(
    name: str, read: Callable, *given: Any, stored: Any = None, **options: Any
) -> Row:
    two = jnp.full((1, 1), 2, jnp.int32)

    def at(picture: Any, dx: Any, dy: Any) -> Any:
        kept = resampling.texels(picture[..., None])
        kept = kept if stored is None else kept.astype(stored)
        return read(kept, two, two, dx[None, None], dy[None, None])

    # The position's fraction has eps of 1, of however dark a pixel.
    options = {"floor": 1.0, "slope_unit": one, **options}
    if stored:
        name, options["wrt"] = f"{name}, {stored.__name__} texels", (1, 2)
    arguments, (oracle, bounds) = [of.picture(stored), of.OFFSET, of.OFFSET], given
    named = f"frames.resampling.{name}"
    return Row(at, oracle, arguments, bounds, name=named, **options)


def _by_slices(texels: Any, column: Any, row: Any, dx: Any, dy: Any) -> Any:
    span = jnp.stack([jnp.stack([dx[0, 0], dy[0, 0]])] * 2)
    place = jnp.int32(2), jnp.int32(2)
    return resampling.bilinear_by_slices(texels, *place, (1, 1), span, lambda: (dx, dy))


_on_a_texel = lambda picture, *place: any(abs(d - np.rint(d)) < 1e-20 for d in place)
_linear = partial(_reader, kink=_on_a_texel)
_nearest = _separable(lambda t: mpf(-0.5 <= t < 0.5), range(2))
_bilinear = _separable(lambda t: 1 - abs(t), range(2))
_catmull_rom = _separable(_keys, range(-1, 3))
_gathers, _HALF = resampling.bilinear, {"float32": Bound(4, 8)}
_NEAREST: Any = {"wrt": (0,), "slope_unit": own_size}
_CUBIC: Any = {"wrt": (1, 2), "quick": 0}

READERS = [
    _reader("nearest", resampling.nearest, _nearest, eps(0, 0), **_NEAREST),
    _reader("catmull_rom", resampling.catmull_rom, _catmull_rom, eps(8, 16), **_CUBIC),
    _linear("bilinear", _gathers, _bilinear, eps(4, 8)),
    _linear("bilinear_by_slices", _by_slices, _bilinear, eps(4, 8), quick=0),
    _linear("bilinear", _gathers, _bilinear, _HALF, stored=jnp.bfloat16),
    _linear("bilinear", _gathers, _bilinear, _HALF, stored=jnp.float16),
]

# --- metrics and statistics of pictures ---


def _mtcd(clip: Numbers) -> list:
    """Equation (6): mean distance of successive pixels, code values."""
    pixels = (clip[1:] - clip[:-1]).reshape(-1, 3)
    return [255 * mp.fsum(angle(pixel)[0] for pixel in pixels) / len(pixels)]


def _decibels(power: Any, error: Any) -> list:
    if not error:
        return [mp.inf]
    return [10 * mp.log10(power / error) if power else -mp.inf]


def _displaced(slope_squared: Numbers, finest_px: Any, displacement: Numbers) -> list:
    """RMS difference from the picture displaced: harmonics, between octaves."""
    (length,), direction = angle(displacement), mp.atan2(*displacement[::-1])
    if not length:
        return [mpf(0)]
    octaves, directions = slope_squared.shape
    turns = [2 * n * direction for n in range(1, directions // 2 + 1)]
    waves = [mpf(1), *(f(x) for x in turns for f in (mp.cos, mp.sin))][:directions]
    octave = min(max(mp.log(length / finest_px, 2), mpf(0)), octaves - 1)
    below = min(int(octave), octaves - 2)
    near, far = (dot(slope_squared[below + i], waves) for i in (0, 1))
    return [length * mp.sqrt(near + (octave - below) * (far - near))]


def _streamed(clip: np.ndarray) -> list:
    streamed = metrics.Streamed(metrics.MTCD())
    for frame in clip:
        streamed.add(frame)
    return [streamed.value]


def _moved(slope_squared: Any, finest_px: Any, displacement: Any) -> Any:
    statistics = PictureStatistics(slope_squared[None], finest_px, 64, False)
    return statistics.difference(displacement[None])[0]


# dB: a logarithm of up to 32 and its factor of 10 are rounded, and their sum.
_DECIBELS = {"float32": Bound(1e-4, 8), "float64": Bound(2e-13, 8)}
_EACH_FRAME = {"float64": Bound(10_000 * 2.0**-53)}
_STREAMED = "metrics.base.Streamed"
_MOVED = "theory.picture_statistics.PictureStatistics.difference"
_mse = lambda test, real: [mp.fsum((test - real).ravel(), squared=True) / test.size]
_psnr = lambda *two: _decibels(mpf(255) ** 2, _mse(*two)[0])
_snr = lambda test, real: _decibels(_mse(0 * real, real)[0], _mse(test, real)[0])
_no_ratio = lambda test, real: np.array_equal(test, real) or not real.any()
_at_rest = lambda slopes, finest_px, displacement: not displacement.any()
_error = partial(Row, kink=np.array_equal, count=72)

METRICS = [
    Row(metrics.mtcd, _mtcd, [of.CLIP], eps(8, 16)),
    Row(metrics.mse, _mse, _PAIR, eps(8, 16), count=72),
    _error(metrics.rmsd, lambda *x: [mp.sqrt(_mse(*x)[0])], _PAIR, eps(8, 16)),
    _error(metrics.psnr, _psnr, _PAIR, _DECIBELS, "dB"),
    _error(metrics.snr, _snr, _PAIR, _DECIBELS, "dB", kink=_no_ratio),
    _numpy(
        _streamed, _mtcd, [of.LONG_CLIP], _EACH_FRAME, "relative", _STREAMED, count=6
    ),
    _scaled(
        _moved, _displaced, [of.DISPLACED], eps(16, 32), name=_MOVED, kink=_at_rest
    ),
]
