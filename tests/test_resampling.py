import functools

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates
from small import quickly

from hmdjit.frames import resampling


def reading(reader):
    """A reader of pictures, made of one of stored texels."""
    return lambda picture, *place: reader(resampling.texels(picture), *place)


READERS = {
    "nearest": (reading(resampling.nearest), oracles.nearest),
    "bilinear": (reading(resampling.bilinear), oracles.bilinear),
    "catmull_rom": (reading(resampling.catmull_rom), oracles.catmull_rom),
}
HEIGHT, WIDTH = 6, 8
each_reader = pytest.mark.parametrize("name", READERS)


@pytest.fixture
def texels(rng):
    return jnp.asarray(rng.random((HEIGHT, WIDTH, 3)))


def grid(width=WIDTH, height=HEIGHT):
    """Column and row of every texel, as int32 that broadcast."""
    column = jnp.arange(width, dtype=jnp.int32)[None, :]
    return column, jnp.arange(height, dtype=jnp.int32)[:, None]


def read(name, texels, dx, dy):
    """Read the whole picture, each texel displaced by `(dx, dy)`."""
    planes = (jnp.broadcast_to(jnp.asarray(d), (HEIGHT, WIDTH)) for d in (dx, dy))
    return READERS[name][0](texels, *grid(), *(p.astype(texels.dtype) for p in planes))


def positions(dx, dy):
    """Where `read` reads, `(HEIGHT, WIDTH, 2)`, texel centres at half integers."""
    column, row = (np.asarray(index) for index in grid())
    x = np.broadcast_to(column + 0.5 + dx, (HEIGHT, WIDTH))
    y = np.broadcast_to(row + 0.5 + dy, (HEIGHT, WIDTH))
    return np.stack([x, y], axis=-1)


# --- independent oracles ---


@each_reader
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("reach", [0.4, 3.0, 30.0])
def test_readers_agree_with_numpy(name, dtype, reach, rng, texels):
    # Up to 30 texels: far beyond the border too.
    dx, dy = rng.uniform(-reach, reach, (2, HEIGHT, WIDTH)).astype(dtype)
    texels = texels.astype(dtype)
    ours = read(name, texels, dx, dy)
    assert ours.dtype == dtype
    oracle = READERS[name][1]
    places = positions(dx.astype(float), dy.astype(float))
    expected = oracles.sample_all(oracle, np.asarray(texels, float), places)
    # A displacement keeps its fraction to eps x reach; slopes are below 2 per texel.
    atol = 8 * np.finfo(dtype).eps * max(1.0, reach)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=atol)


@each_reader
def test_readers_agree_with_numpy_however_they_are_called(name, variant, rng, texels):
    dx, dy = jnp.asarray(rng.uniform(-2, 2, (2, HEIGHT, WIDTH)))
    reader, oracle = READERS[name]
    column, row = grid()
    ours = variant(reader)(texels, column, row, dx, dy)
    places = positions(np.asarray(dx), np.asarray(dy))
    # In a batch of `variant` the first run reads zeros at zeros, the second is ours.
    expected = oracles.sample_all(oracle, np.asarray(texels), places)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize(("name", "order"), [("nearest", 0), ("bilinear", 1)])
def test_readers_agree_with_scipy(name, order, rng, texels):
    dx, dy = rng.uniform(-4, 4, (2, HEIGHT, WIDTH))
    x, y = np.moveaxis(positions(dx, dy), -1, 0) - 0.5
    planes = np.moveaxis(np.asarray(texels), -1, 0)
    oracle = [map_coordinates(p, [y, x], order=order, mode="nearest") for p in planes]
    np.testing.assert_allclose(read(name, texels, dx, dy), oracle, rtol=0, atol=1e-14)


def test_bilinear_agrees_with_opencv(rng, texels):
    # OpenCV rounds fractions to 1/32: give it fractions that it can hold.
    dx, dy = rng.integers(-128, 129, (2, HEIGHT, WIDTH)) / 32
    x, y = np.moveaxis(positions(dx, dy), -1, 0).astype(np.float32) - 0.5
    picture = np.array(texels)
    oracle = cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    ours = np.moveaxis(np.asarray(read("bilinear", texels, dx, dy)), 0, -1)
    np.testing.assert_allclose(ours, oracle, rtol=0, atol=1e-7)  # float32 weights


