import csv
import dataclasses
import math

import numpy as np
import pytest
import xarray
from scipy import stats

from hmdjit.estimates.estimate import combined, control_variate, pairing_gain, ratio
from hmdjit.estimates.intervals import ratio_interval
from hmdjit.estimates.planning import figure_of_merit, interim_level
from hmdjit.estimates.summary import SummaryRow, summarize, write_csv

DESIGN_COLUMNS = (
    "technique,scene,sessions,mean,standard_error,low,high,q05,q50,q95,"
    "ratio,ratio_low,ratio_high,detail_loss"
)
TECHNIQUES = ["msaa4", "head_movement", "freeze", "ssaa4"]
SCENES = ["astronaut", "text", "uniform"]


def study(count=80, techniques=TECHNIQUES, scenes=SCENES, subjects=None):
    """A small study: head_movement leaves 0.6, freeze nothing; `uniform` is still."""
    rng = np.random.default_rng(5)
    level = {"astronaut": 3.0, "text": 7.0, "uniform": 0.01}
    share = {"msaa4": 1.0, "head_movement": 0.6, "freeze": 0.0, "ssaa4": 0.9}
    loss = {"msaa4": 3.0, "head_movement": 5.0, "freeze": 90.0, "ssaa4": 0.0}
    person = np.exp(0.5 * rng.standard_normal(count))
    own = np.exp(0.1 * rng.standard_normal((len(techniques), len(scenes), count)))
    base = np.array([level[s] for s in scenes])[None, :, None]
    shares = np.array([share[t] for t in techniques])[:, None, None]
    losses = np.array([loss[t] for t in techniques])[:, None, None]
    dims = ("technique", "scene", "session")
    coords = {"technique": techniques, "scene": scenes, "session": np.arange(count)}
    if subjects is not None:
        names = [f"subject {i % subjects}" for i in range(count)]
        coords["subject"] = ("session", names)
    return xarray.Dataset(
        {
            "mtcd": (dims, base * shares * person * own),
            "detail_loss": (dims, base * losses * own),
        },
        coords=coords,
        attrs={"baseline": "msaa4", "reference": "ssaa4"},
    )


def by_cell(rows):
    return {(row.technique, row.scene): row for row in rows}


def test_there_is_a_row_per_cell_and_two_pooled_rows_per_technique():
    rows = summarize(study())
    scenes = [*SCENES, "all", "geometric mean"]
    expected = [(t, s) for t in TECHNIQUES for s in scenes]
    assert [(row.technique, row.scene) for row in rows] == expected


def test_a_cell_is_reduced_over_its_sessions():
    data = study()
    x = data["mtcd"].sel(technique="head_movement", scene="text").values
    loss = data["detail_loss"].sel(technique="head_movement", scene="text").values
    row = by_cell(summarize(data))["head_movement", "text"]
    assert row.sessions == 80
    np.testing.assert_allclose(row.mean, x.mean(), rtol=1e-13)
    error = x.std(ddof=1) / math.sqrt(80)
    np.testing.assert_allclose(row.standard_error, error, rtol=1e-13)
    np.testing.assert_allclose(row.high - row.low, 2 * 1.959964 * error, rtol=1e-6)
    quantiles = np.quantile(x, [0.05, 0.5, 0.95])
    np.testing.assert_array_equal([row.q05, row.q50, row.q95], quantiles)
    mean, error = loss.mean(), loss.std(ddof=1) / math.sqrt(80)
    expected = (
        mean,
        error,
        *(mean + side * 1.959963984540054 * error for side in (-1, 1)),
    )
    np.testing.assert_allclose(row.others["detail_loss"], expected, rtol=1e-13)


def test_the_pooled_ratio_is_that_of_scene_averaged_means():
    data = study()
    x = data["mtcd"].sel(technique="head_movement").mean("scene").values
    y = data["mtcd"].sel(technique="msaa4").mean("scene").values
    row = by_cell(summarize(data))["head_movement", "all"]
    np.testing.assert_allclose(row.ratio, x.mean() / y.mean(), rtol=1e-13)
    np.testing.assert_allclose(row.ratio_low, ratio_interval(x, y).low, rtol=1e-13)
    np.testing.assert_allclose(row.q50, np.median(x), rtol=1e-13)


