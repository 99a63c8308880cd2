import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from small import quickly

from hmdjit.filters import neighborhood

SHIFTS = [(0, 0), (1, 0), (0, -1), (-2, 3), (9, 0), (-40, 40)]


def clamped(planes, dx, dy):
    height, width = planes.shape[-2:]
    rows = np.clip(np.arange(height) + dy, 0, height - 1)
    columns = np.clip(np.arange(width) + dx, 0, width - 1)
    return planes[..., rows[:, None], columns]


@pytest.mark.parametrize(("dx", "dy"), SHIFTS)
@pytest.mark.parametrize("shape", [(5, 7), (3, 5, 7)])
def test_shifts_clamp_to_the_edge(rng, shape, dx, dy):
    planes = rng.random(shape)
    at = neighborhood.around(jnp.asarray(planes), 40)
    np.testing.assert_array_equal(at(dx, dy), clamped(planes, dx, dy))


def test_the_mean_of_a_box_is_that_of_its_pixels(rng):
    planes = rng.random((3, 5, 7))
    places = [(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
    expected = np.mean([clamped(planes, *place) for place in places], axis=0)
    ours = neighborhood.box_mean(jnp.asarray(planes))
    np.testing.assert_allclose(ours, expected, rtol=1e-14)


@pytest.mark.parametrize("strength", [1 / 4, 1.0])
def test_sharpening_is_a_kernel_that_sums_to_one(rng, strength):
    point = np.zeros((5, 5))
    point[2, 2] = 1
    kernel = np.asarray(neighborhood.sharpened(jnp.asarray(point), strength))[
        1:-1, 1:-1
    ]
    side = -strength
    expected = [[0, side, 0], [side, 1 + 4 * strength, side], [0, side, 0]]
    np.testing.assert_array_equal(kernel, expected)
    assert kernel.sum() == 1
    # What bends nowhere stays, and so does one colour, at the border as well.
    y, x = np.mgrid[:6, :7] / 8
    ramp = jnp.asarray(0.1 + 0.25 * x + 0.5 * y)
    sharp = neighborhood.sharpened(ramp, strength)
    np.testing.assert_allclose(sharp[1:-1, 1:-1], ramp[1:-1, 1:-1], rtol=1e-14)
    color = jnp.full((3, 4, 4), rng.random())
    np.testing.assert_array_equal(neighborhood.sharpened(color, strength), color)


def test_neighborhoods_are_differentiable_in_batches_and_keep_their_floats(rng):
    planes = jnp.asarray(rng.random((2, 4, 5)))

    def all_of_them(planes):
        return neighborhood.sharpened(neighborhood.box_mean(planes), 0.25)

    check_grads(jax.jit(all_of_them), (planes,), order=1, modes=["rev"])
    batch = quickly(jax.vmap(all_of_them))(planes[:, None])
    np.testing.assert_allclose(batch[:, 0], jax.jit(all_of_them)(planes), rtol=1e-14)
    shape = jax.eval_shape(all_of_them, planes.astype(jnp.float32))
    assert shape.dtype == jnp.float32
