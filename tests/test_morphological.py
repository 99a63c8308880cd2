import functools

import antialiasing_images
import jax
import jax.numpy as jnp
import numpy as np
import oracle_morphological as oracle
import pytest
import viewing
from antialiasing_images import SIZE_PX, half_plane, of_two
from small import quickly

import hmdjit as hj
from hmdjit import techniques
from hmdjit.frames.displacement import SLICES
from hmdjit.metrics import MTCD
from hmdjit.simulation.halo import needed_halo_px
from hmdjit.simulation.session import session
from hmdjit.techniques import MLAA, SMAA

IMAGES = antialiasing_images.images()
FEW = list(IMAGES)[1::5]
CAMERA = hj.Camera(SIZE_PX, SIZE_PX, 4.0, 60.0)


def resolved(technique, picture):
    """Picture `(3, height, width)` that a technique makes of one."""
    height, width = picture.shape[1:]
    region = hj.Region(0, 0, width, height)
    return technique.resolve(hj.Frame(picture[None], CAMERA, region))


@functools.cache
def program(technique):
    return quickly(functools.partial(resolved, technique))


def shown(technique, picture, dtype: type = float):
    return np.asarray(program(technique)(jnp.asarray(picture, dtype)))


def expected_of(technique, picture, tie=oracle.TIE):
    if isinstance(technique, MLAA):
        return oracle.mlaa(picture, technique.space, tie)
    choices = technique.preset, technique.edges, technique.space
    return oracle.smaa(picture, *choices, tie)


def slow(*values):
    return pytest.param(*values, marks=pytest.mark.slow)


# --- against the oracle ---

EVERY = [MLAA(space) for space in ("gamma", "linear")] + [
    SMAA(preset, by, space)
    for preset in ("low", "medium", "high", "ultra")
    for by in ("luma", "color")
    for space in ("gamma", "linear")
]


def agrees(technique, names):
    changed = 0
    for name in names:
        expected = expected_of(technique, IMAGES[name])
        ours = shown(technique, IMAGES[name])
        np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-9, err_msg=name)
        changed += np.any(expected != IMAGES[name], axis=0).mean()
    assert changed > 0.05 * len(names)  # else little would be shown


SOME = [MLAA("linear"), SMAA(), SMAA("ultra", "color")]


@pytest.mark.parametrize("technique", SOME, ids=lambda technique: technique.id)
def test_pictures_agree_with_the_oracle(technique):
    agrees(technique, FEW)


@pytest.mark.slow
@pytest.mark.parametrize("technique", EVERY, ids=lambda technique: technique.id)
def test_all_pictures_agree_with_the_oracle(technique):
    assert len(IMAGES) >= 25
    agrees(technique, FEW if technique.space == "linear" else IMAGES)


@pytest.mark.slow
@pytest.mark.parametrize("size", [(1, 1), (1, 7), (3, 2), (5, 40)])
def test_pictures_may_be_smaller_than_a_walk(size, rng):
    picture, technique = rng.random((3, *size)), SMAA("ultra", "color")
    expected = expected_of(technique, picture)
    np.testing.assert_allclose(shown(technique, picture), expected, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_a_batch_is_shown_as_its_pictures_are():
    technique = SMAA("ultra", "color")
    batch = jnp.asarray([IMAGES[name] for name in FEW])
    ours = jax.jit(jax.vmap(functools.partial(resolved, technique)))(batch)
    expected = [shown(technique, picture) for picture in batch]
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-14)


# Lumas and weights err by some 1e-7 in single precision: decisions that a change of
# all bounds by this much turns over are ties.
NEAR_TIE = 1e-6


