"""NaN propagation: what a texel that is no number reaches, in values and slopes.

Pixels that read such a texel show it, and means over them are no number; so are the
slopes of such means in numbers that all pixels share. In the picture itself a slope is
no number only at texels that those pixels read, and what is masked out has no say.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from extremes import bad_leaves, cast, techniques

from hmdjit.camera import Camera, Region
from hmdjit.frames import resampling
from hmdjit.frames.displacement import Reading
from hmdjit.frames.frame import Frame
from hmdjit.frames.motion import Motion
from hmdjit.frames.sources import History

BLOCK, RIM = 12, 6  # px that are read, and px of the picture around them
# Sixteen past samples are as two, but take long to compile.
SHORT = [name for name in techniques() if name not in ("over SSAA", "sixteen")]
of_techniques = pytest.mark.parametrize(
    "name", [SHORT[0], *(pytest.param(x, marks=pytest.mark.slow) for x in SHORT[1:])]
)
every_dtype = pytest.mark.parametrize("dtype", ["float32", "float64"])


def by_gathers(picture, dx, dy):
    """Read the middle of a picture `(height, width, 1)`, moved by dx and dy texels."""
    index = RIM + jnp.arange(BLOCK, dtype=jnp.int32)
    moved = jnp.full((BLOCK, BLOCK), dx), jnp.full((BLOCK, BLOCK), dy)
    texels = resampling.texels(picture)
    return resampling.bilinear(texels, index[None], index[:, None], *moved)[0]


def by_slices(picture, dx, dy):
    """Read the same with slices."""
    first, place = jnp.int32(RIM), jnp.stack([dx, dy])
    moved = jnp.full((BLOCK, BLOCK), dx), jnp.full((BLOCK, BLOCK), dy)
    # Texels from `floor(d - margin)` on: 3 each way for 1/2, 4 for 1.
    margin = jnp.where(dx > 0, 1.0, 0.5).astype(dx.dtype)
    span = jnp.stack([place - margin, place + margin])
    texels, size = resampling.texels(picture), (BLOCK, BLOCK)
    return resampling.bilinear_by_slices(
        texels, first, first, size, span, lambda: moved
    )[0]


# At rest a texel of weight 0 is read as well, 1 from its pixel; slices read 4 x 4.
READS = {"gathers": (by_gathers, 1 + 1e-6, 2.0), "slices": (by_slices, 2.0, 4.0)}


def beyond(numbers, x, y, reach):
    """How many that are not finite lie a reach or more from a place."""
    rows, columns = np.nonzero(~np.isfinite(np.asarray(numbers)))
    if not rows.size:
        return np.inf  # a texel that nothing shows was not read
    is_near = (np.abs(rows - y) < reach) & (np.abs(columns - x) < reach)
    return float(np.sum(~is_near))


def spread_in_pixels(read, reach, rng, dtype, draws=40):
    """Most pixels that are no number beyond those that read one texel that is none."""
    read = jax.jit(read)
    return max(
        beyond(read(*given), BLOCK / 2 - dx, BLOCK / 2 - dy, reach)
        for given, dx, dy in pictures_with_a_bad_texel(rng, dtype, draws)
    )


def spread_in_slopes(read, reach, rng, dtype, draws=40):
    """The same of texels, in the slope of a mean, beyond what those pixels read."""
    mean = lambda picture, dx, dy: jnp.mean(read(picture, dx, dy) ** 2)
    slope, middle = jax.jit(jax.grad(mean)), BLOCK / 2 + RIM
    return max(
        beyond(slope(*given)[..., 0], middle, middle, reach)
        for given, *_ in pictures_with_a_bad_texel(rng, dtype, draws)
    )


def pictures_with_a_bad_texel(rng, dtype, draws):
    size = BLOCK + 2 * RIM
    for n in range(draws):
        dx, dy = rng.uniform(-2.2, 2.2, 2).tolist() if n else (0.0, 0.0)
        for bad in (np.nan, np.inf):
            picture = rng.random((size, size, 1))
            picture[size // 2, size // 2] = bad
            yield cast((picture, dx, dy), dtype), dx, dy


@every_dtype
@pytest.mark.parametrize("name", READS)
def test_a_bad_texel_reaches_the_pixels_that_read_it(name, dtype, rng):
    read, of_pixels, of_texels = READS[name]
    assert spread_in_pixels(read, of_pixels, rng, dtype) == 0
    assert spread_in_slopes(read, of_texels, rng, dtype) == 0


@pytest.mark.parametrize("spread", [spread_in_pixels, spread_in_slopes])
def test_one_that_spreads_is_noticed(spread, rng):
    spreads = lambda picture, dx, dy: (
        by_gathers(picture, dx, dy) + 0 * jnp.mean(picture)
    )
    assert spread(spreads, 4.0, rng, "float32", 3) > 50
    # So is a reach that is too small for what is read.
    assert spread(by_gathers, 0.4, rng, "float32", 6) > 0


@of_techniques
def test_a_history_that_is_masked_out_has_no_say(name, rng):
    camera = Camera(5, 4, 96.0, 60.0)
    color = jnp.asarray(rng.random((1, 3, 4, 5)), "float32")
    none = jnp.full((3, 4, 5), jnp.nan, "float32")

    @jax.jit
    @jax.value_and_grad
    def brightness(arguments):
        technique, camera, increment = arguments
        mask = jnp.zeros((4, 5), bool)
        frame = Frame(color, camera, Region.whole(camera), mask, Reading("plain"))
        motion = Motion(increment, increment)
        return jnp.mean(technique.step(History.of(none), frame, motion)[1] ** 2)

    increment = 1e-2 * rng.normal(size=3)
    for technique in techniques()[name]:
        given = cast((technique, camera, increment), "float32")
        assert bad_leaves(brightness(given)) == 0


@of_techniques
def test_a_bad_texel_reaches_two_texels_of_a_steps_slopes(name, rng):
    camera = Camera(BLOCK, BLOCK, 8.0, 60.0)
    technique = cast(techniques()[name][0], "float32")

    @jax.jit
    def by_pictures(pictures, increment):
        def brightness(color, past):
            region, reading = Region.whole(camera), Reading("plain")
            frame = Frame(color[None], camera, region, None, reading)
            motion = Motion(increment, increment)
            return jnp.mean(technique.step(History.of(past), frame, motion)[1] ** 2)

        return jax.grad(brightness, (0, 1))(*pictures)

    for n in range(4):
        pictures = rng.random((2, 3, BLOCK, BLOCK))
        pictures[n // 2, 1, BLOCK // 2, BLOCK // 2] = (np.nan, np.inf)[n % 2]
        # Less than a pixel: 1 px is 0.7 deg here.
        increment = rng.uniform(-5e-3, 5e-3, 3)
        for slope in by_pictures(*cast((pictures, increment), "float32")):
            of_texels = jnp.sum(slope, axis=0)
            assert beyond(of_texels, BLOCK / 2, BLOCK / 2, 2.0) == 0
