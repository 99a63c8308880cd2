"""The envelope's cases of metrics: MTCD, MSE, RMSD, PSNR, SNR, and MTCD's prediction.

Pictures are equal, nearly equal, black, of one changed pixel, and far
brighter than white.
"""

import math
from collections.abc import Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np

from .. import metrics
from ..theory.picture_statistics import DIRECTIONS, PictureStatistics
from .cases import eps
from .measuring import Bound, Case, Inputs, Run, Worst
from .oracles import mp

_Rng = np.random.Generator
_LEVELS = (1e-8, 1e-3, 0.5, 1.0, 255.0, 1e6)


def _clips(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    """Three frames of 2 x 2 pixels; what differs does so by more than 1e-17."""
    # The oracle's step, 1e-18, must be small beside a difference.
    shape, near = (3, 2, 2, 3), max(4 * float(np.finfo(dtype).eps), 1e-9)
    yield (np.zeros(shape, dtype),)
    for level in _LEVELS:
        still = np.full(shape, level)
        one = still.copy()
        one[1, 0, 1, 2] *= 1 + near
        beside = level * (1 + near * rng.integers(-8, 9, shape))
        for clip in (still, one, beside, level * rng.random(shape)):
            yield (np.asarray(clip, dtype),)


def _exact_mtcd(clip: np.ndarray) -> list:
    squares = (clip[1:] - clip[:-1]) ** 2
    pixels = squares.reshape(-1, 3)
    return [255 * mp.fsum(mp.sqrt(mp.fsum(pixel)) for pixel in pixels) / len(pixels)]


def _pictures(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    """Pair tests and references, `(2, 3)`."""
    clips = [clip for (clip,) in _clips(rng, dtype)]
    for clip in clips:
        yield clip[1, 0], clip[0, 0]
        yield clip[1, 1], clip[0, 1] / 2
    yield clips[-1][1, 1], np.zeros_like(clips[-1][0, 0])


def _mean_square(values: np.ndarray) -> Any:
    return mp.fsum(values.ravel(), squared=True) / values.size


def _exact_mse(test: np.ndarray, reference: np.ndarray) -> list:
    return [_mean_square(test - reference)]


def _exact_rmsd(test: np.ndarray, reference: np.ndarray) -> list:
    return [mp.sqrt(_mean_square(test - reference))]


def _decibels(power: Any, error: Any) -> list:
    """Return the ratio; of no error 0 here, as ours is made there."""
    if not error:
        return [mp.mpf(0)]
    return [10 * mp.log10(power / error) if power else mp.mpf(0)]


def _exact_psnr(test: np.ndarray, reference: np.ndarray) -> list:
    return _decibels(mp.mpf(255) ** 2, _mean_square(test - reference))


def _exact_snr(test: np.ndarray, reference: np.ndarray) -> list:
    return _decibels(_mean_square(reference), _mean_square(test - reference))


def _finite(ratio: Any) -> Any:
    """Let 0 stand for what is infinite, of equal pictures and of a black reference."""

    def of(test: Any, reference: Any) -> Any:
        found = ratio(test, reference)
        is_equal = jnp.all(test == reference)
        expected = jnp.where(is_equal, jnp.inf, -jnp.inf).astype(found.dtype)
        return jnp.where(found == expected, 0.0, found)

    return of


def _equal(test: np.ndarray, reference: np.ndarray) -> bool:
    return bool(np.array_equal(test, reference))


def _no_ratio(test: np.ndarray, reference: np.ndarray) -> bool:
    return _equal(test, reference) or not reference.any()


def streams(rng: _Rng, dtype: str, quick: bool) -> tuple[float, str]:
    """Errors of `StreamedMtcd`, relative."""
    del dtype
    worst, frames = Worst(), 100 if quick else 10_000
    for level in _LEVELS:
        clip = level * rng.random((frames, 1, 2, 3))
        streamed = metrics.StreamedMtcd()
        for picture in clip:
            streamed.add(picture)
        numbers = [mp.mpf(x) for x in clip.ravel().tolist()]
        (exact,) = _exact_mtcd(np.array(numbers, object).reshape(clip.shape))
        error = abs(mp.mpf(streamed.value) / exact - 1)
        worst.add(float(error), f"{frames} frames up to {level:g}")
    return worst.found


_OCTAVES, _FINEST_PX = 3, 0.25


def _displaced(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    """Statistics of a cell, smallest tabled length and displacement, px."""
    lengths = (0.0, 1e-15, 1e-6, 0.2, 0.3, 0.6, 0.9, 3.0, 1e3, 1e6)
    for n, length in enumerate((*lengths, *lengths, *10 ** rng.uniform(-2, 2, 20))):
        waves = rng.uniform(-0.1, 0.1, (_OCTAVES, DIRECTIONS))
        waves[:, 0] = 1.0
        angle = (0.0, math.tau / 8, rng.uniform(0, math.tau))[n % 3]
        displacement = length * np.array([math.cos(angle), math.sin(angle)])
        numbers = waves * 10 ** rng.uniform(-6, 0), _FINEST_PX, displacement
        yield tuple(np.asarray(x, dtype) for x in numbers)


def _difference(slope_squared: Any, finest_px: Any, displacement_px: Any) -> Any:
    cell = PictureStatistics(slope_squared[None], finest_px, 64, False)
    return cell.difference(displacement_px[None])[0]


def _exact_difference(slope_squared: Any, finest_px: Any, displacement: Any) -> list:
    dx, dy = displacement
    length, direction = mp.hypot(dx, dy), mp.atan2(dy, dx)
    if not length:
        return [mp.mpf(0)]
    turns = [2 * n * direction for n in range(1, DIRECTIONS // 2 + 1)]
    waves = [mp.mpf(1), *(f(x) for x in turns for f in (mp.cos, mp.sin))][:DIRECTIONS]
    octave = min(max(mp.log(length / finest_px[()], 2), mp.mpf(0)), _OCTAVES - 1)
    below = min(int(octave), _OCTAVES - 2)
    near, far = (mp.fdot(slope_squared[below + i], waves) for i in (0, 1))
    return [length * mp.sqrt(near + (octave - below) * (far - near))]


def _at_rest(slope_squared: Any, finest_px: Any, displacement_px: np.ndarray) -> bool:
    return not displacement_px.any()


def cases() -> list[Case]:
    """Pictures of 0 and 1e-8 to 1e6."""
    over = "0, 1e-8 to 1e6: equal, one channel of one pixel, all by 4 eps or 1e-9"
    # dB: a logarithm of up to 32 and its factor of 10 are rounded, and their sum.
    decibels = {"float32": Bound(1e-4, 8), "float64": Bound(2e-13, 8)}
    levels: dict[str, Any] = {"unit": "dB", "bounds": decibels}
    return [
        Case("metrics.mtcd", over, metrics.mtcd, _exact_mtcd, _clips, eps(8, 16)),
        Case("metrics.mse", over, metrics.mse, _exact_mse, _pictures, eps(8, 16)),
        Case(
            "metrics.rmsd",
            over,
            metrics.rmsd,
            _exact_rmsd,
            _pictures,
            eps(8, 16),
            has_kink=_equal,
        ),
        Case(
            "metrics.psnr",
            over,
            _finite(metrics.psnr),
            _exact_psnr,
            _pictures,
            has_kink=_equal,
            **levels,
        ),
        Case(
            "metrics.snr",
            over,
            _finite(metrics.snr),
            _exact_snr,
            _pictures,
            has_kink=_no_ratio,
            **levels,
        ),
        Case(
            "PictureStatistics.difference",
            "0, 1e-15 to 1e6 px, before, between and beyond tabled lengths",
            _difference,
            _exact_difference,
            _displaced,
            eps(16, 32),
            slope_floor=1.0,
            has_kink=_at_rest,
        ),
    ]


def runs() -> list[Run]:
    """Return the one of a clip that comes picture by picture."""
    # A rounding for each frame.
    bound = {"float64": Bound(10_000 * 2.0**-53)}
    over = "1e4 frames of 1e-8 to 1e6"
    name = "metrics.StreamedMtcd"
    return [Run(name, over, streams, bound, "relative", is_slow=True)]
