from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from heads import models
from jax.random import clone
from jax.test_util import check_grads

from hmdjit import quaternion
from hmdjit.head_motion import Amplitude, HeadMotion, presets

# Two-sided tests on normal statistics at 5 standard errors: false alarms 6e-7 each.
LARGEST_Z = 5.0

MODELS = models(person_sd=0.2)
MODEL_A, MODEL_B, BURSTS = MODELS.values()

every_model = pytest.mark.parametrize("head", MODELS.values(), ids=MODELS)
without_bursts = pytest.mark.parametrize(
    "head", [pytest.param(MODEL_A, marks=pytest.mark.slow), MODEL_B], ids=["A", "B"]
)


def typed(head, dtype):
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), head)


@partial(jax.jit, static_argnames=("frames", "sessions"))
def increments_deg(head, key, rate_hz, frames, sessions):
    sample = lambda key: head.rotation_vectors(key, rate_hz, frames)
    path = jax.lax.map(sample, jax.random.split(key, sessions))
    return jnp.degrees(jnp.diff(path, axis=1))


FRAMES_AND_SESSIONS = 2000, 150  # one program for all


# --- presets ---


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name == "fixating" else pytest.mark.slow)
        for name in presets.tables()
    ],
)
def test_presets_have_the_speeds_of_their_law(name, key):
    head, rate_hz = HeadMotion.preset(name), 60.0
    turned = increments_deg(head, key, rate_hz, *FRAMES_AND_SESSIONS)
    power = np.sum(np.square(turned), axis=2).mean(axis=1)
    tracker = 2 * np.square(np.array(head.tracker_noise_deg))
    variance = np.asarray(head.increment_covariance(0, rate_hz))
    law = float(head.person_power) * np.sum(variance - tracker) + np.sum(tracker)
    # Mean squares of 33 s of bursts and of persons are skew by 2 or so, their mean by
    # 0.2: false alarms below 1e-4.
    z = (np.mean(power) - law) / (np.std(power) / np.sqrt(len(power)))
    assert abs(z) < LARGEST_Z
    assert head.increment_rms_deg(rate_hz) ** 2 == pytest.approx(np.sum(variance))


# --- the laws: those of the parts, and the tracker ---


def closed_covariance(head, lag_s):
    """Of the angle, deg^2: an underdamped or overdamped mode by complex numbers."""
    a, b = 1 / np.array(head.correlation_time_s), 1 / head.return_time_s
    law = (a * np.exp(-b * lag_s) - b * np.exp(-a * lag_s)) / (b * (a**2 - b**2))
    law = np.square(head.speed_rms_deg_s) * law
    for mode in head.resonators:
        z, w = np.array(mode.damping), 2 * np.pi * np.array(mode.frequency_hz)
        k = w * np.emath.sqrt(1 - z**2)
        swing = np.real(np.cos(k * lag_s) + z * w / k * np.sin(k * lag_s))
        unit = np.square(mode.speed_rms_deg_s) / w**2
        law = law + unit * np.exp(-z * w * lag_s) * swing
    return law


@pytest.mark.slow
@without_bursts
def test_covariance_agrees_with_its_closed_form(head):
    lags_s = np.array([0.0, 1e-6, 0.01, 0.1, 1.0, 30.0])
    law = closed_covariance(head, lags_s[:, None])
    for lags in (lags_s, -lags_s):
        # Resonances cross 0; both cosines round.
        np.testing.assert_allclose(head.covariance(lags), law, rtol=1e-13, atol=1e-14)
    assert head.covariance(0.1).shape == (3,)
    turned = 2 * (law[0] - law[3:])  # loses 2 digits at 10 ms
    np.testing.assert_allclose(head.structure_function(lags_s[3:]), turned, rtol=1e-12)


