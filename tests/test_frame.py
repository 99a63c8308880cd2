import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from small import quickly
from strategies import rotation_vectors

from hmdjit.camera import Camera, Region
from hmdjit.frames import motion as motions
from hmdjit.frames.displacement import (
    FILTERS,
    GATHER,
    SLICES,
    WARPS,
    Displacement,
    Reading,
)
from hmdjit.frames.frame import Frame
from hmdjit.frames.motion import Motion
from hmdjit.frames.sources import History
from hmdjit.frames.texture import Texture

WIDTH, HEIGHT, FOV_DEG = 10, 8, 90.0
CAMERA = Camera(width_px=WIDTH, height_px=HEIGHT, fov_deg=FOV_DEG)
WHOLE = Region.whole(CAMERA)
TILE = Region(5, 2, 4, 3)
TURN = np.array([0.05, -0.08, 0.11])  # moves pixels by up to 1.5 px

read = quickly(lambda source, displacement: source.at(displacement))
span = quickly(lambda displacement: displacement.span())
px = quickly(lambda displacement: displacement.px())
inside = quickly(lambda displacement: displacement.inside())


def displaced(rotation, region=WHOLE, dtype=float, sample_px=None, reading=GATHER):
    sample = None if sample_px is None else jnp.asarray(sample_px, dtype)
    return Displacement(CAMERA, region, jnp.asarray(rotation, dtype), sample, reading)


def oracle_positions(rotation, region=WHOLE, sample_px=(0, 0)):
    """Where each pixel's source lies in the camera frame, `(height, width, 2)`."""
    x, y = np.moveaxis(centres(region) + sample_px, -1, 0)
    xy = oracles.source_position(WIDTH, HEIGHT, FOV_DEG, rotation, x, y)
    return np.moveaxis(xy, 0, -1)


def centres(region):
    x, y = np.meshgrid(np.arange(region.width), np.arange(region.height))
    return np.stack([region.x0 + x + 0.5, region.y0 + y + 0.5], axis=-1)


def baked(rng, oversampling, margin_px, dtype=float):
    """A texture of noise."""
    height, width = (oversampling * (n + 2 * margin_px) for n in (HEIGHT, WIDTH))
    color, supersampled = rng.random((2, height, width, 3)).astype(dtype)
    return Texture.of(
        jnp.asarray(color), jnp.asarray(supersampled), oversampling, margin_px
    )


# --- motion ---


