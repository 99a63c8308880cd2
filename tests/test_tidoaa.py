"""TIDOAA: its store on static, moving and deforming things, and who wins a cell."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hmdjit as hj
from hmdjit import rendering
from hmdjit.camera import Camera, Region
from hmdjit.filters import scattering
from hmdjit.frames.motion import Motion
from hmdjit.techniques import MSAA, TIDOAA, by_id

SIZE, FRAMES = 16, 5
CAMERA = Camera(SIZE, SIZE, 40.0, 60.0)
STILL = np.tile([1.0, 0, 0, 0], (FRAMES, 1))


def clip(rng, **channels):
    """Frames of noise, far away and static unless something else is said."""
    plane = (FRAMES, SIZE, SIZE)
    usual = {
        "depth": np.full(plane, np.inf),
        "object_id": np.zeros(plane, np.int32),
        "motion_class": np.zeros(plane, np.int32),
    }
    return rng.random((*plane, 3)), usual | channels


def shown(technique, frames, channels, poses=STILL, **more):
    return np.asarray(hj.apply(technique, CAMERA, frames, poses, **channels, **more))


@pytest.mark.parametrize(
    ("options", "id"),
    [
        ({}, "tidoaa"),
        ({"subcell": True}, "tidoaa_subcell"),
        ({"space": "linear", "jitter": False}, "tidoaa_linear_no_jitter"),
    ],
)
def test_ids_say_what_is_no_default(options, id):
    assert TIDOAA(**options).id == id
    assert by_id(id) == TIDOAA(**options)


def test_wrong_options_are_refused():
    with pytest.raises(ValueError, match="space must be one of gamma, linear, got 'n'"):
        TIDOAA(space="n")


def test_a_frame_lives_for_four(rng):
    """At rest the mean of the last four frames; frame 0 is shown as it is."""
    frames, channels = clip(rng)
    found = shown(TIDOAA(), frames, channels)
    for k in range(FRAMES):
        expected = frames[max(0, k - 3) : k + 1].mean(axis=0)
        np.testing.assert_allclose(found[k], expected, atol=1e-12)


def test_what_deforms_is_not_moved(rng):
    frames, channels = clip(rng, motion_class=np.full((FRAMES, SIZE, SIZE), 2))
    np.testing.assert_array_equal(shown(TIDOAA(), frames, channels), frames)


@jax.jit
def rendered(scene, motion, sample_px, k):
    """Hut of solids, one sample per pixel."""
    frame = rendering.render(
        scene,
        CAMERA,
        Region.whole(CAMERA),
        motion,
        sample_px[None],
        frame=k,
        channels=TIDOAA().needs,
    )
    return dataclasses.replace(frame, jitter_px=sample_px)


step = jax.jit(lambda state, frame, motion: TIDOAA().step(state, frame, motion))


def run(scene, motions):
    """Frames, and what is displayed."""
    frames, displayed, state = [], [], None
    for k, motion in enumerate(motions):
        sample_px = jnp.asarray(TIDOAA().sample_offsets_px[k % 4, 0])
        frames.append(rendered(scene, motion, sample_px, k))
        state = TIDOAA().init(frames[0]) if k == 0 else state
        state, picture = step(state, frames[-1], motion)
        displayed.append(picture)
    return frames, displayed


def test_a_static_scene_is_supersampled_from_frame_three():
    scene = dataclasses.replace(
        hj.scenes.hut(rate_rad_s=0.0), classes=np.zeros(8, np.int32)
    )
    frames, displayed = run(scene, [Motion(*jnp.zeros((2, 3)))] * 6)
    places = sorted(tuple(frame.jitter_px.tolist()) for frame in frames[:4])
    assert places == sorted(map(tuple, MSAA(4).sample_offsets_px[0].tolist()))
    expected = np.mean([frame.color[0] for frame in frames[:4]], axis=0)
    for picture in displayed[3:]:
        np.testing.assert_allclose(picture, expected, atol=1e-12)


def test_moving_solids_are_followed():
    """A head that walks sees things that circle; all is finite, frame 0 is itself."""
    turn, walk = jnp.array([1e-3, 2e-2, 0]), jnp.array([1e-2, 0, 2e-2])
    motions = [Motion(turn * k, turn, walk * k, walk) for k in range(6)]
    frames, displayed = run(hj.scenes.hut(), motions)
    np.testing.assert_array_equal(displayed[0], frames[0].color[0])
    assert np.isfinite(displayed).all()
    # What is followed is nearer to the next frames than what stays where it was.
    moved = np.abs(displayed[-1] - frames[-1].color[0]).mean()
    stayed = np.mean([f.color[0] for f in frames[-4:]], axis=0) - frames[-1].color[0]
    assert moved < 0.8 * np.abs(stayed).mean()


def test_a_cell_goes_to_the_newest_then_the_nearest_then_the_first():
    targets = jnp.array([0, 0, 1, 1, 2, 2, 7])
    age = jnp.array([2.0, 1, 1, 1, 1, 1, 0])
    depth = jnp.array([1.0, 9, 5, 3, 4, 4, 1])
    order = jnp.array([0, 1, 2, 3, 5, 4, 6])
    found = scattering.winners(targets, [age, depth], order)
    np.testing.assert_array_equal(found, [1, 3, 4, 7, 7, 7, 7])


def test_of_several_things_in_a_pixel_only_the_newest_are_moved(rng):
    """Two ids in each pixel by turns: each frame replaces what was seen before it."""
    ids = np.ones((FRAMES, SIZE, SIZE), int) * (np.arange(FRAMES) % 2)[:, None, None]
    frames, channels = clip(rng, object_id=ids, motion_class=ids)
    poses = np.hstack([STILL, np.zeros((FRAMES, 3))])
    found = shown(
        TIDOAA(), frames, channels, poses, object_poses=poses[:, None].repeat(2, 1)
    )
    np.testing.assert_allclose(found[2:], (frames[2:] + frames[1:-1]) / 2, atol=1e-12)


def test_what_is_rigid_must_be_known_to_move(rng):
    frames, channels = clip(rng, motion_class=np.ones((FRAMES, SIZE, SIZE), int))
    velocity_px = np.zeros((FRAMES, SIZE, SIZE, 2))
    for more in ({}, {"velocity_px": velocity_px}):
        with pytest.raises(ValueError, match="some are rigid: give object_poses="):
            shown(TIDOAA(), frames, channels, **more)


@pytest.mark.parametrize("subcell", [False, True])
def test_colors_have_finite_derivatives_at_rest_and_turning(rng, subcell):
    frames, channels = clip(rng)
    for poses in (
        STILL,
        hj.HeadMotion.seated().sample(jax.random.key(0), 60.0, FRAMES),
    ):
        slope = jax.grad(
            lambda colors, poses=poses: (
                hj.apply(TIDOAA(subcell), CAMERA, colors, poses, **channels) ** 2
            ).mean()
        )(jnp.asarray(frames))
        assert np.isfinite(slope).all()
        assert np.any(slope)
