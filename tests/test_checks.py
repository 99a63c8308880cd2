import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hmdjit as hj
from hmdjit import _checks


@pytest.mark.parametrize("value", [0.0, 0.5, 1, np.float32(0.25), jnp.asarray(0.75)])
def test_in_range_accepts_every_kind_of_number(value):
    _checks.in_range("share", value, 0, 1)


@pytest.mark.parametrize("value", [-0.1, 1.1, np.nan, np.inf, -np.inf])
def test_in_range_refuses_what_is_outside_or_not_finite(value):
    with pytest.raises(ValueError, match=r"share must lie in \[0, 1\], got"):
        _checks.in_range("share", value, 0, 1)


def test_in_range_refuses_a_concrete_array():
    with pytest.raises(ValueError, match=r"share must lie in \[0, 1\], got 2\."):
        _checks.in_range("share", jnp.asarray(2.0), 0, 1)


@pytest.mark.parametrize(
    ("value", "ends", "interval"),
    [
        (0.0, {"open_low": True}, r"\(0, 1\]"),
        (1.0, {"open_high": True}, r"\[0, 1\)"),
    ],
)
def test_in_range_refuses_an_open_end_and_names_it(value, ends, interval):
    with pytest.raises(ValueError, match=f"share must lie in {interval}, got"):
        _checks.in_range("share", value, 0, 1, **ends)


def test_in_range_writes_an_infinite_end_as_open():
    with pytest.raises(ValueError, match=r"\[0, inf\), got -1\."):
        _checks.in_range("rate_hz", -1.0, 0)
    with pytest.raises(ValueError, match=r"\(-inf, inf\), got nan\."):
        _checks.in_range("angle", np.nan)


@pytest.mark.parametrize(
    ("value", "written"),
    [
        (29.97, "29.97"),
        (30.000001, "30.000001"),
        (np.float32(30.1), "30.1"),
        (30.0, "30"),
        (29.999999999999996, "29.999999999999996"),
    ],
)
def test_a_number_is_told_from_the_bound_that_it_misses(value, written):
    assert _checks.apart(value, 30.0, spec="3g") == written


def test_in_range_tells_a_value_from_its_bound():
    with pytest.raises(ValueError, match=r"\[0, 1\], got 1\.0000001\."):
        _checks.in_range("share", 1.0000001, 0, 1)
    assert _checks.apart(29.96, 30, spec="1f") == "29.96"


def test_in_range_lets_values_that_are_not_known_yet_pass():
    @jax.jit
    def doubled(share):
        _checks.in_range("share", share, 0, 1)
        return 2 * share

    assert doubled(5.0) == 10.0


def test_colours_under_a_mask_are_refused():
    clip = np.ma.masked_greater(np.zeros((2, 4, 4, 3)), 0.5)
    picture = clip[0]
    for take in (
        lambda: hj.metrics.mtcd(clip),
        lambda: hj.metrics.Streamed(hj.metrics.MTCD()).add(picture),
        lambda: hj.scenes.Photograph.of(picture),
        lambda: hj.Texture.of(picture, picture, 1, 0),
    ):
        with pytest.raises(ValueError, match=r"^\w+ must not be masked: say what"):
            take()


@pytest.mark.parametrize("value", [1, 7, np.int64(3)])
def test_whole_accepts_whole_numbers(value):
    _checks.whole("frames", value, 1)


@pytest.mark.parametrize("value", [0, -1, 1.5, 2.0, np.nan, True, "2", None])
def test_whole_refuses_the_rest(value):
    with pytest.raises(ValueError, match="frames must be a whole number >= 1, got"):
        _checks.whole("frames", value, 1)


def test_one_of_suggests_the_nearest():
    _checks.one_of("space", "gamma", ["gamma", "linear"])
    with pytest.raises(ValueError, match=r"gamma, linear, got 'gama'.*'gamma'"):
        _checks.one_of("space", "gama", ["gamma", "linear"])
    with pytest.raises(ValueError, match=r"got 'xyzzy'\.$"):
        _checks.one_of("space", "xyzzy", iter(["gamma", "linear"]))


def test_number_keeps_python_numbers_weakly_typed():
    assert type(_checks.number(np.float32(0.5))) is float
    assert type(_checks.number(1)) is float
    kept = jnp.asarray(0.5, jnp.float32)
    assert _checks.number(kept) is kept


def test_is_traced_tells_known_from_unknown():
    seen = []
    jax.jit(lambda x: seen.append(_checks.is_traced(x)))(1.0)
    assert seen == [True]
    assert not _checks.is_traced(jnp.asarray(1.0))
