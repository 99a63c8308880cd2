"""Fits of the head model: against oracles, on data of known models, and refusals."""

import contextlib
import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
import small
import xarray
from heads import identifiable_within_bounds, traces_of
from scipy.spatial.transform import Rotation

import hmdjit
from hmdjit.head_fitting import errors, fitting, moments, scoring, statistics, whittle
from hmdjit.head_fitting.spectra import Periodograms
from hmdjit.head_motion import Amplitude, HeadMotion, Resonator, Trace, presets
from hmdjit.head_motion.parameters import FitError
from hmdjit.studies import identity

RATE_HZ = 30.0
WANDER = HeadMotion(
    speed_rms_deg_s=(0.9, 0.7, 0.8),
    correlation_time_s=(0.15, 0.2, 0.12),
    tracker_noise_deg=(0.0038, 0.0037, 0.0036),
    return_time_s=8.0,
    person_sd=0.17,
    amplitude=Amplitude(0.4, 0.4),
)
RESONANT = eqx.tree_at(
    lambda h: h.resonators,
    WANDER,
    (Resonator((0.6, 0.6, 0.55), (3.2, 2.7, 3.0), (0.23, 0.175, 0.4)),),
)


@contextlib.contextmanager
def compiled_quickly():
    """Compile without optimising: of what runs once, that takes most of the time."""
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", False)


@pytest.fixture(autouse=True)
def quick_tests_compile_quickly(request):
    is_long = any(map(request.node.get_closest_marker, ("slow", "exhaustive")))
    with contextlib.nullcontext() if is_long else compiled_quickly():
        yield


@pytest.fixture(scope="module")
@compiled_quickly()
def wander_traces():
    return traces_of(WANDER, jax.random.key(7), subjects=6, seconds=20.0)


@functools.cache
def gaussian_traces(return_time_s):
    """Ten equal persons for 2 min without bursts: one program, whatever the spring."""
    head = eqx.tree_at(lambda h: (h.person_sd, h.amplitude), WANDER, (0.0, None))
    head = eqx.tree_at(lambda h: h.return_time_s, head, return_time_s)
    return traces_of(head, jax.random.key(20260101), subjects=10, seconds=120.0)


@pytest.fixture(scope="module")
def wander_fit(wander_traces):
    return hmdjit.fit_heads(wander_traces, order=0)


# --- the deviance ---


def test_residuals_are_roots_of_the_deviance(wander_traces):
    periodograms = Periodograms.of(wander_traces, RATE_HZ)
    data = whittle.data_of(periodograms, 0)
    log_expected = jnp.log(data.power) + np.linspace(-2, 2, data.power.size).reshape(
        data.power.shape
    )
    ratio = np.asarray(data.power / jnp.exp(log_expected))
    deviance = 2 * (ratio - 1 - np.log(ratio)) * np.asarray(data.weight)[:, None, None]
    residuals = small.quickly(whittle.deviance_residuals)(log_expected, data)
    # Where the ratio is within 3 % of 1 the oracle keeps 1e-16 of 1, so 2e-8 in a root.
    np.testing.assert_allclose(residuals**2, deviance, rtol=1e-6, atol=1e-13)
    assert np.all(np.sign(residuals) == np.sign(ratio - 1))


@pytest.mark.parametrize("excess", [0.0, 1e-9, 0.0299999, 0.0300001, 1.0, -3.0])
def test_residuals_have_derivatives_where_data_meet_the_model(wander_traces, excess):
    data = whittle.data_of(Periodograms.of(wander_traces, RATE_HZ), 0)
    at = lambda shift: whittle.deviance_residuals(jnp.log(data.power) - shift, data)[
        0, 0, 0
    ]
    slope = small.quickly(jax.grad(at))(excess)
    # d root / d excess = expm1(e) / root, which tends to sqrt(n).
    weight = np.sqrt(float(data.weight[0]))
    root = np.sqrt(2 * (np.expm1(excess) - excess)) * np.sign(excess)
    tiny = abs(excess) < 1e-6
    oracle = weight * (1.0 if tiny else np.expm1(excess) / root)
    np.testing.assert_allclose(slope, oracle, rtol=1e-6)


