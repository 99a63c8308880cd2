"""Where surfaces were in the last frame, against projected points in float64."""

import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
from scipy.spatial.transform import Rotation
from small import quickly

from hmdjit import camera as pinhole
from hmdjit.camera import Camera
from hmdjit.frames.motion import rebased_motion
from hmdjit.frames.velocity import against_object, past_displacement

CAMERA = Camera(1024, 768, 96.0)
VIEW = CAMERA.width_px, CAMERA.height_px, CAMERA.fov_deg
COUNT = 200
past = quickly(past_displacement)
against = quickly(jax.vmap(against_object, in_axes=(None, 0, 0, 0)))


def pixels(rng):
    """Positions in the frame, and how far away what they show is."""
    x, y = rng.random((2, COUNT)) * [[CAMERA.width_px], [CAMERA.height_px]]
    return x, y, 0.3 * 1000 ** rng.random(COUNT)


def oracle(x, y, depth, poses, before=lambda points: points):
    """Where points lay in the last frame, by the world; `before`: world's points."""
    (last, now), place = (
        Rotation.from_quat(poses[:, :4], scalar_first=True),
        poses[:, 4:],
    )
    points = now.apply((depth * oracles.ray_of(*VIEW, x, y)).T) + place[1]
    seen = last.inv().apply(before(points) - place[0])
    return oracles.project(*VIEW, seen.T) - [x, y]


def two_poses(rng, turn=0.05, move_m=0.1):
    turns = Rotation.random(rng=rng) * Rotation.from_rotvec(
        turn * rng.normal(size=(2, 3))
    )
    place = [5.0, 1.6, -3.0] + move_m * rng.normal(size=(2, 3))
    return np.hstack([turns.as_quat(scalar_first=True), place])


def single(*arrays):
    return [jnp.asarray(array, jnp.float32) for array in arrays]


@pytest.mark.parametrize("size", [1.0, 1e-2, 1e-6])
def test_points_lay_where_the_world_says_in_float32(rng, size):
    poses = two_poses(rng, 0.05 * size, 0.1 * size)
    motion = rebased_motion(poses, jnp.float32)
    x, y, depth = (np.float32(array).astype(float) for array in pixels(rng))
    assert motion.translation_m is not None
    head = motion.increment[1], motion.translation_m[1]
    found = past(CAMERA, *single(x, y, depth), *head)
    expected = oracle(x, y, depth, poses)
    largest = np.nanmax(np.abs(expected))
    # The oracle's own difference of positions near 1000 px has 1e-13 of them.
    is_seen = np.isfinite(expected[0]) & (np.abs(expected).max(axis=0) < 1000)
    assert is_seen.sum() > COUNT / 2
    assert largest > 10 * size
    error = np.abs(np.stack(found) - expected)[:, is_seen]
    limit = 1e-3 * np.minimum(1, np.abs(expected).max(axis=0)[is_seen] / 100)
    assert (error < limit + 1e-9).all()


def test_what_is_infinitely_far_only_turns(rng):
    x, y, _ = pixels(rng)
    increment = jnp.asarray([0.02, -0.03, 0.01])
    depth, moved = jnp.full(COUNT, jnp.inf), jnp.asarray([0.1, 0.2, -0.3])
    found = past(CAMERA, jnp.asarray(x), jnp.asarray(y), depth, increment, moved)
    *turned, _ = pinhole.displacement(CAMERA, increment, jnp.asarray(x), jnp.asarray(y))
    np.testing.assert_allclose(
        np.stack(found), np.stack(turned), rtol=1e-13, atol=1e-13
    )


def test_what_lay_behind_the_eye_is_outside_of_the_frame():
    # Walked 2 m backwards: what is 1 m away now was behind.
    x, y = jnp.asarray([0.0, 512.0, 1024.0]), jnp.asarray([0.0, 384.0, 768.0])
    now = jnp.asarray([0.0, 0.0, 2.0])
    place = lambda move: past(CAMERA, x, y, jnp.ones(3), jnp.zeros(3), move)
    dx, dy = place(now)
    assert np.isfinite([dx, dy]).all()
    assert ((x + dx < 0) | (x + dx > CAMERA.width_px)).all()
    assert np.isnan(place(now * jnp.nan)).all()


def test_gradients_are_finite_and_right(rng):
    x, y, depth = map(jnp.asarray, pixels(rng))
    depth = depth.at[0].set(jnp.inf)

    def total(parts):
        scale, increment, moved = parts
        return jnp.stack(
            past_displacement(CAMERA, x, y, scale * depth, increment, moved)
        )

    at_rest = jnp.asarray(1.0), jnp.zeros(3), jnp.zeros(3)
    near_behind = jnp.asarray(1.0), jnp.zeros(3), jnp.asarray([0.0, 0.0, 1.0])
    slope = jax.jit(jax.jacfwd(total))
    for place in (at_rest, near_behind):
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slope(place)))
    _, turning, moving = slope(at_rest)
    by_difference = lambda i: oracles.jacobian(
        lambda v: total((*at_rest[:i], jnp.asarray(v), *at_rest[i + 1 :])), np.zeros(3)
    )
    for found, i in ((turning, 1), (moving, 2)):
        np.testing.assert_allclose(found, by_difference(i), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("dtype", "tolerance_px"), [(float, 1e-9), (np.float32, 1e-3)])
def test_objects_that_move_by_themselves(rng, dtype, tolerance_px):
    poses = two_poses(rng, 0.02, 0.02)
    motion = rebased_motion(poses, dtype)
    now = jax.tree.map(lambda leaf: leaf[1], motion)
    x, y, depth = (np.asarray(a, dtype).astype(float) for a in pixels(rng))
    # Of three, the first is at rest; in world axes, then in those of the hold pose.
    centre = poses[0, 4:] + rng.normal(size=(3, 3))
    turned, moved = 0.1 * rng.normal(size=(2, 3, 3)) * [[[0], [1], [3]]]
    hold = Rotation.from_quat(poses[0, :4], scalar_first=True).inv()
    own = [hold.apply(v) for v in (centre - poses[0, 4:], turned, moved)]
    each = against(now, *(jnp.asarray(v, dtype) for v in own))
    which = rng.integers(0, 3, COUNT)
    pixel = [jnp.asarray(a, dtype) for a in (x, y, depth)]
    found = np.stack(past(CAMERA, *pixel, *each, jnp.asarray(which)))
    for i in range(3):
        turn = Rotation.from_rotvec(turned[i])
        before = lambda p, i=i, turn=turn: (
            turn.inv().apply(p - centre[i]) + centre[i] - moved[i]
        )
        expected = oracle(x, y, depth, poses, before)
        is_seen = (which == i) & (np.abs(expected).max(axis=0) < 1000)
        assert is_seen.sum() > 10
        assert np.abs(found - expected)[:, is_seen].max() < tolerance_px
    np.testing.assert_allclose(each[0][0], now.increment, atol=1e-7)
    np.testing.assert_allclose(each[1][0], now.translation_m, atol=1e-7)