def test_motion_of_a_session_agrees_with_scipy(rng):
    rotations = Rotation.random(5, rng)
    poses = jnp.asarray(rotations.as_quat(scalar_first=True))
    motion = Motion.of(poses)
    offsets = (rotations[0].inv() * rotations).as_rotvec()
    increments = (rotations[:-1].inv() * rotations[1:]).as_rotvec()
    np.testing.assert_allclose(motion.offset, offsets, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(motion.increment[0], np.zeros(3))
    np.testing.assert_allclose(motion.increment[1:], increments, rtol=0, atol=1e-14)


def test_rebased_motion_keeps_recorded_increments_in_float32(rng):
    steps = 1e-4 * rng.normal(size=(30, 3))
    rotations = [Rotation.from_rotvec([1.0, -2.0, 0.5])]
    for step in steps:
        rotations.append(rotations[-1] * Rotation.from_rotvec(step))
    poses = Rotation.concatenate(rotations).as_quat(scalar_first=True)
    motion = motions.rebased_motion(poses, jnp.float32)
    assert motion.offset.dtype == motion.increment.dtype == jnp.float32
    np.testing.assert_array_equal(motion.offset[0], np.zeros(3))
    # Half an ulp of offsets below 2e-3 rad, twice.
    np.testing.assert_allclose(motion.increment[1:], steps, rtol=0, atol=2.5e-10)


# --- displacement ---


@given(rotation_vectors(largest_rad=0.4), st.booleans())
def test_displacement_agrees_with_projection(rotation, is_tile):
    region = TILE if is_tile else WHOLE
    dx, dy = px(displaced(rotation, region))
    expected = oracle_positions(rotation, region) - centres(region)
    np.testing.assert_allclose(np.stack([dx, dy], -1), expected, rtol=0, atol=1e-11)


def test_displacement_of_a_sample_is_told_from_the_pixel_centre():
    sample = (0.25, -0.4)
    dx, dy = px(displaced(TURN, sample_px=sample))
    expected = oracle_positions(TURN, sample_px=sample) - centres(WHOLE)
    np.testing.assert_allclose(np.stack([dx, dy], -1), expected, rtol=0, atol=1e-12)
    dx, dy = px(displaced(np.zeros(3), sample_px=sample))
    np.testing.assert_array_equal(dx, np.full((HEIGHT, WIDTH), 0.25))
    np.testing.assert_array_equal(dy, np.full((HEIGHT, WIDTH), -0.4))


@given(
    rotation_vectors(largest_rad=0.6),
    st.one_of(st.none(), st.tuples(*[st.floats(-1.5, 1.5)] * 2)),
    st.sampled_from([TILE, Region(0, 0, TILE.width, TILE.height)]),
    st.sampled_from(WARPS),
)
def test_a_span_is_never_too_narrow(rotation, sample_px, region, warp):
    reading = Reading(warp=warp)
    displacement = displaced(rotation, region, float, sample_px, reading)
    planes = jnp.stack(px(displacement))
    low, high = span(displacement)
    assert (low <= planes.min(axis=(1, 2))).all()
    assert (high >= planes.max(axis=(1, 2))).all()


@pytest.mark.parametrize(
    ("warp", "order"), [("homography", np.inf), ("affine", 2), ("shift", 1)]
)
def test_warps_agree_to_their_order_in_a_regions_size(warp, order):
    camera = Camera(width_px=1024, height_px=1024, fov_deg=96.0)

    def error(side):
        region = Region(900, 700, side, side)  # off the camera's axis
        at = [
            Displacement(camera, region, jnp.asarray(TURN), jnp.array([0.2, -0.4]), r)
            for r in (Reading(warp=warp), GATHER)
        ]
        ours, exact = (jnp.stack(px(displacement)) for displacement in at)
        return float(jnp.abs(ours - exact).max())

    small, large = error(17), error(33)
    if order == np.inf:
        assert small == large == 0
    else:
        # Pixel centres reach 8 and 16 px far; the next order adds some percent.
        assert large > 0.01
        np.testing.assert_allclose(large / small, 2**order, rtol=0.1)


@given(rotation_vectors(), st.booleans())
def test_inside_agrees_with_projection(rotation, is_tile):
    region = TILE if is_tile else WHOLE
    positions = oracle_positions(rotation, region)
    x, y = positions[..., 0], positions[..., 1]  # NaN behind the camera
    expected = (x >= 0) & (x <= WIDTH) & (y >= 0) & (y <= HEIGHT)
    # Rounding may decide what lies on the very border.
    borders = [x, x - WIDTH, y, y - HEIGHT]
    on_border = np.nanmin(np.abs(borders), axis=0, initial=1.0) < 1e-9
    ours = np.asarray(inside(displaced(rotation, region)))
    assert ((ours == expected) | on_border).all()


def test_a_pixel_at_rest_is_inside_and_one_behind_or_unknown_is_not():
    assert inside(displaced(np.zeros(3))).all()
    assert not inside(displaced([0.0, np.pi, 0.0])).any()
    assert not inside(displaced([0.0, np.nan, 0.0])).any()


def test_a_tiles_edge_is_not_the_camera_frames_edge():
    # Half a pixel to the right, out of the tile but within the frame.
    half = np.array([0.0, -np.arctan(0.5 / (WIDTH / 2)), 0.0])
    assert inside(displaced(half, Region(4, 4, 4, 4))).all()
    assert not inside(displaced(2 * half, WHOLE)).all()


# --- history ---


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("region", [WHOLE, TILE], ids=["whole", "tile"])
def test_history_at_rest_is_exactly_what_was_kept(rng, region, dtype):
    planes = jnp.asarray(rng.random((3, region.height, region.width)).astype(dtype))
    history = History.of(planes)
    np.testing.assert_array_equal(history.under(region), planes)
    kept = read(history, displaced(np.zeros(3), region, dtype))
    assert kept.dtype == dtype
    np.testing.assert_array_equal(kept, planes)


@pytest.mark.parametrize("region", [WHOLE, TILE], ids=["whole", "tile"])
@pytest.mark.parametrize(("dtype", "atol"), [(np.float64, 1e-13), (np.float32, 1e-5)])
def test_history_agrees_with_the_oracle(rng, region, dtype, atol):
    # Displacements of 2 px to a few roundings; in float32 also the turn's own: 1e-6 px.
    turns = np.concatenate([[TURN], 0.1 * rng.normal(size=(2, 3))]).astype(dtype)
    planes = rng.random((3, region.height, region.width)).astype(dtype)
    picture = np.moveaxis(planes, 0, -1).astype(float)
    for turn in turns:
        ours = read(History.of(jnp.asarray(planes)), displaced(turn, region, dtype))
        places = oracle_positions(turn, region) - [region.x0, region.y0]
        expected = oracles.sample_all(oracles.bilinear, picture, places)
        np.testing.assert_allclose(ours, expected, rtol=0, atol=atol)


def test_history_can_keep_any_channels(rng):
    for channels in (1, 4):
        history = History.of(jnp.asarray(rng.random((channels, HEIGHT, WIDTH))))
        shown = jax.eval_shape(read, history, displaced(TURN))
        assert shown.shape == history.under(WHOLE).shape == (channels, HEIGHT, WIDTH)


# --- texture ---


@pytest.mark.parametrize(
    ("oversampling", "margin_px"), [(1, 0), (1, 3), (2, 2), (4, 1)]
)
@pytest.mark.parametrize("region", [WHOLE, TILE], ids=["whole", "tile"])
def test_texture_agrees_with_the_oracle(rng, oversampling, margin_px, region):
    texture = baked(rng, oversampling, margin_px)
    ours = read(texture, displaced(TURN, region))
    # A pixel's centre is a texel's: pixel 0.5 is texel 0.5 of the first.
    places = oversampling * (oracle_positions(TURN, region) + margin_px - 0.5) + 0.5
    picture = np.asarray(texture.color)
    expected = oracles.sample_all(oracles.bilinear, picture, places)
    # 20 px x 4 texels, a few roundings, slopes of at most 2.
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-13)


