import equinox as eqx
import jax
import numpy as np
import pytest
import scipy.stats
from heads import models
from scipy.spatial.transform import Rotation

from hmdjit.head_fitting import statistics
from hmdjit.head_fitting.spectra import Periodograms
from hmdjit.head_motion import HeadMotion, Trace

# Two-sided tests of means of 200 or more sessions at 5 standard errors. Their squares
# are skew by 0.3 at most: false alarms below 1e-5 each.
LARGEST_Z = 5.0

MODELS = models(person_sd=0.17)
MODEL_A, MODEL_B, BURSTS = MODELS.values()
bursts_first = pytest.mark.parametrize(
    "name", ["bursts", *(pytest.param(name, marks=pytest.mark.slow) for name in "AB")]
)


def trace(path_deg, rate_hz, *, rows=None, subject="one"):
    """A trace of rotation vectors, or of some rows of them."""
    rows = np.arange(len(path_deg)) if rows is None else rows
    head = Rotation.from_rotvec(np.asarray(path_deg)[rows], degrees=True)
    return Trace(rows / rate_hz, head.as_quat(scalar_first=True), subject=subject)


def assert_mean(values, law):
    """Means over axis 0 are the law, by their own spread's z."""
    error = np.mean(values, axis=0) - law
    z = error / (np.std(values, axis=0, ddof=1) / np.sqrt(len(values)))
    np.testing.assert_array_less(np.abs(z), LARGEST_Z)


# --- what recorded heads do ---


def test_a_constant_speed_is_described():
    rate_hz, frames = 60.0, 60 * 25 + 1
    axis = np.array([1.0, 2.0, -2.0]) / 3
    turning = np.outer(np.arange(frames) * 3.0 / rate_hz, axis)  # 3 deg/s
    segments = [
        trace(turning, rate_hz, subject="a"),
        trace(turning[:301], rate_hz, subject="b"),
    ]
    found = statistics.describe(segments, rate_hz)
    assert found.rate_hz == rate_hz
    assert found.subjects == 2
    assert found.still_s == pytest.approx(30.0, rel=1e-12)
    assert found.speed_rms_deg_s == pytest.approx(3.0, rel=1e-9)
    assert found.speed_quantile(0.5) == pytest.approx(3.0, rel=1e-9)
    np.testing.assert_allclose(found.speed_quantile_deg_s, 3.0, rtol=1e-6)
    np.testing.assert_allclose(found.kurtosis, -2.0, atol=1e-9)
    # n evenly spaced angles have the variance (n^2 - 1) / 12 of their step.
    for duration_s, rms_deg in zip((2, 10, 20), found.wander_deg, strict=True):
        count = duration_s * rate_hz
        law = np.abs(axis) * 3 / rate_hz * np.sqrt((count**2 - 1) / 12)
        np.testing.assert_allclose(rms_deg, law, rtol=1e-9)
    law = np.square(np.multiply.outer(found.lag_s, 3 * axis))
    np.testing.assert_allclose(found.structure_deg2, law, rtol=1e-9)
    assert found.lag_s[-1] == pytest.approx(25 / 3, rel=0.01)
    # Away from 0 Hz a Hann window holds nothing of a constant.
    assert np.all(found.spectrum[found.frequency_hz > 0.6] < 1e-12)


