from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from jax.random import clone
from jax.test_util import check_grads

from hmdjit import quaternion
from hmdjit.head_motion import HeadMotion
from hmdjit.head_motion.base import discretise

# Two-sided tests on normal statistics at 5 standard errors: false alarms 6e-7 each.
LARGEST_Z = 5.0


@pytest.fixture
def head():
    return HeadMotion.seated()


@pytest.fixture
def median_person(head):
    return eqx.tree_at(lambda h: h.person_sd, head, 0.0)


def float32_of(tree):
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), tree)


@partial(jax.jit, static_argnames=("frames", "sessions"))
def draw_deg(head, key, rate_hz, frames, sessions):
    sample = lambda key: head.rotation_vectors(key, rate_hz, frames)
    return jnp.degrees(jax.vmap(sample)(jax.random.split(key, sessions)))


def draw(head, key, rate_hz, frames=31, sessions=4000):
    """Rotation vectors in deg, shape (sessions, frames, 3)."""
    return np.asarray(draw_deg(head, clone(key), rate_hz, frames, sessions))


def assert_covariance(left, right, variances, covariance):
    """Pairs of zero-mean normal draws, axis 0, have the covariance, by a z-test."""
    error = np.mean(left * right, axis=0) - covariance
    standard_error = np.sqrt((variances + covariance**2) / len(left))
    np.testing.assert_array_less(np.abs(error / standard_error), LARGEST_Z)


# --- discretisation ---


def double_integrator(spring):
    """In units of the correlation time: x' = v - spring x, v' = -v + white."""
    drift = np.array([[-spring, 1.0], [0.0, -1.0]])
    return drift, np.array([[0.0, 0.0], [0.0, 2.0]])


def exact_double_integrator(spring, dt):
    """Closed form, with 80 digits to spare for its cancellations."""
    with mpmath.workdps(80):
        b, dt = mpmath.mpf(spring), mpmath.mpf(dt)
        fast, slow = mpmath.exp(-dt), mpmath.exp(-b * dt)
        transition = mpmath.matrix([[slow, (slow - fast) / (1 - b)], [0, fast]])
        both = 1 / (1 + b)
        stationary = mpmath.matrix([[both / b, both], [both, 1]])
        noise = stationary - transition * stationary * transition.T
        change = transition - mpmath.eye(2)
        return [np.array(m.tolist(), float) for m in (change, noise)]


def head_and_neck():
    """Slow velocity and two resonators integrated to an angle, entries near 1."""
    drift = scipy.linalg.block_diag(
        -0.5, [[0, 2.0], [-2.0, -0.9]], [[0, 3.0], [-3.0, -0.4]], -0.01
    )
    drift[5, 0:5:2] = 1.0
    return drift, np.diag([1.0, 0.0, 2.0, 0.0, 0.5, 0.0])


def van_loan(drift, diffusion, dt):
    size = len(drift)
    block = np.block([[-drift, diffusion], [np.zeros_like(drift), drift.T]])
    exponential = scipy.linalg.expm(block * dt)
    transition = exponential[size:, size:].T
    return transition - np.eye(size), transition @ exponential[:size, size:]


@pytest.mark.parametrize("spring", [1e-8, 1e-3, 0.5, 100.0])
@pytest.mark.parametrize(("dtype", "rtol"), [(np.float64, 1e-14), (np.float32, 3e-6)])
def test_discretisation_is_exact_from_tiny_to_huge_steps(spring, dtype, rtol):
    drift, diffusion = (jnp.asarray(m, dtype) for m in double_integrator(spring))
    for dt in 10.0 ** np.arange(-9, 6.5, 0.5):
        change, noise = discretise(drift, diffusion, jnp.asarray(dt, dtype))
        exact_change, exact_noise = exact_double_integrator(
            float(drift[0, 0]) * -1, float(jnp.asarray(dt, dtype))
        )
        np.testing.assert_allclose(noise, exact_noise, rtol=rtol)
        # What has been forgotten need not keep relative precision.
        atol = 0.0 if dt <= 1 else rtol
        np.testing.assert_allclose(change, exact_change, rtol=rtol, atol=atol)


