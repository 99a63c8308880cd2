import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
from hypothesis import given
from scipy.spatial.transform import Rotation
from strategies import fractions, orientations, rotation_vectors

from hmdjit import reprojection
from hmdjit.camera import Camera, Region
from hmdjit.frames.frame import Frame

WIDTH, HEIGHT, FOV_DEG = 12, 9, 80.0
CAMERA = Camera(width_px=WIDTH, height_px=HEIGHT, fov_deg=FOV_DEG)
TURN = np.array([0.02, -0.05, 0.03])


def frame_of(camera, region, dtype=float):
    return Frame(jnp.zeros((1, 3, region.height, region.width), dtype), camera, region)


WHOLE = frame_of(CAMERA, Region.whole(CAMERA))


@jax.jit
def displacement(increment, closeness, frame=WHOLE):
    return reprojection.past_position(frame, increment, closeness).px()


@jax.jit
def inside(increment, closeness, frame=WHOLE):
    return reprojection.past_position(frame, increment, closeness).inside()


def equation_1(before, increment, closeness):
    """Displacement by the two absolute poses, px, `(2, h, w)`."""
    turn = Rotation.from_rotvec(np.array(increment))
    now = (Rotation.from_quat(before, scalar_first=True) * turn).as_quat(
        scalar_first=True
    )
    past = oracles.kim_past_position(WIDTH, HEIGHT, FOV_DEG, before, now, closeness)
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    return past - [x, y]


@given(orientations, rotation_vectors(largest_rad=0.3), fractions)
def test_past_position_agrees_with_equation_1(before, increment, closeness):
    expected = equation_1(np.array(before), increment, closeness)
    ours = displacement(increment, closeness)
    # Quaternions and positions of some 10 px, f = 7 px, rays of at most 2.
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-12)


@given(rotation_vectors(largest_rad=0.3))
def test_full_inversion_is_where_the_pixel_was(increment):
    # d = 0: the world point that a pixel shows now, seen by the head before.
    before_from_now = Rotation.from_rotvec(np.array(increment))
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    world = before_from_now.as_matrix() @ oracles.ray_of(
        WIDTH, HEIGHT, FOV_DEG, x, y
    ).reshape(3, -1)
    then = oracles.project(WIDTH, HEIGHT, FOV_DEG, world).reshape(2, HEIGHT, WIDTH)
    ours = displacement(increment, 0.0) + np.stack([x, y])
    np.testing.assert_allclose(ours, then, rtol=0, atol=1e-12)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_the_current_pose_displaces_nothing(dtype):
    increment = jnp.asarray(100 * TURN, dtype)
    dx, dy = displacement(increment, 1.0)
    np.testing.assert_array_equal(dx, np.zeros((HEIGHT, WIDTH)))
    np.testing.assert_array_equal(dy, np.zeros((HEIGHT, WIDTH)))
    assert inside(increment, 1.0).all()


def test_a_head_turning_left_finds_the_past_on_the_left():
    # The picture moves to the right, by f tan(angle) in the centre of an odd width.
    camera = Camera(width_px=33, height_px=5, fov_deg=FOV_DEG)
    frame = frame_of(camera, Region.whole(camera))
    yaw = np.radians(1.0)
    dx, dy = displacement(jnp.asarray([0.0, yaw, 0.0]), 0.0, frame)
    assert dx[2, 16] == pytest.approx(-camera.focal_px * np.tan(yaw), rel=1e-12)
    assert dy[2, 16] == pytest.approx(0.0, abs=1e-12)
    dx, _ = displacement(jnp.asarray([0.0, yaw, 0.0]), 2 / 3, frame)
    assert dx[2, 16] == pytest.approx(-camera.focal_px * np.tan(yaw / 3), rel=1e-12)


@pytest.mark.parametrize("increment_rad", [1e-5, 1e-4, 1e-3, 1e-2])
def test_float32_is_right_to_a_thousandth_of_a_pixel(rng, increment_rad):
    # In the corner of the default camera, where a rotation moves pixels most.
    camera = Camera()
    tile = Region(camera.width_px - 16, 0, 16, 16)
    increment = rng.normal(size=3)
    increment *= increment_rad / np.linalg.norm(increment)
    rounded = increment.astype(np.float32)
    frames = [frame_of(camera, tile, dtype) for dtype in (jnp.float32, jnp.float64)]
    ours = np.stack(displacement(jnp.asarray(rounded), 2 / 3, frames[0]))
    assert ours.dtype == np.float32
    exact = displacement(jnp.asarray(rounded, float), 2 / 3, frames[1])
    error = np.abs(ours - np.stack(exact)).max()
    # Of a displacement of up to 12 px: some ten roundings.
    assert error < min(1e-3, 16 * 6e-8 * np.abs(exact).max())


def test_only_pixels_whose_past_was_seen_are_inside():
    # d = 0, a yaw to the left by 2.5 px or more: the left columns come from outside.
    yaw = np.arctan(2.5 / oracles.focal_px(WIDTH, FOV_DEG))
    increment = jnp.asarray([0.0, yaw, 0.0])
    past_x = (
        equation_1([1.0, 0.0, 0.0, 0.0], increment, 0.0)[0] + np.arange(WIDTH) + 0.5
    )
    expected = past_x >= 0
    assert not expected[:, :3].any()
    assert expected[:, -3:].all()
    columns = slice(1, HEIGHT - 1)  # the yaw also bends rows over the upper edge
    np.testing.assert_array_equal(inside(increment, 0.0)[columns], expected[columns])


def test_gradients_agree_with_differences_also_at_rest():
    total = lambda v: jnp.sin(jnp.stack(displacement(v[:3], v[3]))).sum()
    gradient = jax.jit(jax.grad(total))
    for increment in (TURN, np.zeros(3)):
        at = np.append(increment, 2 / 3)
        # Third derivatives of a sum of 216 terms, times the step squared.
        expected = oracles.jacobian(lambda v: total(jnp.asarray(v)), at)
        np.testing.assert_allclose(
            gradient(jnp.asarray(at)), expected, rtol=1e-6, atol=1e-6
        )
