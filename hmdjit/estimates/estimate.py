"""Means over sessions and smooth functions of them, each with its influences.

An estimate is kept with its *influences*: what each session of each independent sample
adds to its error. Sums, ratios and geometric means of estimates then have theirs (the
delta method), whatever sessions they share. Techniques share sessions, tiles and paths,
hence ratios are *paired*: what moves both cancels.

A *control variate* makes a mean out of fewer sessions: the small-motion theory T
(`theory.predict`) of the same tiles is known for many more sessions at a two-hundredth
of the cost. With simulated sessions i of one sample and predicted paths j of another,
independent one, `mean_i(Y_i - b T_i) + b mean_j(T_j)` has the mean of Y whatever b is,
and for b = cov(Y, T) / var(T) nearly only the variance that T leaves over. Here b comes
from a third sample, the pilot, so that nothing is biased.

A session that failed is not finite. Who leaves it out chooses so, by `nan_policy`:
sessions that fail are those of heads that move much, so means without them are less.

**Source:** control variates with an estimated mean (two-phase sampling): Cochran,
"Sampling Techniques", 3rd ed., chapter 12; ratios by the delta method: section 6.3.
"""

import dataclasses
import functools
import itertools
import math
import operator
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple, get_args

import numpy as np
from jaxtyping import Bool, Float

from .. import _checks
from .columns import Paths, Sessions, Subjects, centred, labels, numbers

MIN_BASELINE_MTCD = 0.05
"""Code values; a ratio to a baseline that flickers no more than this says nothing."""

NO_FLICKER = "no flicker to remove"
NO_SESSION = "no session succeeded"
NO_PAIR = "no session succeeded in both this and the baseline"
NOT_FINITE = "not finite in"

NanPolicy = Literal["propagate", "omit"]
"""What sessions that are not finite make of a mean: NaN, or nothing.

SciPy's words; here infinite ones count as well.
"""

_ROUNDING = 1e-13  # of a standard error: what pairing leaves of it is no spread

Influences = Float[np.ndarray, "..."]
Weights = Float[np.ndarray, "session replicate"]
Replicates = Float[np.ndarray, " replicate"]


