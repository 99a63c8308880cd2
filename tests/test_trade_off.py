import contextlib
import dataclasses
import itertools
import math
import re

import jax
import jax.numpy as jnp
import numpy as np
import PIL.Image
import pytest
import small
from hypothesis import given
from hypothesis import strategies as st

import hmdjit as hj
from hmdjit.cli import main as cli
from hmdjit.estimates.intervals import Z95
from hmdjit.figures import trade_off as trade_off_figure
from hmdjit.figures.drawing import save
from hmdjit.frames.displacement import GATHER, Reading
from hmdjit.studies.measured_blocks import CentralCrop, Tiles, WholeFrame
from hmdjit.trade_off import choice, knobs, measurement, settings, trade_off
from hmdjit.trade_off.settings import Case, EverySample, Setting
from hmdjit.trade_off.trade_off import Row

IDENTITY = dict.fromkeys(trade_off.IDENTITY, "0") | {
    "scene": "text",
    "head": "a head, with a comma",
    "study_options": "--scenes text --head fixating",
}


def row(name="some", *, bias=0.0, sd=0.5, cost=0.01, mean=1.0, **changes):
    """A row of round numbers."""
    values = {
        "setting": name,
        "knob": "texture",
        "technique": "head_movement",
        "dtype": "float32",
        "sessions": 100,
        "mtcd": mean + bias,
        "mtcd_sd": sd,
        "bias": bias,
        "bias_se": 0.0,
        "bias_by": "same pixels",
        "reference_mtcd": mean,
        "frame_difference": bias,
        "frame_difference_se": 0.01,
        "detail_loss": 3.0,
        "detail_loss_sd": 0.1,
        "detail_loss_bias": 0.0,
        "detail_loss_bias_se": 0.0,
        "seconds": 100 * cost,
        "s_per_session": cost,
        "compile_s": 2.0,
        "bake_s": 1.0,
        "is_other_device": False,
        "setting_options": "--tiles 2 --tile-size 64 --oversampling 2",
        "python_fields": "",
        "identity": IDENTITY,
    }
    return Row(**(values | changes))


def tiny_study(**changes):
    values = {
        "scenes": {"board": hj.scenes.checkerboard()},
        "techniques": [hj.techniques.NoAntialiasing()],  # the quickest to compile
        "head": hj.HeadMotion.fixating(),
        "camera": hj.Camera(64, 64, 8.0, 60.0),
        "frames": 3,
        "warmup": 1,
        "measure": Tiles(1, 32),
        "baseline": "none",
    }
    return hj.Study(**(values | changes))


# The front.

coordinates = st.sampled_from([0.5, 1.0, 1.5, 2.0, 3.0, math.nan])


@given(st.lists(st.tuples(coordinates, coordinates), max_size=12))
def test_the_front_is_what_nothing_dominates(points):
    def is_dominated(p):
        return any(
            q[0] <= p[0] and q[1] <= p[1] and q != p
            for q in points
            if not any(map(math.isnan, q))
        )

    expected = [not any(map(math.isnan, p)) and not is_dominated(p) for p in points]
    found = trade_off.pareto_front(np.array(points, float).reshape(-1, 2))
    assert found.tolist() == expected


def test_another_device_is_never_on_the_front():
    slow = row("slow", cost=1.0)
    other = row("other", cost=1e-3, is_other_device=True)
    assert trade_off.front_of([other, slow]) == [slow]


def test_negligible_biases_count_as_equal():
    exact = row("exact", cost=0.02)
    nearly = row("nearly", cost=0.01, bias=1e-6)
    assert trade_off.front_of([exact, nearly]) == [nearly]


# The error.


def test_the_error_is_bias_and_monte_carlo_error():
    # 3 % of bias; 100 sessions of 40 % in a second leave 4 %.
    assert trade_off.total_error(0.03, 0.4, 0.01, 1.0) == pytest.approx(0.05)
    assert row(bias=-0.06, sd=0.8, cost=0.01, mean=2.0).error(1.0) == pytest.approx(
        0.05
    )
    assert trade_off.total_error(0.0, 0.5, 0.1, 1e9) < 1e-5