@without_bursts
@pytest.mark.parametrize("rate_hz", [60.0, 1000.0])
def test_increments_are_differences_of_angles_and_of_noise(head, rate_hz):
    lags = np.array([0, 1, 2, 7, 300, -1])
    angle = lambda steps: closed_covariance(head, np.abs(steps)[:, None] / rate_hz)
    law = 2 * angle(lags) - angle(lags + 1) - angle(lags - 1)
    tracker = np.square(head.tracker_noise_deg)
    law += np.multiply.outer([2, -1, 0, 0, 0, -1], tracker)
    # The oracle's subtraction leaves eps of the angle's variance.
    ours = head.increment_covariance(lags, rate_hz)
    np.testing.assert_allclose(ours, law, rtol=1e-12, atol=4e-15)
    np.testing.assert_allclose(
        head.increment_rms_deg(rate_hz), np.sqrt(np.sum(law[0])), rtol=1e-9
    )


@without_bursts
def test_sampled_spectrum_has_aliases_and_the_trackers_noise(head):
    rate_hz, frequency_hz = 90.0, np.array([0.01, 0.5, 3.0, 11.0, 30.0, 45.0])
    folded = np.abs(frequency_hz[:, None] + np.arange(-3000, 3001) * rate_hz)
    density = np.asarray(head.velocity_spectrum(folded))
    law = np.sum(density * np.sinc(folded / rate_hz)[..., None] ** 2, axis=1)
    noise = 8 * np.square(head.tracker_noise_deg) * rate_hz
    law = law + noise * np.sin(np.pi * frequency_hz / rate_hz)[:, None] ** 2
    ours = head.sampled_velocity_spectrum(frequency_hz, rate_hz)
    # Terms fall as m^-4: those left out are below 1e-11 of the first.
    np.testing.assert_allclose(ours, law, rtol=1e-9)


def test_neither_bursts_nor_persons_change_the_laws():
    calm = eqx.tree_at(lambda h: h.person_sd, MODEL_B, 0.0)
    for head in (BURSTS, calm):
        law = head.increment_covariance(0, 60.0)
        np.testing.assert_array_equal(law, MODEL_B.increment_covariance(0, 60.0))
    assert calm.person_power == 1
    assert MODEL_B.person_power == pytest.approx(np.exp(2 * 0.2**2), rel=1e-15)


def test_a_heads_words_name_its_model_and_its_resonances():
    assert str(MODEL_A).startswith("model A, speed 1.12/0.91/0.93 deg/s, correlation")
    assert "0.0037/0.0036/0.0034 deg (pitch/yaw/roll)" in str(MODEL_A)
    assert str(BURSTS).startswith("model B")
    assert str(BURSTS).endswith("resonance of 0.45/0.35/0.3 deg/s at 8/4.1/11.4 Hz")


def test_a_gradient_is_not_told_as_a_head():
    a_slope = lambda head: 0.3 * head.person_sd - 0.046 * head.correlation_time_s[0]
    slopes = jax.grad(a_slope)(MODEL_A)
    for numbers in (slopes, jax.tree.map(lambda x: -float(x), slopes)):
        assert "model" not in str(numbers)
    assert "correlation_time_s=(-0.046, " in str(slopes)
    # Tracers have no value yet.
    jax.eval_shape(lambda head: (str(head), 0)[1], MODEL_A)


# --- bursts ---


def turn_memory(head, axis, rate_hz, frames):
    """Variance that a frame's noise gives to the turn 0, 1, ... frames later, deg^2."""
    a, b = 1 / head.correlation_time_s[axis], 1 / head.return_time_s
    s = head.speed_rms_deg_s[axis]
    systems = [([[-b, 1.0], [0.0, -a]], 2 * a * s**2)]
    for mode in head.resonators:
        s, w = mode.speed_rms_deg_s[axis], 2 * np.pi * mode.frequency_hz[axis]
        z = mode.damping[axis]
        systems.append(([[0.0, 1.0], [-(w**2), -2 * z * w]], 4 * z * w * s**2))
    total = np.zeros(frames)
    for drift, power in systems:
        drift, diffusion = np.array(drift), np.diag([0.0, power])
        block = np.block([[-drift, diffusion], [np.zeros((2, 2)), drift.T]]) / rate_hz
        exponential = scipy.linalg.expm(block)
        transition = exponential[2:, 2:].T
        noise = transition @ exponential[:2, 2:]
        total[0] += noise[0, 0]
        turn = transition[0] - [1, 0]
        for lag in range(1, frames):
            total[lag] += turn @ noise @ turn
            noise = transition @ noise @ transition.T
    return total


