"""Spaces of curves: every point is a technique within the bounds."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hmdjit.curve_fitting.space import FAMILIES, LOCALIZATIONS, CurveSpace
from hmdjit.curves import Cosine, Spline
from hmdjit.techniques import HeadMovement

SPACES = [
    CurveSpace(family, samples, localization)
    for family, samples, localization in itertools.product(
        FAMILIES, (1, 3), LOCALIZATIONS
    )
]


def named(space, point):
    return dict(
        zip(space.names, np.asarray(space.natural(point)).tolist(), strict=True)
    )


@pytest.mark.parametrize("space", SPACES, ids=str)
@settings(max_examples=12)  # of each of twelve spaces
@given(seed=st.integers(0, 2**31), scale=st.floats(0.01, 30))
def test_every_point_is_within_the_bounds(space, seed, scale):
    point = jnp.asarray(np.random.default_rng(seed).normal(size=space.size) * scale)
    technique = jax.tree.map(float, space.technique(point))  # the checks are its own
    assert 0 <= technique.w_lb <= technique.w_min <= 1
    assert technique.h_max_deg_s > 0
    assert list(technique.closeness) == sorted(technique.closeness)
    numbers = named(space, point)
    for kind in ("weights", "ease.increments", "localization.increments"):
        mine = [value for name, value in numbers.items() if name.startswith(kind)]
        assert not mine or sum(mine) == pytest.approx(1, abs=1e-9)
        assert kind != "weights" or mine == sorted(mine)


@pytest.mark.parametrize("space", SPACES, ids=str)
def test_a_technique_of_the_space_is_found_again(space):
    rng = np.random.default_rng(3)
    point = jnp.asarray(rng.normal(size=space.size))
    technique = jax.tree.map(float, space.technique(point))
    np.testing.assert_allclose(space.near(technique), point, atol=1e-9)


@pytest.mark.parametrize("space", SPACES, ids=str)
def test_a_search_begins_at_kims_constants(space):
    numbers = named(space, space.starts()[0])
    assert numbers["w_min"] == pytest.approx(0.3)
    assert numbers["w_lb"] == pytest.approx(0.1)
    assert numbers["h_max_deg_s"] == pytest.approx(25)
    technique = space.technique(space.starts()[0])
    weights = technique.weights or (1.0,)
    mean = np.average(technique.closeness, weights=weights)
    assert mean == pytest.approx(2 / 3, abs=0.06)  # weights rise with closeness
    share = jnp.linspace(0, 1, 30)
    if space.family == "power":
        assert technique.ease == Cosine(technique.ease.exponent)
        assert float(technique.ease.exponent) == pytest.approx(2)
    np.testing.assert_allclose(
        technique.ease(share), HeadMovement().ease(share), atol=0.01
    )
    np.testing.assert_allclose(technique.localization(share), share, atol=0.01)


def test_techniques_at_their_bounds_are_approached():
    space = CurveSpace("power", 2)
    extreme = HeadMovement(0.0, 0.0, 1e-3, (0.0, 1.0), ease=Cosine(0.5))
    numbers = named(space, space.near(extreme))
    assert numbers["w_min"] < 2e-3
    assert numbers["closeness[0]"] < 2e-3
    assert numbers["closeness[1]"] > 0.99
    assert numbers["ease.exponent"] < 0.502
    one = HeadMovement(1.0, 1.0, 25.0, (1.0,), ease=Spline((1, 0, 0)))
    assert np.isfinite(CurveSpace("spline").near(one)).all()


def test_no_past_at_all_is_approached():
    # Closeness of 0 throughout has no ratios: the weights were 0 / 0.
    for closeness in ((0.0,), (0.0, 0.0)):
        space = CurveSpace(samples=2)
        numbers = named(space, space.near(HeadMovement(closeness=closeness)))
        assert numbers["weights[0]"] == pytest.approx(0.5, abs=2e-3)
        assert numbers["closeness[1]"] < 3e-3


@pytest.mark.parametrize("space", SPACES, ids=str)
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_coordinates_count_no_farther_than_documented(space, dtype):
    at = lambda place: jnp.full(space.size, place, dtype)
    for sign in (1.0, -1.0):
        expected = space.natural(at(sign * 46.0))
        # In float32 exp(700) is infinite; a softmax of inf is NaN in any precision.
        for far in (np.inf, 700.0):
            np.testing.assert_array_equal(space.natural(at(sign * far)), expected)
        assert space.concrete(at(sign * np.inf)).h_max_deg_s > 0


def test_a_closeness_far_below_1_keeps_its_digits():
    # 1 - (1 - d) is 0 for d below 1e-16.
    found = CurveSpace(samples=2).natural(jnp.asarray([0.0, 0, 0, -40.0, -40.0, 0]))
    np.testing.assert_allclose(found[3:5], np.exp(-40) * np.array([1, 2]), rtol=1e-14)


@pytest.mark.slow
def test_slopes_of_natural_numbers_are_those_of_differences():
    for space in (CurveSpace("power", 3, "spline"), CurveSpace("spline")):
        point = jnp.asarray(np.random.default_rng(4).normal(size=space.size))
        slopes = jax.jacfwd(space.natural)(point)
        step = 1e-6 * np.eye(space.size)
        differences = [
            (space.natural(point + s) - space.natural(point - s)) / 2e-6 for s in step
        ]
        np.testing.assert_allclose(
            slopes, np.stack(differences, 1), rtol=1e-6, atol=1e-8
        )


def test_wrong_spaces_are_refused():
    with pytest.raises(ValueError, match="samples must lie in"):
        CurveSpace(samples=5)
    with pytest.raises(ValueError, match=r"family must be one of .*'power'"):
        CurveSpace("powr")
    with pytest.raises(ValueError, match="samples must be at least the technique's 2"):
        CurveSpace().near(HeadMovement(closeness=(0.1, 0.5)))
