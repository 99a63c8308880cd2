import math
import tracemalloc
from typing import Any

import numpy as np
import pytest
from scipy import optimize, stats

from hmdjit.estimates import resampling
from hmdjit.estimates.cells import Cell
from hmdjit.estimates.estimate import (
    MIN_BASELINE_MTCD,
    NO_FLICKER,
    Estimate,
    Resampling,
    centred,
    control_variate,
    mean_of,
)
from hmdjit.estimates.intervals import (
    geometric_mean_ratio,
    interval_of,
    log_ratio_derivative_interval,
    mean_interval,
    ratio_interval,
    student_interval,
)

REPLICATIONS = 400
FALSE_ALARM = 1e-3  # of each coverage test, were its key drawn anew


def sessions(rng, count, *, ratio=0.6, correlation=0.9, shape=()):
    """Lognormal pairs, coefficient of variation 0.55, means `ratio` and 1."""
    sigma = math.sqrt(math.log(1 + 0.55**2))
    common, own = rng.standard_normal((2, *shape, count))
    other = correlation * common + math.sqrt(1 - correlation**2) * own
    y, x = np.exp(sigma * np.stack([common, other]) - sigma**2 / 2)
    return ratio * x, y


def covers(interval, truth):
    return interval.low <= truth <= interval.high


@pytest.mark.parametrize(("count", "coverage"), [(100, 0.945), (16, 0.93), (8, 0.91)])
@pytest.mark.parametrize("kind", ["mean", "ratio"])
def test_intervals_cover_as_documented(rng, kind, count, coverage):
    hits = 0
    for _ in range(REPLICATIONS):
        x, y = sessions(rng, count)
        found = mean_interval(y) if kind == "mean" else ratio_interval(x, y)
        hits += covers(found, 1.0 if kind == "mean" else 0.6)
    assert hits >= stats.binom.ppf(FALSE_ALARM, REPLICATIONS, coverage)
    assert hits <= stats.binom.ppf(1 - FALSE_ALARM, REPLICATIONS, 0.97)


@pytest.mark.parametrize(("count", "coverage"), [(100, 0.945), (16, 0.93)])
def test_geometric_mean_covers_with_sessions_shared_by_scenes(rng, count, coverage):
    hits = 0
    for _ in range(REPLICATIONS):
        person = np.exp(0.3 * rng.standard_normal(count))
        pairs = [sessions(rng, count, ratio=r) for r in (0.5, 0.7, 0.9)]
        x, y = np.stack(pairs, axis=1) * person
        hits += covers(geometric_mean_ratio(x, y), (0.5 * 0.7 * 0.9) ** (1 / 3))
    assert hits >= stats.binom.ppf(FALSE_ALARM, REPLICATIONS, coverage)


def test_intervals_over_subjects_cover_the_population(rng):
    subject = np.repeat(np.arange(12), 6)
    hits = hits_over_windows = 0
    for _ in range(REPLICATIONS):
        person = np.exp(0.4 * rng.standard_normal(12) - 0.08)
        x = person[subject] * np.exp(0.3 * rng.standard_normal(72) - 0.045)
        hits += covers(mean_interval(x, subject), 1.0)
        hits_over_windows += covers(mean_interval(x), 1.0)
    assert hits >= stats.binom.ppf(FALSE_ALARM, REPLICATIONS, 0.93)
    # Windows of one person are alike: taken as independent, they promise too much.
    assert hits_over_windows < 0.75 * REPLICATIONS


def unequal(subjects, effective):
    """Subject of each of some 400 sessions: lognormal shares, so many effective."""
    z = stats.norm.ppf((np.arange(subjects) + 0.5) / subjects)
    share = lambda sd: np.exp(sd * z) / np.exp(sd * z).sum()
    sd = optimize.brentq(lambda sd: 1 / np.sum(share(sd) ** 2) - effective, 0, 9)
    windows = np.maximum(1, np.round(400 * share(sd))).astype(int)
    return np.repeat(np.arange(subjects), windows)