@pytest.mark.parametrize("rate_hz", [60.0, 200.0])
def test_kurtosis_is_that_of_mixed_normal_turns(rate_hz):
    frames = 15
    ours = BURSTS.increment_kurtosis(rate_hz, memory_s=frames / rate_hz)
    for axis in range(3):
        given = turn_memory(BURSTS, axis, rate_hz, frames)
        spread = 0.0
        for i in range(frames):
            for j in range(frames):
                correlation = np.exp(-abs(i - j) / rate_hz / 0.4)
                # Covariance of exp(2 sd m - 2 sd^2) at correlated standard normal m.
                shared = np.exp(4 * 0.3**2 * correlation) - 1
                spread += given[i] * given[j] * shared
        variance = np.sum(given) + 2 * BURSTS.tracker_noise_deg[axis] ** 2
        # The oracle subtracts the identity from transitions.
        np.testing.assert_allclose(ours[axis], 3 * spread / variance**2, rtol=1e-9)


def test_kurtosis_is_zero_without_bursts():
    calm = eqx.tree_at(lambda h: h.amplitude.sd, BURSTS, 0.0)
    for head in (MODEL_A, MODEL_B, calm):
        kurtosis = head.increment_kurtosis(60.0, memory_s=0.25)
        np.testing.assert_array_equal(kurtosis, np.zeros(3))


@pytest.mark.parametrize(
    ("rate_hz", "frames", "sessions"),
    [
        (30.0, *FRAMES_AND_SESSIONS),
        pytest.param(90.0, 6000, 200, marks=pytest.mark.slow),
    ],
)
def test_drawn_increments_have_their_kurtosis(key, rate_hz, frames, sessions):
    head = eqx.tree_at(lambda h: h.person_sd, BURSTS, 0.0)
    turned = np.asarray(increments_deg(head, key, rate_hz, frames, sessions))
    # After 6 s the slowest mode, of 0.05 at 2.4 Hz, remembers exp(-4) of the start.
    turned = turned[:, round(6 * rate_hz) :]
    variance = np.asarray(head.increment_covariance(0, rate_hz))
    kurtosis = np.asarray(head.increment_kurtosis(rate_hz, memory_s=8.0))
    fourth = np.mean(turned**4, axis=1) / variance**2
    error = np.std(fourth, axis=0, ddof=1) / np.sqrt(sessions)
    # Sessions last 60 s, 150 correlation times of bursts: the mean of all is skew by
    # 0.1 where single 4th powers are skew by 15. False alarms below 1e-5.
    z = (np.mean(fourth, axis=0) - 3 - kurtosis) / error
    np.testing.assert_array_less(np.abs(z), LARGEST_Z)
    np.testing.assert_array_less(error, kurtosis / 6)  # tells bursts from none


@pytest.mark.slow
def test_sessions_start_with_their_kurtosis(key):
    # So many that one amplitude for all that the head remembers, of a kurtosis 0.3
    # higher, would be off by 6 standard errors.
    head = eqx.tree_at(lambda h: h.person_sd, BURSTS, 0.0)
    turned = np.asarray(increments_deg(head, key, 60.0, 3, 160_000))
    variance = np.asarray(head.increment_covariance(0, 60.0))
    fourth = np.mean(turned**4, axis=1) / variance**2
    error = np.std(fourth, axis=0, ddof=1) / np.sqrt(len(fourth))
    # 4th powers are skew by 15, their mean by 0.1: false alarms below 1e-5.
    z = np.mean(fourth, axis=0) - 3 - np.asarray(head.increment_kurtosis(60.0))
    np.testing.assert_array_less(np.abs(z / error), LARGEST_Z)


# --- precision, reproducibility, derivatives ---