def whittle_oracle(log_values, frequency_hz, power):
    """Whittle's deviance of one axis, by the sum over aliases, without leakage."""
    speed, time, noise = np.exp(log_values)
    folded = np.abs(frequency_hz[:, None] + RATE_HZ * np.arange(-30, 31))
    w = 2 * np.pi * folded
    density = 4 * speed**2 * time / (1 + (w * time) ** 2)
    density *= w**2 / (w**2 + 1 / 15.0**2) * np.sinc(folded / RATE_HZ) ** 2
    tracker = 8 * noise**2 * RATE_HZ * np.sin(np.pi * frequency_hz / RATE_HZ) ** 2
    ratio = power / (density.sum(axis=1) + tracker)
    return np.sum(ratio - 1 - np.log(ratio))


@pytest.mark.slow
def test_the_minimum_agrees_with_a_plain_whittle_fit(wander_traces):
    one_person = [
        Trace(trace.t_s, trace.world_from_head, subject="one")
        for trace in wander_traces
    ]
    periodograms = Periodograms.of(one_person, RATE_HZ)
    data = whittle.data_of(periodograms, 0)
    ours = np.asarray(whittle.log_values(whittle.best_search(data, 0), data))
    for axis in range(3):
        power = periodograms.power[:, :, axis].mean(axis=0)
        oracle = scipy.optimize.minimize(
            whittle_oracle,
            np.log([0.8, 0.12, 0.004]),
            (periodograms.frequency_hz, power),
            method="Nelder-Mead",
            options={"xatol": 1e-6, "fatol": 1e-9, "maxiter": 4000},
        )
        # The oracle does not know the taper's leakage, 1 to 2 % of a smooth spectrum.
        np.testing.assert_allclose(ours[:, axis], oracle.x, atol=0.05)


# --- the fit ---


def test_a_search_ends_close_to_the_truth(wander_traces):
    periodograms = Periodograms.of(fitting.still_data(wander_traces)[0], RATE_HZ)
    data = whittle.data_of(periodograms, 0)
    logits = whittle.start_logits(np.asarray(data.log_bounds), 0)[0]
    start = whittle.Search(jnp.asarray(logits), jnp.zeros(6))
    found = whittle.log_values(whittle.refine(start, data), data)
    head = WANDER.speed_rms_deg_s, WANDER.correlation_time_s, WANDER.tracker_noise_deg
    truth = np.array(head, float)
    off = np.abs(np.asarray(found) - np.log(truth)).max(axis=1)
    # Five of the largest standard errors that the whole fit has of each.
    np.testing.assert_array_less(off, [0.6, 1.1, 0.15])


@pytest.mark.slow
def test_a_fit_is_close_to_the_truth_by_its_own_errors(wander_fit):
    leaves = lambda head: np.array(jax.tree.leaves(head), float)
    error = leaves(wander_fit.standard_error)
    fitted = np.isfinite(error)
    z = (leaves(wander_fit.head) - leaves(WANDER))[fitted] / error[fitted]
    # 12 numbers at 5 degrees of freedom: beyond 7 errors in 1 % of such tests.
    assert np.max(np.abs(z)) < 7
    assert wander_fit.clusters == "6 subjects"
    assert wander_fit.subjects == 6
    low, high = leaves(wander_fit.low)[fitted], leaves(wander_fit.high)[fitted]
    assert np.all(low <= leaves(wander_fit.head)[fitted])
    assert np.all(high >= leaves(wander_fit.head)[fitted])


@pytest.mark.slow
def test_a_fit_says_how_sure_its_rotation_is(wander_fit):
    error = wander_fit.head.fit_error
    assert (error.clusters, error.over) == (6, "6 subjects")
    assert {part.fit_error for part in wander_fit[1:4]} == {None}
    # Six people who differ by 0.17: by 0.07, with 5 degrees of freedom to a third.
    assert 0.02 < error.rotation < 0.2
    rotation, truth = (
        float(of.increment_rms_deg(RATE_HZ)) for of in (wander_fit.head, WANDER)
    )
    # At 5 degrees of freedom beyond 7 errors in 0.1 % of such tests.
    assert abs(np.log(rotation / truth)) < 7 * error.rotation


