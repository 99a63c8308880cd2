"""Estimates of MTCD from few simulated sessions, and how many sessions they need.

A study's mean is over sessions and over the tiles of the frame. Three ways to it, in
the order of their work for one precision; a pilot chooses between the last two:

- *whole frame*: every pixel of every session; only sessions vary.
- *tiles*: a tile or two per session. A session's tiles say nearly the same of its head
  as all of them do, so the same pixels are better spent on more sessions.
- *control variate*: the small-motion theory T (`theory.predict`) of the same tiles is
  known for many more sessions at a two-hundredth of the cost. With simulated sessions i
  of one sample and predicted paths j of another, independent one,
  `mean_i(Y_i - b T_i) + b mean_j(T_j)` has the mean of Y whatever b is, and for
  b = cov(Y, T) / var(T) nearly only the variance that T leaves over. Here b comes from
  a third sample, the pilot, so that nothing is biased.

Techniques share sessions, tiles and paths, hence ratios are *paired*: what moves both
cancels.

An estimate is kept with its *influences*: what each session of each sample adds to its
error. Sums and ratios of estimates then have theirs, whatever sessions they share.

**Source:** control variates with an estimated mean (two-phase sampling): Cochran,
"Sampling Techniques", 3rd ed., chapter 12; ratios by the delta method: section 6.3.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import get_args

import numpy as np
from jaxtyping import Float
from scipy import stats

from .. import _checks
from .intervals import MIN_BASELINE_MTCD, NO_FLICKER, Interval, NanPolicy, centred

FLOOR_MTCD = 0.005
"""Code values; no tolerance is below it, so that a uniform picture terminates."""

_ROUNDING = 1e-13  # of a standard error: what pairing leaves of it is no spread

Sessions = Float[np.ndarray, " session"]
Paths = Float[np.ndarray, " path"]
Influences = Float[np.ndarray, "..."]


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A number and how far each session may have moved it.

    - `value`: what is estimated.
    - `influences`: for each independent sample, what each of its sessions adds.
    """

    value: float
    influences: tuple[Influences, ...]

    @property
    def standard_error(self) -> float:
        """Root of the sum of squared influences."""
        return math.sqrt(sum(float(np.sum(i**2)) for i in self.influences))

    def interval(self, z: float, method: str) -> Interval:
        """Return the normal interval, `z` standard errors to both sides."""
        error = self.standard_error
        step = z * error
        return Interval(self.value, self.value - step, self.value + step, error, method)


def mean_of(values: Sessions, *, nan_policy: NanPolicy = "propagate") -> Estimate:
    """Mean over the sessions of one sample.

    A single session has no known influence: its standard error is NaN.

    **Arguments:** `nan_policy`: sessions that are not finite make all NaN, or are left
    out: they then keep their place, with no influence.
    """
    _checks.one_of("nan_policy", nan_policy, get_args(NanPolicy))
    is_known = np.isfinite(values)
    if nan_policy != "omit" and not is_known.all():
        return Estimate(math.nan, (np.full(len(values), math.nan),))
    count = int(is_known.sum())
    mean, rest = centred(values)
    # As a variance divides by n - 1.
    unit = 1 / math.sqrt(count * (count - 1)) if count > 1 else math.nan
    return Estimate(float(mean) if count else math.nan, (unit * rest,))


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
    if slope == 0 or len(paths) == 0:
        plain = mean_of(simulated, nan_policy=nan_policy)
        return Estimate(plain.value, (*plain.influences, np.zeros(0)))
    known = np.isfinite(simulated) & np.isfinite(predicted)
    y, t = (
        mean_of(np.where(known, x, np.nan), nan_policy=nan_policy)
        for x in (simulated, predicted)
    )
    there = mean_of(paths)
    # Influences are combined: sessions' own differences would lose a small spread.
    here = combined([1.0, -slope], [y, t])
    value = y.value + slope * (there.value - t.value)
    return Estimate(value, (*here.influences, slope * there.influences[0]))


