import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import viewing
from hypothesis import given
from hypothesis import strategies as st

import hmdjit as hj
from hmdjit.camera import Region
from hmdjit.frames.displacement import GATHER, SLICES, Reading
from hmdjit.frames.sources import History
from hmdjit.simulation import blocks, session
from hmdjit.simulation.blocks import Blocks
from hmdjit.technique_contract.base import AbstractTechnique
from hmdjit.techniques import SSAA, Freeze, HeadMovement, NoAntialiasing

# --- cutting ---

sizes = st.integers(1, 30)
limits = st.tuples(st.integers(2, 8), st.integers(2, 12))


def cut(region, limit):
    """As `blocks.cut`, with other blocks."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(blocks, "LARGEST_PX", limit)
        return blocks.cut(region)


@given(sizes, sizes, limits)
def test_blocks_cover_each_pixel_exactly_once(width, height, limit):
    region = Region(7, 3, width, height)
    grid = cut(region, limit)
    covered = np.zeros((height, width), int)
    for index in range(grid.count):
        column, row = grid.place(jnp.int32(index))
        block = grid.block(jnp.int32(index))
        assert (block.x0, block.y0) == (7 + column, 3 + row)
        covered[row : row + block.height, column : column + block.width] += 1
    assert (covered == 1).all()


@given(sizes, sizes, limits)
def test_blocks_are_small_unless_nothing_good_divides_the_size(width, height, limit):
    grid = cut(Region(0, 0, width, height), limit)
    if width * height <= 2 * limit[0] * limit[1]:
        assert grid.count == 1
        return
    for size, side, largest in zip(
        (height, width), (grid.height, grid.width), limit, strict=True
    ):
        good = [d for d in range(1, largest + 1) if size % d == 0 and 4 * d >= largest]
        assert side == (max(good) if good else size)


@pytest.mark.parametrize(
    ("size", "block"),
    [
        ((1024, 1024), (128, 64)),
        ((128, 128), (128, 128)),  # two blocks are no worse than one
        ((1280, 720), (128, 60)),
        ((1440, 1600), (120, 64)),
        ((997, 1024), (997, 64)),
    ],
)
def test_usual_displays_are_cut_into_blocks_that_fit_a_cache(size, block):
    grid = blocks.cut(Region(0, 0, *size))
    assert (grid.width, grid.height) == block


# --- states ---

REGION = Region(5, 4, 12, 10)
GRID = Blocks(REGION, 4, 5)


def part(planes, block, region=REGION):
    """Its pixels of a region's planes."""
    rows = slice(block.y0 - region.y0, block.y0 - region.y0 + block.height)
    columns = slice(block.x0 - region.x0, block.x0 - region.x0 + block.width)
    return planes[..., rows, columns]


@pytest.fixture
def planes(rng):
    return jnp.asarray(rng.random((3, REGION.height, REGION.width)))


@pytest.mark.parametrize("rim_px", [0, 4])
def test_a_rim_repeats_the_edge(planes, rim_px):
    history = History.of(planes).with_rim(REGION, rim_px)
    widths = [(0, 0), (rim_px, rim_px), (rim_px, rim_px)]
    expected = np.pad(planes, widths, mode="edge")
    np.testing.assert_array_equal(history.texels[0, 0], expected)
    np.testing.assert_array_equal(history.under(REGION), planes)
    for index in range(GRID.count):
        block = GRID.block(jnp.int32(index))
        np.testing.assert_array_equal(history.under(block), part(planes, block))


@pytest.mark.parametrize(("size", "rim_px"), [((12, 10), 4), ((2, 3), 1), ((1, 1), 4)])
def test_a_rim_repeated_once_more_is_that_of_what_was_written(rng, rim_px, size):
    region = Region(5, 4, *size)
    old, new = jnp.asarray(rng.random((2, 3, *size[::-1])))
    history = History.of(old).with_rim(region, rim_px).written(new, region)
    expected = History.of(new).with_rim(region, rim_px)
    ours = jax.jit(lambda history: history.rimmed().texels)(history)
    np.testing.assert_array_equal(ours, expected.texels)


def test_writing_a_block_leaves_the_others(planes):
    history = History.of(planes).with_rim(REGION, 2)
    block = GRID.block(jnp.int32(4))
    written = history.written(jnp.zeros((3, block.height, block.width)), block)
    expected = np.array(history.texels)
    row, column = 2 + block.y0 - REGION.y0, 2 + block.x0 - REGION.x0
    expected[..., row : row + block.height, column : column + block.width] = 0
    np.testing.assert_array_equal(written.texels, expected)