def test_the_rotations_error_is_that_of_what_moves_all_speeds_alike():
    # Alone as unsure as two subjects: the standard error of their mean is s / sqrt(2).
    head = [WANDER.speed_rms_deg_s, WANDER.correlation_time_s, (1e-5,) * 3]
    log_values = np.log(np.array(head, float))
    influence = np.zeros((2, 3, 3))
    influence[:, 0] = np.array([0.1, -0.1])[:, None]
    found = errors._rotation_error(log_values, influence, RATE_HZ)
    assert found == pytest.approx(0.1, rel=1e-4)
    # Times of axes do not move it as much, and the tracker is not known to move.
    influence[:, 0], influence[:, 2] = 0.0, 0.1
    assert errors._rotation_error(log_values, influence, RATE_HZ) < 1e-5


@pytest.mark.slow
def test_one_subject_has_errors_between_its_windows(wander_traces):
    one_person = [
        Trace(trace.t_s, trace.world_from_head, subject="one")
        for trace in wander_traces
    ]
    found = fitting.fit_heads(one_person, order=0)
    assert found.clusters == "48 windows of 1 subjects, between these windows only"
    assert np.isnan(found.standard_error.person_sd)
    assert found.head.person_sd == 0.2
    assert np.all(np.isfinite(np.array(found.standard_error.speed_rms_deg_s)))


@pytest.mark.slow
def test_lost_frames_do_not_change_what_is_fitted(key):
    head = eqx.tree_at(lambda h: h.person_sd, WANDER, 0.0)
    whole = traces_of(head, key, subjects=8, seconds=60.0)
    rng = np.random.default_rng(3)
    lossy = []
    for trace in whole:
        kept = rng.random(len(trace.t_s)) < 0.7
        lossy.append(Trace(trace.t_s[kept], trace.world_from_head[kept]))
    lossy = [
        Trace(t.t_s, t.world_from_head, subject=w.subject)
        for t, w in zip(lossy, whole, strict=True)
    ]
    ours, complete = (
        fitting.fit_heads(lossy, order=0),
        fitting.fit_heads(whole, order=0),
    )
    # Fewer windows are left. Errors of 8 subjects have 7 degrees of freedom, so that
    # their squared ratio passes F(7, 7) = 18.1 for one of 9 numbers in 0.5 % of tests.
    at_most = np.sqrt(18.1 * complete.windows / ours.windows)
    for name in ("speed_rms_deg_s", "correlation_time_s", "tracker_noise_deg"):
        error = np.array(getattr(ours.standard_error, name))
        truth = np.array(getattr(head, name))
        z = (np.array(getattr(ours.head, name)) - truth) / error
        # 9 numbers at 7 degrees of freedom: beyond 6 errors in 0.5 % of such tests.
        assert np.max(np.abs(z)) < 6
        whole_error = np.array(getattr(complete.standard_error, name))
        assert np.all(error < at_most * whole_error)


@pytest.mark.exhaustive
@pytest.mark.parametrize(("head", "order"), [(WANDER, 0), (RESONANT, 1)])
def test_held_out_people_choose_the_order(head, order):
    # Some 1 in 6 would choose one order too many, were it chosen by the minimum.
    traces = traces_of(head, jax.random.key(5), subjects=10, seconds=60.0)
    found = fitting.fit_heads(traces, max_speed_deg_s=100.0)
    assert len(found.head.resonators) == order
    assert set(found.held_out_deviance) == {0, 1, 2}


@pytest.mark.exhaustive
def test_intervals_cover_the_truth():
    # With twenty subjects sandwich errors are a little small: measured, 177 to 194 of
    # 200 intervals at 95 % cover, 188 on average, 19 of 21 numbers at least 180. Of 200
    # that cover with 92.5 % fewer than 172 do with probability 0.05 %: 1 % in all.
    truth = np.array(jax.tree.leaves(RESONANT), float)
    covered = np.zeros(len(truth), int)
    for i in range(200):
        # Selecting still segments would cut the tails of what is to be recovered.
        traces = traces_of(RESONANT, jax.random.key(i), subjects=20, seconds=60.0)
        found = fitting.fit_heads(traces, order=1, max_speed_deg_s=1e3)
        low, high = (
            np.array(jax.tree.leaves(end), float) for end in (found.low, found.high)
        )
        covered += (low <= truth) & (truth <= high)
    names = [jax.tree_util.keystr(p) for p, _ in jax.tree.leaves_with_path(RESONANT)]
    print("\n" + "\n".join(f"{n} {c}" for n, c in zip(names, covered, strict=True)))
    # The amplitude's correlation time is not fitted.
    assert np.all(covered[:-1] >= 172)
    assert np.mean(covered[:-1]) >= 0.92 * 200


