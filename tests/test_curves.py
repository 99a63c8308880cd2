import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jax.flatten_util import ravel_pytree
from scipy.interpolate import BSpline

from hmdjit import curves
from hmdjit.curves import Cosine, Kim, Linear, Spline

SHARE = np.linspace(0, 1, 1001)
CURVES = {
    "linear": Linear(),
    "kim": Kim(),
    "quarter sine": Cosine(0.5),
    "cosine": Cosine(1.3),
    "late": Cosine(9.0),
    "spline": Spline((0.5, 0.0, 2.0, 1.0, 0.7)),
    "first": Spline((1.0, 0.0, 0.0)),
    "last": Spline((0.0, 0.0, 0.0, 3.0)),
}
DTYPES = [np.float32, np.float64]
every_curve = pytest.mark.parametrize("curve", CURVES.values(), ids=CURVES)
increments = st.lists(st.floats(0, 1e3), min_size=3, max_size=9).filter(
    lambda values: sum(values) > 1e-3
)


def heights(curve, share: np.ndarray | float = SHARE):
    return np.asarray(curve(jnp.asarray(share)))


def i_splines(count, share):
    """Ramsay's basis, `(count, shares)`: integrals of B-splines scaled to area 1."""
    inner = np.linspace(0, 1, count)
    knots = np.concatenate([[0.0], inner, [1.0]])
    basis = []
    for i in range(count):
        b_spline = BSpline.basis_element(knots[i : i + 3], extrapolate=False)
        edges = np.union1d(share, inner)
        middle, width = (edges[1:] + edges[:-1]) / 2, np.diff(edges)
        # A linear function's mean over an interval is its value in the middle.
        pieces = np.nan_to_num(b_spline(middle)) * width
        integral = np.concatenate([[0.0], np.cumsum(pieces)])
        basis.append(np.interp(share, edges, integral / integral[-1]))
    return np.stack(basis)


# --- all curves ---


@every_curve
@pytest.mark.parametrize("dtype", DTYPES)
def test_curves_rise_from_exactly_0_to_exactly_1(curve, dtype, variant):
    found = variant(curve)(jnp.asarray(SHARE.astype(dtype)))
    assert found.dtype == dtype
    assert (found[0], found[-1]) == (0, 1)
    # Rounding of a value near 1 may be off by a few of its last places.
    assert (np.diff(found) >= -8 * np.finfo(dtype).eps).all()


@every_curve
def test_the_steepest_slope_is_a_bound_and_no_loose_one(curve):
    slopes = np.diff(heights(curve)) / np.diff(SHARE)
    assert isinstance(curve.steepest, float)
    assert slopes.max() <= curve.steepest * (1 + 1e-12)
    assert slopes.max() >= 0.98 * curve.steepest


@every_curve
def test_gradients_are_finite_and_correct_also_at_the_ends(curve):
    # Under jit the numbers are traced.
    slope = jax.jit(lambda c, s: jax.grad(lambda s: c(s))(s))
    numbers, curve_of = ravel_pytree(curve)
    of_numbers = jax.jit(jax.grad(lambda n, s: curve_of(n)(s)))
    step = 1e-6
    for share in (0.0, 0.3, 0.5, 1.0):  # 0.5 is a knot
        low, high = max(share - step, 0.0), min(share + step, 1.0)
        exact = (heights(curve, high) - heights(curve, low)) / (high - low)
        assert slope(curve, share) == pytest.approx(exact, rel=1e-4, abs=2e-4)
        if numbers.size:
            at = lambda n, s=share: heights(curve_of(jnp.asarray(n)), s)
            np.testing.assert_allclose(
                of_numbers(numbers, share),
                # Off their lowest values, below which there is nothing.
                oracles.jacobian(at, numbers + 2 * step, step),
                rtol=1e-4,
                atol=1e-5,
            )


@every_curve
def test_float32_gradients_are_finite_at_the_ends(curve):
    narrow = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), curve)
    for share in (0.0, 1.0):
        both = jax.grad(lambda c, s: c(s), argnums=(0, 1))(narrow, jnp.float32(share))
        assert all(jnp.isfinite(leaf) for leaf in jax.tree.leaves(both))


@every_curve
def test_what_is_not_a_number_stays_one(curve):
    assert np.isnan(curve(jnp.asarray(np.nan)))


# --- families ---


@pytest.mark.parametrize("dtype", DTYPES)
def test_kims_curves_are_equations_4_and_5_to_the_bit(dtype):
    share = jnp.asarray(SHARE.astype(dtype))
    np.testing.assert_array_equal(Kim()(share), jnp.sin(jnp.pi / 2 * share) ** 4)
    np.testing.assert_array_equal(Linear()(share), share)


