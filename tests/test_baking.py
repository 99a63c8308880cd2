import dataclasses
import functools
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy.spatial.transform import Rotation
from small import quickly

from hmdjit import scenes
from hmdjit.camera import Camera, Region
from hmdjit.frames.displacement import Displacement

OFFSETS_PX = (np.arange(4) + 0.5) / 4 - 0.5
CAMERAS = {
    "wide": Camera(48, 32, 70.0),
    "tall": Camera(20, 36, 40.0),
    "odd": Camera(31, 29, 96.0),
}


def random_picture(*shape):
    return np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)


SCENES = {
    "photograph": scenes.Photograph.of(random_picture(24, 18, 3)),
    "grey": scenes.Photograph.of(random_picture(24, 18) / 255.0, magnification=3.0),
    "panorama": scenes.Panorama.of(random_picture(64, 128, 3), yaw_deg=30.0),
    "checkerboard": scenes.checkerboard(7.0, dark=0.1, light=0.9),
    "honeycomb": scenes.honeycomb(15.0, wall_deg=3.0),
    "zone_plate": scenes.zone_plate(30.0, cycles_per_deg=0.1),
    "noise": scenes.power_law_noise(1.0, size=64, texels_per_deg=0.5),
    "text": scenes.page_of_text(12.0, texels_per_deg=2),
    "uniform": scenes.uniform((0.2, 0.0, 1.0)),
    "almost_uniform": scenes.almost_uniform(),
}


def rays(camera, x_px, y_px):
    """Directions of pixel positions, shape `(3, rows, columns)`."""
    focal = camera.width_px / 2 / np.tan(np.radians(camera.fov_deg / 2))
    x, y = np.meshgrid(
        (np.asarray(x_px) - camera.width_px / 2) / focal,
        (camera.height_px / 2 - np.asarray(y_px)) / focal,
    )
    return np.stack([x, y, -np.ones_like(x)])


@jax.jit
def color_of(scene, camera, direction):
    return scene.color(camera, direction)


jacobian_of = quickly(jax.jacfwd(color_of, argnums=2))


def seen(scene, camera, x_px, y_px, rotation=(0.0, 0.0, 0.0)):
    """Colours at pixel positions, for a head turned by a rotation vector."""
    turn = Rotation.from_rotvec(rotation).as_matrix()
    direction = np.einsum("ij,j...->i...", turn, rays(camera, x_px, y_px))
    return np.asarray(color_of(scene, camera, jnp.asarray(direction)))


def decode(gamma):
    line = gamma <= 0.04045
    return np.where(line, gamma / 12.92, ((gamma + 0.055) / 1.055) ** 2.4)