@pytest.mark.parametrize("sets", [200, pytest.param(2000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", ["mean", "ratio"])
def test_unequal_subjects_count_as_the_effective_ones(rng, kind, sets):
    # As 40 people, 10 effective ones of 40 covered with 91 %, a ratio with 94 %.
    subject, hits = unequal(40, 10), 0
    y = np.ones(len(subject))
    for _ in range(sets):
        person = np.exp(0.5 * rng.standard_normal(40) - 0.125)[subject]
        own = np.exp(0.1 * rng.standard_normal((2, len(subject))) - 0.005)
        x, y = person * own
        if kind == "mean":
            hits += covers(mean_interval(y, subject), 1.0)
        else:
            x *= np.exp(0.1 * rng.standard_normal(40) - 0.005)[subject]
            hits += covers(ratio_interval(x, y, subject), 1.0)
    # 91 % of 2,000 would pass in 5e-6 of such tests; 200 tell what is far off.
    assert hits >= stats.binom.ppf(FALSE_ALARM, sets, 0.95)
    found = mean_interval(y * np.arange(len(y)), subject)
    assert found.method.endswith("of 40 subjects (10.2 effective), both resampled")


@pytest.mark.parametrize("others", [1, 4, 39])
def test_one_subject_with_nearly_all_windows_says_little(rng, others):
    subject = np.concatenate([np.zeros(500, int), 1 + np.arange(max(others, 4))])
    found = mean_interval(np.exp(rng.standard_normal(len(subject))), subject)
    assert found.low < found.value < found.high
    assert "effective" in found.method


def test_subjects_with_equally_many_windows_are_all_effective(rng):
    found = mean_interval(rng.random(60), np.arange(60) % 12)
    assert found.method == "bootstrap, 60 sessions of 12 subjects, both resampled"


@pytest.mark.parametrize(
    ("windows", "units"), [((5,) * 12, 12), ((1, 1, 1, 2, 5), 3.125)]
)
def test_levels_are_those_of_the_effective_subjects(windows, units):
    subject = np.repeat(np.arange(len(windows)), windows)
    values = np.random.default_rng(3).random(2000)
    sample = Resampling(np.ones(len(subject), bool), subject, lambda weights: values)
    found = interval_of(Estimate(1.0, (np.ones(len(subject)),), 10, 1.0, sample))
    width = math.sqrt(units / (units - 1)) * stats.t.ppf(0.975, units - 1)
    ends = np.quantile(values, stats.norm.cdf([-width, width]))
    np.testing.assert_allclose([found.low, found.high], ends, rtol=1e-12)


# --- tables and masks ---

TABLE = np.arange(1.0, 13.0).reshape(4, 3)
TWO_AXES = r"must have one axis \(session\), got an array of shape \(4, 3\)"


@pytest.mark.parametrize(
    "door",
    [
        lambda x: mean_of(x),
        lambda x: mean_interval(x),
        lambda x: mean_interval(x, np.arange(12) % 6),
        lambda x: ratio_interval(x, x),
        lambda x: log_ratio_derivative_interval(x, x, x, x),
        lambda x: control_variate(x, x, x[0], 0.5),
        lambda x: control_variate(x, x, x[0], 0.0),
    ],
)
def test_a_table_is_no_row_of_sessions(untyped, door):
    # It was taken as so many independent sessions: 95 % intervals covered with 40 %.
    for table in (TABLE, TABLE.tolist(), np.ma.masked_greater(TABLE, 5)):
        with pytest.raises(ValueError, match=TWO_AXES):
            door(
                np.ma.asarray(table) if isinstance(table, np.ma.MaskedArray) else table
            )


@pytest.mark.parametrize(
    ("door", "message"),
    [
        (lambda: mean_of(np.array(3.0)), r"one axis \(session\), got .* shape \(\)"),
        (lambda: mean_of(np.ones(3) + 1j), "real numbers, got complex128"),
        (lambda: mean_of(np.ones(3), np.arange(4)), r"each of 3 sessions, .*\(4,\)"),
        (lambda: mean_of(np.ones(3), np.ones((3, 1))), r"of 3 sessions, .*\(3, 1\)"),
        (
            lambda: mean_of(np.ones(3), np.array([0, np.nan, 1])),
            "clusters must have a label for each session, 1 have none",
        ),
        (
            lambda: mean_of(np.ones(3), np.ma.masked_greater([0, 1, 2], 0)),
            "clusters must have a label for each session, 2 have none",
        ),
        (
            lambda: mean_of(np.ones(3), np.array(["ann", None, "bob"])),
            "clusters must have a label for each session, 1 have none",
        ),
        (
            lambda: control_variate(TABLE[0], TABLE[1], TABLE, 0.5),
            r"paths must have one axis \(path\), got an array of shape \(4, 3\)",
        ),
        (
            lambda: geometric_mean_ratio(TABLE[0], TABLE[0]),
            r"2 axes \(scene, session\), got an array of shape \(3,\)",
        ),
        (
            lambda: geometric_mean_ratio(TABLE, TABLE[:2]),
            r"one shape, got \(4, 3\) and \(2, 3\)",
        ),
        (
            lambda: Cell.plain(TABLE),
            r"3 axes \(metric, technique, session\), got .*\(4, 3\)",
        ),
    ],
)
def test_other_axes_are_refused_by_name(untyped, door, message):
    with pytest.raises(ValueError, match=message):
        door()


def test_what_a_mask_hides_is_a_session_that_failed(rng, untyped):
    # It was read under the mask.
    x, y = sessions(rng, 60)
    hidden = np.isin(np.arange(60), [3, 7])
    masked, holes = np.ma.array(x, mask=hidden), np.where(hidden, np.nan, x)
    for of in (
        mean_interval,
        lambda x, **how: mean_interval(x, np.arange(60) % 6, **how),
        lambda x, **how: ratio_interval(x, y, **how),
        lambda x, **how: log_ratio_derivative_interval(x, y, x, y, **how),
        lambda x, **how: geometric_mean_ratio(np.ma.stack([x]), y[None], **how),
    ):
        assert of(masked, nan_policy="omit") == of(holes, nan_policy="omit")
        assert of(masked).method == "not finite in 2 of 60 sessions"
    whole = np.ma.array(np.arange(60), mask=hidden)
    assert mean_of(whole, nan_policy="omit").value == np.arange(60)[~hidden].mean()
    assert mean_interval(np.ma.array(x, mask=False)) == mean_interval(x)
    assert control_variate(x, y, masked, 0.5).reason == "not finite in 2 of 60 sessions"
    np.testing.assert_array_equal(centred(masked)[1][hidden], 0)


def test_mean_interval_by_hand():
    x = np.tile([1.0, 3.0], 50)
    found = mean_interval(x)
    error = math.sqrt(100 / 99) / 10
    assert found.value == 2.0
    np.testing.assert_allclose(found.standard_error, error, rtol=1e-12)
    np.testing.assert_allclose(found.high - 2, 1.959963985 * error, rtol=1e-9)
    np.testing.assert_allclose(found.half_width, 1.959963985 * error, rtol=1e-9)
    assert found.method == "normal, 100 sessions"


def test_students_interval_is_scipys(rng):
    x = rng.normal(size=9)
    found = student_interval(mean_of(x))
    expected = stats.ttest_1samp(x, 0).confidence_interval(0.95)
    np.testing.assert_allclose([found.low, found.high], expected, rtol=1e-12)


def test_ratio_interval_by_hand():
    x, y = np.tile([1.0, 3.0, 2.0], 20), np.tile([2.0, 4.0, 6.0], 20)
    found = ratio_interval(x, y)
    residual = np.tile([0.0, 1.0, -1.0], 20)  # x - y / 2
    error = math.sqrt(np.sum(residual**2) / 59) / math.sqrt(60) / 4.0
    np.testing.assert_allclose(found.value, 0.5, rtol=1e-15)
    np.testing.assert_allclose(found.standard_error, error, rtol=1e-12)
    np.testing.assert_allclose(found.low, 0.5 - 1.959963985 * error, rtol=1e-9)


def test_geometric_mean_is_the_geometric_mean(rng):
    x, y = sessions(rng, 200, shape=(4,))
    x *= np.array([[0.5], [1.0], [1.5], [2.0]])
    direct = stats.gmean(x.mean(axis=1) / y.mean(axis=1))
    np.testing.assert_allclose(geometric_mean_ratio(x, y).value, direct, rtol=1e-13)


def test_geometric_mean_error_agrees_with_the_jackknife(rng):
    x, y = sessions(rng, 300, shape=(4,))
    person = np.exp(0.5 * rng.standard_normal(300))
    x, y = x * person, y * person
    without = [
        stats.gmean(np.delete(x, i, 1).mean(axis=1) / np.delete(y, i, 1).mean(axis=1))
        for i in range(300)
    ]
    jackknife = np.std(without) * math.sqrt(299)
    found = geometric_mean_ratio(x, y)
    # The two differ by terms of relative order 1 / n.
    np.testing.assert_allclose(found.standard_error, jackknife, rtol=0.02)
    np.testing.assert_allclose(found.low * found.high, found.value**2, rtol=1e-12)


@pytest.mark.parametrize("count", [20, 400])
def test_ratio_agrees_with_a_brute_force_bootstrap(rng, count):
    x, y = sessions(rng, count)
    draws = np.random.default_rng(7).integers(0, count, (20_000, count))
    replicates = np.sort(x[draws].mean(axis=1) / y[draws].mean(axis=1))
    found = ratio_interval(x, y)
    # Ours has 2,000 replicates: its error has a relative one of 1 / sqrt(4000), 1.6 %.
    # Asymptotic and resampled errors differ by less than that at 400 sessions.
    np.testing.assert_allclose(found.standard_error, np.std(replicates), rtol=0.07)
    width = stats.t.ppf(0.975, count - 1) * math.sqrt(count / (count - 1))
    ends = np.quantile(replicates, stats.norm.cdf([-width, width]))
    tolerance = 0.35 * found.standard_error  # 4 standard errors of a 1 % percentile
    np.testing.assert_allclose([found.low, found.high], ends, atol=tolerance)


def test_pairing_narrows_the_ratio(rng):
    x, y = sessions(rng, 300, correlation=0.99)
    paired = ratio_interval(x, y)
    assert paired.half_width < ratio_interval(rng.permutation(x), y).half_width / 4


@pytest.mark.parametrize("count", [40, 400])
def test_subjects_who_differ_widen_the_interval(rng, count):
    subject = np.array([f"s{i}" for i in np.arange(count) % 8])
    person = np.exp(0.5 * rng.standard_normal(8))[np.arange(count) % 8]
    x = person * np.exp(0.1 * rng.standard_normal(count))
    over_subjects = mean_interval(x, subject)
    assert over_subjects.half_width > 1.5 * mean_interval(x).half_width
    assert "8 subjects" in over_subjects.method


def test_resampled_subjects_take_all_their_windows_with_them():
    index = np.array([0] * 3 + [1] * 5 + [2] * 2 + [3] * 4 + [4])
    drawn = []
    replicate = lambda weights: drawn.append(weights) or weights[0]
    sample = Resampling(np.ones(15, bool), index, replicate)
    interval_of(Estimate(1.0, (np.ones(15),), 15, 1.0, sample))
    (weights,) = drawn
    per_subject = np.stack([weights[index == s].sum(axis=0) for s in range(5)])
    times = per_subject / np.bincount(index)[:, None]
    np.testing.assert_array_equal(times, np.round(times))
    np.testing.assert_array_equal(times.sum(axis=0), 5)
    # Each window is drawn once on average; 2,000 replicates of variance about 2.
    np.testing.assert_allclose(weights.mean(axis=1), 1, atol=4 * math.sqrt(2 / 2000))


def test_fewer_than_five_subjects_speak_for_their_windows_only(rng):
    x, y = sessions(rng, 100)
    subject = np.arange(100) % 4
    found = ratio_interval(x, y, subject)
    assert found.method.endswith(
        "100 sessions of 4 subjects: between these windows only"
    )
    assert found.low == ratio_interval(x, y).low
    assert "windows only" not in ratio_interval(x, y, np.arange(100) % 5).method


def with_holes(rng):
    x, y = sessions(rng, 100)
    x[3], y[7], y[8] = np.nan, np.inf, -np.inf
    return x, y


def assert_same(found, expected):
    """Equal but for the rounding of sums that some zeros are added to."""
    assert found.method == expected.method
    for name in ("value", "low", "high", "standard_error"):
        ours, theirs = getattr(found, name), getattr(expected, name)
        np.testing.assert_allclose(ours, theirs, rtol=1e-12)


def test_failed_sessions_are_left_out_pairwise_where_that_is_chosen(rng):
    x, y = with_holes(rng)
    keep = ~np.isin(np.arange(100), [3, 7, 8])
    assert_same(mean_interval(x, nan_policy="omit"), mean_interval(np.delete(x, 3)))
    found = ratio_interval(x, y, nan_policy="omit")
    assert_same(found, ratio_interval(x[keep], y[keep]))
    subject = np.arange(100) % 6
    left = ratio_interval(x, y, subject, nan_policy="omit")
    assert_same(left, ratio_interval(x[keep], y[keep], subject[keep]))
    scenes = np.stack([x, 2 * y]), np.stack([y, y])
    both = geometric_mean_ratio(*scenes, nan_policy="omit")
    np.testing.assert_allclose(both.value, math.sqrt(2 * found.value), rtol=1e-12)
    data = np.stack([x, y, x, y])
    left = log_ratio_derivative_interval(*data, nan_policy="omit")
    assert_same(left, log_ratio_derivative_interval(*data[:, keep]))


def test_failed_sessions_make_all_nan_and_are_counted(rng):
    x, y = with_holes(rng)
    good = np.ones(100)
    for found, bad in (
        (mean_interval(x), 1),
        (mean_interval(y, np.arange(100) % 6), 2),
        (ratio_interval(x, y), 3),
        (ratio_interval(x, good), 1),
        (log_ratio_derivative_interval(good, good, x, y), 3),
        # One scene is whole; sessions are counted once, in however many they failed.
        (geometric_mean_ratio(np.stack([good, x, x]), np.stack([good, y, good])), 3),
    ):
        numbers = [found.value, found.low, found.high, found.standard_error]
        assert np.isnan(numbers).all()
        assert found.method == f"not finite in {bad} of 100 sessions"


@pytest.mark.parametrize("nan_policy", ["propagate", "omit"])
def test_both_policies_agree_where_no_session_failed(rng, nan_policy):
    x, y = sessions(rng, 60)
    assert mean_interval(x, nan_policy=nan_policy) == mean_interval(x)
    assert ratio_interval(x, y, nan_policy=nan_policy) == ratio_interval(x, y)


def test_a_policy_that_is_none_is_refused(untyped):
    policy: Any = "raise"
    message = "nan_policy must be one of propagate, omit, got 'raise'"
    with pytest.raises(ValueError, match=message):
        mean_interval(np.ones(3), nan_policy=policy)


@pytest.mark.parametrize(("level", "has_ratio"), [(0.05, False), (0.0501, True)])
def test_a_ratio_needs_flicker_to_remove(level, has_ratio):
    y = np.full(60, level)
    found = ratio_interval(0.5 * y, y)
    assert math.isfinite(found.value) == has_ratio
    assert (found.method == "no flicker to remove") != has_ratio
    over_scenes = geometric_mean_ratio(0.5 * y[None], y[None])
    assert math.isfinite(over_scenes.value) == has_ratio


def test_geometric_mean_leaves_scenes_without_flicker_out(rng):
    x, y = sessions(rng, 100, shape=(3,))
    x[1], y[1] = 1e-3, 1e-2
    found, expected = (
        geometric_mean_ratio(x, y),
        geometric_mean_ratio(x[[0, 2]], y[[0, 2]]),
    )
    assert found == expected


@pytest.mark.parametrize("count", [5, 100])
def test_what_does_not_vary_has_an_interval_of_no_width(count):
    y = np.linspace(1, 2, count)
    for found, value in (
        (ratio_interval(y, y), 1.0),
        (ratio_interval(0 * y, y), 0.0),
        (mean_interval(0 * y), 0.0),
        (geometric_mean_ratio(y[None], y[None]), 1.0),
        (geometric_mean_ratio(0 * y[None], y[None]), 0.0),
    ):
        assert (found.value, found.low, found.high) == (value, value, value)
        assert found.standard_error == 0


def test_one_session_has_a_value_and_no_interval():
    x, y = np.array([1.0]), np.array([2.0])
    for found, value in (
        (mean_interval(x), 1.0),
        (ratio_interval(x, y), 0.5),
        (geometric_mean_ratio(x[None], y[None]), 0.5),
        (geometric_mean_ratio(0 * x[None], y[None]), 0.0),
    ):
        assert found.value == pytest.approx(value, rel=1e-15)
        assert np.isnan([found.low, found.high, found.standard_error]).all()


def test_no_session_has_nothing_and_says_so():
    none = np.full(3, np.nan)
    for found in (
        mean_interval(none, nan_policy="omit"),
        mean_interval(none[:0]),
        ratio_interval(none, np.ones(3), nan_policy="omit"),
        geometric_mean_ratio(none[None], np.ones((1, 3)), nan_policy="omit"),
        log_ratio_derivative_interval(none, none, none, none, nan_policy="omit"),
    ):
        assert math.isnan(found.value)
        assert found.method.startswith("no session succeeded")


def test_intervals_stay_in_range_and_repeat_themselves(rng):
    x = np.where(rng.random(12) < 0.8, 0.0, 1.0)
    found = mean_interval(x)
    assert found.low >= 0
    for count in (11, 13, 14):  # resampled in between
        mean_interval(np.arange(1.0, count))
    assert mean_interval(x) == found


@pytest.mark.parametrize("count", [50, 1000])
def test_a_spread_far_below_the_mean_keeps_its_digits(rng, count):
    # `x - R y` of the values themselves cancels: 6 digits were lost at 1e-12.
    z = np.round(1000 * rng.normal(size=(2, count)))  # exact in steps of 2^-50
    x, y = 0.5 + z[0] * 2.0**-50, 1 + z[1] * 2.0**-50
    found = ratio_interval(x, y)
    rest = (z - z.mean(axis=1, keepdims=True)) * 2.0**-50
    residual = (rest[0] - found.value * rest[1]) / y.mean()
    expected = math.sqrt(np.sum(residual**2) / (count - 1) / count)
    np.testing.assert_allclose(found.standard_error, expected, rtol=1e-12)


@pytest.mark.parametrize("size", [1e-8, 1e-3, 1.0, 1e6])
def test_what_is_no_spread_is_relative_to_the_sessions(rng, size):
    # It was below 1e-13 code values, so that small sessions had no error.
    z = rng.normal(size=60)
    of = lambda size: mean_interval(size * (1 + 1e-6 * z))
    np.testing.assert_allclose(
        of(size).standard_error, size * of(1.0).standard_error, rtol=1e-8
    )
    assert "no spread" in mean_interval(size * (1 + 1e-15 * z)).method


@pytest.mark.parametrize("count", range(1, 60))
def test_equal_sessions_have_exactly_their_mean(count):
    # A sum of rounded numbers over their count was off: 3 times 0.05 had a ratio.
    for level in (0.1, 1 / 3, MIN_BASELINE_MTCD):
        y = np.full(count, level)
        assert mean_interval(y).value == level
    for found in (
        ratio_interval(y, y),
        geometric_mean_ratio(y[None], y[None]),
        log_ratio_derivative_interval(y, y, y, y),
    ):
        assert found.method == "no flicker to remove"


def test_the_mean_of_the_known_sessions_is_that_of_the_others_left_out(rng):
    x = rng.normal(size=(3, 40))
    known = rng.random((3, 40)) < 0.5
    known[2] = False
    mean, rest = centred(np.where(known, x, np.nan))
    for row in range(2):
        assert mean[row] == pytest.approx(x[row, known[row]].mean(), rel=1e-14)
    np.testing.assert_array_equal(rest[~known], 0)
    np.testing.assert_allclose((mean[:, None] + rest)[known], x[known], rtol=1e-14)
    assert mean[2] == 0


def test_shapes_must_agree(untyped):
    with pytest.raises(ValueError, match=r"one shape, got \(3,\) and \(4,\)"):
        ratio_interval(np.ones(3), np.ones(4))


@pytest.mark.parametrize("count", [400, 24])
def test_log_ratio_derivative_has_the_error_of_a_jackknife(rng, count):
    x, y = sessions(rng, count)
    dx, dy = x * (1 + 0.5 * rng.normal(size=count)), y * rng.normal(size=count)
    found = log_ratio_derivative_interval(x, y, dx, dy)
    without = lambda values: (values.sum() - values) / (count - 1)
    one_out = without(dx) / without(x) - without(dy) / without(y)
    error = math.sqrt((count - 1) * np.var(one_out))
    expected = dx.sum() / x.sum() - dy.sum() / y.sum()
    np.testing.assert_allclose(found.value, expected, rtol=1e-12)
    # They differ by terms of order 1 / count; 2,000 replicates know theirs to 1.6 %.
    np.testing.assert_allclose(found.standard_error, error, rtol=0.02 + 3 / count)
    assert found.low < found.value < found.high


def test_log_ratio_derivative_of_a_scale_is_exact(rng):
    x, y = sessions(rng, 60)
    found = log_ratio_derivative_interval(x, y, 2 * x, -y)
    assert (found.low, found.high, found.standard_error) == (found.value,) * 2 + (0.0,)
    np.testing.assert_allclose(found.value, 3.0, rtol=1e-12)


def test_log_ratio_derivative_needs_flicker(rng):
    x, y = sessions(rng, 60)
    for pair in ((0 * x, y), (x, 0.01 * y)):
        found = log_ratio_derivative_interval(*pair, x, y)
        assert math.isnan(found.value)
        assert found.method == NO_FLICKER


def test_very_many_windows_are_resampled_in_little_memory(rng):
    count = 6000
    x, subjects = rng.lognormal(size=count), rng.integers(0, 6, count)
    tracemalloc.start()
    found = mean_interval(x, subjects)
    _, most_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert "6000 sessions of 6 subjects" in found.method
    # A byte a window and replicate, and some megabytes beside; numbers would take 8.
    assert most_bytes < 4 * 2000 * count


def test_replicates_are_the_same_however_many_are_made_at_a_time(rng, monkeypatch):
    (x, y), subjects = rng.lognormal(size=(2, 40)), np.repeat(np.arange(8), 5)
    x[3] = np.nan
    at_once = ratio_interval(x, y, subjects, nan_policy="omit")
    resampling._times.cache_clear()
    monkeypatch.setattr(resampling, "_AT_A_TIME", 3000)
    in_pieces = ratio_interval(x, y, subjects, nan_policy="omit")
    assert at_once.method == in_pieces.method
    for field in ("value", "low", "high", "standard_error"):
        np.testing.assert_allclose(
            getattr(in_pieces, field), getattr(at_once, field), rtol=1e-13
        )
