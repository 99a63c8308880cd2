"""The envelope's runs of searches within bounds: coordinates to numbers, and back.

Searches go through any real numbers, which stand for the logarithms of a head's numbers
between their bounds, and for a curve's numbers. At 0, beside it, far off and infinite
all must be numbers within their range, with gradients, and right.
"""

import itertools
import math
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..curve_fitting import CurveSpace
from ..curve_fitting.space import FAMILIES, LOCALIZATIONS
from ..head_fitting import whittle
from ..techniques import HeadMovement
from .cases import eps
from .measuring import Run, Worst
from .oracles import mp

_Rng = np.random.Generator
_Found = tuple[float, str]

COORDINATES = (
    *(0.0, 1e-9, -1e-9, 1.0, -1.0, 20.0, -20.0, 46.0, -46.0, 50.0, -50.0),
    *(700.0, -700.0, math.inf, -math.inf),
)
RATES_HZ = (1.6, 30.0, 90.0, 1000.0)

_FARTHEST = 46  # documented: coordinates of curves count no farther
_SMALLEST = 1e-30  # what is smaller counts as this large
SPACES = [
    CurveSpace(),
    *(CurveSpace(f, 4, kind) for f in FAMILIES for kind in LOCALIZATIONS),
]


def _logistic(x: Any) -> Any:
    return 1 / (1 + mp.exp(-x))


def _eps(dtype: str) -> float:
    return float(np.finfo(dtype).eps)


# --- heads ---


def _log_values(logits: Any, log_bounds: Any) -> Any:
    one = jnp.ones(1, logits.dtype)
    power, leakage = (jnp.ones((1, 1, n), logits.dtype) for n in (3, 1))
    data = whittle.Data(
        power, one, leakage, jnp.zeros(1, int), one, one[0], log_bounds, one[0]
    )
    return whittle.log_values(whittle.Search(logits, one), data)


_head_forms = [
    jax.jit(_log_values),
    jax.jit(jax.jacfwd(_log_values)),
    jax.jit(jax.jacrev(_log_values)),
]


def _head_points(rng: _Rng) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    for rate_hz in RATES_HZ:
        log_bounds = whittle.log_bounds(2, rate_hz)
        for x in (*COORDINATES, *rng.uniform(-30, 30, 5)):
            yield np.full((log_bounds.shape[1], 3), x), log_bounds


