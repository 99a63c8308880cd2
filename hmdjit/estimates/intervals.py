"""95 % intervals of estimates: normal, Student's, and by resampling.

Intervals are over sessions: each draws a new person and a new path, and scenes are
fixed. Where recorded traces were replayed, the subject is the cluster.

- From 50 sessions on, the interval is normal, by the estimate's influences.
- Below, the sessions are resampled (2,000 replicates, fixed seed) and the interval lies
  between percentiles of the replicates, at the levels `Phi(-+ sqrt(n / (n-1)) t)` with
  Student's 97.5 % quantile t of n - 1 degrees of freedom. Percentiles keep to the range
  of the estimate (never below 0), and the levels undo the plain bootstrap's narrowness.
  For lognormal sessions with a coefficient of variation of 0.55, intervals of a mean
  then cover 85, 91, 93, 94 % at 4, 8, 16, 32 sessions, those of a ratio 87, 94, 93,
  94 %; plain percentiles and BCa cover 6 to 8 points less at 4 to 8 sessions, the basic
  bootstrap 8 to 12 less, and BCa at the same levels no more.
- With clusters, subjects are resampled and then each one's windows: slightly wide,
  since the second stage repeats what the first already shows. They count as
  `(sum w)^2 / sum w^2` effective ones, with w windows each: as many as they are where
  all have equally many. At 40, 20, 10, 5 effective of 40 subjects, whose means differ
  by a coefficient of variation of 0.53, intervals of a mean cover 94, 94, 95, 98 %
  (taken as 40: 94, 93, 91, 89), those of a ratio 96, 95, 97, 99 %. Fewer than 5 cannot
  show how people differ: the interval is then over windows, and says so.
- Influences of at most 1e-13 of the sessions themselves are rounding: no spread.

**Source:** two-stage resampling: Davison and Hinkley, "Bootstrap Methods and their
Application", section 3.8; levels: Hesterberg, "What Teachers Should Know About the
Bootstrap", The American Statistician 69(4), 2015, the expanded percentile interval.
"""

import dataclasses
import itertools
import math

import numpy as np
from jaxtyping import Float
from scipy import stats

from .columns import Sessions, Subjects, numbers
from .estimate import (
    MIN_BASELINE_MTCD,
    NO_FLICKER,
    NO_PAIR,
    NOT_FINITE,
    Estimate,
    NanPolicy,
    combined,
    mean_logarithm,
    mean_of,
    none,
    paired_means,
    ratio,
)
from .resampling import replicates

Cells = Float[np.ndarray, "scene session"]

Z95 = float(stats.norm.ppf(0.975))
"""Half-width of a normal 95 % interval, in standard errors."""

WINDOWS_ONLY = "between these windows only"

_NO_SPREAD = 1e-13
"""Of the sessions' size: what they differ by is rounding, and resampling would only
show that."""

_FEW_SESSIONS = 50
_FEW_SUBJECTS = 5


@dataclasses.dataclass(frozen=True)
class Interval:
    """An estimate and its 95 % interval; NaN where there is none, and `method` why."""

    value: float
    low: float
    high: float
    standard_error: float
    method: str

    @property
    def half_width(self) -> float:
        """Half the interval's length."""
        return (self.high - self.low) / 2


def normal_interval(estimate: Estimate, z: float, method: str) -> Interval:
    """Return `z` standard errors to both sides."""
    value, error = estimate.value, estimate.standard_error
    step = z * error
    return Interval(value, value - step, value + step, error, estimate.reason or method)


def with_head(found: Interval, estimate: Estimate, clusters: int) -> Interval:
    """Add what the head's own fit may be off by, which no number of sessions lessens.

    It is independent of the sessions: half-widths add as squares do, its own by
    Student's t. With heads fitted to 12 people 23 of 24 intervals of a mean covered, ±
    0.46 where their replay had ± 0.47 (given the head 12, ± 0.19). Ratios also depend
    on how smoothly heads turn, which is not in it: 18 covered, ± 0.014 for ± 0.019.

    **Arguments:** `clusters`: what the head was fitted to, subjects mostly.
    """
    error = abs(estimate.by_head)
    reach = float(stats.t.ppf(0.975, clusters - 1)) * error
    return dataclasses.replace(
        found,
        low=found.value - math.hypot(found.value - found.low, reach),
        high=found.value + math.hypot(found.high - found.value, reach),
        standard_error=math.hypot(found.standard_error, error),
    )


def student_interval(estimate: Estimate) -> Interval:
    """Return as many standard errors as Student's t has, for normal sessions."""
    quantile = float(stats.t.ppf(0.975, max(estimate.count - 1, 0)))
    return normal_interval(estimate, quantile, "Student's t over sessions")


def interval_of(estimate: Estimate, method: str = "delta") -> Interval:
    """Interval as the module describes: normal of many sessions, resampled of few.

    **Arguments:** `method`: what to call the normal one.

    **Returns:** the interval, in the estimate's unit; NaN bounds for a single session.
    """
    value, sample = estimate.value, estimate.resampling
    if sample is None:  # none, or one with control variates, of many sessions
        return normal_interval(estimate, Z95, method)
    count = int(sample.drawn.sum())
    suffix = f", {count} session" + "s" * (count > 1)
    subjects = index = None
    if sample.clusters is not None:
        labels = np.asarray(sample.clusters)[sample.drawn]
        subjects, index = np.unique(labels, return_inverse=True)
        if len(subjects) < _FEW_SUBJECTS:
            suffix += f" of {len(subjects)} subject" + "s" * (len(subjects) > 1)
            suffix, subjects = f"{suffix}: {WINDOWS_ONLY}", None
    if count == 1:
        return Interval(value, math.nan, math.nan, math.nan, f"no interval{suffix}")
    if np.abs(estimate.influences[0]).max() <= _NO_SPREAD * estimate.size:
        return Interval(value, value, value, 0.0, f"no spread{suffix}")
    if subjects is None and count >= _FEW_SESSIONS:
        return normal_interval(estimate, Z95, method + suffix)
    if subjects is None or index is None:
        units, index = float(count), None
    else:
        windows = np.bincount(index)
        units = count**2 / float(np.sum(windows**2))
        index = index.astype(np.int64)
        effective = f" ({units:.3g} effective)" if units < len(subjects) else ""
        suffix += f" of {len(subjects)} subjects{effective}, both resampled"
    found = replicates(sample, index)
    found = found[np.isfinite(found)]
    quantile = math.sqrt(units / (units - 1)) * stats.t.ppf(0.975, units - 1)
    low, high = np.quantile(found, stats.norm.cdf([-quantile, quantile]))
    error = float(np.std(found, ddof=1))
    return Interval(value, float(low), float(high), error, f"bootstrap{suffix}")