@pytest.mark.slow
def test_float32_poses_keep_the_increments(key):
    path = BURSTS.rotation_vectors(clone(key), 1000.0, 2000, dtype=jnp.float32)
    poses = BURSTS.sample(key, 1000.0, 2000, dtype=jnp.float32)
    exact = jax.vmap(quaternion.exp)(jnp.asarray(path, jnp.float64))
    kept = np.asarray(quaternion.increments(poses))
    error = kept - np.asarray(quaternion.increments(exact))
    # Vector parts below 2^-5 round by up to 2^-30 = 9e-10, in 8 places, doubled by log;
    # evenly spread, that is 9e-10 / sqrt(3) each.
    assert np.max(np.abs(path)) < 2**-4
    assert np.max(np.abs(error)) < 16 * 2**-30
    assert np.sqrt(np.mean(error**2)) < 2 * np.sqrt(8 / 3) * 2**-30


@pytest.mark.slow
def test_sessions_depend_on_their_key_alone(key):
    keys = jax.vmap(lambda i: jax.random.fold_in(key, i))(jnp.arange(4))
    sample = lambda key: BURSTS.sample(key, 60.0, 8)
    sessions = jax.jit(lambda keys: jax.lax.map(sample, keys))
    batch = sessions(clone(keys))
    np.testing.assert_array_equal(sessions(clone(keys[::-1]))[::-1], batch)
    # Another program may round elsewhere: some eps of 8 frames near 1.
    alone = sample(jax.random.fold_in(clone(key), 3))
    np.testing.assert_allclose(alone, batch[3], atol=1e-14)
    assert np.unique(np.asarray(batch)[:, 0, 1]).size == 4
    np.testing.assert_allclose(jnp.linalg.norm(batch, axis=-1), 1.0, rtol=1e-14)


@pytest.mark.parametrize(
    "head",
    [pytest.param(MODEL_A, marks=pytest.mark.slow), BURSTS],
    ids=["A", "bursts"],
)
def test_dtype_follows_the_model_or_the_caller(head, key):
    type_of = lambda head, dtype=None: (
        jax.eval_shape(lambda: head.sample(key, 60.0, 2, dtype=dtype)).dtype
    )
    single = typed(head, jnp.float32)
    assert type_of(head) == jnp.result_type(float)
    assert type_of(head, jnp.float32) == jnp.float32
    assert type_of(single) == jnp.float32
    assert jax.eval_shape(lambda: head.sample(key, 60.0, 1)).shape == (1, 4)
    places, lags = np.array([0.5, 3.0]), np.array([0, 1])
    for law in (
        lambda h: h.covariance(places),
        lambda h: h.structure_function(places),
        lambda h: h.increment_covariance(lags, 60.0),
        lambda h: h.velocity_spectrum(places),
        lambda h: h.sampled_velocity_spectrum(places, 60.0),
        lambda h: h.increment_kurtosis(60.0),
        lambda h: h.increment_rms_deg(60.0),
    ):
        assert jax.eval_shape(partial(law, single)).dtype == jnp.float32
        assert jax.eval_shape(partial(law, head)).dtype == jnp.result_type(float)


def test_a_sweep_compiles_once(key):
    # Numbers of a model are leaves, and none of them, nor the rate, is static.
    @jax.jit
    @eqx.debug.assert_max_traces(max_traces=1)
    def draw(head, rate_hz):
        return head.sample(clone(key), rate_hz, 8)

    for value in (0.5, 1.0, 2.0):
        head = jax.tree.map(lambda leaf, value=value: value * leaf, BURSTS)
        assert jnp.isfinite(draw(head, 30.0 * value)).all()


@pytest.mark.slow
@pytest.mark.parametrize("head", [MODEL_A, BURSTS], ids=["A", "bursts"])
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


def _with(where, *values):
    return eqx.tree_at(where, BURSTS, values)


_SPEEDS = lambda h: (
    h.speed_rms_deg_s,
    *(mode.speed_rms_deg_s for mode in h.resonators),
)
SINGULAR = {
    "correlation times": _with(lambda h: (h.correlation_time_s,), (1e-9, 0.1, 1e6)),
    "return at the correlation time": _with(lambda h: (h.return_time_s,), 0.15),
    "dampings": _with(lambda h: (h.resonators[0].damping,), (1e-3, 1.0, 2.0)),
    # At 60 Hz: the Nyquist frequency, the rate and twice the rate.
    "aliases": _with(lambda h: (h.resonators[0].frequency_hz,), (30.0, 60.0, 120.0)),
    "no movement": _with(_SPEEDS, *((0.0,) * 3,) * 3),
    "rest": _with(lambda h: (*_SPEEDS(h), h.tracker_noise_deg), *((0.0,) * 3,) * 4),
    "no spread": _with(lambda h: (h.amplitude.sd, h.person_sd), 0.0, 0.0),
}


