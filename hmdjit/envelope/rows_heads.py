"""The envelope's rows of head motion, and of searches within bounds.

What is asked of float32 is asked of float64, in its eps: the laws are sums of positive
terms, so that digits are lost to rounding alone.
"""

import math
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..curve_fitting import CurveSpace
from ..curve_fitting.space import FAMILIES, LOCALIZATIONS
from ..head_fitting import whittle
from ..head_motion import HeadMotion
from ..head_motion.discretisation import discretise
from ..head_motion.parameters import Amplitude, Resonator
from . import arguments as of
from . import exact_heads as exact
from .row import Argument, Inputs, Rng, Row, eps, one, own_size

_of_law = partial(Row, slope_unit=own_size, count=69)


# --- ranges ---


def _draw_wander(rng: Rng, dtype: np.dtype, n: int) -> tuple[float, float, float]:
    if n < 49:
        return 10 ** rng.uniform(-4, 2), of.TIMES_S[n % 7], of.TIMES_S[n // 7]
    return 1.0, *(10 ** rng.uniform(-6, 6, 2)).tolist()


def _draw_mode(rng: Rng, dtype: np.dtype, n: int) -> tuple[float, float, float]:
    damping = (0.02, 0.05, 0.3, 1.0, 1.2, 2.0)[n % 6]
    return 10 ** rng.uniform(-4, 2), 10 ** rng.uniform(-1, 2), damping


def _bursts(rng: Rng, dtype: np.dtype, n: int) -> tuple[float, ...]:
    """Wander, or rest; a tracker that is silent, quiet, or louder than the turns."""
    speed, time, back = _draw_wander(rng, dtype, 2 * n)
    noise = (0.0, 1e-3, 1.0)[n % 3] * speed / 60
    sd = (0.4, 0.0, 1e-6, 1.0)[n % 4]
    bursts = (0.4, 1e-6, 1e6, 10 ** rng.uniform(-6, 6))[n // 4 % 4]
    return speed * (n % 10 != 9), time, back, noise, sd, bursts


def _stiff(rng: Rng, dtype: np.dtype, n: int) -> tuple[np.ndarray, float]:
    if n % 2:
        low, high = np.sort(10 ** rng.uniform(-6, 6, 2))
        return np.array([[-low, high], [0.0, -high]]), 2 * high
    # A mode rings on for 1 / damping radians: longer ones lose more.
    w, z = 10 ** rng.uniform(-2, 3), rng.choice([0.05, 0.3, 1.0, 2.0])
    return np.array([[0.0, w], [-w, -2 * z * w]]), 4 * z * w


_WANDER = Argument("times 1e-6 to 1e6 s either way round", _draw_wander)
_MODE = Argument("0.1 to 100 Hz, damping 0.02 to 2", _draw_mode)
_BURSTS = Argument("times 1e-6 to 1e6 s, bursts of 0 to 1; at rest", _bursts)
_STIFF = Argument("wander and modes, |drift| dt to 1e12", _stiff)
_FRAMES = Argument("lags 0 to 10", lambda rng, dtype, n: np.int32((0, 1, 2, 10)[n % 4]))
_SAMPLED = Argument(
    "0 Hz to half the rate, 1 to 10,000 Hz",
    lambda rng, dtype, n: (
        (0.0, 1e-6, 1.0, rng.random(), 10 ** rng.uniform(-4, 0))[n % 5]
        * of.RATES_HZ[n // 5 % 5]
        / 2,
        of.RATES_HZ[n // 5 % 5],
    ),
)
_LOG_BOUNDS = Argument(
    "1.6 to 1000 Hz",
    lambda rng, dtype, n: whittle.log_bounds(1, (1.6, 30.0, 90.0, 1000.0)[n % 4]),
)
_LAG = of.logarithmic("lags 0, 1e-6 to 1e6 s", 0.0, low=1e-6, high=1e6)
_SHORT_LAG = of.logarithmic("lags 0, 1e-4 to 10 s", 0.0, low=1e-4, high=10)
_STEP = of.logarithmic("steps 1e-6 to 1e6 s", low=1e-6, high=1e6)
_NYQUIST = (rate / 2 for rate in of.RATES_HZ)
_FREQUENCY = of.logarithmic("0 to 5000 Hz", 0.0, *_NYQUIST, low=1e-4, high=5e3)


def _coordinates(shape: int | tuple[int, ...]) -> Argument:
    """Coordinates of a search: all at an extreme, one of them, and a random mix."""
    spread = [x for x in of.COORDINATES if abs(x) != 46]  # where they stop to count

    def draw(rng: Rng, dtype: np.dtype, n: int) -> np.ndarray:
        extreme, place = of.COORDINATES[n // 3 % 15], n // 3 % np.prod(shape)
        alone = rng.normal(size=shape)
        alone.flat[place] = extreme
        return (np.full(shape, extreme), alone, rng.choice(spread, shape))[n % 3]

    return Argument("coordinates 0, 1e-9 to 700, infinite", draw)


# --- heads ---


def _wander(
    speed: Any, time: Any, back: Any, *others: Any, noise: Any = 0
) -> HeadMotion:
    noise = noise + 0 * speed
    return HeadMotion((speed,) * 3, (time,) * 3, (noise,) * 3, back, 0.0, *others)


def _mode(speed: Any, frequency: Any, damping: Any) -> HeadMotion:
    mode = Resonator((speed,) * 3, (frequency,) * 3, (damping,) * 3)
    return _wander(0 * speed, 1 + 0 * speed, 15 + 0 * speed, (mode,))


def _law(name: str, kind: str, *given: Any, **options: Any) -> Row:
    """Row of a law of a head of three numbers, at a lag or frequency."""
    head = {"wander": _wander, "mode": _mode}[kind]
    of_numbers = lambda a, b, c, *at: getattr(head(a, b, c), name)(*at)[0]
    exact_head = getattr(exact.Exponentials, kind)
    oracle = lambda a, b, c, *at: getattr(exact_head(a, b, c), name)(*at)
    return _of_law(
        of_numbers, oracle, *given, name=f"HeadMotion.{name}, {kind}", **options
    )


def _turn(speed: Any, time: Any, back: Any, lag: Any) -> float:
    """About the turn within a lag."""
    return float(speed * min(1.0, math.sqrt(back / time)) * min(time, back, lag))


def _turn_is_seen(speed: Any, time: Any, back: Any, lag: Any) -> bool:
    # Smaller turns have squares, or slopes of them, that are denormal in float32.
    return not lag or _turn(speed, time, back, lag) > 1e-15


def _step_is_seen(speed: Any, time: Any, back: Any, *others: Any) -> bool:
    return _turn(speed, time, back, 1 / others[-1]) > 1e-17


def _or_time(arguments: Inputs, index: int) -> float:
    """At lag 0, where the slope of the covariance is 0."""
    return own_size(arguments, index) or float(min(arguments[1], arguments[2]))


def _discretised(drift: Any, power: Any, dt: Any) -> Any:
    noise = jnp.zeros((2, 2), drift.dtype).at[1, 1].set(power)
    return jnp.concatenate([part.ravel() for part in discretise(drift, noise, dt)])


def _rms(speed: Any, time: Any, back: Any, rate: Any) -> Any:
    return _wander(speed, time, back).increment_rms_deg(rate)


def _kurtosis(
    speed: Any, time: Any, back: Any, noise: Any, sd: Any, bursts: Any
) -> Any:
    head = _wander(speed, time, back, (), Amplitude(sd, bursts), noise=noise)
    return head.increment_kurtosis(60.0, memory_s=8 / 60)[0]


_LAGGED, _RINGING = [_WANDER, _LAG], [_MODE, _SHORT_LAG]
_covariance, _structure = (
    partial(_law, x) for x in ("covariance", "structure_function")
)
_spectrum = partial(_law, "velocity_spectrum")

HEADS = [
    _of_law(
        _discretised,
        exact.transition,
        [_STIFF, _STEP],
        eps(32, 128),
        name="head_motion.discretisation.discretise",
    ),
    _covariance("wander", _LAGGED, eps(32, 1e3), slope_unit=_or_time, quick=0),
    _structure("wander", _LAGGED, eps(32, 64), kept=_turn_is_seen),
    _spectrum("wander", [_WANDER, _FREQUENCY], eps(16, 32)),
    # A mode keeps its phase over hundreds of radians, by which its slopes are larger.
    _covariance("mode", _RINGING, eps(32, 1e3), quick=0),
    _structure("mode", _RINGING, eps(32, 1e3), quick=0),
    _spectrum("mode", [_MODE, _FREQUENCY], eps(16, 32)),
    _law(
        "increment_covariance",
        "wander",
        [_WANDER, _FRAMES, of.RATE],
        eps(32, 64),
        kept=_step_is_seen,
        quick=0,
    ),
    _law(
        "sampled_velocity_spectrum",
        "wander",
        [_WANDER, _SAMPLED],
        eps(64, 128),
        floor=1e-30,
    ),
    _of_law(
        _rms,
        exact.increment_rms,
        [_WANDER, of.RATE],
        eps(16, 32),
        name="HeadMotion.increment_rms_deg",
        kept=_step_is_seen,
        quick=0,
    ),
    _of_law(
        _kurtosis,
        exact.increment_kurtosis,
        [_BURSTS],
        eps(32, 64),
        name="HeadMotion.increment_kurtosis",
        floor=1e-12,
        count=35,
        quick=0,
    ),
]

# --- searches within bounds ---


def _log_values(logits: Any, log_bounds: Any) -> Any:
    one = jnp.ones(1, logits.dtype)
    power, leakage = (jnp.ones((1, 1, n), logits.dtype) for n in (3, 1))
    data = whittle.Data(
        power, one, leakage, jnp.zeros(1, int), one, one[0], log_bounds, one[0]
    )
    return whittle.log_values(whittle.Search(logits, one), data)


def _at_end(point: np.ndarray) -> bool:
    return bool(np.any(np.abs(point) == exact.FARTHEST))


def _numbers(space: CurveSpace, quick: int = 0) -> Row:
    kind = f"{space.family}, {space.localization}, {space.samples}"
    # Differences of up to 92, and logarithms of up to 44, are rounded by half an eps of
    # that, which an exponential is off by; besides it some ten roundings.
    return Row(
        space.natural,
        partial(exact.natural, space),
        [_coordinates(space.size)],
        eps(64, 64),
        name=f"CurveSpace.natural ({kind})",
        slope_unit=one,
        kink=_at_end,
        quick=quick,
    )


SEARCHES = [
    Row(
        _log_values,
        exact.log_values,
        [_coordinates((6, 3)), _LOG_BOUNDS],
        eps(4, 4),  # a sigmoid, a product and a sum
        name="head_fitting.whittle.log_values",
        slope_unit=one,
        wrt=(0,),
        count=45,
    ),
    _numbers(CurveSpace(), quick=24),
    *(_numbers(CurveSpace(f, 4, kind)) for f in FAMILIES for kind in LOCALIZATIONS),
]