def test_seconds_to_a_monte_carlo_error():
    # 50 % of spread to 1 %: 2500 sessions.
    assert row(sd=0.5, cost=0.01).seconds_to(0.01) == pytest.approx(25.0)
    assert math.isnan(row(mean=0.0).seconds_to(0.01))


# The choice.


def test_a_tolerance_is_reached_at_the_least_cost():
    fast = row("fast", cost=0.001, bias=0.03)
    good = row("good", cost=0.01, bias=0.01)
    best = row("best", cost=0.05)
    found = choice.candidates([fast, good, best])
    picked = choice.pick_tolerance(found, 0.05)
    assert picked.setting == "fast"
    for tolerance in (0.05, 0.02, 0.005):
        picked = choice.pick_tolerance(found, tolerance)
        assert picked.error <= tolerance
        chosen = picked.rows[0]
        fewer = abs(chosen.bias) + Z95 * chosen.mtcd_sd / math.sqrt(picked.sessions - 1)
        assert fewer > tolerance  # not one session too many
        assert picked.seconds == pytest.approx(picked.sessions * chosen.s_per_session)
    # 2 % by `good`: 1 % is left for chance, 9604 sessions; by `best`: 2401, 5 times as
    # dear: 96 against 120 s.
    assert choice.pick_tolerance(found, 0.02).setting == "good"
    assert choice.pick_tolerance(found, 0.005).setting == "best"


def test_a_budget_buys_the_smallest_error():
    fast, best = row("fast", cost=0.001, bias=0.03), row("best", cost=0.05)
    found = choice.candidates([fast, best])
    assert choice.pick_budget(found, 1.0).setting == "fast"
    picked = choice.pick_budget(found, 1000.0)
    assert (picked.setting, picked.sessions) == ("best", 20000)
    assert picked.seconds <= 1000.0


def test_what_is_not_known_of_a_bias_counts():
    lucky = row("lucky", cost=0.001, bias_se=0.02)
    sure = row("sure", cost=0.01)
    found = choice.candidates([lucky, sure])
    assert choice.pick_tolerance(found, 0.03).setting == "sure"


def test_ties_go_to_the_smaller_error_then_to_the_first():
    found = choice.candidates([row("a"), row("b")])
    assert choice.pick_tolerance(found, 0.05).setting == "a"
    assert choice.pick_budget(found, 5.0).setting == "a"
    # As cheap at 2 sessions each, but one is nearer.
    near, far = row("near", sd=1e-4), row("far", sd=1e-4, bias=0.01)
    found = choice.candidates([far, near])
    assert choice.pick_tolerance(found, 0.05).setting == "near"


def test_nothing_fits():
    found = choice.candidates([row("good", bias=0.01), row("bad", bias=0.03)])
    with pytest.raises(ValueError, match=r"0.005: the bias of the best, good, .* 0.01"):
        choice.pick_tolerance(found, 0.005)
    with pytest.raises(ValueError, match=r"two sessions in 0.01 s: .* needs 0.02 s"):
        choice.pick_budget(found, 0.01)
    with pytest.raises(ValueError, match="no setting has flicker"):
        choice.pick_tolerance([], 0.01)


def test_a_setting_must_do_for_all_techniques():
    both = [row("both", knob="default"), row("both", technique="none", knob="default")]
    one = row("one", cost=1e-4)
    worse = row("worse"), row("worse", technique="none", bias=0.2)
    other = row("other", is_other_device=True)
    found = choice.candidates([*both, one, *worse, other])
    assert [rows[0].setting for rows in found] == ["both", "worse"]
    picked = choice.pick_tolerance(found, 0.05)
    assert picked.setting == "both"
    assert picked.seconds == pytest.approx(picked.sessions * 0.02)
    only = choice.candidates([*both, one], ["head_movement"])
    assert choice.pick_tolerance(only, 0.05).setting == "one"


# The file.


def test_a_file_holds_all_of_the_rows(tmp_path):
    rows = [
        row("a, b", bias=1 / 3),
        row('"c"', is_other_device=True, python_fields="x"),
    ]
    path = trade_off.write_csv(rows, tmp_path / "new" / "rows.csv")
    assert trade_off.read_csv(path) == rows
    unknown = trade_off.write_csv([row(bias=math.nan)], tmp_path / "nan.csv")
    assert math.isnan(trade_off.read_csv(unknown)[0].bias)


