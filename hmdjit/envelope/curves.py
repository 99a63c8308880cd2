"""The envelope's rows of curves, sample patterns and searches within bounds."""

import itertools
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from .. import curves
from ..curve_fitting.space import FAMILIES, LOCALIZATIONS, CurveSpace
from ..head_fitting import whittle
from ..sample_patterns import radical_inverse
from . import arguments as of
from .engine import Argument, Bound, Row, Sized, eps, in_numpy, mp, scaled

_FARTHEST = 46  # documented: coordinates of curves count no farther
_SMALLEST = mp.mpf(10) ** -30  # what is smaller counts as this large


def cosine(share: Any, exponent: Any = 2) -> Any:
    """Kim et al.'s equation (4) with its exponent free."""
    half = (1 - mp.cos(mp.pi * share)) / 2
    return half**exponent if half else half


def _spline(share: Any, rises: np.ndarray) -> Any:
    """Integral of the polygon of slopes up to a share, over all of it."""
    slopes = [2 * rises[0], *rises[1:-1], 2 * rises[-1]]
    sides = np.diff(slopes)
    bends = np.diff(sides, prepend=0)

    def until(end: Any) -> Any:
        # The first side goes on before the start: there the curve has a derivative.
        powers = [end**2, *(max(end - k, 0) ** 2 for k in range(1, len(sides)))]
        return slopes[0] * end + bends.dot(powers) / 2

    return until(share * len(sides)) / until(len(sides))


def _radical_inverse(base: int, index: int) -> Any:
    """Digits of an index, mirrored at the point."""
    digits = reversed(np.base_repr(index, base))
    return mp.fsum(int(x) / mp.mpf(base) ** (k + 1) for k, x in enumerate(digits))


def _log_values(logits: Any, log_bounds: Any) -> Any:
    x, power, leakage = (jnp.ones(s, logits.dtype) for s in (1, (1, 1, 3), (1, 1, 1)))
    of = x, leakage, jnp.zeros(1, int), x, x[0], log_bounds, x[0]
    return whittle.log_values(whittle.Search(logits, x), whittle.Data(power, *of))


_logistic = lambda x: 1 / (1 + mp.exp(-x))


def _exact_log_values(logits: np.ndarray, log_bounds: np.ndarray) -> Sized:
    """Logarithms of a head's numbers, which count by their larger bounds."""
    low, high = (np.repeat(of[:, None], 3, axis=1) for of in log_bounds)
    shares = np.vectorize(_logistic, "O")(logits)
    sizes = np.maximum(abs(low), abs(high)).ravel()
    return Sized(low + (high - low) * shares, sizes)


def _natural(space: CurveSpace, point: np.ndarray) -> Sized:
    """Return a curve's numbers, as documented, which count by themselves."""
    left = iter(np.clip(point, -_FARTHEST, _FARTHEST))
    take = lambda count: list(itertools.islice(left, count))

    def simplex(count: int) -> np.ndarray:
        parts = [mp.exp(x) for x in [*take(count - 1), mp.zero]]
        return np.array(parts) / mp.fsum(parts)

    w_min, below, log_h_max = take(3)
    w_min = _logistic(w_min)
    numbers = [w_min, w_min * _logistic(below), mp.exp(log_h_max)]
    numbers += [*(1 - np.cumprod([1 - _logistic(x) for x in take(space.samples)]))]
    weights = np.cumsum(simplex(space.samples))
    numbers += [*(weights / mp.fsum(weights))] if space.samples > 1 else []
    numbers += [mp.mpf(0.5) + mp.exp(*take(1))] if space.family == "power" else []
    numbers += [*simplex(6)] if space.family == "spline" else []
    numbers += [*simplex(4)] if space.localization == "spline" else []
    return Sized(numbers, [max(x, _SMALLEST) for x in numbers])


def _numbers(family: str, samples: int, localization: str, quick: int = 0) -> Row:
    space = CurveSpace(family, samples, localization)
    name = f"CurveSpace.natural ({family}, {localization}, {samples})"
    options: Any = {"slope_unit": 1.0, "kink": _ends, "quick": quick, "name": name}
    oracle, given = partial(_natural, space), [of.coordinates(space.size)]
    # Differences of up to 92, and logarithms of up to 44, are rounded by half an eps of
    # that, which an exponential is off by; besides it some ten roundings.
    return Row(space.natural, oracle, given, eps(64, 64), **options)


# Curves rise from 0; what is smaller counts as this large.
_curve = partial(scaled, floor=1e-30)
_cosine = lambda share, exponent: curves.Cosine(exponent)(share)
_rising = lambda share, rises: curves.Spline(tuple(rises))(share)
_ends = lambda point: np.any(np.abs(point) == _FARTHEST)
_steep = lambda share, exponent: share == 0 and exponent == 0.5
_POWER = of.logarithmic("exponent 0.5 to 100", 0.5, 1.0, 2.0, 100.0, within=(0.5, 100))
_POWERS: Any = {"name": "curves.Cosine", "kink": _steep}
_INDICES = (0, 1, 2, 15, 10**9 - 1, 123_456_789, 3**18, 5**12 - 1)
_INDEX = [of.numbers("bases 2, 3, 5", 2, 3, 5), of.numbers("indices to 1e9", *_INDICES)]
_ULPS = {"float64": Bound(4 * 2.0**-52)}
_BOUNDS = lambda rng, dtype, n: whittle.log_bounds(1, (1.6, 30.0, 90.0, 1e3)[n % 4])
_LOGITS = [of.coordinates(6, 3), Argument("1.6 to 1000 Hz", _BOUNDS)]
_SIGMOIDS: Any = {"slope_unit": 1.0, "wrt": (0,), "count": 45}
_RISING, _NAME = "curves.Spline", "head_fitting.whittle.log_values"

ROWS = [
    _curve(curves.Kim(), cosine, [of.SHARE], eps(8, 16), name="curves.Kim"),
    # A power takes its base's rounding times its exponent.
    _curve(_cosine, cosine, [of.SHARE, _POWER], eps(128, 256), **_POWERS),
    _curve(_rising, _spline, [of.SHARE, of.weights(5)], eps(16, 64), name=_RISING),
    in_numpy(radical_inverse, _radical_inverse, _INDEX, _ULPS, "absolute"),
    # A sigmoid, a product and a sum.
    Row(_log_values, _exact_log_values, _LOGITS, eps(4, 4), name=_NAME, **_SIGMOIDS),
    _numbers("kim", 1, "linear", quick=24),
    *(_numbers(family, 4, kind) for family in FAMILIES for kind in LOCALIZATIONS),
]
