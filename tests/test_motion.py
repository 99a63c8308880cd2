"""Motion with positions, and heads that turn on a neck, against scipy in float64."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small import CAMERA, path, quickly, texture

import hmdjit as hj
from hmdjit.frames.motion import Motion, check_poses, checked_motion, rebased_motion
from hmdjit.frames.neck import NeckModel
from hmdjit.techniques import HeadMovement

FRAMES = 6
of = quickly(Motion.of)


def random_poses(rng, place_m=0.0, step_m=0.1):
    turns = Rotation.random(FRAMES, rng).as_quat(scalar_first=True)
    return np.hstack([turns, place_m + step_m * rng.normal(size=(FRAMES, 3))])


def oracle(poses):
    """Position from the hold pose in its axes, and steps in the head's axes now."""
    turns, place = Rotation.from_quat(poses[:, :4], scalar_first=True), poses[:, 4:]
    steps = np.diff(place, axis=0, prepend=place[:1])
    return turns[0].inv().apply(place - place[0]), turns.inv().apply(steps)


def test_positions_agree_with_scipy(rng):
    poses = random_poses(rng, place_m=2.0)
    motion = of(jnp.asarray(poses))
    position_m, translation_m = oracle(poses)
    np.testing.assert_allclose(motion.position_m, position_m, rtol=0, atol=1e-15)
    np.testing.assert_allclose(motion.translation_m, translation_m, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(motion.translation_m[0], np.zeros(3))


def test_an_origin_far_away_costs_no_digits(rng):
    # Half an ulp of 1e4 m is 1e-12 m in float64, and 5e-4 m in float32.
    poses = random_poses(rng, place_m=1e4, step_m=1e-6)
    motion = rebased_motion(poses, jnp.float32)
    assert motion.translation_m is not None
    assert motion.translation_m.dtype == jnp.float32
    _, steps = oracle(poses)
    np.testing.assert_allclose(motion.translation_m, steps, rtol=1e-6, atol=3e-12)


def test_a_head_that_stays_turns_as_one_without_positions(rng):
    poses = random_poses(rng, place_m=3.0, step_m=0.0)
    with_place, without = (
        checked_motion(each, jnp.float32) for each in (poses, poses[:, :4])
    )
    np.testing.assert_array_equal(with_place.offset, without.offset)
    np.testing.assert_array_equal(with_place.increment, without.increment)
    np.testing.assert_array_equal(with_place.translation_m, np.zeros((FRAMES, 3)))
    assert without.position_m is None
    assert with_place.turning().translation_m is None


def test_poses_that_are_being_traced_have_positions_too(rng):
    poses = random_poses(rng)
    traced = quickly(lambda poses: checked_motion(poses, poses.dtype))
    position_m, translation_m = oracle(poses)
    motion = traced(jnp.asarray(poses))
    np.testing.assert_allclose(motion.position_m, position_m, atol=1e-15)
    np.testing.assert_allclose(motion.translation_m, translation_m, atol=1e-15)
    assert np.isnan(traced(jnp.asarray(poses) * 1.02).position_m).any()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ((2, 5, np.nan), r"poses\[2\] must have a finite position, got \[.* nan .*\]"),
        ((3, 6, np.inf), r"poses\[3\] must have a finite position, got \[.* inf\]"),
        ((1, 0, 1.5), r"poses\[1\] must have a length in \[0.99, 1.01\], got "),
    ],
)
def test_poses_that_are_none_are_refused(rng, wrong, message):
    poses = random_poses(rng)
    row, column, poses[row, column] = wrong
    with pytest.raises(ValueError, match=message) as error:
        checked_motion(poses, jnp.float32)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("shape", [(6, 3), (6, 8), (7,), (0, 7), (2, 6, 7)])
def test_poses_of_other_shapes_are_refused(shape):
    with pytest.raises(ValueError, match=r"^poses must have "):
        check_poses(np.ones(shape))


# --- neck ---


EYE_M = np.array([0.0, 0.075, -0.0805])
moved = quickly(lambda motion: NeckModel().moved(motion))


@pytest.mark.parametrize("size", [1.0, 1e-2, 1e-6])
def test_an_eye_moves_with_its_neck(rng, size):
    """1e-6 rad move it by 1e-7 m: both keep their digits in float32."""
    turns = Rotation.from_rotvec(np.cumsum(size * rng.normal(size=(FRAMES, 3)), axis=0))
    poses = turns.as_quat(scalar_first=True)
    place = turns.apply(EYE_M)  # from the neck
    position_m, translation_m = oracle(np.hstack([poses, place]))
    turning = rebased_motion(poses, jnp.float32)
    motion = moved(turning)
    np.testing.assert_array_equal(motion.increment, turning.increment)
    limit_m = 1e-6 * 0.11 * size * FRAMES
    np.testing.assert_allclose(motion.position_m, position_m, rtol=0, atol=limit_m)
    np.testing.assert_allclose(
        motion.translation_m, translation_m, rtol=0, atol=limit_m
    )


def test_a_known_position_is_kept(rng):
    motion = of(jnp.asarray(random_poses(rng)))
    assert NeckModel().moved(motion) is motion


def test_derivatives_at_rest_are_those_of_a_lever():
    def place(up_m, turn):
        found = NeckModel(up_m=up_m).moved(Motion(turn[None], turn[None]))
        return jnp.concatenate(jax.tree.leaves(found)[2:])

    by_length, by_turn = jax.jacfwd(place, (0, 1))(jnp.asarray(0.075), jnp.zeros(3))
    lever = np.cross(np.eye(3), EYE_M).T  # r x eye, of each axis
    np.testing.assert_allclose(by_turn, [lever, lever], atol=1e-15)
    np.testing.assert_array_equal(by_length, np.zeros((2, 3)))


@pytest.mark.parametrize("name", ["up_m", "forward_m"])
@pytest.mark.parametrize("length", [1.5, np.nan])
def test_lengths_of_a_neck_are_checked(name, length):
    with pytest.raises(ValueError, match=rf"{name} must lie in \[-1, 1\], got"):
        NeckModel(**{name: length})


def test_windows_of_recordings_carry_positions_where_all_have_them(rng):
    t_s = np.arange(2 * FRAMES) / 60
    poses = np.vstack([random_poses(rng, 1e3), random_poses(rng, 1e3)])
    with_place, without = hj.Trace(t_s, poses), hj.Trace(t_s, poses[:, :4])
    windows, _ = hj.Replay([with_place]).windows(FRAMES)
    assert windows.shape == (2, FRAMES, 7)
    for window, recorded in zip(windows, np.split(with_place.poses, 2), strict=True):
        position_m, _ = oracle(recorded)
        np.testing.assert_allclose(window[:, 4:], position_m, rtol=0, atol=1e-12)
    alone, _ = hj.Replay([without]).windows(FRAMES)
    mixed, _ = hj.Replay([with_place, without]).windows(FRAMES)
    np.testing.assert_array_equal(windows[..., :4], alone)
    np.testing.assert_array_equal(mixed, np.concatenate([alone, alone]))


@pytest.mark.slow
def test_a_picture_does_not_move_with_the_eye(rng):
    picture, turns = texture(rng), path(rng)
    poses = np.hstack([turns, 0.1 * rng.normal(size=(len(turns), 3))])
    shown = [
        hj.simulate(picture, CAMERA, HeadMovement(), each) for each in (turns, poses)
    ]
    for one, other in zip(*map(jax.tree.leaves, shown), strict=True):
        np.testing.assert_array_equal(one, other)
