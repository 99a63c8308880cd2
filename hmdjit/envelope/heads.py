"""The envelope's rows of head motion.

What is asked of float32 is asked of float64, in its eps: the laws are sums of positive
terms, so that digits are lost to rounding alone. Exactly, the covariance of an angle is
a sum of exponentials, and all else follows from it.
"""

import itertools
import math
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..head_motion import HeadMotion
from ..head_motion.discretisation import discretise
from ..head_motion.parameters import Amplitude, Resonator
from . import arguments as of
from .row import Argument, Inputs, Rng, Row, Sized, eps, mp, own_size

Terms = list[tuple[Any, Any]]  # amplitudes and rates, in pairs that may be complex

# --- ranges ---


def _stiff(rng: Rng, dtype: np.dtype, n: int) -> tuple[np.ndarray, float]:
    if n % 2:
        low, high = np.sort(10 ** rng.uniform(-6, 6, 2))
        return np.array([[-low, high], [0.0, -high]]), 2 * high
    # A mode rings on for 1 / damping radians: longer ones lose more.
    w, z = 10 ** rng.uniform(-2, 3), rng.choice([0.05, 0.3, 1.0, 2.0])
    return np.array([[0.0, w], [-w, -2 * z * w]]), 4 * z * w


def _sampled(rng: Rng, dtype: np.dtype, n: int) -> tuple[float, float]:
    rate = of.RATES_HZ[n // 5 % 5]
    share = (0.0, 1e-6, 1.0, rng.random(), 10 ** rng.uniform(-4, 0))[n % 5]
    return share * rate / 2, rate


_SPEED = of.logarithmic("", low=1e-4, high=100)
_TIME = of.logarithmic("times 1e-6 to 1e6 s", *of.TIMES_S, low=1e-6, high=1e6)
_HERTZ = of.logarithmic("0.1 to 100 Hz", low=0.1, high=100)
_DAMPING = of.numbers("damping 0.02 to 2", 0.02, 0.05, 0.3, 1.0, 1.2, 2.0)
_WANDER, _MODE = [_SPEED, _TIME, _TIME], [_SPEED, _HERTZ, _DAMPING]
_BURSTS = [
    of.logarithmic("at rest", 0.0, low=1e-4, high=100),
    *(_TIME, _TIME),
    of.logarithmic("noise 0, 1e-7 to 1", 0.0, low=1e-7, high=1),
    of.numbers("bursts of 0 to 1", 0.4, 0.0, 1e-6, 1.0),
    of.logarithmic("for 1e-6 to 1e6 s", 0.4, 1e-6, 1e6, low=1e-6, high=1e6),
]
_RATE = of.numbers("1 to 10,000 Hz", *of.RATES_HZ)
_FRAMES = Argument("lags 0 to 10", lambda rng, dtype, n: np.int32((0, 1, 2, 10)[n % 4]))
_LAG = of.logarithmic("lags 0, 1e-6 to 1e6 s", 0.0, low=1e-6, high=1e6)
_SHORT_LAG = of.logarithmic("lags 0, 1e-4 to 10 s", 0.0, low=1e-4, high=10)
_STEP = of.logarithmic("steps 1e-6 to 1e6 s", low=1e-6, high=1e6)
_STIFF = [Argument("wander and modes, |drift| dt to 1e12", _stiff), _STEP]
_HALVES = (rate / 2 for rate in of.RATES_HZ)
_FREQUENCY = of.logarithmic("0 to 5000 Hz", 0.0, *_HALVES, low=1e-4, high=5e3)
_SAMPLED = Argument("0 Hz to half the rate, 1 to 10,000 Hz", _sampled)

# --- heads ---


def _wander(speed: Any, time: Any, back: Any, *others: Any, noise: Any = 0) -> Any:
    noise = noise + 0 * speed
    return HeadMotion((speed,) * 3, (time,) * 3, (noise,) * 3, back, 0.0, *others)


def _mode(*given: Any) -> Any:
    none, mode = 0 * given[0], Resonator(*((each,) * 3 for each in given))
    return _wander(none, 1 + none, 15 + none, (mode,))


def _terms(power: Any, a: Any, b: Any) -> Terms:
    """White noise through two exponentials."""
    if a == b:
        b = b * (1 + mp.mpf(10) ** -20)  # the limit, to 20 digits
    scale = power / (b**2 - a**2)
    return [(scale / a, a), (-scale / b, b)]


def _oscillator(speed: Any, frequency_hz: Any, damping: Any) -> Terms:
    """Damped, under or over."""
    w, root = 2 * mp.pi * frequency_hz, mp.sqrt(mp.mpc(damping**2 - 1))
    power = 2 * speed**2 * w * damping
    return _terms(power, w * (damping - root), w * (damping + root))


def _sampled_spectrum(terms: Terms, frequency_hz: Any, rate_hz: Any) -> Any:
    """One-sided density of the frame-difference velocity."""
    half = mp.sin(mp.pi * frequency_hz / rate_hz) ** 2
    kernel = lambda x: mp.sinh(x) / (mp.sinh(x / 2) ** 2 + half) if half else 0
    return 4 * rate_hz * half * _sum(terms, lambda r: kernel(r / rate_hz))


def _increment_covariance(terms: Terms, frames: Any, rate_hz: Any) -> Sized:
    law = lambda n: _structure(terms, n / rate_hz)
    at = lambda n: (law(n - 1) + law(n + 1)) / 2 - law(n)
    return Sized([at(int(frames))], [at(0)])


_sum = lambda terms, function: mp.re(mp.fsum(c * function(r) for c, r in terms))
_covariance = lambda terms, lag: _sum(terms, lambda r: mp.exp(-r * abs(lag)))
_structure = lambda terms, lag: _sum(terms, lambda r: -2 * mp.expm1(-r * abs(lag)))
_spectrum = lambda terms, w: 4 * w**2 * _sum(terms, lambda r: r / (r**2 + w**2))
_wandering = lambda v, time, back: _terms(v**2 / time, 1 / time, 1 / back)
_HEADS = {"wander": (_wander, _wandering), "mode": (_mode, _oscillator)}
_LAWS = {
    "covariance": lambda x, lag: Sized([_covariance(x, lag)], [_covariance(x, 0)]),
    "structure_function": _structure,
    "velocity_spectrum": lambda terms, hertz: _spectrum(terms, 2 * mp.pi * hertz),
    "sampled_velocity_spectrum": _sampled_spectrum,
    "increment_covariance": _increment_covariance,
}


def _law(name: str, kind: str, *given: Any, **options: Any) -> Row:
    """Row of a law of a head of three numbers, at a lag or frequency."""
    (head, terms), law = _HEADS[kind], _LAWS[name]
    measured = lambda a, b, c, *at: getattr(head(a, b, c), name)(*at)[0]
    oracle = lambda a, b, c, *at: law(terms(a, b, c), *at)
    return _row(measured, oracle, *given, name=f"HeadMotion.{name}, {kind}", **options)


def _kurtosis(*given: Any) -> Any:
    head = _wander(*given[:3], (), Amplitude(*given[4:]), noise=given[3])
    return head.increment_kurtosis(60.0, memory_s=8 / 60)[0]


def _exact_kurtosis(*given: Any) -> Any:
    """Of turns at 60 Hz and 8 frames' memory, by the response to an impulse of noise.

    What one frame's noise gives to the turn of a later frame is the integral of squared
    differences of the response.
    """
    speed, time, back, noise, sd, bursts = given
    dt, a, b = mp.mpf(1) / 60, 1 / time, 1 / back
    if a == b:
        b = b * (1 + mp.mpf(10) ** -60)
    size, gives = speed * mp.sqrt(2 * a) / (a - b), []
    for k in range(8):
        terms = []  # of the response's difference, within a frame
        for sign, rate in ((size, b), (-size, a)):
            before = mp.exp(-rate * (k - 1) * dt) if k else 0
            terms.append((sign * (mp.exp(-rate * k * dt) - before), rate))
        products = [(c * d, r + q) for c, r in terms for d, q in terms]
        gives.append(mp.fsum(-c * mp.expm1(-r * dt) / r for c, r in products))
    total = mp.fsum(gives) + 2 * noise**2
    shared = [mp.expm1(4 * sd**2 * mp.exp(-n * dt / bursts)) for n in range(8)]
    places = itertools.product(range(8), repeat=2)
    pairs = mp.fsum(gives[i] * gives[j] * shared[abs(i - j)] for i, j in places)
    return 3 * pairs / total**2 if total else total


def _discretised(drift: Any, power: Any, dt: Any) -> Any:
    noise = jnp.zeros((2, 2), drift.dtype).at[1, 1].set(power)
    return jnp.concatenate([part.ravel() for part in discretise(drift, noise, dt)])


def transition(drift: np.ndarray, power: Any, dt: Any) -> list:
    """Transition minus identity, and noise's covariance, of two coupled states.

    Noise of a power drives the second. By eigenvalues; the noise is what a stationary
    law loses, of Lyapunov's equation.
    """
    a, ((b, c), (d, e)) = mp.matrix(drift.tolist()), drift
    half = (b + e) / 2
    root = mp.sqrt(mp.mpc(((b - e) / 2) ** 2 + c * d)) or mp.mpf(10) ** -25
    up, down = (mp.exp((half + sign * root) * dt) for sign in (1, -1))
    moved = mp.eye(2) * (up + down) / 2
    moved += (a - half * mp.eye(2)) * ((up - down) / 2 / root)
    moved = moved.apply(mp.re)
    lyapunov = mp.matrix([[2 * b, 2 * c, 0], [d, b + e, c], [0, 2 * d, 2 * e]])
    x, y, z = mp.lu_solve(lyapunov, mp.matrix([0, 0, -power]))
    law = mp.matrix([[x, y], [y, z]])
    return [*(moved - mp.eye(2)), *(law - moved * law * moved.T)]


def _turn(speed: Any, time: Any, back: Any, lag: Any) -> float:
    """About the turn within a lag."""
    return float(speed * min(1.0, math.sqrt(back / time)) * min(time, back, lag))


def _or_time(arguments: Inputs, index: int) -> float:
    """At lag 0, where the slope of the covariance is 0."""
    return own_size(arguments, index) or float(min(arguments[1], arguments[2]))


_row = partial(Row, slope_unit=own_size, count=69)
# Smaller turns have squares, or slopes of them, that are denormal in float32.
_turn_is_seen = lambda *head: not head[-1] or _turn(*head) > 1e-15
_step_is_seen = lambda a, b, c, *others: _turn(a, b, c, 1 / others[-1]) > 1e-17
_AT_REST: Any = {"slope_unit": _or_time, "quick": 0}
_SEEN: Any = {"kept": _turn_is_seen}
_DENSITY = [*_WANDER, _SAMPLED], eps(64, 128)
_rms = lambda *head: _wander(*head[:3]).increment_rms_deg(head[3])
_exact_rms = lambda *x: mp.sqrt(3 * _structure(_wandering(*x[:3]), 1 / x[3]))
_RMS: Any = {"name": "HeadMotion.increment_rms_deg", "kept": _step_is_seen}
_KURTOSIS: Any = {"name": "HeadMotion.increment_kurtosis", "floor": 1e-12, "count": 35}
_FRAME_LAGS, _STEPS = [*_WANDER, _FRAMES, _RATE], {"kept": _step_is_seen, "quick": 0}
_RINGING, _ASKED = [*_MODE, _SHORT_LAG], eps(32, 1e3)
_DISCRETISE = "head_motion.discretisation.discretise"

HEADS = [
    _row(_discretised, transition, _STIFF, eps(32, 128), name=_DISCRETISE),
    _law("covariance", "wander", [*_WANDER, _LAG], _ASKED, **_AT_REST),
    _law("structure_function", "wander", [*_WANDER, _LAG], eps(32, 64), **_SEEN),
    _law("velocity_spectrum", "wander", [*_WANDER, _FREQUENCY], eps(16, 32)),
    # A mode keeps its phase over hundreds of radians, by which its slopes are larger.
    _law("covariance", "mode", _RINGING, _ASKED, quick=0),
    _law("structure_function", "mode", _RINGING, _ASKED, quick=0),
    _law("velocity_spectrum", "mode", [*_MODE, _FREQUENCY], eps(16, 32)),
    _law("increment_covariance", "wander", _FRAME_LAGS, eps(32, 64), **_STEPS),
    _law("sampled_velocity_spectrum", "wander", *_DENSITY, floor=1e-30),
    _row(_rms, _exact_rms, [*_WANDER, _RATE], eps(16, 32), quick=0, **_RMS),
    _row(_kurtosis, _exact_kurtosis, _BURSTS, eps(32, 64), quick=0, **_KURTOSIS),
]