@pytest.mark.parametrize("dt", [1e-9, 1e-4, 0.01, 0.3, 2.0, 5.0])
def test_discretisation_agrees_with_van_loan(dt):
    drift, diffusion = head_and_neck()
    oracle_change, oracle_noise = van_loan(drift, diffusion, dt)
    change, noise = discretise(jnp.asarray(drift), jnp.asarray(diffusion), dt)
    scale = np.max(np.abs(oracle_noise))
    # The oracle itself subtracts the identity.
    np.testing.assert_allclose(change, oracle_change, rtol=1e-10, atol=1e-15)
    np.testing.assert_allclose(noise, oracle_noise, rtol=1e-10, atol=1e-13 * scale)


@pytest.mark.parametrize("dt", [1e-9, 1e-4, 0.01, 0.3, 2.0, 50.0, 1e4])
def test_discretisation_in_float32_agrees_with_float64(dt):
    exact = [jnp.asarray(m) for m in (*head_and_neck(), dt)]
    rounded = float32_of(exact)
    exact = [jnp.asarray(m, jnp.float64) for m in rounded]
    for ours, oracle in zip(discretise(*rounded), discretise(*exact), strict=True):
        scale = np.max(np.abs(oracle))
        np.testing.assert_allclose(ours, oracle, rtol=1e-5, atol=1e-6 * scale)


@given(st.floats(-6, 3), st.floats(-6, 3))
@settings(max_examples=50)
def test_two_steps_are_one_long_step(exponent, other_exponent):
    drift, diffusion = map(jnp.asarray, head_and_neck())
    first, second = 10.0**exponent, 10.0**other_exponent
    change, noise = discretise(drift, diffusion, first)
    later_change, later_noise = discretise(drift, diffusion, second)
    both_change, both_noise = discretise(drift, diffusion, first + second)
    later = jnp.eye(6) + later_change
    np.testing.assert_allclose(
        both_change, change + later_change + later_change @ change, atol=1e-12
    )
    carried = later @ noise @ later.T
    scale = float(jnp.max(jnp.abs(both_noise)))
    np.testing.assert_allclose(
        both_noise, carried + later_noise, rtol=1e-11, atol=1e-12 * scale
    )


def test_gradients_of_the_discretisation_are_correct():
    for dt in (1e-3, 0.05, 0.7, 4.0):
        arguments = tuple(jnp.asarray(m) for m in (*double_integrator(0.1), dt))
        # Central differences with steps of 6e-6 err by about 1e-10.
        check_grads(discretise, arguments, 1, modes=("fwd", "rev"), rtol=1e-6)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_gradients_of_the_discretisation_are_finite(dtype):
    drift, diffusion = (jnp.asarray(m, dtype) for m in double_integrator(0.1))
    jacobians = jax.vmap(jax.jacrev(discretise, argnums=(0, 1, 2)), (None, None, 0))
    steps = jnp.array([0.0, 1e-9, 1e6], dtype)
    for leaf in jax.tree.leaves(jacobians(drift, diffusion, steps)):
        assert jnp.isfinite(leaf).all()


# --- the drawn process against its laws ---


@pytest.mark.parametrize("rate_hz", [60.0, 1000.0])
def test_first_and_last_angle_are_stationary(median_person, key, rate_hz):
    angle = draw(median_person, key, rate_hz)
    law = median_person.covariance(0.0) + np.square(median_person.tracker_noise_deg)
    for frame in (0, -1):
        assert_covariance(angle[:, frame], angle[:, frame], law**2, law)


@pytest.mark.parametrize("rate_hz", [60.0, 120.0])
def test_the_same_process_at_every_rate(median_person, key, rate_hz):
    frames = round(0.1 * rate_hz)
    angle = draw(median_person, key, rate_hz)
    turned = angle[:, frames] - angle[:, 0]
    law = 2 * (median_person.covariance(0.0) - median_person.covariance(0.1))
    law = law + 2 * np.square(median_person.tracker_noise_deg)
    assert_covariance(turned, turned, law**2, law)


def test_drawn_angles_have_their_covariance(median_person, key):
    # A short return time, so that lags within a session tell spring and speed apart.
    head = eqx.tree_at(lambda h: h.return_time_s, median_person, 0.3)
    angle = draw(head, key, 60.0)
    variance = head.covariance(0.0) + np.square(head.tracker_noise_deg)
    for lag in (1, 5, 30):
        law = head.covariance(lag / 60)
        assert_covariance(angle[:, 0], angle[:, lag], variance**2, law)