def test_a_swinging_head_is_described():
    rate_hz, swing_hz, amplitude = 90.0, 2.0, np.array([0.5, 1.0, 0.25])
    time_s = np.arange(round(24 * rate_hz) + 1) / rate_hz
    angle_deg = np.outer(np.sin(2 * np.pi * swing_hz * time_s), amplitude)
    found = statistics.describe([trace(angle_deg, rate_hz)], rate_hz)
    # Frame differences of a sine of w are sines, by sinc of half a frame's phase; 12
    # periods of 45 frames each.
    seen = np.sinc(swing_hz / rate_hz) * 2 * np.pi * swing_hz * amplitude
    assert found.speed_rms_deg_s == pytest.approx(
        np.linalg.norm(seen) / np.sqrt(2), rel=1e-9
    )
    assert found.speed_quantile(1.0) == pytest.approx(np.linalg.norm(seen), rel=1e-2)
    # The median of |cos| is that of 45 degrees; a frame's step here is 8 degrees.
    expected = np.linalg.norm(seen) / np.sqrt(2)
    assert found.speed_quantile(0.5) == pytest.approx(expected, rel=0.1)
    assert found.speed_quantile(0.25) < found.speed_quantile(0.5)
    np.testing.assert_allclose(found.kurtosis, -1.5, atol=1e-9)
    wander = np.tile(amplitude / np.sqrt(2), (3, 1))
    np.testing.assert_allclose(found.wander_deg, wander, rtol=1e-9)
    # The mean over segments that end in the middle of a period: 1e-2 of the whole.
    turned = np.multiply.outer(
        1 - np.cos(2 * np.pi * swing_hz * found.lag_s), amplitude**2
    )
    np.testing.assert_allclose(found.structure_deg2, turned, atol=0.02)
    # All its power is within a bin or two of 2 Hz; a Hann window reaches 0.5 Hz.
    is_near = np.abs(found.frequency_hz - swing_hz) < 0.6
    assert np.all(found.spectrum[~is_near] < 1e-3 * found.spectrum.max(axis=0))
    periodograms = Periodograms.of([trace(angle_deg, rate_hz)], rate_hz)
    total = periodograms.power.mean(axis=0).sum(axis=0) * 0.25
    np.testing.assert_allclose(total, seen**2 / 2, rtol=1e-9)


def test_descriptions_leave_out_what_is_too_short(rng):
    path_deg = 0.01 * rng.normal(size=(601, 3)).cumsum(axis=0)
    found = statistics.describe([trace(path_deg, 60.0)], 60.0)
    assert np.isfinite(found.wander_deg[:2]).all()
    assert np.isnan(found.wander_deg[2]).all()  # of 20 s
    message = (
        r"segments must last at least 4 s for a spectrum, the longest lasts 2\.00 s"
    )
    with pytest.raises(ValueError, match=message):
        statistics.describe([trace(path_deg[:121], 60.0)], 60.0)
    with pytest.raises(ValueError, match="at least one still segment, got none"):
        statistics.describe([], 60.0)


def test_a_head_that_only_turns_has_no_kurtosis_of_nodding():
    # 0 / 0 warned; here warnings are errors.
    time_s = np.arange(601) / 60.0
    yaw = np.outer(np.sin(2 * np.pi * time_s), [0.0, 1.0, 0.0])
    turned = trace(yaw, 60.0)
    found = statistics.describe([turned], 60.0)
    assert np.isnan(found.kurtosis).tolist() == [True, False, True]
    assert found.speed_rms_deg_s > 0


def test_wander_is_measured_in_whole_blocks(rng):
    paths = [rng.normal(size=(count, 3)) for count in (25, 9, 10)]
    found = statistics.block_variances(paths, 9.6)  # blocks of 10 frames
    law = [np.var(paths[0][:10], 0), np.var(paths[0][10:20], 0), np.var(paths[2], 0)]
    np.testing.assert_allclose(found, law, rtol=1e-12)
    assert statistics.block_variances(paths, 30.0).shape == (0, 3)


# --- what a model's heads are expected to do ---


# One program draws all, that of `as_recorded` for 12 segments of 12 s.
RATE_HZ, FRAMES, SEGMENTS = 30.0, 361, 12


