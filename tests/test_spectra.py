from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal
from heads import models
from scipy.spatial.transform import Rotation

from hmdjit.head_fitting.spectra import Periodograms, Turns
from hmdjit.head_motion import Trace

# Two-sided tests of means of 200 or more sessions at 5 standard errors: false alarms
# below 1e-5 each (periodograms of many bins are nearly normal, bursts make them skew).
LARGEST_Z = 5.0

RATE_HZ = 30.0  # low: what is tested has no scale, windows are 120 frames
WINDOW = 120

# Small angles: rotations add up like vectors, to 1e-3 of a turn.
MODELS = models(person_sd=0.0, scale=0.1, wander_s=4.0)
MODEL_A, MODEL_B, BURSTS = MODELS.values()


def trace(path_deg, *, rows=None, rate_hz=RATE_HZ, subject="one"):
    """A trace of rotation vectors, or of some rows of them."""
    rows = np.arange(len(path_deg)) if rows is None else rows
    head = Rotation.from_rotvec(np.asarray(path_deg)[rows], degrees=True)
    return Trace(rows / rate_hz, head.as_quat(scalar_first=True), subject=subject)


def some_lost(rng, frames, share=0.3):
    """Rows that are left where frames were lost, at most two in a row."""
    kept = rng.random(frames) > share
    kept[[0, -1]] = True
    for frame in range(2, frames):
        kept[frame] |= not kept[frame - 1] and not kept[frame - 2]
    return np.flatnonzero(kept)


@partial(jax.jit, static_argnames=("sessions", "frames"))
def draw_deg(head, key, sessions, frames):
    sample = lambda key: head.rotation_vectors(key, RATE_HZ, frames)
    return jnp.degrees(jax.lax.map(sample, jax.random.split(key, sessions)))


def still(frames):
    return trace(np.zeros((frames, 3)))


# --- turns ---


def test_turns_over_lost_frames_are_spread_evenly(rng):
    path_deg = 0.1 * rng.normal(size=(90, 3)).cumsum(axis=0)
    rows = some_lost(rng, 90)
    turns = Turns.of(trace(path_deg, rows=rows))
    np.testing.assert_array_equal(turns.frames, np.diff(rows))
    assert turns.rate_hz == pytest.approx(RATE_HZ, rel=1e-12)
    head = Rotation.from_rotvec(path_deg[rows], degrees=True)
    for step in range(len(rows) - 1):
        turned = (head[step].inv() * head[step + 1]).as_rotvec(degrees=True)
        np.testing.assert_allclose(turns.angle_deg[step], turned, atol=1e-12)
        lost = slice(*(rows[step : step + 2] - rows[0]))
        each = turned / (rows[step + 1] - rows[step])
        filled = turns.filled_deg[lost]
        np.testing.assert_allclose(filled, np.tile(each, (len(filled), 1)), atol=1e-12)
        velocity = turns.velocity_deg_s[step]
        np.testing.assert_allclose(velocity, each * RATE_HZ, rtol=1e-9, atol=1e-12)
    assert turns.path_deg.shape == (90, 3)
    np.testing.assert_array_equal(turns.path_deg[0], 0.0)
    np.testing.assert_allclose(
        turns.path_deg[rows][1:], turns.angle_deg.cumsum(axis=0), atol=1e-12
    )


def test_a_turn_about_one_axis_is_found_where_it_is():
    yaw_deg = np.outer(np.arange(20.0), [0.0, 3.0, 0.0])
    turns = Turns.of(trace(yaw_deg))
    np.testing.assert_allclose(turns.path_deg, yaw_deg, atol=1e-12)
    np.testing.assert_allclose(turns.velocity_deg_s[:, 1], 3 * RATE_HZ, rtol=1e-12)


# --- windows ---