def test_drawn_increments_have_their_covariance(median_person, key):
    increments = np.diff(draw(median_person, key, 90.0), axis=1)
    variance = median_person.increment_covariance(0, 90.0)
    for lag in (0, 1, 2, 10):
        law = median_person.increment_covariance(lag, 90.0)
        assert_covariance(increments[:, 0], increments[:, lag], variance**2, law)


def test_drawn_axes_are_independent(median_person, key):
    increments = np.diff(draw(median_person, key, 90.0), axis=1)[:, 0]
    variance = np.asarray(median_person.increment_covariance(0, 90.0))
    for axis, other in ((0, 1), (1, 2), (2, 0)):
        product = variance[axis] * variance[other]
        assert_covariance(increments[:, axis], increments[:, other], product, 0.0)


@pytest.mark.slow
def test_drawn_speeds_have_their_spectrum(median_person, key):
    frames, sessions, rate_hz = 1025, 200, 90.0
    angle = draw(median_person, key, rate_hz, frames, sessions)
    window = np.hanning(frames)[:-1]
    speed = np.diff(angle, axis=1) * rate_hz * window[None, :, None]
    power = np.abs(np.fft.rfft(speed, axis=1)) ** 2
    density = 2 * power / (rate_hz * np.sum(window**2))
    frequency_hz = np.fft.rfftfreq(frames - 1, 1 / rate_hz)
    law = median_person.sampled_velocity_spectrum(frequency_hz, rate_hz)
    relative = density[:, 1:] / np.asarray(law)[None, 1:]
    frequency_hz = frequency_hz[1:]
    # Bands are many bins (0.09 Hz) wide, so the window's leakage is below 1e-3.
    for low_hz, high_hz in ((1, 3), (3, 8), (8, 20), (20, 44)):
        band = (frequency_hz >= low_hz) & (frequency_hz < high_hz)
        of_session = relative[:, band].mean(axis=1)
        standard_error = of_session.std(axis=0) / np.sqrt(sessions)
        z = (of_session.mean(axis=0) - 1) / standard_error
        np.testing.assert_array_less(np.abs(z), LARGEST_Z)


def test_persons_scale_all_axes_together_but_not_the_tracker(head, key):
    median = eqx.tree_at(lambda h: h.person_sd, head, 0.0)
    quiet = lambda h: eqx.tree_at(lambda h: h.tracker_noise_deg, h, (0.0, 0.0, 0.0))
    frozen = lambda h: eqx.tree_at(lambda h: h.speed_rms_deg_s, h, (0.0, 0.0, 0.0))
    ratio = draw(quiet(head), key, 60.0) / draw(quiet(median), key, 60.0)
    scale = ratio[:, 0, 0]
    np.testing.assert_allclose(ratio, np.tile(scale[:, None, None], (1, 31, 3)))
    np.testing.assert_array_equal(
        draw(frozen(head), key, 60.0), draw(frozen(median), key, 60.0)
    )
    # Lognormal: the logarithm is normal, by its first four moments.
    z = np.log(scale) / 0.17
    for power, moment, variance in ((1, 0, 1), (2, 1, 2), (3, 0, 15), (4, 3, 96)):
        error = (np.mean(z**power) - moment) / np.sqrt(variance / len(z))
        assert abs(error) < LARGEST_Z
    np.testing.assert_allclose(head.person_power, np.exp(2 * 0.17**2), rtol=1e-15)


