"""Laws of the head's parts against closed forms of 40 digits and integrals."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg

from hmdjit.head_motion import components, laws

covariance = jax.jit(laws.covariance)
structure_function = jax.jit(laws.structure_function)
velocity_spectrum = jax.jit(laws.velocity_spectrum)
turn_memory = jax.jit(laws.turn_memory, static_argnames="frames")


@jax.jit
def increment_covariance(parts, lags, rate_hz):
    return laws.increment_covariance(parts, silent(parts), lags, rate_hz)


@jax.jit
def sampled_velocity_spectrum(parts, frequency_hz, rate_hz):
    return laws.sampled_velocity_spectrum(parts, silent(parts), frequency_hz, rate_hz)


def silent(parts):
    """No tracker's noise."""
    return jnp.zeros(3, parts.drift.dtype)


class Wander(NamedTuple):
    """`dv = -v / tau dt + sqrt(2 s^2 / tau) dW`, `dx = (v - x / T_r) dt`."""

    speed_rms_deg_s: tuple[float, ...]
    correlation_time_s: tuple[float, ...]
    return_time_s: float

    def parts(self, dtype=jnp.float64):
        speed, time, return_time = (jnp.asarray(x, dtype) for x in self)
        return components.wander(speed, time, return_time)

    def system(self, axis):
        """Drift and diffusion in deg and deg/s."""
        s, a, b = self._numbers(axis)
        return np.array([[-b, 1.0], [0.0, -a]]), np.diag([0.0, 2 * s**2 * a])

    def covariance(self, axis, t):
        """Of the angle, deg^2; in the numbers of mpmath."""
        s, a, b = self._numbers(axis, mpmath.mpf)
        kept = a * mpmath.exp(-b * abs(t)) - b * mpmath.exp(-a * abs(t))
        return s**2 * kept / (b * (a**2 - b**2))

    def velocity_covariance(self, axis, t):
        """Minus the second derivative of the angle's covariance, (deg/s)^2."""
        s, a, b = self._numbers(axis)
        return s**2 * a * (a * np.exp(-a * t) - b * np.exp(-b * t)) / (a**2 - b**2)

    def _numbers(self, axis, number: Any = float):
        times = self.correlation_time_s[axis], self.return_time_s
        return number(self.speed_rms_deg_s[axis]), *(1 / number(t) for t in times)


class Mode(NamedTuple):
    """`x'' + 2 z w0 x' + w0^2 x = sqrt(4 z w0) s dW / dt`."""

    speed_rms_deg_s: tuple[float, ...]
    frequency_hz: tuple[float, ...]
    damping: tuple[float, ...]

    def parts(self, dtype=jnp.float64):
        return components.resonance(*(jnp.asarray(row, dtype) for row in self))

    def system(self, axis):
        s, w, z = (row[axis] for row in self)
        w = 2 * np.pi * w
        return np.array([[0.0, 1.0], [-(w**2), -2 * z * w]]), np.diag(
            [0.0, 4 * z * w * s**2]
        )

    def covariance(self, axis, t):
        s, w, z = (mpmath.mpf(row[axis]) for row in self)
        w, t = 2 * mpmath.pi * w, abs(t)
        k = w * mpmath.sqrt(1 - z**2)  # imaginary above the critical damping
        sine = t if k == 0 else mpmath.re(mpmath.sin(k * t) / k)
        kept = mpmath.re(mpmath.cos(k * t)) + z * w * sine
        return (s / w) ** 2 * mpmath.exp(-z * w * t) * kept

    def velocity_covariance(self, axis, t):
        s, w, z = (row[axis] for row in self)
        w = 2 * np.pi * w
        k = w * np.sqrt(1 - z**2)
        return s**2 * np.exp(-z * w * t) * (np.cos(k * t) - z * w / k * np.sin(k * t))


WANDER = Wander((1.12, 0.91, 0.93), (0.10, 0.124, 0.029), 15.0)
QUICK = Wander((1.12, 0.91, 0.93), (0.10, 0.124, 0.029), 0.11)
NECK = Mode((0.4, 0.5, 0.5), (2.8, 2.4, 3.0), (0.12, 0.3, 0.4))
TREMOR = Mode((0.45, 0.35, 0.3), (8.0, 4.1, 11.4), (0.15, 0.07, 0.02))
# Hardly damped, critical and overdamped; the second rings at 60 Hz' Nyquist frequency.
ODD = Mode((1.0, 1.0, 1.0), (1.2, 30.0, 3.0), (1e-3, 1.0, 2.0))
EACH = {"wander": WANDER, "quick": QUICK, "neck": NECK, "tremor": TREMOR, "odd": ODD}

