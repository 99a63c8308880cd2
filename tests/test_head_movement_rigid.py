"""Head movement with six degrees of freedom, against matrices of 4 x 4 in float64."""

import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
import small
from scipy.spatial.transform import Rotation, Slerp

import hmdjit as hj
from hmdjit import reprojection
from hmdjit.camera import Camera, Region
from hmdjit.frames.frame import Frame
from hmdjit.frames.motion import Motion, checked_motion
from hmdjit.simulation.halo import needed_halo_px
from hmdjit.studies.measured_blocks import Tiles, WholeFrame
from hmdjit.techniques import HeadMovement

WIDTH, HEIGHT, FOV_DEG, FRAMES = 24, 20, 60.0, 12
VIEW = WIDTH, HEIGHT, FOV_DEG
CAMERA = Camera(WIDTH, HEIGHT, FOV_DEG)
WHOLE = Region.whole(CAMERA)
NORMAL, AWAY_M = np.array([0.5, 0.1, 1.0]), -2.0  # of a slanted plane in the world
RIGID = HeadMovement(reprojects="rigid")


def matrix(pose):
    """World from head, 4 x 4."""
    found = np.eye(4)
    turn = Rotation.from_quat(pose[:4], scalar_first=True)
    found[:3, :3], found[:3, 3] = turn.as_matrix(), pose[4:]
    return found


def between(before, now, closeness):
    """Pose between two, by scipy's slerp and by a line."""
    turns = Rotation.from_quat(np.stack([before[:4], now[:4]]), scalar_first=True)
    turn = Slerp([0.0, 1.0], turns)(closeness).as_quat(scalar_first=True)
    return np.append(turn, before[4:] + closeness * (now[4:] - before[4:]))


def past_displacement(before, now, closeness, depth):
    """Where each pixel's point projects, seen from between the poses, px."""
    found = np.zeros((2, HEIGHT, WIDTH))
    change = np.linalg.inv(matrix(between(before, now, closeness))) @ matrix(now)
    for row in range(HEIGHT):
        for column in range(WIDTH):
            x, y = column + 0.5, row + 0.5
            point = np.append(oracles.ray_of(*VIEW, x, y) * depth[row, column], 1.0)
            if np.isinf(depth[row, column]):
                point = np.append(oracles.ray_of(*VIEW, x, y), 0.0)
            there = oracles.project(*VIEW, (change @ point)[:3])
            found[:, row, column] = there - [x, y]
    return found


def two_poses(rng, turn=0.1, move_m=0.1):
    turns = Rotation.random(rng=rng) * Rotation.from_rotvec(
        turn * rng.normal(size=(2, 3))
    )
    place = [5.0, 1.6, -3.0] + move_m * rng.normal(size=(2, 3))
    return np.hstack([turns.as_quat(scalar_first=True), place])


def step_of(poses):
    """Turn and translation of the second pose."""
    motion = checked_motion(poses, jnp.float64)
    assert motion.translation_m is not None
    return motion.increment[1], motion.translation_m[1]


def frame_of(depth, region=WHOLE):
    depth = jnp.asarray(depth)
    color = jnp.zeros((1, 3, *depth.shape), depth.dtype)
    return Frame(color, CAMERA, region, channels={"depth": depth[None, None]})


@small.quickly
def placed(frame, increment, closeness, translation_m):
    found = reprojection.past_position(frame, increment, closeness, translation_m)
    return jnp.stack(found.px()), found.span(), found.inside()


@pytest.mark.parametrize("closeness", [0.0, 2 / 3, 1.0])
def test_the_past_is_where_matrices_say(rng, closeness):
    depth = 0.5 * 100 ** rng.random((HEIGHT, WIDTH))
    depth[3:6] = np.inf
    poses = two_poses(rng)
    turn, move = step_of(poses)
    found, (low, high), inside = placed(frame_of(depth), turn, closeness, move)
    before, now = poses
    expected = past_displacement(before, now, closeness, depth)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    # Halos rely on the bounds.
    assert (found >= low[:, None, None]).all()
    assert (found <= high[:, None, None]).all()
    x, y = expected + np.mgrid[:HEIGHT, :WIDTH][::-1] + 0.5
    expected = (x >= 0) & (x <= WIDTH) & (y >= 0) & (y <= HEIGHT)
    np.testing.assert_array_equal(inside, expected)


