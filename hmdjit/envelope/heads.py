"""The envelope's rows of head motion.

What is asked of float32 is asked of float64, in its eps: the laws are sums of positive
terms, so that digits are lost to rounding alone. Exactly, the covariance of an angle is
a sum of exponentials, and all else follows from it.
"""

import itertools
import math
from collections.abc import Callable
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..head_motion import HeadMotion
from ..head_motion.discretisation import discretise
from ..head_motion.parameters import Amplitude, Resonator
from . import arguments as of
from .row import Argument, Inputs, Rng, Row, Sized, eps, mp, own_size

_of_law = partial(Row, slope_unit=own_size, count=69)
_Terms = list[tuple[Any, Any]]  # amplitudes and rates, in pairs that may be complex

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


def _sampled(rng: Rng, dtype: np.dtype, n: int) -> tuple[float, float]:
    rate = of.RATES_HZ[n // 5 % 5]
    share = (0.0, 1e-6, 1.0, rng.random(), 10 ** rng.uniform(-4, 0))[n % 5]
    return share * rate / 2, rate


_WANDER = Argument("times 1e-6 to 1e6 s either way round", _draw_wander)
_MODE = Argument("0.1 to 100 Hz, damping 0.02 to 2", _draw_mode)
_BURSTS = [Argument("times 1e-6 to 1e6 s, bursts of 0 to 1; at rest", _bursts)]
_FRAMES = Argument("lags 0 to 10", lambda rng, dtype, n: np.int32((0, 1, 2, 10)[n % 4]))
_LAG = of.logarithmic("lags 0, 1e-6 to 1e6 s", 0.0, low=1e-6, high=1e6)
_SHORT_LAG = of.logarithmic("lags 0, 1e-4 to 10 s", 0.0, low=1e-4, high=10)
_STEP = of.logarithmic("steps 1e-6 to 1e6 s", low=1e-6, high=1e6)
_STIFF = [Argument("wander and modes, |drift| dt to 1e12", _stiff), _STEP]
_NYQUIST = (rate / 2 for rate in of.RATES_HZ)
_FREQUENCY = of.logarithmic("0 to 5000 Hz", 0.0, *_NYQUIST, low=1e-4, high=5e3)
_SAMPLED = Argument("0 Hz to half the rate, 1 to 10,000 Hz", _sampled)
_LAGGED, _RINGING = [_WANDER, _LAG], [_MODE, _SHORT_LAG]

# --- heads ---


def _wander(
    speed: Any, time: Any, back: Any, *others: Any, noise: Any = 0
) -> HeadMotion:
    noise = noise + 0 * speed
    return HeadMotion((speed,) * 3, (time,) * 3, (noise,) * 3, back, 0.0, *others)


def _mode(speed: Any, frequency: Any, damping: Any) -> HeadMotion:
    mode = Resonator((speed,) * 3, (frequency,) * 3, (damping,) * 3)
    return _wander(0 * speed, 1 + 0 * speed, 15 + 0 * speed, (mode,))


def _wander_terms(speed: Any, time_s: Any, return_s: Any) -> _Terms:
    """White noise through two exponentials."""
    a, b = 1 / time_s, 1 / return_s
    if a == b:
        b = b * (1 + mp.mpf(10) ** -20)  # the limit, to 20 digits
    scale = speed**2 * a / (b**2 - a**2)
    return [(scale / a, a), (-scale / b, b)]


def _mode_terms(speed: Any, frequency_hz: Any, damping: Any) -> _Terms:
    """Damped oscillator, under- or overdamped."""
    if damping == 1:
        damping = 1 + mp.mpf(10) ** -20
    w, root = 2 * mp.pi * frequency_hz, mp.sqrt(mp.mpc(damping**2 - 1))
    first, second = w * (damping - root), w * (damping + root)
    scale = (speed / w) ** 2 / (second - first)
    return [(scale * second, first), (-scale * first, second)]


def _covariance(terms: _Terms, lag: Any) -> Sized:
    at = lambda t: mp.re(mp.fsum(c * mp.exp(-r * abs(t)) for c, r in terms))
    return Sized([at(lag)], [at(0)])


def _structure_function(terms: _Terms, lag: Any) -> list:
    return [mp.re(mp.fsum(-2 * c * mp.expm1(-r * abs(lag)) for c, r in terms))]


def _increment_covariance(terms: _Terms, frames: Any, rate_hz: Any) -> Sized:
    def at(n: int) -> Any:
        lags = [(n + k) / rate_hz for k in (-1, 0, 1)]
        before, here, after = (_structure_function(terms, t)[0] for t in lags)
        return (before + after) / 2 - here

    return Sized([at(int(frames))], [at(0)])


def _velocity_spectrum(terms: _Terms, frequency_hz: Any) -> list:
    w = 2 * mp.pi * frequency_hz
    two_sided = mp.fsum(2 * c * r / (r**2 + w**2) for c, r in terms)
    return [2 * w**2 * mp.re(two_sided)]


def _sampled_velocity_spectrum(terms: _Terms, frequency_hz: Any, rate_hz: Any) -> list:
    """One-sided density of the frame-difference velocity."""
    differenced = 4 * mp.sin(mp.pi * frequency_hz / rate_hz) ** 2
    if not differenced:
        return [mp.mpf(0)]
    kernel = lambda x: mp.sinh(x) / (2 * (mp.sinh(x / 2) ** 2 + differenced / 4))
    total = mp.fsum(c * kernel(r / rate_hz) for c, r in terms)
    return [2 * rate_hz * differenced * mp.re(total)]


def _exact_rms(speed: Any, time: Any, back: Any, rate: Any) -> list:
    """Of the turn between frames, of three equal axes."""
    law = _structure_function(_wander_terms(speed, time, back), 1 / rate)
    return [mp.sqrt(3 * law[0])]


def _kurtosis(
    speed: Any, time: Any, back: Any, noise: Any, sd: Any, bursts: Any
) -> Any:
    head = _wander(speed, time, back, (), Amplitude(sd, bursts), noise=noise)
    return head.increment_kurtosis(60.0, memory_s=8 / 60)[0]


def _exact_kurtosis(
    speed: Any, time: Any, back: Any, noise: Any, sd: Any, bursts: Any
) -> list:
    """Of turns at 60 Hz and 8 frames' memory, by the response to an impulse of noise.

    What one frame's noise gives to the turn of a later frame is the integral of squared
    differences of the response.
    """
    dt, a, b = mp.mpf(1) / 60, 1 / time, 1 / back
    if a == b:
        b = b * (1 + mp.mpf(10) ** -60)
    size, given = speed * mp.sqrt(2 * a) / (a - b), []
    for k in range(8):
        terms = []  # of the response's difference, within a frame
        for sign, rate in ((size, b), (-size, a)):
            before = mp.exp(-rate * (k - 1) * dt) if k else 0
            terms.append((sign * (mp.exp(-rate * k * dt) - before), rate))
        products = [(c * d, r + q) for c, r in terms for d, q in terms]
        given.append(mp.fsum(-c * mp.expm1(-r * dt) / r for c, r in products))
    total = mp.fsum(given) + 2 * noise**2
    if not total:
        return [mp.mpf(0)]
    shared = [mp.expm1(4 * sd**2 * mp.exp(-n * dt / bursts)) for n in range(8)]
    places = itertools.product(range(8), repeat=2)
    pairs = mp.fsum(given[i] * given[j] * shared[abs(i - j)] for i, j in places)
    return [3 * pairs / total**2]


def _discretised(drift: Any, power: Any, dt: Any) -> Any:
    noise = jnp.zeros((2, 2), drift.dtype).at[1, 1].set(power)
    return jnp.concatenate([part.ravel() for part in discretise(drift, noise, dt)])


def transition(drift: np.ndarray, power: Any, dt: Any) -> list:
    """Transition minus identity, and noise's covariance, of two coupled states.

    Noise of a power drives the second. By eigenvalues; the noise is what a stationary
    law loses, of Lyapunov's equation.
    """
    a = mp.matrix(drift.tolist())
    b, c, d, e = a
    half_trace = (b + e) / 2
    root = mp.sqrt(mp.mpc(((b - e) / 2) ** 2 + c * d)) or mp.mpf(10) ** -25
    grown = [mp.exp((half_trace + sign * root) * dt) for sign in (1, -1)]
    even, odd = (grown[0] + grown[1]) / 2, (grown[0] - grown[1]) / 2 / root
    moved = (even * mp.eye(2) + odd * (a - half_trace * mp.eye(2))).apply(mp.re)
    lyapunov = mp.matrix([[2 * b, 2 * c, 0], [d, b + e, c], [0, 2 * d, 2 * e]])
    x, y, z = mp.lu_solve(lyapunov, mp.matrix([0, 0, -power]))
    law = mp.matrix([[x, y], [y, z]])
    return [*(moved - mp.eye(2)), *(law - moved * law * moved.T)]


def _law(head: Callable, terms: Callable, law: Callable, *given: Any, **options: Any):
    """Row of a law of a head of three numbers, at a lag or frequency."""
    name = law.__name__[1:]
    of_numbers = lambda a, b, c, *at: getattr(head(a, b, c), name)(*at)[0]
    oracle = lambda a, b, c, *at: law(terms(a, b, c), *at)
    named = f"HeadMotion.{name}, {head.__name__[1:]}"
    return _of_law(of_numbers, oracle, *given, name=named, **options)


def _turn(speed: Any, time: Any, back: Any, lag: Any) -> float:
    """About the turn within a lag."""
    return float(speed * min(1.0, math.sqrt(back / time)) * min(time, back, lag))


def _or_time(arguments: Inputs, index: int) -> float:
    """At lag 0, where the slope of the covariance is 0."""
    return own_size(arguments, index) or float(min(arguments[1], arguments[2]))


# Smaller turns have squares, or slopes of them, that are denormal in float32.
_turn_is_seen = lambda *head: not head[-1] or _turn(*head) > 1e-15
_step_is_seen = lambda a, b, c, *others: _turn(a, b, c, 1 / others[-1]) > 1e-17
_wandering, _ringing = (
    partial(_law, *kind) for kind in ((_wander, _wander_terms), (_mode, _mode_terms))
)
_rms = lambda *head: _wander(*head[:3]).increment_rms_deg(head[3])
_RMS, _KURTOSIS = "HeadMotion.increment_rms_deg", "HeadMotion.increment_kurtosis"
_BURSTING: Any = {"name": _KURTOSIS, "floor": 1e-12, "count": 35, "quick": 0}
_AT_REST: Any = {"slope_unit": _or_time, "quick": 0}
_STEPS: Any = {"kept": _step_is_seen, "quick": 0}
_DISCRETISE = "head_motion.discretisation.discretise"

HEADS = [
    _of_law(_discretised, transition, _STIFF, eps(32, 128), name=_DISCRETISE),
    _wandering(_covariance, _LAGGED, eps(32, 1e3), **_AT_REST),
    _wandering(_structure_function, _LAGGED, eps(32, 64), kept=_turn_is_seen),
    _wandering(_velocity_spectrum, [_WANDER, _FREQUENCY], eps(16, 32)),
    # A mode keeps its phase over hundreds of radians, by which its slopes are larger.
    _ringing(_covariance, _RINGING, eps(32, 1e3), quick=0),
    _ringing(_structure_function, _RINGING, eps(32, 1e3), quick=0),
    _ringing(_velocity_spectrum, [_MODE, _FREQUENCY], eps(16, 32)),
    _wandering(
        _increment_covariance, [_WANDER, _FRAMES, of.RATE], eps(32, 64), **_STEPS
    ),
    _wandering(
        _sampled_velocity_spectrum, [_WANDER, _SAMPLED], eps(64, 128), floor=1e-30
    ),
    _of_law(_rms, _exact_rms, [_WANDER, of.RATE], eps(16, 32), name=_RMS, **_STEPS),
    _of_law(_kurtosis, _exact_kurtosis, _BURSTS, eps(32, 64), **_BURSTING),
]
