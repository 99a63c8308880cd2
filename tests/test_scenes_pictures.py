import struct
import zlib

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tifffile
from PIL import Image, ImageCms

from hmdjit import scenes
from hmdjit.camera import Camera, Region
from hmdjit.frames.displacement import Displacement
from hmdjit.scenes import pictures

CAMERA = Camera(32, 24, 60.0)
FOCAL = 16 / np.tan(np.radians(30))


def looking_at(x_px, y_px, camera=CAMERA):
    """Directions of pixel positions, shape `(3, rows, columns)`."""
    x, y = np.meshgrid(
        (np.asarray(x_px) - camera.width_px / 2) / camera.focal_px,
        (camera.height_px / 2 - np.asarray(y_px)) / camera.focal_px,
    )
    return jnp.asarray(np.stack([x, y, -np.ones_like(x)]))


@jax.jit
def color_of(scene, direction, camera=CAMERA):
    return scene.color(camera, direction)


def codes(scene, shape):
    """The scene's colours at the pixel centres of a frame, in 8 bits."""
    height, width = shape
    camera = Camera(width, height, 60.0)
    x_px, y_px = np.arange(width) + 0.5, np.arange(height) + 0.5
    color = np.asarray(color_of(scene, looking_at(x_px, y_px, camera), camera))
    return np.moveaxis(color * 255, 0, -1)


@pytest.fixture
def picture(rng):
    return rng.integers(0, 256, (24, 32, 3), dtype=np.uint8)


def test_a_picture_of_the_cameras_size_is_its_frame(picture):
    scene = scenes.Photograph.of(picture)
    np.testing.assert_allclose(codes(scene, (24, 32)), picture, atol=1e-9)
    texture = scenes.bake(scene, CAMERA, oversampling=1, dtype=jnp.float64)
    still = Displacement(CAMERA, Region.whole(CAMERA), jnp.zeros(3))
    frame = np.moveaxis(np.asarray(texture.at(still)), 0, -1)
    np.testing.assert_allclose(frame * 255, picture, atol=1e-9)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32, np.float64])
def test_every_kind_of_number_keeps_its_value(kind, picture):
    gamma = picture / 255
    full = np.iinfo(kind).max if np.issubdtype(kind, np.integer) else 1
    scene = scenes.Photograph.of((gamma * full).round(9).astype(kind))
    step = 1e-7 if np.issubdtype(kind, np.floating) else 1 / full
    np.testing.assert_allclose(codes(scene, (24, 32)) / 255, gamma, atol=step)


def test_grey_is_three_equal_channels(picture):
    grey = scenes.Photograph.of(picture[..., 0])
    color = scenes.Photograph.of(np.repeat(picture[..., :1], 3, axis=2))
    np.testing.assert_array_equal(codes(grey, (24, 32)), codes(color, (24, 32)))


def test_a_picture_continues_as_its_mirror_image(picture):
    scene = scenes.Photograph.of(picture)
    padded = np.pad(picture, ((40, 40), (50, 50), (0, 0)), mode="symmetric")
    np.testing.assert_allclose(codes(scene, padded.shape[:2]), padded, atol=1e-9)


def test_between_texels_gamma_is_interpolated(picture):
    scene = scenes.Photograph.of(picture)
    x_px, y_px = 7.5 + 0.25, 11.5 + 0.6
    color = color_of(scene, looking_at([x_px], [y_px]))[:, 0, 0]
    row = 0.4 * picture[11].astype(float) + 0.6 * picture[12]
    np.testing.assert_allclose(color * 255, 0.75 * row[7] + 0.25 * row[8], atol=1e-9)


def test_magnification_is_display_pixels_per_texel(picture):
    scene = scenes.Photograph.of(picture, magnification=3.0)
    texels = np.arange(10, 20)
    x_px = 16 + 3.0 * (texels + 0.5 - 16)
    y_px = 12 + 3.0 * (np.arange(24) + 0.5 - 12)
    color = np.asarray(color_of(scene, looking_at(x_px, y_px)))
    expected = np.moveaxis(picture[:, texels], -1, 0)
    np.testing.assert_allclose(color * 255, expected, atol=1e-9)


