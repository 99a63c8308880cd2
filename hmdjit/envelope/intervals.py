"""The envelope's runs of intervals, in float64 NumPy.

Sessions are all equal, equal but for 1e-12, of every size, with heavy tails, failed in
part, and paired so well that a ratio does not vary. An error counts in eps of what it
is rounded from: a value's of the means that it is made of, a standard error's of what
it would be were nothing paired, a bound's of value and half-width together. So a spread
must keep its digits however far below the mean it lies. Below 50 sessions intervals are
resampled: of those only the value is held here, and that there is an interval about it.
"""

import itertools
import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from ..estimates import intervals
from ..estimates.intervals import Interval
from .measuring import Bound, Run, Worst
from .oracles import mp

_Rng = np.random.Generator
_Found = tuple[float, str]
EPS = float(np.finfo(np.float64).eps)

COUNTS = (1, 2, 49, 50, 51, 100_000)
"""Sessions: nothing to compare with, either side of the bootstrap, and many."""

NO_SPREAD = 1e-13
"""Documented: of the sessions' size, what counts as no spread."""


class Truth(NamedTuple):
    """An estimate in many digits, and what its parts are rounded from.

    - `value`, `error`, `low`, `high`: as of an `Interval`; infinite of one session.
    - `size`: of the terms of the value; of the bounds with the half-width.
    - `spread`: the standard error, were nothing paired.
    """

    value: Any
    error: Any
    low: Any
    high: Any
    size: Any
    spread: Any

    @classmethod
    def of(
        cls,
        value: Any,
        size: Any,
        weights: list,
        means: list["Mean"],
        *,
        cut: bool = True,
    ) -> "Truth":
        """Return an estimate that moves by weights with the means of sessions.

        **Arguments:** `cut`: whether what is rounding, as documented, is no spread.
        """
        if min(mean.count for mean in means) == 1:
            return cls(value, mp.inf, -mp.inf, mp.inf, size, mp.inf)
        terms = list(zip(weights, means, strict=True))
        own = mp.fsum(w**2 * a.with_(a) for w, a in terms)
        pairs = itertools.combinations(terms, 2)
        shared = 2 * mp.fsum(v * w * a.with_(b) for (v, a), (w, b) in pairs)
        error, spread = mp.sqrt(abs(own + shared)), mp.sqrt(own)
        if cut:
            largest = np.max(sum(abs(float(w)) * np.abs(a.values) for w, a in terms))
            root = math.sqrt(means[0].count - 1)
            error = error if error * root > NO_SPREAD * largest else mp.mpf(0)
        step = mp.sqrt(2) * mp.erfinv(mp.mpf("0.95")) * error
        return cls(value, error, value - step, value + step, size, spread)


class Mean:
    """Mean of the known sessions, and its covariances, in many digits."""

    def __init__(self, values: np.ndarray):
        self.values, self.known = values, np.isfinite(values)
        self.numbers = _numbers(values[self.known])
        self.count = len(self.numbers)
        self.value = mp.fsum(self.numbers) / self.count
        self.size = mp.fsum(self.numbers, absolute=True) / self.count

    def with_(self, other: "Mean") -> Any:
        """Covariance of both means over the sessions that both know."""
        both = self.known & other.known
        if self.known.all() and other.known.all():
            a, b = self.numbers, other.numbers
        else:
            a, b = _numbers(self.values[both]), _numbers(other.values[both])
        total = mp.fdot(zip(a, b, strict=True)) + len(a) * self.value * other.value
        total -= self.value * mp.fsum(b) + other.value * mp.fsum(a)
        units = (one.count * (one.count - 1) for one in (self, other))
        return total / mp.sqrt(mp.fprod(units))


def _numbers(values: np.ndarray) -> list:
    return [mp.mpf(x) for x in values.tolist()]


def _of_mean(values: np.ndarray) -> Truth:
    x = Mean(values[np.isfinite(values)])
    return Truth.of(x.value, x.size, [1], [x])


def _of_ratio(x: np.ndarray, y: np.ndarray) -> Truth:
    known = np.isfinite(x) & np.isfinite(y)
    a, b = Mean(x[known]), Mean(y[known])
    ratio = a.value / b.value
    weights = [1 / b.value, -ratio / b.value]
    return Truth.of(ratio, ratio, weights, [a, b])


