"""The envelope's rows of head motion.

The laws are sums of positive terms, so that digits are lost to rounding alone. Exactly,
the covariance of an angle is a sum of exponentials, and all else follows from it.
"""

from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..head_motion import HeadMotion
from ..head_motion.discretisation import discretise
from ..head_motion.parameters import Amplitude, Resonator
from . import arguments as of
from .engine import Argument, Rng, Row, Sized, eps, mp, own_size, scaled


@partial(Argument, "wander and modes, |drift| dt to 1e12")
def _drift(rng: Rng, dtype: np.dtype, n: int) -> tuple[np.ndarray, float]:
    if n % 2:
        low, high = np.sort(10 ** rng.uniform(-6, 6, 2))
        return np.array([[-low, high], [0.0, -high]]), 2 * high
    # A mode rings on for 1 / damping radians: longer ones lose more.
    w, z = 10 ** rng.uniform(-2, 3), rng.choice([0.05, 0.3, 1.0, 2.0])
    return np.array([[0.0, w], [-w, -2 * z * w]]), 4 * z * w


@partial(Argument, "0 Hz to half the rate, 1 to 10,000 Hz")
def _sampled(rng: Rng, dtype: np.dtype, n: int) -> tuple[float, float]:
    rate = of.RATES_HZ[n // 5 % 5]
    share = (0.0, 1e-6, 1.0, rng.random(), 10 ** rng.uniform(-4, 0))[n % 5]
    return share * rate / 2, rate


_SPEED = of.logarithmic("", within=(1e-4, 100))
_TIME = of.logarithmic("times 1e-6 to 1e6 s", *of.TIMES_S, within=(1e-6, 1e6))
_HERTZ = of.logarithmic("0.1 to 100 Hz", within=(0.1, 100))
_DAMPING = of.numbers("damping 0.02 to 2", 0.02, 0.05, 0.3, 1.0, 1.2, 2.0)
_WANDER, _MODE = [_SPEED, _TIME, _TIME], [_SPEED, _HERTZ, _DAMPING]
_BURSTS = [
    of.logarithmic("at rest", 0.0, within=(1e-4, 100)),
    *(_TIME, _TIME),
    of.logarithmic("noise 0, 1e-7 to 1", 0.0, within=(1e-7, 1)),
    of.numbers("bursts of 0 to 1", 0.4, 0.0, 1e-6, 1.0),
    of.logarithmic("for 1e-6 to 1e6 s", 0.4, 1e-6, 1e6, within=(1e-6, 1e6)),
]
_RATE = of.numbers("1 to 10,000 Hz", *of.RATES_HZ)
_FRAMES = of.numbers("lags 0 to 10", 0, 1, 2, 10)
_LAG = of.logarithmic("lags 0, 1e-6 to 1e6 s", 0.0, within=(1e-6, 1e6))
_SHORT_LAG = of.logarithmic("lags 0, 1e-4 to 10 s", 0.0, within=(1e-4, 10))
_STEP = of.logarithmic("steps 1e-6 to 1e6 s", within=(1e-6, 1e6))
_HALVES = (rate / 2 for rate in of.RATES_HZ)
_FREQUENCY = of.logarithmic("0 to 5000 Hz", 0.0, *_HALVES, within=(1e-4, 5e3))


def _wander(speed: Any, time: Any, back: Any, *others: Any, noise: Any = 0.0) -> Any:
    return HeadMotion((speed,) * 3, (time,) * 3, (noise,) * 3, back, 0.0, *others)


def _mode(*given: Any) -> Any:
    mode = Resonator(*((each,) * 3 for each in given))
    return _wander(0.0, 1.0, 15.0, (mode,))


def _terms(power: Any, a: Any, b: Any) -> list:
    """White noise through two exponentials: amplitudes and rates, maybe complex."""
    if a == b:
        b = b * (1 + mp.mpf(10) ** -20)  # the limit, to 20 digits
    scale = power / (b**2 - a**2)
    return [(scale / a, a), (-scale / b, b)]


def _oscillator(speed: Any, frequency_hz: Any, damping: Any) -> list:
    w, root = 2 * mp.pi * frequency_hz, mp.sqrt(mp.mpc(damping**2 - 1))
    power = 2 * speed**2 * w * damping
    return _terms(power, w * (damping - root), w * (damping + root))


def _sampled_spectrum(terms: list, frequency_hz: Any, rate_hz: Any) -> Any:
    half = mp.sin(mp.pi * frequency_hz / rate_hz) ** 2
    kernel = lambda x: mp.sinh(x) / (mp.sinh(x / 2) ** 2 + half) if half else 0
    return 4 * rate_hz * half * _sum(terms, lambda r: kernel(r / rate_hz))


def _increment_covariance(terms: list, frames: Any, rate_hz: Any) -> Sized:
    law = lambda n: _structure(terms, n / rate_hz)
    at = lambda n: (law(n - 1) + law(n + 1)) / 2 - law(n)
    return Sized([at(int(frames))], [at(0)])


_sum = lambda terms, function: mp.re(mp.fsum(c * function(r) for c, r in terms))
_covariance = lambda terms, lag: _sum(terms, lambda r: mp.exp(-r * abs(lag)))
_structure = lambda terms, lag: _sum(terms, lambda r: -2 * mp.expm1(-r * abs(lag)))
_spectrum = lambda terms, w: 4 * w**2 * _sum(terms, lambda r: r / (r**2 + w**2))
_wandering = lambda v, time, back: _terms(v**2 / time, 1 / time, 1 / back)
_HEADS = {"wander": (_wander, _wandering, _WANDER), "mode": (_mode, _oscillator, _MODE)}
_LAWS = {
    "covariance": lambda x, lag: Sized([_covariance(x, lag)], [_covariance(x, 0)]),
    "structure_function": _structure,
    "velocity_spectrum": lambda terms, hertz: _spectrum(terms, 2 * mp.pi * hertz),
    "sampled_velocity_spectrum": _sampled_spectrum,
    "increment_covariance": _increment_covariance,
}


def _law(name: str, kind: str, at: list, bounds: dict, **options: Any) -> Row:
    (head, terms, numbers), law = _HEADS[kind], _LAWS[name]
    measured = lambda a, b, c, *at: getattr(head(a, b, c), name)(*at)[0]
    oracle = lambda a, b, c, *at: law(terms(a, b, c), *at)
    options["name"] = f"HeadMotion.{name}, {kind}"
    return _row(measured, oracle, [*numbers, *at], bounds, **options)


def _kurtosis(*given: Any) -> Any:
    head = _wander(*given[:3], (), Amplitude(*given[4:]), noise=given[3])
    return head.increment_kurtosis(60.0, memory_s=8 / 60)[0]


def _exact_kurtosis(speed: Any, time: Any, back: Any, noise: Any, *bursts: Any) -> Any:
    """Of turns at 60 Hz and 8 frames' memory, by the response to a noise impulse."""
    (sd, for_s), dt, a, b = bursts, mp.mpf(1) / 60, 1 / time, 1 / back
    if a == b:
        b = b * (1 + mp.mpf(10) ** -60)
    size, frames = speed * mp.sqrt(2 * a) / (a - b), range(8)
    response = [[mp.exp(-b * k * dt), -mp.exp(-a * k * dt)] for k in frames]
    steps = np.diff(size * np.array(response), axis=0, prepend=0)
    within = [[-mp.expm1(-r * dt) / r for r in (b + q, a + q)] for q in (b, a)]
    # What one frame's noise gives to the turn of a later one.
    gives = (steps.dot(within) * steps).sum(axis=1)
    shared = [mp.expm1(4 * sd**2 * mp.exp(-n * dt / for_s)) for n in frames]
    pairs = gives.dot([[shared[abs(i - k)] for i in frames] for k in frames]).dot(gives)
    total = mp.fsum(gives) + 2 * noise**2
    return 3 * pairs / total**2 if total else total


def _discretised(drift: Any, power: Any, dt: Any) -> Any:
    noise = jnp.zeros((2, 2), drift.dtype).at[1, 1].set(power)
    return jnp.concatenate([part.ravel() for part in discretise(drift, noise, dt)])


def transition(drift: np.ndarray, power: Any, dt: Any) -> list:
    """Transition minus identity, and noise's covariance; it drives the second state."""
    (b, c), (d, e) = drift
    moved = mp.expm(mp.matrix(drift.tolist()) * dt)
    # What noise adds is what a stationary law, of Lyapunov's equation, loses.
    lyapunov = mp.matrix([[2 * b, 2 * c, 0], [d, b + e, c], [0, 2 * d, 2 * e]])
    x, y, z = mp.lu_solve(lyapunov, mp.matrix([0, 0, -power]))
    law = mp.matrix([[x, y], [y, z]])
    return [*(moved - mp.eye(2)), *(law - moved * law * moved.T)]


_row = partial(scaled, count=69)
# About the turn within a lag, the last of the times. Smaller ones have squares, or
# slopes of them, that are denormal in float32.
_turn = lambda speed, *times: speed * min(1, times[1] / times[0]) ** 0.5 * min(times)
_turn_is_seen = lambda *head: not head[-1] or _turn(*head) > 1e-15
_step_is_seen = lambda a, b, c, *others: _turn(a, b, c, 1 / others[-1]) > 1e-17
# At lag 0, where the slope of the covariance is 0.
_or_time = lambda given, index: own_size(given, index) or float(min(given[1:3]))
_AT_REST: Any = {"slope_unit": _or_time, "quick": 0}
_STEPS: Any = {"kept": _step_is_seen, "quick": 0}
_rms = lambda *head: _wander(*head[:3]).increment_rms_deg(head[3])
_exact_rms = lambda *x: mp.sqrt(3 * _structure(_wandering(*x[:3]), 1 / x[3]))
_RMS = "HeadMotion.increment_rms_deg"
_KURTOSIS: Any = {"name": "HeadMotion.increment_kurtosis", "floor": 1e-12, "count": 35}
_DISCRETISE = "head_motion.discretisation.discretise"

ROWS = [
    _row(_discretised, transition, [_drift, _STEP], eps(32, 128), name=_DISCRETISE),
    _law("covariance", "wander", [_LAG], eps(32, 1e3), **_AT_REST),
    _law("structure_function", "wander", [_LAG], eps(32, 64), kept=_turn_is_seen),
    _law("velocity_spectrum", "wander", [_FREQUENCY], eps(16, 32)),
    # A mode keeps its phase over hundreds of radians, by which its slopes are larger.
    _law("covariance", "mode", [_SHORT_LAG], eps(32, 1e3), quick=0),
    _law("structure_function", "mode", [_SHORT_LAG], eps(32, 1e3), quick=0),
    _law("velocity_spectrum", "mode", [_FREQUENCY], eps(16, 32)),
    _law("increment_covariance", "wander", [_FRAMES, _RATE], eps(32, 64), **_STEPS),
    _law("sampled_velocity_spectrum", "wander", [_sampled], eps(64, 128), floor=1e-30),
    _row(_rms, _exact_rms, [*_WANDER, _RATE], eps(16, 32), name=_RMS, **_STEPS),
    _row(_kurtosis, _exact_kurtosis, _BURSTS, eps(32, 64), quick=0, **_KURTOSIS),
]
