import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hmdjit import scenes
from hmdjit.camera import Camera

CAMERA = Camera(64, 64, 96.0)
DEG = np.pi / 180


@pytest.fixture
def points(rng):
    """Points of the image plane, tangent units, shape `(2, 400)`."""
    return rng.uniform(-1.2, 1.2, (2, 400))


@jax.jit
def color_of(scene, direction):
    return scene.color(CAMERA, direction)


def grey(scene, points):
    direction = np.stack([*points, -np.ones_like(points[0])])
    color = np.asarray(color_of(scene, jnp.asarray(direction)))
    assert (color == color[:1]).all()
    return color[0]


def test_the_checkerboard_alternates(points):
    scene = scenes.checkerboard(7.0, dark=0.2, light=0.7)
    expected = [
        0.7 if (int(x // (7 * DEG)) + int(y // (7 * DEG))) % 2 else 0.2
        for x, y in points.T
    ]
    np.testing.assert_allclose(grey(scene, points), expected, atol=1e-12)


def test_two_degree_squares_are_sixteen_pixels_of_the_default_camera():
    camera = Camera()
    x_px = np.arange(1024) + 0.5
    x = (x_px - 512) / camera.focal_px
    row = grey(scenes.checkerboard(), np.stack([x, np.full(1024, 0.01)]))
    edges = np.flatnonzero(np.diff(row))
    np.testing.assert_allclose(np.diff(edges), 16.1, atol=1)
    assert len(edges) == 63


def test_the_honeycomb_is_light_where_one_centre_is_clearly_nearest(points):
    cell, wall = 13 * DEG, 2 * DEG
    columns, rows = np.meshgrid(np.arange(-20, 21), np.arange(-20, 21))
    centres = np.stack(
        [
            cell * (columns + rows / 2).ravel(),
            cell * (3**0.5 / 2 * rows).ravel(),
        ]
    )
    expected = []
    for point in points.T:
        away = np.linalg.norm(centres - point[:, None], axis=0)
        near = np.argsort(away)[:4]
        own, others = centres[:, near[0]], centres[:, near[1:]]
        # Distance to the wall's middle line: the bisector of two centres.
        to_wall = (away[near[1:]] ** 2 - away[near[0]] ** 2) / (
            2 * np.linalg.norm(others - own[:, None], axis=0)
        )
        expected.append(0.9 if to_wall.min() > wall / 2 else 0.1)
    scene = scenes.honeycomb(13.0, wall_deg=2.0, dark=0.1, light=0.9)
    np.testing.assert_allclose(grey(scene, points), expected, atol=1e-12)
    assert 0.6 < np.mean(np.array(expected) > 0.5) < 0.8  # (1 - 2 / 13)^2 = 0.72


def test_the_zone_plate_is_a_chirp(points):
    scene = scenes.zone_plate(40.0, cycles_per_deg=0.5, contrast=0.6)
    per_unit, radius = 0.5 / DEG, np.tan(40 * DEG)
    phase = np.pi * per_unit / radius * (points**2).sum(0)
    np.testing.assert_allclose(
        grey(scene, points), 0.5 + 0.3 * np.cos(phase), atol=1e-10
    )


def test_the_zone_plate_reaches_nyquist_where_it_says():
    camera = Camera()
    radius_px = camera.focal_px * np.tan(40 * DEG)
    x_px = radius_px + np.linspace(-4, 4, 1601)
    wave = grey(scenes.zone_plate(), np.stack([x_px / camera.focal_px, 0 * x_px])) - 0.5
    crossings = np.flatnonzero(np.diff(np.sign(wave)))
    # Half a cycle per pixel crosses its mean once per pixel.
    assert len(crossings) == 8


def test_uniform_and_almost_uniform():
    scene = scenes.uniform((0.1, 0.5, 1.0))
    color = color_of(scene, jnp.array([0.3, 0.2, -1.0]))
    np.testing.assert_array_equal(color, [0.1, 0.5, 1.0])
    low, high = np.array([0.5, 0.6, 0.7]), np.array([0.4, 0.6, 0.9])
    scene = scenes.almost_uniform(low=tuple(low), high=tuple(high))
    for y in (-3.0, 0.0, 0.4):
        color = color_of(scene, jnp.array([0.3, y, -1.0]))
        share = 1 / (1 + np.exp(-2 * y))
        np.testing.assert_allclose(color, low + (high - low) * share, atol=1e-12)


def test_an_almost_uniform_picture_flickers_by_less_than_can_be_measured():
    scene, y = scenes.almost_uniform(), np.linspace(-1.1, 1.1, 50)
    pitch = np.radians(0.12)  # per frame: a restless head
    turned = np.tan(np.arctan(y) + pitch)
    code_values = [
        np.asarray(color_of(scene, jnp.asarray(np.stack([0 * y, y, 0 * y - 1])))) * 255
        for y in (y, turned)
    ]
    distance = np.linalg.norm(code_values[1] - code_values[0], axis=0)
    assert distance.mean() < 0.05
    assert np.ptp(code_values[0][0]) == pytest.approx(6.1, abs=0.1)


def test_noise_has_the_spectrum_the_mean_and_the_deviation_it_states():
    side = 128
    scene = scenes.power_law_noise(1.5, 3, size=side, texels_per_deg=4.0)
    # Texel centres straddle the point straight ahead.
    at = (np.arange(side) - (side - 1) / 2) / 4 * DEG
    x, y = np.meshgrid(at, -at)
    picture = grey(scene, np.stack([x.ravel(), y.ravel()])).reshape(side, side)
    assert picture.mean() == pytest.approx(0.5, abs=2e-3)  # a few values are cut off
    assert picture.std() == pytest.approx(0.15, rel=0.01)
    power = np.abs(np.fft.fft2(picture)) ** 2
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(side), np.fft.fftfreq(side)))
    chosen = (frequency > 0.03) & (frequency < 0.4)
    slope = np.polyfit(np.log(frequency[chosen]), np.log(power[chosen]), 1)[0]
    # log of an exponential variable has deviation 1.28: with some 8,000 pairs of
    # frequencies that spread over 0.5 in log, the slope's standard error is 0.03.
    assert slope == pytest.approx(-3.0, abs=0.1)