def test_texture_reads_its_reference_too(rng):
    texture = baked(rng, 2, 2)
    swapped = Texture.of(texture.supersampled, texture.color, 2, 2)
    reference = quickly(lambda t, d: t.at(d, supersampled=True))
    ours = reference(texture, displaced(TURN))
    np.testing.assert_array_equal(ours, read(swapped, displaced(TURN)))


@pytest.mark.parametrize("oversampling", [1, 2, 4])
def test_texture_at_rest_shows_its_texels_exactly(rng, oversampling):
    texture = baked(rng, oversampling, 3)
    texels = np.moveaxis(np.asarray(texture.color), -1, 0)
    shown = texels[:, ::oversampling, ::oversampling][:, 3:-3, 3:-3]
    np.testing.assert_array_equal(read(texture, displaced(np.zeros(3))), shown)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_tile_is_the_same_block_of_the_whole_frame(rng, dtype):
    texture = baked(rng, 2, 2, dtype)
    whole = read(texture, displaced(TURN, WHOLE, dtype))
    tile = read(texture, displaced(TURN, TILE, dtype))
    # Two programs may fuse differently: roundings of up to 40 texels.
    np.testing.assert_allclose(
        tile, whole[:, 2:5, 5:9], rtol=0, atol=40 * np.finfo(dtype).eps
    )


def test_a_margin_shows_what_the_head_turned_to(rng):
    texture = baked(rng, 1, 3)
    # The ray of the centre turned onto that of 3 px above: row 0 shows row -3.
    up = displaced([np.arctan(3 / (WIDTH / 2)), 0.0, 0.0])
    places = oracle_positions([np.arctan(3 / (WIDTH / 2)), 0.0, 0.0]) + 3
    assert places[..., 1].min() < 3.5 - 3
    picture = np.asarray(texture.color)
    expected = oracles.sample_all(oracles.bilinear, picture, places)
    np.testing.assert_allclose(read(texture, up), expected, rtol=0, atol=1e-13)


