"""TIDOAA: its store on static, moving and deforming things, and who wins a cell."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hmdjit as hj
from hmdjit import rendering
from hmdjit.camera import Camera, Region
from hmdjit.frames.motion import Motion
from hmdjit.techniques import MSAA, TIDOAA, by_id
from hmdjit.techniques.base import mean_of_samples

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


@pytest.mark.parametrize("name", ["subcell", "space", "jitter"])
def test_wrong_options_are_refused(name):
    with pytest.raises(ValueError, match=f"{name} must be"):
        TIDOAA(**{name: "no"})


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


def test_a_static_scene_is_supersampled_from_frame_three(rng):
    camera = Camera(32, 32, 60.0, 60.0)
    scene, region = hj.scenes.hut(), Region.whole(camera)
    motion = Motion(*jnp.zeros((2, 3)))
    technique = TIDOAA()

    @jax.jit
    def run():
        state = None
        for k in range(5):
            frame = rendering.render(
                scene,
                camera,
                region,
                motion,
                technique.sample_offsets_px[k % 4],
                channels=technique.needs,
            )
            px = jnp.asarray(technique.sample_offsets_px[k % 4, 0])
            frame = hj.frames.frame.Frame(
                frame.color, camera, region, channels=frame.channels, jitter_px=px
            )
            state = technique.init(frame) if k == 0 else state
            state, picture = technique.step(state, frame, motion)
        pattern = MSAA(4).sample_offsets_px[0]
        every = rendering.render(scene, camera, region, motion, pattern)
        return picture, mean_of_samples(every.color, "gamma")

    # Its static things count as one.
    np.testing.assert_allclose(*run(), atol=1e-12)