def test_a_head_file_keeps_the_fits_error_and_a_study_says_it(tmp_path):
    error = FitError(0.0625, 12, "12 subjects")
    head = dataclasses.replace(WANDER, fit_error=error)
    assert jax.tree.leaves(head) == jax.tree.leaves(WANDER)  # it moves nothing
    presets.write(tmp_path / "me.toml", head, {})
    read = HeadMotion.read(tmp_path / "me.toml")
    assert read.fit_error == error
    said = identity.attributes(small.study(head=read), 0)
    names = ("head_fit_error", "head_fit_clusters", "head_fit_over")
    assert [said[name] for name in names] == [0.0625, 12, "12 subjects"]
    words = "12 subjects: intervals include the error of how much it turns, ± 6.2 %"
    assert words in identity.footer(xarray.Dataset({"x": ("session", [0])}, attrs=said))
    preset = identity.attributes(small.study(), 0)
    assert np.isnan(preset["head_fit_error"])
    said = identity.footer(xarray.Dataset({"x": ("session", [0])}, attrs=preset))
    assert "taken as known: intervals are given this head" in said


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ((-0.1, 12, ""), r"rotation must lie in \[0, 1\], got -0\.1"),
        ((np.nan, 12, ""), r"rotation must lie in \[0, 1\], got nan"),
        ((0.1, 1, ""), "clusters must be a whole number >= 2, got 1"),
    ],
)
def test_a_fits_error_is_checked(numbers, message):
    with pytest.raises(ValueError, match=message):
        FitError(*numbers)


# --- moments ---


def test_the_return_time_is_found_in_long_recordings():
    traces = gaussian_traces(4.0)
    found = moments.return_time(traces, WANDER, RATE_HZ, {}, over_subjects=True)
    assert abs(np.log(found.value / 4.0)) < 5 * found.error < 2


def test_short_recordings_do_not_tell_the_return_time(wander_traces):
    short = [t for trace in wander_traces for t in trace.still_segments()]
    few = [Trace(t.t_s[:200], t.world_from_head[:200]) for t in short]
    found = moments.return_time(few, WANDER, RATE_HZ, {}, over_subjects=True)
    assert found.value == moments.DEFAULT_RETURN_TIME_S
    assert np.isnan(found.error)


@pytest.mark.slow
@pytest.mark.parametrize("sd", [0.0, 0.3, 0.6])
def test_gearys_ratio_agrees_with_simulation(key, sd):
    head = eqx.tree_at(
        lambda h: (h.person_sd, h.amplitude.sd), RESONANT, (0.0, float(sd))
    )
    path = np.degrees(head.rotation_vectors(key, RATE_HZ, 1_000_000))
    velocity = np.diff(path, axis=0)
    ratio = np.mean(np.abs(velocity), axis=0) / np.sqrt(np.mean(velocity**2, axis=0))
    # Documented: 0.6 % low at most; the simulation's error is near 0.1 %.
    np.testing.assert_allclose(moments.geary_ratio(head, RATE_HZ), ratio, rtol=0.01)
    if not sd:
        np.testing.assert_allclose(
            moments.geary_ratio(head, RATE_HZ), 0.79788, rtol=1e-4
        )


@pytest.mark.parametrize("return_time_s", [0.1, 0.9])
def test_a_return_within_the_shortest_time_ends_there(return_time_s):
    # It became 15 s, as if the recordings were too short to tell.
    traces = gaussian_traces(return_time_s)
    found = moments.return_time(traces, WANDER, RATE_HZ, {}, over_subjects=True)
    assert found.value == 1.0
    assert np.isnan(found.error)


def test_one_subject_of_many_with_long_recordings_has_no_error(wander_traces):
    # The spread of a single group was 0 / 0, with a warning.
    brief = [Trace(t.t_s[:200], t.world_from_head[:200]) for t in wander_traces]
    traces = [*brief, gaussian_traces(4.0)[0]]
    found = moments.return_time(traces, WANDER, RATE_HZ, {}, over_subjects=True)
    assert found.value == moments.DEFAULT_RETURN_TIME_S