@pytest.mark.parametrize(
    "dtype", [jnp.float32, pytest.param(jnp.float64, marks=pytest.mark.slow)]
)
def test_gradients_of_poses_are_finite(key, dtype):
    @jax.jit
    @jax.value_and_grad
    def score(head, rate_hz):
        poses = head.sample(clone(key), rate_hz, 5)
        return jnp.sum(quaternion.increments(poses) ** 2)

    for name, head in SINGULAR.items():
        for rate_hz in (60.0, 1000.0):
            found = score(typed(head, dtype), jnp.asarray(rate_hz, dtype))
            finite = [bool(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(found)]
            assert all(finite), f"{name} at {rate_hz:g} Hz"


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_gradients_of_laws_are_finite(dtype):
    places, lags = np.array([0.25, 3.0, 29.9]), np.array([0, 1, 3])

    @jax.jit
    @jax.value_and_grad
    def score(head):
        return (
            jnp.sum(head.increment_covariance(lags, 60.0))
            + jnp.sum(head.sampled_velocity_spectrum(places, 60.0))
            + jnp.sum(head.increment_kurtosis(60.0, memory_s=0.5))
        )

    for name, head in SINGULAR.items():
        if name == "rest":  # has no kurtosis
            continue
        leaves = jax.tree.leaves(score(typed(head, dtype)))
        assert all(bool(jnp.isfinite(leaf)) for leaf in leaves), name


@pytest.mark.parametrize(
    "dtype", [jnp.float32, pytest.param(jnp.float64, marks=pytest.mark.slow)]
)
def test_at_rest_the_rms_turn_has_gradient_0(dtype):
    # The root of no variance has an infinite slope.
    def turned(speed, noise):
        head = HeadMotion((speed,) * 3, (0.1,) * 3, (noise,) * 3, 15.0, 0.0)
        return head.increment_rms_deg(60.0)

    zero = jnp.zeros((), dtype)
    value, slopes = jax.value_and_grad(turned, (0, 1))(zero, zero)
    assert value == 0
    assert slopes == (0, 0)


def test_laws_of_extreme_heads_keep_their_digits_in_float32():
    # Slow wanders sampled fast, whose squares are 0 in float32; springs faster than the
    # velocity, which cancelled it. The envelope has more of them, against exact laws.
    def laws(numbers):
        speed, time, back = numbers
        axes, bursts = lambda x: (x, x, x), Amplitude(0.4, 0.4)
        head = HeadMotion(
            axes(speed), axes(time), axes(0 * speed), back, 0.0, (), bursts
        )
        found = [
            head.increment_rms_deg(10_000.0),
            head.increment_kurtosis(60.0, memory_s=0.25)[0],
            *head.sampled_velocity_spectrum(np.array([0.0, 1.0]), 10_000.0)[:, 0],
        ]
        return jnp.stack(found)

    values, slopes = jax.jit(laws), jax.jit(jax.jacrev(laws))
    heads = [(0.5, 1e6, 1e6), (1.0, 1e3, 1e-6), (1.0, 1e3, 1e-3), (1.0, 1e6, 1e-3)]
    for numbers in heads:
        single = jnp.asarray(numbers, jnp.float32)
        exact = values(jnp.asarray(single, jnp.float64))
        np.testing.assert_allclose(values(single), exact, rtol=1e-5)
        assert jnp.isfinite(slopes(single)).all()
    # At rest there is no kurtosis, and of the slowest head that of any: it has no unit.
    resting, slowest, any_head = (
        values(jnp.asarray((speed, 0.1, 15.0), jnp.float32))[1]
        for speed in (0.0, 1e-30, 1.0)
    )
    assert resting == 0
    np.testing.assert_allclose(slowest, any_head, rtol=1e-5)


# --- what is refused ---


@pytest.mark.parametrize(
    ("config", "field", "value", "message"),
    [
        (
            MODEL_A,
            "speed_rms_deg_s",
            (1.0, -1.0, 1.0),
            r"\(yaw\) .* \[0, inf\), got -1",
        ),
        (MODEL_A, "speed_rms_deg_s", (1.0,) * 4, r"must have 3 numbers .* got 4\."),
        (
            MODEL_A,
            "correlation_time_s",
            (0.0, 1.0, 1.0),
            r"\(pitch\) .* \(0, inf\), go",
        ),
        (MODEL_A, "correlation_time_s", (1.0, 1.0, np.inf), r"\(roll\) .* got inf"),
        (MODEL_A, "tracker_noise_deg", (1.0, 1.0, np.nan), r"\(roll\) .* got nan"),
        (MODEL_A, "tracker_noise_deg", (1.0, 1.0), r"must have 3 numbers .* got 2\."),
        (MODEL_A, "return_time_s", 0.0, r"must lie in \(0, inf\), got 0\."),
        (MODEL_A, "person_sd", -0.1, r"must lie in \[0, inf\), got -0\.1\."),
        *(
            (MODEL_B.resonators[0], *rest)
            for rest in [
                (
                    "speed_rms_deg_s",
                    (-1.0, 1.0, 1.0),
                    r"\(pitch\) .* \[0, inf\), got -",
                ),
                ("speed_rms_deg_s", (1.0, 1.0), r"must have 3 numbers .* got 2\."),
                ("frequency_hz", (1.0, 0.0, 1.0), r"\(yaw\) .* \(0, inf\), got 0\."),
                ("frequency_hz", (1.0, 1.0, np.inf), r"\(roll\) .* got inf"),
                ("damping", (1.0, 1.0, 0.0), r"\(roll\) .* \(0, inf\), got 0\."),
                ("damping", (np.nan, 1.0, 1.0), r"\(pitch\) .* got nan"),
            ]
        ),
        (BURSTS.amplitude, "sd", -0.1, r"must lie in \[0, inf\), got -0\.1\."),
        (BURSTS.amplitude, "sd", np.nan, r"must lie in \[0, inf\), got nan"),
        (BURSTS.amplitude, "correlation_time_s", 0.0, r".* \(0, inf\), got 0\."),
        (BURSTS.amplitude, "correlation_time_s", np.inf, r".* \(0, inf\), got inf"),
    ],
)
def test_parameters_out_of_range_are_refused(config, field, value, message):
    with pytest.raises(ValueError, match=field + r" ?" + message):
        type(config)(**{**vars(config), field: value})


@every_model
def test_requests_out_of_range_are_refused(head, key):
    with pytest.raises(ValueError, match=r"rate_hz must lie in \(0, inf\), got 0\."):
        head.sample(key, 0.0, 5)
    for request in (
        partial(head.increment_covariance, 0),
        partial(head.sampled_velocity_spectrum, 1.0),
        head.increment_kurtosis,
        head.increment_rms_deg,
    ):
        with pytest.raises(ValueError, match=r"rate_hz must lie in \(0, inf\), got -1"):
            request(-1.0)
    with pytest.raises(ValueError, match="frames must be a whole number >= 1, got 0"):
        head.sample(key, 60.0, 0)


def test_parameters_may_be_arrays_and_tracers(key):
    speeds = jnp.array(BURSTS.speed_rms_deg_s)

    @jax.jit
    @jax.vmap
    def poses(speeds, sd):
        numbers = {
            **vars(BURSTS),
            "speed_rms_deg_s": speeds,
            "amplitude": Amplitude(sd, 0.4),
        }
        return HeadMotion(**numbers).sample(clone(key), 60.0, 8)

    swept = poses(jnp.stack([speeds, 0 * speeds]), jnp.array([0.3, 0.0]))
    expected = BURSTS.sample(clone(key), 60.0, 8)
    np.testing.assert_allclose(swept[0], expected, atol=1e-14)