def test_windows_overlap_by_half_and_have_their_owners():
    segments = [
        still(WINDOW),  # one turn short of a window
        trace(np.zeros((WINDOW + 1, 3)), subject="b"),
        trace(np.zeros((3 * WINDOW // 2 + 1, 3)), subject="a"),
        trace(np.zeros((2 * WINDOW, 3)), subject="b"),
    ]
    found = Periodograms.of(segments, RATE_HZ)
    assert found.subjects == ("a", "b")
    np.testing.assert_array_equal(found.subject, [1, 0, 0, 1, 1])
    np.testing.assert_array_equal(found.windows, [2, 3])
    # Kept are 0.25 Hz to 0.97 of the Nyquist frequency.
    np.testing.assert_allclose(found.frequency_hz, np.arange(1, 59) / 4, rtol=1e-12)
    assert found.power.shape == (5, 58, 3)
    assert found.leakage().shape == (2, 58, len(found.grid_hz))
    assert [len(steps) for steps in found.steps] == [WINDOW] * 5


def test_segments_shorter_than_a_window_give_none():
    found = Periodograms.of([still(WINDOW), still(7)], RATE_HZ)
    assert found.power.shape == (0, 58, 3)
    assert found.subjects == ()
    assert found.steps == []
    assert Periodograms.of([], RATE_HZ).power.shape == (0, 58, 3)


def test_periodograms_are_those_of_scipy(rng):
    path_deg = 0.01 * rng.normal(size=(3 * WINDOW, 3)).cumsum(axis=0)
    found = Periodograms.of([trace(path_deg)], RATE_HZ)
    velocity = Turns.of(trace(path_deg)).velocity_deg_s
    welch: Any = scipy.signal.welch
    frequency_hz, mean = welch(velocity, RATE_HZ, "hann", WINDOW, detrend=False, axis=0)
    kept = np.isin(frequency_hz, found.frequency_hz)
    np.testing.assert_allclose(found.by_subject()[0], mean[kept], rtol=1e-9)


def test_blocks_hold_the_same_windows_in_the_order_of_subjects(rng):
    subjects = ["c", "a", "b", "a"]
    segments = [
        trace(0.01 * rng.normal(size=(2 * WINDOW, 3)), subject=name)
        for name in subjects
    ]
    whole = Periodograms.of(segments, RATE_HZ)
    for count in (1, 2, 5, 8):
        blocks = whole.in_blocks(count)
        assert blocks.subjects == tuple(f"block {i + 1}" for i in range(count))
        assert blocks.power is whole.power
        assert np.ptp(blocks.windows) <= 1
        assert blocks.windows.sum() == len(whole.power)
        # The windows of a subject come together, and in their order.
        order = np.argsort(whole.subject, kind="stable")
        assert np.all(np.diff(blocks.subject[order]) >= 0)
        mean = np.average(blocks.by_subject(), axis=0, weights=blocks.windows)
        np.testing.assert_allclose(mean, whole.power.mean(axis=0), rtol=1e-12)


# --- leakage ---


def test_leakage_of_a_white_velocity_is_one():
    leakage = Periodograms.of([still(2 * WINDOW)], RATE_HZ).leakage()[0]
    np.testing.assert_allclose(leakage.sum(axis=1), 1.0, rtol=1e-12)
    assert np.all(leakage >= 0)


def test_leakage_without_gaps_is_the_tapers_own():
    """Three Dirichlet kernels make the transform of a Hann window."""
    found = Periodograms.of([still(WINDOW + 1)], RATE_HZ)

    def dirichlet(frequency_hz):
        x = np.pi * frequency_hz / RATE_HZ
        small = np.abs(np.sin(x)) < 1e-12
        ratio = np.sin(WINDOW * x) / np.where(small, 1.0, np.sin(x))
        ratio = np.where(small, WINDOW * np.cos(WINDOW * x) / np.cos(x), ratio)
        return np.exp(-1j * (WINDOW - 1) * x) * ratio

    def response(frequency_hz):
        bin_hz = RATE_HZ / WINDOW
        sides = dirichlet(frequency_hz - bin_hz) + dirichlet(frequency_hz + bin_hz)
        wave = dirichlet(frequency_hz) / 2 - sides / 4
        return np.abs(wave) ** 2 / (3 / 8 * WINDOW)  # of a taper of power 1

    grid_hz = found.grid_hz
    apart_hz = found.frequency_hz[:, None] - grid_hz
    folded = response(apart_hz)
    # Of a one-sided spectrum also the negative frequencies, but for the ends' own.
    folded[:, 1:-1] += response(found.frequency_hz[:, None] + grid_hz[1:-1])
    law = folded / (2 * (len(grid_hz) - 1))
    np.testing.assert_allclose(found.leakage()[0], law, atol=1e-12)


def expected_power(covariance, steps):
    """Of the tapered transform, from the covariance of the velocity by lag in frames.

    The filled series is a matrix times the true one; all sums are written out.
    """
    count = int(np.sum(steps))
    filled = np.zeros((count, count))
    start = 0
    for step in steps:
        filled[start : start + step, start : start + step] = 1 / step
        start += step
    taper = np.hanning(count + 1)[:-1]
    taper = taper / np.sqrt(np.sum(taper**2))
    lag = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    seen = filled @ covariance[lag] @ filled.T * np.outer(taper, taper)
    waves = np.exp(-2j * np.pi * np.outer(np.arange(count), np.arange(count)) / count)
    return 2 / RATE_HZ * np.real(np.einsum("fi,ij,fj->f", waves, seen, waves.conj()))


@pytest.mark.parametrize(
    "head", [pytest.param(MODEL_A, marks=pytest.mark.slow), MODEL_B], ids=["A", "B"]
)
@pytest.mark.parametrize("share", [0.0, 0.3])
def test_expected_periodograms_are_those_of_the_covariance(head, share, rng):
    rows = some_lost(rng, WINDOW + 1, share)
    found = Periodograms.of([trace(np.zeros((WINDOW + 1, 3)), rows=rows)], RATE_HZ)
    np.testing.assert_array_equal(found.steps[0], np.diff(rows))
    spectrum = np.asarray(head.sampled_velocity_spectrum(found.grid_hz, RATE_HZ))
    ours = found.leakage()[0] @ spectrum
    lags = np.asarray(head.increment_covariance(np.arange(WINDOW), RATE_HZ))
    for axis in range(3):
        power = expected_power(lags[:, axis] * RATE_HZ**2, np.diff(rows))[1:59]
        # The grid of 12 s lets what is remembered for 8 s overlap: of B's mode of 0.05
        # at 2.4 Hz exp(-6). The notch that the spring of 4 s makes at 0 Hz is narrower
        # than the grid; without gaps the taper lets only the lowest frequency see it.
        np.testing.assert_allclose(ours[0, axis], power[0], rtol=0.015)
        np.testing.assert_allclose(ours[1:, axis], power[1:], rtol=1e-3)


@pytest.mark.parametrize(
    ("name", "sessions"),
    [
        ("bursts", 200),
        *(pytest.param(name, 1500, marks=pytest.mark.slow) for name in MODELS),
    ],
)
@pytest.mark.parametrize("share", [0.0, 0.3])
def test_periodograms_of_many_sessions_are_as_expected(name, sessions, share, key, rng):
    head, frames = MODELS[name], 2 * WINDOW + 1
    paths = np.asarray(draw_deg(head, key, sessions, frames))
    segments = [
        trace(path, rows=some_lost(rng, frames, share), subject=f"{i % 7}")
        for i, path in enumerate(paths)
    ]
    found = Periodograms.of(segments, RATE_HZ)
    assert found.windows.sum() == 3 * sessions
    spectrum = np.asarray(head.sampled_velocity_spectrum(found.grid_hz, RATE_HZ))
    # Subjects have different gaps: the mean over all has the mean leakage.
    weight = found.windows / found.windows.sum()
    expected = np.tensordot(weight, found.leakage(), 1) @ spectrum
    of_session = found.power.reshape(sessions, 3, -1, 3).mean(axis=1) / expected
    # 8 bands from 0.5 Hz, where the grid resolves the spectrum.
    bands = np.array_split(np.arange(1, of_session.shape[1]), 8)
    means = np.stack([of_session[:, band].mean(axis=1) for band in bands], axis=1)
    z = means.mean(axis=0) - 1
    z /= means.std(axis=0, ddof=1) / np.sqrt(sessions)
    np.testing.assert_array_less(np.abs(z), LARGEST_Z)
    if share:  # by itself the spectrum is a fifth too high where frames are lost
        high = found.power.mean(axis=0)[found.frequency_hz > 10].mean(axis=0)
        assert np.all(high < 0.8 * spectrum[found.grid_hz > 10].mean(axis=0))