def _of_derivative(
    x: np.ndarray, y: np.ndarray, dx: np.ndarray, dy: np.ndarray
) -> Truth:
    a, b, da, db = (Mean(values) for values in (x, y, dx, dy))
    up, down = da.value / a.value, db.value / b.value
    weights = [-up / a.value, down / b.value, 1 / a.value, -1 / b.value]
    size = da.size / a.value + db.size / b.value
    return Truth.of(up - down, size, weights, [a, b, da, db])


def _of_geometric_mean(x: np.ndarray, y: np.ndarray) -> Truth:
    """As documented: a session that a scene lacks adds 0 to its sums."""
    known, share = np.isfinite(x) & np.isfinite(y), mp.mpf(1) / len(x)
    rows = [np.where(known, of, 0.0) for of in (x, y)]
    a, b = ([Mean(row) for row in of] for of in rows)
    logs = [mp.log(one.value / two.value) for one, two in zip(a, b, strict=True)]
    weights = [share / one.value for one in a] + [-share / two.value for two in b]
    log = Truth.of(share * mp.fsum(logs), 0, weights, [*a, *b])
    value = mp.exp(log.value)
    # A power loses as many eps as its exponent is large.
    size = value * (1 + share * mp.fsum(logs, absolute=True))
    ends = (mp.exp(log.low), mp.exp(log.high))
    return Truth(value, value * log.error, *ends, size, size * log.spread)


def _judge(worst: Worst, found: Interval, exact: Truth, where: str) -> None:
    """Take in the errors of value, standard error and bounds, in eps."""
    judge_one(worst, found.value, exact.value, exact.size, f"value of {where}")
    ends = found.standard_error, found.low, found.high
    if not mp.isfinite(exact.error):
        worst.add(0.0 if np.isnan(ends).all() else math.inf, f"one session, {where}")
    elif found.method.startswith("bootstrap"):
        # Resampled: only that there is one, about the value, can be asked of it.
        off = max(found.low - found.value, found.value - found.high, 0.0)
        judge_one(worst, off, 0, exact.size, f"bootstrap of {where}")
        is_wide = exact.error > 0 and found.standard_error > 0
        worst.add(0.0 if is_wide else math.inf, f"bootstrap of {where}")
    else:
        judge_one(worst, ends[0], exact.error, exact.spread, f"error of {where}")
        for ours, truth in zip(ends[1:], (exact.low, exact.high), strict=True):
            share = max(1, abs(truth / exact.value) if exact.value else 0)
            size = exact.size * share + abs(truth - exact.value)
            judge_one(worst, ours, truth, size, f"bound of {where}")


def judge_one(worst: Worst, ours: float, truth: Any, size: Any, where: str) -> None:
    """Take in how far a number is from the truth, in eps of a size."""
    off = abs(mp.mpf(ours) - truth) if math.isfinite(ours) else mp.inf
    worst.add(float(off / (size or 1)) / EPS if off else 0.0, where)


# --- sessions ---


_Pair = tuple[str, np.ndarray, np.ndarray]


def sessions(rng: _Rng, quick: bool) -> Iterator[_Pair]:
    """MTCD of a technique and of a baseline, code values, by number and kind."""
    for count in COUNTS[:-1] if quick else COUNTS:
        for name, x, y in _pairs(rng, count):
            if count < 1000 or name in _OF_MANY:
                yield f"{count} sessions, {name}", x, y


_OF_MANY = ("equal but for 1e-12", "heavy tails, alike", "some failed")