each = pytest.mark.parametrize("part", EACH.values(), ids=EACH)


def exactly(law, places):
    """Values of a law of 40 digits at places, for each axis: `(places, 3)`."""
    with mpmath.workdps(40):
        places = [mpmath.mpf(place) for place in places]
        return np.array([[float(law(axis, at)) for axis in range(3)] for at in places])


def van_loan(drift, diffusion, dt):
    size = len(drift)
    block = np.block([[-drift, diffusion], [np.zeros_like(drift), drift.T]])
    exponential = scipy.linalg.expm(block * dt)
    transition = exponential[size:, size:].T
    return transition, transition @ exponential[:size, size:]


# --- against closed forms ---


@each
def test_covariance_agrees_with_its_closed_form(part):
    lags_s = np.array([0.0, 1e-6, 0.01, 0.1, 1.0, 30.0, -0.1])
    law = exactly(part.covariance, lags_s)
    # A lag's rounding moves a mode's phase: 30 s of 1.2 Hz, still ringing, are 230 rad.
    ours = covariance(part.parts(), lags_s)
    np.testing.assert_allclose(ours, law, rtol=1e-13, atol=1e-13 * np.max(law))


@each
def test_structure_function_keeps_its_digits_at_short_lags(part):
    lags_s = np.array([1e-9, 1e-6, 1e-3, 0.01, 0.1, 1.0, 30.0])
    turned = lambda axis, t: 2 * (part.covariance(axis, 0) - part.covariance(axis, t))
    law = exactly(turned, lags_s)
    np.testing.assert_allclose(
        structure_function(part.parts(), lags_s), law, rtol=1e-12
    )
    assert np.all(structure_function(part.parts(), np.zeros(1)) == 0)


@each
@pytest.mark.parametrize("rate_hz", [60, 1000])
def test_increments_are_differences_of_angles(part, rate_hz):
    def difference(axis, lag):
        at = lambda frames: part.covariance(axis, frames / rate_hz)
        return 2 * at(lag) - at(lag + 1) - at(lag - 1)

    lags = np.array([0, 1, 2, 7, 300, -2])
    law = exactly(difference, lags.tolist())
    ours = increment_covariance(part.parts(), lags, float(rate_hz))
    np.testing.assert_allclose(ours, law, rtol=1e-12, atol=1e-12 * law[0].max())


@pytest.mark.parametrize("part", [WANDER, QUICK, NECK])
def test_spectrum_is_the_fourier_transform_of_the_covariance(part):
    frequency_hz = np.array([0.01, 0.5, 3.0, 11.0, 45.0])
    ours = np.asarray(velocity_spectrum(part.parts(), frequency_hz))
    for axis in range(3):
        law = [
            scipy.integrate.quad(
                partial(part.velocity_covariance, axis),
                0,
                np.inf,
                weight="cos",
                wvar=2 * np.pi * at,
                epsabs=1e-12,
                limlst=200,
            )[0]
            for at in frequency_hz
        ]
        # The integrals' own error, of about 1e-12 in each of some 100 cycles.
        np.testing.assert_allclose(4 * np.array(law), ours[:, axis], atol=1e-10)


@each
def test_spectrum_is_the_response_of_the_system(part):
    frequency_hz = np.array([0.01, 0.5, 1.2, 3.0, 8.0, 11.4, 30.0, 45.0, 500.0])
    ours = np.asarray(velocity_spectrum(part.parts(), frequency_hz))
    for axis in range(3):
        drift, diffusion = part.system(axis)
        noise = np.array([0.0, np.sqrt(diffusion[1, 1])])
        for at, found in zip(frequency_hz, ours[:, axis], strict=True):
            s = 2j * np.pi * at
            # The angle's velocity is `s x`. On the peak of the least damped mode 1e-3
            # of the terms is left of their sum.
            response = s * np.linalg.solve(s * np.eye(2) - drift, noise)[0]
            np.testing.assert_allclose(found, 2 * abs(response) ** 2, rtol=2e-12)


