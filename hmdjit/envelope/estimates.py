"""The envelope's rows of intervals and estimates, in float64 NumPy.

An error counts by what it is rounded from: a value's by the means that it is made of, a
standard error's by what it would be were nothing paired, a bound's by value and
half-width together. So a spread must keep its digits however far below the mean it is.
"""

from collections.abc import Callable
from functools import partial, wraps
from typing import Any, NamedTuple

import numpy as np

from ..estimates import estimate, intervals, planning
from . import arguments as of
from .engine import Argument, Bound, Rng, Row, Sized, in_numpy, mp

# A sum of 1e5 is made of 16 additions and 10 halvings: 13 eps, were all to round one
# way. Of a standard error that is half, and three for the roots and quotients.
_SUMMED = {"float64": Bound(16)}
_NO_SPREAD = 1e-13  # documented: of the sessions' size, what counts as no spread
_FEWEST = 50  # documented: of fewer sessions, intervals are resampled


@partial(
    Argument,
    "1, 2, 49 to 51, 1e5 sessions of 0, 1e-8 to 1e6; equal, equal but for 1e-12, "
    "lognormal to 3, in proportion, some NaN",
)
def _sessions(rng: Rng, dtype: np.dtype, n: int) -> tuple[Any, ...]:
    """Sessions `(scene, session)`, derivatives of the first scene, and paths."""
    # Counts of both sides of the bootstrap; within 56 everything meets all else.
    count = 100_000 if n % 44 == 41 else (1, 2, 49, 50, 51)[n % 5]
    spread = (0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.5, 3.0)[n % 7]
    size = (0.0, 1e-8, 1e-3, 1.0, 1e6, 0.1, 1 / 3, 441.67)[n % 8]
    paired = (0.0, 1.0, 0.97)[n % 3]
    z, w, (sign, noise) = rng.normal(size=(3, 2, count))
    # Heavy tails leave enough for a ratio, however few sessions there are.
    x = size * (0.1 + 0.6 * np.exp(spread * z))
    y = max(size, 1.0) * (0.1 + np.exp(spread * (paired * z + (1 - paired) * w)))
    if n % 13 == 7:
        x[:, 1::3], y[0, 2::4] = np.nan, np.nan
    dx = (x[0] * sign, 3 * x[0], x[0] + 1e-9 * noise)[n // 88 % 3]
    dy = (y[0] * noise, 1e-3 * y[0], 1 + 0 * y[0])[n // 88 % 3]
    paths, slope = y[0][np.isfinite(y[0])][-1000:], (0.0, 1e-3, 0.9, 1e6)[n // 88]
    return x, y, dx, dy, np.append(paths, paths[0]), slope


_flickers = lambda x, *others: bool(np.all(np.nansum(x, axis=-1) > 0))
_is_known = lambda *s: _flickers(*s) and bool(np.isfinite(s[0] + s[1]).all())
_has_spread = lambda x, *others: _flickers(x) and x.shape[1] > 1
Parts = list[tuple[Any, Any]]  # of an exact answer: numbers, and by what they count


class Truth(NamedTuple):
    """An estimate, and what its parts are rounded from; one session has no error."""

    value: Any
    error: Any
    size: Any  # of the value, or of a mean's part in it
    spread: Any  # the standard error, were nothing paired
    sessions: int
    is_rounding: bool = False  # no session moves it by more than that

    def estimate(self) -> Parts:
        """Value and standard error."""
        return [(self.value, self.size or 1), (self.error, self.spread or 1)]

    def interval(self, is_logarithmic: bool = False) -> Parts:
        """Besides them bounds, which are symmetric or so in logarithms."""
        (value, size), (error, spread) = self.estimate()
        if self.is_rounding:
            error = mp.zero
        elif 1 < self.sessions < _FEWEST:
            # Resampled: only that there is one, about the value, can be asked of it.
            return [(value, size), (1, 1), (0, size), (0, size)]
        step = _level(0) * error
        parts = [(value, size), (error, spread)]
        for move in (-step, step):
            end = value * mp.exp(move / value) if is_logarithmic else value + move
            share = max(1, abs(end / value)) if value else 1
            parts.append((end, size * share + (step if step > 0 else 0)))
        return parts

    def gain(self) -> Parts:
        """How much less variance pairing leaves, which counts by what that loses."""
        if not self.spread or self.error <= _NO_SPREAD * self.spread:
            return [(mp.nan, 1)]
        over = self.spread / self.error
        return [(over**2, 2 * over**2 * max(over, 1))]


# Half-width of an interval that errs with probability `0.05 / 2^analysis`.
_level = lambda analysis: mp.sqrt(2) * mp.erfinv(1 - 1 / mp.mpf(20 << analysis))
_is_finite = np.vectorize(mp.isfinite, [bool])


def truth(function: Callable, *samples: np.ndarray) -> Truth:
    """Delta method of a function of means; samples that lack a session have a NaN."""
    known = _is_finite(samples)
    numbers, counts = np.where(known, samples, mp.zero), known.sum(axis=1).tolist()
    means, count = numbers.sum(axis=1) / counts, min(counts)
    orders = np.eye(len(means), dtype=int).tolist()
    weights = np.array([mp.diff(function, [*means], order) for order in orders])
    value, parts = function(*means), weights * abs(numbers).sum(axis=1) / counts
    size = max(abs(value), *abs(parts))
    if count == 1:
        return Truth(value, mp.nan, size, mp.inf, count)
    # What each session adds to the error, by each mean.
    units = weights / [mp.sqrt(n * (n - 1)) for n in counts]
    parts = np.where(known, numbers - means[:, None], 0) * units[:, None]
    added, spread = parts.sum(axis=0), mp.norm(parts.ravel())
    largest = abs(numbers).max(axis=1).dot(abs(units))
    is_rounding = max(abs(added)) <= _NO_SPREAD * largest
    return Truth(value, mp.norm(added), size, spread, count, is_rounding)


_mean, _ratio = partial(truth, lambda a: a), partial(truth, lambda a, b: a / b)
_slope = partial(truth, lambda a, b, up, down: up / a - down / b)


def _geometric_mean(x: np.ndarray, y: np.ndarray) -> Truth:
    """Of two scenes' ratios; a power loses as many eps as its exponent is large."""
    found = truth(lambda a, b, c, d: mp.sqrt(a / c * b / d), *x, *y)
    lost = 1 + abs(mp.log(found.value))
    return found._replace(size=found.size * lost, spread=found.spread * lost)


def _exact_geometric(x: np.ndarray, y: np.ndarray) -> Parts:
    """As documented: a session that a scene lacks adds 0 to its sums."""
    known = _is_finite(x + y)
    both = np.where(known, [x, y], mp.zero)[..., known.any(axis=0)]
    return _geometric_mean(*both).interval(is_logarithmic=True)


def _exact_control(y: Any, t: Any, paths: Any, slope: Any) -> Parts:
    """Without a slope predictions do not count; paths are sessions of their own."""
    if slope == 0:
        return _mean(y).estimate()
    function = lambda here, t, there: here + mp.mpf(slope) * (there - t)
    none = np.full(len(paths), mp.nan)
    here = [np.append(row, none) for row in (y + 0 * t, t + 0 * y)]
    return truth(function, *here, np.append(mp.nan * y, paths)).estimate()


def _exact_estimates(x: np.ndarray, y: np.ndarray) -> Parts:
    one, two = (_ratio(*pair) for pair in zip(x, y, strict=True))
    parts = one.estimate() + two.estimate() + one.gain() + two.gain()
    return parts + _geometric_mean(x, y).estimate()


def _numbers(found: Any) -> list[float]:
    """Value, error and bounds; if resampled, how far these are on the wrong side."""
    if isinstance(found, float):
        return [found]
    if isinstance(found, list):
        return [number for one in found for number in _numbers(one)]
    value, error = found.value, found.standard_error
    if isinstance(found, estimate.Estimate):
        return [value, error]
    if found.method.startswith("bootstrap"):
        gaps = found.low - value, value - found.high
        return [value, float(error > 0), *(max(gap, 0.0) for gap in gaps)]
    return [value, error, found.low, found.high]


def _estimates(x: np.ndarray, y: np.ndarray, nan_policy: Any) -> list[Any]:
    mean = partial(estimate.mean_of, nan_policy=nan_policy)
    pairs = [(mean(one), mean(other)) for one, other in zip(x, y, strict=True)]
    ratios = [estimate.ratio(*pair) for pair in pairs]
    gains = [estimate.pairing_gain(*pair) for pair in pairs]
    return [*ratios, *gains, estimate.geometric_mean(ratios)]


def _row(function: Callable, rows: Callable, oracle: Callable, **options: Any) -> Row:
    @wraps(function)
    def measured(*drawn: Any) -> list[float]:
        return _numbers(function(*rows(*drawn), nan_policy="omit"))

    exact = lambda *drawn: Sized(*zip(*oracle(*rows(*drawn)), strict=True))
    return in_numpy(measured, exact, [_sessions], _SUMMED, **{"count": 88, **options})


_technique = lambda x, *others: (x[0],)
_pair = lambda x, y, *others: (x[0], y[0])
_scenes = lambda x, y, *others: (x, y)
_derivatives = lambda x, y, dx, dy, *others: (x[0], y[0], dx, dy)
_control = lambda x, y, dx, dy, *others: (x[0], y[0], *others)
_exact_ratio = lambda x, y: _ratio(x + 0 * y, y + 0 * x).interval()
_derivative = intervals.log_ratio_derivative_interval
_exact_derivative = lambda *rows: _slope(*rows).interval()
_ALL: Any = {"name": "estimates.estimate.ratio, geometric_mean, pairing_gain"}
_LEVELS = [of.numbers("interim analyses 1 to 199", *range(1, 200, 5))]

ROWS = [
    _row(intervals.mean_interval, _technique, lambda x: _mean(x).interval()),
    _row(intervals.ratio_interval, _pair, _exact_ratio),
    _row(intervals.geometric_mean_ratio, _scenes, _exact_geometric, kept=_flickers),
    _row(_derivative, _derivatives, _exact_derivative, kept=_is_known, count=264),
    _row(estimate.mean_of, _technique, lambda x: _mean(x).estimate()),
    _row(estimate.control_variate, _control, _exact_control, count=352),
    _row(_estimates, _scenes, _exact_estimates, kept=_has_spread, **_ALL),
    # A rational function of the root of a logarithm: some ten roundings.
    in_numpy(planning.interim_level, _level, _LEVELS, {"float64": Bound(8)}, count=41),
]