def drawn_paths(head, key, batches=1):
    """Rotation vectors in deg of 12 sessions per batch, `(sessions, frames, 3)`."""
    whole = [trace(np.zeros((FRAMES, 3)), RATE_HZ)] * SEGMENTS
    drawn = [
        Rotation.from_quat(one.world_from_head, scalar_first=True)
        for batch_key in jax.random.split(key, batches)
        for one in statistics.as_recorded(batch_key, head, whole, RATE_HZ)
    ]
    return np.stack([poses.as_rotvec(degrees=True) for poses in drawn])


@pytest.mark.parametrize(
    "head", [pytest.param(MODEL_A, marks=pytest.mark.slow), BURSTS], ids=["A", "bursts"]
)
def test_expected_block_variance_is_a_double_sum(head):
    length = 60
    ours = statistics.expected_block_variance(head, float(length), RATE_HZ)
    lag = np.abs(np.subtract.outer(np.arange(length), np.arange(length)))
    covariance = np.asarray(head.covariance(np.arange(length) / RATE_HZ))
    for axis in range(3):
        # The trace of (I - 11'/n) C, person and tracker included.
        whole = np.exp(2 * 0.17**2) * covariance[lag, axis]
        whole = whole + head.tracker_noise_deg[axis] ** 2 * np.eye(length)
        law = (np.trace(whole) - np.sum(whole) / length) / length
        np.testing.assert_allclose(ours[axis], law, rtol=1e-9)


@bursts_first
def test_drawn_blocks_have_their_expected_variance(name, key):
    head = MODELS[name]
    paths = drawn_paths(head, key, batches=25)
    blocks = [statistics.block_variances([path], 60.0).mean(axis=0) for path in paths]
    law = statistics.expected_block_variance(head, 60.0, RATE_HZ)
    assert_mean(np.stack(blocks), law)


@bursts_first
def test_expected_spectra_are_those_of_persons_like_the_models(name, key):
    # Persons that differ a lot, and a tracker that does not follow them.
    head = eqx.tree_at(lambda h: h.person_sd, MODELS[name], 0.3)
    paths = drawn_paths(head, key, batches=25)
    segments = [
        trace(path, RATE_HZ, subject=f"{i % 3}") for i, path in enumerate(paths)
    ]
    found = Periodograms.of(segments, RATE_HZ)
    # From 0.5 Hz, see the tests of spectra.
    expected = statistics.expected_spectrum(head, found)[1:]
    bands = np.array_split(np.arange(len(expected)), 6)
    of_session = found.power.reshape(len(paths), -1, *found.power.shape[1:])
    relative = of_session.mean(axis=1)[:, 1:] / expected
    # A person who moves twice as much has four times the spectrum, less the tracker's.
    tracker = statistics.expected_spectrum(head, found, 0.0)
    median = statistics.expected_spectrum(head, found, 1.0)
    twice = statistics.expected_spectrum(head, found, 4.0)
    np.testing.assert_allclose(twice - tracker, 4 * (median - tracker), rtol=1e-12)
    # Poses turn by 1 deg or more: rotation vectors of turns about several axes do not
    # add up, which moves 1e-4 of their power.
    assert_mean(np.stack([relative[:, b].mean(axis=1) for b in bands], axis=1), 1.0)


# --- a model's heads beside recorded ones ---


def recorded(rng, head, key):
    """12 segments of 4 subjects, of which a tenth of the frames is lost."""
    found = []
    for i, path in enumerate(drawn_paths(head, key)):
        kept = rng.random(FRAMES) > 0.1
        kept[:2], kept[-1] = True, True
        rows = np.flatnonzero(kept)
        found.append(trace(path, RATE_HZ, rows=rows, subject=f"p{i // 3}"))
    return found


