"""Draws against the laws: fixed keys, z-tests, and an exact chi-square of all lags."""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.fft
import scipy.linalg
from heads import models
from jax.random import clone

from hmdjit.head_motion import Amplitude, HeadMotion, sampling
from hmdjit.head_motion.components import Parts

# Two-sided tests at 5 standard errors: of normal statistics 6e-7 false alarms each, of
# means of 1,000 squares (skewness 0.1, with bursts 0.3) up to 1e-5. This file has some
# 2,000: one in 50 keys would fail.
LARGEST_Z = 5.0

FRAMES, SESSIONS = 101, 1000
RATES_HZ = (60.0, 72.0, 90.0, 120.0, 1000.0)

_SHARED = models(person_sd=0.0)
MODEL_B, BURSTS = _SHARED["B"], _SHARED["bursts"]
# Bursts without spread: the Gaussian model B, drawn by the program of bursts.
CALM = HeadMotion(**{**vars(MODEL_B), "amplitude": Amplitude(0.0, 0.4)})
MODELS = {"calm": CALM, "bursts": BURSTS, "A": _SHARED["A"], "B": MODEL_B}


def marked(name, *rates_hz):
    """Models with programs of their own, and a few rates, are for the slow run."""
    is_slow = name in ("A", "B") or (name == "calm" and rates_hz in [(72.0,), (120.0,)])
    value = (name, *rates_hz) if rates_hz else name
    return pytest.param(value, marks=pytest.mark.slow if is_slow else ())


every_model = pytest.mark.parametrize("name", [marked(name) for name in MODELS])


class Drawn(NamedTuple):
    head: HeadMotion
    rate_hz: float
    angle_deg: np.ndarray  # (sessions, frames, 3)

    @property
    def tracker(self):
        """Variance of the tracker's noise, deg^2."""
        return np.square(np.array(self.head.tracker_noise_deg))


@partial(jax.jit, static_argnames=("sessions", "frames", "dtype"))
def draw_deg(head, key, rate_hz, sessions, frames, dtype):
    sample = lambda key: head.rotation_vectors(key, rate_hz, frames, dtype=dtype)
    return jnp.degrees(jax.lax.map(sample, jax.random.split(key, sessions)))


def draw(head, key, rate_hz, *, sessions=SESSIONS, frames=FRAMES, dtype=jnp.float64):
    """Rotation vectors in deg, shape (sessions, frames, 3)."""
    return np.asarray(draw_deg(head, clone(key), rate_hz, sessions, frames, dtype))


def quiet(head):
    """Head without the tracker's noise, which hides it at 1000 Hz."""
    return eqx.tree_at(lambda h: h.tracker_noise_deg, head, (0.0,) * 3)


def assert_mean(values, law):
    """Means over axis 0, sessions, are the law by their own spread's z."""
    error = np.mean(values, axis=0) - law
    z = error / (np.std(values, axis=0, ddof=1) / np.sqrt(len(values)))
    np.testing.assert_array_less(np.abs(z), LARGEST_Z)


def assert_normal_variance(values, law):
    """Zero-mean normal values, axis 0, have the variance: the z of a chi-square."""
    z = (np.mean(values**2, axis=0) / law - 1) / np.sqrt(2 / len(values))
    np.testing.assert_array_less(np.abs(z), LARGEST_Z)


@pytest.fixture(scope="module")
def drawn(request):
    name, rate_hz = request.param
    head = quiet(MODELS[name]) if rate_hz > 500 else MODELS[name]
    angle_deg = draw(head, jax.random.key(20260101), rate_hz)
    return Drawn(head, rate_hz, angle_deg)


every_draw = pytest.mark.parametrize(
    "drawn",
    [marked(name, rate_hz) for name in MODELS for rate_hz in RATES_HZ],
    ids=[f"{name}-{rate_hz:g}" for name in MODELS for rate_hz in RATES_HZ],
    indirect=True,
)


# --- second-order laws: exact at every rate, whether in bursts or not ---


@every_draw
def test_first_and_last_angles_are_stationary(drawn):
    law = drawn.head.covariance(0.0) + drawn.tracker
    for frame in (0, -1):
        assert_mean(drawn.angle_deg[:, frame] ** 2, law)
        assert_mean(drawn.angle_deg[:, frame], 0.0)


@every_draw
def test_the_same_process_at_every_rate(drawn):
    # At 72 Hz 0.1 s are 7.2 frames: 7 are taken.
    frames = round(0.1 * drawn.rate_hz)
    turned = drawn.angle_deg[:, frames] - drawn.angle_deg[:, 0]
    law = drawn.head.structure_function(frames / drawn.rate_hz) + 2 * drawn.tracker
    assert_mean(turned**2, law)


@every_draw
def test_drawn_increments_have_their_covariance(drawn):
    increments = np.diff(drawn.angle_deg, axis=1)
    count = increments.shape[1]
    law = drawn.head.increment_covariance(np.arange(count), drawn.rate_hz)
    for lag in (0, 1, 2, 10, 40):
        products = increments[:, : count - lag] * increments[:, lag:]
        assert_mean(products.mean(axis=1), law[lag])