def test_a_state_written_block_by_block_is_that_of_the_whole(planes):
    def state(planes, count):
        return {"shown": History.of(planes), "more": (History.of(2 * planes), count)}

    expected = blocks.kept(state(planes, jnp.int32(7)), REGION, 4)
    shapes = jax.eval_shape(state, part(planes, GRID.block(jnp.int32(0))), jnp.int32(0))
    ours = blocks.blank(shapes, REGION, 4)
    for index in range(GRID.count):
        block = GRID.block(jnp.int32(index))
        of_block = state(part(planes, block), jnp.int32(7))
        ours = blocks.written(ours, of_block, block)
    assert eqx.tree_equal(blocks.rimmed(ours), expected)


def test_only_what_keeps_its_pixels_as_histories_is_cut(planes):
    history = History.of(planes)
    for state in (None, history, (history, jnp.int32(0)), jnp.zeros(3)):
        assert blocks.is_cuttable(state)
    for state in (planes, (history, planes[0]), {"a": history, "b": planes}):
        assert not blocks.is_cuttable(state)


@pytest.mark.parametrize("index", range(GRID.count))
def test_a_blocks_planes_are_its_part_of_the_regions(planes, index):
    block = GRID.block(jnp.int32(index))
    ours = blocks.part_of(planes, REGION, block)
    np.testing.assert_array_equal(ours, part(planes, block))


# --- sessions: by slices, whole or cut, and by gathers ---

# 38 px per rad: the picture moves by what `turns` says.
CAMERA = hj.Camera(width_px=40, height_px=24, fov_deg=55.0, refresh_hz=60.0)
WHOLE = Region.whole(CAMERA)
INNER = Region(9, 7, 17, 11)  # measured, across blocks
UNCUT = blocks.LARGEST_PX
FRAMES = 6

# Weights that do not fall with head speed: history counts however fast it moves.
Kim = functools.partial(HeadMovement, h_max_deg_s=1e6)
TECHNIQUES = {
    "none": NoAntialiasing(),
    "ssaa2": SSAA(2),
    "ssaa4": SSAA(4),
    "freeze": Freeze(),
    "head_movement": Kim(),
    "same_pixel in linear": Kim(
        difference="same_pixel", closeness=(0.2, 0.8), space="linear"
    ),
    "head_movement+ssaa2": Kim(resolve=SSAA(2)),
}


@pytest.fixture(scope="module")
def texture():
    return viewing.noise_texture(np.random.default_rng(4), CAMERA, 12)


def motions(rng):
    """At rest, moving by parts of a pixel, by pixels, by many, and out of sight.

    How far a head turns from frame to frame is set apart from where it points, so that
    the texture's margin suffices.
    """
    offsets = np.cumsum(0.5 * rng.normal(size=(5, FRAMES, 3)), axis=1)
    offsets[0] = 0.0
    offsets[:, 0] = 0.0
    pixels = np.array([0.0, 0.3, 3.0, 30.0, 100.0])[:, None, None]
    turns = pixels * rng.normal(size=(5, FRAMES, 3))
    turns[:, 0] = 0.0
    focal_px = float(CAMERA.focal_px)
    return hj.Motion(jnp.asarray(offsets / focal_px), jnp.asarray(turns / focal_px))


def measured(technique, texture, motion, reading, limit=UNCUT, region=WHOLE, part=None):
    """Results of sessions, `(sessions, 2)`, cut into blocks of another size."""

    # Optimising the program takes longer than all the rest of a test.
    @functools.partial(
        jax.jit, compiler_options={"xla_backend_optimization_level": "0"}
    )
    def results(texture, camera, technique, motion, region, part):
        def one(motion):
            (result,) = session.session(
                texture,
                camera,
                (technique,),
                motion,
                region,
                part,
                warmup=1,
                reading=reading,
            )
            return jnp.stack([result.mtcd, result.detail_loss])

        return jax.lax.map(one, motion)

    part = region if part is None else part
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(blocks, "LARGEST_PX", limit)
        return np.asarray(results(texture, CAMERA, technique, motion, region, part))


def check_the_same(ours, expected):
    # The same numbers in another order: reads round to an ulp or so of a colour, times
    # the few texels per texel of slope that 20 roundings of a position cost; a mean of
    # a thousand pixels is summed to as many ulps at worst, of values of some 100.
    assert np.isfinite(expected).all()
    np.testing.assert_allclose(ours, expected, rtol=1e-12, atol=1e-11)


slow = functools.partial(pytest.param, marks=pytest.mark.slow)