@each_reader
def test_a_block_may_differ_from_the_picture_in_shape(name, rng, texels):
    column = jnp.array([[5, 6]], dtype=jnp.int32)
    row = jnp.array([[1], [2], [3]], dtype=jnp.int32)
    dx, dy = jnp.asarray(rng.uniform(-1, 1, (2, 3, 2)))
    reader, oracle = READERS[name]
    block = reader(texels[..., :1], column, row, dx, dy)
    assert block.shape == (1, 3, 2)
    x = np.asarray(column) + 0.5 + np.asarray(dx)
    y = np.asarray(row) + 0.5 + np.asarray(dy)
    places = np.stack([x, y], axis=-1)
    expected = oracles.sample_all(oracle, np.asarray(texels[..., :1]), places)
    np.testing.assert_allclose(block, expected, rtol=0, atol=1e-14)


# --- laws ---

coefficients = st.floats(-1.0, 1.0)


def coordinates():
    column, row = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    return column.astype(float), row.astype(float)


@given(st.tuples(*[coefficients] * 4), st.integers(0, 99))
def test_bilinear_is_exact_for_affine_pictures(a, seed):
    picture = lambda x, y: a[0] + a[1] * x + a[2] * y + a[3] * x * y
    x, y = coordinates()
    # Stay within the picture, where clamping does not bend it.
    rng = np.random.default_rng(seed)
    dx, dy = rng.uniform(-x, WIDTH - 1 - x), rng.uniform(-y, HEIGHT - 1 - y)
    ours = read("bilinear", jnp.asarray(picture(x, y))[..., None], dx, dy)
    # Values of at most 50, a dozen roundings.
    np.testing.assert_allclose(ours[0], picture(x + dx, y + dy), rtol=0, atol=1e-13)


@given(st.tuples(*[coefficients] * 9), st.integers(0, 99))
def test_catmull_rom_is_exact_for_quadratic_pictures(a, seed):
    def picture(x, y):
        powers = [x**i * y**j for i in range(3) for j in range(3)]
        return sum(factor * power for factor, power in zip(a, powers, strict=True))

    x, y = coordinates()
    rng = np.random.default_rng(seed)
    dx, dy = rng.uniform(1 - x, WIDTH - 2 - x), rng.uniform(1 - y, HEIGHT - 2 - y)
    ours = read("catmull_rom", jnp.asarray(picture(x, y))[..., None], dx, dy)
    # Values of at most 3000, sixteen taps.
    np.testing.assert_allclose(ours[0], picture(x + dx, y + dy), rtol=0, atol=1e-11)


@each_reader
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_no_displacement_is_exactly_the_picture(name, dtype, texels):
    texels = texels.astype(dtype)
    ours = read(name, texels, 0.0, 0.0)
    np.testing.assert_array_equal(ours, jnp.moveaxis(texels, -1, 0))


@each_reader
@pytest.mark.parametrize(
    "shift", [(1, 0), (0, -2), (3, 2), (-20, 50), (10**6, -(10**6))]
)
def test_whole_texels_are_exact_shifts_that_clamp_at_the_border(name, shift, texels):
    ours = read(name, texels, float(shift[0]), float(shift[1]))
    column, row = (np.asarray(index) for index in grid())
    column = np.clip(column + shift[0], 0, WIDTH - 1)
    row = np.clip(row + shift[1], 0, HEIGHT - 1)
    moved = np.asarray(texels)[row, column]
    np.testing.assert_array_equal(ours, np.moveaxis(moved, -1, 0))


@each_reader
@pytest.mark.parametrize("far", [1e9, 3e9, 1e30])
def test_positions_however_far_clamp_to_their_own_side(name, far, texels):
    right = read(name, texels, far, 0.0)
    expected = np.broadcast_to(np.moveaxis(texels, -1, 0)[..., -1:], right.shape)
    np.testing.assert_array_equal(right, expected)
    up = read(name, texels, 0.0, -far)
    expected = np.broadcast_to(np.moveaxis(texels, -1, 0)[:, :1], up.shape)
    np.testing.assert_array_equal(up, expected)