@every_draw
def test_drawn_increments_have_all_of_their_law(drawn):
    """Whitened by the law they are uncorrelated, of variance 1: 10^5 numbers per axis.

    Of Gaussian heads their sum of squares is a chi-square: it errs by 0.4 %.
    """
    increments = np.diff(drawn.angle_deg, axis=1)
    count = increments.shape[1]
    law = drawn.head.increment_covariance(np.arange(count), drawn.rate_hz)
    for axis in range(3):
        spread = np.linalg.cholesky(scipy.linalg.toeplitz(np.asarray(law)[:, axis]))
        white = scipy.linalg.solve_triangular(
            spread, increments[:, :, axis].T, lower=True
        ).T
        if drawn.head.amplitude is None or drawn.head.amplitude.sd == 0:
            assert_normal_variance(white.ravel(), 1.0)
        assert_mean(np.mean(white**2, axis=1), 1.0)
        assert_mean(np.mean(white[:, 1:] * white[:, :-1], axis=1), 0.0)


@every_draw
def test_drawn_axes_are_uncorrelated(drawn):
    increments = np.diff(drawn.angle_deg, axis=1)
    assert_mean(np.mean(increments * np.roll(increments, 1, axis=2), axis=1), 0.0)


@every_model
def test_drawn_angles_have_their_covariance(name, key):
    # A short return time, so that lags within a session tell spring and speed apart.
    head = eqx.tree_at(lambda h: h.return_time_s, MODELS[name], 0.3)
    angle = draw(head, key, 60.0)
    for lag in (1, 5, 30, 100):
        assert_mean(angle[:, 0] * angle[:, lag], head.covariance(lag / 60))


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_sessions_start_in_the_stationary_law(name, key):
    # Squares of 20,000 sessions err by 1 %.
    head, rate_hz = quiet(MODELS[name]), 60.0
    angle = draw(head, key, rate_hz, sessions=20_000, frames=3)
    first, turns = angle[:, 0], np.diff(angle, axis=1)
    assert_mean(first**2, head.covariance(0.0))
    # A later angle covaries less by half of what it has turned.
    assert_mean(first * turns[:, 0], -head.structure_function(1 / rate_hz) / 2)
    law = np.asarray(head.increment_covariance(np.arange(FRAMES - 1), rate_hz))
    assert_mean(turns[:, 0] ** 2, law[0])
    assert_mean(turns[:, 1] ** 2, law[0])
    assert_mean(turns[:, 0] * turns[:, 1], law[1])


@pytest.mark.parametrize(
    "name", ["bursts", *(pytest.param(name, marks=pytest.mark.slow) for name in "AB")]
)
@pytest.mark.parametrize("rate_hz", [60.0, 1000.0])
def test_draws_in_float32_keep_the_law(name, key, rate_hz):
    head = quiet(MODELS[name])
    angle = draw(head, key, rate_hz, dtype=jnp.float32)
    assert angle.dtype == np.float32
    angle = angle.astype(float)
    # Angles of some deg round by 1e-7: 1e-4 of an increment at 1000 Hz.
    assert_mean(angle[:, -1] ** 2, head.covariance(0.0))
    increments = np.diff(angle, axis=1)
    law = head.increment_covariance(np.arange(FRAMES - 1), rate_hz)
    assert_mean(np.mean(increments**2, axis=1), law[0])
    assert_mean(np.mean(increments[:, 1:] * increments[:, :-1], axis=1), law[1])
    lag = round(0.1 * rate_hz)
    assert_mean((angle[:, lag] - angle[:, 0]) ** 2, head.structure_function(0.1))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["A", "B", "bursts"])
@pytest.mark.parametrize("rate_hz", RATES_HZ)
def test_drawn_velocities_have_their_spectrum(name, key, rate_hz):
    head = quiet(MODELS[name]) if rate_hz > 500 else MODELS[name]
    count, sessions = 1024, 200
    angle = draw(head, key, rate_hz, sessions=sessions, frames=count + 1)
    taper = np.hanning(count + 1)[:-1]
    taper /= np.sqrt(np.sum(taper**2))
    velocity = np.diff(angle, axis=1) * rate_hz * taper[None, :, None]
    density = 2 / rate_hz * np.abs(np.fft.rfft(velocity, axis=1)) ** 2

    # The expected periodogram: the spectrum's covariance, in which what the head
    # remembers for 8 sessions overlaps, seen through the taper.
    fine_hz = np.fft.rfftfreq(8 * count, 1 / rate_hz)
    law = np.asarray(head.sampled_velocity_spectrum(fine_hz, rate_hz))
    covariance = np.fft.irfft(law, axis=0)[: count + 1]
    reach = np.append(np.correlate(taper, taper, "full")[count - 1 :], 0.0)
    law = scipy.fft.dct(reach[:, None] * covariance, type=1, axis=0)
    law = np.asarray(law)[::2]

    # Two bins from 0 the taper lets the spring's notch pass, which is narrower.
    relative = density[:, 2:-1] / law[2:-1]
    bands = np.array_split(np.arange(relative.shape[1]), 12)
    assert_mean(np.stack([relative[:, b].mean(axis=1) for b in bands], axis=1), 1.0)


