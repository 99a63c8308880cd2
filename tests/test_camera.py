import functools
from typing import Any

import cv2
import equinox as eqx
import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import oracles
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from small import quickly
from strategies import rotation_vectors

from hmdjit import camera as pinhole
from hmdjit import camera_bounds, quaternion
from hmdjit.camera import Camera, Region

CAMERA = Camera()  # 1024 px, 96 deg
WIDE = Camera(width_px=120, height_px=80, fov_deg=100.0)
AXES = {"pitch": 0, "yaw": 1, "roll": 2}
DEGREE = np.pi / 180

displacement = pinhole.displacement
position = st.tuples(st.floats(0, 120), st.floats(0, 80))


def turn(axis, angle_rad, dtype: Any = float):
    """The increment of a head that turns about one of its axes."""
    vector = np.zeros(3)
    vector[AXES[axis]] = angle_rad
    return jnp.asarray(vector, dtype)


def oracle_displacement(rotation, x, y, camera=WIDE):
    shape = camera.width_px, camera.height_px, camera.fov_deg
    return oracles.source_position(*shape, rotation, x, y) - np.array([x, y])


# --- construction ---


@pytest.mark.parametrize("fov_deg", [0.0, 180.0, 181.0, -96.0, np.nan, np.inf])
def test_field_of_view_is_checked(fov_deg):
    with pytest.raises(ValueError, match=rf"fov_deg .*\(0, 180\), got {fov_deg:g}"):
        Camera(fov_deg=fov_deg)
    with pytest.raises(ValueError, match=r"fov_deg .*\(0, 180\)"):
        Camera(fov_deg=jnp.asarray(fov_deg))


@pytest.mark.parametrize("side", ["width_px", "height_px"])
@pytest.mark.parametrize("value", [0, -4, 1.5, np.nan])
def test_resolution_is_checked(side, value, untyped):
    with pytest.raises(ValueError, match=rf"{side} .*whole number >= 1, got {value}"):
        Camera(**{side: value})


@pytest.mark.parametrize("refresh_hz", [0.0, -60.0, np.nan, np.inf])
def test_refresh_rate_is_checked(refresh_hz):
    with pytest.raises(ValueError, match=r"refresh_hz .*\(0, inf\), got"):
        Camera(refresh_hz=refresh_hz)


def test_whole_numbers_are_fine_as_angles_and_rates():
    camera = Camera(width_px=200, height_px=100, fov_deg=90, refresh_hz=72)
    np.testing.assert_allclose(camera.focal_px, 100.0, rtol=1e-15)
    assert camera.frame_time_s == 1 / 72


def test_one_compilation_serves_every_camera_of_a_shape_and_every_tile():
    @eqx.debug.assert_max_traces(max_traces=1)
    def bound(camera, region, rotation):
        return camera_bounds.displacement_bound(camera, region, rotation)

    compiled = quickly(bound)
    for fov_deg, x0 in [(90.0, 0), (100.0, 7)]:
        camera = Camera(width_px=32, height_px=16, fov_deg=fov_deg)
        compiled(camera, Region(x0, 3, 8, 8), jnp.zeros(3))


def test_focal_length_can_be_differentiated():
    focal = lambda fov_deg: eqx.tree_at(lambda c: c.fov_deg, CAMERA, fov_deg).focal_px
    gradient = jax.grad(focal)(jnp.asarray(96.0))
    # d/da (W/2) / tan(a/2) = -(W/4) / sin^2(a/2)
    expected = -256 / np.sin(48 * DEGREE) ** 2 * DEGREE
    np.testing.assert_allclose(gradient, expected, rtol=1e-14)


def test_focal_length_keeps_its_digits_near_180_degrees_in_float32():
    # tan(fov / 2) lost 292 eps at 179.9 degrees, the cotangent of the rest loses none.
    for fov_deg in (0.1, 90.0, 96.0, 179.0, 179.9, 179.999):
        fov = np.float32(fov_deg)
        camera = eqx.tree_at(lambda c: c.fov_deg, CAMERA, jnp.asarray(fov))
        with mpmath.workdps(30):
            half = mpmath.mpf(float(fov)) * mpmath.pi / 360
            exact = float(512 / mpmath.tan(half))
        np.testing.assert_allclose(camera.focal_px, exact, rtol=3e-7)


def test_at_rest_the_homography_is_exactly_minus_the_identity():
    # What K and K^-1 do not cancel, 390 eps at 179.9 degrees, is not formed.
    for fov_deg in (0.1, 96.0, 179.9):
        camera = eqx.tree_at(lambda c: c.fov_deg, CAMERA, jnp.float32(fov_deg))
        found = pinhole.homography(camera, jnp.zeros(3, jnp.float32))
        np.testing.assert_array_equal(found, -np.eye(3))