# The settings.


def test_settings_say_how_a_study_realises_them():
    camera = hj.Camera(1024, 1024, 96.0, 60.0)
    usual = Setting("s", "k", Tiles(4, 32), 4)
    size = "--width 1024 --height 1024"
    assert usual.study_options(camera) == (
        f"{size} --tiles 4 --tile-size 32 --oversampling 4"
    )
    assert usual.python_fields() == ""
    half = dataclasses.replace(usual, measure=WholeFrame(), shrink=2, dtype="float64")
    assert half.study_options(camera) == (
        "--width 512 --height 512 --whole-frame --oversampling 4"
    )
    assert half.python_fields() == "bake(dtype=jnp.float64)"
    crop = dataclasses.replace(
        usual,
        measure=CentralCrop(256),
        reading=Reading(usual.reading.sampler, warp="shift"),
    )
    assert "--crop 256" in crop.study_options(camera)
    assert crop.python_fields() == 'Reading(warp="shift")'
    assert [s.samples_frame() for s in (usual, half, crop)] == [True, False, False]


@pytest.mark.parametrize("moves", [True, False])
def test_solids_have_knobs_of_their_own(moves):
    still = {} if moves else {"movement": None}
    study = tiny_study(
        scenes={"solids": small.solids(**still)},
        techniques=[hj.techniques.MSAA(), hj.techniques.NoAntialiasing()],
        reference_every=2,
    )
    cases, _ = settings.cases(study, knobs.single_knobs(study), is_with_samples=True)
    by_name = {case.setting.name: case.setting for case in cases}
    assert by_name["reference"].reading.reference_samples == 64
    camera, half = study.display, "--width 64 --height 64 --tiles 1 --tile-size 32"
    options = by_name["reference of 4 rays"].study_options(camera)
    assert options == f"{half} --reference-samples 4 --reference-every 2"
    assert by_name["reference every 3"].python_fields() == ""
    # MSAA is no technique of pictures, and is not baked.
    of = lambda name: [c.technique.id for c in cases if c.setting.name == name]
    assert of("reference") == ["msaa4", "none"]
    assert of("baked, texture 2x") == ([] if moves else ["none"])
    if not moves:
        assert "--baked --no-neck" in by_name["baked, texture 2x"].study_options(camera)


@pytest.mark.slow
def test_baking_and_a_rough_reference_are_measured_beside_rays():
    study = tiny_study(scenes={"solids": small.solids(movement=None)})
    names = ("reference of 4 rays", "reference every 1", "baked, texture 4x")
    chosen = [one for one in knobs.single_knobs(study) if one.name in names]
    cases, _ = settings.cases(study, chosen)
    rows = {r.setting: r for r in measurement.measure(study, cases, sessions=4)}
    assert rows["reference of 4 rays"].bias == rows["default"].bias
    assert rows["reference of 4 rays"].detail_loss_bias > 0  # its own noise
    baked, usual = rows["baked, texture 4x"], rows["default"]
    assert abs(baked.bias) < 0.3 * baked.reference_mtcd  # no neck, and texels
    assert abs(usual.bias) < 1e-3 * usual.reference_mtcd


def test_cases_begin_with_the_reference_and_leave_out_what_does_not_fit():
    study = tiny_study(
        techniques=[hj.techniques.HeadMovement(), hj.techniques.MSAA()],
        baseline="msaa4",
    )
    every = [*knobs.single_knobs(study), *knobs.combinations(study)]
    cases, misfits = settings.cases(
        study, every, also=[hj.techniques.SSAA()], is_with_samples=True
    )
    ids = [case.technique.id for case in cases if case.setting.name == "reference"]
    assert ids == ["head_movement", "none", "ssaa4"]
    assert [case.setting.name for case in cases[:3]] == ["reference"] * 3
    assert "crop of 256 px" in misfits
    assert "4 tiles of 64 px" in misfits
    assert not [
        case
        for case in cases
        if case.setting.knob == "history filter" and case.technique.id == "none"
    ]
    textures = [case.setting.texture() for case in cases]
    changes = sum(a != b for a, b in itertools.pairwise(textures))
    assert changes == len(set(textures)) - 1  # each is baked once


