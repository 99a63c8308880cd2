import colour
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hmdjit as hj
from hmdjit.metrics import ciede2000, lab

# Sharma, Wu and Dalal (2005), table 1: L1 a1 b1, L2 a2 b2, CIEDE2000.
SHARMA = np.fromstring(
    """
    50.0000 2.6772 -79.7751 50.0000 0.0000 -82.7485 2.0425
    50.0000 3.1571 -77.2803 50.0000 0.0000 -82.7485 2.8615
    50.0000 2.8361 -74.0200 50.0000 0.0000 -82.7485 3.4412
    50.0000 -1.3802 -84.2814 50.0000 0.0000 -82.7485 1.0000
    50.0000 -1.1848 -84.8006 50.0000 0.0000 -82.7485 1.0000
    50.0000 -0.9009 -85.5211 50.0000 0.0000 -82.7485 1.0000
    50.0000 0.0000 0.0000 50.0000 -1.0000 2.0000 2.3669
    50.0000 -1.0000 2.0000 50.0000 0.0000 0.0000 2.3669
    50.0000 2.4900 -0.0010 50.0000 -2.4900 0.0009 7.1792
    50.0000 2.4900 -0.0010 50.0000 -2.4900 0.0010 7.1792
    50.0000 2.4900 -0.0010 50.0000 -2.4900 0.0011 7.2195
    50.0000 2.4900 -0.0010 50.0000 -2.4900 0.0012 7.2195
    50.0000 -0.0010 2.4900 50.0000 0.0009 -2.4900 4.8045
    50.0000 -0.0010 2.4900 50.0000 0.0010 -2.4900 4.8045
    50.0000 -0.0010 2.4900 50.0000 0.0011 -2.4900 4.7461
    50.0000 2.5000 0.0000 50.0000 0.0000 -2.5000 4.3065
    50.0000 2.5000 0.0000 73.0000 25.0000 -18.0000 27.1492
    50.0000 2.5000 0.0000 61.0000 -5.0000 29.0000 22.8977
    50.0000 2.5000 0.0000 56.0000 -27.0000 -3.0000 31.9030
    50.0000 2.5000 0.0000 58.0000 24.0000 15.0000 19.4535
    50.0000 2.5000 0.0000 50.0000 3.1736 0.5854 1.0000
    50.0000 2.5000 0.0000 50.0000 3.2972 0.0000 1.0000
    50.0000 2.5000 0.0000 50.0000 1.8634 0.5757 1.0000
    50.0000 2.5000 0.0000 50.0000 3.2592 0.3350 1.0000
    60.2574 -34.0099 36.2677 60.4626 -34.1751 39.4387 1.2644
    63.0109 -31.0961 -5.8663 62.8187 -29.7946 -4.0864 1.2630
    61.2901 3.7196 -5.3901 61.4292 2.2480 -4.9620 1.8731
    35.0831 -44.1164 3.7933 35.0232 -40.0716 1.5901 1.8645
    22.7233 20.0904 -46.6940 23.0331 14.9730 -42.5619 2.0373
    36.4612 47.8580 18.3852 36.2715 50.5065 21.2231 1.4146
    90.8027 -2.0831 1.4410 91.1528 -1.6435 0.0447 1.4441
    90.9257 -0.5406 -0.9208 88.6381 -0.8985 -0.7239 1.5381
    6.7747 -0.2908 -2.4247 5.8714 -0.0985 -2.2286 0.6377
    2.0776 0.0795 -1.1350 0.9033 -0.0636 -0.5514 0.9082
    """,
    sep=" ",
).reshape(34, 7)
MATRIX = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)
SHARMA_LAB = SHARMA[:, :3], SHARMA[:, 3:6]


def colour_decoded(gamma):
    curve = ((gamma + 0.055) / 1.055) ** 2.4
    return np.where(gamma <= 0.04045, gamma / 12.92, curve)


def lab_pairs(rng, count=4000):
    """Random pairs, far and near; all hues, greys among them."""
    one = rng.uniform([0, -100, -100], [100, 100, 100], (count, 3))
    near = one + rng.normal(0, 3, one.shape)
    other = np.where(rng.random((count, 1)) < 0.5, near, rng.permutation(one))
    other[::50, 1:] = 0
    one[25::50, 1:] = 0
    other[:, 0] = np.clip(other[:, 0], 0, 100)
    return one, other


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_ciede2000_agrees_with_the_published_pairs(dtype):
    one, other = (jnp.asarray(values, dtype) for values in SHARMA_LAB)
    for pair in [(one, other), (other, one)]:
        found = ciede2000(*pair)
        assert found.dtype == dtype
        np.testing.assert_allclose(found, SHARMA[:, 6], rtol=0, atol=8e-5)


def test_ciede2000_agrees_with_colour_science(rng):
    one, other = lab_pairs(rng)
    one, other = (np.concatenate(p) for p in zip((one, other), SHARMA_LAB, strict=True))
    oracle = colour.delta_E(one, other, method="CIE 2000")
    np.testing.assert_allclose(ciede2000(one, other), oracle, rtol=0, atol=1e-10)
    np.testing.assert_allclose(ciede2000(other, one), oracle, rtol=0, atol=1e-10)
    one, other = one.astype(np.float32), other.astype(np.float32)
    oracle = colour.delta_E(*(x.astype(float) for x in (one, other)), method="CIE 2000")
    np.testing.assert_allclose(ciede2000(one, other), oracle, rtol=1e-6, atol=1e-5)