def test_magnification_is_a_number_that_can_be_varied_and_differentiated(picture):
    scene, direction = scenes.Photograph.of(picture), looking_at([3.2, 8.7], [5.1])

    @jax.jit
    def mean(magnification):
        varied = eqx.tree_at(lambda s: s.magnification, scene, magnification)
        return varied.color(CAMERA, direction).mean()

    step = 1e-6
    central = (mean(1.1 + step) - mean(1.1 - step)) / (2 * step)
    assert float(jax.grad(mean)(1.1)) == pytest.approx(float(central), rel=1e-6)


@pytest.mark.parametrize(
    ("picture", "message"),
    [
        (np.zeros((4, 4, 2), np.uint8), r"\(height, width, 3\), got \(4, 4, 2\)"),
        (np.zeros(4, np.uint8), r"\(height, width, 3\), got \(4,\)"),
        (np.zeros((0, 4), np.uint8), r"at least 1 x 1, got \(0, 4\)"),
        (np.zeros((4, 4), np.int64), "uint8, uint16 or floating, got int64"),
        (np.full((4, 4), 1.5), r"picture must lie in \[0, 1\], got 1.5"),
        (np.full((4, 4), -0.5), r"picture must lie in \[0, 1\], got -0.5"),
        (np.full((4, 4), np.nan), r"picture must lie in \[0, 1\], got nan"),
    ],
)
def test_what_is_no_picture_is_refused(picture, message):
    with pytest.raises(ValueError, match=message):
        scenes.Photograph.of(picture)


@pytest.mark.parametrize("kind", [scenes.Photograph, scenes.Panorama])
def test_planes_in_the_order_of_a_picture_are_refused(kind):
    with pytest.raises(ValueError, match=r"\(3, height, width\), got \(4, 8, 3\)"):
        kind(jnp.zeros((4, 8, 3), jnp.uint8))
    with pytest.raises(ValueError, match="uint8, uint16 or floating, got int32"):
        kind(jnp.zeros((3, 4, 8), jnp.int32))


def test_a_panorama_may_be_one_percent_off():
    for width in (99, 100, 101):
        scenes.Panorama.of(np.zeros((50, width), np.uint8))
    with pytest.raises(ValueError, match=r"within 1 %, got 102 x 50"):
        scenes.Panorama.of(np.zeros((50, 102), np.uint8))


def test_options_out_of_range_are_refused(picture):
    with pytest.raises(
        ValueError, match=r"magnification must lie in \(0, inf\), got 0"
    ):
        scenes.Photograph.of(picture, magnification=0.0)
    with pytest.raises(ValueError, match=r"yaw_deg must lie in .*, got inf"):
        scenes.Panorama.of(np.zeros((4, 8), np.uint8), yaw_deg=np.inf)
    with pytest.raises(ValueError, match=r"2:1 .* within 1 %, got 9 x 4"):
        scenes.Panorama.of(np.zeros((4, 9), np.uint8))


# Panorama


def panorama_oracle(picture, direction, yaw_deg=0.0):
    """Bilinear in gamma on a picture padded by wrapping and by its border rows."""
    height, width, _ = picture.shape
    padded = np.pad(picture / 255, ((1, 1), (0, 0), (0, 0)), mode="edge")
    padded = np.pad(padded, ((0, 0), (1, 1), (0, 0)), mode="wrap")
    x, y, z = np.asarray(direction) / np.linalg.norm(direction)
    right = np.degrees(np.angle(-z + 1j * x)) - yaw_deg
    column = (0.5 + right / 360) % 1 * width + 0.5  # of the padded picture
    row = (0.5 - np.degrees(np.arcsin(y)) / 180) * height + 0.5
    i, j = min(int(column), width), min(int(row), height)
    u, v = column - i, row - j
    low, high = padded[j, i : i + 2], padded[j + 1, i : i + 2]
    return (1 - v) * ((1 - u) * low[0] + u * low[1]) + v * (
        (1 - u) * high[0] + u * high[1]
    )


def test_a_panorama_agrees_with_an_independent_reader(rng):
    picture = rng.integers(0, 256, (16, 32, 3), dtype=np.uint8)
    scene = scenes.Panorama.of(picture, yaw_deg=25.0)
    directions = rng.standard_normal((3, 200))
    expected = [panorama_oracle(picture, d, 25.0) for d in directions.T]
    found = color_of(scene, jnp.asarray(directions))
    np.testing.assert_allclose(np.asarray(found).T, expected, atol=1e-10)


