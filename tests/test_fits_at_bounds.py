"""Fits at the bounds of their searches and beyond: maps, refusals, whole fits."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from extremes import bad_leaves, cast
from heads import identifiable_within_bounds, traces_of

from hmdjit.curve_fitting.space import FAMILIES, LOCALIZATIONS, CurveSpace
from hmdjit.curves import Cosine, Spline
from hmdjit.envelope.arguments import COORDINATES
from hmdjit.head_fitting import fitting, whittle
from hmdjit.head_motion import Amplitude, HeadMotion, Resonator
from hmdjit.techniques import HeadMovement

# --- maps: how exact they are is in the envelope ---

BOTH = pytest.mark.parametrize("dtype", ["float32", "float64"])
RATES_HZ = (1.6, 30.0, 90.0, 1000.0)
SPACES = [
    CurveSpace(),
    *(CurveSpace(f, 4, kind) for f in FAMILIES for kind in LOCALIZATIONS),
]


def log_values(logits, log_bounds):
    one = jnp.ones(1, logits.dtype)
    power, leakage = (jnp.ones((1, 1, n), logits.dtype) for n in (3, 1))
    data = whittle.Data(
        power, one, leakage, jnp.zeros(1, int), one, one[0], log_bounds, one[0]
    )
    return whittle.log_values(whittle.Search(logits, one), data)


def with_slopes(function):
    by = (jax.jacfwd(function), jax.jacrev(function))
    return jax.jit(lambda *given: (function(*given), [slope(*given) for slope in by]))


def numbers_beyond_bounds(dtype):
    """How many numbers of a head lie beyond their bounds, or have no gradient."""
    anew = with_slopes(lambda *given: log_values(*given))
    bad = 0
    for rate_hz in RATES_HZ:
        log_bounds = jnp.asarray(whittle.log_bounds(2, rate_hz), dtype)
        for x in (*COORDINATES, *np.linspace(-30, 30, 6)):
            logits = jnp.full((log_bounds.shape[1], 3), x, dtype)
            found, slopes = anew(logits, log_bounds)
            low, high = log_bounds[..., None]
            bad += int(jnp.sum(~((found >= low) & (found <= high)))) + bad_leaves(
                slopes
            )
    return bad


@BOTH
def test_any_logit_is_a_number_within_its_bounds_with_a_gradient(dtype):
    assert numbers_beyond_bounds(dtype) == 0


def test_a_map_that_leaves_its_bounds_does_not_hold(monkeypatch):
    def plain(search, data):
        low, high = data.log_bounds[..., None]
        return low + (high - low) * jax.nn.sigmoid(search.logits)

    # In float64 low + (high - low) is 4e-16 above the largest wander's speed.
    monkeypatch.setattr(whittle, "log_values", plain)
    assert numbers_beyond_bounds("float64") > 0


@BOTH
@pytest.mark.parametrize("order", whittle.ORDERS)
def test_a_search_starts_from_the_wander_that_is_documented(order, dtype):
    for rate_hz in RATES_HZ:
        log_bounds = whittle.log_bounds(order, rate_hz)
        low, high = log_bounds[:, :3]
        # Nearer to a bound than a fiftieth of its range they lie there.
        kept, inside = np.log([0.8, 0.12, 0.004]), 0.02 * (high - low)
        expected = np.clip(kept, low + inside, high - inside)[:, None]
        for logits in whittle.start_logits(log_bounds, order):
            found = log_values(*cast((logits, log_bounds), dtype))[:3]
            off = np.abs(np.asarray(found, float) - expected)
            assert off.max() <= 4 * np.finfo(dtype).eps * np.abs([low, high]).max()


@BOTH
@pytest.mark.parametrize(
    "space",
    [SPACES[0], *(pytest.param(s, marks=pytest.mark.slow) for s in SPACES[1:])],
)
def test_any_point_is_a_technique_with_gradients(space, dtype, rng):
    (least, most), found_of = space.ranges, with_slopes(space.natural)
    is_valid = jax.jit(lambda point: space.technique(point).is_valid)
    points = [np.full(space.size, x) for x in COORDINATES]
    for x, i in itertools.product(COORDINATES, range(space.size)):
        points.append(rng.normal(size=space.size))
        points[-1][i] = x
    points += [rng.choice(COORDINATES, space.size) for _ in range(20)]
    for point in points:
        given = jnp.asarray(point, dtype)
        found, slopes = found_of(given)
        found = np.asarray(found, float)
        is_within = (found >= least) & (found <= most) & np.isfinite(found)
        assert is_within.all(), point
        assert bool(is_valid(given)), point
        assert bad_leaves(slopes) == 0, point


def near_bounds(bound, inwards):
    """A bound, an ulp inside it, and farther in."""
    inside = float(np.nextafter(bound, bound + inwards))
    return [bound, inside, *(bound + inwards * step for step in (1e-9, 1e-3, 0.01))]


@BOTH
def test_techniques_come_back_from_their_place_in_the_space(dtype):
    space = CurveSpace()
    natural = jax.jit(jax.vmap(space.natural))
    shares = [*near_bounds(0.0, 1.0), 0.5, *near_bounds(1.0, -1.0)]
    speeds = (1e-19, 1e-6, 25.0, 1e19)
    cases = [
        (w_min, share, d, speeds[int(1e3 * (w_min + share + d)) % 4])
        for w_min, share, d in itertools.product(shares, repeat=3)
    ]
    points = [space.near(HeadMovement(w, s * w, h, (d,))) for w, s, d, h in cases]
    found = np.asarray(natural(jnp.asarray(np.stack(points), dtype)), float)
    w_min, share, d, speed = np.array(cases).T
    back = np.stack(
        [found[:, 0], found[:, 1] / found[:, 0], found[:, 2] / speed, found[:, 3]]
    )
    # Of nothing there is no share; half of the smallest number is nothing.
    share = np.where(w_min > 0, share * w_min / np.where(w_min > 0, w_min, 1), 0)
    # What lies nearer to a bound than 1e-3 is documented to come back from there.
    inside = np.stack([w_min, share, d]).clip(1e-3, 1 - 1e-3)
    expected = np.insert(inside, 2, 1.0, axis=0)
    np.testing.assert_allclose(back, expected, rtol=0, atol=64 * np.finfo(dtype).eps)


# --- what lies beyond is refused ---

_UP = lambda value: float(np.nextafter(value, np.inf))
_DOWN = lambda value: float(np.nextafter(value, -np.inf))
_LEAST = _UP(0.0)


def _head(**changes):
    numbers = {
        "speed_rms_deg_s": (1.0,) * 3,
        "correlation_time_s": (0.1,) * 3,
        "tracker_noise_deg": (0.0,) * 3,
    }
    return HeadMotion(**{**numbers, **changes})


def _yaw(value, other=1.0):
    return (other, value, other)


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: HeadMovement(w_min=_UP(1.0)), r"w_min must lie in \[0, 1\]"),
        (lambda: HeadMovement(w_min=0.0, w_lb=_LEAST), r"w_lb must lie in \[0, w_min"),
        (lambda: HeadMovement(w_lb=-_LEAST), r"w_lb must lie in \[0, 1\]"),
        (lambda: HeadMovement(h_max_deg_s=0.0), r"h_max_deg_s must lie in \(0, inf\)"),
        (lambda: HeadMovement(h_max_deg_s=np.inf), "h_max_deg_s must lie"),
        (lambda: HeadMovement(closeness=(0.5, _UP(1.0))), r"closeness\[1\] must lie"),
        (lambda: HeadMovement(closeness=(-_LEAST,)), r"closeness\[0\] must lie"),
        (lambda: HeadMovement(weights=(0.0,)), "weights must have a positive sum"),
        (lambda: Cosine(_DOWN(0.5)), r"exponent must lie in \[0.5, inf\)"),
        (lambda: Spline((0.0, 0.0, 0.0)), "increments must have a positive sum"),
        (lambda: Spline((1.0, -_LEAST, 1.0)), r"increments\[1\] must lie"),
        (lambda: _head(speed_rms_deg_s=_yaw(-_LEAST)), r"speed_rms_deg_s \(yaw\) must"),
        (lambda: _head(correlation_time_s=_yaw(0.0)), r"correlation_time_s \(yaw\)"),
        (lambda: _head(tracker_noise_deg=_yaw(np.nan)), r"tracker_noise_deg \(yaw\)"),
        (lambda: _head(return_time_s=0.0), r"return_time_s must lie in \(0, inf\)"),
        (lambda: _head(person_sd=-_LEAST), r"person_sd must lie in \[0, inf\)"),
        (lambda: Resonator(_yaw(1.0), _yaw(0.0), _yaw(1.0)), r"frequency_hz \(yaw\)"),
        (lambda: Resonator(_yaw(1.0), _yaw(1.0), _yaw(0.0)), r"damping \(yaw\) must"),
        (lambda: Amplitude(-_LEAST, 0.4), r"sd must lie in \[0, inf\)"),
        (lambda: Amplitude(0.4, 0.0), r"correlation_time_s must lie in \(0, inf\)"),
    ],
)
def test_what_lies_beyond_a_bound_is_refused_in_a_line(make, field):
    with pytest.raises(ValueError, match=f"^{field}") as refusal:
        make()
    assert "\n" not in str(refusal.value)


def test_what_lies_at_a_bound_or_an_ulp_inside_is_taken():
    for w in (0.0, _LEAST, _DOWN(1.0), 1.0):
        for d in (0.0, _LEAST, _DOWN(1.0), 1.0):
            technique = HeadMovement(w, w, _LEAST, (d, d), ease=Cosine(0.5))
            space = CurveSpace("power", 2)
            point = space.near(technique)
            assert np.isfinite(point).all()
            assert np.isfinite(space.natural(point)).all()
    _head(speed_rms_deg_s=_yaw(0.0), correlation_time_s=_yaw(_LEAST), person_sd=0.0)
    Resonator(_yaw(0.0), _yaw(_LEAST), _yaw(_LEAST))


# --- heads ---

_PLAIN = {"speed": 0.8, "time": 0.12, "noise": 0.004, "back": 8.0, "modes": ()}
_BEYOND = {
    "noise at its least": ({"noise": 1e-5}, 0),
    "noise at its most": ({"noise": 0.3}, 0),
    "noise beyond": ({"noise": 3.0}, 0),
    "speed beyond": ({"speed": 300.0}, 0),
    "time at its most": ({"time": 5.0}, 0),
    "time beyond": ({"time": 50.0}, 0),
    "time at its least": ({"time": 5e-3}, 0),
    "time below": ({"time": 5e-4}, 0),
    "return below": ({"back": 0.1}, 0),
    "return beyond": ({"back": 1000.0}, 0),
    "bursts beyond": ({"bursts": Amplitude(3.0, 0.4)}, 0),
    "a tracker, with a resonance": ({"speed": 0.0}, 1),
    "frequency at its least": ({"modes": ((0.5, 0.7, 0.2),)}, 1),
    "frequency below": ({"modes": ((0.5, 0.07, 0.2),)}, 1),
    "frequency at its most": ({"modes": ((0.5, 13.5, 0.2),)}, 1),
    "frequency beyond": ({"modes": ((0.5, 135.0, 0.2),)}, 1),
    "damping at its least": ({"modes": ((0.5, 3.0, 0.02),)}, 1),
    "damping below": ({"modes": ((0.5, 3.0, 0.002),)}, 1),
    "damping at its most": ({"modes": ((0.5, 3.0, 2.0),)}, 1),
    "damping beyond": ({"modes": ((0.5, 3.0, 20.0),)}, 1),
}


def _drawn(change, subjects, seconds):
    numbers = {**_PLAIN, "bursts": None, **change}
    three = lambda name: (numbers[name],) * 3
    modes = [Resonator(*((x,) * 3 for x in mode)) for mode in numbers["modes"]]
    head = HeadMotion(
        *(three("speed"), three("time"), three("noise"), numbers["back"], 0.17),
        tuple(modes),
        numbers["bursts"],
    )
    return traces_of(head, jax.random.key(5), subjects, seconds)


@pytest.mark.exhaustive
@pytest.mark.parametrize(("subjects", "seconds"), [(6, 16.0), (1, 60.0)])
@pytest.mark.parametrize("case", _BEYOND)
def test_heads_at_and_beyond_the_bounds_are_fitted_within_them(case, subjects, seconds):
    change, order = _BEYOND[case]
    traces = _drawn(change, subjects, seconds)
    found = fitting.fit_heads(traces, order=order, max_speed_deg_s=1e6)
    known = identifiable_within_bounds(found)
    # What lies far beyond is not identifiable.
    if "time beyond" in case or "noise beyond" in case:
        name = "correlation_time_s" if "time" in case else "tracker_noise_deg"
        assert np.isnan(getattr(found.standard_error, name)).any()
    elif "damping below" in case:
        error = np.array(found.standard_error.resonators[0].damping, float)
        assert np.isnan(error).any()
    assert known.any() or "noise beyond" in case


@pytest.mark.exhaustive
def test_the_order_of_a_tracker_alone_is_chosen_among_fits_at_their_bounds():
    traces = _drawn({"speed": 0.0}, 6, 16.0)
    found = fitting.fit_heads(traces, max_speed_deg_s=1e6)
    identifiable_within_bounds(found)
    assert np.isfinite(list(found.held_out_deviance.values())).all()
