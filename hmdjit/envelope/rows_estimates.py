"""The envelope's rows of intervals and estimates, in float64 NumPy.

Sessions are all equal, equal but for 1e-12, of every size, with heavy tails, failed in
part, and paired so well that a ratio does not vary.
"""

from collections.abc import Callable, Iterable
from functools import partial
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from ..estimates import estimate, intervals, planning
from ..estimates.estimate import Estimate
from ..estimates.intervals import Interval
from . import exact_estimates as exact
from .row import Argument, Bound, Rng, Row, Sized

SUMMED = {"float64": Bound(16)}
"""A sum of 1e5 is made of 16 additions and 10 halvings: 13 eps, were all to round one
way. Of a standard error that is half, and three for the roots and quotients."""


def _near(z: np.ndarray) -> np.ndarray:
    return 1 + 1e-12 * z


def _heavy(z: np.ndarray) -> np.ndarray:
    return 0.1 + np.exp(3 * z)  # enough for a ratio, however few


def _failed(z: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.exp(z), np.exp(w)
    x[1::3], y[2::4] = np.nan, np.nan
    return x, y


def _level(level: float) -> Callable:
    return lambda z, w: (0 * z + 0.7 * level, 0 * w + level)


def _size(size: float) -> Callable:
    return lambda z, w: (size * np.exp(z / 2), max(size, 1.0) * np.exp(w / 2))


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
OVER = (
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
    numbers, names = (
        rng.standard_normal((2, count)),
        list(_MANY if count > 51 else _FEW),
    )
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
    return Sessions(
        f"{kind}, slope {slope:g}", (x, y, np.append(paths, paths[0]), slope)
    )


def _flickers(sessions: Sessions) -> bool:
    return bool(np.all(np.nansum(sessions.values[0], axis=-1) > 0))


def _is_known(sessions: Sessions) -> bool:
    return _flickers(sessions) and bool(np.isfinite(sum(sessions.values[:2])).all())


# --- what is measured ---


def _of_interval(found: Interval) -> list[float]:
    value, error, ends = found.value, found.standard_error, [found.low, found.high]
    if not found.method.startswith("bootstrap"):
        return [value, error, *ends]
    beyond = [max(found.low - value, 0.0), max(value - found.high, 0.0)]
    return [value, float(error > 0), *beyond]


def _of_estimate(found: Estimate) -> list[float]:
    return [found.value, found.standard_error]


def _joined(answers: Iterable[Sized]) -> Sized:
    values, sizes = (list(chain.from_iterable(x)) for x in zip(*answers, strict=True))
    return Sized(values, sizes)


def _mean_of(values: np.ndarray) -> Estimate:
    return estimate.mean_of(values, nan_policy="omit")


def _with_control(y: Any, t: Any, paths: Any, slope: Any) -> Estimate:
    omit: Any = {"nan_policy": "omit"}
    return estimate.control_variate(y, t, paths, float(slope), **omit)


def _estimates(sessions: Sessions) -> list[float]:
    """Ratio and gain of each scene, and the geometric mean over scenes."""
    ratios, found = [], []
    for rows in zip(*sessions.values, strict=True):
        means = [_mean_of(row) for row in rows]
        ratios.append(estimate.ratio(*means))
        found += [*_of_estimate(ratios[-1]), estimate.pairing_gain(*means)]
    return [*found, *_of_estimate(estimate.geometric_mean(ratios))]


def _exact_estimates(sessions: Sessions) -> Sized:
    answers = []
    for x, y in zip(*sessions.values, strict=True):
        ratio = exact.log_of_ratios(x[None], y[None], cut=False).exp()
        answers += [ratio.estimate(), ratio.pairing_gain()]
    whole = exact.log_of_ratios(*sessions.values, cut=False).exp()
    return _joined([*answers, whole.estimate()])


def _exact_geometric_mean(sessions: Sessions) -> Sized:
    """As documented: a session that a scene lacks adds 0 to its sums."""
    x, y = sessions.values
    known = np.isfinite(x + y)
    logs = exact.log_of_ratios(*(np.where(known, z, 0.0) for z in (x, y)), cut=True)
    return logs.exp().interval(logs)


def _row(
    name: str, function: Any, oracle: Any, draw: Any, kinds: int = 1, **kept: Any
) -> Row:
    return Row(
        function,
        oracle,
        [Argument(OVER, draw)],
        SUMMED,
        name=f"estimates.{name}",
        eager=True,
        count=kinds * len(_EVERY),
        quick=0,
        **kept,
    )


def _interval_of(name: str) -> Callable[[Sessions], list[float]]:
    interval = partial(getattr(intervals, name), nan_policy="omit")
    return lambda sessions: _of_interval(interval(*sessions.values))


ESTIMATES = [
    _row(
        "intervals.mean_interval",
        lambda s: [
            number
            for x in s.values
            for number in _of_interval(intervals.mean_interval(x, nan_policy="omit"))
        ],
        lambda s: _joined(exact.mean(x).interval() for x in s.values),
        _pair,
    ),
    _row(
        "intervals.ratio_interval",
        _interval_of("ratio_interval"),
        lambda s: exact.ratio(*s.values).interval(),
        _pair,
    ),
    _row(
        "intervals.geometric_mean_ratio",
        _interval_of("geometric_mean_ratio"),
        _exact_geometric_mean,
        _scenes,
        kept=_flickers,
    ),
    _row(
        "intervals.log_ratio_derivative_interval",
        _interval_of("log_ratio_derivative_interval"),
        lambda s: exact.log_ratio_derivative(*s.values).interval(),
        _with_derivatives,
        3,
        kept=_is_known,
    ),
    _row(
        "estimate.mean_of",
        lambda s: [number for x in s.values for number in _of_estimate(_mean_of(x))],
        lambda s: _joined(exact.mean(x, cut=False).estimate() for x in s.values),
        _pair,
    ),
    _row(
        "estimate.control_variate",
        lambda s: _of_estimate(_with_control(*s.values)),
        lambda s: exact.control_variate(*s.values).estimate(),
        _with_paths,
        4,
    ),
    _row(
        "estimate.ratio, geometric_mean, pairing_gain",
        _estimates,
        _exact_estimates,
        _scenes,
        kept=lambda s: _flickers(s) and s.values[0].shape[1] > 1,
    ),
    # A rational function of the root of a logarithm: some ten roundings.
    Row(
        lambda look: [planning.interim_level(look)],
        exact.level_of_look,
        [Argument("looks 1 to 199", lambda rng, dtype, n: min(5 * n + 1, 199))],
        {"float64": Bound(8)},
        name="estimates.planning.interim_level",
        eager=True,
        count=41,
        quick=0,
    ),
]
