"""Monotone curves from (0, 0) to (1, 1): how a share of speed or difference counts.

A curve is a frozen module whose numbers are leaves, so that it can be fitted. Kim et
al. let head speed count by `Kim` (equation 4), colour difference by `Linear` (5).
"""

import abc
import itertools
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jaxtyping import Array, Bool

from . import _checks
from ._types import Numbers, Scalar

_SAMPLES_PER_INTERVAL = 32
_END_WEIGHT = 1e3  # of the end (1, 1) in a least-squares fit, against one sample


class AbstractCurve(eqx.Module):
    """A curve on `[0, 1]` that does not fall, exactly 0 at 0 and exactly 1 at 1."""

    @abc.abstractmethod
    def __call__(self, share: Numbers | Scalar) -> Numbers:
        """Height of the curve, elementwise; `share` lies in `[0, 1]`."""

    @property
    @abc.abstractmethod
    def steepest(self) -> float:
        """Bound of the slope, of a curve whose numbers are known; sizes halos."""

    @property
    def is_valid(self) -> Bool[Array, ""] | bool:
        """Whether its numbers are in range: known only while running inside `jit`."""
        return True


class Linear(AbstractCurve):
    """The straight line.

    **Source:** Kim et al., equation (5), by which a colour difference counts.
    """

    def __call__(self, share: Numbers | Scalar) -> Numbers:
        """Return the share itself."""
        return jnp.asarray(share)

    @property
    def steepest(self) -> float:
        """Slope of the straight line, 1."""
        return 1.0


class Kim(AbstractCurve):
    """Ease curve `((1 - cos(pi s)) / 2)^2`.

    Written as `sin(pi s / 2)^4`, which keeps its digits near 0.

    **Source:** Kim et al., equation (4), by which a head speed counts.
    """

    def __call__(self, share: Numbers | Scalar) -> Numbers:
        """Height of the curve, elementwise."""
        return jnp.sin(jnp.pi / 2 * share) ** 4

    @property
    def steepest(self) -> float:
        """At a share of 2/3: 2.04."""
        return Cosine(2.0).steepest


class Cosine(AbstractCurve):
    """Ease curves `((1 - cos(pi s)) / 2)^exponent`, a power of a half cosine wave.

    - `exponent`: at least 1/2, below which the slope at 0 has no bound. At 2 it is
      `Kim` up to rounding, at 1/2 a quarter of a sine wave.

    Gradients in the share and in the exponent are finite, also at 0 and 1.

    **Errors:** `ValueError` naming the field, the range and the value.

    **Source:** Kim et al., equation (4), with its exponent free.
    """

    exponent: Scalar = eqx.field(converter=_checks.number, default=2.0)

    def __check_init__(self):
        _checks.in_range("exponent", self.exponent, 0.5)

    def __call__(self, share: Numbers | Scalar) -> Numbers:
        """Height of the curve, elementwise."""
        return jnp.sin(jnp.pi / 2 * share) ** (2 * self.exponent)

    @property
    def is_valid(self) -> Bool[Array, ""] | bool:
        """Whether the exponent is in the range above."""
        return (self.exponent >= 0.5) & (self.exponent < math.inf)

    @property
    def steepest(self) -> float:
        """Slope of `sin(pi s / 2)^p` where `sin^2 = (p - 1) / p`."""
        p = 2 * float(self.exponent)
        return float(np.pi / 2 * np.sqrt(p) * (1 - 1 / p) ** ((p - 1) / 2))


class Spline(AbstractCurve):
    """Quadratic I-spline: any curve that does not fall, by how much it rises where.

    The sum over i of `increments[i]` times the integral of the i-th linear B-spline, on
    `len(increments) - 1` equal intervals; the slope is continuous.

    - `increments`: at least 3 numbers of at least 0 with a positive sum, by which they
      are divided: only their ratios count.

    **Errors:** `ValueError` naming the field, the range and the value.

    **Source:** Ramsay, "Monotone Regression Splines in Action", Statistical Science
    3(4), 1988, with M-splines of order 2.
    """

    increments: tuple[Scalar, ...] = eqx.field(converter=_checks.numbers)

    def __check_init__(self):
        if len(self.increments) < 3:
            raise ValueError(
                f"increments must be at least 3 numbers, got {len(self.increments)}."
            )
        for i, increment in enumerate(self.increments):
            _checks.in_range(f"increments[{i}]", increment, 0)
        total = sum(self.increments)
        if not _checks.is_traced(total) and total <= 0:
            raise ValueError(f"increments must have a positive sum, got {total:g}.")

    @classmethod
    def like(cls, curve: AbstractCurve, count: int) -> "Spline":
        """Spline of `count` increments nearest to a curve, by least squares.

        **Errors:** `ValueError` unless `count` is a whole number of at least 3.
        """
        _checks.whole("count", count, 3)
        intervals = count - 1
        share = np.linspace(0, 1, _SAMPLES_PER_INTERVAL * intervals + 1)
        place = np.clip(intervals * share[:, None] - np.arange(intervals), 0, 1)
        # Within an interval one B-spline falls and the next one rises.
        integrals = np.zeros((len(share), count))
        integrals[:, :-1] += place * (2 - place) / 2
        integrals[:, 1:] += place**2 / 2
        integrals[:, [0, -1]] *= 2
        heights = np.asarray(curve(jnp.asarray(share)), float)
        weight = np.where(share == 1, _END_WEIGHT, 1.0)
        increments, _ = scipy.optimize.nnls(
            weight[:, None] * integrals, weight * heights
        )
        return cls(increments / increments.sum())

    def _slopes(self) -> list[Scalar]:
        """Slope at each knot, but for a factor.

        The first and the last B-spline are half as wide, so twice as high.
        """
        first, *inner, last = self.increments
        return [2 * first, *inner, 2 * last]

    def __call__(self, share: Numbers | Scalar) -> Numbers:
        """Height of the curve, elementwise.

        What is gained up to the share, over that and what is left from there: sums of
        what is never negative, so that both ends are exact.
        """
        last = len(self.increments) - 2
        share = jnp.asarray(share)
        gained = left = jnp.zeros_like(share)
        for i, (low, high) in enumerate(itertools.pairwise(self._slopes())):
            # At 0 and 1 nothing is clipped: there the slope is the one inside.
            a = (last + 1) * share - i
            a = jnp.maximum(a, 0) if i > 0 else a
            a = jnp.minimum(a, 1) if i < last else a
            b = 1 - a
            gained = gained + a * ((2 - a) * low + a * high)
            left = left + b * ((2 - b) * high + b * low)
        return gained / (gained + left)

    @property
    def is_valid(self) -> Bool[Array, ""] | bool:
        """Whether the increments are in the range above."""
        total = sum(self.increments)
        found = (total > 0) & (total < math.inf)
        for increment in self.increments:
            found = found & (increment >= 0)
        return found

    @property
    def steepest(self) -> float:
        """Largest slope at a knot: between them it is linear."""
        slopes = np.asarray(self._slopes(), float)
        total = np.sum(np.asarray(self.increments, float))
        return float((len(self.increments) - 1) * np.max(slopes) / total)
