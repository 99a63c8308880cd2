"""The envelope's runs of estimators, in float64 NumPy.

On the sessions of `intervals`, errors counted as there; and whether a ratio is formed
just where a baseline flickers enough.
"""

import math

import numpy as np

from ..estimates import estimate as estimators
from ..estimates import intervals, planning
from ..estimates.estimate import MIN_BASELINE_MTCD, Estimate
from ..estimates.planning import Need
from .intervals import (
    EPS,
    NO_SPREAD,
    SESSIONS,
    SUMMED,
    Mean,
    Truth,
    judge_one,
    scenes,
    sessions,
)
from .measuring import Bound, Run, Worst
from .oracles import mp

_Rng = np.random.Generator
_Found = tuple[float, str]

SLOPES = (0.0, 1e-3, 0.9, 1e6)
"""Of control variates."""


def baselines(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Count wrong answers to whether a baseline flickers enough for a ratio."""
    del dtype
    worst, limit = Worst(), MIN_BASELINE_MTCD
    beside = [np.nextafter(limit, end) for end in (0.0, 1.0)]
    for count in (*range(1, 52), 1000, 100_000)[: 52 if quick else None]:
        body = np.exp(rng.standard_normal(count))
        body /= body.mean()
        for level in (limit, *beside, limit * (1 - 1e-14), limit * (1 + 1e-14)):
            for y in (np.full(count, level), level * body):
                # Of sessions that differ, what rounding could decide is not asked.
                mean = Mean(y).value
                if y.any() and abs(mean / limit - 1) < 8 * EPS and np.ptp(y):
                    continue
                x = 0.5 * y
                has_ratio = [
                    math.isfinite(found.value)
                    for found in (
                        intervals.ratio_interval(x, y),
                        intervals.geometric_mean_ratio(x[None], y[None]),
                        intervals.log_ratio_derivative_interval(x, y, x, y),
                    )
                ]
                means = estimators.mean_of(x), estimators.mean_of(y)
                has_ratio.append(not estimators.ratio(*means).reason)
                wrong = sum(has != (mean > limit) for has in has_ratio)
                worst.add(float(wrong), f"{count} sessions of {level!r}")
    return worst.found


def _of_control(y: np.ndarray, t: np.ndarray, paths: np.ndarray, slope: float) -> Truth:
    """As documented: without a slope predictions do not count."""
    if slope == 0:
        a = Mean(y)
        return Truth.of(a.value, a.size, [1], [a], cut=False)
    known, b = np.isfinite(y) & np.isfinite(t), mp.mpf(slope)
    a, c, there = Mean(y[known]), Mean(t[known]), Mean(paths)
    value = a.value + b * (there.value - c.value)
    size = a.size + b * (there.size + c.size)
    here = Truth.of(value, size, [1, -b], [a, c], cut=False)
    apart = b * mp.sqrt(there.with_(there))
    error, spread = (mp.hypot(of, apart) for of in (here.error, here.spread))
    return Truth(value, error, -mp.inf, mp.inf, size, spread)


def _judge_estimate(worst: Worst, found: Estimate, exact: Truth, where: str) -> None:
    judge_one(worst, found.value, exact.value, exact.size, f"value of {where}")
    error = found.standard_error
    if mp.isfinite(exact.error):
        judge_one(worst, error, exact.error, exact.spread, f"error of {where}")
    else:
        worst.add(0.0 if math.isnan(error) else math.inf, f"one session, {where}")


def controls(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Errors of `mean_of` and `control_variate`, eps."""
    worst = Worst()
    for name, x, y in sessions(rng, quick):
        exact = _of_control(x, x, x[:0], 0.0)
        _judge_estimate(worst, estimators.mean_of(x, nan_policy="omit"), exact, name)
        paths = rng.permutation(y[np.isfinite(y)])
        paths = np.concatenate([paths, paths[:1]])
        for slope in SLOPES if x.size < 1000 else SLOPES[-1:]:
            found = estimators.control_variate(x, y, paths, slope, nan_policy="omit")
            exact = _of_control(x, y, paths, slope)
            _judge_estimate(worst, found, exact, f"{name}, slope {slope:g}")
    return worst.found


def _of_estimates(x: np.ndarray, y: np.ndarray) -> Truth:
    """Geometric mean of ratios of means, paired.

    As documented: a session that failed in one array has no influence there alone.
    """
    a, b = ([Mean(row) for row in of] for of in (x, y))
    share = mp.mpf(1) / len(x)
    logs = [mp.log(one.value / two.value) for one, two in zip(a, b, strict=True)]
    weights = [share / one.value for one in a] + [-share / two.value for two in b]
    log = Truth.of(share * mp.fsum(logs), 0, weights, [*a, *b], cut=False)
    value = mp.exp(log.value)
    size = value * (1 + (len(x) > 1) * share * mp.fsum(logs, absolute=True))
    return Truth(value, value * log.error, -mp.inf, mp.inf, size, size * log.spread)


def paired_estimates(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Errors of `ratio`, `geometric_mean` and `pairing_gain`, eps."""
    worst = Worst()
    for name, xs, ys in scenes(rng, quick):
        if xs.shape[1] == 1:
            continue
        found = []
        for x, y in zip(xs, ys, strict=True):
            means = [estimators.mean_of(of, nan_policy="omit") for of in (x, y)]
            found.append(estimators.ratio(*means))
            exact = _of_estimates(x[None], y[None])
            _judge_estimate(worst, found[-1], exact, name)
            _judge_gain(worst, estimators.pairing_gain(*means), exact, name)
        whole = estimators.geometric_mean(found)
        _judge_estimate(worst, whole, _of_estimates(xs, ys), name)
    return worst.found


def _judge_gain(worst: Worst, gain: float, exact: Truth, where: str) -> None:
    """Take in the error of a pairing's gain, in eps of what its errors lose."""
    if not exact.spread or exact.error <= NO_SPREAD * exact.spread:
        worst.add(0.0 if math.isnan(gain) else math.inf, f"gain of {where}")
        return
    over = exact.spread / exact.error
    judge_one(worst, gain, over**2, 2 * over**2 * max(over, 1), f"gain of {where}")


def sessions_needed(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Excess of what planned sessions leave over what was asked for, eps."""
    del dtype, quick
    worst = Worst()
    for n in range(300):
        needs = [
            Need(*(10 ** rng.uniform(-4, 4, 3)).tolist()) for _ in range(1 + n % 3)
        ]
        if n % 2:
            whole = [float(rng.integers(1, 1000)) for _ in needs]
            needs = [Need(0.1, variance, 0.0) for variance in whole]
        cost = (10 ** rng.uniform(-4, 0, 2)).tolist()
        sessions, paths = planning.sessions_needed(needs, *cost)
        for need in needs:
            error, *variances = (mp.mpf(x) for x in need.__dict__.values())
            left = variances[0] / sessions
            left += variances[1] / paths if variances[1] else 0
            worst.add(max(float(left / error**2 - 1), 0.0) / EPS, f"{needs}, {cost}")
        hardest = max(needs, key=lambda need: need.session_variance / need.error**2)
        has_spare = (sessions - 2) * hardest.error**2 >= hardest.session_variance
        if not paths and has_spare:
            worst.add(math.inf, f"too many for {needs}")
    return worst.found


def looks(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Errors of `interim_level`, eps."""
    worst = Worst()
    for look in range(1, 200):
        asked = mp.mpf("0.025") / mp.mpf(2) ** look
        guess = mp.sqrt(-2 * mp.log(asked))
        excess = lambda x, asked=asked: mp.log(mp.erfc(x / mp.sqrt(2)) / 2 / asked)
        exact = mp.findroot(excess, guess)
        ours = planning.interim_level(look)
        judge_one(worst, ours, exact, exact, f"look {look}")
    return worst.found


def runs() -> list[Run]:
    """All of them: none in the quick form, which is of float32."""
    every = [
        (
            "has a ratio, with those of intervals",
            "1 to 1e5 sessions, baselines an ulp and 1e-14 off 0.05",
            baselines,
            {"float64": Bound(0)},
            "decisions",
        ),
        (
            "control_variate, mean_of",
            f"slopes 0 to 1e6; {SESSIONS}",
            controls,
            SUMMED,
            "eps",
        ),
        (
            "ratio, geometric_mean, pairing_gain",
            f"2 scenes; {SESSIONS}",
            paired_estimates,
            SUMMED,
            "eps",
        ),
        # A variance over a squared error, and a sum of two such: four roundings.
        (
            "sessions_needed",
            "errors and variances of 1e-4 to 1e4",
            sessions_needed,
            {"float64": Bound(4)},
            "eps",
        ),
        # A rational function of the root of a logarithm: some ten roundings.
        ("level_of_look", "looks 1 to 199", looks, {"float64": Bound(8)}, "eps"),
    ]
    return [Run(f"estimators.{each[0]}", *each[1:], is_slow=True) for each in every]