def _pairs(rng: _Rng, count: int) -> Iterator[_Pair]:
    one, two = rng.standard_normal((2, count))
    body = np.exp(0.5 * one)
    for level in (0.1, 1 / 3, 441.67):
        yield f"all {level:.4g}", np.full(count, 0.7 * level), np.full(count, level)
    near = lambda z: 1 + 1e-12 * z
    yield "equal but for 1e-12", 0.3 * near(one), near(two)
    yield "equal but for 1e-12, alike", 0.3 * near(one), near(one + 0.8 * two)
    yield "1e-8, equal but for 1e-6", 1e-8 * (1 + 1e-6 * one), 1 + 1e-6 * two
    for size in (1e-8, 1e-3, 1.0, 1e6):
        yield f"size {size:g}", size * body, max(size, 1.0) * np.exp(0.5 * two)
    heavy = lambda z: 0.1 + np.exp(3 * z)  # enough for a ratio, however few
    yield "heavy tails", heavy(one), heavy(two)
    yield "heavy tails, alike", heavy(one), heavy(one + 0.03 * two)
    yield "1e6 and a spread of 1e-3", 1e6 + 1e-3 * one, 1e6 + 1e-3 * two
    yield "in proportion", 0.6 * body, body
    yield "opposed", 20 - np.minimum(body, 19), body
    yield "no flicker", 0 * body, body
    if count > 2:
        failed = np.where(rng.random(count) < 0.3, np.nan, 1.0)
        failed[0] = 1.0
        yield "some failed", body * failed, np.exp(0.5 * two) * failed[::-1]


def means(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Errors of `mean_interval`, eps."""
    worst = Worst()
    for name, *pair in sessions(rng, quick):
        for values in pair:
            found = intervals.mean_interval(values, nan_policy="omit")
            _judge(worst, found, _of_mean(values), name)
    return worst.found


def _paired(pairs: Iterator[_Pair], interval: Callable, exact: Callable) -> _Found:
    worst = Worst()
    for name, x, y in pairs:
        _judge(worst, interval(x, y, nan_policy="omit"), exact(x, y), name)
    return worst.found


def ratios(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Errors of `ratio_interval`, eps."""
    return _paired(sessions(rng, quick), intervals.ratio_interval, _of_ratio)


def scenes(rng: _Rng, quick: bool) -> Iterator[_Pair]:
    """Two kinds of sessions, as scenes that share them."""
    pairs = [pair for pair in sessions(rng, quick) if np.nansum(pair[1])]
    for (name, *one), (_, *two) in itertools.pairwise(pairs):
        if one[0].size == two[0].size:
            x, y = (np.stack(rows) for rows in zip(one, two, strict=True))
            yield f"{name}, and the next", x, y


def geometric_means(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Errors of `geometric_mean_ratio` over two scenes, eps."""
    interval = intervals.geometric_mean_ratio
    return _paired(scenes(rng, quick), interval, _of_geometric_mean)


def derivatives(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Errors of `log_ratio_derivative_interval`, eps."""
    worst = Worst()
    for name, x, y in sessions(rng, quick):
        if not (np.isfinite(x + y).all() and x.any()):
            continue
        signs, noise = rng.normal(size=(2, x.size))
        kinds = [
            ("of either sign", x * signs, y * noise),
            ("in proportion", 3 * x, 1e-3 * y),
            ("alike", x + 1e-9 * noise, 1 + 0 * y),
        ]
        for kind, dx, dy in kinds[: 3 if x.size < 1000 else 1]:
            found = intervals.log_ratio_derivative_interval(x, y, dx, dy)
            _judge(worst, found, _of_derivative(x, y, dx, dy), f"{name}, {kind}")
    return worst.found


SESSIONS = (
    "1, 2, 49 to 51, 1e5 sessions of 1e-8 to 1e6; equal, equal but for 1e-12, "
    "lognormal of 3, in proportion, some NaN"
)
SUMMED = {"float64": Bound(16)}
"""A sum of 1e5 is made of 16 additions and 10 halvings: 13 eps, were all to round one
way. Of a standard error that is half, and three for the roots and quotients."""


def runs() -> list[Run]:
    """All of them: none in the quick form, which is of float32."""
    every = [
        ("mean_interval", SESSIONS, means),
        ("ratio_interval", SESSIONS, ratios),
        ("geometric_mean_ratio", f"2 scenes; {SESSIONS}", geometric_means),
        ("log_ratio_derivative_interval", f"of either sign; {SESSIONS}", derivatives),
    ]
    return [
        Run(f"intervals.{name}", over, measure, SUMMED, "eps", is_slow=True)
        for name, over, measure in every
    ]
