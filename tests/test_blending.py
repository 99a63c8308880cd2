import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest

from hmdjit import blending, curves

SIZE = (3, 5, 4)
DTYPES = [np.float32, np.float64]


def eps(dtype):
    return float(np.finfo(dtype).eps)


def pictures(rng, dtype=float, count=2):
    return [jnp.asarray(rng.random(SIZE).astype(dtype)) for _ in range(count)]


# --- speed: equation (4) ---

# At 60 Hz and h_max = 25 deg/s: head speed, weight of the current picture.
WEIGHT_AT_SPEED = {
    0.0: 0.300,
    5.0: 0.306,
    10.0: 0.384,
    12.5: 0.475,
    15.0: 0.600,
    20.0: 0.873,
    25.0: 1.0,
    400.0: 1.0,
}


@pytest.mark.parametrize(("speed", "expected"), WEIGHT_AT_SPEED.items())
def test_weight_at_equal_colours_is_the_tabled_one(speed, expected):
    minimum = blending.localized_minimum(0.3, 0.1, jnp.zeros(()))
    weight = blending.current_weight(minimum, blending.ease(speed, 25.0))
    assert weight == pytest.approx(expected, abs=5e-4)  # three printed digits


def test_ease_agrees_with_the_printed_form(rng):
    for h_max in (1.0, 25.0, 60.0):
        speeds = rng.uniform(0, 2 * h_max, 100)
        ours = blending.ease(jnp.asarray(speeds), h_max)
        expected = [oracles.kim_ease(speed, h_max) for speed in speeds]
        # The printed form cancels near rest: absolute.
        np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("dtype", DTYPES)
def test_ease_keeps_its_digits_near_rest(dtype):
    speed = jnp.asarray(1e-4, dtype)
    expected = (np.pi / 2 * 1e-4 / 25) ** 4
    assert blending.ease(speed, 25.0) == pytest.approx(expected, rel=8 * eps(dtype))


@pytest.mark.parametrize("dtype", DTYPES)
def test_ease_is_exactly_0_at_rest_and_1_from_h_max_on(dtype):
    speeds = jnp.asarray([0.0, 25.0, 25.1, 1e4], dtype)
    np.testing.assert_array_equal(blending.ease(speeds, 25.0), [0, 1, 1, 1])


def test_ease_rises_with_speed():
    curve = blending.ease(jnp.linspace(0.0, 25.0, 500), 25.0)
    assert (jnp.diff(curve) > 0).all()


@pytest.mark.parametrize("dtype", DTYPES)
def test_by_default_ease_and_localisation_are_kims(rng, dtype):
    speed, difference = (jnp.asarray(rng.random(1000).astype(dtype)) for _ in "hd")
    share = jnp.minimum(40 * speed, 25.0) / 25.0
    ours = blending.ease(40 * speed, 25.0)
    expected = jnp.sin(jnp.pi / 2 * share) ** 4
    np.testing.assert_allclose(ours, expected, rtol=16 * float(jnp.finfo(dtype).eps))
    ours = blending.localized_minimum(0.3, 0.1, difference)
    np.testing.assert_array_equal(ours, 0.3 - (0.3 - 0.1) * difference)


def test_other_curves_take_the_place_of_kims():
    spline = curves.Spline((1.0, 0.0, 1.0))
    speeds = jnp.asarray([0.0, 6.25, 12.5, 18.75, 25.0, 400.0])
    # The slope falls from 2 to 0 and rises again.
    expected = [0, 0.375, 0.5, 0.625, 1, 1]
    np.testing.assert_allclose(blending.ease(speeds, 25.0, spline), expected)
    ours = blending.localized_minimum(0.3, 0.1, speeds[:5] / 25, spline)
    np.testing.assert_allclose(ours, 0.3 - 0.2 * np.array(expected[:5]))


@pytest.mark.parametrize("h_max", [1e-30, 1e-25, 1e-6, 25.0, 1e25])
def test_ease_has_its_gradient_at_every_h_max(h_max):
    # JAX's own slope of a quotient is 0 x h_max^-2, infinite below 1e-19 in float32.
    top = np.float32(h_max)
    slopes = jax.grad(blending.ease, (0, 1))
    below, above = np.nextafter(top, np.float32(0)), np.nextafter(top, np.float32(1e38))
    for speed in (np.float32(0), below, top, above):
        found = slopes(jnp.asarray(speed), jnp.asarray(top))
        assert np.isfinite(found).all()
        assert np.all(np.abs(found) * top < 1e-5)  # flat at both ends
    along, across = slopes(jnp.asarray(top / 2), jnp.asarray(top))
    np.testing.assert_allclose(along * top, np.pi / 2, rtol=1e-5)
    np.testing.assert_allclose(across * top, -np.pi / 4, rtol=1e-5)


def test_gradients_of_ease_are_finite_and_correct():
    gradient = jax.jit(jax.grad(lambda v: blending.ease(v[0], v[1])))
    for speed in (0.0, 3.0, 24.0, 40.0):
        at = np.array([speed, 25.0])
        ours = gradient(jnp.asarray(at))
        expected = oracles.jacobian(lambda v: oracles.kim_ease(abs(v[0]), v[1]), at)
        np.testing.assert_allclose(ours, expected, rtol=1e-7, atol=1e-9)