def test_seated_heads_have_the_speeds_that_were_recorded(head, key, rng):
    turned = np.diff(np.radians(draw(head, key, 90.0)), axis=1)
    speed = np.degrees(np.linalg.norm(turned, axis=-1)) * 90
    variance = np.asarray(head.increment_covariance(0, 90.0))
    tracker = 2 * np.square(head.tracker_noise_deg)
    law = head.person_power * np.sum(variance - tracker) + np.sum(tracker)
    # Within a second speeds are correlated: the sessions' spread bounds the error.
    power = np.mean(speed**2, axis=1)
    z = (np.mean(power) - law * 90**2) / (np.std(power) / np.sqrt(len(power)))
    assert abs(z) < LARGEST_Z

    # The law of one frame, drawn independently; both medians err by about 0.01.
    persons = np.exp(0.17 * rng.normal(size=(100_000, 1)))
    sd = np.sqrt(persons**2 * (variance - tracker) + tracker)
    one_frame = np.linalg.norm(sd * rng.normal(size=sd.shape), axis=1) * 90
    for share in (0.5, 0.95):
        expected = np.quantile(one_frame, share)
        assert np.quantile(speed, share) == pytest.approx(expected, abs=0.05)

    # Recorded: RMS 1.8-2.0 and 95th percentile 3.1-3.5 deg/s, 0.020-0.022 deg per
    # frame. The recorded median, 1.35-1.5, is below any Gaussian's of that RMS.
    assert np.sqrt(law) * 90 == pytest.approx(1.89, abs=0.02)
    assert 3.1 < np.quantile(one_frame, 0.95) < 3.5
    assert 0.020 < head.increment_rms_deg(90.0) < 0.022
    np.testing.assert_allclose(head.increment_rms_deg(90.0) ** 2, np.sum(variance))


# --- the laws among themselves ---


def test_covariance_agrees_with_its_closed_form(head):
    lags_s = np.array([0.0, 1e-6, 0.01, 0.1, 1.0, 30.0])
    a, b = 1 / np.array(head.correlation_time_s), 1 / 15.0
    lags = lags_s[:, None]
    law = (a * np.exp(-b * lags) - b * np.exp(-a * lags)) / (b * (a**2 - b**2))
    law = np.square(head.speed_rms_deg_s) * law
    np.testing.assert_allclose(head.covariance(lags_s), law, rtol=1e-13)
    np.testing.assert_allclose(head.covariance(-lags_s), law, rtol=1e-13)


@pytest.mark.parametrize("rate_hz", [60.0, 1000.0])
@pytest.mark.parametrize("return_time_s", [15.0, 0.124])
def test_increments_are_differences_of_angles(head, rate_hz, return_time_s):
    head = eqx.tree_at(lambda h: h.return_time_s, head, return_time_s)
    lags = np.array([0, 1, 2, 7, 300, -2])
    angle = lambda steps: np.asarray(head.covariance(steps / rate_hz))
    law = 2 * angle(lags) - angle(lags + 1) - angle(lags - 1)
    tracker = np.square(head.tracker_noise_deg)
    law[0] += 2 * tracker
    law[1] -= tracker
    # The oracle's subtraction leaves eps of the angle's variance.
    ours = head.increment_covariance(lags, rate_hz)
    np.testing.assert_allclose(ours, law, rtol=1e-12, atol=2e-15)


def test_sampled_spectrum_is_the_continuous_one_with_its_aliases(head):
    rate_hz = 90.0
    frequency_hz = np.array([0.01, 0.5, 3.0, 11.0, 30.0, 45.0])
    aliases = np.arange(-3000, 3001) * rate_hz
    folded = np.abs(frequency_hz[:, None] + aliases)
    density = np.asarray(head.velocity_spectrum(folded))
    law = np.sum(density * np.sinc(folded / rate_hz)[..., None] ** 2, axis=1)
    noise = 8 * np.square(head.tracker_noise_deg) * rate_hz
    law = law + noise * np.sin(np.pi * frequency_hz / rate_hz)[:, None] ** 2
    ours = head.sampled_velocity_spectrum(frequency_hz, rate_hz)
    # Terms fall as m^-4: those left out are below 1e-11 of the first.
    np.testing.assert_allclose(ours, law, rtol=1e-9)


def test_spectra_integrate_to_variances(head):
    # Half-way points integrate a smooth periodic function to rounding; the spring's
    # notch at 0 is 0.01 Hz wide.
    count = 2**18
    frequency_hz = (np.arange(count) + 0.5) * 45.0 / count
    density = head.sampled_velocity_spectrum(frequency_hz, 90.0)
    variance = np.sum(density, axis=0) * 45.0 / count
    law = head.increment_covariance(0, 90.0) * 90.0**2
    np.testing.assert_allclose(variance, law, rtol=1e-9)