@each_reader
def test_weights_sum_to_one(name, rng):
    dx, dy = rng.uniform(-9, 9, (2, HEIGHT, WIDTH))
    ours = read(name, jnp.ones((HEIGHT, WIDTH, 1)), dx, dy)
    np.testing.assert_allclose(ours, 1.0, rtol=0, atol=1e-15)


@pytest.mark.parametrize("name", ["nearest", "bilinear"])
def test_a_mean_stays_between_its_texels(name, rng, texels):
    dx, dy = rng.uniform(-9, 9, (2, HEIGHT, WIDTH))
    ours = read(name, texels, dx, dy)
    assert (ours >= texels.min() - 1e-15).all()
    assert (ours <= texels.max() + 1e-15).all()


def test_nearest_goes_right_and_down_on_a_tie(texels):
    planes = np.moveaxis(texels, -1, 0)
    ours = read("nearest", texels, 0.5, 0.5)
    np.testing.assert_array_equal(ours[:, :-1, :-1], planes[:, 1:, 1:])
    ours = read("nearest", texels, -0.5, -0.5)
    np.testing.assert_array_equal(ours, planes)


@pytest.mark.parametrize("name", ["bilinear", "catmull_rom"])
def test_readers_are_continuous_where_a_centre_is_hit(name, texels):
    tiny = 1e-12
    before, after = read(name, texels, 1 - tiny, -tiny), read(name, texels, 1.0, 0.0)
    np.testing.assert_allclose(before, after, rtol=0, atol=4 * tiny)


# --- gradients ---


@functools.partial(quickly, static_argnums=0)
def slopes(name, texels, dx, dy):
    """Derivative of every value in its own displacement, `(2, 3, HEIGHT, WIDTH)`."""
    zero, one = jnp.zeros((HEIGHT, WIDTH)), jnp.ones((HEIGHT, WIDTH))
    reader = lambda x, y: read(name, texels, x, y)
    along = lambda *tangent: jax.jvp(reader, (zero + dx, zero + dy), tangent)[1]
    return jax.vmap(along)(jnp.stack([one, zero]), jnp.stack([zero, one]))


@each_reader
def test_slopes_agree_with_differences(name, rng, texels):
    # At least 1e-3 from a texel's centre or border, where the slopes jump.
    whole = rng.integers(-1, 2, (2, HEIGHT, WIDTH))
    dx, dy = whole + 0.499 * rng.uniform(0.01, 0.99, (2, HEIGHT, WIDTH))
    step = 1e-6
    x = read(name, texels, dx + step, dy) - read(name, texels, dx - step, dy)
    y = read(name, texels, dx, dy + step) - read(name, texels, dx, dy - step)
    differences = np.stack([x, y]) / (2 * step)
    ours = slopes(name, texels, jnp.asarray(dx), jnp.asarray(dy))
    np.testing.assert_allclose(ours, differences, rtol=0, atol=1e-8)


def test_slopes_where_a_centre_is_hit_exactly(texels):
    planes = np.moveaxis(np.asarray(texels), -1, 0)
    x, y = slopes("bilinear", texels, 0.0, 0.0)  # the one to the right
    np.testing.assert_array_equal(x[..., :-1], np.diff(planes, axis=2))
    np.testing.assert_array_equal(y[:, :-1], np.diff(planes, axis=1))
    np.testing.assert_array_equal(x[..., -1], 0.0)
    x, y = slopes("catmull_rom", texels, 0.0, 0.0)  # the central difference
    middle = (planes[..., 2:] - planes[..., :-2]) / 2
    np.testing.assert_allclose(x[..., 1:-1], middle, rtol=0, atol=1e-15)
    assert jnp.isfinite(y).all()


