"""The envelope's rows of searches within bounds, which go through any real numbers."""

import itertools
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..curve_fitting import CurveSpace
from ..curve_fitting.space import FAMILIES, LOCALIZATIONS
from ..head_fitting import whittle
from . import arguments as of
from .exact_geometry import Numbers
from .row import Argument, Rng, Row, Sized, eps, mp, one

_FARTHEST = 46  # documented: coordinates of curves count no farther
_SMALLEST = 1e-30  # what is smaller counts as this large


def _coordinates(shape: int | tuple[int, ...]) -> Argument:
    """Coordinates of a search: all at an extreme, one of them, and a random mix."""
    spread = [x for x in of.COORDINATES if abs(x) != 46]  # where they stop to count

    def draw(rng: Rng, dtype: np.dtype, n: int) -> np.ndarray:
        extreme, place = of.COORDINATES[n // 3 % 15], n // 3 % np.prod(shape)
        alone = rng.normal(size=shape)
        alone.flat[place] = extreme
        return (np.full(shape, extreme), alone, rng.choice(spread, shape))[n % 3]

    return Argument("coordinates 0, 1e-9 to 700, infinite", draw)


def _log_bounds(rng: Rng, dtype: np.dtype, n: int) -> np.ndarray:
    return whittle.log_bounds(1, (1.6, 30.0, 90.0, 1000.0)[n % 4])


def _log_values(logits: Any, log_bounds: Any) -> Any:
    one = jnp.ones(1, logits.dtype)
    power, leakage = (jnp.ones((1, 1, n), logits.dtype) for n in (3, 1))
    data = whittle.Data(
        power, one, leakage, jnp.zeros(1, int), one, one[0], log_bounds, one[0]
    )
    return whittle.log_values(whittle.Search(logits, one), data)


_logistic = lambda x: 1 / (1 + mp.exp(-x))


def _exact_log_values(logits: np.ndarray, log_bounds: np.ndarray) -> Sized:
    """Logarithms of a head's numbers, which count by their larger bounds."""
    values, sizes = [], []
    for row, low, high in zip(logits, *log_bounds, strict=True):
        values += [low + (high - low) * _logistic(x) for x in row]
        sizes += [max(abs(low), abs(high))] * len(row)
    return Sized(values, sizes)


def _natural(space: CurveSpace, point: Numbers) -> Sized:
    """Return a curve's numbers, as documented, which count by themselves."""
    left = iter([min(max(x, mp.mpf(-_FARTHEST)), mp.mpf(_FARTHEST)) for x in point])
    take = lambda count: list(itertools.islice(left, count))

    def simplex(count: int) -> list:
        parts = [mp.exp(x) for x in [*take(count - 1), mp.mpf(0)]]
        return [part / mp.fsum(parts) for part in parts]

    w_min, below, log_h_max = take(3)
    w_min = _logistic(w_min)
    numbers, away = [w_min, w_min * _logistic(below), mp.exp(log_h_max)], mp.mpf(1)
    for step in take(space.samples):
        away *= 1 - _logistic(step)
        numbers.append(1 - away)
    if space.samples > 1:
        weights = list(itertools.accumulate(simplex(space.samples)))
        numbers += [weight / mp.fsum(weights) for weight in weights]
    if space.family == "power":
        numbers.append(mp.mpf(1) / 2 + mp.exp(next(left)))
    numbers += simplex(6) if space.family == "spline" else []
    numbers += simplex(4) if space.localization == "spline" else []
    return Sized(numbers, [max(x, mp.mpf(_SMALLEST)) for x in numbers])


def _numbers(space: CurveSpace, quick: int = 0) -> Row:
    kind = f"{space.family}, {space.localization}, {space.samples}"
    # Differences of up to 92, and logarithms of up to 44, are rounded by half an eps of
    # that, which an exponential is off by; besides it some ten roundings.
    return Row(
        space.natural,
        partial(_natural, space),
        [_coordinates(space.size)],
        eps(64, 64),
        name=f"CurveSpace.natural ({kind})",
        slope_unit=one,
        kink=lambda point: bool(np.any(np.abs(point) == _FARTHEST)),
        quick=quick,
    )


_LOGITS = [_coordinates((6, 3)), Argument("1.6 to 1000 Hz", _log_bounds)]
_SIGMOIDS: Any = {"slope_unit": one, "wrt": (0,), "count": 45}
_LOG_VALUES = "head_fitting.whittle.log_values"

SEARCHES = [
    # A sigmoid, a product and a sum.
    Row(
        _log_values,
        _exact_log_values,
        _LOGITS,
        eps(4, 4),
        name=_LOG_VALUES,
        **_SIGMOIDS,
    ),
    _numbers(CurveSpace(), quick=24),
    *(_numbers(CurveSpace(f, 4, kind)) for f in FAMILIES for kind in LOCALIZATIONS),
]
