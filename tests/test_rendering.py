import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
from small import quickly

from hmdjit import rendering, scenes
from hmdjit.camera import Camera, Region
from hmdjit.frames.motion import Motion
from hmdjit.frames.texture import Texture
from hmdjit.scenes.base import AbstractFlatScene
from hmdjit.simulation.views import Pattern
from hmdjit.techniques import MSAA, SSAA, NoAntialiasing

WIDTH, HEIGHT, FOV_DEG = 12, 9, 40.0
CAMERA = Camera(width_px=WIDTH, height_px=HEIGHT, fov_deg=FOV_DEG)
WHOLE = Region.whole(CAMERA)
TILE = Region(5, 2, 4, 3)
TURN = np.array([0.02, -0.05, 0.04])  # moves pixels by up to 2 px

SLOPES = np.array([[0.3, -0.2], [-0.1, 0.4], [0.2, 0.2]])  # per unit of the plane


class Ramp(AbstractFlatScene):
    """Affine on the plane, so that bilinear reads are exact."""

    name: str = eqx.field(static=True, default="ramp")

    def plane_color(self, camera, x, y):
        return jnp.stack([0.5 + a * x + b * y for a, b in SLOPES])


class Disc(AbstractFlatScene):
    """A hard edge."""

    name: str = eqx.field(static=True, default="disc")

    def plane_color(self, camera, x, y):
        inside = ((x - 0.02) ** 2 + (y + 0.03) ** 2 < 0.03).astype(x.dtype)
        return jnp.stack([inside, 0.2 + 0.6 * inside, 1 - inside])


def exact_color(scene, rotation, x, y):
    """Gamma colour `(..., 3)` that turned rays of pixel positions meet."""
    ray = oracles.ray_of(WIDTH, HEIGHT, FOV_DEG, x, y)
    ray = np.tensordot(oracles.rotation_matrix(rotation), ray, axes=1)
    plane = [jnp.asarray(axis) for axis in ray[:2] / -ray[2]]
    return np.moveaxis(np.asarray(scene.plane_color(CAMERA, *plane)), 0, -1)


def supersampled(scene, rotation, factor):
    """Brute force: the box mean over `factor`^2 samples per pixel, in light."""
    x, y = np.meshgrid(np.arange(WIDTH * factor), np.arange(HEIGHT * factor))
    gamma = exact_color(scene, rotation, (x + 0.5) / factor, (y + 0.5) / factor)
    light = oracles.srgb_decode(gamma)
    light = light.reshape(HEIGHT, factor, WIDTH, factor, 3).mean(axis=(1, 3))
    return np.moveaxis(oracles.srgb_encode(light), -1, 0)


def centres(region):
    x, y = np.meshgrid(np.arange(region.width), np.arange(region.height))
    return region.x0 + x + 0.5, region.y0 + y + 0.5


@quickly
def resolved(technique, texture, region, offset):
    pattern = Pattern.of(technique, texture.gives)
    now, samples = Motion(offset, offset), np.asarray(pattern.samples[0])
    channels = pattern.channels
    return technique.resolve(
        rendering.render(texture, CAMERA, region, now, samples, channels=channels)
    )


def shown(technique, texture, offset, region=WHOLE):
    offset = jnp.asarray(offset, texture.color.dtype)
    return np.asarray(resolved(technique, texture, region, offset))


@pytest.fixture(scope="module")
def ramp():
    return scenes.bake(Ramp(), CAMERA, margin_deg=6.0, dtype=jnp.float64)


@pytest.fixture
def noise(rng, ramp):
    """A texture of noise, of the same shape."""
    color, reference = jnp.asarray(rng.random((2, *ramp.color.shape)))
    return Texture.of(color, reference, ramp.oversampling, ramp.margin_px)


@pytest.mark.parametrize("region", [WHOLE, TILE], ids=["whole", "tile"])
def test_a_sample_is_the_texture_where_its_turned_ray_meets_it(noise, region):
    samples = np.array([[0.25, -0.25], [0.0, 0.0], [-0.5, 0.4]])
    render = quickly(
        lambda r: rendering.render(noise, CAMERA, region, Motion(r, r), samples)
    )
    frame = render(jnp.asarray(TURN))
    for sample, ours in zip(samples, frame.color, strict=True):
        x, y = centres(region)
        past = oracles.source_position(
            WIDTH, HEIGHT, FOV_DEG, TURN, x + sample[0], y + sample[1]
        )
        expected = oracles.bilinear_at(
            np.asarray(noise.color), *(2 * (past + noise.margin_px - 0.5) + 0.5)
        )
        # 40 texels, a few roundings, slopes of at most 2.
        np.testing.assert_allclose(
            ours, np.moveaxis(expected, -1, 0), rtol=0, atol=1e-13
        )


