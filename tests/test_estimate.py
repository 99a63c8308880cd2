import math

import numpy as np
import pytest

from hmdjit.estimates.estimate import (
    NO_FLICKER,
    combined,
    control_variate,
    mean_of,
    pairing_gain,
    ratio,
)


@pytest.fixture
def flicker(rng):
    """Two techniques and a baseline in 400 sessions: one restless person moves all."""
    person = np.exp(0.5 * rng.normal(size=400))
    return person * rng.uniform(0.5, 1.5, (3, 400))


def test_a_baseline_that_does_not_flicker_has_no_ratio(flicker):
    found = ratio(mean_of(flicker[0]), mean_of(0.01 * flicker[1]))
    assert found.reason == NO_FLICKER
    assert np.isnan([found.value, found.standard_error]).all()


def test_a_ratio_to_itself_is_exactly_1(flicker):
    x = mean_of(flicker[0])
    assert ratio(x, x).value == 1
    assert ratio(x, x).standard_error == 0


# --- sums know which sessions they share ---


def test_a_weighted_sum_of_means_is_the_mean_of_weighted_sums(flicker):
    ours = combined([2.0, -3.0], [mean_of(flicker[0]), mean_of(flicker[1])])
    expected = mean_of(2 * flicker[0] - 3 * flicker[1])
    assert ours.value == pytest.approx(expected.value, rel=1e-12)
    assert ours.standard_error == pytest.approx(expected.standard_error, rel=1e-12)


def test_samples_of_different_length_share_the_sessions_that_both_have(rng):
    values = rng.normal(size=(2000, 200))
    both = [combined([0.5, 0.5], [mean_of(v), mean_of(v[:50])]) for v in values[:100]]
    scatter = (values.mean(axis=1) + values[:, :50].mean(axis=1)) / 2
    np.testing.assert_allclose([one.value for one in both], scatter[:100], atol=1e-14)
    # (1/2)^2 (1/200 + 1/50 + 2/200) = 0.0935^2; a spread of 2,000 errs by 1.6 %.
    known = np.mean([one.standard_error for one in both])
    assert known == pytest.approx(0.0935, rel=0.02)
    assert np.std(scatter) == pytest.approx(known, rel=0.08)


def test_a_session_that_failed_keeps_its_place(flicker):
    values, others = flicker[0].copy(), flicker[0].copy()
    values[3] = np.nan
    ours = mean_of(values, nan_policy="omit")
    expected = mean_of(np.delete(values, 3))
    assert ours.value == expected.value
    assert ours.standard_error == pytest.approx(expected.standard_error, rel=1e-12)
    # One that failed in one of two equal scenes leaves them nearly as correlated.
    both = combined([0.5, 0.5], [ours, mean_of(others)])
    assert both.standard_error == pytest.approx(ours.standard_error, rel=0.01)


def test_a_session_that_failed_makes_all_nan_unless_it_is_left_out(flicker):
    x, y = flicker[0].copy(), flicker[1]
    x[3] = np.inf
    for slope in (0.0, 0.8):
        found = control_variate(x, y, flicker[2], slope)
        assert math.isnan(found.value)
        assert math.isnan(found.standard_error)
        left = control_variate(x, y, flicker[2], slope, nan_policy="omit")
        whole = control_variate(np.delete(x, 3), np.delete(y, 3), flicker[2], slope)
        assert left.value == whole.value
    # Not a baseline without flicker, which has no ratio at all.
    against = ratio(mean_of(y), mean_of(x))
    assert against.reason == "not finite in 1 of 400 sessions"
    assert math.isnan(against.value)


# --- the control variate ---


def population(rng, shape, correlation=0.98, mean=3.0):
    """Sessions and a prediction of them, off in mean and scale, by correlation."""
    x, noise = rng.normal(size=(2, *shape))
    simulated = mean + x
    predicted = 0.7 * (2 + correlation * x + math.sqrt(1 - correlation**2) * noise)
    return simulated, predicted