# --- localisation: equation (5) ---


@pytest.mark.parametrize("dtype", DTYPES)
def test_black_and_white_differ_most_whatever_the_measure(dtype):
    black, white = jnp.zeros(SIZE, dtype), jnp.ones(SIZE, dtype)
    for kind in ("euclidean", "max_channel"):
        difference = blending.color_difference(black, white, kind=kind)
        assert difference.dtype == dtype
        np.testing.assert_allclose(difference, 1.0, rtol=eps(dtype))
        assert (difference <= 1).all()


def test_color_difference_agrees_with_numpy(rng):
    a, b = pictures(rng)
    distance = np.linalg.norm(a - b, axis=0) / np.sqrt(3)
    ours = blending.color_difference(a, b)
    np.testing.assert_allclose(ours, distance, rtol=1e-14)
    ours = blending.color_difference(a, b, kind="max_channel")
    np.testing.assert_array_equal(ours, np.abs(a - b).max(axis=0))


def test_color_difference_of_equal_pictures_has_gradient_0(rng):
    (picture,) = pictures(rng, count=1)
    total = lambda a, b: blending.color_difference(a, b).sum()
    for gradient in jax.grad(total, argnums=(0, 1))(picture, picture):
        np.testing.assert_array_equal(gradient, np.zeros(SIZE))


def test_localized_minimum_falls_from_w_min_to_w_lb():
    difference = jnp.asarray([0.0, 0.5, 1.0])
    ours = blending.localized_minimum(0.3, 0.1, difference)
    np.testing.assert_allclose(ours, [0.3, 0.2, 0.1], rtol=1e-15)


@pytest.mark.parametrize("dtype", DTYPES)
def test_current_weight_is_exactly_1_at_full_speed_and_the_minimum_at_rest(rng, dtype):
    minimum = rng.random(1000).astype(dtype)
    full = blending.current_weight(jnp.asarray(minimum), jnp.ones((), dtype)[None])
    np.testing.assert_array_equal(full, np.ones(1000))
    rest = blending.current_weight(jnp.asarray(minimum), jnp.zeros((), dtype)[None])
    np.testing.assert_allclose(rest, minimum, rtol=0, atol=eps(dtype))


# --- past and present: equations (2) and (3) ---


def test_past_color_is_the_weighted_sum(rng):
    samples = pictures(rng, count=3)
    ours = blending.past_color(samples, [0.5, 0.3, 0.2])
    expected = np.einsum("s,schw->chw", [0.5, 0.3, 0.2], np.stack(samples))
    np.testing.assert_allclose(ours, expected, rtol=1e-14)
    alone = blending.past_color(samples[:1], [1.0])
    np.testing.assert_array_equal(alone, samples[0])


@pytest.mark.parametrize("dtype", DTYPES)
def test_past_color_of_equal_samples_is_exactly_theirs(rng, dtype):
    (sample,) = pictures(rng, dtype, count=1)
    weights = [jnp.asarray(w, dtype) for w in (0.1, 0.2, 0.7)]
    ours = blending.past_color([sample] * 3, weights)
    np.testing.assert_array_equal(ours, sample)


def test_blend_agrees_with_equation_3(rng):
    current, history = pictures(rng)
    weight = rng.random(SIZE[1:])
    ours = blending.blend(current, history, jnp.asarray(weight))
    expected = weight * np.asarray(current) + (1 - weight) * np.asarray(history)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=3e-16)


@pytest.mark.parametrize("dtype", DTYPES)
def test_blend_is_exactly_the_present_where_it_counts_fully_or_equals_the_past(
    rng, dtype
):
    current, history = pictures(rng, dtype)
    weight = jnp.asarray(rng.random(SIZE[1:]).astype(dtype))
    full = blending.blend(current, history, jnp.ones_like(weight))
    np.testing.assert_array_equal(full, current)
    equal = blending.blend(current, current, weight)
    np.testing.assert_array_equal(equal, current)


@pytest.mark.parametrize("poison", [np.nan, np.inf])
def test_what_is_not_blended_enters_neither_the_picture_nor_the_gradients(rng, poison):
    current, history = pictures(rng)
    inside = jnp.asarray(rng.random(SIZE[1:]) < 0.5)
    poisoned = jnp.where(inside[None], history, poison)

    def total(current, history, w_min):
        history = blending.usable(history, current, inside)
        difference = blending.color_difference(current, history)
        weight = blending.localized_minimum(w_min, 0.1, difference)
        return (blending.blend(current, history, weight) ** 2).sum()

    gradient = jax.jit(jax.value_and_grad(total, argnums=(0, 1, 2)))
    clean, dirty = (gradient(current, h, 0.3) for h in (history, poisoned))
    for expected, ours in zip(*map(jax.tree.leaves, (clean, dirty)), strict=True):
        np.testing.assert_array_equal(ours, expected)