def test_laws_in_float32_agree_with_float64(head):
    head = float32_of(head)
    exact = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), head)
    frequency_hz = np.linspace(0.25, 500, 40).astype(np.float32)
    lags = np.array([0, 1, 2, 500])
    for law in (
        lambda h: h.covariance(np.array([0.0, 0.125, 8.0], np.float32)),
        lambda h: h.velocity_spectrum(frequency_hz),
        lambda h: h.sampled_velocity_spectrum(frequency_hz, 1000.0),
        lambda h: h.increment_rms_deg(1000.0),
    ):
        assert law(head).dtype == jnp.float32
        np.testing.assert_allclose(law(head), law(exact), rtol=1e-5)
    ours = np.asarray(head.increment_covariance(lags, 1000.0))
    oracle = np.asarray(exact.increment_covariance(lags, 1000.0))
    variance = np.max(np.abs(oracle), axis=0)
    assert np.all(np.abs(ours - oracle) < 1e-5 * variance)


# --- precision, reproducibility, derivatives ---


def test_float32_poses_keep_the_increments(head, key):
    path = head.rotation_vectors(clone(key), 1000.0, 2000, dtype=jnp.float32)
    poses = head.sample(key, 1000.0, 2000, dtype=jnp.float32)
    exact = jax.vmap(quaternion.exp)(jnp.asarray(path, jnp.float64))
    kept = np.asarray(quaternion.increments(poses))
    error = kept - np.asarray(quaternion.increments(exact))
    # Vector parts below 2^-5 round by up to 2^-30 = 9e-10, in 8 places, doubled by log;
    # evenly spread, that is 9e-10 / sqrt(3) each.
    assert np.max(np.abs(path)) < 2**-4
    assert np.max(np.abs(error)) < 16 * 2**-30
    assert np.sqrt(np.mean(error**2)) < 2 * np.sqrt(8 / 3) * 2**-30


def test_float32_sampling_keeps_the_law_at_1000_hz(median_person, key):
    head = eqx.tree_at(lambda h: h.tracker_noise_deg, median_person, (0.0,) * 3)
    head = float32_of(head)
    angle = draw(head, key, 1000.0)
    assert angle.dtype == np.float32
    increments = np.diff(angle.astype(float), axis=1)[:, -1]
    law = np.asarray(head.increment_covariance(0, 1000.0), float)
    assert_covariance(increments, increments, law**2, law)


def test_sessions_depend_on_their_key_alone(head, key):
    keys = jax.vmap(lambda i: jax.random.fold_in(key, i))(jnp.arange(4))
    sample = lambda key: head.sample(key, 60.0, 8)
    batch = jax.lax.map(sample, clone(keys))
    np.testing.assert_array_equal(jax.lax.map(sample, clone(keys[1:3])), batch[1:3])
    # Another program may round elsewhere: some eps of 8 frames near 1.
    alone = sample(jax.random.fold_in(clone(key), 3))
    np.testing.assert_allclose(alone, batch[3], atol=1e-14)
    assert np.unique(np.asarray(batch)[:, 0, 1]).size == 4
    np.testing.assert_allclose(jnp.linalg.norm(batch, axis=-1), 1.0, rtol=1e-14)


def test_dtype_follows_the_model_or_the_caller(head, key):
    type_of = lambda head, dtype=None: (
        jax.eval_shape(lambda: head.sample(key, 60.0, 2, dtype=dtype)).dtype
    )
    assert type_of(head) == jnp.result_type(float)
    assert type_of(head, jnp.float32) == jnp.float32
    assert type_of(float32_of(head)) == jnp.float32
    assert head.sample(key, 60.0, 1).shape == (1, 4)


def test_a_sweep_compiles_once(head, key):
    @jax.jit
    @eqx.debug.assert_max_traces(max_traces=1)
    def last_pose(head, rate_hz):
        return head.sample(clone(key), rate_hz, 7)[-1]

    for speed in (0.5, 1.0, 2.0):
        swept = eqx.tree_at(lambda h: h.speed_rms_deg_s[1], head, speed)
        assert jnp.isfinite(last_pose(swept, 30.0 * speed)).all()