class Resampling(NamedTuple):
    """How an estimate is made again from sessions that are drawn anew.

    - `drawn`: the sessions that it is made of.
    - `clusters`: subject of each session, or None if every session is a new person.
    - `replicate`: the estimate, from how often each session is drawn.
    """

    drawn: Bool[np.ndarray, " session"]
    clusters: Subjects | None
    replicate: Callable[[Weights], Replicates]


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A number and how far each session may have moved it.

    - `value`: what is estimated; NaN where there is none, and then `reason` says why.
    - `influences`: for each independent sample, what each of its sessions adds.
    - `count`: sessions that it is made of; of a part's, if parts have their own.
    - `size`: of the terms that influences are differences of, which round by it.
    - `resampling`: of the sessions, where there is no other sample.
    - `by_head`: what a standard error of the head's fit adds, beside all sessions.
    """

    value: float
    influences: tuple[Influences, ...] = ()
    count: int = 0
    size: float = 0.0
    resampling: Resampling | None = None
    reason: str = ""
    by_head: float = 0.0

    @property
    def standard_error(self) -> float:
        """Root of the sum of squared influences: of the sessions, given the head."""
        if self.reason:
            return math.nan
        return math.sqrt(sum(float(np.sum(i**2)) for i in self.influences))


def none(reason: str) -> Estimate:
    """Return what stands for an estimate that cannot be made."""
    return Estimate(math.nan, reason=reason)


def mean_of(
    values: Sessions,
    clusters: Subjects | None = None,
    *,
    nan_policy: NanPolicy = "propagate",
    drawn: Bool[np.ndarray, " session"] | None = None,
) -> Estimate:
    """Mean over the sessions of one sample.

    A single session has no known influence: its standard error is NaN.

    **Arguments:**

    - `values`: one per session, along one axis; what a mask hides is not finite.
    - `clusters`: subject of each session, or None if every session is a new person.
    - `nan_policy`: sessions that are not finite make all NaN, or are left out: they
      then keep their place, with no influence.
    - `drawn`: the sessions that were drawn, if more than those that are finite: the
      mean is then one sum over another, to which some sessions add 0.

    **Errors:** `ValueError` for a table of other axes, and for clusters that do not
    name a subject of each session.
    """
    _checks.one_of("nan_policy", nan_policy, get_args(NanPolicy))
    values = numbers("sessions", values)
    if clusters is not None:
        clusters = labels("clusters", clusters, values.size)
    known = np.isfinite(values)
    count, missing = int(known.sum()), int(np.sum(~known))
    if missing and nan_policy == "propagate":
        reason = f"{NOT_FINITE} {missing} of {known.size} sessions"
        return Estimate(math.nan, count=count, reason=reason)
    if count == 0:
        return none(NO_SESSION)
    drawn = known if drawn is None else drawn
    mean, rest = centred(values)
    # As a variance divides by n - 1.
    n = int(drawn.sum())  # at least `count`
    unit = math.sqrt(n / (n - 1)) / count if n > 1 else math.nan
    terms, end = np.where(known, values, 0.0), known.size
    replicate = lambda weights: terms @ weights[:end] / (known @ weights[:end])
    size = unit * float(np.abs(terms).max())
    resampling = Resampling(drawn, clusters, replicate)
    return Estimate(float(mean), (unit * rest,), n, size, resampling)


def paired_means(
    *rows: Sessions,
    clusters: Subjects | None = None,
    nan_policy: NanPolicy = "propagate",
    drawn: Bool[np.ndarray, " session"] | None = None,
) -> list[Estimate]:
    """Mean of each row over the sessions that are finite in all of them.

    **Arguments:** as of `mean_of`.
    """
    data = [numbers("sessions", row) for row in rows]
    if len({row.shape for row in data}) > 1:
        shapes = " and ".join(str(row.shape) for row in data)
        raise ValueError(f"sessions must have one shape, got {shapes}.")
    known = np.isfinite(data).all(axis=0)
    mean = functools.partial(mean_of, nan_policy=nan_policy, drawn=drawn)
    return [mean(np.where(known, row, np.nan), clusters) for row in data]


def control_variate(
    simulated: Sessions,
    predicted: Sessions,
    paths: Paths,
    slope: float,
    *,
    nan_policy: NanPolicy = "propagate",
) -> Estimate:
    """Mean of what is simulated, with a prediction of it as the control variate.

    **Arguments:**

    - `simulated`, `predicted`: of the same sessions and tiles.
    - `paths`: predictions for other, independent paths.
    - `slope`: b, from a pilot; 0 leaves the plain mean over `simulated`.
    - `nan_policy`: of the simulated sessions, as in `mean_of`; paths are finite. Those
      of heads whose sessions are left out stay in: what the slope tells of them, the
      mean still has.
    """
    paths = numbers("paths", paths, ("path",))
    if slope == 0 or len(paths) == 0:
        return mean_of(simulated, nan_policy=nan_policy)
    # Influences are combined: sessions' own differences would lose a small spread.
    y, t = paired_means(simulated, predicted, nan_policy=nan_policy)
    here, there = combined([1.0, -slope], [y, t]), mean_of(paths)
    if here.reason or there.reason:
        return here if here.reason else there
    value = y.value + slope * (there.value - t.value)
    influences = (*here.influences, slope * there.influences[0])
    return Estimate(value, influences, here.count)


def function_of(
    function: Callable, gradient: Sequence[float], estimates: Sequence[Estimate]
) -> Estimate:
    """Smooth function of estimates, by the delta method.

    Session i of a sample is the same one in all of them; a sample that one of them
    lacks did not move that one.

    **Arguments:**

    - `function`: of as many numbers, or arrays of them, as there are estimates.
    - `gradient`: its derivatives at their values.
    """
    count = min(e.count for e in estimates)
    for estimate in estimates:
        if estimate.reason:
            return dataclasses.replace(estimate, count=count)
    samples = itertools.zip_longest(
        *(e.influences for e in estimates), fillvalue=np.zeros(0)
    )
    terms = zip(gradient, estimates, strict=True)
    resampling, known = None, [e.resampling for e in estimates if e.resampling]
    if len(known) == len(estimates):
        replicate = lambda weights: function(*(one.replicate(weights) for one in known))
        drawn = _total([1.0] * len(known), [one.drawn for one in known]) > 0
        clusters = max(known, key=lambda one: one.drawn.size).clusters
        resampling = Resampling(drawn, clusters, replicate)
    return Estimate(
        float(function(*(e.value for e in estimates))),
        tuple(_total(gradient, parts) for parts in samples),
        count,
        sum(abs(weight) * e.size for weight, e in terms),
        resampling,
        by_head=sum(w * e.by_head for w, e in zip(gradient, estimates, strict=True)),
    )


def _total(weights: Sequence[float], parts: Sequence[np.ndarray]) -> np.ndarray:
    """Weighted sum of arrays, each of which may end before the others do."""
    total = np.zeros(max(len(part) for part in parts))
    for weight, part in zip(weights, parts, strict=True):
        total[: len(part)] += weight * part
    return total


def combined(weights: Sequence[float], estimates: Sequence[Estimate]) -> Estimate:
    """Return a weighted sum of estimates, with their correlations."""
    total = lambda *x: sum(w * value for w, value in zip(weights, x, strict=True))
    return function_of(total, weights, estimates)


def ratio(x: Estimate, y: Estimate, *, above: float = MIN_BASELINE_MTCD) -> Estimate:
    """Ratio of two estimates, paired; none where `y` is not above a limit."""
    if NO_SESSION in (x.reason, y.reason):
        return none(NO_PAIR)
    if y.value <= above:
        return none(NO_FLICKER)
    gradient = [1 / y.value, -x.value / y.value / y.value]
    return function_of(operator.truediv, gradient, [x, y])


def pairing_gain(x: Estimate, y: Estimate) -> float:
    """Variance of a ratio with sessions of their own for x and y, over the paired one.

    NaN where there is no ratio, or pairing leaves no variance but of rounding.
    """
    paired = ratio(x, y)
    if paired.reason:
        return math.nan
    alone = math.hypot(x.standard_error, paired.value * y.standard_error) / y.value
    if not paired.standard_error > _ROUNDING * alone:
        return math.nan
    return (alone / paired.standard_error) ** 2


def mean_logarithm(ratios: Sequence[Estimate]) -> Estimate:
    """Mean of the logarithms of positive ratios."""
    gradient = [1 / (len(ratios) * r.value) for r in ratios]
    return function_of(lambda *x: np.mean(np.log(x), axis=0), gradient, ratios)


def geometric_mean(ratios: Sequence[Estimate]) -> Estimate:
    """Geometric mean of positive ratios."""
    log = mean_logarithm(ratios)
    return function_of(np.exp, [math.exp(log.value)], [log])