def test_what_does_not_move_or_is_far_away_only_turns(rng):
    increment, moved = jnp.asarray([0.02, -0.03, 0.01]), jnp.asarray([0.1, 0.2, -0.3])
    depth = 1 + rng.random((HEIGHT, WIDTH))
    far = np.full_like(depth, np.inf)
    turned = reprojection.past_position(frame_of(depth), increment, 2 / 3)
    expected = jnp.stack(turned.px())
    for where, move in ((depth, jnp.zeros(3)), (far, moved), (far, jnp.zeros(3))):
        found, _, inside = placed(frame_of(where), increment, 2 / 3, move)
        np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)
        np.testing.assert_array_equal(inside, turned.inside())


def test_a_tile_finds_what_the_whole_frame_finds(rng):
    depth = 1 + rng.random((HEIGHT, WIDTH))
    turn, move = step_of(two_poses(rng, 0.02, 0.02))
    found, span, _ = placed(frame_of(depth), turn, 0.3, move)
    tile = Region(5, 7, 8, 6)
    part = frame_of(depth[7:13, 5:13], tile)
    mine, (low, high), _ = placed(part, turn, 0.3, move)
    np.testing.assert_allclose(mine, found[:, 7:13, 5:13], rtol=0, atol=1e-12)
    assert (low >= span[0]).all()
    assert (high <= span[1]).all()


def test_gradients_are_finite_and_right_also_at_rest(rng):
    depth = jnp.asarray(1 + rng.random((HEIGHT, WIDTH))).at[0].set(jnp.inf)
    turn, move = 0.02 * rng.normal(size=(2, 3))

    @jax.jit
    def total(numbers, depth):
        position = reprojection.past_position(
            frame_of(depth), numbers[:3], numbers[6], numbers[3:6]
        )
        return jnp.sin(jnp.stack(position.px())).sum()

    gradient = jax.jit(jax.grad(total, argnums=(0, 1)))
    for at in (np.zeros(7), np.concatenate([turn, move, [2 / 3]])):
        found, of_depth = gradient(jnp.asarray(at), depth)
        assert jnp.isfinite(of_depth).all()
        expected = oracles.jacobian(lambda v: total(jnp.asarray(v), depth), at)
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-4)


# --- a slanted plane that an eye passes ---


def plane_seen(pose):
    """Depth, and a smooth texture, of the plane that a pose sees."""
    turn = Rotation.from_quat(pose[:4], scalar_first=True)
    x, y = np.arange(WIDTH) + 0.5, np.arange(HEIGHT)[:, None] + 0.5
    rays = np.moveaxis(oracles.ray_of(*VIEW, *np.broadcast_arrays(x, y)), 0, -1)
    world = turn.apply(rays.reshape(-1, 3)).reshape(rays.shape)
    depth = (AWAY_M - NORMAL @ pose[4:]) / (world @ NORMAL)
    points = pose[4:] + depth[..., None] * world
    phase = 3 * points @ np.array([[1, 0.3, 0], [0.2, 1, 0], [0.5, -0.8, 0.3]])
    return depth, 0.5 + 0.4 * np.sin(phase)


def aside(step_m=0.03, turn=0.0):
    """Poses of an eye that moves to the right, and turns a little."""
    k = np.arange(FRAMES)[:, None]
    turns = Rotation.from_rotvec(turn * k * [0.3, 1.0, 0.2])
    return np.hstack([turns.as_quat(scalar_first=True), k * [[step_m, 0.0, 0.0]]])


def shown(technique, poses, clip, **channels):
    return np.asarray(hj.apply(technique, CAMERA, clip, poses, **channels))