def head_numbers(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Errors of logarithms of a head's numbers, eps of their larger bound's size."""
    worst = Worst()
    for logits, log_bounds in list(_head_points(rng))[:: 3 if quick else 1]:
        given = [jnp.asarray(x, dtype) for x in (logits, log_bounds)]
        found = np.asarray(_head_forms[0](*given), float)[:, 0]
        low, high = np.asarray(given[1], float)
        x = mp.mpf(float(given[0][0, 0]))
        for ours, a, b in zip(found.tolist(), low.tolist(), high.tolist(), strict=True):
            exact = mp.mpf(a) + (mp.mpf(b) - mp.mpf(a)) * _logistic(x)
            off = abs(mp.mpf(ours) - exact) / max(abs(a), abs(b))
            worst.add(float(off) / _eps(dtype), f"logit {float(x)!r} of {a!r} to {b!r}")
    return worst.found


def head_slopes(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Errors of their gradients, eps of their larger bound's size."""
    worst = Worst()
    for logits, log_bounds in list(_head_points(rng))[:: 3 if quick else 1]:
        given = [jnp.asarray(x, dtype) for x in (logits, log_bounds)]
        x = mp.mpf(float(given[0][0, 0]))
        share, ends = _logistic(x) * _logistic(-x), np.asarray(given[1], float).tolist()
        own = np.eye(logits.size, dtype=bool).reshape(logits.shape * 2)
        for form in _head_forms[1:]:
            found = np.asarray(form(*given), float)
            where = f"logit {float(x)!r} of {log_bounds.tolist()}"
            other = float(np.max(np.abs(found[~own])))
            worst.add(other / _eps(dtype), f"{where}, by another number")
            of_axes = found[own].reshape(logits.shape).tolist()
            for axes, low, high in zip(of_axes, *ends, strict=True):
                exact = (mp.mpf(high) - mp.mpf(low)) * share
                off = max(abs(mp.mpf(ours) - exact) for ours in axes)
                off /= max(abs(low), abs(high))
                worst.add(float(off) / _eps(dtype), where)
    return worst.found


def head_range(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Count numbers of a head beyond their bounds, and gradients that are none."""
    worst = Worst()
    for logits, log_bounds in list(_head_points(rng))[:: 3 if quick else 1]:
        given = [jnp.asarray(x, dtype) for x in (logits, log_bounds)]
        found, *slopes = (np.asarray(form(*given)) for form in _head_forms)
        low, high = np.asarray(given[1])[..., None]
        bad = np.sum(~((found >= low) & (found <= high)))
        bad += sum(np.sum(~np.isfinite(slope)) for slope in slopes)
        worst.add(float(bad), f"logit {float(logits[0, 0])!r} of {log_bounds.tolist()}")
    return worst.found


def head_starts(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Errors of the wander that a search starts from, eps of its logarithms.

    Starts nearer to a bound than a fiftieth of its range are documented to lie there.
    """
    del rng, quick
    worst, kept = Worst(), np.log([0.8, 0.12, 0.004])
    for order, rate_hz in itertools.product(whittle.ORDERS, RATES_HZ):
        log_bounds = whittle.log_bounds(order, rate_hz)
        low, high = log_bounds[:, :3]
        expected = np.clip(kept, low + 0.02 * (high - low), high - 0.02 * (high - low))
        for logits in whittle.start_logits(log_bounds, order):
            given = [jnp.asarray(x, dtype) for x in (logits, log_bounds)]
            found = np.asarray(_log_values(*given), float)[:3]
            off = np.abs(found - expected[:, None]) / np.max(np.abs([low, high]))
            worst.add(float(off.max()) / _eps(dtype), f"order {order}, {rate_hz:g} Hz")
    return worst.found


# --- curves ---


@jax.jit
def _natural(space: CurveSpace, point: Any) -> Any:
    return space.natural(point)


@jax.jit
def _slopes(space: CurveSpace, point: Any) -> Any:
    return jax.jacfwd(space.natural)(point), jax.jacrev(space.natural)(point)


@jax.jit
def _is_valid(space: CurveSpace, point: Any) -> Any:
    return space.technique(point).is_valid


def _spaces(quick: bool) -> list[CurveSpace]:
    return [CurveSpace("power", 4, "spline")] if quick else SPACES


def _points(rng: _Rng, space: CurveSpace, quick: bool) -> Iterator[np.ndarray]:
    """Coordinates at the extremes one by one, all together, and in a random mix."""
    for x in COORDINATES:
        yield np.full(space.size, x)
        for i in range(0 if quick else space.size):
            point = rng.normal(size=space.size)
            point[i] = x
            yield point
    yield from _mixed_points(rng, space)


def _mixed_points(rng: _Rng, space: CurveSpace) -> Iterator[np.ndarray]:
    for n in range(40):
        yield (
            rng.choice(COORDINATES, space.size)
            if n % 2
            else rng.normal(size=space.size)
        )


def _exact_natural(space: CurveSpace, point: list) -> list:
    """Write out the numbers of a point, as documented."""
    left = iter([min(max(x, mp.mpf(-_FARTHEST)), mp.mpf(_FARTHEST)) for x in point])
    take = lambda count: [next(left) for _ in range(count)]

    def simplex(count: int) -> list:
        parts = [mp.exp(x) for x in [*take(count - 1), mp.mpf(0)]]
        return [part / mp.fsum(parts) for part in parts]

    w_min, below, log_h_max = take(3)
    w_min = _logistic(w_min)
    numbers, away = [w_min, w_min * _logistic(below), mp.exp(log_h_max)], mp.mpf(1)
    for step in take(space.samples):
        away *= 1 - _logistic(step)
        numbers.append(1 - away)
    if space.samples > 1:
        weights = list(itertools.accumulate(simplex(space.samples)))
        numbers += [weight / mp.fsum(weights) for weight in weights]
    if space.family == "power":
        numbers.append(mp.mpf(1) / 2 + mp.exp(next(left)))
    numbers += simplex(6) if space.family == "spline" else []
    return numbers + (simplex(4) if space.localization == "spline" else [])


def curve_numbers(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Errors of a curve's numbers, each in eps of its own."""
    worst = Worst()
    for space in _spaces(quick):
        for point in _points(rng, space, quick):
            given = jnp.asarray(point, dtype)
            found = np.asarray(_natural(space, given), float).tolist()
            exact = _exact_natural(space, [mp.mpf(x) for x in given.tolist()])
            for name, ours, truth in zip(space.names, found, exact, strict=True):
                off = abs(mp.mpf(ours) - truth) if math.isfinite(ours) else mp.inf
                off /= max(truth, mp.mpf(_SMALLEST))
                where = f"{name} of {space.family} at {given.tolist()}"
                worst.add(float(off) / _eps(dtype), where)
    return worst.found


def curve_slopes(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Errors of their gradients, in eps of the slope or of the number itself."""
    worst, step = Worst(), mp.mpf(10) ** -60
    for space in _spaces(quick):
        for point in _mixed_points(rng, space):
            given = jnp.asarray(point, dtype)
            at = [mp.mpf(x) for x in given.tolist()]
            size = [abs(x) for x in _exact_natural(space, at)]
            forward, reverse = (np.asarray(x, float) for x in _slopes(space, given))
            for column, x in enumerate(at):
                if abs(x) == _FARTHEST:  # where coordinates stop to count
                    continue
                beside = [
                    _exact_natural(space, [*at[:column], x + h, *at[column + 1 :]])
                    for h in (step, -step)
                ]
                for row, (name, ahead, behind) in enumerate(
                    zip(space.names, *beside, strict=True)
                ):
                    exact = (ahead - behind) / (2 * step)
                    unit = max(abs(exact), size[row], mp.mpf(_SMALLEST))
                    for ours in (forward[row, column], reverse[row, column]):
                        off = abs(mp.mpf(float(ours)) - exact) / unit
                        where = f"{name} of {space.family} at {given.tolist()}"
                        worst.add(float(off) / _eps(dtype), f"{where} by {column}")
    return worst.found


def curve_range(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Count points that are no technique, and gradients that are none."""
    worst = Worst()
    for space in _spaces(quick):
        least, most = space.ranges
        for point in _points(rng, space, quick):
            given = jnp.asarray(point, dtype)
            found = np.asarray(_natural(space, given), float)
            bad = np.sum(~((found >= least) & (found <= most) & np.isfinite(found)))
            bad += not _is_valid(space, given)
            bad += sum(np.sum(~np.isfinite(x)) for x in _slopes(space, given))
            worst.add(float(bad), f"{space.family} at {given.tolist()}")
    return worst.found


def _near_bounds(bound: float, inwards: float) -> list[float]:
    """Return a bound, an ulp inside it, and farther in."""
    inside = float(np.nextafter(bound, bound + inwards))
    return [bound, inside, *(bound + inwards * step for step in (1e-9, 1e-3, 0.01))]


def curve_round_trips(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Farthest that a technique comes back from its place in the space, as documented.

    Of numbers by their share of the range; what lies nearer to a bound than 1e-3 is
    documented to come back from there.
    """
    del rng, quick
    worst, space = Worst(), CurveSpace()
    shares = [*_near_bounds(0.0, 1.0), 0.5, *_near_bounds(1.0, -1.0)]
    speeds = (1e-19, 1e-6, 25.0, 1e19)
    for w_min, share, d in itertools.product(shares, repeat=3):
        speed = speeds[int(1e3 * (w_min + share + d)) % 4]
        technique = HeadMovement(w_min, share * w_min, speed, (d,))
        point = jnp.asarray(space.near(technique), dtype)
        found = np.asarray(_natural(space, point), float)
        back = [found[0], found[1] / found[0], found[2] / speed, found[3]]
        inside = np.clip(
            [w_min, share, 1.0, d], 1e-3, [1 - 1e-3, 1 - 1e-3, 1, 1 - 1e-3]
        )
        # Of nothing there is no share; half of the smallest number is nothing.
        inside[1] = np.clip(share * w_min / w_min if w_min else 0, 1e-3, 1 - 1e-3)
        off = np.max(np.abs(np.array(back) - inside))
        worst.add(float(off) / _eps(dtype), f"{w_min!r}, {share!r}, {speed!r}, {d!r}")
    return worst.found


def runs() -> list[Run]:
    """All of them."""
    over = "coordinates 0, 1e-9 to 700, infinite"
    none, few = eps(0), eps(4)  # a sigmoid, a product and a sum
    # Differences of up to 92, and logarithms of up to 44, are rounded by half an eps of
    # that, which an exponential is off by; besides it some ten roundings.
    powers = eps(64)
    head, curve = "whittle.log_values", "CurveSpace.natural"
    return [
        Run(head, f"{over}; 1.6 to 1000 Hz", head_numbers, few, "eps"),
        Run(f"{head}, gradients", over, head_slopes, few, "eps", is_slow=True),
        Run(f"{head}, range and gradients", over, head_range, none, "numbers"),
        Run("whittle.start_logits", "back to the starts", head_starts, few, "eps"),
        Run(curve, over, curve_numbers, powers, "eps"),
        Run(f"{curve}, gradients", over, curve_slopes, powers, "eps", is_slow=True),
        Run(
            f"{curve}, range and gradients",
            over,
            curve_range,
            none,
            "numbers",
            is_slow=True,
        ),
        Run(
            "CurveSpace.near",
            "back from bounds, an ulp and more inside, h_max 1e-19 to 1e19",
            curve_round_trips,
            powers,
            "eps",
            is_slow=True,
        ),
    ]