def mean_interval(
    x: Sessions,
    clusters: Subjects | None = None,
    *,
    nan_policy: NanPolicy = "propagate",
) -> Interval:
    """Interval of the mean over sessions; arguments as of `mean_of`."""
    return interval_of(mean_of(x, clusters, nan_policy=nan_policy), "normal")


def ratio_interval(
    x: Sessions,
    y: Sessions,
    clusters: Subjects | None = None,
    *,
    nan_policy: NanPolicy = "propagate",
) -> Interval:
    """Interval of a ratio of means, `mean(x) / mean(y)`.

    Sessions are paired, so that what moves both (a restless person) cancels.

    **Arguments:**

    - `x`, `y`: MTCD of a technique and of the baseline in the same sessions, code
      values.
    - `clusters`: subject of each session, or None if every session is a new person.
    - `nan_policy`: sessions where either is not finite make all NaN, or are left out.

    **Returns:** the interval, dimensionless; NaN unless `mean(y)` exceeds
    `MIN_BASELINE_MTCD`.
    """
    means = paired_means(x, y, clusters=clusters, nan_policy=nan_policy)
    return interval_of(ratio(*means))


def log_ratio_derivative_interval(
    x: Sessions,
    y: Sessions,
    dx: Sessions,
    dy: Sessions,
    *,
    nan_policy: NanPolicy = "propagate",
) -> Interval:
    """Differentiate the logarithm of a ratio of means, `ln(mean(x) / mean(y))`.

    The estimate is `mean(dx) / mean(x) - mean(dy) / mean(y)`, paired over all four.

    **Arguments:**

    - `x`, `y`: MTCD of a technique and of the baseline in the same sessions, code
      values.
    - `dx`, `dy`: their derivatives with respect to one parameter.
    - `nan_policy`: sessions where any is not finite make all NaN, or are left out.

    **Returns:** the interval, in units of one over the parameter's; NaN unless
    `mean(x)` is positive and `mean(y)` exceeds `MIN_BASELINE_MTCD`.
    """
    of_x, of_y, of_dx, of_dy = paired_means(x, y, dx, dy, nan_policy=nan_policy)
    parts = [ratio(of_dx, of_x, above=0.0), ratio(of_dy, of_y)]
    return interval_of(combined([1.0, -1.0], parts))


def geometric_mean_ratio(
    x: Cells,
    y: Cells,
    clusters: Subjects | None = None,
    *,
    nan_policy: NanPolicy = "propagate",
) -> Interval:
    """Geometric mean over scenes of `mean(x_s) / mean(y_s)`.

    Scenes are fixed and share their sessions. From 50 sessions on, the interval is
    `G exp(-+ 1.96 se)` with the standard error of the logarithm.

    **Arguments:**

    - `x`, `y`: MTCD of a technique and of the baseline, `(scene, session)`, code
      values.
    - `clusters`: subject of each session, or None if every session is a new person.
    - `nan_policy`: sessions where either is not finite in any scene make all NaN, or
      are left out of the scenes where they are not.

    **Returns:** the interval, dimensionless, over the scenes whose baseline exceeds
    `MIN_BASELINE_MTCD`; 0 if the technique removes all flicker from one of them.
    """
    x, y = (numbers("cells", cells, ("scene", "session")) for cells in (x, y))
    if x.shape != y.shape:
        raise ValueError(f"cells must have one shape, got {x.shape} and {y.shape}.")
    both = np.isfinite(x) & np.isfinite(y)
    failed = int(np.sum(~both.all(axis=0)))
    if failed and nan_policy == "propagate":
        reason = f"{NOT_FINITE} {failed} of {both.shape[1]} sessions"
        return interval_of(none(reason))
    pairs = list(zip(x, y, strict=True))
    below = [paired_means(*pair, nan_policy=nan_policy)[1].value for pair in pairs]
    has_ratio = np.array(below) > MIN_BASELINE_MTCD
    if not has_ratio.any():
        return interval_of(none(NO_FLICKER if both.any() else NO_PAIR))
    # A ratio of means is a ratio of sums, to which a session left out adds 0.
    seen = np.any(both[has_ratio], axis=0)
    ratios = [
        ratio(*paired_means(*pair, clusters=clusters, nan_policy="omit", drawn=seen))
        for pair in itertools.compress(pairs, has_ratio)
    ]
    if any(r.value == 0 for r in ratios):
        bound = 0.0 if seen.sum() > 1 else math.nan
        return Interval(0.0, bound, bound, bound, "exact: a scene without any flicker")
    log = interval_of(mean_logarithm(ratios), "delta of the logarithm")
    value = math.exp(log.value)
    error = value * log.standard_error
    return Interval(value, math.exp(log.low), math.exp(log.high), error, log.method)
