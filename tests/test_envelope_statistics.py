"""The envelope of intervals and estimates: bounds hold, and can fail; plans."""

import dataclasses
import math

import numpy as np
import pytest

from hmdjit.envelope import engine
from hmdjit.envelope.engine import mp
from hmdjit.envelope.estimates import ROWS, truth
from hmdjit.estimates import estimate as estimates
from hmdjit.estimates import intervals
from hmdjit.estimates.estimate import mean_of, ratio
from hmdjit.estimates.planning import Need, sessions_needed

EPS = 2.0**-52


def measured(row, inputs=22):
    """Measure a row but for its largest samples, which take seconds."""

    def is_kept(*drawn):
        is_small = np.size(drawn[0]) < 1000
        return is_small and (row.kept is None or row.kept(*drawn))

    some = dataclasses.replace(row, kept=is_kept, quick=inputs)
    return next(engine.measure([some], quick=True))


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_bounds_hold_but_for_the_largest_samples(row):
    found = measured(row)
    assert found.inputs == 22
    assert found.holds, found


def test_residuals_that_cancel_do_not_hold(monkeypatch):
    def plain(x):
        return x.mean(axis=-1), x  # as `x - R y` of the values themselves

    monkeypatch.setattr(estimates, "centred", plain)
    (row,) = (row for row in ROWS if row.name.endswith("ratio_interval"))
    assert measured(row, inputs=86).error > 1e6  # eps: 6 digits are lost


def test_the_oracle_of_a_standard_error_is_its_definition(rng):
    x, y = rng.random((2, 7)) + 1
    with mp.workdps(engine.DIGITS):
        exact = truth(lambda a, b: 2 * a - 3 * b, *map(engine.exact_numbers, (x, y)))
        error, spread = float(exact.error), float(exact.spread)
    rows = 2 * x - 3 * y
    assert error == pytest.approx(rows.std(ddof=1) / np.sqrt(7), rel=1e-12)
    own = 4 * x.var(ddof=1) + 9 * y.var(ddof=1)
    assert spread == pytest.approx(np.sqrt(own / 7), rel=1e-12)


def test_a_ratio_is_formed_just_where_a_baseline_flickers_enough(rng):
    limit = estimates.MIN_BASELINE_MTCD
    beside = [np.nextafter(limit, end) for end in (0.0, 1.0)]
    for count in (1, 2, 7, 49, 50, 1000, 100_000):
        body = np.exp(rng.standard_normal(count))
        body /= body.mean()
        for level in (limit, *beside, limit * (1 - 1e-14), limit * (1 + 1e-14)):
            for y in (np.full(count, level), level * body):
                mean = math.fsum(y) / count if np.ptp(y) else y[0]
                # Of sessions that differ, what rounding could decide is not asked.
                if abs(mean / limit - 1) < 8 * EPS and np.ptp(y):
                    continue
                x = 0.5 * y
                values = [
                    intervals.ratio_interval(x, y).value,
                    intervals.geometric_mean_ratio(x[None], y[None]).value,
                    intervals.log_ratio_derivative_interval(x, y, x, y).value,
                ]
                has_ratio = [
                    *np.isfinite(values),
                    not ratio(mean_of(x), mean_of(y)).reason,
                ]
                assert has_ratio == [mean > limit] * 4, f"{count} sessions of {level!r}"


def test_planned_sessions_leave_no_more_error_than_was_asked_for(rng):
    for n in range(300):
        size = lambda count: (10 ** rng.uniform(-4, 4, count)).tolist()
        needs = [Need(*size(3)) for _ in range(1 + n % 3)]
        if n % 2:
            needs = [Need(0.1, float(rng.integers(1, 1000)), 0.0) for _ in needs]
        sessions, paths = sessions_needed(
            needs, *(10 ** rng.uniform(-4, 0, 2)).tolist()
        )
        for need in needs:
            left = need.session_variance / sessions
            left += need.path_variance / paths if need.path_variance else 0
            assert left <= need.error**2 * (1 + 4 * EPS), needs
        hardest = max(need.session_variance / need.error**2 for need in needs)
        assert paths or sessions - 2 < hardest, f"too many for {needs}"