def test_the_geometric_mean_is_over_scenes_that_flicker():
    cells = by_cell(summarize(study()))
    row = cells["head_movement", "geometric mean"]
    ratios = [cells["head_movement", scene].ratio for scene in ("astronaut", "text")]
    np.testing.assert_allclose(row.ratio, math.sqrt(math.prod(ratios)), rtol=1e-13)
    assert row.note == "over 2 of 3 scenes"
    assert math.isnan(row.mean)


def test_the_baseline_has_a_ratio_of_one_and_freeze_of_zero():
    cells = by_cell(summarize(study()))
    for technique, value in (("msaa4", 1.0), ("freeze", 0.0)):
        for scene in ("astronaut", "text", "all", "geometric mean"):
            row = cells[technique, scene]
            found = [row.ratio, row.ratio_low, row.ratio_high]
            assert found == [value] * 3


def test_a_scene_without_flicker_has_no_ratio_and_says_why():
    for technique in TECHNIQUES:
        row = by_cell(summarize(study()))[technique, "uniform"]
        assert np.isnan([row.ratio, row.ratio_low, row.ratio_high]).all()
        assert row.note == "no flicker to remove"
        assert math.isfinite(row.mean)


def test_failed_sessions_are_left_out_and_counted_where_that_was_chosen():
    data = study().assign_attrs(omit_failed=1)
    data["mtcd"][1, 0, :5] = np.nan
    data["mtcd"][0, 0, 4:7] = np.nan
    cells = by_cell(summarize(data))
    assert cells["head_movement", "astronaut"].sessions == 75
    assert cells["head_movement", "astronaut"].note == (
        "ratio over the 73 sessions that succeeded in both"
    )
    assert cells["head_movement", "text"].sessions == 80
    assert cells["head_movement", "all"].sessions == 75
    assert cells["head_movement", "geometric mean"].sessions == 80


def test_older_results_left_out_few_sessions_without_saying_so():
    data = study()
    assert "omit_failed" not in data.attrs
    data["mtcd"][1, 0, :5] = np.nan
    assert by_cell(summarize(data))["head_movement", "astronaut"].sessions == 75


def test_failed_sessions_else_make_what_they_enter_nan():
    data = study().assign_attrs(omit_failed=0)
    expected = by_cell(summarize(data))
    data["mtcd"][1, 0, :5] = np.nan
    data["detail_loss"][2, 1, 7] = np.inf
    cells = by_cell(summarize(data))
    words = "not finite in 5 of 80 sessions"
    for scene in ("astronaut", "all", "geometric mean"):
        row = cells["head_movement", scene]
        numbers = [row.mean, row.q05, row.ratio, row.ratio_low, row.pairing_gain]
        assert np.isnan(numbers).all()
        assert row.note == words
    assert cells["head_movement", "astronaut"].sessions == 75
    lossless = cells[TECHNIQUES[2], "text"]
    assert math.isnan(lossless.others["detail_loss"].mean)
    assert lossless.note == "detail_loss not finite in 1 of 80 sessions"
    # As text, for fields that are NaN are equal so.
    whole = cells["head_movement", "text"]
    assert str(whole) == str(expected["head_movement", "text"])


def test_a_cell_where_every_session_failed_is_empty_and_named():
    data = study().assign_attrs(omit_failed=1)
    data["mtcd"][1, 1] = np.nan
    cells = by_cell(summarize(data))
    empty = cells["head_movement", "text"]
    assert (empty.sessions, empty.note) == (0, "no session succeeded")
    assert np.isnan([empty.mean, empty.q05, empty.ratio]).all()
    assert cells["head_movement", "all"].note == "no session of text"
    assert cells["head_movement", "geometric mean"].note == "over 1 of 3 scenes"
    assert math.isfinite(cells["ssaa4", "all"].ratio)