def test_the_directions_of_a_panorama():
    picture = np.zeros((4, 8), np.uint8)
    picture[1:3, 3:5] = 100  # the centre
    picture[1:3, 5:7] = 150  # right of it
    picture[0] = 200  # the top
    scene = scenes.Panorama.of(picture)
    axes = jnp.array([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -1.0], [-1.0, 0, 0, 0]])
    ahead, right, up, down = np.asarray(color_of(scene, axes))[0] * 255
    np.testing.assert_allclose([ahead, right, up, down], [100, 150, 200, 0], atol=1e-9)


@pytest.mark.parametrize("columns", [1, 5, -3])
def test_a_yaw_by_one_column_shifts_the_panorama_by_one_column(columns, rng):
    picture = rng.integers(0, 256, (16, 32, 3), dtype=np.uint8)
    yaw = np.radians(columns * 360 / 32)  # the head turns left
    turn = [[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]]
    direction = looking_at([2.3, 20.0], [6.5, 17.1])
    turned = jnp.einsum("ij,j...->i...", jnp.asarray(turn), direction)
    moved = scenes.Panorama.of(np.roll(picture, columns, axis=1))
    found = color_of(scenes.Panorama.of(picture), turned)
    np.testing.assert_allclose(found, color_of(moved, direction), atol=1e-10)
    heading = scenes.Panorama.of(picture, yaw_deg=columns * 360 / 32)
    found = color_of(heading, direction)
    np.testing.assert_allclose(found, color_of(moved, direction), atol=1e-10)


# Files


def saved(folder, array, name="picture.png", **options):
    path = folder / name
    Image.fromarray(array).save(path, **options)
    return path


def test_a_photograph_is_read_with_its_name(tmp_path, picture):
    scene = scenes.Photograph.read(saved(tmp_path, picture, "a cat.png"))
    assert scene.name == "a cat"
    assert scene.planes.dtype == jnp.uint8
    np.testing.assert_allclose(codes(scene, (24, 32)), picture, atol=1e-9)
    scene = scenes.Photograph.read(str(tmp_path / "a cat.png"), name="b")
    assert scene.name == "b"
    frame = pictures.read_picture(tmp_path / "a cat.png")
    np.testing.assert_array_equal(frame, (picture / 255).astype(np.float32))


def test_a_jpeg_is_read(tmp_path):
    path = saved(tmp_path, np.full((16, 16, 3), 130, np.uint8), "flat.jpg")
    np.testing.assert_allclose(pictures.read_picture(path) * 255, 130, atol=1.01)


@pytest.mark.parametrize("name", ["turned.png", "turned.tif", "grey.tif", "deep.tif"])
def test_a_photograph_is_turned_upright(tmp_path, picture, name):
    exif = Image.Exif()
    exif[0x0112] = 6  # the camera was held turned: row 0 is the right side
    stored = picture if name.startswith("turned") else picture[..., 0]
    stored = 257 * stored.astype(np.uint16) if name == "deep.tif" else stored
    frame = pictures.read_picture(saved(tmp_path, stored, name, exif=exif)) * 255
    np.testing.assert_allclose(frame[..., 0], np.rot90(picture, -1)[..., 0], atol=1e-4)


@pytest.mark.parametrize("orientation", [1, 6])
@pytest.mark.parametrize(
    "entry",
    [
        struct.pack(">HHIIii", 0x011A, 10, 1, 38, -1, 0),  # resolution, signed: -1/0
        struct.pack(">HHIIii", 0x011A, 10, 1, 38, -72, 1),
        struct.pack(">HHIId", 0x011A, 12, 1, 38, np.nan),
        struct.pack(">HHII", 0x8769, 4, 1, 2**32 - 1),  # a list beyond the file's end
    ],
    ids=["-1/0", "-72/1", "nan", "beyond"],
)
def test_a_damaged_exif_entry_is_no_damaged_picture(tmp_path, orientation, entry):
    turn = struct.pack(">HHIHH", 0x0112, 3, 1, orientation, 0)
    (first, rest) = (entry[:12], entry[12:])
    entries = sorted([turn, first])
    exif = b"Exif\0\0MM\0*" + struct.pack(">IH", 8, 2) + b"".join(entries) + bytes(4)
    light = np.repeat(np.array([200, 50], np.uint8), 8)[:, None].repeat(24, 1)
    path = saved(tmp_path, light, "camera.jpg", exif=exif + rest, quality=100)
    upright = light if orientation == 1 else np.rot90(light, -1)
    frame = pictures.read_picture(path) * 255
    np.testing.assert_allclose(frame[..., 0], upright, atol=1.01)


