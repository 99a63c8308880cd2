"""Means, ratios of means and geometric means of ratios, with 95 % intervals.

Intervals are over sessions: each draws a new person and a new path, and scenes are
fixed. Where recorded traces were replayed, the subject is the cluster.

- From 50 sessions on, the interval of a mean is normal, that of a ratio is the delta
  method's. Both use an influence `l_i`, how much session i moves the estimate, and the
  standard error `sd(l) / sqrt(n)`.
- Below, the sessions are resampled (2,000 replicates, fixed seed) and the interval lies
  between percentiles of the replicates, at the levels `Phi(-+ sqrt(n / (n-1)) t)` with
  Student's 97.5 % quantile t of n - 1 degrees of freedom. Percentiles keep to the range
  of the estimate (never below 0), and the levels undo the plain bootstrap's narrowness.
  For lognormal sessions with a coefficient of variation of 0.55, intervals of a mean
  then cover 85, 91, 93, 94 % at 4, 8, 16, 32 sessions, those of a ratio 87, 94, 93,
  94 %; plain percentiles and BCa cover 6 to 8 points less at 4 to 8 sessions, the basic
  bootstrap 8 to 12 less, and BCa at the same levels no more.
- With clusters, subjects are resampled and then each one's windows: slightly wide,
  since the second stage repeats what the first already shows. Fewer than 5 subjects
  cannot show how people differ: the interval is then over windows, and says so.
- Influences of at most 1e-13 of the sessions themselves are rounding: no spread.
- A session that failed is not finite. Who leaves it out chooses so, by `nan_policy`:
  sessions that fail are those of heads that move much, so means without them are less.

**Source:** delta method for ratios: Cochran, "Sampling Techniques", 3rd ed., section
6.3; two-stage resampling: Davison and Hinkley, "Bootstrap Methods and their
Application", section 3.8; levels: Hesterberg, "What Teachers Should Know About the
Bootstrap", The American Statistician 69(4), 2015, the expanded percentile interval.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float, Shaped
from scipy import stats

from .. import _checks

MIN_BASELINE_MTCD = 0.05
"""Code values; a ratio to a baseline that flickers no more than this says nothing."""

POOLED = "all"
"""Scene of the rows that average over all scenes."""

GEOMETRIC_MEAN = "geometric mean"
"""Scene of the rows with the geometric mean of the per-scene ratios."""

NO_FLICKER = "no flicker to remove"
WINDOWS_ONLY = "between these windows only"
NO_SESSION = "no session succeeded"
NO_PAIR = "no session succeeded in both this and the baseline"
NOT_FINITE = "not finite in"

NanPolicy = Literal["propagate", "omit"]
"""What sessions that are not finite make of a mean: NaN, or nothing.