@pytest.mark.parametrize(
    ("name", "limits"),
    [
        ("head_movement", [(8, 10)]),
        slow("same_pixel in linear", [UNCUT, (8, 10)]),
        slow("none", [UNCUT, (8, 10), (2, 2)]),
        slow("ssaa2", [UNCUT, (8, 10)]),
        slow("ssaa4", [UNCUT, (8, 10)]),
        slow("freeze", [UNCUT, (8, 10)]),
        slow("head_movement", [UNCUT, (5, 7), (24, 1)]),
        slow("head_movement+ssaa2", [UNCUT, (8, 10)]),
    ],
)
def test_a_session_by_slices_is_the_session_by_gathers(rng, texture, name, limits):
    technique, motion = TECHNIQUES[name], motions(rng)
    by = functools.partial(measured, technique, texture, motion, part=INNER)
    expected = by(GATHER)
    assert (expected[1:, 0] > 1).all() or name == "freeze"
    for limit in limits:
        check_the_same(by(SLICES, limit), expected)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("region", "is_inner"),
    [
        (Region(3, 2, 37, 22), True),  # no good divisor: strips as wide as the region
        (Region(3, 1, 37, 23), False),  # none at all: one piece
        (Region(0, 0, 12, 24), False),
        (Region(28, 20, 12, 4), True),  # in the frame's corner
    ],
    ids=["strips", "one piece", "left", "corner"],
)
def test_regions_of_any_shape_are_the_same_in_blocks(rng, texture, region, is_inner):
    inner = Region(region.x0 + 1, region.y0 + 1, region.width - 3, region.height - 2)
    by = functools.partial(
        measured,
        TECHNIQUES["head_movement"],
        texture,
        motions(rng),
        region=region,
        part=inner if is_inner else region,
    )
    check_the_same(by(SLICES, (6, 8)), by(GATHER))


@pytest.mark.slow
def test_of_blocks_as_large_as_what_is_measured_one_counts(rng, texture):
    technique, motion = TECHNIQUES["head_movement"], motions(rng)
    region, part = Region(8, 0, 24, 24), Region(16, 8, 8, 8)
    by = functools.partial(
        measured, technique, texture, motion, region=region, part=part
    )
    check_the_same(by(SLICES, (8, 8)), by(GATHER))


class Nameless(AbstractTechnique):
    """Made to keep something, or to read around."""

    @property
    def id(self):
        return "nameless"


class Fading(Nameless):
    """Fades from the first picture, kept as a plane or as a history, by a counter."""

    keeps_history: bool = eqx.field(static=True)

    def init(self, frame):
        first = frame.color[0]
        kept = History.of(first) if self.keeps_history else first
        return kept, jnp.zeros((), first.dtype)

    def step(self, state, frame, motion):
        kept, count = state
        first = kept.under(frame.region) if self.keeps_history else kept
        kept = History.of(first) if self.keeps_history else kept
        return (kept, count + 1), first + (frame.color[0] - first) * count / FRAMES


@pytest.mark.parametrize("keeps_history", [True, slow(False)])
def test_a_state_may_hold_numbers_and_planes_beside(rng, texture, keeps_history):
    # A counter counts frames, not blocks; a plane that is no history keeps a region
    # in one piece.
    by = functools.partial(measured, Fading(keeps_history), texture, motions(rng))
    expected = by(GATHER)
    assert (expected[:, 1] > 1).all()
    check_the_same(by(SLICES, (8, 10)), expected)


class Smoothing(Nameless):
    """Mean of each pixel and its right-hand neighbour; the edge repeats."""

    @property
    def stencil_radius_px(self):
        return 1

    def init(self, frame):
        return None

    def step(self, state, frame, motion):
        picture = frame.color[0]
        right = jnp.concatenate([picture[..., 1:], picture[..., -1:]], axis=-1)
        return None, (picture + right) / 2


@pytest.mark.slow
def test_a_stencil_is_not_cut_off_at_block_edges(rng, texture):
    by = functools.partial(measured, Smoothing(), texture, motions(rng))
    check_the_same(by(SLICES, (8, 10)), by(GATHER))


@pytest.mark.slow
def test_a_filter_is_in_the_programs_of_those_who_read_through_it(rng, texture):
    motion = jax.tree.map(lambda leaf: leaf[1], motions(rng))

    def program(name, **filters):
        reading = Reading("slices", **filters)
        run = functools.partial(session.session, warmup=1, reading=reading)
        arguments = (texture, CAMERA, (TECHNIQUES[name],), motion, WHOLE, INNER)
        return str(jax.make_jaxpr(run)(*arguments))

    none, kim = program("none"), program("head_movement")
    assert program("none", history_filter="nearest") == none
    assert program("head_movement", history_filter="nearest") != kim
    assert program("none", texture_filter="nearest") != none
