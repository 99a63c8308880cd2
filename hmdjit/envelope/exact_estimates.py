"""Exact means, ratios and their standard errors in many digits, by their definitions.

An error counts by what it is rounded from: a value's by the means that it is made of, a
standard error's by what it would be were nothing paired, a bound's by value and
half-width together. So a spread must keep its digits however far below the mean it is.
"""

import dataclasses
import itertools
import math
from typing import Any

import numpy as np

from .row import Sized, mp

_NO_SPREAD = 1e-13  # documented: of the sessions' size, what counts as no spread
_FEWEST = 50  # documented: of fewer sessions, intervals are resampled
_Values = np.ndarray


class Mean:
    """Mean of the known sessions, and its covariances."""

    def __init__(self, values: _Values):
        self.values, self.known = values, np.isfinite(values)
        self.numbers = self.of(self.known)
        self.count = len(self.numbers)
        self.value = mp.fsum(self.numbers) / self.count
        self.size = mp.fsum(self.numbers, absolute=True) / self.count

    def of(self, known: _Values) -> list:
        """Return the sessions that are known."""
        return [mp.mpf(x) for x in self.values[known].tolist()]

    def with_(self, other: "Mean") -> Any:
        """Covariance of both means over the sessions that both know."""
        a, b = self.numbers, other.numbers
        if not np.array_equal(self.known, other.known):
            a, b = (one.of(self.known & other.known) for one in (self, other))
        total = mp.fdot(zip(a, b, strict=True)) + len(a) * self.value * other.value
        total -= self.value * mp.fsum(b) + other.value * mp.fsum(a)
        units = (one.count * (one.count - 1) for one in (self, other))
        return total / mp.sqrt(mp.fprod(units))


@dataclasses.dataclass(frozen=True)
class Truth:
    """An estimate, and what its parts are rounded from.

    - `value`, `error`: the estimate and its standard error; NaN of one session.
    - `size`: of the terms of the value.
    - `spread`: the standard error, were nothing paired.
    - `count`: sessions.
    """

    value: Any
    error: Any
    size: Any
    spread: Any
    count: int

    @classmethod
    def of(
        cls,
        value: Any,
        size: Any,
        weights: list,
        means: list[Mean],
        *,
        cut: bool = True,
    ) -> "Truth":
        """Return an estimate that moves by weights with the means of sessions.

        **Arguments:** `cut`: whether what is rounding, as documented, is no spread.
        """
        count = min(mean.count for mean in means)
        if count == 1:
            return cls(value, mp.nan, size, mp.inf, count)
        terms = list(zip(weights, means, strict=True))
        own = mp.fsum(w**2 * a.with_(a) for w, a in terms)
        pairs = itertools.combinations(terms, 2)
        shared = 2 * mp.fsum(v * w * a.with_(b) for (v, a), (w, b) in pairs)
        error = mp.sqrt(abs(own + shared))
        if cut:
            largest = np.max(sum(abs(float(w)) * np.abs(a.values) for w, a in terms))
            is_spread = error * math.sqrt(means[0].count - 1) > _NO_SPREAD * largest
            error = error if is_spread else mp.mpf(0)
        return cls(value, error, size, mp.sqrt(own), count)

    def exp(self) -> "Truth":
        """Exponential: a power loses as many eps as its exponent is large."""
        value = mp.exp(self.value)
        size = value * (1 + self.size)
        return Truth(value, value * self.error, size, size * self.spread, self.count)

    def estimate(self) -> Sized:
        """Value and standard error."""
        return Sized([self.value, self.error], [self.size or 1, self.spread or 1])

    def pairing_gain(self) -> Sized:
        """How much less variance pairing leaves, which counts by what that loses."""
        if not self.spread or self.error <= _NO_SPREAD * self.spread:
            return Sized([mp.nan], [1])
        over = self.spread / self.error
        return Sized([over**2], [2 * over**2 * max(over, 1)])

    def interval(self, logs: "Truth | None" = None) -> Sized:
        """Value, standard error and bounds, which are symmetric or so in logarithms."""
        if self.count < _FEWEST and self.error > 0:
            # Resampled: only that there is one, about the value, can be asked of it.
            size = self.size or 1
            return Sized([self.value, 1, 0, 0], [size, 1, size, size])
        values, sizes = self.estimate()
        step = mp.sqrt(2) * mp.erfinv(mp.mpf("0.95")) * (logs or self).error
        for move in (-step, step):
            end = mp.exp(logs.value + move) if logs else self.value + move
            share = max(1, abs(end / self.value) if self.value else 0)
            size = self.size * share + abs(end - self.value)
            values, sizes = [*values, end], [*sizes, size if size > 0 else 1]
        return Sized(values, sizes)


def mean(values: _Values, *, cut: bool = True) -> Truth:
    """Mean of the known sessions."""
    x = Mean(values[np.isfinite(values)] if cut else values)
    return Truth.of(x.value, x.size, [1], [x], cut=cut)


def ratio(x: _Values, y: _Values) -> Truth:
    """Ratio of the means of the sessions that both know."""
    a, b = (Mean(values[np.isfinite(x + y)]) for values in (x, y))
    value = a.value / b.value
    return Truth.of(value, value, [1 / b.value, -value / b.value], [a, b])


def log_ratio_derivative(x: _Values, y: _Values, dx: _Values, dy: _Values) -> Truth:
    """Return the derivative of a ratio's logarithm, by derivatives of sessions."""
    a, b, da, db = means = [Mean(values) for values in (x, y, dx, dy)]
    up, down = da.value / a.value, db.value / b.value
    weights = [-up / a.value, down / b.value, 1 / a.value, -1 / b.value]
    return Truth.of(up - down, da.size / a.value + db.size / b.value, weights, means)


def log_of_ratios(x: _Values, y: _Values, *, cut: bool) -> Truth:
    """Mean logarithm of ratios of means, scene by scene."""
    a, b = ([Mean(row) for row in of] for of in (x, y))
    share = mp.mpf(1) / len(x)
    logs = [mp.log(one.value / two.value) for one, two in zip(a, b, strict=True)]
    weights = [share / one.value for one in a] + [-share / two.value for two in b]
    # Of one ratio the logarithm is not formed.
    size = share * mp.fsum(logs, absolute=True) if cut or len(x) > 1 else mp.mpf(0)
    return Truth.of(share * mp.fsum(logs), size, weights, [*a, *b], cut=cut)


def control_variate(y: _Values, t: _Values, paths: _Values, slope: Any) -> Truth:
    """Mean with a control variate; without a slope predictions do not count."""
    if slope == 0:
        return mean(y, cut=False)
    known, b = np.isfinite(y) & np.isfinite(t), mp.mpf(float(slope))
    a, c, there = Mean(y[known]), Mean(t[known]), Mean(paths)
    size = a.size + b * (there.size + c.size)
    value = a.value + b * (there.value - c.value)
    here = Truth.of(value, size, [1, -b], [a, c], cut=False)
    apart = b * mp.sqrt(there.with_(there)) if here.count > 1 else 0
    error, spread = (mp.hypot(of, apart) for of in (here.error, here.spread))
    return Truth(value, error, size, spread, here.count)


def level_of_look(look: int) -> list:
    """Half-width of an interval that errs with probability `0.05 / 2^look`."""
    asked = mp.mpf("0.025") / mp.mpf(2) ** look
    excess = lambda x: mp.log(mp.erfc(x / mp.sqrt(2)) / 2 / asked)
    return [mp.findroot(excess, mp.sqrt(-2 * mp.log(asked)))]