def test_equal_colours_do_not_differ_and_have_no_gradient(rng):
    one, _ = lab_pairs(rng, 100)
    one = jnp.asarray(np.concatenate([one, [[50, 0, 0], [0, 0, 0], [100, 0, 0]]]))
    np.testing.assert_array_equal(ciede2000(one, one), 0)
    for slope in jax.grad(lambda *x: ciede2000(*x).sum(), (0, 1))(one, one):
        np.testing.assert_array_equal(slope, 0)


def test_gradients_are_those_of_differences_and_finite_at_grey(rng):
    one, other = lab_pairs(rng, 400)
    total = lambda x, y: ciede2000(x, y).sum()
    pair = jnp.asarray(one), jnp.asarray(other)
    slopes = jax.grad(total, (0, 1))(*pair)
    assert all(np.isfinite(slope).all() for slope in slopes)
    # Differences straddle no grey, nor hues that are opposite.
    hue = [np.arctan2(x[:, 2], x[:, 1]) for x in (one, other)]
    from_opposite = np.abs(np.abs(hue[0] - hue[1]) - np.pi)
    chroma = [np.hypot(x[:, 1], x[:, 2]) for x in (one, other)]
    inner = [(x[:, 0] > 1) & (x[:, 0] < 99) for x in (one, other)]
    is_smooth = (np.minimum(*chroma) > 1e-2) & (from_opposite > 0.01)
    is_smooth &= inner[0] & inner[1] & (np.minimum(*np.abs(hue)) > 1e-3)
    assert is_smooth.sum() > 200
    # Symmetric: the other's slope is the same function of the pair in turn.
    turned = jax.grad(total)(*pair[::-1])
    np.testing.assert_allclose(slopes[1], turned, rtol=0, atol=1e-14)
    for axis in range(3):
        shift = 1e-5 * np.eye(3)[axis]
        difference = ciede2000(one + shift, other) - ciede2000(one - shift, other)
        np.testing.assert_allclose(
            slopes[0][is_smooth, axis], difference[is_smooth] / 2e-5, 1e-5, 1e-6
        )


def test_lab_agrees_with_colour_science(rng):
    colors = np.concatenate([rng.random((500, 3)), np.eye(3), np.zeros((1, 3))])
    white = colour.XYZ_to_xy(MATRIX @ np.ones(3))
    for space, linear in [("linear", colors), ("gamma", colour_decoded(colors))]:
        oracle = colour.XYZ_to_Lab(linear @ MATRIX.T, white)
        # Colour-science's white is (x, y) at Y = 1, as is that of the matrix.
        np.testing.assert_allclose(lab(colors, space=space), oracle, rtol=0, atol=1e-10)
        single = lab(colors.astype(np.float32), space=space)
        assert single.dtype == jnp.float32
        np.testing.assert_allclose(single, oracle, rtol=0, atol=1e-4)


def test_lab_of_greys_has_no_chroma_and_of_codes_is_that_of_colours():
    greys = np.repeat(np.arange(256, dtype=np.uint8)[:, None], 3, axis=1)
    found = lab(greys)
    np.testing.assert_allclose(found[:, 1:], 0, atol=1e-12)
    np.testing.assert_allclose(found[[0, 255], 0], [0, 100], atol=1e-12)
    np.testing.assert_allclose(lab(greys / 255), found, rtol=0, atol=1e-12)


def test_wrong_colours_are_refused():
    good = np.zeros((4, 3))
    for wrong, message in [
        (np.zeros((4, 2)), r"must have the shape \(\.\.\., 3\), got \(4, 2\)"),
        (np.zeros((4, 3), int), "must be"),
        (np.full((4, 3), 200.0), r"must (have L\* in \[0, 100\]|lie in \[0, 1\])"),
    ]:
        with pytest.raises(ValueError, match=message):
            ciede2000(wrong, wrong)
        with pytest.raises(ValueError, match=message):
            lab(wrong)
    with pytest.raises(ValueError, match=r"one shape, got \(4, 3\) and \(2, 3\)"):
        ciede2000(good, good[:2])
    with pytest.raises(ValueError, match="space must be one of gamma, linear"):
        lab(good, space="srgb")
    assert hj.metrics.ciede2000(good[0], good[0]).shape == ()


def test_pictures_differ_as_their_lab_values_do(rng):
    test, reference = rng.integers(0, 256, (2, 7, 5, 3), dtype=np.uint8)
    white = colour.XYZ_to_xy(MATRIX @ np.ones(3))
    pair = [
        colour.XYZ_to_Lab(colour_decoded(picture / 255) @ MATRIX.T, white)
        for picture in (test, reference)
    ]
    oracle = colour.delta_E(*pair, method="CIE 2000")
    found = hj.metrics.ciede2000_map(test, reference)
    assert found.shape == (7, 5)
    np.testing.assert_allclose(found, oracle, rtol=0, atol=1e-10)
    mean = hj.metrics.mean_ciede2000(test.astype(float), reference.astype(float))
    np.testing.assert_allclose(mean, oracle.mean(), rtol=0, atol=1e-10)
    mean = hj.metrics.mean_ciede2000(test / 255, reference / 255, peak=1.0)
    np.testing.assert_allclose(mean, oracle.mean(), rtol=0, atol=1e-10)
    with pytest.raises(ValueError, match="peak must be named"):
        hj.metrics.ciede2000_map(test / 255, reference / 255)


def test_gradients_of_pictures_are_finite_at_black_white_grey_and_equal_ones():
    levels = np.array([0, 1e-3, 8, 128, 255], np.float32)
    test = np.broadcast_to(levels[:, None, None], (5, 5, 3))
    reference = np.swapaxes(test, 0, 1).copy()
    slope = jax.jit(jax.grad(hj.metrics.mean_ciede2000, (0, 1)))
    for value in slope(jnp.asarray(test), jnp.asarray(reference)):
        assert np.isfinite(value).all()
        assert value.dtype == np.float32