@each
@pytest.mark.parametrize("rate_hz", [60.0, 90.0, 1000.0])
def test_sampled_spectrum_is_the_continuous_one_with_its_aliases(part, rate_hz):
    frequency_hz = np.array([0.01, 0.5, 1.2, 3.0, 11.0, 29.9, 30.0])
    folded = np.abs(frequency_hz[:, None] + np.arange(-3000, 3001) * rate_hz)
    density = np.asarray(velocity_spectrum(part.parts(), folded))
    law = np.sum(density * np.sinc(folded / rate_hz)[..., None] ** 2, axis=1)
    ours = sampled_velocity_spectrum(part.parts(), frequency_hz, rate_hz)
    # Aliases fall as m^-4: those left out are below 1e-11 of the first, which the
    # spring's notch makes 1e-2 of the whole at most.
    np.testing.assert_allclose(ours, law, rtol=1e-9)


@each
def test_sampled_spectrum_integrates_to_the_increments(part):
    # Half-way points integrate a periodic function up to its covariance 5,000 s later;
    # the slowest part forgets within 15 s or, of damping 1e-3 at 1.2 Hz, 130 s.
    count, rate_hz, lags = 2**18, 90.0, np.array([0, 1, 5])
    frequency_hz = (np.arange(count) + 0.5) * rate_hz / 2 / count
    density = sampled_velocity_spectrum(part.parts(), frequency_hz, rate_hz)
    waves = np.cos(2 * np.pi * np.outer(lags, frequency_hz) / rate_hz)
    ours = waves @ np.asarray(density) / (2 * count * rate_hz)
    law = np.asarray(increment_covariance(part.parts(), lags, rate_hz))
    np.testing.assert_allclose(ours, law, atol=1e-9 * law[0].max())


@each
@pytest.mark.parametrize("rate_hz", [60.0, 1000.0])
def test_each_frames_noise_is_remembered_in_the_turns(part, rate_hz):
    ours = turn_memory(part.parts(), rate_hz, frames=50)
    assert ours.shape == (50, 3)
    for axis in range(3):
        drift, diffusion = part.system(axis)
        transition, noise = van_loan(drift, diffusion, 1 / rate_hz)
        law = [noise[0, 0]]
        for _ in range(49):
            turn = transition[0] - [1, 0]
            law.append(turn @ noise @ turn)
            noise = transition @ noise @ transition.T
        # The oracle subtracts the identity: 1e-16 of a transition near 1.
        np.testing.assert_allclose(ours[:, axis], law, rtol=1e-8, atol=1e-10 * max(law))


def test_turns_are_all_that_is_remembered():
    # At 10 Hz 50 frames are 5 s: older is exp(-2 * 5 / 0.124) of the slowest, 1e-35.
    part = QUICK.parts()
    total = jnp.sum(turn_memory(part, 10.0, frames=50), axis=0)
    law = increment_covariance(part, np.arange(6), 10.0)[0]
    np.testing.assert_allclose(total, law, rtol=1e-12)


def laws_at_some_places(parts, rate_hz):
    """Every law, in the shapes above: those that cross 0, and those that do not."""
    like = partial(jnp.asarray, dtype=parts.drift.dtype)
    lags_s = like([0.0, 1e-3, 0.01, 0.125, 1.0, 8.0, -0.125])
    frequency_hz = like([0.25, 1.0, 2.375, 2.75, 3.0, 4.125, 8.0, 11.375, 30.0])
    covariances = {
        "covariance": covariance(parts, lags_s),
        "increments": increment_covariance(parts, np.arange(0, 12, 2), rate_hz),
    }
    powers = {
        "structure": structure_function(parts, lags_s),
        "spectrum": velocity_spectrum(parts, frequency_hz),
        "sampled": sampled_velocity_spectrum(parts, frequency_hz[2:], rate_hz),
        "memory": turn_memory(parts, rate_hz, frames=50)[:3],
    }
    return covariances, powers


@pytest.mark.slow
def test_laws_of_a_sum_are_sums_of_laws():
    found = [part.parts() for part in (WANDER, NECK, TREMOR)]
    whole = components.joined(*found)
    assert whole.angle_unit_deg.shape == (3, 3)
    each = [laws_at_some_places(part, 60.0) for part in found]
    laws = jax.tree.leaves(laws_at_some_places(whole, 60.0))
    for law, *parts in zip(laws, *map(jax.tree.leaves, each), strict=True):
        # Of covariances 1e-14 of the largest.
        atol = 1e-14 * np.max(np.abs(parts))
        np.testing.assert_allclose(law, np.sum(parts, axis=0), rtol=1e-13, atol=atol)