def test_every_sample_is_what_ssaa_shows_of_samples():
    frame = hj.Frame(
        jnp.linspace(0, 1, 4 * 3 * 2 * 2).reshape(4, 3, 2, 2),
        hj.Camera(2, 2, 8.0, 60.0),
        hj.Region(0, 0, 2, 2),
    )
    mine, theirs = EverySample(2), hj.techniques.SSAA(2)
    np.testing.assert_array_equal(mine.resolve(frame), theirs.resolve(frame))
    assert not EverySample(4).reads_supersampled


def test_short_texels_are_painted_in_float32():
    camera, scene = hj.Camera(48, 32, 8.0, 60.0), hj.scenes.checkerboard()
    short = hj.scenes.bake(scene, camera, margin_deg=1.0, dtype=jnp.bfloat16)
    full = hj.scenes.bake(scene, camera, margin_deg=1.0)
    assert short.color_texels.dtype == jnp.bfloat16
    # Half a unit in the last of 8 bits, relative.
    np.testing.assert_allclose(
        np.asarray(short.color, np.float32), full.color, rtol=2.0**-8
    )
    still = np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
    technique = hj.techniques.NoAntialiasing()
    result = jax.eval_shape(lambda: hj.simulate(short, camera, technique, still))
    assert result.mtcd.dtype == jnp.float32


# Measuring.


@pytest.fixture(scope="module")
def measured():
    study, technique = tiny_study(), hj.techniques.NoAntialiasing()
    tile = Tiles(1, 32)
    chosen = [
        Setting("reference", "reference", tile, 4, "float64", GATHER),
        Setting("default", "default", tile, reading=GATHER),
        Setting("4 tiles", "tiles", Tiles(4, 32), reading=GATHER),
        Setting("half resolution", "resolution", tile, reading=GATHER, shrink=2),
    ]
    cases = [Case(setting, technique, technique) for setting in chosen]
    events = []
    rows = list(measurement.measure(study, cases, sessions=4, progress=events.append))
    return {row.setting: row for row in rows}, events


def test_the_reference_has_no_bias_against_itself(measured):
    reference = measured[0]["reference"]
    assert (reference.bias, reference.bias_se) == (0.0, 0.0)
    assert (reference.detail_loss_bias, reference.detail_loss_bias_se) == (0.0, 0.0)
    assert reference.dtype == "float64"


def test_bias_is_measured_on_the_same_pixels_where_that_is_possible(measured):
    rows, _ = measured
    default, tiles, half = rows["default"], rows["4 tiles"], rows["half resolution"]
    assert default.bias_by == "same pixels"
    assert default.bias == pytest.approx(default.mtcd - default.reference_mtcd)
    assert default.bias_se < math.hypot(default.mtcd_sd, rows["reference"].mtcd_sd) / 2
    assert tiles.bias_by == "same pixels, other tiles"
    assert (tiles.bias, tiles.bias_se) == (default.bias, default.bias_se)
    assert tiles.frame_difference != default.frame_difference
    assert half.bias_by == "frame mean"
    assert half.bias == half.frame_difference
    assert "--width 32 --height 32" in half.setting_options


def test_rows_say_what_they_cost_and_on_what(measured):
    rows, events = measured
    for one in rows.values():
        assert one.sessions == 4
        assert one.s_per_session == pytest.approx(one.seconds / 4)
        assert one.seconds > 0
        assert one.identity["scene"] == "board"
    assert any("compiling" in event.doing for event in events)
    assert events[-1].total == 4


@pytest.mark.slow
def test_a_setting_is_the_study_that_it_names(measured):
    study = dataclasses.replace(tiny_study(), sessions=4)
    data = study.run(seed=0)
    found = float(data["mtcd"].mean())
    # Programs of other batch sizes and margins give the same numbers, up to rounding.
    assert measured[0]["default"].mtcd == pytest.approx(found, rel=1e-5)


def test_a_picture_is_drawn_of_any_rows(tmp_path):
    for rows in (
        [row()],
        [row("a"), row("b", bias=0.1, bias_by="frame mean", cost=1e-3)],
        [row("a", technique=t, knob="default") for t in ("none", "head_movement")],
    ):
        path = save(trade_off_figure.draw(rows), tmp_path / "figure.png")
        with PIL.Image.open(path) as picture:
            assert picture.width > 1000
    with pytest.raises(ValueError, match="a setting with flicker"):
        trade_off_figure.draw([row(mean=0.0)])