def test_one_compilation_serves_all_tiles(rng):
    @eqx.debug.assert_max_traces(max_traces=1)
    def shown(texture, displacement):
        return texture.at(displacement)

    compiled = jax.jit(shown)
    texture = baked(rng, 2, 1)
    for origin in [(0, 0), (3, 4), (6, 1)]:
        compiled(texture, displaced(TURN, Region(*origin, 4, 4)))


# --- any source ---


def sources(rng):
    history = History.of(jnp.asarray(rng.random((3, HEIGHT, WIDTH))))
    return [history, baked(rng, 2, 2)]


def test_a_displacement_that_is_not_a_number_gives_nan(rng):
    for source in sources(rng):
        shown = read(source, displaced([0.0, np.nan, 0.0]))
        assert shown.shape == (3, HEIGHT, WIDTH)
        assert jnp.isnan(shown).all()


def test_what_lies_behind_the_camera_is_still_a_colour(rng):
    for source in sources(rng):
        shown = read(source, displaced([0.0, 2.0, 0.0]))
        assert jnp.isfinite(shown).all()


def test_vmap_over_rotations_is_a_loop(rng):
    turns = jnp.asarray(0.1 * rng.normal(size=(3, 3)))
    history, _ = sources(rng)
    batch = jax.vmap(lambda r: history.at(Displacement(CAMERA, WHOLE, r)))
    one_by_one = [read(history, displaced(turn)) for turn in turns]
    np.testing.assert_allclose(quickly(batch)(turns), one_by_one, rtol=0, atol=1e-13)


def weighted_sum(rotation, source, weight):
    return (weight * source.at(Displacement(CAMERA, WHOLE, rotation))).sum()


value = quickly(weighted_sum)
gradient = quickly(jax.grad(weighted_sum))


def test_gradient_in_the_rotation_agrees_with_differences(rng):
    weight = jnp.asarray(rng.normal(size=(3, HEIGHT, WIDTH)))
    for source in sources(rng):
        at = lambda r, s=source: value(jnp.asarray(r), s, weight)
        # A step of 1e-7 rad moves pixels by 1e-6 px: none crosses a texel's centre,
        # where the slope jumps. Sums of 500 terms round to 1e-14: 1e-7 of the slope.
        differences = oracles.jacobian(at, TURN, step=1e-7)
        ours = gradient(jnp.asarray(TURN), source, weight)
        np.testing.assert_allclose(ours, differences, rtol=1e-5)


def test_gradient_at_rest_is_exact_for_an_affine_picture():
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    history = History.of(jnp.asarray(np.stack([0.02 * x, 0.03 * y, 0.01 * (x - y)])))
    interior = np.zeros((3, HEIGHT, WIDTH))
    interior[:, 1:-1, 1:-1] = 1.0
    at = lambda r: value(jnp.asarray(r), history, jnp.asarray(interior))
    ours = gradient(jnp.zeros(3), history, jnp.asarray(interior))
    # Central differences: the third derivative, about the first, times 1e-10.
    expected = oracles.jacobian(at, np.zeros(3))
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-8)


def test_gradient_at_rest_is_finite_for_any_picture(rng):
    weight = jnp.asarray(rng.normal(size=(3, HEIGHT, WIDTH)))
    for source in sources(rng):
        assert jnp.isfinite(gradient(jnp.zeros(3), source, weight)).all()


# --- frame ---


def test_a_frame_says_where_its_pixels_sources_lie():
    frame = Frame(jnp.zeros((1, 3, TILE.height, TILE.width)), CAMERA, TILE)
    assert frame.static_mask is None
    ours = px(frame.displacement(jnp.asarray(TURN)))
    np.testing.assert_array_equal(ours, px(displaced(TURN, TILE)))


# --- readings ---

TURNS = [
    np.zeros(3),
    1e-3 * TURN,
    0.3 * TURN,
    TURN,
    np.array([0.0, 0.5, 0.0]),  # beyond a rim and a margin
    np.array([0.3, -1.5, 0.4]),  # partly behind the camera
    np.array([0.0, 3.0, 0.0]),
    np.array([0.0, np.nan, 0.0]),
]