def test_a_single_session_still_has_a_table():
    cells = by_cell(summarize(study(count=1)))
    row = cells["head_movement", "all"]
    assert row.note == "one session has no interval"
    assert math.isfinite(row.mean)
    assert math.isfinite(row.ratio)
    missing = [row.standard_error, row.low, row.high, row.ratio_low, row.ratio_high]
    assert np.isnan(missing).all()


def test_one_scene_is_its_own_average():
    cells = by_cell(summarize(study(scenes=["text"])))
    one, pooled = cells["head_movement", "text"], cells["head_movement", "all"]
    # As text, for fields that are NaN are equal so.
    assert str(dataclasses.replace(one, scene="all")) == str(pooled)
    assert cells["head_movement", "geometric mean"].ratio == pytest.approx(one.ratio)


def test_replayed_subjects_are_the_clusters():
    over_sessions = by_cell(summarize(study()))["msaa4", "all"]
    over_subjects = by_cell(summarize(study(subjects=8)))["msaa4", "all"]
    assert "8 subjects" in over_subjects.interval
    assert over_subjects.low != over_sessions.low
    few = by_cell(summarize(study(subjects=3)))["msaa4", "all"]
    assert few.interval.endswith("between these windows only")


def test_dimensions_may_come_in_any_order():
    data = study()
    assert str(summarize(data.transpose("session", "technique", "scene"))) == str(
        summarize(data)
    )


@pytest.mark.parametrize("name", ["mtcd", "detail_loss"])
def test_a_metric_over_other_axes_is_refused(name):
    data = study(count=12)
    for other in (data[name].expand_dims(eye=2), data[name][..., 0]):
        message = f"{name} must be over technique, scene, session, got "
        with pytest.raises(ValueError, match=message):
            summarize(data.assign({name: other}))


def test_a_missing_baseline_is_named_with_what_exists():
    data = study()
    data.attrs["baseline"] = "none"
    with pytest.raises(ValueError, match=r"one of msaa4, head_movement.*got 'none'"):
        summarize(data)


@pytest.mark.parametrize("name", ["all", "geometric mean"])
def test_a_scene_named_like_a_pooled_row_is_refused(name):
    data = study().assign_coords(scene=["astronaut", name, "uniform"])
    with pytest.raises(ValueError, match=f"scene must not be named '{name}'"):
        summarize(data)


def test_csv_has_the_designed_columns_and_all_digits(tmp_path):
    data = study().assign_coords(scene=["astro,naut", 'te"xt', "uniform"])
    rows = summarize(data)
    path = write_csv(rows, tmp_path / "new" / "summary.csv")
    with open(path, newline="", encoding="utf-8") as file:
        header, *lines = csv.reader(file)
    assert ",".join(header[:14]) == DESIGN_COLUMNS
    ends = ("standard_error", "low", "high")
    assert header[14:17] == [f"detail_loss_{end}" for end in ends]
    assert header[17:19] == ["interval", "note"]
    assert header[19:] == ["seconds", "figure_of_merit", "pairing_gain"]
    for row, line in zip(rows, lines, strict=True):
        values = list(row.columns().values())
        read = [type(value)(text) for value, text in zip(values, line, strict=True)]
        np.testing.assert_equal(read, values)
    assert path.read_bytes().count(b"\r\n") == len(rows) + 1


def test_results_are_deterministic(tmp_path):
    for count in (20, 80):
        first = write_csv(summarize(study(count)), tmp_path / "a.csv").read_bytes()
        again = write_csv(summarize(study(count)), tmp_path / "b.csv").read_bytes()
        assert first == again