@pytest.mark.parametrize(
    ("technique", "names"),
    [
        (SMAA(), FEW[::2]),
        slow(MLAA(), list(IMAGES)[::4]),
        slow(SMAA("ultra", "color"), list(IMAGES)[::4]),
    ],
    ids=lambda value: getattr(value, "id", ""),
)
def test_single_precision_agrees_but_at_ties(technique, names):
    left_out = 0
    for name in names:
        picture = IMAGES[name].astype(np.float32)
        ours = shown(technique, picture, np.float32)
        assert ours.dtype == np.float32
        ties = (oracle.TIE + sign * NEAR_TIE for sign in (0, -1, 1))
        expected, *others = (
            expected_of(technique, picture.astype(float), t) for t in ties
        )
        is_tie = np.any([abs(expected - other) > 1e-7 for other in others], axis=(0, 1))
        error = abs(ours - expected).max(axis=0)
        assert error[~is_tie].max() < 2e-6, name
        left_out += is_tie.mean()
    assert left_out < 0.01 * len(names)


# --- coverage ---


def coverage(height_at, samples=64):
    """Share of each pixel below a level line, exact where no pixel's corner is cut."""
    x = (np.arange(SIZE_PX * samples) + 0.5) / samples
    rows = np.arange(SIZE_PX)[:, None]
    parts = np.clip(rows + 1 - height_at(x), 0, 1)
    return parts.reshape(SIZE_PX, SIZE_PX, samples).mean(axis=-1)