def test_draws_have_the_recorded_frames(rng, key):
    record_key, key, other_key = jax.random.split(key, 3)
    segments = recorded(rng, BURSTS, record_key)
    drawn = statistics.as_recorded(key, BURSTS, segments, RATE_HZ)
    again = statistics.as_recorded(jax.random.clone(key), BURSTS, segments, RATE_HZ)
    other = statistics.as_recorded(other_key, BURSTS, segments, RATE_HZ)
    assert len(drawn) == len(segments)
    for ours, same, another, segment in zip(drawn, again, other, segments, strict=True):
        np.testing.assert_array_equal(ours.frame_numbers, segment.frame_numbers)
        np.testing.assert_allclose(ours.t_s, segment.t_s, atol=1e-12)
        assert ours.subject == segment.subject
        np.testing.assert_array_equal(ours.world_from_head, same.world_from_head)
        assert np.all(ours.world_from_head[0] != another.world_from_head[0])
        assert np.all(ours.world_from_head[0] != segment.world_from_head[0])
    starts = np.stack([ours.world_from_head[0] for ours in drawn])
    assert len(np.unique(starts, axis=0)) == len(drawn)


@bursts_first
def test_a_model_is_good_for_its_own_draws(name, rng, key):
    record_key, key = jax.random.split(key)
    head = eqx.tree_at(lambda h: h.person_sd, MODELS[name], 0.0)
    segments = recorded(rng, head, record_key)
    good = statistics.goodness(key, head, segments, RATE_HZ, draws=4)
    # 12 segments of 12 s hold 30 independent windows, and bins of at least one
    # frequency: an error of 10 log10(1 +- 1 / sqrt(30)) = 0.8 dB, bursts add a half.
    assert np.all(good.spectrum_error_db < 1.2)
    ours, model = good.recorded, good.model
    assert good.expected.shape == ours.spectrum.shape == model.spectrum.shape
    assert model.subjects == ours.subjects == 4
    assert model.still_s == pytest.approx(4 * ours.still_s, rel=1e-9)
    for q in (0.25, 0.5, 0.95):
        assert model.speed_quantile(q) == pytest.approx(ours.speed_quantile(q), rel=0.1)
    # 144 s of an amplitude or a mode of 0.5 s: 8 %.
    assert model.speed_rms_deg_s == pytest.approx(ours.speed_rms_deg_s, rel=0.25)

    # A head and a tracker of half as much are told, by 6 dB.
    calm = eqx.tree_at(lambda h: h.tracker_noise_deg, head, (0.0018,) * 3)
    speeds = lambda config: config.speed_rms_deg_s
    halved = lambda c: eqx.tree_at(speeds, c, tuple(s / 2 for s in c.speed_rms_deg_s))
    modes = tuple(map(halved, head.resonators))
    calm = HeadMotion(**{**vars(halved(calm)), "resonators": modes})
    bad = statistics.goodness(jax.random.clone(key), calm, segments, RATE_HZ, draws=1)
    assert np.all(bad.spectrum_error_db > 4)


def test_speeds_of_a_white_head_have_their_quantiles(rng):
    """Angular velocities of three independent normal axes: the law of Maxwell."""
    path_deg = 0.01 * rng.normal(size=(20_001, 3)).cumsum(axis=0)
    found = statistics.describe([trace(path_deg, 60.0)], 60.0)
    for share in (0.05, 0.5, 0.95):
        speed = scipy.stats.maxwell.ppf(share, scale=0.6)
        density = scipy.stats.maxwell.pdf(speed, scale=0.6)
        # sqrt(p (1 - p) / n) over the density, at 5 standard errors.
        error = np.sqrt(share * (1 - share) / 20_000) / density
        assert abs(found.speed_quantile(share) - speed) < 5 * error
    assert found.speed_rms_deg_s == pytest.approx(0.6 * np.sqrt(3), rel=0.02)
    np.testing.assert_allclose(found.kurtosis, 0.0, atol=5 * np.sqrt(24 / 20_000))
    np.testing.assert_allclose(found.spectrum, 2 * 0.6**2 / 60, rtol=0.4)
    np.testing.assert_allclose(
        found.structure_deg2[:10],
        np.multiply.outer(found.lag_s[:10] * 60 * 1e-4, np.ones(3)),
        rtol=0.1,
    )
