"""Exact means, smooth functions of them and their standard errors, by definition.

An error counts by what it is rounded from: a value's by the means that it is made of, a
standard error's by what it would be were nothing paired, a bound's by value and
half-width together. So a spread must keep its digits however far below the mean it is.
"""

import itertools
import math
from typing import Any, NamedTuple

import numpy as np

from .row import Sized, mp

_NO_SPREAD = 1e-13  # documented: of the sessions' size, what counts as no spread
_FEWEST = 50  # documented: of fewer sessions, intervals are resampled


class Mean:
    """Mean of the known sessions, and its covariances."""

    def __init__(self, values: np.ndarray):
        self.values, self.known = values, np.isfinite(values)
        self.numbers = self.of(self.known)
        self.count = len(self.numbers)
        self.value = mp.fsum(self.numbers) / self.count
        self.size = mp.fsum(self.numbers, absolute=True) / self.count

    def of(self, known: np.ndarray) -> list:
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


class Truth(NamedTuple):
    """An estimate, and what its parts are rounded from.

    - `value`, `error`: the estimate and its standard error; NaN of one session.
    - `size`: of the terms of the value.
    - `spread`: the standard error, were nothing paired.
    - `number`: of sessions.
    """

    value: Any
    error: Any
    size: Any
    spread: Any
    number: int

    @property
    def exp(self) -> "Truth":
        """Exponential: a power loses as many eps as its exponent is large."""
        value = mp.exp(self.value)
        size = value * (1 + self.size)
        return Truth(value, value * self.error, size, size * self.spread, self.number)

    @property
    def estimate(self) -> Sized:
        """Value and standard error."""
        return Sized([self.value, self.error], [self.size or 1, self.spread or 1])


def truth(value: Any, size: Any, weights: Any, means: Any, cut: bool = True) -> Truth:
    """Estimate that moves by weights with means; rounding, if cut, is no spread."""
    count = min(mean.count for mean in means)
    if count == 1:
        return Truth(value, mp.nan, size, mp.inf, count)
    terms = list(zip(weights, means, strict=True))
    own = mp.fsum(w**2 * a.with_(a) for w, a in terms)
    pairs = itertools.combinations(terms, 2)
    shared = 2 * mp.fsum(v * w * a.with_(b) for (v, a), (w, b) in pairs)
    error = mp.sqrt(abs(own + shared))
    if cut:
        largest = np.max(sum(abs(float(w)) * np.abs(a.values) for w, a in terms))
        is_spread = error * math.sqrt(means[0].count - 1) > _NO_SPREAD * largest
        error = error if is_spread else mp.mpf(0)
    return Truth(value, error, size, mp.sqrt(own), count)


def gain(of: Truth) -> Sized:
    """How much less variance pairing leaves, which counts by what that loses."""
    if not of.spread or of.error <= _NO_SPREAD * of.spread:
        return Sized([mp.nan], [1])
    over = of.spread / of.error
    return Sized([over**2], [2 * over**2 * max(over, 1)])


def interval(of: Truth, logs: Truth | None = None) -> Sized:
    """Value, standard error and bounds, which are symmetric or so in logarithms."""
    if of.number < _FEWEST and of.error > 0:
        # Resampled: only that there is one, about the value, can be asked of it.
        size = of.size or 1
        return Sized([of.value, 1, 0, 0], [size, 1, size, size])
    values, sizes = of.estimate
    step = mp.sqrt(2) * mp.erfinv(mp.mpf("0.95")) * (logs or of).error
    for move in (-step, step):
        end = mp.exp(logs.value + move) if logs else of.value + move
        share = max(1, abs(end / of.value) if of.value else 0)
        size = of.size * share + abs(end - of.value)
        values, sizes = [*values, end], [*sizes, size if size > 0 else 1]
    return Sized(values, sizes)