@pytest.mark.parametrize("turned", [False, True])
def test_an_edge_of_slope_1_over_n_gets_its_exact_coverage(turned):
    technique = SMAA("medium")
    for n in range(2, 13):
        # It passes through the middle of each step.
        height_at = lambda x, n=n: 12.5 + (x - n) / n
        centre = np.arange(SIZE_PX) + 0.5
        picture = of_two(centre[:, None] > height_at(centre))
        exact = coverage(height_at, 64)
        ours = shown(technique, picture.swapaxes(1, 2) if turned else picture)[0]
        ours = ours.T if turned else ours
        whole = slice(n, (SIZE_PX // n - 1) * n)  # steps that end inside
        np.testing.assert_allclose(ours[:, whole], exact[:, whole], rtol=0, atol=1e-9)


@pytest.mark.parametrize("angle_deg", [30, 38, 43, 48, 55, 128, 133, 140])
def test_steep_edges_come_near_their_coverage(angle_deg):
    fine = np.mean(
        [
            _half_plane_at(angle_deg, dx, dy)
            for dx in (np.arange(16) + 0.5) / 16 - 0.5
            for dy in (np.arange(16) + 0.5) / 16 - 0.5
        ],
        axis=0,
    )
    inner = (slice(8, -8), slice(8, -8))
    picture = of_two(half_plane(angle_deg, 0.3))
    rms = lambda plane: np.sqrt(np.mean((plane[inner] - fine[inner]) ** 2))
    assert rms(shown(SMAA(), picture)[0]) < 0.4 * rms(picture[0])


def _half_plane_at(angle_deg, dx, dy):
    angle = np.radians(angle_deg)
    return half_plane(angle_deg, 0.3 - np.sin(angle) * dx + np.cos(angle) * dy)


# --- laws ---


@pytest.mark.parametrize("technique", SOME, ids=lambda technique: technique.id)
def test_what_has_no_steps_is_left_alone(technique, rng):
    level = np.broadcast_to(rng.random((3, 1, 1)), (3, SIZE_PX, SIZE_PX))
    slight = 0.02 * (np.arange(SIZE_PX) + np.arange(SIZE_PX)[:, None])
    steep = np.cumsum(rng.random(SIZE_PX)) / 20  # edges that nothing turns off
    for picture in (level, np.stack([slight / 2] * 3), np.tile(steep, (3, SIZE_PX, 1))):
        np.testing.assert_array_equal(shown(technique, picture), picture)
        turned = picture.swapaxes(1, 2)
        np.testing.assert_array_equal(shown(technique, turned), turned)


@pytest.mark.parametrize("technique", SOME, ids=lambda technique: technique.id)
def test_a_shifted_picture_is_shown_shifted(technique):
    picture = np.full((3, SIZE_PX, SIZE_PX), 0.3)
    picture[:, 12:28, 12:28] = IMAGES["glyphs"][:, :16, :16]
    found = shown(technique, picture)
    assert np.any(found != picture)
    for shift in ((0, 5), (-7, 0), (4, -6)):
        moved = shown(technique, np.roll(picture, shift, (1, 2)))
        np.testing.assert_array_equal(moved, np.roll(found, shift, (1, 2)))


@pytest.mark.parametrize("technique", [SOME[0], SMAA("medium")], ids=lambda t: t.id)
def test_without_diagonals_rows_are_columns(technique):
    for name in FEW:
        picture = IMAGES[name]
        ours = shown(technique, picture.swapaxes(1, 2)).swapaxes(1, 2)
        expected = shown(technique, picture)
        if isinstance(technique, SMAA):  # where both pairs are as strong, rows go first
            options = 0.1, 16, 0, 0.0, True, "luma", oracle.TIE
            t, b, w, e = oracle.shares(picture, *options)
            is_tie = abs(np.maximum(t, b) - np.maximum(w, e)) < 2e-5
            ours = np.where(is_tie, expected, ours)
        np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-12, err_msg=name)


@pytest.mark.parametrize(
    "technique", [SMAA(), *map(slow, EVERY[:2])], ids=lambda technique: technique.id
)
def test_gradients_are_those_of_a_mix_of_colors(technique, rng):
    picture = jnp.asarray(IMAGES["disc"])
    weights = jnp.asarray(rng.random(picture.shape))
    total = lambda picture: jnp.sum(weights * resolved(technique, picture))
    slope = np.asarray(quickly(jax.grad(total))(picture))
    assert np.isfinite(slope).all()
    assert np.abs(slope - weights).max() > 0.01
    # Edges stay where they are under a small change of all colours.
    change = 1e-6 * rng.normal(size=picture.shape)
    moved = [np.sum(weights * shown(technique, picture + s * change)) for s in (1, -1)]
    np.testing.assert_allclose(
        (moved[0] - moved[1]) / 2, np.sum(slope * change), rtol=1e-4
    )


# --- how far they read ---

TECHNIQUE = SMAA("low", "color")


def test_the_stencil_is_as_wide_as_said():
    middle, longest = 18, TECHNIQUE.stencil_radius_px - 2
    # A level edge whose ends are at the longest walk from the middle.
    picture = np.zeros((3, SIZE_PX, SIZE_PX))
    picture[:, 20:] = 0.4
    picture[:, 20, middle + longest + 1 :] = 0.0
    picture[:, 20, : middle - longest] = 0.0
    found = shown(TECHNIQUE, picture)
    changed = picture.copy()
    # So strong an edge that the one at the line's end is none beside it.
    changed[:, 20, middle + longest + 2] = 1.0
    columns = np.nonzero(np.any(shown(TECHNIQUE, changed) != found, axis=0))[1]
    assert columns.min() == middle


@pytest.mark.parametrize("name", FEW)
def test_nothing_beyond_the_stencil_is_read(name, rng):
    inner = slice(16, 24)
    around = slice(16 - TECHNIQUE.stencil_radius_px, 24 + TECHNIQUE.stencil_radius_px)
    other = rng.random(IMAGES[name].shape)
    other[:, around, around] = IMAGES[name][:, around, around]
    ours = shown(TECHNIQUE, other)[:, inner, inner]
    np.testing.assert_array_equal(ours, shown(TECHNIQUE, IMAGES[name])[:, inner, inner])


@pytest.mark.slow
@pytest.mark.parametrize("technique", EVERY[2::4], ids=lambda technique: technique.id)
def test_nothing_beyond_a_wide_stencil_is_read(technique, rng):
    radius = technique.stencil_radius_px
    for name in ("level comb", "wires", "edge 2.5", "edge 45", "noise"):
        picture = np.tile(IMAGES[name], (1, 1, 4))
        found = shown(technique, picture)
        for _ in range(6):
            y, x = rng.integers(0, picture.shape[1:])
            changed = picture.copy()
            changed[:, y, x] = rng.random(3)
            rows, columns = np.nonzero(
                np.any(shown(technique, changed) != found, axis=0)
            )
            assert np.abs(columns - x).max(initial=0) <= radius
            assert np.abs(rows - y).max(initial=0) <= radius


# --- in the engine ---


WIDE = hj.Camera(64, 48, 4.0, 60.0)


@pytest.mark.slow
def test_a_tile_with_its_halo_measures_what_the_whole_frame_does(rng):
    repeated = np.tile(IMAGES["large glyphs"], (1, 3, 3))
    texels = jnp.asarray(np.moveaxis(repeated[:, :64, :80], 0, -1))  # 8 px of margin
    texture = hj.Texture.of(texels, texels, oversampling=1, margin_px=8)
    motion = hj.Motion.of(jnp.asarray(viewing.path(rng, WIDE, 4, 0.8)))
    tile = hj.Region(29, 20, 8, 6)
    origins = np.array([[[tile.x0, tile.y0]]])
    moves = jax.tree.map(lambda leaf: leaf[None], motion)
    (halo_px,) = needed_halo_px(TECHNIQUE, WIDE, moves, origins, (8, 6))
    assert halo_px == TECHNIQUE.stencil_radius_px == 10

    def measured(region):
        run = functools.partial(session, warmup=0, reading=SLICES, metrics=(MTCD(),))
        shared = texture, WIDE, (TECHNIQUE,)
        (result,) = quickly(lambda *given: run(*shared, *given))(motion, region, tile)
        return np.array([float(value) for value in result.metrics.values()])

    around = lambda px: hj.Region(29 - px, 20 - px, 8 + 2 * px, 6 + 2 * px)
    expected = measured(hj.Region.whole(WIDE))
    np.testing.assert_allclose(measured(around(10)), expected, rtol=1e-12)
    assert (expected > 0).all()


def shown_clip(technique, names):
    clip = np.stack([IMAGES[name] for name in names])
    frames, poses = np.moveaxis(clip, 1, -1), np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
    expected = [np.moveaxis(shown(TECHNIQUE, picture), 0, -1) for picture in clip]
    return np.asarray(hj.apply(technique, CAMERA, frames, poses)), expected


def test_it_shows_clips():
    ours, expected = shown_clip(TECHNIQUE, FEW[:3])
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-14)