def test_noise_is_periodic_and_its_seed_is_its_identity(points):
    def noise(seed):
        return scenes.power_law_noise(1.0, seed, size=32, texels_per_deg=1.0)

    period = 32 * DEG
    first = grey(noise(0), points)
    np.testing.assert_allclose(grey(noise(0), points + period), first, atol=1e-6)
    np.testing.assert_array_equal(grey(noise(0), points), first)
    assert np.abs(grey(noise(1), points) - first).mean() > 0.05


def test_a_page_of_text_has_lines_at_its_pitch_and_white_around():
    scene = scenes.page_of_text(2.5, page_deg=60.0, texels_per_deg=8)
    x, y = np.meshgrid(np.linspace(-20, 20, 801) * DEG, np.linspace(-20, 20, 801) * DEG)
    picture = grey(scene, np.stack([x.ravel(), y.ravel()])).reshape(801, 801)
    assert picture.min() < 0.01
    assert picture.max() == 1
    ink = 1 - picture.mean(axis=1)
    cycles = np.abs(np.fft.rfft(ink - ink.mean()))
    assert np.argmax(cycles) == 16  # 40 degrees, 2.5 degrees each
    far = np.array([[-1.2, 1.2, 0.0, 0.0], [0.0, 0.0, 1.2, -1.2]])
    np.testing.assert_array_equal(grey(scene, far), 1.0)


def test_text_is_the_same_every_time():
    pages = [scenes.page_of_text(5.0, texels_per_deg=4) for _ in range(2)]
    first, second = (jax.tree.leaves(page) for page in pages)
    np.testing.assert_array_equal(first[0], second[0])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: scenes.checkerboard(0.0), r"square_deg must lie in \(0, inf\), got 0"),
        (
            lambda: scenes.checkerboard(light=1.2),
            r"light must lie in \[0, 1\], got 1.2",
        ),
        (lambda: scenes.honeycomb(-1.0), r"cell_deg must lie in \(0, inf\), got -1"),
        (
            lambda: scenes.honeycomb(2.0, wall_deg=2.0),
            r"wall_deg must lie in \(0, 2\), got 2",
        ),
        (lambda: scenes.honeycomb(dark=-1.0), r"dark must lie in \[0, 1\], got -1"),
        (lambda: scenes.zone_plate(90.0), r"radius_deg must lie in \(0, 90\), got 90"),
        (lambda: scenes.zone_plate(cycles_per_deg=0.0), r"cycles_per_deg .*, got 0"),
        (lambda: scenes.zone_plate(contrast=2.0), r"contrast .* \[0, 1\], got 2"),
        (lambda: scenes.uniform((0.0, 2.0, 0.0)), r"color \(green\) .* got 2"),
        (lambda: scenes.uniform((0.0, 1.0)), r"color must be three numbers"),
        (lambda: scenes.almost_uniform(low=(-0.1, 0.0, 0.0)), r"low \(red\) .* -0.1"),
        (lambda: scenes.power_law_noise(5.0), r"exponent .* \[0, 4\], got 5"),
        (lambda: scenes.power_law_noise(seed=-1), "seed .* whole number >= 0, got -1"),
        (lambda: scenes.power_law_noise(deviation=0.0), r"deviation .* got 0"),
        (lambda: scenes.power_law_noise(size=1), r"size .* >= 2, got 1"),
        (
            lambda: scenes.power_law_noise(texels_per_deg=0.0),
            r"texels_per_deg .* got 0",
        ),
        (lambda: scenes.page_of_text(0.0), r"line_deg must lie in \(0, 12.4\], got 0"),
        (lambda: scenes.page_of_text(page_deg=0.0), r"page_deg .* got 0"),
        (lambda: scenes.page_of_text(texels_per_deg=0), r"texels_per_deg .* got 0"),
    ],
)
def test_options_out_of_range_are_refused_by_name_range_and_value(make, message):
    with pytest.raises(ValueError, match=message):
        make()
