"""Fits at the bounds of their searches and beyond: maps, refusals, whole fits."""

import jax
import numpy as np
import pytest
from heads import identifiable_within_bounds, traces_of

from hmdjit.curve_fitting.space import CurveSpace
from hmdjit.curves import Cosine, Spline
from hmdjit.envelope import bounds
from hmdjit.envelope.measuring import DIGITS, mp
from hmdjit.head_fitting import fitting, whittle
from hmdjit.head_motion import Amplitude, HeadMotion, Resonator
from hmdjit.techniques import HeadMovement

# --- maps ---


RUNS = [
    pytest.param(run, marks=pytest.mark.slow if run.is_slow else (), id=run.name)
    for run in bounds.runs()
]


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("run", RUNS)
def test_maps_are_right_and_within_their_ranges(run, dtype):
    with mp.workdps(DIGITS):
        error, where = run.measure(np.random.default_rng(0), dtype, True)
    assert error <= run.bounds[dtype].value, where


def test_a_map_that_leaves_its_bounds_does_not_hold(monkeypatch):
    def plain(search, data):
        low, high = data.log_bounds[..., None]
        return low + (high - low) * jax.nn.sigmoid(search.logits)

    # In float64 low + (high - low) is 4e-16 above the largest wander's speed.
    monkeypatch.setattr(whittle, "log_values", plain)
    anew = lambda *given: bounds._log_values(*given)
    monkeypatch.setattr(bounds, "_head_forms", [jax.jit(anew)])
    rng = np.random.default_rng(0)
    assert bounds.head_range(rng, "float64", quick=True)[0] > 0


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


@pytest.mark.slow
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


@pytest.mark.slow
def test_the_order_of_a_tracker_alone_is_chosen_among_fits_at_their_bounds():
    traces = _drawn({"speed": 0.0}, 6, 16.0)
    found = fitting.fit_heads(traces, max_speed_deg_s=1e6)
    identifiable_within_bounds(found)
    assert np.isfinite(list(found.held_out_deviance.values())).all()