# --- the tracker and the person ---


def test_a_head_that_does_not_move_shows_the_tracker_alone(key):
    head = eqx.tree_at(
        lambda h: (h.speed_rms_deg_s, *(mode.speed_rms_deg_s for mode in h.resonators)),
        BURSTS,
        ((0.0,) * 3,) * 3,
    )
    angle = draw(head, key, 60.0)
    assert_normal_variance(angle.reshape(-1, 3), np.square(head.tracker_noise_deg))
    assert_mean(np.mean(angle[:, 1:] * angle[:, :-1], axis=1), 0.0)
    # Neither persons nor bursts scale it.
    loud = eqx.tree_at(lambda h: (h.person_sd, h.amplitude.sd), head, (0.5, 0.9))
    np.testing.assert_array_equal(draw(loud, key, 60.0), angle)


def test_persons_scale_all_axes_and_parts_together(key):
    head = quiet(BURSTS)
    varied = eqx.tree_at(lambda h: h.person_sd, head, 0.17)
    ratio = draw(varied, key, 60.0) / draw(head, key, 60.0)
    scale = ratio[:, 0, 0]
    np.testing.assert_allclose(ratio, np.tile(scale[:, None, None], (1, FRAMES, 3)))
    # Lognormal: the logarithm is normal, by its first four moments.
    z = np.log(scale) / 0.17
    for power, moment, variance in ((1, 0, 1), (2, 1, 2), (3, 0, 15), (4, 3, 96)):
        error = (np.mean(z**power) - moment) / np.sqrt(variance / len(z))
        assert abs(error) < LARGEST_Z
    assert varied.person_power == pytest.approx(np.exp(2 * 0.17**2), rel=1e-15)


# --- the amplitude ---

# Parts that forget at once: each angle is a frame's driving noise, so draws with
# bursts over draws without are the amplitude.
FORGETFUL = Parts(
    jnp.ones((1, 3)),
    drift=jnp.tile(-1e6 * jnp.eye(2), (1, 3, 1, 1)),
    diffusion=jnp.tile(2e6 * jnp.eye(2), (1, 3, 1, 1)),
    stationary=jnp.tile(jnp.eye(2), (1, 3, 1, 1)),
)


@jax.jit
def amplitudes(key, sd, correlation_time_s, rate_hz):
    """Amplitude of each frame per session and axis, `(sessions, frames, 3)`."""

    def path(key, sd):
        bursts = Amplitude(sd, correlation_time_s)
        still = jnp.zeros(3), jnp.zeros(())
        return sampling.draw(key, FORGETFUL, *still, bursts, 1 / rate_hz, FRAMES)

    def ratio(key):
        moved, still = jax.vmap(path, (None, 0))(key, jnp.stack([sd, 0 * sd]))
        return moved / still

    return jax.lax.map(ratio, jax.random.split(key, SESSIONS))


@pytest.mark.parametrize("rate_hz", [30.0, 1000.0])
def test_amplitudes_have_the_law_of_their_logarithm(key, rate_hz):
    sd, correlation_time_s = 0.3, 0.4
    numbers = (jnp.asarray(x) for x in (sd, correlation_time_s, rate_hz))
    amplitude = np.asarray(amplitudes(key, *numbers))
    # All axes have the same; quotients round.
    same = np.tile(amplitude[:, :, :1], (1, 1, 3))
    np.testing.assert_allclose(amplitude, same, rtol=1e-9)
    level = (np.log(amplitude[:, :, 0]) + sd**2) / sd
    for frame in (0, 1, 50, -1):  # stationary from the first frame on
        assert_mean(level[:, frame], 0.0)
        assert_normal_variance(level[:, frame], 1.0)
    for lag in (1, 5, 25):
        law = np.exp(-lag / rate_hz / correlation_time_s)
        assert_mean(np.mean(level[:, lag:] * level[:, :-lag], axis=1), law)
        steps = level[:, lag:] - level[:, :-lag]
        assert_mean(np.mean(steps**2, axis=1), 2 * (1 - law))
    assert_mean(np.mean(amplitude[:, :, 0] ** 2, axis=1), 1.0)


def test_an_amplitude_without_spread_leaves_a_gaussian_path(key):
    # Its correlation time has nothing left to act on: to the bit.
    still = lambda time: eqx.tree_at(
        lambda h: (h.amplitude.sd, h.amplitude.correlation_time_s), BURSTS, (0.0, time)
    )
    angle = draw(still(0.4), key, 60.0)
    np.testing.assert_array_equal(angle, draw(still(7.0), key, 60.0))
    increments = np.diff(angle, axis=1)[:, 10::30]
    squares = np.mean(increments**2, axis=(0, 1))
    fourth = np.mean(increments**4, axis=1) / squares**2
    # The kurtosis of normal increments, of which 3 in a session covary a little.
    assert_mean(fourth, 3.0)
    np.testing.assert_allclose(
        draw(eqx.tree_at(lambda h: h.amplitude.sd, still(0.4), 1e-9), key, 60.0),
        angle,
        atol=1e-6,
    )