@given(st.floats(0.5, 20), st.floats(0, 1))
def test_cosine_agrees_with_the_printed_form(exponent, share):
    expected = ((1 - np.cos(np.pi * share)) / 2) ** exponent
    # The printed form cancels near 0, and its root steepens what is lost.
    assert Cosine(exponent)(share) == pytest.approx(expected, rel=1e-12, abs=1e-7)


def test_cosine_of_exponent_2_is_kims_curve():
    np.testing.assert_allclose(heights(Cosine()), heights(Kim()), rtol=1e-14)
    assert Kim().steepest == pytest.approx(np.pi * 0.75**1.5, rel=1e-15)


@pytest.mark.parametrize("count", [3, 4, 9])
def test_splines_agree_with_integrated_b_splines(rng, count):
    values = rng.random(count)
    share = rng.random(200)
    expected = values @ i_splines(count, share) / values.sum()
    np.testing.assert_allclose(
        heights(Spline(values), share), expected, rtol=0, atol=1e-13
    )


@given(increments, st.floats(0, 1), st.floats(0, 1))
def test_splines_do_not_fall_whatever_their_increments(values, one, other):
    low, high = sorted((one, other))
    below, above = (float(Spline(values)(share)) for share in (low, high))
    assert 0 <= below <= above + 1e-15
    assert above <= 1
    assert above - below <= Spline(values).steepest * (high - low) + 1e-14


@given(increments, st.floats(0.01, 100), st.floats(0, 1))
def test_only_ratios_of_increments_count(values, factor, share):
    scaled = Spline([factor * value for value in values])
    assert scaled(share) == pytest.approx(float(Spline(values)(share)), abs=1e-13)


def test_equal_steps_of_a_spline_have_a_continuous_slope(rng):
    spline = Spline(rng.random(5))
    slope = jax.vmap(jax.grad(spline))
    for knot in (0.25, 0.5, 0.75):
        before, at, after = slope(jnp.asarray([knot - 1e-9, knot, knot + 1e-9]))
        assert before == pytest.approx(float(at), abs=1e-7)
        assert after == pytest.approx(float(at), abs=1e-7)


# Largest distance over [0, 1], as measured; it falls by about 2^3 per halved interval.
@pytest.mark.parametrize(("count", "error"), [(5, 7e-3), (9, 9e-4), (17, 9e-5)])
def test_splines_come_as_near_to_kims_ease_as_their_intervals_are_short(count, error):
    like = Spline.like(Kim(), count)
    assert len(like.increments) == count
    assert np.abs(heights(like) - heights(Kim())).max() < error


def test_a_spline_like_a_spline_is_the_same_one(rng):
    values = rng.random(6)
    like = Spline.like(Spline(values), 6)
    np.testing.assert_allclose(jax.tree.leaves(like), values / values.sum())
    # The straight line has a constant slope: its ends rise by half as much.
    line = jax.tree.leaves(Spline.like(Linear(), 5))
    np.testing.assert_allclose(line, [0.125, 0.25, 0.25, 0.25, 0.125])


def test_one_program_serves_a_family(rng):
    traces = []

    @jax.jit
    def height(curve, share):
        traces.append(curve)
        return curve(share)

    for exponent in (0.5, 1.0, 3.0):
        height(Cosine(exponent), 0.3)
    for _ in range(3):
        height(Spline(rng.random(4)), 0.3)
    assert len(traces) == 2


# --- what is refused ---


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Cosine(0.4), r"^exponent must lie in \[0.5, inf\), got 0.4.$"),
        (lambda: Cosine(np.nan), r"^exponent must lie in \[0.5, inf\), got nan.$"),
        (lambda: Spline((1, 2)), "^increments must be at least 3 numbers, got 2.$"),
        (
            lambda: Spline((1, -1, 1)),
            r"^increments\[1\] must lie in \[0, inf\), got -1.$",
        ),
        (lambda: Spline((0, 0, 0)), "^increments must have a positive sum, got 0.$"),
        (lambda: Spline.like(Kim(), 2), "^count must be a whole number >= 3, got 2.$"),
    ],
)
def test_wrong_numbers_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_numbers_that_are_traced_pass():
    at = jax.jit(lambda e: (Cosine(e)(0.5), Spline((e, e, e))(0.5)))
    np.testing.assert_allclose(at(1.0), [0.5, 0.5], rtol=1e-15)
    assert issubclass(Spline, curves.AbstractCurve)