# --- conventions ---


def test_pixel_zero_is_top_left_and_rays_point_right_up_and_ahead():
    top_left = pinhole.pixel_to_ray(CAMERA, jnp.array([0.0, 0.0]))
    side = np.tan(48 * DEGREE)
    np.testing.assert_allclose(top_left, [-side, side, -1.0], rtol=1e-14)
    centre = pinhole.pixel_to_ray(CAMERA, jnp.array([512.0, 512.0]))
    np.testing.assert_array_equal(centre, [0.0, 0.0, -1.0])


def moved(motion, ray):
    """Where a far object moves in the picture when the head turns."""
    pose = quaternion.exp(motion)  # world_from_head, from the identity
    seen = quaternion.rotate(quaternion.conjugate(pose), ray)
    return pinhole.ray_to_pixel(CAMERA, seen) - pinhole.ray_to_pixel(CAMERA, ray)


AHEAD = jnp.array([0.0, 0.0, -1.0])
ONE_DEGREE_PX = 512 / np.tan(48 * DEGREE) * np.tan(DEGREE)


@pytest.mark.parametrize(
    ("axis", "expected"),
    [("yaw", (ONE_DEGREE_PX, 0)), ("pitch", (0, ONE_DEGREE_PX)), ("roll", (0, 0))],
)
def test_a_turn_moves_the_far_centre(axis, expected):
    # Head turns left: content moves right. Head turns up: content moves down.
    np.testing.assert_allclose(moved(turn(axis, DEGREE), AHEAD), expected, atol=1e-10)


def test_a_roll_to_the_left_turns_the_picture_clockwise():
    right = pinhole.pixel_to_ray(CAMERA, jnp.array([612.0, 512.0]))
    expected = [100 * np.cos(DEGREE) - 100, 100 * np.sin(DEGREE)]  # right goes down
    np.testing.assert_allclose(moved(turn("roll", DEGREE), right), expected, atol=1e-10)


def test_displacement_by_the_increment_leads_back_to_the_past_sample():
    # What is at the centre now came from the left when the head turned left.
    dx, dy, in_front = displacement(
        CAMERA, turn("yaw", DEGREE), jnp.asarray(512.0), jnp.asarray(512.0)
    )
    np.testing.assert_allclose([dx, dy], [-ONE_DEGREE_PX, 0], atol=1e-10)
    assert in_front


# --- pixel <-> ray, homography, displacement: one law, three forms, one oracle ---


@given(position)
def test_ray_to_pixel_inverts_pixel_to_ray(xy):
    ray = pinhole.pixel_to_ray(WIDE, jnp.asarray(xy))
    np.testing.assert_allclose(ray, oracles.ray_of(120, 80, 100.0, *xy), atol=1e-14)
    # A few roundings at 120 px; and a ray's length does not matter.
    np.testing.assert_allclose(pinhole.ray_to_pixel(WIDE, 3 * ray), xy, atol=1e-13)


@pytest.mark.parametrize("z", [0.0, 0.1, 1.0])
def test_a_ray_behind_the_camera_has_no_pixel(z):
    assert jnp.isnan(pinhole.ray_to_pixel(WIDE, jnp.array([0.1, 0.2, z]))).all()


@given(rotation_vectors(largest_rad=0.6), position)
def test_displacement_and_homography_agree_with_projection(rotation, xy):
    x, y = xy
    expected = oracle_displacement(rotation, x, y)
    dx, dy, in_front = displacement(WIDE, rotation, jnp.asarray(x), jnp.asarray(y))
    assert in_front
    # A rounding of the depth moves what projects to x by eps x^2 / f, f = 50 px.
    atol = 1e-16 * (150 + np.abs(expected).max()) ** 2
    np.testing.assert_allclose([dx, dy], expected, rtol=0, atol=atol)
    u, v, w = pinhole.homography(WIDE, rotation) @ jnp.array([x, y, 1.0])
    np.testing.assert_allclose([u / w - x, v / w - y], expected, rtol=0, atol=atol)


def test_homography_agrees_with_opencv():
    points = np.array([[10.5, 20.5], [100.0, 3.0], [60.0, 40.0]])
    matrix = pinhole.homography(WIDE, jnp.array([0.02, -0.05, 0.1]))
    theirs = cv2.perspectiveTransform(points[None], np.array(matrix))[0]
    dx, dy, _ = displacement(
        WIDE, jnp.array([0.02, -0.05, 0.1]), *jnp.asarray(points.T)
    )
    np.testing.assert_allclose(points + np.stack([dx, dy], 1), theirs, atol=1e-11)