@pytest.mark.parametrize("noise", [0.004, 0.3])
def test_a_tracker_alone_has_no_bursts(wander_traces, noise):
    # The movement's share was 0, and the ratio 0 / 0.
    still = HeadMotion((0.0,) * 3, (0.1,) * 3, (noise,) * 3)
    bursts = moments.with_amplitude(still, 1.0)
    np.testing.assert_allclose(moments.geary_ratio(bursts, RATE_HZ), np.sqrt(2 / np.pi))
    found = moments.amplitude(wander_traces, still, RATE_HZ, over_subjects=True)
    assert found.value == 0
    assert np.isnan(found.error)


def test_a_gaussian_head_has_no_bursts():
    traces = gaussian_traces(4.0)
    found = moments.amplitude(traces, WANDER, RATE_HZ, over_subjects=True)
    assert found.value < 0.15


@pytest.mark.slow
@pytest.mark.parametrize(("speed", "noise"), [(0.8, 0.0), (0.0, 0.004)])
def test_a_number_that_is_0_ends_at_its_bound_and_is_not_identifiable(speed, noise):
    # Its interval went from 1e-254 to 1e243, or overflowed.
    numbers = lambda h: (
        *(h.speed_rms_deg_s, h.tracker_noise_deg, h.person_sd, h.amplitude.sd),
    )
    head = eqx.tree_at(numbers, WANDER, ((speed,) * 3, (noise,) * 3, 0.0, 0.0))
    traces = traces_of(head, jax.random.key(7), subjects=6, seconds=20.0)
    found = fitting.fit_heads(traces, order=0, max_speed_deg_s=100.0)
    known = identifiable_within_bounds(found)
    of = lambda name: (
        np.array(getattr(part, name), float)
        for part in (found.head, found.standard_error)
    )
    speeds, speed_errors = of("speed_rms_deg_s")
    noises, noise_errors = of("tracker_noise_deg")
    if noise:
        # A wander that is far shorter than a frame is like the tracker's noise.
        _, time_errors = of("correlation_time_s")
        assert np.isnan(speed_errors + time_errors).all()
        # 3 numbers at 5 degrees of freedom: beyond 7 errors in 0.3 % of such tests.
        assert np.max(np.abs(noises - noise) / noise_errors) < 7
        assert found.head.amplitude == Amplitude(0.0, 0.4)
        assert np.isnan(found.standard_error.person_sd)
    else:
        assert np.isnan(noise_errors).any()
        assert np.max(noises) < 5e-4
        assert np.max(np.abs(speeds - speed) / speed_errors) < 7
    assert known.sum() >= 3


def test_what_a_search_holds_at_a_bound_pulls_nothing(rng):
    gradient = rng.normal(size=(2, 40, 5))
    information = np.einsum("sfi,sfj->sij", gradient, gradient)
    subject = np.repeat([0, 1], 4)
    score = rng.normal(size=(8, 5))
    whole = scoring.Scoring(score, information, subject)
    assert whole.identifiable(3).all()
    held = whole.without(np.array([False, True, False]))
    np.testing.assert_array_equal(held.identifiable(3), [True, False, True])
    pulls = held.jackknife(np.arange(8))
    np.testing.assert_allclose(pulls[:, 1], 0, atol=1e-15)
    # The rest is as if that number were not there.
    free = [0, 2, 3, 4]
    gone = scoring.Scoring(score[:, free], information[:, free][..., free], subject)
    np.testing.assert_allclose(pulls[:, free], gone.jackknife(np.arange(8)), rtol=1e-9)


def test_what_lies_in_a_flat_direction_is_not_identifiable(rng):
    gradient = rng.normal(size=(1, 40, 4))
    gradient[..., 1] *= 1e-7  # hidden by the tracker's noise, say
    information = np.einsum("sfi,sfj->sij", gradient, gradient)
    of = scoring.Scoring(rng.normal(size=(3, 4)), information, np.zeros(3, int))
    np.testing.assert_array_equal(of.identifiable(3), [True, False, True])