@pytest.mark.parametrize("slope", [0.0, 0.8, 1.4])
def test_a_control_variate_is_unbiased_whatever_its_slope(rng, slope):
    simulated, predicted = population(rng, (500, 60))
    _, paths = population(rng, (500, 300))
    found = [
        control_variate(*sample, slope)
        for sample in zip(simulated, predicted, paths, strict=True)
    ]
    values = np.array([estimate.value for estimate in found])
    error = values.std() / math.sqrt(len(values))
    assert abs(values.mean() - 3.0) < 5 * error  # false alarm 6e-7
    known = math.sqrt(np.mean([estimate.standard_error**2 for estimate in found]))
    # The spread of 500 values errs by 3.2 %: 5 standard errors.
    assert values.std() == pytest.approx(known, rel=0.16)


def test_the_regression_slope_leaves_what_the_prediction_does_not_explain(rng):
    simulated, predicted = population(rng, (40_000,))
    _, paths = population(rng, (4_000_000,))
    slope = np.cov(simulated, predicted)[0, 1] / predicted.var(ddof=1)
    ours = control_variate(simulated, predicted, paths, slope)
    plain = mean_of(simulated)
    gain = (plain.standard_error / ours.standard_error) ** 2
    # 1 / (1 - r^2) = 25.3, and the paths' own r^2 / 100 on top of 1 - r^2: 20.4.
    assert gain == pytest.approx(1 / (1 - 0.98**2 + 0.98**2 / 100), rel=0.05)


def test_without_a_slope_predictions_do_not_count(flicker):
    ours = control_variate(flicker[0], flicker[1], flicker[2], 0.0)
    assert ours.value == mean_of(flicker[0]).value
    assert ours.standard_error == mean_of(flicker[0]).standard_error


# --- pairing ---


def test_pairing_gains_what_sessions_share(rng):
    shared = rng.normal(size=4000)
    x, y = (mean_of(4 + shared + 0.5 * rng.normal(size=4000)) for _ in range(2))
    # Variances 1.25 each, of the difference 0.5; 4 standard errors of their ratio.
    assert pairing_gain(x, y) == pytest.approx(2.5 / 0.5, rel=4 * (4 / 4000) ** 0.5)
    assert math.isnan(pairing_gain(y, y))
    assert math.isnan(pairing_gain(x, mean_of(np.zeros(4000))))


def test_a_session_alone_has_no_error():
    # It was 0: one session was as sure as could be.
    alone = mean_of(np.array([np.nan, 3.0]), nan_policy="omit")
    assert alone.value == 3.0
    assert math.isnan(alone.standard_error)
    none = mean_of(np.full(2, np.nan), nan_policy="omit")
    assert math.isnan(none.value)
    assert math.isnan(none.standard_error)


def test_a_control_keeps_the_digits_of_a_small_spread(rng):
    # `Y - b T` of the values themselves rounds by b T, 1e6 times what Y is.
    z = np.round(1000 * rng.normal(size=(2, 60)))
    y, t = 1 + z * 2.0**-50  # exactly
    ours = control_variate(y, t, t, 1e6)
    rest = (z - z.mean(axis=1, keepdims=True)) * 2.0**-50
    here = np.sum((rest[0] - 1e6 * rest[1]) ** 2)
    expected = math.sqrt((here + 1e12 * np.sum(rest[1] ** 2)) / 60 / 59)
    assert ours.standard_error == pytest.approx(expected, rel=1e-12)


def test_a_session_that_was_not_predicted_does_not_count(rng):
    y, t = rng.normal(size=(2, 30))
    t[3] = np.nan
    ours = control_variate(y, t, t[:3], 0.5, nan_policy="omit")
    expected = control_variate(np.delete(y, 3), np.delete(t, 3), t[:3], 0.5)
    assert ours.value == pytest.approx(expected.value, rel=1e-12)
    assert ours.standard_error == pytest.approx(expected.standard_error, rel=1e-12)


def test_what_pairing_leaves_of_rounding_is_no_variance(flicker):
    # In proportion but for rounding, they had a gain of 1e32.
    y = mean_of(flicker[0])
    assert math.isnan(pairing_gain(mean_of(0.6 * flicker[0]), y))
    assert pairing_gain(mean_of(0.6 * flicker[0] + 1e-9 * flicker[1]), y) > 1e12
