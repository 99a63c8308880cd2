"""The envelope of intervals, estimators and metrics: bounds hold, and can fail."""

import numpy as np
import pytest

from hmdjit.envelope import estimators, intervals, measuring, metrics
from hmdjit.envelope.measuring import mp
from hmdjit.estimates import estimate as studied

RUNS = [*intervals.runs(), *estimators.runs(), *metrics.runs()]


def measured(run, seed=0):
    with mp.workdps(measuring.DIGITS):
        return run.measure(np.random.default_rng(seed), "float64", True)


@pytest.mark.parametrize("run", RUNS, ids=lambda run: run.name)
def test_bounds_hold_but_for_the_largest_samples(run):
    error, where = measured(run)
    assert error <= run.bounds["float64"].value, where


def test_bounds_of_metrics_hold():
    cases = metrics.cases()
    rows = measuring.measure(cases, quick=True)
    assert [row.name for row in rows] == [case.name for case in cases]
    for row in rows:
        assert row.holds, row


def test_residuals_that_cancel_do_not_hold(monkeypatch):
    def plain(x):
        return x.mean(axis=-1), x  # as `x - R y` of the values themselves

    monkeypatch.setattr(studied, "centred", plain)
    run = intervals.runs()[1]
    error, _ = measured(run)
    assert run.name == "intervals.ratio_interval"
    assert error > 1e6  # eps: 6 digits are lost


def test_the_oracle_of_a_standard_error_is_its_definition(rng):
    x, y = rng.random((2, 7)) + 1
    with mp.workdps(measuring.DIGITS):
        exact = intervals.Truth.of(
            0, 1, [2, -3], [intervals.Mean(x), intervals.Mean(y)]
        )
        error, spread = float(exact.error), float(exact.spread)
    rows = 2 * x - 3 * y
    assert error == pytest.approx(rows.std(ddof=1) / np.sqrt(7), rel=1e-12)
    own = 4 * x.var(ddof=1) + 9 * y.var(ddof=1)
    assert spread == pytest.approx(np.sqrt(own / 7), rel=1e-12)