@pytest.mark.parametrize("name", ["bilinear", "catmull_rom"])
@pytest.mark.parametrize("hole", [np.nan, np.inf])
def test_a_hole_is_seen_but_not_in_the_slope_of_what_is_masked(name, hole, texels):
    # 0 x NaN: what a mask takes out came back in the gradient of the position.
    holed = texels.at[2, 3].set(hole)
    dx, dy = jnp.asarray(0.3), jnp.asarray(0.4)

    def seen(dx, dy):
        shown = read(name, holed, dx, dy)
        return jnp.where(jnp.isfinite(shown), shown, 0.0).sum(), shown

    gradient = quickly(jax.value_and_grad(seen, (0, 1), has_aux=True))
    (_, shown), slope = gradient(dx, dy)
    assert not jnp.isfinite(shown).all()
    assert jnp.isfinite(jnp.stack(slope)).all()


@each_reader
def test_a_hole_is_in_the_slopes_by_the_texels_that_its_pixels_read(name, texels):
    dx, dy = jnp.asarray(0.3), jnp.asarray(-0.6)
    mean = lambda texels, dx: jnp.mean(read(name, texels, dx, dy) ** 2)
    slopes = quickly(jax.grad(mean, (0, 1)))
    with_hole = lambda value: texels.at[2, 3, 1].set(value)
    total = lambda texels, weight: (weight * read(name, texels, dx, dy)).sum()
    weights = quickly(jax.grad(total))
    by_filled, _ = slopes(with_hole(0.5), dx)
    for hole in (np.nan, np.inf):
        is_bad = ~jnp.isfinite(read(name, with_hole(hole), dx, dy))
        is_read = np.asarray(weights(texels, is_bad.astype(texels.dtype))) != 0
        assert 0 < is_read.sum() < is_read.size / 3
        by_holed, by_dx = slopes(with_hole(hole), dx)
        np.testing.assert_array_equal(~np.isfinite(by_holed), is_read)
        # Elsewhere they are those of a picture without the hole, exactly.
        np.testing.assert_array_equal(by_holed[~is_read], by_filled[~is_read])
        # A number that all pixels share has no slope, as the mean has no value.
        assert jnp.isnan(by_dx) or name == "nearest"


@each_reader
def test_gradients_in_the_picture_are_the_weights(name, rng, texels):
    dx, dy = rng.uniform(-2, 2, (2, HEIGHT, WIDTH))
    direction = jnp.asarray(rng.normal(size=texels.shape))
    weight = jnp.asarray(rng.normal(size=(3, HEIGHT, WIDTH)))
    total = lambda t: (weight * read(name, t, dx, dy)).sum()
    gradient = quickly(jax.grad(total))(texels)
    # Reading is linear in the picture, so the gradient says what a change does.
    expected = (weight * read(name, direction, dx, dy)).sum()
    np.testing.assert_allclose((gradient * direction).sum(), expected, rtol=1e-12)


# --- by slices ---

ROWS, COLUMNS = 9, 11  # of the stored picture, in display pixels
BLOCK = (3, 4)  # height and width
CENTRE = (3, 3)  # column and row of its first pixel: no border is near
SIZES = pytest.mark.parametrize(
    ("k", "dtype"), [(1, np.float64), (2, np.float64), (2, np.float32), (4, np.float32)]
)


@pytest.fixture
def stored(rng):
    """A picture of `k` texels per pixel, and its texels."""

    def stored(k, dtype=float):
        picture = rng.random((k * ROWS, k * COLUMNS, 3)).astype(dtype)
        return picture, resampling.texels(jnp.asarray(picture), k)

    return stored


def by_slices():
    """Read a block at many places by many fields."""

    @quickly
    def read(texels, *cases):
        def one(case):
            (column, row), (dx, dy), span = case
            return resampling.bilinear_by_slices(
                texels, column, row, BLOCK, span, lambda: (dx, dy)
            )

        return jax.lax.map(one, cases)  # under `vmap` slices would not stay slices

    def read_all(texels, place, fields, span):
        # In groups of one size, to compile once.
        found = []
        for start in range(0, len(fields), 256):
            chosen = np.arange(start, min(start + 256, len(fields)))
            filled = np.resize(chosen, 256)
            cases = (jnp.asarray(a[filled]) for a in (place, fields, span))
            found.append(read(texels, *cases)[: len(chosen)])
        return np.concatenate(found)

    return read_all