SciPy's words; here infinite ones count as well.
"""

Sessions = Float[np.ndarray, " session"]
Cells = Float[np.ndarray, "scene session"]
Subjects = Shaped[np.ndarray, " session"]

Z95 = float(stats.norm.ppf(0.975))
"""Half-width of a normal 95 % interval, in standard errors."""

_NO_SPREAD = 1e-13
"""Of the sessions' size: what they differ by is rounding, and resampling would only
show that."""

_FEW_SESSIONS = 50
_FEW_SUBJECTS = 5
_REPLICATES = 2000
_SEED = 20260101


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


def centred(
    x: Float[np.ndarray, "*rows session"],
) -> tuple[Float[np.ndarray, "*rows"], Float[np.ndarray, "*rows session"]]:
    """Mean of the finite sessions, and how far each is from it: 0 of the others.

    Both are right to rounding however far the spread lies below the mean: equal
    sessions have exactly their mean. Of no session it is 0.
    """
    known = np.isfinite(x)
    count = np.maximum(known.sum(axis=-1, keepdims=True), 1)
    over = lambda values: np.where(known, values, 0.0).sum(-1, keepdims=True) / count
    mean = over(x)
    mean = mean + over(x - mean)  # what a sum of large numbers had lost
    rest = x - mean  # exact where they are close
    return mean[..., 0], np.where(known, rest - over(rest), 0.0)


def mean_interval(
    x: Sessions,
    clusters: Subjects | None = None,
    *,
    nan_policy: NanPolicy = "propagate",
) -> Interval:
    """Mean over sessions: influence `x_i - mean(x)`.

    **Arguments:**

    - `x`: one value per session.
    - `clusters`: subject of each session, or None if every session is a new person.
    - `nan_policy`: sessions that are not finite make all NaN, or are left out.

    **Returns:** the interval, in the unit of `x`; NaN bounds for a single session.
    """
    x = np.asarray(x, float)[None]
    if failure := _failure(x, nan_policy):
        return _none(failure)
    x, clusters = _finite(x, clusters)
    if x.shape[1] == 0:
        return _none(NO_SESSION)
    (value,), (rest,) = centred(x)
    statistic = lambda means: means[0]
    return _interval(value, rest, np.abs(x[0]), x, statistic, clusters, "normal")


def ratio_interval(
    x: Sessions,
    y: Sessions,
    clusters: Subjects | None = None,
    *,
    nan_policy: NanPolicy = "propagate",
) -> Interval:
    """Ratio of means `R = mean(x) / mean(y)`: influence `(x_i - R y_i) / mean(y)`.

    The residuals are paired, so that what moves both (a restless person) cancels.

    **Arguments:**

    - `x`, `y`: MTCD of a technique and of the baseline in the same sessions, code
      values.
    - `clusters`: subject of each session, or None if every session is a new person.
    - `nan_policy`: sessions where either is not finite make all NaN, or are left out.

    **Returns:** the interval, dimensionless; NaN unless `mean(y)` exceeds
    `MIN_BASELINE_MTCD`.
    """
    data = _paired(x, y)
    if failure := _failure(data, nan_policy):
        return _none(failure)
    data, clusters = _finite(data, clusters)
    if data.size == 0:
        return _none(NO_PAIR)
    (x_mean, y_mean), (dx, dy) = centred(data)
    if not y_mean > MIN_BASELINE_MTCD:
        return _none(NO_FLICKER)
    value = x_mean / y_mean
    # `x - R y`, of what is left without the means, which would cancel.
    influence = (dx - value * dy) / y_mean
    size = (np.abs(data[0]) + np.abs(value * data[1])) / y_mean
    statistic = lambda means: means[0] / means[1]
    return _interval(value, influence, size, data, statistic, clusters, "delta")


def log_ratio_derivative_interval(
    x: Sessions,
    y: Sessions,
    dx: Sessions,
    dy: Sessions,
    *,
    nan_policy: NanPolicy = "propagate",
) -> Interval:
    """Differentiate the logarithm of a ratio of means, `ln(mean(x) / mean(y))`.

    The estimate is `mean(dx) / mean(x) - mean(dy) / mean(y)`; the influence of session
    i on `mean(dx) / mean(x) = D` is `(dx_i - D x_i) / mean(x)`, that on the other
    alike: one residual per session, paired over all four.

    **Arguments:**

    - `x`, `y`: MTCD of a technique and of the baseline in the same sessions, code
      values.
    - `dx`, `dy`: their derivatives with respect to one parameter.
    - `nan_policy`: sessions where any is not finite make all NaN, or are left out.

    **Returns:** the interval, in units of one over the parameter's; NaN unless
    `mean(x)` is positive and `mean(y)` exceeds `MIN_BASELINE_MTCD`.
    """
    data = np.stack([np.asarray(values, float) for values in (x, y, dx, dy)])
    if failure := _failure(data, nan_policy):
        return _none(failure)
    data, _ = _finite(data, None)
    if data.shape[1] == 0:
        return _none(NO_PAIR)
    (x_mean, y_mean, dx_mean, dy_mean), rest = centred(data)
    if not (x_mean > 0 and y_mean > MIN_BASELINE_MTCD):
        return _none(NO_FLICKER)
    of_x, of_y = dx_mean / x_mean, dy_mean / y_mean
    weights = np.array([-of_x / x_mean, of_y / y_mean, 1 / x_mean, -1 / y_mean])
    influence, size = weights @ rest, np.abs(weights) @ np.abs(data)
    statistic = lambda means: means[2] / means[0] - means[3] / means[1]
    return _interval(of_x - of_y, influence, size, data, statistic, None, "delta")


def geometric_mean_ratio(
    x: Cells,
    y: Cells,
    clusters: Subjects | None = None,
    *,
    nan_policy: NanPolicy = "propagate",
) -> Interval:
    """Geometric mean over scenes of `R_s = mean(x_s) / mean(y_s)`.

    Scenes are fixed and share their sessions: the influence of session i on the
    logarithm is the mean over scenes of `(x_si - R_s y_si) / (R_s mean(y_s))`. From 50
    sessions on, the interval is `G exp(-+ 1.96 se)`.

    **Arguments:**

    - `x`, `y`: MTCD of a technique and of the baseline, `(scene, session)`, code
      values.
    - `clusters`: subject of each session, or None if every session is a new person.
    - `nan_policy`: sessions where either is not finite in any scene make all NaN, or
      are left out of the scenes where they are not.

    **Returns:** the interval, dimensionless, over the scenes whose baseline exceeds
    `MIN_BASELINE_MTCD`; 0 if the technique removes all flicker from one of them.
    """
    data = _paired(x, y)
    if failure := _failure(data, nan_policy):
        return _none(failure)
    x, y = data
    both = np.isfinite(x) & np.isfinite(y)
    (x_mean, y_mean), (dx, dy) = centred(np.where(both, data, np.nan))
    has_ratio = y_mean > MIN_BASELINE_MTCD
    if not has_ratio.any():
        return _none(NO_FLICKER if both.any() else NO_PAIR)
    seen = both[has_ratio].any(axis=0)
    # A ratio of means is a ratio of sums, to which a session left out adds 0.
    x, y, dx, dy = (
        np.where(both, of, 0.0)[has_ratio][:, seen] for of in (x, y, dx, dy)
    )
    clusters = None if clusters is None else np.asarray(clusters)[seen]
    scenes, ratio = len(x), x_mean[has_ratio] / y_mean[has_ratio]
    if not ratio.all():
        bound = 0.0 if x.shape[1] > 1 else math.nan
        return Interval(0.0, bound, bound, bound, "exact: a scene without any flicker")
    x_mean = x.mean(axis=1, keepdims=True)
    influence = np.mean((dx - ratio[:, None] * dy) / x_mean, axis=0)
    size = np.mean((np.abs(x) + np.abs(ratio[:, None] * y)) / x_mean, axis=0)
    statistic = lambda means: np.mean(np.log(means[:scenes] / means[scenes:]), axis=0)
    log = _interval(
        np.log(ratio).mean(),
        influence,
        size,
        np.concatenate([x, y]),
        statistic,
        clusters,
        "delta of the logarithm",
    )
    value = math.exp(log.value)
    error = value * log.standard_error
    return Interval(value, math.exp(log.low), math.exp(log.high), error, log.method)


def _paired(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    x, y = np.asarray(x, float), np.asarray(y, float)
    if x.shape != y.shape:
        raise ValueError(f"x and y must have one shape, got {x.shape} and {y.shape}.")
    return np.stack([x, y])


def _failure(data: np.ndarray, nan_policy: NanPolicy) -> str:
    """Say how many sessions (last axis) are not finite, if that is to make all NaN."""
    _checks.one_of("nan_policy", nan_policy, get_args(NanPolicy))
    is_good = np.isfinite(data).all(axis=tuple(range(data.ndim - 1)))
    if nan_policy == "omit" or is_good.all():
        return ""
    return f"{NOT_FINITE} {np.sum(~is_good)} of {is_good.size} sessions"


def _finite(
    data: np.ndarray, clusters: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray | None]:
    """Keep the sessions (last axis) that are finite in every row."""
    keep = np.isfinite(data).all(axis=0)
    return data[:, keep], None if clusters is None else np.asarray(clusters)[keep]


def _none(reason: str) -> Interval:
    return Interval(math.nan, math.nan, math.nan, math.nan, reason)


def _interval(
    value: float,
    influence: np.ndarray,
    size: np.ndarray,
    data: np.ndarray,
    statistic: Callable[[np.ndarray], np.ndarray],
    clusters: np.ndarray | None,
    asymptotic: str,
) -> Interval:
    """Interval of `statistic(means of data over sessions)`, as the module describes.

    **Arguments:** `size`: of the terms that each influence is a difference of.
    """
    value, count = float(value), influence.size
    suffix = f", {count} session" + "s" * (count > 1)
    subjects = None if clusters is None else np.unique(clusters)
    if subjects is not None and len(subjects) < _FEW_SUBJECTS:
        suffix += f" of {len(subjects)} subject" + "s" * (len(subjects) > 1)
        suffix, subjects = f"{suffix}: {WINDOWS_ONLY}", None
    if count == 1:
        return Interval(value, math.nan, math.nan, math.nan, f"no interval{suffix}")
    if np.abs(influence).max() <= _NO_SPREAD * size.max():
        return Interval(value, value, value, 0.0, f"no spread{suffix}")
    if subjects is None and count >= _FEW_SESSIONS:
        error = float(np.std(influence, ddof=1)) / math.sqrt(count)
        step = Z95 * error
        return Interval(value, value - step, value + step, error, asymptotic + suffix)
    if subjects is None or clusters is None:
        units, weights = count, _weights(count, None)
    else:
        units, index = len(subjects), np.searchsorted(subjects, clusters)
        weights = _weights(count, index.astype(np.int64).tobytes())
        suffix += f" of {units} subjects, both resampled"
    # Sessions without any flicker can leave a replicate that has no ratio.
    with np.errstate(divide="ignore", invalid="ignore"):
        replicates = statistic(data @ weights / weights.sum(axis=0))
    replicates = replicates[np.isfinite(replicates)]
    quantile = math.sqrt(units / (units - 1)) * stats.t.ppf(0.975, units - 1)
    low, high = np.quantile(replicates, stats.norm.cdf([-quantile, quantile]))
    error = float(np.std(replicates, ddof=1))
    return Interval(value, float(low), float(high), error, f"bootstrap{suffix}")


@functools.lru_cache(maxsize=2)
def _weights(count: int, clusters: bytes | None) -> np.ndarray:
    """How often each session is drawn in each replicate, `(session, replicate)`.

    One seed: cells with the same sessions are resampled alike.
    """
    rng = np.random.default_rng(_SEED)
    if clusters is None:
        drawn = rng.multinomial(count, np.full(count, 1 / count), size=_REPLICATES)
        return drawn.T.astype(float)
    index = np.frombuffer(clusters, dtype=np.int64)
    units = int(index.max()) + 1
    times = rng.multinomial(units, np.full(units, 1 / units), size=_REPLICATES)
    weights = np.zeros((count, _REPLICATES))
    for unit in range(units):
        windows = np.flatnonzero(index == unit)
        share = np.full(len(windows), 1 / len(windows))
        # A subject drawn k times: k draws of its number of windows, in one.
        drawn = rng.multinomial(times[:, unit] * len(windows), share)
        weights[windows] = drawn.T
    return weights