@pytest.mark.slow
def test_gradients_of_a_session_are_correct(head, key):
    leaves, structure = jax.tree.flatten(head)
    weights = jnp.asarray(np.linspace(-1, 1, 18).reshape(6, 3))

    @jax.jit
    def score(leaves, rate_hz):
        drawn = jax.tree.unflatten(structure, leaves)
        path = drawn.rotation_vectors(clone(key), rate_hz, 6)
        return jnp.sum(weights * path) * 1e3

    leaves = [jnp.asarray(leaf) for leaf in leaves]
    for rate_hz in (60.0, 1000.0):
        arguments = (leaves, jnp.asarray(rate_hz))
        # The tracker's leaves are near 4e-3: steps of 1e-6 still see straight lines.
        check_grads(score, arguments, 1, ("fwd", "rev"), rtol=1e-5, eps=1e-6)


@pytest.mark.parametrize(
    "dtype", [jnp.float32, pytest.param(jnp.float64, marks=pytest.mark.slow)]
)
def test_gradients_of_poses_are_finite(head, key, dtype):
    @jax.jit
    @jax.grad
    def gradient(head):
        poses = head.sample(clone(key), 1000.0, 5, dtype=dtype)
        return jnp.sum(quaternion.increments(poses) ** 2)

    for correlation_time_s in (1e-9, 0.1, 1e6):
        times = (correlation_time_s, 0.1, 0.03)
        varied = eqx.tree_at(lambda h: h.correlation_time_s, head, times)
        assert all(np.isfinite(leaf) for leaf in jax.tree.leaves(gradient(varied)))


@pytest.mark.slow
def test_laws_have_gradients_where_spring_and_speed_agree(head):
    same = eqx.tree_at(lambda h: h.return_time_s, head, head.correlation_time_s[0])

    @jax.jit
    def laws(return_time_s):
        varied = eqx.tree_at(lambda h: h.return_time_s, same, return_time_s)
        angle = varied.covariance(0.1)[0]
        increment = varied.increment_covariance(3, 90.0)[0]
        density = varied.sampled_velocity_spectrum(3.0, 90.0)[0]
        return jnp.stack([angle, increment, density])

    step_s = 1e-5
    slopes = (laws(0.1 + step_s) - laws(0.1 - step_s)) / (2 * step_s)
    # Central differences at 0.1 s err by (1e-5 / 0.1)^2.
    np.testing.assert_allclose(jax.jacrev(laws)(0.1), slopes, rtol=1e-7)


# --- what is refused ---


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        (
            "speed_rms_deg_s",
            (1.0, -1.0, 1.0),
            r"\(yaw\) must lie in \[0, inf\), got -1",
        ),
        ("correlation_time_s", (0.0, 1.0, 1.0), r"\(pitch\) must lie in \(0, inf\)"),
        ("correlation_time_s", (1.0, 1.0, np.inf), r"\(roll\) must lie in .* got inf"),
        ("tracker_noise_deg", (1.0, 1.0, np.nan), r"\(roll\) must lie in .* got nan"),
        ("tracker_noise_deg", (1.0, 1.0), r"must have 3 numbers .* got 2\."),
        ("return_time_s", 0.0, r"must lie in \(0, inf\), got 0\."),
        ("person_sd", -0.1, r"must lie in \[0, inf\), got -0\.1\."),
    ],
)
def test_parameters_out_of_range_are_refused(head, field, value, message):
    with pytest.raises(ValueError, match=field + r" ?" + message):
        HeadMotion(**{**vars(head), field: value})


def test_requests_out_of_range_are_refused(head, key):
    with pytest.raises(ValueError, match=r"rate_hz must lie in \(0, inf\), got 0\."):
        head.sample(key, 0.0, 5)
    with pytest.raises(ValueError, match=r"rate_hz must lie in \(0, inf\), got -1\."):
        head.increment_covariance(0, -1.0)
    with pytest.raises(ValueError, match="frames must be a whole number >= 1, got 0"):
        head.sample(key, 60.0, 0)


def test_parameters_may_be_arrays_and_tracers(key):
    seated = HeadMotion.seated()
    speeds = jnp.array(seated.speed_rms_deg_s)

    @jax.vmap
    def poses(speeds):
        head = HeadMotion(**{**vars(seated), "speed_rms_deg_s": speeds})
        return head.sample(clone(key), 60.0, 2)

    swept = poses(jnp.stack([speeds, 0 * speeds]))
    expected = seated.sample(clone(key), 60.0, 2)
    np.testing.assert_allclose(swept[0], expected, atol=1e-14)