@pytest.fixture(scope="module")
def read_by_slices():
    return by_slices()


@pytest.fixture
def read_slices_only(monkeypatch):
    """Show what is gathered as NaN."""
    nothing = lambda *arguments: jnp.full((3, *BLOCK), jnp.nan)
    monkeypatch.setattr(resampling, "bilinear", nothing)
    return by_slices()


def span_of(fields):
    """Smallest and largest `(dx, dy)` of each field `(2, h, w)`: `(cases, 2, 2)`."""
    return np.stack([fields.min(axis=(2, 3)), fields.max(axis=(2, 3))], axis=1)


def at_centre(fields):
    return np.broadcast_to(np.array(CENTRE, np.int32), (len(fields), 2))


def sweep(rng, k, dtype: type = np.float64):
    """Fields that move blocks across each border, by whole texels and by parts.

    They vary by nothing, by what each number of taps spans, and by more.
    """
    far = 4 + k * max(ROWS, COLUMNS)
    along = np.arange(-far, far + 1)
    moves = [(x, 0) for x in along] + [(0, x) for x in along] + [(x, x) for x in along]
    spreads = [0.0, 0.9, 1.5, 2.5, 5.0]
    moves = np.tile(moves, (len(spreads), 1))
    spread = np.repeat(spreads, len(moves) // len(spreads))
    fractions = rng.random((len(moves), 2, *BLOCK))
    fractions[..., 0, 0] = 0.0  # the lowest lies on a texel's centre
    across = moves[..., None, None] + spread[:, None, None, None] * fractions
    # And a block anywhere, moved a little or far.
    places = [(x, y) for x in range(COLUMNS - 3) for y in range(ROWS - 2)]
    moves = np.outer(np.resize([2, 30], 2 * len(places)), [1, 1])
    moves = moves * rng.uniform(-1, 1, moves.shape)
    around = moves[..., None, None] + rng.uniform(-0.5, 0.5, (len(moves), 2, *BLOCK))
    place = np.concatenate([at_centre(across), places, places]).astype(np.int32)
    return place, np.concatenate([across, around]).astype(dtype)


def oracle_of(picture, k, place, fields):
    """Where the texel of each pixel's centre is displaced, read in float64."""
    height, width = BLOCK
    x = k * (place[:, 0, None, None] + np.arange(width)) + 0.5 + fields[:, 0]
    y = k * (place[:, 1, None, None] + np.arange(height)[:, None]) + 0.5 + fields[:, 1]
    read = oracles.bilinear_at(picture.astype(float), x.ravel(), y.ravel())
    return np.moveaxis(read.reshape(*x.shape, 3), -1, 1)


def rounding(dtype, fields):
    """A displacement keeps its fraction to eps x its size; slopes are below 2."""
    return 8 * np.finfo(dtype).eps * np.abs(fields).max()


def is_sliceable(k, place, span):
    """Whether some number of taps spans it, all of them stored for every pixel."""
    low, high = np.floor(span[:, 0]), np.floor(span[:, 1])
    first = k * place
    last = k * (place + np.array(BLOCK[::-1]) - 1)
    size = k * np.array([COLUMNS, ROWS])
    found = np.zeros(len(place), bool)
    for taps in resampling.TAPS:
        farthest = low + np.array(taps[::-1]) - 1
        is_stored = (first + low >= 0) & (last + farthest < size)
        found |= (is_stored & (high + 1 <= farthest)).all(axis=1)
    return found


@SIZES
def test_slices_agree_with_numpy_across_each_border(
    k, dtype, rng, stored, read_by_slices
):
    picture, texels = stored(k, dtype)
    place, fields = sweep(rng, k, dtype)
    ours = read_by_slices(texels, place, fields, span_of(fields))
    assert ours.dtype == dtype
    expected = oracle_of(picture, k, place, fields.astype(float))
    atol = rounding(dtype, fields)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=atol)


