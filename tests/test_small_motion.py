"""A head that hardly moves: techniques filter its motion, as a table has it."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hmdjit as hj
from hmdjit.simulation import session
from hmdjit.techniques import HeadMovement, NoAntialiasing

# MTCD with the technique over MTCD without, d = 2/3, ten frames: history starts at
# frame 0, and after a long warm-up. The rows: how the head moves from frame to frame.
SHARES = (0.1, 0.2, 0.3)
SMALL_MOTION = {
    "position white": [(0.376, 0.371), (0.425, 0.418), (0.479, 0.470)],
    "white": [(0.412, 0.423), (0.490, 0.499), (0.561, 0.568)],
    "ou 0.5": [(0.463, 0.504), (0.572, 0.612), (0.658, 0.692)],
    "ou 0.8": [(0.525, 0.643), (0.658, 0.764), (0.749, 0.832)],
}
LONG_WARMUP = 60  # 0.9^60 is 0.002


def autocovariance(law, lags):
    """Of the increments, relative to their variance, at lags 0, 1, ..."""
    if law == "position white":
        return np.where(lags == 0, 1.0, np.where(lags == 1, -0.5, 0.0))
    rho = float(law.removeprefix("ou ")) if law.startswith("ou") else 0.0
    return rho**lags


def draw(rng, law, sessions, frames):
    """Increments of unit variance from their stationary law, `(sessions, frames)`."""
    if law == "position white":
        return np.diff(rng.normal(size=(sessions, frames + 1))) / np.sqrt(2)
    rho = autocovariance(law, np.array([1]))[0]
    noise = rng.normal(size=(sessions, frames))
    increments = [noise[:, 0]]
    for k in range(1, frames):
        increments.append(rho * increments[-1] + np.sqrt(1 - rho**2) * noise[:, k])
    return np.stack(increments, axis=1)


def predicted_ratio(law, share, warmup, d=2 / 3):
    """First order: the picture moves by the increments, filtered by g_n.

    g_0 = (1 - d) + d A, g_n = d A (1 - A)^n, cut off where the session starts.
    """
    total = 0.0
    for k in range(warmup + 1, warmup + 10):
        n = np.arange(k)
        g = d * share * (1 - share) ** n + (1 - d) * (n == 0)
        total += np.sqrt(g @ autocovariance(law, abs(n[:, None] - n)) @ g)
    return total / 9


@pytest.mark.parametrize("law", SMALL_MOTION)
def test_predicted_ratios_are_the_tabled_ones(law):
    for share, tabled in zip(SHARES, SMALL_MOTION[law], strict=True):
        ours = [predicted_ratio(law, share, warmup) for warmup in (0, LONG_WARMUP)]
        np.testing.assert_allclose(ours, tabled, rtol=0, atol=0.001)


def test_predicted_ratios_obey_the_closed_forms():
    d = 2 / 3
    for a in SHARES:
        rest = 1 - a
        k = np.arange(1, 10)
        by_frame = (1 - d) ** 2 + 2 * d * (1 - d) * a
        by_frame = by_frame + d**2 * a * (1 - rest ** (2 * k)) / (2 - a)
        np.testing.assert_allclose(
            predicted_ratio("white", a, 0), np.sqrt(by_frame).mean(), rtol=1e-12
        )
        for law, rho in [("white", 0.0), ("ou 0.5", 0.5), ("ou 0.8", 0.8)]:
            steady = (1 - d) ** 2 + 2 * d * (1 - d) * a / (1 - rest * rho)
            steady += d**2 * a / (2 - a) * (1 + rest * rho) / (1 - rest * rho)
            np.testing.assert_allclose(
                predicted_ratio(law, a, 400), np.sqrt(steady), rtol=1e-12
            )


def strip_texture(period_px, margin_px):
    """A grey sinusoid along x, 4 texels per pixel, for a camera of 96 x 1 px."""
    x = 0.5 + np.arange(4 * (96 + 2 * margin_px)) / 4 - margin_px
    wave = 0.5 + 0.4 * np.sin(2 * np.pi * x / period_px)
    texels = np.broadcast_to(wave[None, :, None], (4 * (1 + 2 * margin_px), len(x), 3))
    return hj.Texture.of(jnp.asarray(texels), jnp.asarray(texels), 4, margin_px)


STRIP = hj.Camera(width_px=96, height_px=1, fov_deg=2.0, refresh_hz=60.0)
WAVE_PX = 64  # 0.098 rad per px; the block measures one period, far from the edges


@functools.partial(jax.jit, static_argnames="warmup")
def strip_mtcd(technique, texture, turns, *, warmup):
    """MTCD of sessions of a head that only turns left and right."""
    motions = hj.Motion(jnp.cumsum(turns, axis=1), turns)
    region, block = hj.Region.whole(STRIP), hj.Region(16, 0, WAVE_PX, 1)

    def one(motion):
        (result,) = session.session(
            texture, STRIP, (technique,), motion, region, block, warmup=warmup
        )
        return result.mtcd

    return jax.lax.map(one, motions)


def check_small_motion(rng, sessions, laws, shares, warmups, rms_px=0.1):
    texture = strip_texture(WAVE_PX, 40)
    for warmup in warmups:
        for law in laws:
            turns = np.zeros((sessions, warmup + 10, 3))
            px = rms_px * draw(rng, law, sessions, warmup + 9)
            turns[:, 1:, 1] = np.arctan(px / float(STRIP.focal_px))
            turns = jnp.asarray(turns)
            mtcd = functools.partial(
                strip_mtcd, texture=texture, turns=turns, warmup=warmup
            )
            plain = np.asarray(mtcd(NoAntialiasing()))
            for share in shares:
                kim = HeadMovement(w_min=share, w_lb=share, h_max_deg_s=1e9)
                ours = np.asarray(mtcd(kim))
                ratio = ours.mean() / plain.mean()
                # The delta method: sessions are independent, pairs of runs are not.
                error = np.std(ours - ratio * plain) / plain.mean() / sessions**0.5
                expected = predicted_ratio(law, share, warmup)
                # First order in 0.1 px of motion and in a picture of 0.1 rad per px:
                # bilinear reads and curvature cost up to 1 %.
                assert abs(ratio - expected) < 0.02 * expected + 2 * error


@pytest.mark.exhaustive
def test_small_motion_is_filtered_as_predicted(rng):
    # With the warm-up that studies use.
    check_small_motion(rng, 300, ["position white", "ou 0.8"], [0.1, 0.3], [12])


@pytest.mark.exhaustive
def test_small_motion_agrees_with_the_table(rng):
    check_small_motion(rng, 4000, SMALL_MOTION, SHARES, [0, LONG_WARMUP])