def test_forms_agree_however_they_are_called(variant):
    rotation, x, y = turn("pitch", 0.1), jnp.asarray(20.0), jnp.asarray(30.0)
    form = functools.partial(displacement, WIDE)
    dx, dy, in_front = variant(form)(rotation, x, y)
    expected = oracle_displacement(rotation, 20.0, 30.0)
    np.testing.assert_allclose([dx, dy], expected, rtol=0, atol=1e-12)
    assert in_front


def test_no_rotation_is_exactly_no_displacement():
    x = jnp.arange(0.5, 120.0)[None, :]
    y = jnp.arange(0.5, 80.0)[:, None]
    dx, dy, in_front = displacement(WIDE, jnp.zeros(3), x, y)
    np.testing.assert_array_equal(dx, np.zeros((80, 120)))
    np.testing.assert_array_equal(dy, np.zeros((80, 120)))
    assert in_front.all()


def test_what_turns_behind_the_camera_is_told_and_does_not_move():
    x = jnp.array([0.0, 59.0, 61.0, 120.0])
    dx, dy, in_front = displacement(WIDE, turn("yaw", np.pi / 2), x, jnp.full(4, 40.0))
    # A quarter turn to the left takes the right half's rays to the front's left half.
    np.testing.assert_array_equal(in_front, [False, False, True, True])
    np.testing.assert_array_equal(dx[~in_front], 0.0)
    np.testing.assert_array_equal(dy[~in_front], 0.0)
    assert jnp.isfinite(dx).all()


def test_a_rotation_that_is_not_a_number_shows():
    nan = jnp.array([0.0, jnp.nan, 0.0])
    dx, dy, in_front = displacement(WIDE, nan, jnp.asarray(3.0), jnp.asarray(4.0))
    assert jnp.isnan(dx)
    assert jnp.isnan(dy)
    assert not in_front


@pytest.mark.parametrize("length", [1e-5, 1e-4, 1e-3, 1e-2, 0.1])
def test_displacement_in_float32_is_as_good_as_the_picture_needs(rng, length):
    axes = rng.normal(size=(10, 3))
    rotations = length * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    rotations = rotations.astype(np.float32)
    grid = np.linspace(0.5, 1023.5, 25)
    x, y = (plane.astype(np.float32) for plane in np.meshgrid(grid, grid))

    def field(dtype):
        planes = jnp.asarray(x, dtype), jnp.asarray(y, dtype)
        form = jax.vmap(lambda r: displacement(CAMERA, r, *planes)[:2])
        return np.stack(form(jnp.asarray(rotations, dtype)))

    error = np.abs(field(jnp.float32) - field(jnp.float64))
    largest = np.abs(field(jnp.float64)).max(axis=(0, 2, 3), keepdims=True)
    assert error.max() < 1e-4
    # A dozen roundings, and the ray's own, on the longest displacement.
    assert (error / largest).max() < 16 * np.finfo(np.float32).eps


def test_displacement_keeps_digits_that_positions_lose():
    x = jnp.asarray(1000.5, jnp.float32)
    dx, _, _ = displacement(CAMERA, turn("yaw", 1e-7, np.float32), x, x)
    exact, _, _ = displacement(CAMERA, turn("yaw", 1e-7), *jnp.full((2,), 1000.5))
    np.testing.assert_allclose(dx, exact, rtol=1e-6)
    ray = pinhole.pixel_to_ray(CAMERA, jnp.stack([x, x]))
    turned = quaternion.rotate(quaternion.exp(turn("yaw", 1e-7, np.float32)), ray)
    lost = pinhole.ray_to_pixel(CAMERA, turned)[0] - x
    assert abs(float(lost) / float(exact) - 1) > 0.1


# --- bound ---


def largest_displacement(camera, region, rotation):
    """Brute force over the region's pixel edges and whatever lies between."""
    x = region.x0 + jnp.linspace(0.0, region.width, 9)[None, :]
    y = region.y0 + jnp.linspace(0.0, region.height, 9)[:, None]
    dx, dy, in_front = displacement(camera, rotation, x, y)
    largest = jnp.stack([jnp.abs(dx).max(), jnp.abs(dy).max()])
    return jnp.where(in_front.all(), largest, jnp.inf)


BOUND = quickly(camera_bounds.displacement_bound)
LARGEST = quickly(largest_displacement)


