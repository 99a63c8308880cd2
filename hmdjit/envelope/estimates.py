"""The envelope's rows of intervals and estimates, in float64 NumPy.

Sessions are all equal, equal but for 1e-12, of every size, with heavy tails, failed in
part, and paired so well that a ratio does not vary.
"""

import itertools
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ..estimates import estimate, intervals, planning
from ..estimates.intervals import Interval
from .exact_estimates import Mean, Truth, gain, interval, truth
from .row import Argument, Bound, Rng, Row, Sized, mp

SUMMED = {"float64": Bound(16)}
"""A sum of 1e5 is made of 16 additions and 10 halvings: 13 eps, were all to round one
way. Of a standard error that is half, and three for the roots and quotients."""


# --- sessions ---


def _failed(z: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.exp(z), np.exp(w)
    x[1::3], y[2::4] = np.nan, np.nan
    return x, y


_near = lambda z: 1 + 1e-12 * z
_heavy = lambda z: 0.1 + np.exp(3 * z)  # enough for a ratio, however few
_level = lambda level: lambda z, w: (0 * z + 0.7 * level, 0 * w + level)
_size = lambda x: lambda z, w: (x * np.exp(z / 2), max(x, 1.0) * np.exp(w / 2))
# Of a technique and a baseline, code values, from two normal numbers per session.
_MANY = {
    "equal but for 1e-12": lambda z, w: (0.3 * _near(z), _near(w)),
    "heavy tails, alike": lambda z, w: (_heavy(z), _heavy(z + 0.03 * w)),
    "some failed": _failed,
}
_FEW = {
    "all 0.1": _level(0.1),
    "all 1 / 3": _level(1 / 3),
    "all 441.67": _level(441.67),
    "equal but for 1e-12, alike": lambda z, w: (0.3 * _near(z), _near(z + 0.8 * w)),
    "equal but for 1e-6": lambda z, w: (1e-8 * (1 + 1e-6 * z), 1 + 1e-6 * w),
    **{f"size {size:g}": _size(size) for size in (1e-8, 1e-3, 1.0, 1e6)},
    "heavy tails": lambda z, w: (_heavy(z), _heavy(w)),
    "1e6 and a spread of 1e-3": lambda z, w: (1e6 + 1e-3 * z, 1e6 + 1e-3 * w),
    "in proportion": lambda z, w: (0.6 * np.exp(z / 2), np.exp(z / 2)),
    "opposed": lambda z, w: (20 - np.exp(z / 2).clip(max=19), np.exp(z / 2)),
    **_MANY,
    "no flicker": lambda z, w: (0 * z, np.exp(z / 2)),
}
# Nothing to compare with, either side of the bootstrap, and many.
_EVERY = [(count, kind) for count in (1, 2, 49, 50, 51) for kind in _FEW]
_EVERY += [(100_000, kind) for kind in _MANY]
_OVER = (
    "1, 2, 49 to 51, 1e5 sessions of 1e-8 to 1e6; equal, equal but for 1e-12, "
    "lognormal of 3, in proportion, some NaN"
)


class Sessions(NamedTuple):
    """What sessions measured, and how they were drawn."""

    kind: str
    values: Any  # arrays, one per measure

    def __str__(self) -> str:
        return f"{self.values[0].shape[-1]} sessions, {self.kind}"


def _pair(rng: Rng, dtype: np.dtype, n: int) -> Sessions:
    count, kind = _EVERY[n]
    return Sessions(kind, _FEW[kind](*rng.standard_normal((2, count))))


def _scenes(rng: Rng, dtype: np.dtype, n: int) -> Sessions:
    """Two kinds of the same sessions, which all flicker."""
    count, kind = _EVERY[n]
    numbers = rng.standard_normal((2, count))
    names = list(_MANY if count > 51 else _FEW)
    other = names[names.index(kind) - 1]
    pairs = zip(_FEW[kind](*numbers), _FEW[other](*numbers), strict=True)
    return Sessions(f"{kind}, and {other}", tuple(np.stack(rows) for rows in pairs))


def _with_derivatives(rng: Rng, dtype: np.dtype, n: int) -> Sessions:
    kind, (x, y) = _pair(rng, dtype, n // 3)
    signs, noise = rng.normal(size=(2, x.size))
    name, dx, dy = [
        ("of either sign", x * signs, y * noise),
        ("in proportion", 3 * x, 1e-3 * y),
        ("alike", x + 1e-9 * noise, 1 + 0 * y),
    ][n % 3]
    return Sessions(f"{kind}, {name}", (x, y, dx, dy))


def _with_paths(rng: Rng, dtype: np.dtype, n: int) -> Sessions:
    kind, (x, y) = _pair(rng, dtype, n // 4)
    slope = np.array((0.0, 1e-3, 0.9, 1e6)[n % 4])
    paths = rng.permutation(y[np.isfinite(y)])
    values = x, y, np.append(paths, paths[0]), slope
    return Sessions(f"{kind}, slope {slope:g}", values)


_flickers = lambda s: np.all(np.nansum(s.values[0], axis=-1) > 0)
_is_known = lambda s: _flickers(s) and np.isfinite(sum(s.values[:2])).all()
_has_spread = lambda s: _flickers(s) and s.values[0].shape[1] > 1

# --- exactly, by their definitions ---


def _mean(values: np.ndarray, cut: bool = True) -> Truth:
    x = Mean(values[np.isfinite(values)] if cut else values)
    return truth(x.value, x.size, [1], [x], cut)


def _ratio(x: np.ndarray, y: np.ndarray) -> Truth:
    """Of the sessions that both know."""
    a, b = (Mean(values[np.isfinite(x + y)]) for values in (x, y))
    value = a.value / b.value
    return truth(value, value, [1 / b.value, -value / b.value], [a, b])


def _log_ratio_derivative(*values: np.ndarray) -> Truth:
    a, b, da, db = means = [Mean(x) for x in values]
    up, down = da.value / a.value, db.value / b.value
    weights = [-up / a.value, down / b.value, 1 / a.value, -1 / b.value]
    return truth(up - down, da.size / a.value + db.size / b.value, weights, means)


def _log_of_ratios(x: np.ndarray, y: np.ndarray, cut: bool) -> Truth:
    """Mean logarithm of ratios of means, scene by scene."""
    a, b = ([Mean(row) for row in of] for of in (x, y))
    share = mp.mpf(1) / len(x)
    logs = [mp.log(one.value / two.value) for one, two in zip(a, b, strict=True)]
    weights = [share / one.value for one in a] + [-share / two.value for two in b]
    # Of one ratio the logarithm is not formed.
    size = share * mp.fsum(logs, absolute=True) if cut or len(x) > 1 else mp.mpf(0)
    return truth(share * mp.fsum(logs), size, weights, [*a, *b], cut)


def _controlled(y: Any, t: Any, paths: Any, slope: Any) -> Truth:
    """Without a slope predictions do not count."""
    if slope == 0:
        return _mean(y, cut=False)
    known, b = np.isfinite(y) & np.isfinite(t), mp.mpf(float(slope))
    a, c, there = Mean(y[known]), Mean(t[known]), Mean(paths)
    size = a.size + b * (there.size + c.size)
    value = a.value + b * (there.value - c.value)
    here = truth(value, size, [1, -b], [a, c], cut=False)
    apart = b * mp.sqrt(there.with_(there)) if here.number > 1 else 0
    error, spread = (mp.hypot(of, apart) for of in (here.error, here.spread))
    return Truth(value, error, size, spread, here.number)


def _exact_level(analysis: int) -> list:
    """Half-width of an interval that errs with probability `0.05 / 2^analysis`."""
    asked = mp.mpf("0.025") / mp.mpf(2) ** analysis
    excess = lambda x: mp.log(mp.erfc(x / mp.sqrt(2)) / 2 / asked)
    return [mp.findroot(excess, mp.sqrt(-2 * mp.log(asked)))]


def _joined(answers: Iterable[Sized]) -> Sized:
    each = zip(*answers, strict=True)
    return Sized(*(list(itertools.chain.from_iterable(x)) for x in each))


def _exact_estimates(sessions: Sessions) -> Sized:
    answers = []
    for x, y in zip(*sessions.values, strict=True):
        ratio = _log_of_ratios(x[None], y[None], cut=False).exp
        answers += [ratio.estimate, gain(ratio)]
    whole = _log_of_ratios(*sessions.values, cut=False).exp
    return _joined([*answers, whole.estimate])


def _exact_geometric_mean(sessions: Sessions) -> Sized:
    """As documented: a session that a scene lacks adds 0 to its sums."""
    x, y = sessions.values
    known = np.isfinite(x + y)
    logs = _log_of_ratios(*(np.where(known, z, 0.0) for z in (x, y)), cut=True)
    return interval(logs.exp, logs)


# --- what is measured ---


def _of_interval(found: Interval) -> list[float]:
    value, error, ends = found.value, found.standard_error, [found.low, found.high]
    if not found.method.startswith("bootstrap"):
        return [value, error, *ends]
    beyond = [max(found.low - value, 0.0), max(value - found.high, 0.0)]
    return [value, float(error > 0), *beyond]


_of_estimate = lambda found: [found.value, found.standard_error]


def _estimates(sessions: Sessions) -> list[float]:
    """Ratio and gain of each scene, and the geometric mean over scenes."""
    ratios, found = [], []
    for rows in zip(*sessions.values, strict=True):
        means = [estimate.mean_of(row, nan_policy="omit") for row in rows]
        ratios.append(estimate.ratio(*means))
        found += [*_of_estimate(ratios[-1]), estimate.pairing_gain(*means)]
    return [*found, *_of_estimate(estimate.geometric_mean(ratios))]


def _row(
    name: str, function: Any, oracle: Any, draw: Any, kinds: int = 1, **kept: Any
) -> Row:
    options = {"eager": True, "count": kinds * len(_EVERY), "quick": 0, **kept}
    arguments, named = [Argument(_OVER, draw)], f"estimates.{name}"
    return Row(function, oracle, arguments, SUMMED, name=named, **options)


def _interval(name: str, oracle: Callable, *given: Any, **kept: Any) -> Row:
    of = partial(getattr(intervals, name), nan_policy="omit")
    measured = lambda sessions: _of_interval(of(*sessions.values))
    return _row(f"intervals.{name}", measured, oracle, *given, **kept)


def _means(sessions: Sessions) -> list[float]:
    found = [estimate.mean_of(x, nan_policy="omit") for x in sessions.values]
    return [*_of_estimate(found[0]), *_of_estimate(found[1])]


def _mean_intervals(sessions: Sessions) -> list[float]:
    found = [intervals.mean_interval(x, nan_policy="omit") for x in sessions.values]
    return [*_of_interval(found[0]), *_of_interval(found[1])]


def _control(sessions: Sessions) -> list[float]:
    y, t, paths, slope = sessions.values
    omit: Any = {"nan_policy": "omit"}
    return _of_estimate(estimate.control_variate(y, t, paths, float(slope), **omit))


_exact_intervals = lambda s: _joined(interval(_mean(x)) for x in s.values)
_exact_means = lambda s: _joined(_mean(x, cut=False).estimate for x in s.values)
_exact_ratio = lambda s: interval(_ratio(*s.values))
_exact_slopes = lambda s: interval(_log_ratio_derivative(*s.values))
_exact_control = lambda s: _controlled(*s.values).estimate
_LOGARITHM = "log_ratio_derivative_interval"
_ALL = "estimate.ratio, geometric_mean, pairing_gain"
_LOOKS = Argument("looks 1 to 199", lambda rng, dtype, n: min(5 * n + 1, 199))

ESTIMATES = [
    _row("intervals.mean_interval", _mean_intervals, _exact_intervals, _pair),
    _interval("ratio_interval", _exact_ratio, _pair),
    _interval("geometric_mean_ratio", _exact_geometric_mean, _scenes, kept=_flickers),
    _interval(_LOGARITHM, _exact_slopes, _with_derivatives, 3, kept=_is_known),
    _row("estimate.mean_of", _means, _exact_means, _pair),
    _row("estimate.control_variate", _control, _exact_control, _with_paths, 4),
    _row(_ALL, _estimates, _exact_estimates, _scenes, kept=_has_spread),
    # A rational function of the root of a logarithm: some ten roundings.
    Row(
        lambda look: [planning.interim_level(look)],
        _exact_level,
        [_LOOKS],
        {"float64": Bound(8)},
        name="estimates.planning.interim_level",
        eager=True,
        count=41,
        quick=0,
    ),
]
