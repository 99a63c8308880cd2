import csv
import dataclasses
import math

import numpy as np
import pytest
import xarray

from hmdjit.estimates import summary as results
from hmdjit.estimates.intervals import ratio_interval
from hmdjit.estimates.summary import summarize, write_csv

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
    np.testing.assert_allclose(row.detail_loss, loss.mean(), rtol=1e-13)
    error = loss.std(ddof=1) / math.sqrt(80)
    np.testing.assert_allclose(row.detail_loss_standard_error, error, rtol=1e-13)


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
    assert math.isnan(lossless.detail_loss)
    assert lossless.note == "not finite in 1 of 80 sessions"
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
    assert dataclasses.replace(one, scene="all") == pooled
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
    assert header[14:17] == ["detail_loss_standard_error", "interval", "note"]
    assert header[17:] == ["seconds", "figure_of_merit", "pairing_gain"]
    kinds = [type(value) for value in dataclasses.astuple(rows[0])]
    read = [
        results.SummaryRow(*(kind(v) for kind, v in zip(kinds, line, strict=True)))
        for line in lines
    ]
    assert str(read) == str(rows)  # as text, NaN equals NaN
    assert path.read_bytes().count(b"\r\n") == len(rows) + 1


def test_results_are_deterministic(tmp_path):
    for count in (20, 80):
        first = write_csv(summarize(study(count)), tmp_path / "a.csv").read_bytes()
        again = write_csv(summarize(study(count)), tmp_path / "b.csv").read_bytes()
        assert first == again


def test_a_failed_write_leaves_the_old_file_and_no_other(tmp_path):
    path = write_csv(summarize(study()), tmp_path / "summary.csv")
    before = path.read_bytes()
    with pytest.raises(TypeError):
        write_csv([1], path)  # pyright: ignore[reportArgumentType]
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