def kept(rng, rim_px):
    planes = jnp.asarray(rng.random((3, HEIGHT, WIDTH)))
    return History.of(planes).with_rim(WHOLE, rim_px)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("warp", "region"),
    [
        ("homography", WHOLE),
        ("homography", TILE),
        ("affine", WHOLE),
        ("affine", TILE),
        ("shift", TILE),
    ],
    ids=lambda value: value if isinstance(value, str) else f"{value.width} px",
)
def test_sources_read_by_slices_are_those_read_by_gathers(rng, warp, region):
    for source in (kept(rng, 4), baked(rng, 2, 5)):
        for turn in TURNS:
            ours, expected = (
                read(source, displaced(turn, region, reading=Reading(s, warp=warp)))
                for s in ("slices", "gather")
            )
            # 40 texels, a few roundings, slopes of at most 2.
            np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("sample_px", [None, (-1.5, 1.5)])
def test_inside_by_slices_is_inside_by_gathers(sample_px):
    for region in (WHOLE, TILE):
        for turn in TURNS:
            ours, expected = (
                inside(displaced(turn, region, float, sample_px, reading))
                for reading in (SLICES, GATHER)
            )
            np.testing.assert_array_equal(ours, expected)


@pytest.mark.parametrize("reading", [SLICES, GATHER], ids=lambda r: r.sampler)
@pytest.mark.parametrize(
    ("x0", "y0", "move"),
    [(0, 2, (-1, 0)), (6, 2, (1, 0)), (3, 0, (0, -1)), (3, 5, (0, 1))],
    ids=["left", "right", "top", "bottom"],
)
def test_the_outermost_pixels_leave_the_frame_by_half_a_pixel(x0, y0, move, reading):
    camera = Camera(WIDTH, HEIGHT, fov_deg=0.1)  # all pixels move alike
    region = Region(x0, y0, 4, 3)
    for px, is_out in [(0.4, False), (0.6, True), (-0.6, False)]:
        dx, dy = px * np.array(move) / float(camera.focal_px)
        turn = jnp.array([-dy, -dx, 0.0])
        displacement = Displacement(camera, region, turn, None, reading)
        x, y = np.moveaxis(centres(region), -1, 0)
        x, y = x + px * move[0], y + px * move[1]
        expected = (x >= 0) & (x <= WIDTH) & (y >= 0) & (y <= HEIGHT)
        assert (~expected).any() == is_out
        np.testing.assert_array_equal(inside(displacement), expected)


@pytest.mark.slow
@pytest.mark.parametrize("filter_", FILTERS)
def test_sources_are_read_through_their_own_filter(rng, filter_):
    history, texture = kept(rng, 4), baked(rng, 2, 3)
    oracle, places = getattr(oracles, filter_), oracle_positions(TURN)
    of_history = Reading("slices", history_filter=filter_)
    picture = np.moveaxis(np.asarray(history.under(WHOLE)), 0, -1)
    ours = read(history, displaced(TURN, reading=of_history))
    expected = oracles.sample_all(oracle, picture, places)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-13)
    of_texture = Reading("slices", texture_filter=filter_)
    ours = read(texture, displaced(TURN, reading=of_texture))
    picture, places = np.asarray(texture.color), 2 * (places + 3 - 0.5) + 0.5
    expected = oracles.sample_all(oracle, picture, places)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-13)
    # The other filter is not even in the program.
    for source, other in [(history, of_texture), (texture, of_history)]:
        programs = [
            str(jax.make_jaxpr(source.at)(displaced(TURN, reading=reading)))
            for reading in (SLICES, other)
        ]
        assert programs[0] == programs[1]


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("sampler", "slice", "one of slices, .*, got 'slice'. Did you mean 'slices'"),
        ("texture_filter", "cubic", "one of nearest, bilinear, catmull_rom, got 'cu"),
        ("history_filter", "Bilinear", "one of .*, got 'Bilinear'. Did you mean 'bil"),
        ("warp", "", "one of homography, affine, shift, got ''.$"),
        ("warp", None, "one of homography, affine, shift, got None.$"),
        ("sampler", 3, "one of slices, gather, plain, at_rest, got 3.$"),
    ],
)
def test_a_reading_that_there_is_not_is_refused(untyped, field, value, message):
    with pytest.raises(ValueError, match=f"^{field} must be {message}") as error:
        Reading(**{field: value})
    assert "\n" not in str(error.value)
