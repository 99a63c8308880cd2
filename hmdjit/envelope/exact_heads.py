"""Exact laws of head motion, and of searches within bounds, in many digits.

The covariance of an angle is a sum of exponentials; all else follows from it.
"""

import itertools
from typing import Any

import numpy as np

from .exact_geometry import Numbers
from .row import Sized, mp

FARTHEST = 46  # documented: coordinates of curves count no farther
_SMALLEST = 1e-30  # what is smaller counts as this large


class Exponentials:
    """`C(t) = sum of amplitude exp(-rate |t|)`, in pairs that may be complex."""

    def __init__(self, *terms: tuple[Any, Any]):
        self.terms = terms

    @classmethod
    def wander(cls, speed: Any, time_s: Any, return_s: Any) -> "Exponentials":
        """White noise through two exponentials."""
        a, b = 1 / time_s, 1 / return_s
        if a == b:
            b = b * (1 + mp.mpf(10) ** -20)  # the limit, to 20 digits
        scale = speed**2 * a / (b**2 - a**2)
        return cls((scale / a, a), (-scale / b, b))

    @classmethod
    def mode(cls, speed: Any, frequency_hz: Any, damping: Any) -> "Exponentials":
        """Damped oscillator, under- or overdamped."""
        if damping == 1:
            damping = 1 + mp.mpf(10) ** -20
        w = 2 * mp.pi * frequency_hz
        root = mp.sqrt(mp.mpc(damping**2 - 1))
        first, second = w * (damping - root), w * (damping + root)
        scale = (speed / w) ** 2 / (second - first)
        return cls((scale * second, first), (-scale * first, second))

    def covariance(self, lag: Any) -> Any:
        """Of the angle, which counts by its variance."""
        at = lambda t: mp.re(mp.fsum(c * mp.exp(-r * abs(t)) for c, r in self.terms))
        return Sized([at(lag)], [at(0)])

    def structure_function(self, lag: Any) -> list:
        """Mean squared turn."""
        return [mp.re(mp.fsum(-2 * c * mp.expm1(-r * abs(lag)) for c, r in self.terms))]

    def increment_covariance(self, frames: Any, rate_hz: Any) -> Sized:
        """Covariance of frame-to-frame turns, which counts by their variance."""

        def at(n: int) -> Any:
            lags = [abs(n + k) / rate_hz for k in (-1, 0, 1)]
            before, here, after = (self.structure_function(t)[0] for t in lags)
            return (before + after) / 2 - here

        return Sized([at(int(frames))], [at(0)])

    def velocity_spectrum(self, frequency_hz: Any) -> list:
        """One-sided density of the velocity."""
        w = 2 * mp.pi * frequency_hz
        two_sided = mp.fsum(2 * c * r / (r**2 + w**2) for c, r in self.terms)
        return [2 * w**2 * mp.re(two_sided)]

    def sampled_velocity_spectrum(self, frequency_hz: Any, rate_hz: Any) -> list:
        """One-sided density of the frame-difference velocity."""
        differenced = 4 * mp.sin(mp.pi * frequency_hz / rate_hz) ** 2
        if not differenced:
            return [mp.mpf(0)]
        kernel = lambda x: mp.sinh(x) / (2 * (mp.sinh(x / 2) ** 2 + differenced / 4))
        total = mp.fsum(c * kernel(r / rate_hz) for c, r in self.terms)
        return [2 * rate_hz * differenced * mp.re(total)]


def increment_rms(speed: Any, time_s: Any, return_s: Any, rate_hz: Any) -> list:
    """Root mean square of the turn between frames, of three equal axes."""
    law = Exponentials.wander(speed, time_s, return_s)
    return [mp.sqrt(3 * law.structure_function(1 / rate_hz)[0])]


def increment_kurtosis(
    speed: Any, time_s: Any, return_s: Any, noise: Any, sd: Any, bursts_s: Any
) -> list:
    """Excess kurtosis of a wandering head's turns at 60 Hz, of 8 frames' memory.

    By the response to an impulse of noise: what one frame's noise gives to the turn of
    a later frame is the integral of squared differences of the response.
    """
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
    shared = [mp.expm1(4 * sd**2 * mp.exp(-n * dt / bursts_s)) for n in range(8)]
    places = itertools.product(range(8), repeat=2)
    pairs = mp.fsum(given[i] * given[j] * shared[abs(i - j)] for i, j in places)
    return [3 * pairs / total**2]


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


# --- searches within bounds ---


def _logistic(x: Any) -> Any:
    return 1 / (1 + mp.exp(-x))


def log_values(logits: np.ndarray, log_bounds: np.ndarray) -> Sized:
    """Logarithms of a head's numbers, which count by their larger bounds."""
    values, sizes = [], []
    for row, low, high in zip(logits, *log_bounds, strict=True):
        values += [low + (high - low) * _logistic(x) for x in row]
        sizes += [max(abs(low), abs(high))] * len(row)
    return Sized(values, sizes)


def natural(space: Any, point: Numbers) -> Sized:
    """Return a curve's numbers, as documented, which count by themselves."""
    left = iter([min(max(x, mp.mpf(-FARTHEST)), mp.mpf(FARTHEST)) for x in point])
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
    numbers += simplex(4) if space.localization == "spline" else []
    return Sized(numbers, [max(x, mp.mpf(_SMALLEST)) for x in numbers])
