"""The envelope's cases of head motion: sampling at any rate, laws, spectra.

What is asked of float32 is asked of float64, in its eps: the laws are sums of positive
terms, so that digits are lost to rounding alone.
"""

import math
from collections.abc import Callable, Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..head_motion import HeadMotion
from ..head_motion.discretisation import discretise
from ..head_motion.parameters import Amplitude, Resonator
from . import oracles as exact
from .cases import eps
from .measuring import Case, Inputs
from .oracles import mp

_Rng = np.random.Generator

RATES_HZ = (1.0, 60.0, 90.0, 1000.0, 10_000.0)
TIMES_S = (1e-6, 1e-3, 0.1, 1.0, 15.0, 1e3, 1e6)
"""Correlation and return times."""


def _as(dtype: np.dtype, *numbers: float) -> Inputs:
    return tuple(np.asarray(x, dtype) for x in numbers)


def _time(rng: _Rng) -> float:
    return 10 ** rng.uniform(-6, 6)


def _stiff(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    """Wander and modes over steps that are short and long for all they hold."""
    for n in range(60):
        dt = 10 ** rng.uniform(-6, 6)
        if n % 2:
            a, b = 1 / _time(rng), 1 / _time(rng)
            drift = [[-min(a, b), max(a, b)], [0.0, -max(a, b)]]
            power = 2 * max(a, b)
        else:
            # A mode rings on for 1 / damping radians: longer ones lose more.
            w, z = 10 ** rng.uniform(-2, 3), rng.choice([0.05, 0.3, 1.0, 2.0])
            drift, power = [[0.0, w], [-w, -2 * z * w]], 4 * z * w
        diffusion = [[0.0, 0.0], [0.0, power]]
        yield np.asarray(drift, dtype), np.asarray(diffusion, dtype), *_as(dtype, dt)


def _sampled(drift: Any, diffusion: Any, dt: Any) -> Any:
    # Only symmetric diffusions are allowed.
    found = discretise(drift, (diffusion + diffusion.T) / 2, dt)
    return jnp.concatenate([part.ravel() for part in found])


def _exact_sampled(drift: Any, diffusion: Any, dt: Any) -> list:
    return exact.transition(drift, (diffusion + diffusion.T) / 2, dt[()])


def _head(speed: Any, time: Any, returns: Any, noise: Any = 0.0) -> HeadMotion:
    return HeadMotion((speed,) * 3, (time,) * 3, (noise,) * 3, returns, 0.0)


def _resonant(speed: Any, frequency: Any, damping: Any) -> HeadMotion:
    mode = Resonator((speed,) * 3, (frequency,) * 3, (damping,) * 3)
    zero = jnp.zeros_like(speed)
    still = (zero,) * 3, (zero + 1,) * 3, (zero,) * 3
    return HeadMotion(*still, zero + 15, zero, (mode,))


def _wanders(rng: _Rng, dtype: np.dtype) -> Iterator[tuple[np.ndarray, ...]]:
    """Speed, correlation time, return time, and one of a place, a lag or a rate."""
    for n in range(49):
        time, returns = TIMES_S[n % 7], TIMES_S[n // 7]
        yield _as(dtype, 10 ** rng.uniform(-4, 2), time, returns)
    for _ in range(20):
        yield _as(dtype, 1.0, _time(rng), _time(rng))


def _with(inputs: Callable, *ranges: Callable) -> Callable:
    def of(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
        for n, found in enumerate(inputs(rng, dtype)):
            yield *found, *_as(dtype, *(drawn(rng, n) for drawn in ranges))

    return of


def _modes(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    for n in range(40):
        damping = (0.02, 0.05, 0.3, 1.0, 1.2, 2.0)[n % 6]
        yield _as(dtype, 10 ** rng.uniform(-4, 2), 10 ** rng.uniform(-1, 2), damping)


def _lag(rng: _Rng, n: int) -> float:
    return (0.0, 10 ** rng.uniform(-6, 6))[n % 5 > 0]


def _short_lag(rng: _Rng, n: int) -> float:
    return (0.0, 10 ** rng.uniform(-4, 1))[n % 5 > 0]


def _rate(rng: _Rng, n: int) -> float:
    return RATES_HZ[n % 5]


def _share(rng: _Rng, n: int) -> float:
    """Of half the rate, where there is a spectrum."""
    return (0.0, 1e-6, 1.0, rng.random(), 10 ** rng.uniform(-4, 0))[n % 5]


def _law(name: str) -> Callable:
    """Return a law of wander as function of its numbers and of a lag."""

    def of(speed: Any, time: Any, returns: Any, lag: Any) -> Any:
        return getattr(_head(speed, time, returns, 0 * speed), name)(lag)[0]

    return of


def _seen(inputs: Callable) -> Callable:
    """Leave out turns whose squares, or their slopes, are denormal in float32."""

    def kept(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
        for found in inputs(rng, dtype):
            speed, time, returns, lag = (float(x) for x in found)
            share = min(1.0, math.sqrt(returns / time))
            if speed * share * min(time, returns, lag) > 1e-15 or not lag:
                yield found

    return kept


def _beside_variance(law: Callable) -> Callable:
    """Return a covariance, which crosses 0, with the variance that it is judged by."""

    def of(first: Any, second: Any, third: Any, lag: Any) -> Any:
        return jnp.stack([law(first, second, third, t) for t in (lag, 0 * lag)])

    return of


def _mode_law(name: str) -> Callable:
    def of(speed: Any, frequency: Any, damping: Any, lag: Any) -> Any:
        return getattr(_resonant(speed, frequency, damping), name)(lag)[0]

    return of


def _oracle(make: Callable, law: Callable, *others: float) -> Callable:
    """Make exponentials of the first three arguments, and ask them for a law."""

    def of(*arguments: Any) -> list:
        first = make(*(x[()] for x in arguments[:3]))
        return [law(first, x) for x in (arguments[3][()], *others)]

    return of


def _shorter_time(
    speed: np.ndarray, time: np.ndarray, returns: np.ndarray, lag: np.ndarray
) -> float:
    return float(min(time, returns))


def _cases(kind: str, make: Callable, inputs: Callable, law: Callable) -> list[Case]:
    is_wander = kind == "wander"
    over = (
        "times 1e-6 to 1e6 s either way round"
        if is_wander
        else "0.1 to 100 Hz, damping 0.02 to 2"
    )
    lag = _lag if is_wander else _short_lag
    lags = "lags 0, 1e-6 to 1e6 s" if is_wander else "lags 0, 1e-4 to 10 s"
    of = exact.Exponentials
    # A mode keeps its phase over hundreds of radians, by which its slopes are larger.
    found = [
        Case(
            f"HeadMotion.covariance, {kind}",
            f"{over}, {lags}",
            _beside_variance(law("covariance")),
            _oracle(make, of.covariance, 0.0),
            _with(inputs, lag),
            eps(32, 1e3),
            slope_floor=1.0,
            unit_at_0=_shorter_time if is_wander else None,
            is_slow=True,
        ),
        Case(
            f"HeadMotion.structure_function, {kind}",
            f"{over}, {lags}",
            law("structure_function"),
            _oracle(make, of.structure),
            _seen(_with(inputs, lag)) if is_wander else _with(inputs, lag),
            eps(32, 64 if is_wander else 1e3),
            is_slow=not is_wander,
            slope_floor=1.0,
        ),
        Case(
            f"HeadMotion.velocity_spectrum, {kind}",
            f"{over}, 0 to 5000 Hz",
            law("velocity_spectrum"),
            _oracle(make, of.spectrum),
            _with(inputs, lambda rng, n: RATES_HZ[n % 5] / 2 * _share(rng, n // 5)),
            eps(16, 32),
            slope_floor=1.0,
        ),
    ]
    return found


def _increment_rms(speed: Any, time: Any, returns: Any, rate: Any) -> Any:
    return _head(speed, time, returns, 0 * speed).increment_rms_deg(rate)


def _exact_increment_rms(*arguments: Any) -> list:
    speed, time, returns, rate = (x[()] for x in arguments)
    law = exact.Exponentials.wander(speed, time, returns)
    return [mp.sqrt(3 * law.structure(1 / rate))]


def _spectrum(speed: Any, time: Any, returns: Any, rate: Any, share: Any) -> Any:
    head = _head(speed, time, returns, 0 * speed)
    return head.sampled_velocity_spectrum(share * rate / 2, rate)[0]


def _exact_spectrum(*arguments: Any) -> list:
    speed, time, returns, rate, share = (x[()] for x in arguments)
    law = exact.Exponentials.wander(speed, time, returns)
    return [law.sampled_spectrum(share * rate / 2, rate)]


def _neighbours(speed: Any, time: Any, returns: Any, rate: Any, lag: Any) -> Any:
    head = _head(speed, time, returns, 0 * speed)
    found = [head.increment_covariance(n, rate)[0] for n in (lag, jnp.zeros_like(lag))]
    return jnp.stack(found)


def _exact_neighbours(*arguments: Any) -> list:
    speed, time, returns, rate, lag = (x[()] for x in arguments)
    law = exact.Exponentials.wander(speed, time, returns)
    return [law.of_increments(int(n), 1 / rate) for n in (lag, 0)]


def _lagged(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    for n, found in enumerate(_with(_wanders, _rate)(rng, dtype)):
        yield *found, np.asarray((0, 1, 2, 10)[n % 4], np.int32)


def _no_underflow(inputs: Callable, power: float) -> Callable:
    """Leave out heads whose turns are so small that their squares are denormal."""

    def kept(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
        for found in inputs(rng, dtype):
            speed, time, returns, rate = (float(x) for x in found[:4])
            turn = speed * min(time, 1 / rate, returns)
            turn *= min(1.0, math.sqrt(returns / time))
            if turn > power:
                yield found

    return kept


_MEMORY_S = 8 / 60


def _kurtosis(
    speed: Any, time: Any, returns: Any, noise: Any, sd: Any, bursts: Any
) -> Any:
    head = HeadMotion(
        (speed,) * 3, (time,) * 3, (noise,) * 3, returns, 0.0, (), Amplitude(sd, bursts)
    )
    return head.increment_kurtosis(60.0, memory_s=_MEMORY_S)[0]


def _exact_kurtosis(*arguments: Any) -> list:
    """Excess kurtosis of a wandering head's turns, of 8 frames' memory.

    By the response to an impulse of noise: what one frame's noise gives to the turn of
    a later frame is the integral of squared differences of the response.
    """
    speed, time_s, return_s, noise, sd, bursts_s = (x[()] for x in arguments)
    dt = mp.mpf(1) / 60
    a, b = 1 / time_s, 1 / return_s
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
    shared = lambda lag: mp.expm1(4 * sd**2 * mp.exp(-lag * dt / bursts_s))
    pairs = mp.fsum(
        given[i] * given[j] * shared(abs(i - j)) for i in range(8) for j in range(8)
    )
    return [3 * pairs / total**2]


def _bursts(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    """Wander, or rest; a tracker that is silent, quiet, or louder than the turns."""
    for n, found in enumerate(list(_wanders(rng, dtype))[::2]):
        speed = (found[0], np.asarray(0, dtype))[n % 10 == 9]
        noise = (0.0, 1e-3, 1.0)[n % 3] * float(found[0]) / 60
        sd = (0.4, 0.0, 1e-6, 1.0)[n % 4]
        time = (0.4, 1e-6, 1e6, _time(rng))[n // 4 % 4]
        yield speed, *found[1:], *_as(dtype, noise, sd, time)


def cases() -> list[Case]:
    """Rates of 1 to 10,000 Hz, times of 1e-6 to 1e6 s."""
    laws = "times 1e-6 to 1e6 s either way round, 1 to 10,000 Hz"
    rated = _with(_wanders, _rate)
    return [
        Case(
            "head_motion.base.discretise",
            "times 1e-6 to 1e6 s, steps 1e-6 to 1e6 s, |drift| dt to 1e12",
            _sampled,
            _exact_sampled,
            _stiff,
            eps(32, 128),
            slope_floor=1.0,
        ),
        *_cases("wander", exact.Exponentials.wander, _wanders, _law),
        *_cases("mode", exact.Exponentials.mode, _modes, _mode_law),
        Case(
            "HeadMotion.increment_rms_deg",
            laws,
            _increment_rms,
            _exact_increment_rms,
            _no_underflow(rated, 1e-17),
            eps(16, 32),
            slope_floor=1.0,
            is_slow=True,
        ),
        Case(
            "HeadMotion.increment_kurtosis",
            "times 1e-6 to 1e6 s, 60 Hz, bursts of 0 to 1; at rest",
            _kurtosis,
            _exact_kurtosis,
            _bursts,
            eps(32, 64),
            floor=1e-12,
            slope_floor=1.0,
            is_slow=True,
        ),
        Case(
            "HeadMotion.increment_covariance",
            f"{laws}, lags 0 to 10",
            _neighbours,
            _exact_neighbours,
            _no_underflow(_lagged, 1e-17),
            eps(32, 64),
            slope_floor=1.0,
            is_slow=True,
        ),
        Case(
            "HeadMotion.sampled_velocity_spectrum",
            f"{laws}, 0 Hz to half the rate",
            _spectrum,
            _exact_spectrum,
            _with(_wanders, _rate, _share),
            eps(64, 128),
            floor=1e-30,
            slope_floor=1.0,
        ),
    ]