def test_grey_keeps_8_and_16_bits(tmp_path, rng):
    grey = rng.integers(0, 256, (5, 7), dtype=np.uint8)
    scene = scenes.Photograph.read(saved(tmp_path, grey))
    np.testing.assert_array_equal(scene.planes, grey[None])
    deep = rng.integers(0, 65536, (5, 7), dtype=np.uint16)
    path = saved(tmp_path, deep)
    scene = scenes.Photograph.read(path)
    np.testing.assert_array_equal(scene.planes, deep[None])
    frame = pictures.read_picture(path)
    assert frame.shape == (5, 7, 3)
    np.testing.assert_allclose(frame[..., 1], deep / 65535, atol=1e-7)


def test_one_bit_and_palettes_are_read(tmp_path, picture):
    bits = picture[..., 0] > 127
    Image.fromarray(bits).save(tmp_path / "bits.png")
    scene = scenes.Photograph.read(tmp_path / "bits.png")
    np.testing.assert_array_equal(scene.planes[0], 255 * bits)
    palette = Image.fromarray(picture).quantize(16)
    palette.save(tmp_path / "palette.png")
    frame = pictures.read_picture(tmp_path / "palette.png") * 255
    np.testing.assert_allclose(frame, np.asarray(palette.convert("RGB")), atol=1e-4)


def test_transparency_is_laid_on_black(tmp_path, rng):
    rgba = rng.integers(0, 256, (5, 7, 4), dtype=np.uint8)
    frame = pictures.read_picture(saved(tmp_path, rgba)) * 255
    expected = rgba[..., :3] * (rgba[..., 3:] / 255)
    np.testing.assert_allclose(frame, expected, atol=0.501)
    # A colour of a palette-less picture that is declared transparent.
    grey = np.array([[10, 200]], np.uint8)
    path = saved(tmp_path, grey, transparency=200)
    np.testing.assert_allclose(pictures.read_picture(path)[0, :, 0] * 255, [10, 0])
    opaque = pictures.read_picture(path, opaque=True)
    np.testing.assert_allclose(opaque[0, :, 0] * 255, [10, 200])


@pytest.mark.parametrize("alpha", [128, 0])
def test_an_opaque_picture_is_read_without_its_alpha(tmp_path, rng, alpha):
    rgba = rng.integers(0, 256, (5, 7, 4), dtype=np.uint8)
    rgba[..., 3] = alpha
    path = saved(tmp_path, rgba)
    frame = pictures.read_picture(path, opaque=True)
    np.testing.assert_array_equal(np.round(frame * 255), rgba[..., :3])
    assert frame.dtype == np.float32


def png(path, bits, kind, row, transparent):
    """One row of pixels, packed, as a PNG with a transparent colour."""
    width = 8 * len(row) // (bits * (3 if kind == 2 else 1))
    header = struct.pack(">IIBBBBB", width, 1, bits, kind, 0, 0, 0)
    chunks = {b"IHDR": header, b"tRNS": transparent}
    chunks |= {b"IDAT": zlib.compress(b"\0" + row), b"IEND": b""}
    content = b"\x89PNG\r\n\x1a\n"
    for name, data in chunks.items():
        check = struct.pack(">I", zlib.crc32(name + data))
        content += struct.pack(">I", len(data)) + name + data + check
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("bits", "row", "transparent", "expected"),
    [
        (16, struct.pack(">3H", 1000, 40000, 200), 40000, [1000 / 257, 0, 200 / 257]),
        (16, struct.pack(">3H", 1000, 40000, 200), 200, [1000 / 257, 40000 / 257, 0]),
        (4, bytes([0x0F, 0x3A]), 15, [0, 0, 51, 170]),
        (2, bytes([0b00011011]), 2, [0, 85, 0, 255]),
        (1, bytes([0b01010000]), 0, [0, 255, 0, 255, 0, 0, 0, 0]),
    ],
)
def test_a_transparent_grey_is_found_in_the_bits_of_the_file(
    tmp_path, bits, row, transparent, expected
):
    transparent = struct.pack(">H", transparent)
    path = png(tmp_path / "grey.png", bits, 0, row, transparent)
    frame = pictures.read_picture(path)[0, :, 0] * 255
    np.testing.assert_allclose(frame, expected, atol=1e-4)


