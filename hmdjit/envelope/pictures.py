"""The envelope's rows of colours, blends, resampling and metrics."""

from collections.abc import Callable
from functools import partial, wraps
from typing import Any

import jax.numpy as jnp
import numpy as np

from .. import blending, color, metrics
from ..frames import resampling
from ..theory.picture_statistics import DIRECTIONS, PictureStatistics
from . import arguments as of
from .curves import cosine
from .engine import Argument, Bound, Rng, Row, eps, in_numpy, mp, own_size, scaled

mpf = mp.mpf


def _encode(linear: Any) -> Any:
    if linear <= mpf("0.0031308"):
        return mpf("12.92") * linear
    return mpf("1.055") * linear ** (1 / mpf("2.4")) - mpf("0.055")


def _decode(gamma: Any) -> Any:
    if gamma <= mpf("0.04045"):
        return gamma / mpf("12.92")
    return ((gamma + mpf("0.055")) / mpf("1.055")) ** mpf("2.4")


@partial(Argument, "h 0 to 2 h_max, an ulp beside it; h_max 1e-25 to 1e25 deg/s")
def _speed(rng: Rng, dtype: np.dtype, n: int) -> tuple[Any, Any]:
    h_max, ulp = (1e-25, 1e-6, 25.0, 1e9, 1e25)[n // 9 % 5], np.finfo(dtype).eps
    share = (0.0, 1e-9, 1e-3, 0.5, 1 - ulp, 1.0, 1 + ulp, 2.0, rng.random())[n % 9]
    return dtype.type(share) * dtype.type(h_max), h_max


def _past_color(samples: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Equation (2), of weights that sum to 1: the last one is what the others leave."""
    return np.array([*weights[:-1], 1 - mp.fsum(weights[:-1])]).dot(samples)


def _difference(kind: str, oracle: Callable) -> Row:
    function, name = blending.color_difference, f"blending.color_difference ({kind})"
    return _dark(partial(function, kind=kind), oracle, _SHOWN, eps(8, 8), name=name)


_at_joint = lambda x: any(abs(x / joint - 1) < 1e-6 for joint in (0.0031308, 0.04045))
_equal = lambda one, other: np.max(np.abs(one - other)) < 1e-17
_past = lambda x, weights: blending.past_color(list(x[..., None, None]), list(weights))
_ease = lambda speed, h_max: cosine(min(speed, h_max) / h_max)
_luma = lambda rgb: rgb.dot([mpf(weight) for weight in ("0.2126", "0.7152", "0.0722")])
_distance = lambda one, other: mp.norm((one - other).ravel())
_squared = lambda one, other: _distance(one, other) ** 2
_euclidean = lambda *two: min(_distance(*two) / mp.sqrt(3), mp.one)
_largest = lambda one, other: min(max(abs(one - other).ravel()), mp.one)
_minimum = lambda w_min, w_lb, difference: w_min - (w_min - w_lb) * difference
_weight = lambda minimum, easing: minimum + (1 - minimum) * easing
_mixed = lambda now, past, weight: blending.blend(now, past, weight[None, None])
_exact_mixed = lambda now, past, weight: now * weight + past * (1 - weight)
_black = lambda now, past, weight: not (now.any() or past.any())
# What is black and all past is left with nothing but rounding.
_is_seen = lambda now, past, weight: past.any() or not now.any()
_BLEND: Any = {"name": "blending.blend", "slope_unit": own_size, "kink": _black}
# What is smaller squares to 0 in float32.
_dark = partial(Row, floor=1e-17, kink=_equal)
_LEVEL = of.logarithmic("0, 1e-30 to 1e6", *of.LEVELS, -1e-3, within=(1e-12, 1e6))
_HDR = [of.apart(of.pictures(2, 3, 1, 1))]
_SHOWN = [of.apart(of.pictures(2, 3, 1, 1, levels=of.LEVELS[:-3]))]
_SAMPLE = of.logarithmic("samples of 1e-8 to 1e6", within=(1e-8, 1e6))
_PAST = [of.arrays(_SAMPLE, 16, 3), of.weights(16)]


def _read(kernel: Callable, picture: np.ndarray, dx: Any, dy: Any) -> Any:
    """Sum of texels about (2, 2) by a kernel; those beyond an edge are its."""

    def weights(position: Any, size: int) -> np.ndarray:
        base, found = int(mp.floor(position)), np.array([mpf(0)] * size)
        for tap in range(base - 1, base + 3):
            found[min(max(tap, 0), size - 1)] += kernel(position - tap)
        return found

    down, across = map(weights, (2 + dy, 2 + dx), picture.shape)
    return down.dot(picture).dot(across)


def _keys(t: Any) -> Any:
    """Keys' kernel, a = -1/2."""
    t = abs(t)
    return (3 * t**3 - 5 * t**2 + 2 if t < 1 else -(t**3) + 5 * t**2 - 8 * t + 4) / 2


def _reader(read: Any, kernel: Any, bounds: Any, stored="", **options: Any) -> Row:
    two = jnp.full((1, 1), 2, jnp.int32)

    def at(picture: Any, dx: Any, dy: Any) -> Any:
        kept = resampling.texels(picture[..., None]).astype(stored or picture.dtype)
        return read(kept, two, two, dx[None, None], dy[None, None])

    # The position's fraction has eps of 1, of however dark a pixel.
    options = {"floor": 1.0, "slope_unit": 1.0, **options}
    given = partial(_read, kernel), [_TEXELS, _OFFSET, _OFFSET], bounds
    return Row(wraps(read)(at), *given, **options)


@wraps(resampling.bilinear_by_slices)
def _by_slices(texels: Any, column: Any, row: Any, dx: Any, dy: Any) -> Any:
    span = jnp.stack([jnp.stack([dx[0, 0], dy[0, 0]])] * 2)
    place = jnp.int32(2), jnp.int32(2)
    return resampling.bilinear_by_slices(texels, *place, (1, 1), span, lambda: (dx, dy))


_on_a_texel = lambda picture, *place: any(abs(d - np.rint(d)) < 1e-20 for d in place)
_box, _tent = lambda t: mpf(-0.5 <= t < 0.5), lambda t: max(1 - abs(t), 0)
_linear = partial(_reader, kernel=_tent, kink=_on_a_texel)
_TEXELS = Argument("", lambda rng, *_: rng.integers(0, 256, (4, 5)) / 256)  # exact
_OFFSETS = (0.0, 1.0, -2.0, 3.0, 1e6, -1e6, 1e-30, -1e-30, 1e-6, -1e-6, 0.5 - 1e-3)
_OFFSET = of.numbers("0, 1e-30 to 1e6 texels, beyond edges", *_OFFSETS, within=(-5, 6))
_TWO, _NAME = resampling.bilinear, "frames.resampling.bilinear"
_STORED: Any = {"bounds": {"float32": Bound(4, 8)}, "wrt": (1, 2)}


def _mtcd(clip: np.ndarray) -> Any:
    """Equation (6): mean distance of successive pixels, code values."""
    pixels = np.diff(clip, axis=0).reshape(-1, 3)
    return 255 * mp.fsum(map(mp.norm, pixels)) / len(pixels)


def _displaced(slope_squared: Any, finest_px: Any, displacement: Any) -> Any:
    """RMS difference from the picture displaced: harmonics, between octaves."""
    length, direction = mp.norm(displacement), mp.atan2(*displacement[::-1])
    octaves, directions = slope_squared.shape
    turns = [2 * n * direction for n in range(1, directions // 2 + 1)]
    waves = [mpf(1), *(f(x) for x in turns for f in (mp.cos, mp.sin))][:directions]
    octave = min(max(mp.log(length / finest_px, 2), mpf(0)), octaves - 1)
    below = min(int(octave), octaves - 2)
    near, far = slope_squared[below : below + 2].dot(waves)
    return length * mp.sqrt(near + (octave - below) * (far - near))


def _streamed(clip: np.ndarray) -> float:
    streamed = metrics.Streamed(metrics.MTCD())
    for frame in clip:
        streamed.add(frame)
    return streamed.value


@wraps(PictureStatistics.difference)
def _moved(slope_squared: Any, finest_px: Any, displacement: Any) -> Any:
    statistics = PictureStatistics(slope_squared[None], finest_px, 64, False)
    return statistics.difference(displacement[None])[0]


@partial(Argument, "")
def _slopes(rng: Rng, dtype: np.dtype, n: int) -> tuple[np.ndarray, float]:
    waves = rng.uniform(-0.1, 0.1, (3, DIRECTIONS))
    waves[:, 0] = 1.0
    return waves * 10 ** rng.uniform(-6, 0), 0.25


_mse = lambda test, real: mp.fsum((test - real).ravel(), squared=True) / test.size
_decibels = lambda power, error: 10 * mp.log10(power / error if error else mp.inf)
_psnr = lambda *two: _decibels(mpf(255) ** 2, _mse(*two))
_snr = lambda test, real: _decibels(_mse(0 * real, real), _mse(test, real))
_no_ratio = lambda test, real: np.array_equal(test, real) or not real.any()
_still = lambda slopes, finest_px, displacement: not displacement.any()
_error = partial(Row, kink=np.array_equal, count=72)
# dB: a logarithm of up to 32 and its factor of 10 are rounded, and their sum.
_DECIBELS = {"float32": Bound(1e-4, 8), "float64": Bound(2e-13, 8)}
_LEVELS = (0.0, 1e-8, 1e-3, 0.5, 1.0, 255.0, 1e6)
_PAIR = [of.apart(of.pictures(2, 2, 3, levels=_LEVELS))]
_SCALES = of.numbers("1e4 frames of 1e-8 to 1", 1e-8, 1e-5, 1e-3, 0.1, 0.5, 1.0)
_STREAMED = "metrics.base.Streamed"
_LONG, _EACH = [of.arrays(_SCALES, 10_000, 1, 2, 3)], {"float64": Bound(1e4 * 2.0**-53)}
_LENGTHS = (0.0, 1e-15, 1e-6, 0.2, 0.3, 0.6, 0.9, 3.0, 1e3, 1e6)
_PX = of.logarithmic("0, 1e-15 to 1e6 px", *_LENGTHS, within=(1e-2, 100))

ROWS = [
    # A power by logarithms loses as many eps as the exponent is large.
    Row(color.encode, _encode, [_LEVEL], eps(24, 24), kink=_at_joint),
    Row(color.decode, _decode, [_LEVEL], eps(64, 64), kink=_at_joint),
    Row(color.luma, _luma, [of.arrays(_LEVEL, 3)], eps(4, 2)),
    Row(color.squared_distance, _squared, _HDR, eps(8, 4), floor=1e-34),
    _dark(color.distance, _distance, _HDR, eps(6, 8)),
    _difference("euclidean", _euclidean),
    _difference("max_channel", _largest),
    scaled(blending.ease, _ease, [_speed], eps(16, 32), floor=1e-30, count=66),
    Row(blending.localized_minimum, _minimum, [of.SHARE] * 3, eps(4, 2), floor=1.0),
    Row(blending.current_weight, _weight, [of.SHARE] * 2, eps(2, 2), floor=1.0),
    Row(_past, _past_color, _PAST, eps(16, 16), name="blending.past_color"),
    Row(_mixed, _exact_mixed, [*_HDR, of.SHARE], eps(4, 4), kept=_is_seen, **_BLEND),
    _reader(resampling.nearest, _box, eps(0, 0), wrt=(0,), slope_unit=own_size),
    _reader(resampling.catmull_rom, _keys, eps(8, 16), wrt=(1, 2), quick=0),
    _linear(_TWO, bounds=eps(4, 8)),
    _linear(_by_slices, bounds=eps(4, 8), quick=0),
    _linear(_TWO, stored="bfloat16", name=f"{_NAME}, bfloat16 texels", **_STORED),
    _linear(_TWO, stored="float16", name=f"{_NAME}, float16 texels", **_STORED),
    Row(metrics.mtcd, _mtcd, [of.pictures(3, 2, 2, 3, levels=_LEVELS)], eps(8, 16)),
    Row(metrics.mse, _mse, _PAIR, eps(8, 16), count=72),
    _error(metrics.rmsd, lambda *two: mp.sqrt(_mse(*two)), _PAIR, eps(8, 16)),
    _error(metrics.psnr, _psnr, _PAIR, _DECIBELS, "dB"),
    _error(metrics.snr, _snr, _PAIR, _DECIBELS, "dB", kink=_no_ratio),
    in_numpy(_streamed, _mtcd, _LONG, _EACH, "relative", _STREAMED, count=6),
    scaled(_moved, _displaced, [_slopes, of.vectors(_PX, 2)], eps(16, 32), kink=_still),
]
