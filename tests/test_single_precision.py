"""Whole sessions, their prediction and baked scenes: float32 against float64."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from extremes import cast, wandering_poses

import hmdjit as hj
from hmdjit import scenes
from hmdjit.camera import Camera, Region
from hmdjit.frames.displacement import GATHER
from hmdjit.frames.motion import rebased_motion
from hmdjit.techniques import HeadMovement, NoAntialiasing
from hmdjit.theory.picture_statistics import PictureStatistics
from hmdjit.theory.prediction import predict

CAMERA = Camera(48, 48, 6.0, 60.0)
DTYPES = ("float32", "float64")


@functools.cache
def texture():
    scene = scenes.power_law_noise(size=64)
    return scenes.bake(scene, CAMERA, oversampling=1, margin_deg=6.0)


def session(poses, dtype, technique=HeadMovement(), warmup=0):  # noqa: B008
    # A pose in NumPy is re-based in float64, and then as exact as the texture is.
    poses = jnp.asarray(poses) if dtype == "float64" else poses
    result = hj.simulate(
        cast(texture(), dtype),
        CAMERA,
        technique,
        poses,
        warmup=warmup,
        region=Region(16, 16, 12, 12),
        reading=GATHER,
    )
    return np.array([float(result.mtcd), float(result.detail_loss)])


half_hour = pytest.mark.parametrize(
    "frames", [3_000, pytest.param(100_000, marks=pytest.mark.slow)]
)


@half_hour
def test_half_an_hour_of_flicker_and_detail_loss(frames, rng):
    poses = wandering_poses(rng, frames, 3e-4)
    ours, oracle = (session(poses, dtype) for dtype in DTYPES)
    # Sums that are not compensated err by 2e-6.
    np.testing.assert_allclose(ours, oracle, rtol=3e-7)


@pytest.mark.slow
def test_two_frames_after_a_long_warmup(rng):
    poses = wandering_poses(rng, 100_002, 3e-4)
    ours, oracle = (session(poses, dtype, warmup=100_000)[0] for dtype in DTYPES)
    assert ours == pytest.approx(oracle, rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("technique", [HeadMovement(), NoAntialiasing()])
def test_flicker_of_small_motion(technique, rng):
    for turn in (0.0, *10.0 ** np.arange(-8, -1.9, 0.5)):
        poses = wandering_poses(rng, 12, turn)
        ours, oracle = (session(poses, dtype, technique)[0] for dtype in DTYPES)
        assert abs(ours - oracle) <= 2e-5, f"code values, at {turn!r} rad per frame"


@pytest.mark.slow
def test_predictions(rng):
    statistics = PictureStatistics.of(texture(), CAMERA, cell_px=48)
    predicted = jax.jit(predict)
    for turn in 10.0 ** np.arange(-8, -1.9, 1):
        poses = wandering_poses(rng, 12, turn)
        ours, oracle = (
            predicted(
                cast(statistics, dtype),
                CAMERA,
                HeadMovement(),
                rebased_motion(poses, dtype),
            )
            for dtype in DTYPES
        )
        assert float(ours[0]) == pytest.approx(float(oracle[0]), rel=4e-6), turn


@pytest.mark.parametrize(
    "scene", [scenes.power_law_noise(size=64), scenes.almost_uniform()]
)
def test_baked_scenes_that_are_smooth(scene):
    display = Camera(256, 16, 96.0, 60.0)
    ours, oracle = (
        np.asarray(
            scenes.bake(scene, display, oversampling=1, dtype=dtype).color, float
        )
        for dtype in map(jnp.dtype, DTYPES)
    )
    np.testing.assert_allclose(255 * ours, 255 * oracle, rtol=0, atol=0.02)