def test_people_who_do_not_differ_have_no_error_of_it():
    # 0 had an error of 3e8 and an interval of [0, 0].
    found = errors.person_sd(np.array([0.1, -0.1, 0.0]), np.full(3, 0.5))
    assert found.value == 0
    assert np.isnan(found[1:]).all()
    found = errors.person_sd(np.array([0.1, -0.1, 0.0]), np.full(3, 1e-4))
    assert found.low < found.value < found.high


# --- what is refused ---


def test_axes_without_any_movement_are_refused_by_name(wander_traces):
    def still(trace, axis):
        path = Rotation.from_quat(trace.world_from_head, scalar_first=True).as_rotvec()
        path[:, axis] = 0.0
        path[:, (axis + 1) % 3] = 0.0  # else turns about two axes make a third
        poses = Rotation.from_rotvec(path).as_quat(scalar_first=True)
        return Trace(trace.t_s, poses, subject=trace.subject)

    frozen = [still(trace, 1) for trace in wander_traces]
    with pytest.raises(ValueError, match=r"move in all axes .*, none does in yaw\.$"):
        fitting.fit_heads(frozen, order=0)
    mixed = [still(wander_traces[0], 1), *wander_traces[1:]]
    with pytest.raises(ValueError, match=r"fitted, subject 0 does not in yaw\.$"):
        fitting.fit_heads(mixed, order=0)


def test_a_rate_that_leaves_resonances_no_frequency_is_refused():
    # Bounds of 0.7 to 0.45 Hz were searched between.
    with pytest.raises(ValueError, match=r"rate_hz must be above 1\.56 Hz .* got 1"):
        whittle.log_bounds(1, 1.0)
    low, high = whittle.log_bounds(2, 1.6)
    assert np.all(low < high)
    assert whittle.log_bounds(0, 1.0).shape == (2, 3)


def test_too_little_still_data_is_refused_with_reasons(wander_traces):
    with pytest.raises(fitting.NotEnoughDataError) as refusal:
        fitting.fit_heads(wander_traces[:1], order=0)
    assert str(refusal.value) == (
        "traces must hold at least 30 s of still data, in at least 8 windows of 4 s; "
        "got 20.0 s in 1 segments of at most 20.0 s (8 windows), of 20.0 s recorded."
    )


def test_mixed_rates_no_traces_and_orders_are_refused(wander_traces):
    fast = Trace(wander_traces[0].t_s / 2, wander_traces[0].world_from_head, name="f")
    with pytest.raises(ValueError, match=r"one rate within 2 %: f has 60.00 Hz"):
        fitting.fit_heads([*wander_traces, fast])
    with pytest.raises(ValueError, match="at least one recording, got none"):
        fitting.fit_heads([])
    with pytest.raises(ValueError, match="order must be one of 0, 1, 2, got '3'"):
        fitting.fit_heads(wander_traces, order=3)


def test_a_description_needs_a_window(wander_traces):
    brief = Trace(wander_traces[0].t_s[:60], wander_traces[0].world_from_head[:60])
    with pytest.raises(ValueError, match=r"must last at least 4 s .* lasts 1\.97 s"):
        statistics.describe([brief], RATE_HZ)


@pytest.mark.parametrize("rate_hz", [5.0, 12.0, 24.0, 90.0])
@pytest.mark.parametrize("order", whittle.ORDERS)
def test_the_search_starts_within_its_bounds_at_every_rate(rate_hz, order):
    starts = whittle.start_logits(whittle.log_bounds(order, rate_hz), order)
    assert np.all(np.isfinite(starts))


def test_nearly_gaussian_recordings_have_a_small_amplitude(monkeypatch, wander_traces):
    # At a spread of 0.008 the slope is taken from 0 on.
    calm = eqx.tree_at(lambda h: h.amplitude, WANDER, None)
    ratio = float(
        np.mean(moments.geary_ratio(moments.with_amplitude(calm, 0.008), RATE_HZ))
    )
    monkeypatch.setattr(
        moments, "geary_pseudo_values", lambda velocity: np.array([ratio, ratio])
    )
    found = moments.amplitude(wander_traces, calm, RATE_HZ, over_subjects=True)
    assert found.value == pytest.approx(0.008, abs=2e-3)