def test_a_failed_write_leaves_the_old_file_and_no_other(tmp_path, monkeypatch):
    class Unwritable:
        def __str__(self):
            raise RuntimeError("unwritable")

    rows = summarize(study())
    path = write_csv(rows, tmp_path / "summary.csv")
    before = path.read_bytes()
    columns = dict.fromkeys(rows[0].columns(), Unwritable())
    monkeypatch.setattr(SummaryRow, "columns", lambda row: columns)
    with pytest.raises(RuntimeError, match="unwritable"):
        write_csv(rows, path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


# --- the head's own error ---


def fitted(data, error=0.06, clusters=12):
    """The study, of a head that people were fitted to: 0.06 of what it turns."""
    level = data["mtcd"].sel(technique="msaa4", scene="text").values
    about = {"head_fit_error": error, "head_fit_over": f"{clusters} subjects"}
    about["head_fit_clusters"] = clusters
    return data.assign(rotation_deg=("session", 0.003 * level)).assign_attrs(about)


@pytest.mark.parametrize("count", [20, 80])
def test_intervals_hold_how_unsure_a_fitted_head_is(count):
    # Theirs was the spread of sessions alone, a third of what a replay says.
    given = by_cell(summarize(study(count)))
    found = by_cell(summarize(fitted(study(count))))
    t = stats.t.ppf(0.975, 11)
    for scene in ("text", "all"):
        row, alone = found["msaa4", scene], given["msaa4", scene]
        # Flicker is in proportion to rotation: 0.06 of it, to the sessions' own spread.
        step = 0.06 * row.mean
        assert row.mean == alone.mean
        rel = 1e-9 if scene == "text" else 0.05
        error = math.hypot(alone.standard_error, step)
        assert row.standard_error == pytest.approx(error, rel=rel)
        for end, other in ((row.low, alone.low), (row.high, alone.high)):
            half = math.hypot(other - row.mean, t * step)
            assert abs(end - row.mean) == pytest.approx(half, rel=rel)
        assert row.interval == f"{alone.interval}, head of 12 subjects"
    # More sessions do not lessen it.
    assert row.high - row.low > 2 * t * step
    # A ratio hardly moves, what does not flicker and the baseline's not at all.
    row, alone = found["head_movement", "all"], given["head_movement", "all"]
    widened = (row.ratio_high - row.ratio_low) / (alone.ratio_high - alone.ratio_low)
    assert 1 <= widened < 1.3
    frozen = found["freeze", "text"]
    assert (frozen.low, frozen.high, frozen.ratio_low, frozen.ratio_high) == (0,) * 4
    one = found["msaa4", "geometric mean"]
    assert (one.ratio_low, one.ratio_high) == (1, 1)


def test_what_holds_with_a_ratio_holds_with_their_geometric_mean():
    data = study(scenes=["text"])
    data["mtcd"][1] **= 1.5  # else the ratio does not depend on how much heads turn
    cells = by_cell(summarize(fitted(data, error=0.2)))
    one, mean = cells["head_movement", "text"], cells["head_movement", "geometric mean"]
    # The one is symmetric, the other in proportion.
    half = math.sqrt((mean.ratio_high - one.ratio) * (one.ratio - mean.ratio_low))
    assert half == pytest.approx((one.ratio_high - one.ratio_low) / 2, rel=0.02)
    known = by_cell(summarize(data))["head_movement", "text"]
    assert one.ratio_high - one.ratio_low > 1.5 * (known.ratio_high - known.ratio_low)


def test_what_removes_all_flicker_of_a_scene_does_so_with_any_head():
    data = study()
    data["mtcd"].loc["head_movement", "text"] = 0.0
    row = by_cell(summarize(fitted(data)))["head_movement", "geometric mean"]
    assert (row.ratio, row.ratio_low, row.ratio_high) == (0, 0, 0)


def test_intervals_of_a_head_that_is_taken_as_known_say_so():
    expected = by_cell(summarize(study()))["msaa4", "all"]
    row = by_cell(summarize(fitted(study(), error=math.nan)))["msaa4", "all"]
    assert row.interval == f"{expected.interval}, given the head"
    as_before = dataclasses.replace(row, interval=expected.interval)
    assert str(as_before) == str(expected)
    single = by_cell(summarize(fitted(study(count=1))))["msaa4", "all"]
    assert math.isnan(single.low)
    still = by_cell(summarize(fitted(study())))["msaa4", "uniform"]
    assert still.note == "no flicker to remove"


def test_a_goal_holds_a_fitted_head_too():
    given, found = (
        by_cell(summarize(data))["msaa4", "text"]
        for data in (with_goal(), fitted(with_goal()))
    )
    half = math.hypot(given.high - given.mean, stats.t.ppf(0.975, 11) * 0.06 * 7)
    # The rotation follows the flicker of some sessions only: the mean of these.
    assert found.high - found.mean == pytest.approx(half, rel=0.2)
    assert found.figure_of_merit == given.figure_of_merit  # of sessions
    assert found.interval == f"{given.interval}, head of 12 subjects"


# --- metrics ---


def test_further_metrics_have_a_mean_and_an_error_in_their_order(tmp_path):
    data = study(20)
    data = data.assign(sharpness=data["mtcd"] + 1).drop_vars("detail_loss")
    for metrics in (["mtcd", "sharpness"], ["sharpness", "mtcd"], ["sharpness"]):
        rows = summarize(data.assign_attrs(metrics=metrics))
        row = by_cell(rows)["head_movement", "text"]
        values = data[metrics[0]].sel(technique="head_movement", scene="text").values
        assert row.mean == pytest.approx(values.mean(), rel=1e-13)
        ends = ("", "_standard_error", "_low", "_high")
        names = [f"{name}{end}" for name in metrics[1:] for end in ends]
        header = write_csv(rows, tmp_path / "a.csv").read_text().splitlines()[0]
        assert header.split(",")[13:-5] == names
    sharpness = by_cell(summarize(data.assign_attrs(metrics=["mtcd", "sharpness"])))
    mtcd = by_cell(summarize(data.assign_attrs(metrics=["sharpness", "mtcd"])))
    # Few sessions are resampled, whichever metric it is.
    one, other = sharpness["ssaa4", "all"], mtcd["ssaa4", "all"]
    bounds = lambda row: (row.mean, row.standard_error, row.low, row.high)
    assert one.others["sharpness"] == bounds(other)
    assert other.others["mtcd"] == bounds(one)


def test_decibels_are_averaged_as_the_powers_of_errors():
    data = study(60)
    error = data["detail_loss"]
    how = {"units": "dB", "averaged_as": "error power"}
    with np.errstate(divide="ignore"):
        psnr = 10 * np.log10(255**2 / error.values)
    data = data.assign(psnr=(error.dims, psnr, how)).assign_attrs(
        metrics=["mtcd", "detail_loss", "psnr"]
    )
    rows = by_cell(summarize(data))
    for row in rows.values():
        if row.scene == "geometric mean":
            continue
        loss, found = row.others["detail_loss"], row.others["psnr"]
        if loss.mean == 0:  # the reference
            assert found.mean == math.inf
            assert np.isnan(found[1:]).all()
            continue
        decibels = lambda x: 10 * math.log10(255**2 / x)
        np.testing.assert_allclose(
            [found.mean, found.low, found.high],
            [decibels(x) for x in (loss.mean, loss.high, loss.low)],
            rtol=1e-12,
        )
        slope = 10 / math.log(10) / loss.mean
        np.testing.assert_allclose(found.standard_error, slope * loss.standard_error)
    assert any(math.isinf(row.others["psnr"].mean) for row in rows.values())
    assert not any("psnr" in row.note for row in rows.values())


# --- studies with a goal ---


def with_goal():
    """Sessions and paths of each scene's own number; a frozen picture in few."""
    rng, data = np.random.default_rng(8), study(300)
    counts = np.tile([300, 200, 150], (4, 1))
    counts[2] = 100
    beyond = np.arange(300) >= counts[..., None]
    predicted = data["mtcd"].values * np.exp(0.1 * rng.standard_normal((4, 3, 300)))
    paths = 3 * np.exp(rng.standard_normal((4, 3, 500)))
    paths[:, 1, 400:] = np.nan
    slope, share = rng.uniform(0.8, 1.2, (4, 3)), rng.uniform(0.4, 0.9, (4, 3))
    slope[2], share[2] = 0, np.nan
    cell = ("technique", "scene")
    return data.where(xarray.DataArray(~beyond, dims=(*cell, "session"))).assign(
        predicted=((*cell, "session"), predicted),
        predicted_extra_paths=((*cell, "extra_path"), paths),
        control_slope=(cell, slope),
        between_session_share=(cell, share),
        simulated_sessions=(cell, counts),
        interim_analyses=("scene", [1, 3, 2]),
        seconds=("scene", [2.0, 3.0, 4.0]),
    )


def test_a_study_with_a_goal_has_control_variates_and_an_analysis_level():
    data = with_goal().assign_attrs(omit_failed=0)
    cells = by_cell(summarize(data))
    names = ("mtcd", "predicted", "predicted_extra_paths", "control_slope")

    def estimate(t, s):
        y, predicted, paths, slope = (data[name].values[t, s] for name in names)
        known = np.isfinite(y)
        paths = paths[np.isfinite(paths)]
        return control_variate(y[known], predicted[known], paths, float(slope))

    means = [[estimate(t, s) for s in range(3)] for t in range(2)]
    x, y = means[1][1], means[0][1]
    pooled_x, pooled_y = (combined([1 / 3] * 3, scenes) for scenes in means[::-1])
    for scene, of, base, analyses, seconds in (
        ("text", x, y, 3, 3.0),
        ("all", pooled_x, pooled_y, 3, 9.0),
    ):
        row, paired = cells["head_movement", scene], ratio(of, base)
        assert row.mean == pytest.approx(of.value, rel=1e-13)
        step = interim_level(analyses) * of.standard_error
        assert row.high - row.mean == pytest.approx(step, rel=1e-10)
        step = interim_level(analyses) * paired.standard_error
        assert row.ratio_high - paired.value == pytest.approx(step, rel=1e-10)
        merit = figure_of_merit(of, seconds)
        assert row.figure_of_merit == pytest.approx(merit, rel=1e-10)
        assert row.pairing_gain == pytest.approx(pairing_gain(of, base), rel=1e-10)
    assert cells["msaa4", "text"].interval == "normal, 2.73 standard errors"
    assert cells["head_movement", "text"].sessions == 200
    assert cells["head_movement", "all"].sessions == 150
    assert math.isnan(cells["head_movement", "all"].q50)
    timed = summarize(data.assign_attrs(budget_s=9.0))
    assert timed[0].interval == "normal, 1.96 standard errors"


def test_what_a_frozen_picture_shows_is_known_without_a_goal_for_it():
    cells = by_cell(summarize(with_goal()))
    row = cells["freeze", "text"]
    assert (row.sessions, row.mean, row.high, row.q95, row.ratio) == (100, 0, 0, 0, 0)
    assert cells["freeze", "geometric mean"].note == "no scene has a positive ratio"
    row = cells["head_movement", "geometric mean"]
    assert math.isfinite(row.ratio_low)


def test_quantiles_are_drawn_towards_the_mean_by_the_sessions_between_session_share():
    data = with_goal()
    values = data["mtcd"].values[1, 0]
    raw = np.quantile(values, [0.05, 0.95])
    share = math.sqrt(data["between_session_share"].values[1, 0])
    row = by_cell(summarize(data))["head_movement", "astronaut"]
    expected = values.mean() + share * (raw - values.mean())
    np.testing.assert_allclose([row.q05, row.q95], expected, rtol=1e-12)


def test_with_a_goal_a_session_that_failed_for_one_technique_counts_for_none():
    whole = with_goal()
    data = whole.copy(deep=True)
    data["mtcd"][1, 0, 5] = np.nan
    cells = by_cell(summarize(data.assign_attrs(omit_failed=1)))
    assert cells["head_movement", "astronaut"].sessions == 299
    assert cells["msaa4", "astronaut"].sessions == 299
    assert cells["msaa4", "text"].sessions == 200
    cells = by_cell(summarize(data.assign_attrs(omit_failed=0)))
    for scene in ("astronaut", "all", "geometric mean"):
        row = cells["head_movement", scene]
        assert np.isnan([row.mean, row.low, row.q05, row.ratio, row.ratio_high]).all()
        assert row.note == "not finite in 1 of 300 sessions"
    assert math.isfinite(cells["msaa4", "all"].ratio)