# --- precision and derivatives ---


@pytest.mark.slow  # the envelope holds laws in float32 against exact ones
@pytest.mark.parametrize("part", [WANDER, NECK, TREMOR])
@pytest.mark.parametrize("rate_hz", [60.0, 1000.0])
def test_laws_in_float32_agree_with_float64(part, rate_hz):
    single = part.parts(jnp.float32)
    # The same numbers: their own rounding is not the laws'.
    double = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), single)
    ours, oracle = (laws_at_some_places(parts, rate_hz) for parts in (single, double))
    assert {leaf.dtype for leaf in jax.tree.leaves(ours)} == {jnp.dtype(jnp.float32)}
    for name, law in oracle[1].items():
        # On a mode's peak eps / damping: for 0.02, 6e-6.
        np.testing.assert_allclose(ours[1][name], law, rtol=1e-5, err_msg=name)
    for name, law in oracle[0].items():
        error = np.asarray(ours[0][name], float) - np.asarray(law)
        assert np.all(np.abs(error) < 1e-5 * np.asarray(law[0])), name


def every_law(parts, rate_hz):
    dtype = parts.drift.dtype
    lags_s = jnp.array([0.0, 1e-6, 0.01], dtype)
    frequency_hz = jnp.array([0.25, 3.0, 30.0], dtype)
    return jnp.concatenate(
        [
            laws.covariance(parts, lags_s),
            laws.structure_function(parts, lags_s),
            increment_covariance(parts, jnp.array([0, 1, 3]), rate_hz),
            laws.velocity_spectrum(parts, frequency_hz),
            sampled_velocity_spectrum(parts, frequency_hz, rate_hz),
        ]
    )


@jax.jit
def laws_of_a_mode(rows):
    return every_law(components.resonance(*rows), 60.0)


@jax.jit
def laws_of_a_wander(rows):
    return every_law(components.wander(rows[0], rows[1], rows[2, 0]), 60.0)


ROUND_MODE = [
    [[1.0, 0.0, 1.0], [3.0, 30.0, 60.0], [1e-3, 1.0, 2.0]],
    [[1.0, 1.0, 1.0], [30.0, 60.0, 0.25], [1e-3, 1e-3, 1e-3]],
]
# Correlation and return times that are tiny, huge and the same.
ROUND_WANDER = [
    [[1.0, 0.0, 1.0], [1e-9, 0.1, 1e6], [15.0] * 3],
    [[1.0, 1.0, 1.0], [0.1, 0.0999999, 5.0], [0.1] * 3],
]


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_gradients_of_laws_are_finite(dtype):
    for of, places in (
        (laws_of_a_mode, ROUND_MODE),
        (laws_of_a_wander, ROUND_WANDER),
    ):
        jacobian = jax.jit(jax.jacrev(of))
        for rows in places:
            assert jnp.isfinite(of(jnp.array(rows, dtype))).all()
            assert jnp.isfinite(jacobian(jnp.array(rows, dtype))).all()


@pytest.mark.slow
@pytest.mark.parametrize("of", [laws_of_a_mode, laws_of_a_wander])
def test_gradients_of_laws_are_correct(of):
    # Critical and overdamped; resonances at 30 and 60 Hz, sampled at 60 Hz; for the
    # wander the third row is the return time, which is also one correlation time.
    rows = jnp.array([[1.0, 0.5, 1.0], [3.0, 30.0, 60.0], [0.2, 1.0, 2.0]])
    if of is laws_of_a_wander:
        rows = jnp.array([[1.0, 0.5, 1.0], [0.1, 0.124, 0.03], [0.1, 0.1, 0.1]])
    jacobian = np.asarray(jax.jit(jax.jacrev(of))(rows))
    for place in np.ndindex(3, 3):
        step = 1e-5 * rows[place]
        move = jnp.zeros((3, 3)).at[place].set(step)
        slope = np.asarray((of(rows + move) - of(rows - move)) / (2 * step))
        # Central differences err by (1e-5)^2 and by eps / 1e-5 of the value, of laws
        # that vary as the 4th power or less.
        scale = np.abs(np.asarray(of(rows))) / float(rows[place])
        error = np.abs(jacobian[(..., *place)] - slope)
        assert np.all(error <= 1e-8 * np.abs(slope) + 1e-9 * scale.max())