@pytest.mark.slow
def test_a_head_movement_blends_what_it_shows():
    blended = techniques.HeadMovement(resolve=TECHNIQUE)
    assert blended.id == "head_movement+smaa_low_color"
    assert techniques.by_id(blended.id) == blended
    ours, expected = shown_clip(blended, FEW[:3])
    np.testing.assert_allclose(ours[0], expected[0], rtol=0, atol=1e-14)


# --- ids and doors ---


@pytest.mark.parametrize("technique", EVERY, ids=lambda technique: technique.id)
def test_ids_make_the_same_technique(technique):
    assert techniques.by_id(technique.id) == technique


def test_ids_say_what_is_not_the_default():
    assert (SMAA().id, SMAA().preset) == ("smaa", "high")
    assert SMAA("ultra", "color", "linear").id == "smaa_ultra_color_linear"
    assert MLAA("linear").id == "mlaa_linear"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: SMAA("highest"),
            "^preset must be one of low, medium, high, ultra, got",
        ),
        (lambda: SMAA(edges="depth"), "^edges must be one of luma, color, got 'depth'"),
        (lambda: SMAA(space="srgb"), "^space must be one of gamma, linear, got 'srgb'"),
        (lambda: MLAA("srgb"), "^space must be one of gamma, linear, got 'srgb'"),
    ],
)
def test_what_is_not_known_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