@pytest.mark.parametrize("offset", [np.zeros(3), TURN], ids=["hold", "turned"])
@pytest.mark.parametrize("technique", [NoAntialiasing(), SSAA(2)], ids=lambda t: t.id)
def test_supersampling_agrees_with_brute_force(ramp, technique, offset):
    factor = round(technique.sample_offsets_px.shape[1] ** 0.5)
    expected = supersampled(Ramp(), offset, factor)
    ours = shown(technique, ramp, offset)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-12)


def test_the_reference_agrees_with_brute_force_at_the_hold_pose():
    # One texel per pixel: each carries just its own pixel's 16 samples.
    for scene in (Ramp(), Disc()):
        texture = scenes.bake(
            scene, CAMERA, oversampling=1, margin_deg=1.0, dtype=jnp.float64
        )
        expected = supersampled(scene, np.zeros(3), 4)
        ours = shown(SSAA(4), texture, np.zeros(3))
        np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-12)


def test_the_reference_is_near_brute_force_off_the_hold_pose(ramp):
    # The box is that of the hold pose's plane, turned by 0.04 rad and scaled by a few
    # percent; of a ramp it is its mean, but for gamma's curvature over a pixel: 1e-5.
    ours = shown(SSAA(4), ramp, TURN)
    expected = supersampled(Ramp(), TURN, 4)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-5)


def test_multisamples_shade_a_picture_only_at_the_pixel_centre(ramp):
    # Rendered sample by sample a texture would be supersampled: 4 different pictures.
    technique = MSAA(4).on_pictures()
    expected = supersampled(Ramp(), TURN, 1)
    ours = shown(technique, ramp, TURN)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("technique", [SSAA(2), SSAA(4)], ids=lambda t: t.id)
def test_a_tile_is_the_same_block_of_the_whole_frame(noise, technique):
    whole = shown(technique, noise, TURN)
    tile = shown(technique, noise, TURN, TILE)
    # Two programs may fuse differently: roundings of 40 texels.
    np.testing.assert_allclose(tile, whole[:, 2:5, 5:9], rtol=0, atol=1e-14)


def test_a_frame_holds_colour_and_nothing_else(noise):
    samples = SSAA(2).sample_offsets_px[0]

    @quickly
    def render(offset):
        now = Motion(offset, offset)
        frame, one_read = (
            rendering.render(noise, CAMERA, WHOLE, now, where, channels={name})
            for where, name in ((samples, "color"), (np.zeros((1, 2)), "supersampled"))
        )
        return frame, one_read, rendering.reference(noise, CAMERA, WHOLE, now)

    frame, one_read, reference = render(jnp.asarray(TURN))
    assert frame.color.shape == (4, 3, HEIGHT, WIDTH)
    shapes = {leaf.shape for leaf in jax.tree.leaves(frame)}
    assert shapes == {(), frame.color.shape}  # else the camera's and region's numbers
    assert one_read.color.shape == (1, 3, HEIGHT, WIDTH)
    np.testing.assert_array_equal(one_read.color[0], reference)


def test_a_texture_of_codes_is_that_of_their_colours(rng):
    codes = rng.integers(0, 256, (4, 6, 3), dtype=np.uint8)
    texture = Texture.of(codes, 257 * codes.astype(np.uint16), 2, 0)
    np.testing.assert_allclose(texture.color, codes / 255, rtol=1e-15)
    np.testing.assert_allclose(texture.supersampled, codes / 255, rtol=1e-15)
    half = jnp.zeros((4, 6, 3), jnp.bfloat16)
    assert Texture.of(half, half, 2, 0).color.dtype == jnp.bfloat16


@pytest.mark.parametrize(
    ("color", "message"),
    [
        (
            np.full((4, 6, 3), 255.0),
            r"color must lie in \[0, 1\], got float64 from 255",
        ),
        (np.zeros((4, 6, 3), np.int64), "color must be uint8, .* got int64"),
        (np.zeros((4, 6, 4)), r"one shape .* got \(4, 6, 4\) and \(4, 6, 3\)"),
        (np.zeros((3, 6, 3)), r"multiples of oversampling = 2, got \(3, 6, 3\)"),
    ],
)
def test_what_is_no_texture_is_refused(color, message):
    with pytest.raises(ValueError, match=message):
        Texture.of(color, np.zeros((4, 6, 3)), 2, 0)


def test_samples_may_change_from_frame_to_frame(noise):
    # Traced, not constants of the program.
    now = Motion(jnp.asarray(TURN), jnp.asarray(TURN))
    render = quickly(
        lambda where: rendering.render(noise, CAMERA, WHOLE, now, where).color
    )
    expected = shown(NoAntialiasing(), noise, TURN)
    at_centre, elsewhere = (render(jnp.full((1, 2), px))[0] for px in (0.0, 0.3))
    np.testing.assert_allclose(at_centre, expected, rtol=0, atol=1e-13)
    assert (elsewhere != expected).all()