@given(
    rotation_vectors(),
    st.floats(1.0, 175.0),
    st.tuples(st.integers(0, 112), st.integers(0, 72)),
)
@example(jnp.array([0.0, 0.9, 0.0]), 100.0, (0, 0))  # near the horizon
@example(jnp.array([0.0, np.pi / 2, 0.0]), 60.0, (60, 36))  # behind
def test_displacement_bound_is_never_too_small(rotation, fov_deg, origin):
    camera = Camera(width_px=120, height_px=80, fov_deg=fov_deg)
    x0, y0 = origin
    tile = Region(x0, y0, 8, 8)
    for region in (tile, Region.whole(camera)):
        for dtype in (jnp.float64, jnp.float32):
            rounded = rotation.astype(dtype)
            bound = BOUND(camera, region, rounded)
            assert bound.dtype == dtype
            largest = LARGEST(camera, region, rounded.astype(float))
            assert (bound.astype(float) >= largest).all()


@given(rotation_vectors(largest_rad=0.1, smallest_rad=1e-8))
def test_displacement_bound_of_a_small_rotation_is_not_silly(rotation):
    region = Region.whole(CAMERA)
    bound = BOUND(CAMERA, region, rotation)
    # Axis by axis |dx| may be 0 where the bound adds up: compare the larger of the two.
    largest = LARGEST(CAMERA, region, rotation)
    assert bound.max() <= 3 * largest.max()


def test_displacement_bound_at_rest_is_zero_and_behind_is_infinite():
    region = Region.whole(CAMERA)
    np.testing.assert_array_equal(BOUND(CAMERA, region, jnp.zeros(3)), [0.0, 0.0])
    assert jnp.isinf(BOUND(CAMERA, region, turn("yaw", 1.0))).all()
    assert jnp.isinf(BOUND(CAMERA, region, turn("yaw", np.nan))).all()


# --- gradients ---


@jax.jit
def along_a_line(rotation):
    x = jnp.linspace(0.0, 120.0, 7)
    return jnp.stack(displacement(WIDE, rotation, x, jnp.full(7, 70.0))[:2])


line_jacobian = quickly(jax.jacfwd(along_a_line))


@pytest.mark.parametrize("length", [0.0, 1e-10, 1e-3, 0.3])
def test_displacement_gradient_agrees_with_differences(length):
    rotation = length * np.array([0.48, -0.6, 0.64])
    differences = oracles.jacobian(lambda r: along_a_line(jnp.asarray(r)), rotation)
    # 1e-10 of the third derivative, up to 1e4 px, and rounding of 100 px over 1e-5.
    ours = line_jacobian(jnp.asarray(rotation))
    np.testing.assert_allclose(ours, differences, rtol=0, atol=2e-6)


@pytest.mark.parametrize("angle", [np.pi / 2, np.pi])
def test_displacement_gradient_is_finite_behind_and_on_the_horizon(angle):
    assert jnp.isfinite(line_jacobian(turn("yaw", angle))).all()


# --- angular resolution ---


@functools.cache
def resolution_over_the_frame():
    centres = jnp.arange(0.5, 1024.0, 16.0) + 7.5
    grid = jnp.stack(jnp.meshgrid(centres, centres), axis=-1).reshape(-1, 2)
    return jax.vmap(lambda p: pinhole.px_per_deg(CAMERA, p))(grid)


def test_px_per_deg_is_that_of_the_default_camera():
    at = lambda x, y: pinhole.px_per_deg(CAMERA, jnp.array([x, y]))
    np.testing.assert_allclose(at(512.0, 512.0), [8.05, 8.05], atol=0.005)
    np.testing.assert_allclose(at(0.0, 512.0)[0], 17.97, atol=0.005)
    np.testing.assert_allclose(at(512.0, 1024.0)[1], 17.97, atol=0.005)


def test_px_per_deg_over_the_frame_is_not_that_of_the_centre():
    # The mean of 64 x 64 blocks of 16 px differs from that of all pixels by 1e-3.
    mean = resolution_over_the_frame().mean(axis=0)
    np.testing.assert_allclose(mean, [11.75, 11.75], atol=0.006)


def test_px_per_deg_is_the_slope_of_the_displacement():
    for x, y in [(3.0, 70.0), (60.0, 40.0), (110.0, 0.0)]:
        ours = pinhole.px_per_deg(WIDE, jnp.array([x, y]))
        for axis, slope in zip(["yaw", "pitch"], ours, strict=True):
            small = turn(axis, 1e-6 * DEGREE)
            dx, dy, _ = displacement(WIDE, small, jnp.asarray(x), jnp.asarray(y))
            np.testing.assert_allclose(np.hypot(dx, dy) / 1e-6, slope, rtol=1e-6)


# --- regions ---


def test_regions_number_their_pixels_in_the_camera_frame():
    tile = Region(5, 2, 3, 2)
    np.testing.assert_array_equal(tile.columns(), [[5, 6, 7]])
    np.testing.assert_array_equal(tile.rows(), [[2], [3]])
    whole = Region.whole(WIDE)
    assert (whole.width, whole.height) == (120, 80)
    assert whole.columns().dtype == whole.rows().dtype == jnp.int32