@pytest.mark.parametrize("k", [1, 2, 4])
def test_exactly_what_fits_is_sliced(k, rng, stored, read_slices_only):
    # Neither is a slice shifted to lie within the picture, nor is gathered what fits.
    place, fields = sweep(rng, k)
    span = span_of(fields)
    ours = read_slices_only(stored(k)[1], place, fields, span)
    is_sliced = np.isfinite(ours).all(axis=(1, 2, 3))
    np.testing.assert_array_equal(is_sliced, is_sliceable(k, place, span))
    assert 0.1 < is_sliced.mean() < 0.9


@pytest.mark.parametrize("taps", resampling.TAPS)
def test_each_number_of_taps_reads_all_that_it_spans(
    taps, rng, stored, monkeypatch, read_slices_only
):
    monkeypatch.setattr(resampling, "TAPS", (taps,))
    picture, texels = stored(2)
    low = np.array([[-3, 2], [-2, -1], [0, 0]])
    reach = np.array(taps[::-1]) - 1 - 1e-9
    fields = low[..., None, None] + reach[:, None, None] * rng.random((3, 2, *BLOCK))
    span = np.stack([low, low + reach], axis=1)
    ours = read_slices_only(texels, at_centre(fields), fields, span)
    expected = oracle_of(picture, 2, at_centre(fields), fields)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=rounding(float, fields))


@pytest.mark.parametrize("miss", [1e-6, 1e-3])
def test_a_displacement_that_misses_its_span_is_extrapolated(
    miss, rng, stored, read_by_slices
):
    # Rounding may move it past a bound that is a whole number of texels: the line
    # through the nearest two texels goes on, where weights would have been lost.
    picture, texels = stored(2)
    low = np.array([[0, 0], [-2, 1], [1, -2]])
    for rows, columns in resampling.TAPS:
        reach = np.array([columns, rows]) - 1
        is_high = rng.random((3, 2, *BLOCK)) < 0.5
        missed = np.where(is_high, reach[:, None, None] + miss, -miss)
        fields = low[..., None, None] + missed
        span = np.stack([low, low + reach - 1e-9], axis=1)
        ours = read_by_slices(texels, at_centre(fields), fields, span)
        expected = oracle_of(picture, 2, at_centre(fields), fields)
        # Wrong by the miss times the change of slope, at most 2 per axis.
        np.testing.assert_allclose(ours, expected, rtol=0, atol=4 * miss)
        assert np.abs(ours - expected).max() > 0.01 * miss  # it was not gathered


def test_what_has_no_bounds_is_gathered(rng, stored, read_by_slices):
    inf, nan = np.inf, np.nan
    along_x = [
        *[(-inf, inf), (-inf, -inf), (inf, inf), (nan, nan), (nan, 0.5), (0.0, nan)],
        *[(3e9, 3e9), (-3e9, 3e9), (-1e300, -1e300), (0.0, 1e300)],
    ]
    span = np.array([np.stack([x, (0.0, 0.5)], axis=-1) for x in along_x])
    span = np.concatenate([span, span[..., ::-1]])
    picture, texels = stored(2)
    fields = rng.uniform(-9, 9, (len(span), 2, *BLOCK))
    fields[:, 0, 1, 2] = nan
    fields[:, 1, 0, 0] = -1e300
    ours = read_by_slices(texels, at_centre(fields), fields, span)
    safe = np.clip(np.nan_to_num(fields), -99, 99)
    expected = oracle_of(picture, 2, at_centre(fields), safe)
    expected[:, :, 1, 2] = nan
    np.testing.assert_allclose(ours, expected, rtol=0, atol=rounding(float, safe))


def test_texels_may_be_kept_in_less_than_what_is_computed(rng, stored, read_by_slices):
    texels = stored(2, np.float32)[1].astype(jnp.bfloat16)
    place, fields = sweep(rng, 2, np.float32)
    ours = read_by_slices(texels, place, fields, span_of(fields))
    assert ours.dtype == np.float32
    picture = np.asarray(resampling.picture(texels).astype(jnp.float32))
    expected = oracle_of(picture, 2, place, fields.astype(float))
    atol = rounding(np.float32, fields)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=atol)
