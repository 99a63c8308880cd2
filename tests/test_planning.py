import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from hmdjit.estimates.estimate import mean_of
from hmdjit.estimates.planning import (
    Need,
    figure_of_merit,
    interim_level,
    sessions_needed,
)

variance = st.floats(1e-6, 10.0)


@given(
    st.lists(
        st.tuples(st.floats(1e-3, 1.0), variance, variance), min_size=1, max_size=4
    ),
    st.floats(1e-4, 1.0),
    st.floats(1e-7, 1e-3),
)
def test_planned_numbers_suffice_and_nothing_near_is_cheaper(needs, session_s, path_s):
    needs = [Need(*need) for need in needs]
    n, m = sessions_needed(needs, session_s, path_s)

    def suffices(n, m):
        return all(
            need.session_variance / n + need.path_variance / m
            <= need.error**2 * (1 + 1e-9)
            for need in needs
        )

    assert suffices(n, m)
    cost = n * session_s + m * path_s
    for share in np.geomspace(0.5, 2.0, 9):
        other_n = max(round(share * n), 1)
        # The fewest paths that go with so many sessions.
        left = [need.error**2 - need.session_variance / other_n for need in needs]
        if min(left) <= 0:
            continue
        fewest = max(
            need.path_variance / rest for need, rest in zip(needs, left, strict=True)
        )
        # The search steps by 6 %: its minimum is flat there, plus rounding up to 1.
        slack = session_s + path_s
        assert cost <= 1.02 * (other_n * session_s + fewest * path_s) + slack


def test_plain_means_need_no_paths():
    assert sessions_needed([Need(0.1, 2.0, 0.0)], 1.0, 1e-3) == (200, 0)


def test_interim_analyses_together_err_no_more_than_one_interval():
    missed = [2 * stats.norm.sf(interim_level(k)) for k in range(1, 40)]
    assert sum(missed) == pytest.approx(0.05, rel=1e-6)
    assert interim_level(1) == pytest.approx(2.2414, abs=1e-4)


def test_late_interim_analyses_keep_their_levels():
    # 1 - 0.025 / 2^k is 1 from the 48th analysis on.
    for k in (1, 30, 60, 200):
        missed = 2 * stats.norm.sf(interim_level(k))
        assert missed == pytest.approx(0.05 / 2**k, rel=1e-12)


def test_a_figure_of_merit_is_per_relative_error_and_second(rng):
    x = mean_of(rng.uniform(1, 2, 40))
    relative = x.standard_error / x.value
    assert figure_of_merit(x, 4.0) == pytest.approx(1 / (4 * relative**2))
    assert math.isnan(figure_of_merit(mean_of(np.zeros(10)), 4.0))