def encode(linear):
    line = linear <= 0.0031308
    return np.where(line, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def supersampled(scene, camera, x_px, y_px, rotation=(0.0, 0.0, 0.0)):
    """SSAA(4): all samples of all pixels, then means."""
    x_px = np.add.outer(x_px, OFFSETS_PX).reshape(-1)
    y_px = np.add.outer(y_px, OFFSETS_PX).reshape(-1)
    light = decode(seen(scene, camera, x_px, y_px, rotation))
    light = light.reshape(3, len(y_px) // 4, 4, len(x_px) // 4, 4)
    return encode(light.mean(axis=(2, 4)))


def texel_centers(camera, texture):
    height, width, _ = texture.color.shape
    assert height == texture.oversampling * (camera.height_px + 2 * texture.margin_px)
    assert width == texture.oversampling * (camera.width_px + 2 * texture.margin_px)
    return [
        0.5 + np.arange(size) / texture.oversampling - texture.margin_px
        for size in (width, height)
    ]


@functools.cache
def baked(name, oversampling=2):
    return scenes.bake(
        SCENES[name], CAMERAS["wide"], oversampling=oversampling, dtype=jnp.float64
    )


def check_texels(texture, scene, camera):
    x_px, y_px = texel_centers(camera, texture)
    color = np.moveaxis(seen(scene, camera, x_px, y_px), 0, -1)
    reference = np.moveaxis(supersampled(scene, camera, x_px, y_px), 0, -1)
    # Both sides evaluate one function in float64, at positions that round apart.
    np.testing.assert_allclose(texture.color, color, rtol=0, atol=1e-10)
    np.testing.assert_allclose(texture.supersampled, reference, rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", SCENES)
def test_texels_hold_the_exact_scene_and_its_supersampled_mean(name):
    check_texels(baked(name), SCENES[name], CAMERAS["wide"])


@pytest.mark.parametrize(
    ("oversampling", "camera"), [(1, "wide"), (2, "odd"), (4, "tall")]
)
def test_every_oversampling_and_camera_bakes_the_same_function(oversampling, camera):
    scene, camera = SCENES["checkerboard"], CAMERAS[camera]
    texture = scenes.bake(
        scene, camera, oversampling=oversampling, margin_deg=2.5, dtype=jnp.float64
    )
    check_texels(texture, scene, camera)


@pytest.mark.parametrize("name", ["photograph", "honeycomb"])
def test_float32_textures_agree_with_float64(name):
    single, double = scenes.bake(SCENES[name], CAMERAS["wide"]), baked(name)
    assert single.color.dtype == single.supersampled.dtype == jnp.float32
    # Positions are right to 1e-5 px, so colours of these pictures to 1e-4 of full
    # range; only a sample that falls on the other side of an edge differs by more.
    for field in ("color", "supersampled"):
        difference = np.asarray(getattr(single, field)) - np.asarray(
            getattr(double, field)
        )
        assert (np.abs(difference) > 1e-4).mean() < 1e-3


# Root mean square and mean of (2x texture read at a turned pose - exact scene), for the
# points and for the SSAA(4) reference; colours 0 to 1. At this camera a pixel is
# 1.7 degrees, so the squares are 4 px and the text is a blur: sharp scenes are limited
# by their edges, smooth ones by their curvature. Measured, rounded up by a third.
READ_ERRORS = {
    "photograph": (0.04, 1e-3, 0.022, 4e-3),  # white noise of 1 px: the worst case
    "grey": (8e-3, 1e-3, 5e-3, 1e-3),  # white noise of 3 px
    "panorama": (0.014, 1e-3, 9e-3, 1e-3),
    "checkerboard": (0.19, 4e-3, 0.11, 0.014),
    "honeycomb": (0.19, 0.036, 0.1, 7e-3),  # its walls are 1/4 px thin here
    "zone_plate": (0.012, 1e-3, 0.01, 1e-3),
    "noise": (8e-3, 1e-3, 5e-3, 1e-3),
    "text": (0.13, 8e-3, 0.035, 2e-3),
    "uniform": (1e-15, 1e-15, 1e-15, 1e-15),
    "almost_uniform": (2e-7, 1e-8, 2e-7, 1e-8),
}
TURNED = (0.01, -0.02, 0.005)


def read_errors(name, oversampling):
    scene, camera = SCENES[name], CAMERAS["wide"]
    pixels = np.arange(48) + 0.5, np.arange(32) + 0.5
    points = seen(scene, camera, *pixels, TURNED)
    means = supersampled(scene, camera, *pixels, TURNED)
    displacement = Displacement(camera, Region.whole(camera), jnp.array(TURNED))
    texture = baked(name, oversampling)
    errors = (
        np.asarray(texture.at(displacement)) - points,
        np.asarray(texture.at(displacement, supersampled=True)) - means,
    )
    return [abs(f) for e in errors for f in (np.sqrt(np.mean(e**2)), np.mean(e))]


@pytest.mark.parametrize("name", SCENES)
def test_a_turned_head_reads_what_the_turned_rays_see(name):
    for found, allowed in zip(read_errors(name, 2), READ_ERRORS[name], strict=True):
        assert found <= allowed


def test_a_finer_texture_is_read_better():
    coarse, fine = read_errors("zone_plate", 2), read_errors("zone_plate", 4)
    # Bilinear reading of a smooth scene is of second order: a quarter, averaged over
    # where between texels it is read; these pixels are one draw of that.
    assert fine[0] < 0.35 * coarse[0]
    assert fine[2] < 0.35 * coarse[2]


@pytest.mark.parametrize("name", SCENES)
def test_color_depends_on_the_direction_alone_whatever_its_length_and_shape(name):
    scene, camera = SCENES[name], CAMERAS["wide"]
    direction = rays(camera, [3.3, 20.1, 40.7], [5.2, 25.9])
    color = np.asarray(color_of(scene, camera, jnp.asarray(direction)))
    assert color.shape == (3, 2, 3)
    assert (color >= 0).all()
    assert (color <= 1).all()
    longer = color_of(scene, camera, jnp.asarray(7.0 * direction))
    np.testing.assert_allclose(longer, color, atol=1e-12)
    flat = color_of(scene, camera, jnp.asarray(direction.reshape(3, 6)))
    np.testing.assert_array_equal(flat, color.reshape(3, 6))
    one = color_of(scene, camera, jnp.asarray(direction[:, 1, 2]))
    np.testing.assert_array_equal(one, color[:, 1, 2])
    single = jax.eval_shape(color_of, scene, camera, jnp.float32(direction))
    assert single.dtype == jnp.float32


@pytest.mark.parametrize("name", SCENES)
def test_gradients_of_color_in_the_direction_are_finite(name):
    scene, camera = SCENES[name], CAMERAS["wide"]
    straight = np.array([[0.0, 0.0, -1.0], [0.3, -0.2, -1.0], [1e-9, 0.0, -1.0]])
    around = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
    for direction in np.concatenate([straight, around]):
        assert np.isfinite(jacobian_of(scene, camera, direction)).all()


def test_gradients_of_a_smooth_scene_are_right():
    scene, camera = SCENES["zone_plate"], CAMERAS["wide"]
    check_grads(
        lambda direction: color_of(scene, camera, direction),
        (jnp.array([0.3, -0.2, -1.0]),),
        order=1,
    )


def test_a_flat_scene_is_not_a_number_where_it_cannot_be_seen():
    sideways = jnp.array([[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]])
    for name, scene in SCENES.items():
        color = color_of(scene, CAMERAS["wide"], sideways)
        assert (np.isfinite(color) == (name == "panorama")).all()


class Counted(scenes.AbstractFlatScene):
    """A scene that notes each time that it is compiled."""

    traces: ClassVar[list[str]] = []
    grey: jax.Array
    name: str = eqx.field(static=True)

    def plane_color(self, camera, x, y):
        self.traces.append(self.name)
        return jnp.broadcast_to(self.grey.astype(x.dtype), (3, *x.shape))


def test_scenes_of_one_class_and_shape_share_a_program():
    camera = Camera(8, 8, 50.0)
    first = scenes.bake(Counted(grey=jnp.array(0.25), name="first"), camera)
    compiled = len(Counted.traces)
    assert compiled > 0
    turned = dataclasses.replace(camera, fov_deg=50.1)
    second = scenes.bake(Counted(grey=jnp.array(0.5), name="second"), turned)
    assert len(Counted.traces) == compiled
    assert (first.color == 0.25).all()
    assert (second.color == 0.5).all()


def test_the_margin_holds_what_the_head_can_turn_to():
    camera = Camera(200, 100, 60.0)
    focal = 100 / np.tan(np.radians(30))
    texture = scenes.bake(scenes.uniform(), camera, margin_deg=4.0, oversampling=1)
    needed = focal * (np.tan(np.radians(34)) - np.tan(np.radians(30)))
    assert needed <= texture.margin_px < needed + 1
    tall = Camera(100, 200, 60.0)
    focal = 50 / np.tan(np.radians(30))
    half = np.arctan(100 / focal)
    texture = scenes.bake(scenes.uniform(), tall, margin_deg=4.0, oversampling=1)
    needed = focal * (np.tan(half + np.radians(4)) - np.tan(half))
    assert needed <= texture.margin_px < needed + 1


@pytest.mark.parametrize(
    ("camera", "options", "message"),
    [
        (
            Camera(8, 8, 90),
            {"oversampling": 3},
            "oversampling must be 1, 2 or 4, got 3",
        ),
        (
            Camera(8, 8, 90),
            {"margin_deg": 41.0},
            r"margin_deg must lie in \[0, 40\), got 41",
        ),
        (Camera(8, 8, 90), {"margin_deg": -1.0}, r"margin_deg must lie in .*, got -1"),
        (Camera(8, 8, 175), {}, r"field of view.* \[0, 170\], got 175"),
        (Camera(8, 128, 90), {}, r"field of view.* \[0, 170\], got 172.8"),
    ],
)
def test_what_cannot_be_baked_is_refused_by_name_range_and_value(
    camera, options, message
):
    with pytest.raises(ValueError, match=message):
        scenes.bake(scenes.uniform(), camera, **options)