# The commands.


def test_a_choice_is_printed_with_its_command(tmp_path, capsys):
    # The cheaper one cannot be asked of a study.
    rows = [row("plain", knob="default"), row("odd", cost=1e-4, python_fields="P(1)")]
    file = trade_off.write_csv(rows, tmp_path / "rows.csv")
    assert cli.run(["pick", "--budget", "10s", "--from", str(file)]) == 0
    printed = capsys.readouterr().out
    assert "Setting: plain" in printed
    assert (
        "hmdjit study --scenes text --head fixating --tiles 2 --tile-size 64 "
        "--oversampling 2 --techniques head_movement --sessions" in printed
    )


WRONG = [
    (["pick", "--tolerance", "0.02"], r"run `hmdjit trade-off` first"),
    (["pick", "--tolerance", "2"], r"tolerance must lie in \(0, 1\), got 2"),
    (["pick", "--tolerance", "0.0001", "--from", "{rows}"], r"the best, plain, is"),
    (["pick", "--budget", "soon"], r"a time above 0, like 30s, 5m or 1h, got 'soon'"),
    (["pick"], r"name either --tolerance"),
    (["pick", "--budget", "1s", "--from", "{text}"], r"not a table of `hmdjit trade"),
    (
        ["pick", "--budget", "1s", "--from", "{rows}", "--technique", "non"],
        r"technique must be one of head_movement, got 'non'",
    ),
    (["trade-off", "--scene", "txt"], r"Did you mean 'text'"),
    (["trade-off", "--sessions", "1"], r"sessions must be a whole number >= 2, got 1"),
    (["trade-off", "--technique", "taa"], r"technique must be one of"),
    (["trade-off", "--images", "{missing}"], r"missing.png"),
    (["trade-off", "--out", "{text}/out"], r"out must be where files can be made"),
]


@pytest.mark.parametrize(("arguments", "message"), WRONG)
def test_wrong_inputs_end_in_one_clear_line(
    arguments, message, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    rows = trade_off.write_csv([row("plain", bias=0.01)], tmp_path / "rows.csv")
    (tmp_path / "notes.txt").write_text("no, table\n1, 2\n")
    places = {
        "rows": rows,
        "text": tmp_path / "notes.txt",
        "missing": tmp_path / "missing.png",
    }
    assert cli.run([argument.format(**places) for argument in arguments]) == 2
    error = capsys.readouterr().err.strip()
    assert error.startswith("hmdjit: error: ")
    assert "\n" not in error
    assert re.search(message, error), error
    assert not (tmp_path / "hmdjit-trade-off").exists()


def test_an_interruption_keeps_what_is_measured(tmp_path, capsys, monkeypatch):
    def interrupted(*_, **__):
        yield row("first")
        raise KeyboardInterrupt

    monkeypatch.setattr(measurement, "measure", interrupted)
    out = tmp_path / "out"
    assert cli.run(["trade-off", "--out", str(out)]) == cli.INTERRUPTED
    assert "hmdjit: stopped; 1 of 30 rows are kept" in capsys.readouterr().err
    assert [r.setting for r in trade_off.read_csv(out / "trade_off.csv")] == ["first"]


@pytest.mark.slow
def test_the_commands_from_end_to_end(tmp_path, capsys):
    out = tmp_path / "out"
    size = ["--width", "128", "--height", "128", "--fov", "16"]
    small = [*size, "--sessions", "4", "--out", str(out)]
    with contextlib.chdir(tmp_path):
        assert cli.run(["trade-off", "--quick", *small]) == 0
    printed = capsys.readouterr().out
    assert "texture 4x" in printed
    assert "crop" not in printed
    with PIL.Image.open(out / "trade_off.png") as picture:
        assert picture.width > 1000
    rows = trade_off.read_csv(out / "trade_off.csv")
    assert {"reference", "default", "texture 1x"} <= {r.setting for r in rows}
    file = ["--from", str(out / "trade_off.csv")]
    assert cli.run(["pick", "--tolerance", "0.2", *file]) == 0
    assert "hmdjit study --scenes text" in capsys.readouterr().out