def test_a_transparent_colour_of_16_bits_is_refused(tmp_path):
    row, transparent = struct.pack(">6H", 0, 1, 2, 3, 4, 5), struct.pack(">3H", 3, 4, 5)
    path = png(tmp_path / "deep.png", 16, 2, row, transparent)
    with pytest.raises(
        ValueError, match=r"^.*deep\.png: has a transparent colour of 16"
    ):
        pictures.read_picture(path)
    assert pictures.read_picture(path, opaque=True).shape == (1, 2, 3)


@pytest.mark.parametrize("kind", [np.int32, np.uint32, np.int16])
def test_grey_of_no_stated_range_is_refused(tmp_path, kind):
    grey = (np.arange(4)[None] * (np.iinfo(kind).max // 4)).astype(kind)
    tifffile.imwrite(tmp_path / "counts.tif", grey)
    with pytest.raises(ValueError, match=r"^.*counts\.tif: its grey values have no"):
        scenes.Photograph.read(tmp_path / "counts.tif")


def test_grey_tiffs_of_16_bits_are_read_unless_black_is_the_largest(tmp_path):
    grey = np.array([[0, 1000, 40000]], np.uint16)
    path = tmp_path / "grey.tif"
    for order in ("<", ">"):
        tifffile.imwrite(path, grey, byteorder=order)
        scene = scenes.Photograph.read(path)
        np.testing.assert_array_equal(scene.planes, grey[None])
    tifffile.imwrite(path, grey, photometric="miniswhite")
    with pytest.raises(ValueError, match=r"black at 0\.$"):
        scenes.Photograph.read(path)


def test_of_an_animation_the_first_frame_is_read(tmp_path):
    first, second = (Image.new("RGB", (4, 2), (grey, 0, 0)) for grey in (200, 50))
    first.save(tmp_path / "wave.gif", save_all=True, append_images=[second])
    frame = pictures.read_picture(tmp_path / "wave.gif")
    np.testing.assert_allclose(frame * 255, np.asarray(first), atol=1e-4)


def test_a_colour_profile_is_not_applied(tmp_path, picture):
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB")).tobytes()
    path = saved(tmp_path, picture, icc_profile=profile)
    np.testing.assert_allclose(pictures.read_picture(path) * 255, picture, atol=1e-4)


def test_a_picture_that_is_too_large_is_told_with_its_size(tmp_path, monkeypatch):
    path = saved(tmp_path, np.zeros((20, 20), np.uint8))
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 200)
    assert pictures.read_picture(path).shape == (20, 20, 3)  # Pillow warns from 200
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 199)
    with pytest.raises(
        ValueError, match=r"too large: .*400 pixels.* limit of 398"
    ) as e:
        pictures.read_picture(path)
    assert "bomb" not in str(e.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path, picture):
    with pytest.raises(FileNotFoundError, match=r"gone\.png: no such file"):
        scenes.Photograph.read(tmp_path / "gone.png")
    with pytest.raises(IsADirectoryError, match="is a directory"):
        scenes.Panorama.read(tmp_path)
    text = tmp_path / "text.png"
    text.write_text("not a picture")
    with pytest.raises(ValueError, match=r"text\.png: not a picture"):
        scenes.Photograph.read(text)
    whole = saved(tmp_path, picture).read_bytes()
    for name, content in {
        "cut.png": whole[: len(whole) // 2],
        "bad.png": whole[:60] + b"?" * 60 + whole[120:],
    }.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ValueError, match=f"{name}: damaged or unreadable"):
            scenes.Photograph.read(tmp_path / name)
    with pytest.raises(ValueError, match=r"picture\.png: .* 2:1 .* got 32 x 24"):
        scenes.Panorama.read(tmp_path / "picture.png")
    Image.fromarray(np.zeros((4, 8), np.float32)).save(tmp_path / "light.tif")
    with pytest.raises(ValueError, match=r"light\.tif: its .*no stated range"):
        scenes.Panorama.read(tmp_path / "light.tif")


def test_a_panorama_is_read(tmp_path, rng):
    picture = rng.integers(0, 256, (4, 8, 3), dtype=np.uint8)
    scene = scenes.Panorama.read(saved(tmp_path, picture, "room.png"), yaw_deg=90.0)
    assert scene.name == "room"
    assert scene.yaw_deg == 90.0
    np.testing.assert_array_equal(scene.planes, np.moveaxis(picture, -1, 0))