def test_points_of_a_plane_show_what_they_showed():
    poses = aside(0.1, turn=0.004)
    turn, move = step_of(poses)
    depth, color = plane_seen(poses[1])
    found, _, inside = placed(frame_of(depth), turn, 0.0, move)
    places = np.asarray(found) + np.mgrid[:HEIGHT, :WIDTH][::-1] + 0.5
    _, before = plane_seen(poses[0])
    places = np.moveaxis(places, 0, -1)
    read = oracles.sample_all(oracles.catmull_rom, before, places)
    inner = (slice(3, -3), slice(3, -3))
    assert np.asarray(inside)[inner].all()
    # The third power of up to 0.4 rad per pixel is what cubics leave.
    error = np.abs(np.moveaxis(read, 0, -1) - color)[inner].max()
    assert error < 0.01 < 0.05 < np.abs(before - color)[inner].max()


def test_a_still_world_converges_where_rotation_alone_ghosts():
    poses = aside()
    depth, clip = (np.stack(each) for each in zip(*map(plane_seen, poses), strict=True))
    full = {"closeness": (0.0,), "h_max_deg_s": 1e3}
    error = {}
    for reprojects in ("rotation", "rigid"):
        technique = HeadMovement(reprojects=reprojects, **full)
        found = shown(technique, poses, clip, depth=depth)
        inner = found[-1, 4:-4, 4:-4] - clip[-1, 4:-4, 4:-4]
        error[reprojects] = np.sqrt(np.mean(inner**2))
    assert 10 * error["rigid"] < error["rotation"]


def test_without_translation_all_is_as_by_rotation(rng):
    clip, depth = rng.random((FRAMES, HEIGHT, WIDTH, 3)), np.ones((FRAMES, 20, 24))
    poses = aside(0.0, turn=0.004)
    usual = shown(HeadMovement(), poses, clip)
    np.testing.assert_allclose(
        shown(RIGID, poses, clip, depth=depth), usual, rtol=0, atol=1e-12
    )
    # Where nothing tells the eye's place, that is the same program.
    np.testing.assert_array_equal(
        shown(RIGID, poses[:, :4], clip, depth=depth),
        shown(HeadMovement(), poses[:, :4], clip),
    )
    with pytest.raises(ValueError, match=r"^head_movement_rigid needs .* depth: give"):
        shown(RIGID, poses, clip)


def test_a_picture_has_no_depth_to_read():
    assert RIGID.on_pictures() == HeadMovement()
    assert RIGID.needs == {"color", "depth"}
    assert HeadMovement().on_pictures().needs == HeadMovement().needs == {"color"}


# --- halos ---

SOLIDS = small.solids(movement=None)


def halo_px(technique, translation_m):
    still = jnp.zeros((1, 5, 3))
    motion = Motion(still, still, still, jnp.broadcast_to(translation_m, (1, 5, 3)))
    origins = np.full((1, 1, 2), 24, np.int32)
    found = needed_halo_px(
        technique, small.CAMERA_8_PX_PER_DEG, motion, origins, (16, 16), SOLIDS
    )
    return int(found[0])


def test_halos_know_how_near_things_are():
    # The plate is 1 m away: a third of 3 px and a little in each of 5 frames, so that
    # a bilinear read reaches 2 px.
    focal_px = float(small.CAMERA_8_PX_PER_DEG.focal_px)
    move = np.array([3.0 / focal_px, 0.0, 0.0])
    assert halo_px(HeadMovement(), move) == 0
    assert 5 < halo_px(RIGID, move) <= 10


@pytest.mark.slow
def test_all_tiles_together_are_the_whole_frame():
    def values(measure):
        run = small.study(
            scenes={"solids": SOLIDS},
            techniques=[RIGID],
            baseline=RIGID.id,
            head=hj.HeadMotion.fixating(),
            sessions=2,
            measure=measure,
        ).run(5)
        return run["mtcd"].values.ravel()

    # As of all halos, 1e-5 of the colour range.
    whole, tiles = values(WholeFrame()), values(Tiles(16, 16))
    assert np.abs(tiles - whole).max() < 9e-3