def combined(weights: Sequence[float], estimates: Sequence[Estimate]) -> Estimate:
    """Return a weighted sum; session i of a sample is the same one in all."""
    value = sum(w * e.value for w, e in zip(weights, estimates, strict=True))
    samples = []
    for parts in zip(*(e.influences for e in estimates), strict=True):
        total = np.zeros(max(len(part) for part in parts))
        for weight, part in zip(weights, parts, strict=True):
            total[: len(part)] += weight * part
        samples.append(total)
    return Estimate(value, tuple(samples))


def ratio(x: Estimate, y: Estimate) -> Estimate | None:
    """Ratio of two estimates, paired; None where the baseline does not flicker."""
    if y.value <= MIN_BASELINE_MTCD:
        return None
    value = x.value / y.value
    difference = combined([1 / y.value, -value / y.value], [x, y])
    return dataclasses.replace(difference, value=value)


def pairing_gain(x: Estimate, y: Estimate) -> float:
    """Variance of a ratio with sessions of their own for x and y, over the paired one.

    NaN where there is no ratio, or pairing leaves no variance but of rounding.
    """
    paired = ratio(x, y)
    if paired is None:
        return math.nan
    alone = math.hypot(x.standard_error, paired.value * y.standard_error) / y.value
    if not paired.standard_error > _ROUNDING * alone:
        return math.nan
    return (alone / paired.standard_error) ** 2


def geometric_mean(ratios: Sequence[Estimate]) -> Estimate:
    """Geometric mean of positive ratios."""
    value = math.exp(sum(math.log(r.value) for r in ratios) / len(ratios))
    weights = [value / (len(ratios) * r.value) for r in ratios]
    return dataclasses.replace(combined(weights, ratios), value=value)


def no_ratio() -> Interval:
    """Return what stands for a ratio to a baseline that does not flicker."""
    return Interval(math.nan, math.nan, math.nan, math.nan, NO_FLICKER)


# --- how many sessions ---


@dataclasses.dataclass(frozen=True)
class Need:
    """What one number needs: a standard error, from two samples' variances.

    - `error`: the standard error that is asked for.
    - `session_variance`: of one simulated session's part in it.
    - `path_variance`: of one predicted path's part.
    """

    error: float
    session_variance: float
    path_variance: float


def sessions_needed(
    needs: Sequence[Need], session_seconds: float, path_seconds: float
) -> tuple[int, int]:
    """Sessions to simulate and paths to predict for the least work.

    With r paths for each session a number needs `n = (v + w / r) / e^2` sessions; the r
    that is cheapest for the hardest of all numbers is searched for.

    **Arguments:** seconds per session and per path; path variances of 0 need none.

    **Returns:** `(n, m)`, sessions and paths.
    """
    session = np.array([need.session_variance / need.error**2 for need in needs])
    path = np.array([need.path_variance / need.error**2 for need in needs])
    if not path.any():
        return math.ceil(session.max()), 0
    per_session = np.geomspace(1e-2, 1e4, 241)
    count = np.max(session + path / per_session[:, None], axis=1)
    seconds = count * (session_seconds + per_session * path_seconds)
    best = int(np.argmin(seconds))
    return math.ceil(count[best]), math.ceil(count[best] * per_session[best])


def level_of_look(look: int) -> float:
    """Half-width, in standard errors, of the intervals at a look, counted from 1.

    Look k may err with probability `0.05 / 2^k`: together no more than 5 %, however
    many looks there are (the union bound). The first, which nearly always is the last,
    has 2.24 standard errors where a single one would have 1.96.
    """
    return float(stats.norm.isf(0.025 / 2**look))


def figure_of_merit(estimate: Estimate, seconds: float) -> float:
    """`1 / (relative error^2 x seconds)`, 1/s; NaN where there is no error."""
    relative = estimate.standard_error / abs(estimate.value) if estimate.value else 0.0
    return 1 / (relative**2 * seconds) if relative and seconds else math.nan
