import colour
import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hmdjit import color

EVERY_BYTE = np.arange(256) / 255
# The standard rounds its constants: at the joint of its two pieces the encoding curve
# steps down by 2.8e-8.
JOINT = 3e-8
unit = st.floats(0.0, 1.0)

encode_slope = jax.jit(jax.vmap(jax.grad(color.encode)))
decode_slope = jax.jit(jax.vmap(jax.grad(color.decode)))


@given(unit)
def test_decode_inverts_encode(value):
    assert abs(color.decode(color.encode(jnp.asarray(value))) - value) <= JOINT


@given(unit)
def test_encode_inverts_decode(value):
    assert abs(color.encode(color.decode(jnp.asarray(value))) - value) <= JOINT


def test_curves_invert_each_other_at_their_joints():
    linear = jnp.linspace(0.00313, 0.003132, 2001)
    gamma = jnp.linspace(0.04044, 0.04046, 2001)
    np.testing.assert_allclose(color.decode(color.encode(linear)), linear, atol=JOINT)
    np.testing.assert_allclose(color.encode(color.decode(gamma)), gamma, atol=JOINT)


@given(unit, unit)
def test_curves_are_increasing(a, b):
    low, high = jnp.asarray(min(a, b)), jnp.asarray(max(a, b))
    assert color.encode(high) >= color.encode(low) - JOINT
    assert color.decode(high) >= color.decode(low)


def test_black_and_white_stay():
    for curve in (color.encode, color.decode):
        assert curve(jnp.asarray(0.0)) == 0
        np.testing.assert_allclose(curve(jnp.asarray(1.0)), 1.0, rtol=0, atol=1e-15)


def test_negative_values_stay_linear_and_nan_stays():
    np.testing.assert_allclose(color.encode(jnp.asarray(-0.1)), -1.292, rtol=1e-15)
    np.testing.assert_allclose(color.decode(jnp.asarray(-1.292)), -0.1, rtol=1e-15)
    for curve in (color.encode, color.decode):
        assert jnp.isnan(curve(jnp.asarray(jnp.nan)))


def test_curves_agree_with_the_standard_however_they_are_called(variant):
    values = jnp.asarray(EVERY_BYTE)
    encoded = variant(color.encode)(values)
    decoded = variant(color.decode)(values)
    np.testing.assert_allclose(encoded, oracles.srgb_encode(EVERY_BYTE), rtol=1e-14)
    np.testing.assert_allclose(decoded, oracles.srgb_decode(EVERY_BYTE), rtol=1e-14)


def test_curves_agree_with_colour_science():
    values = jnp.asarray(EVERY_BYTE)
    # It puts the decoding's joint at encode(0.0031308), 6e-8 from ours.
    np.testing.assert_allclose(
        color.encode(values), colour.cctf_encoding(EVERY_BYTE, "sRGB"), atol=JOINT
    )
    np.testing.assert_allclose(
        color.decode(values), colour.cctf_decoding(EVERY_BYTE, "sRGB"), atol=JOINT
    )


def test_curves_in_float32_are_right_to_a_ten_thousandth_of_a_code_value():
    values = jnp.asarray(EVERY_BYTE, jnp.float32)
    for curve in (color.encode, color.decode):
        assert curve(values).dtype == jnp.float32
        exact = np.asarray(curve(values.astype(jnp.float64)))
        np.testing.assert_allclose(curve(values), exact, rtol=0, atol=1e-4 / 255)


@pytest.mark.parametrize("height", [1, 4])
def test_luma_agrees_with_colour_science(rng, height):
    rgb = rng.random((3, height, 5))
    space = colour.RGB_COLOURSPACES["ITU-R BT.709"]
    oracle = np.einsum("c,chw->hw", space.matrix_RGB_to_XYZ[1], rgb)
    # BT.709 prints four digits; the exact matrix of its primaries has more.
    np.testing.assert_allclose(color.luma(jnp.asarray(rgb)), oracle, atol=5e-5)


def test_luma_of_grey_is_its_value_and_its_shape_is_free():
    assert color.luma(jnp.full(3, 0.25)).shape == ()
    np.testing.assert_allclose(color.luma(jnp.full(3, 0.25)), 0.25, rtol=1e-15)


def test_slopes_at_black_are_those_of_the_straight_line():
    black = jnp.zeros(1)
    np.testing.assert_array_equal(encode_slope(black), [12.92])
    np.testing.assert_allclose(decode_slope(black), [1 / 12.92], rtol=1e-15)


def test_slopes_agree_with_differences():
    # Away from the joints, which 1e-6 must not straddle.
    points = np.array([1e-4, 0.003, 0.0032, 0.02, 0.05, 0.3, 1.0])
    for slope, curve in [(encode_slope, color.encode), (decode_slope, color.decode)]:
        there = lambda x, f=curve: np.asarray(f(jnp.asarray(x)))
        differences = (there(points + 1e-6) - there(points - 1e-6)) / 2e-6
        np.testing.assert_allclose(slope(jnp.asarray(points)), differences, rtol=1e-6)


@pytest.mark.parametrize("function", [color.encode, color.decode])
def test_codes_are_no_colours(function):
    with pytest.raises(ValueError, match="must be floating, got uint8"):
        function(jnp.zeros((3, 2, 2), jnp.uint8))
