import dataclasses
import itertools
import json
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray
from heads import models

import hmdjit as hj
from hmdjit.cli import definition
from hmdjit.cli import main as cli
from hmdjit.cli.options import Options
from hmdjit.estimates.cells import Cell
from hmdjit.estimates.planning import interim_level
from hmdjit.estimates.summary import summarize
from hmdjit.reports import study as report
from hmdjit.simulation.session import Result
from hmdjit.studies import runner as running
from hmdjit.studies import sampler as samples
from hmdjit.studies import sequential as until
from hmdjit.studies.failures import FailedSessionsError, Failures
from hmdjit.studies.measured_blocks import CentralCrop, Tiles, WholeFrame
from hmdjit.techniques import FXAA, Freeze, HeadMovement, NoAntialiasing
from hmdjit.theory.control_variates import control_of

HEAD = models(person_sd=0.17)["A"]
CAMERA = hj.Camera(128, 128, 16.0, 60.0)
NOISE = hj.scenes.power_law_noise(size=256, texels_per_deg=8.0)
GREY = hj.scenes.power_law_noise(0.0, deviation=1e-5, size=16, name="grey")
PAIR = (NoAntialiasing(), HeadMovement())


def study(scenes=None, techniques=PAIR, **changes):
    settings = {
        "head": HEAD,
        "camera": CAMERA,
        "measure": Tiles(1, 16),
        "baseline": "none",
        "frames": 4,
        "warmup": 3,
        "oversampling": 1,
    }
    return hj.Study(scenes or {"noise": NOISE}, techniques, **settings | changes)


def rows_of(dataset):
    return {(row.technique, row.scene): row for row in summarize(dataset)}


@pytest.fixture(scope="module")
def precise():
    """Both scenes to 5 %, with all kinds of techniques."""
    events = []
    scenes = {"noise": NOISE, "grey": GREY}
    dataset = study(scenes, (*PAIR, Freeze())).run(
        3, tolerance=0.05, progress=events.append
    )
    return dataset, events


@pytest.mark.slow
def test_every_interval_is_within_the_tolerance(precise):
    rows = rows_of(precise[0])
    for technique in ("none", "head_movement"):
        row = rows[technique, "noise"]
        assert 0 < row.high - row.low <= 2 * 0.05 * row.mean
        assert row.ratio_high - row.ratio_low <= 2 * 0.05 * row.ratio
    for technique in ("none", "head_movement", "freeze"):
        # Relative to nothing there is only the floor.
        assert rows[technique, "grey"].high <= 2 * until.FLOOR_MTCD
        assert math.isnan(rows[technique, "grey"].ratio)
    assert rows["freeze", "noise"].mean == rows["freeze", "noise"].high == 0


class Predictions:
    """Control variates that take each session's number for its path."""

    def __init__(self, techniques):
        self.models = [control_of(technique) for technique in techniques]

    def statistics(self, texture):
        return None if texture is None else object()

    def predict(self, statistics, motion, origins):
        paths = _drawn(motion, 0)[:, None].repeat(2, axis=1)
        return [2 * paths, paths]


def _drawn(numbers, stream):
    """Numbers with mean 4 and variance 1, by hashing."""
    hashed = np.sin(numbers * 12.9898 + 78.233 * stream) * 43758.5453
    return 4 + 12**0.5 * (hashed - np.floor(hashed) - 0.5)


def _simulated(scene, texture, batch):
    """MTCD of 8 and 4 on average, most of which the paths predict."""
    path, rest = _drawn(batch.motion, 0), _drawn(batch.motion, 1) - 4
    return np.stack([np.stack([2 * path + 0.2 * rest, path - 0.1 * rest])] * 2)


def _until(goal, clock, monkeypatch, pair=PAIR):
    """Run a scene until a goal, with a clock of one's own."""
    for module in (until, samples):
        monkeypatch.setattr(module, "time", SimpleNamespace(perf_counter=clock))
    paths = Numbered()
    sampler = FakeSampler(
        pair, Numbered(), paths, Predictions(pair), _simulated, lambda event: None
    )
    failures = Failures(False, 6.0, None)
    scene = until.Until(goal, sampler, 0, 2, failures).scene
    texture: Any = object()
    return scene("noise", texture, clock(), goal.budget_s or 0.0)


def test_a_tolerance_asks_no_clock(untyped, monkeypatch):
    found = []
    for seconds in (1e-6, 0.3):
        ticks = itertools.count()
        clock = lambda ticks=ticks, s=seconds: s * next(ticks) ** 2
        cell, plan = _until(until.Goal(tolerance=0.01), clock, monkeypatch)
        found.append(cell)
        assert plan.estimator == "control variate"
    one, other = found
    for name in ("measured", "predicted", "paths", "slope", "count"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    mean = one.estimate(0, "omit")
    assert mean.value == pytest.approx(8.0, abs=4 * mean.standard_error)
    assert interim_level(1) * mean.standard_error <= 0.01 * mean.value


def test_what_no_theory_knows_is_predicted_as_rendered(untyped, monkeypatch):
    pair = (NoAntialiasing(), FXAA())
    clock = lambda: 0.0
    _, plan = _until(until.Goal(tolerance=0.01), clock, monkeypatch, pair)
    assert "no theory of fxaa: predicted as rendered" in str(plan)
    _, plan = _until(until.Goal(tolerance=0.01), clock, monkeypatch)
    assert "no theory" not in str(plan)


def test_without_a_control_variate_the_plan_says_so(untyped):
    sampler = FakeSampler(PAIR, Numbered(), None, None, _simulated, lambda event: None)
    goal = until.Goal(tolerance=0.05)
    scene = until.Until(goal, sampler, 0, 2, Failures(False, 6.0, None)).scene
    solids: Any = object()
    cell, plan = scene("solids", solids, 0.0, 0.0)
    assert plan.estimator == "simulation"
    assert "paired, without a control variate" in str(plan)
    assert cell.paths.shape[1] == 0
    mean = cell.estimate(0, "omit")
    assert interim_level(1) * mean.standard_error <= 0.05 * mean.value


def test_what_a_budget_allowed_is_repeated(untyped, monkeypatch):
    monkeypatch.setattr(until, "MOST_SESSIONS", 100)  # it asks for no more than it has
    ticks = itertools.count()
    budget = until.Goal(budget_s=0.07)
    cell, plan = _until(budget, lambda: 1e-3 * next(ticks), monkeypatch)
    known = until.with_controls([cell], [plan], budget, [[[0], [1]]], (2, 1, 9999))
    ran = json.loads(known["attributes"]["ran"])
    assert ran == {"noise": [cell.measured.shape[-1], cell.paths.shape[1]]}
    again = until.Goal(repeat=ran)
    other, _ = _until(again, lambda: 7.0 * next(ticks), monkeypatch)
    for name in ("measured", "predicted", "paths", "slope", "count"):
        np.testing.assert_array_equal(getattr(cell, name), getattr(other, name))


COMMAND = [
    *("study", "--no-report", "--seed", "3", "--scenes", "noise"),
    *("--techniques", "none", "head_movement", "--width", "64", "--height", "64"),
    *("--fov", "8", "--frames", "4", "--warmup", "3", "--oversampling", "1"),
    *("--margin", "4"),
]


def _found(folder):
    with xarray.open_dataset(folder / "result.nc", engine="h5netcdf") as dataset:
        return dataset.load()


def _is_within(tolerance, dataset):
    rows = rows_of(dataset)
    for technique in ("none", "head_movement"):
        row = rows[technique, "noise"]
        assert 0 < row.high - row.low <= 2 * tolerance * row.mean
        assert row.ratio_high - row.ratio_low <= 2 * tolerance * row.ratio
    assert 0 < rows["head_movement", "noise"].ratio < 1


def test_a_tolerance_is_kept_from_the_command_line_on(tmp_path, capsys, monkeypatch):
    def run(self, techniques, texture, batch):
        numbers = batch.start + np.arange(batch.size)
        measured = _simulated("noise", None, SimpleNamespace(motion=numbers))
        return [Result({"mtcd": x, "detail_loss": x}) for x in measured[0]]

    monkeypatch.setattr(running.Runner, "run", run)
    monkeypatch.setattr(report, "write_report", lambda *_: [])
    monkeypatch.setattr(definition.scenes, "by_name", lambda name: GREY)
    # The whole frame is predicted by nothing, which would have to be compiled.
    command = [*COMMAND, "--whole-frame", "--out", str(tmp_path)]
    assert not cli.run([*command, "--tolerance", "0.04"])
    assert "noise: simulation, " in capsys.readouterr().out  # the plan
    dataset = _found(tmp_path)
    assert dataset.attrs["tolerance"] == 0.04
    assert dataset.sizes["session"] > samples.LEAST_SESSIONS
    _is_within(0.04, dataset)

    # Another goal does not replace it unasked.
    assert cli.run([*command, "--budget", "0.2s"]) == 2
    assert "other tolerance or budget" in capsys.readouterr().err
    assert not cli.run([*command, "--budget", "0.2s", "--overwrite"])
    (file,) = tmp_path.glob("*.nc")
    assert f"--repeat {file} runs as many again" in unwrapped(capsys.readouterr().out)
    again = [*COMMAND, "--whole-frame", "--out", str(tmp_path / "again")]
    assert not cli.run([*again, "--repeat", str(file)])
    ours, expected = (_found(place) for place in (tmp_path / "again", tmp_path))
    assert ours["mtcd"].equals(expected["mtcd"])
    assert (
        rows_of(ours)["none", "noise"].interval
        == "normal, 1.96 standard errors, given the head"
    )


def unwrapped(text):
    return " ".join(text.split())


@pytest.mark.slow
def test_a_tolerance_is_kept_with_all_there_is(tmp_path):
    tiles = ("--tiles", "1", "--tile-size", "16", "--tolerance", "0.2")
    assert not cli.run([*COMMAND, *tiles, "--out", str(tmp_path)])
    _is_within(0.2, _found(tmp_path))


@pytest.mark.parametrize("goal", [{"tolerance": 0.05}, {"budget": "3s"}])
def test_the_command_line_measures_what_a_study_does(goal):
    options = Options(scenes=("noise",), **goal)
    default = hj.Study({"noise": NOISE}, PAIR, HEAD, baseline="none")
    assert definition.build(options).measure == default.measure


@pytest.mark.slow
def test_the_plan_is_told_and_kept(precise):
    dataset, events = precise
    lines = [event.line for event in events if event.line]
    plans = json.loads(dataset.attrs["plan"])
    assert [plan["scene"] for plan in plans] == ["noise", "grey"]
    assert len(lines) == 2
    for line, plan in zip(lines, plans, strict=True):
        assert line.startswith(f"{plan['scene']}: {plan['estimator']}, ")
        assert plan["interim_analyses"] >= 1
    assert dataset.attrs["tolerance"] == 0.05


@pytest.mark.slow
def test_few_sessions_tell_as_much_as_many(precise):
    ours = rows_of(precise[0])["none", "noise"]
    many = study(sessions=1500).run(4, batch_size=samples.CHUNK)
    expected = rows_of(many)["none", "noise"]
    error = math.hypot(ours.standard_error, expected.standard_error)
    assert abs(ours.mean - expected.mean) < 4 * error  # false alarm 6e-5
    ratio = rows_of(many)["head_movement", "noise"]
    mine = rows_of(precise[0])["head_movement", "noise"]
    spread = math.hypot(mine.ratio_high - mine.ratio, ratio.ratio_high - ratio.ratio)
    assert abs(mine.ratio - ratio.ratio) < 2 * spread


@pytest.mark.slow
def test_sessions_are_those_of_any_other_study(precise):
    dataset, _ = precise
    same = study(sessions=samples.CHUNK).run(3, batch_size=samples.CHUNK)
    ours = dataset["mtcd"].sel(technique=["none", "head_movement"], scene=["noise"])
    np.testing.assert_array_equal(ours[..., : samples.CHUNK], same["mtcd"])


@pytest.mark.slow
def test_a_study_goes_on_where_it_stopped(tmp_path, monkeypatch):
    expected = study().run(5, tolerance=0.1)
    run = running.Runner.run
    calls = []

    def interrupted(self, techniques, texture, batch):
        if batch.start < samples.PILOT_START:
            calls.append(batch.start)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return run(self, techniques, texture, batch)

    with monkeypatch.context() as patch:
        patch.setattr(running.Runner, "run", interrupted)
        with pytest.raises(KeyboardInterrupt):
            study().run(5, out=tmp_path, tolerance=0.1)
    assert len(list(tmp_path.glob("batches/*.npz"))) == 1
    resumed = study().run(5, out=tmp_path, tolerance=0.1)
    clocked = ["seconds"]
    xarray.testing.assert_identical(
        resumed.drop_vars(clocked).drop_attrs(),
        expected.drop_vars(clocked).drop_attrs(),
    )


@pytest.mark.slow
def test_a_budget_ends_in_time_and_says_what_is_known_then():
    dataset = study().run(6, budget_s=6.0)
    assert float(dataset["seconds"].sum()) < 6.0 + 30.0  # compiling and the pilot
    row = rows_of(dataset)["none", "noise"]
    assert row.low < row.mean < row.high
    assert "1.96" in row.interval
    assert dataset.attrs["budget_s"] == 6.0


@pytest.mark.parametrize("measure", [WholeFrame(), CentralCrop(32)])
@pytest.mark.slow
def test_what_is_no_tile_is_simulated_plainly(measure):
    dataset = study(measure=measure).run(0, tolerance=0.2)
    assert json.loads(dataset.attrs["plan"])[0]["estimator"] == "simulation"
    row = rows_of(dataset)["none", "noise"]
    assert row.high - row.low <= 2 * 0.2 * row.mean


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tolerance": 0.1, "repeat": {"noise": (128, 0)}}, "exclude each other"),
        ({"repeat": {"grey": (128, 0)}}, r"must name the scenes of this .* got grey"),
        ({"repeat": '{"noise": [128, 0]}'}, "repeat must be numbers by scene, got '{"),
        ({"repeat": {"noise": 128}}, "of noise must be sessions and paths, got 128"),
        (
            {"repeat": {"noise": (64, 0)}},
            r"sessions of noise must be .* >= 128, got 64",
        ),
        ({"repeat": {"noise": (128, -1)}}, r"paths of noise must be .* >= 0, got -1"),
        ({"tolerance": 0.0}, r"tolerance must lie in \(0, 1\), got 0"),
        ({"tolerance": 1.5}, r"tolerance must lie in \(0, 1\), got 1\.5"),
        ({"tolerance": math.nan}, "tolerance must lie in .* got nan"),
        ({"budget_s": -1.0}, r"budget, s must lie in \(0, inf\), got -1"),
        ({"tolerance": 0.1, "budget_s": 3.0}, "exclude each other"),
    ],
)
def test_wrong_goals_are_refused(options, message, untyped):
    with pytest.raises(ValueError, match=message):
        study().run(0, **options)


def test_recorded_heads_have_no_goal():
    trace = hj.Trace(np.arange(40) / 60, np.tile([1.0, 0, 0, 0], (40, 1)))
    replay = study(head=hj.Replay((trace,)))
    with pytest.raises(ValueError, match="need a head model"):
        replay.run(0, tolerance=0.1)


@pytest.mark.slow
def test_a_tolerance_out_of_reach_is_refused(monkeypatch):
    monkeypatch.setattr(until, "MOST_SESSIONS", 100)
    with pytest.raises(ValueError, match=r"tolerance 0\.05 would take 1.* sessions of"):
        study().run(0, tolerance=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("omit_failed", "who"), [(False, "noise's pilot"), (True, "noise")]
)
def test_heads_that_leave_the_margin_stop_the_study(omit_failed, who):
    restless = study(margin_deg=0.02)
    message = rf"of 128 sessions of {who} gave .*at most 1% may"
    with pytest.raises(FailedSessionsError, match=message):
        restless.run(0, tolerance=0.1, omit_failed=omit_failed)


@pytest.mark.slow
def test_failed_sessions_are_left_out_only_by_choice(precise):
    data = precise[0].copy(deep=True)
    # That a frozen picture was not run further is no failure.
    data["simulated_sessions"][2] = 64
    data["mtcd"][2, :, 64:] = data["detail_loss"][2, :, 64:] = np.nan
    expected = rows_of(data)
    data["mtcd"][1, 0, 5] = np.nan
    rows = rows_of(data)
    assert rows["freeze", "noise"].mean == rows["freeze", "all"].ratio == 0
    for scene in ("noise", "all", "geometric mean"):
        row = rows["head_movement", scene]
        assert np.isnan([row.mean, row.low, row.q05, row.ratio, row.ratio_high]).all()
    assert rows["head_movement", "noise"].note.startswith("not finite in 1 of ")
    for technique, scene in (("none", "noise"), ("head_movement", "grey")):
        # As text, for fields that are NaN are equal so.
        assert str(rows[technique, scene]) == str(expected[technique, scene])

    left = rows_of(data.assign_attrs(omit_failed=1))["head_movement", "noise"]
    whole = expected["head_movement", "noise"]
    assert left.sessions == whole.sessions - 1
    assert 0 < abs(left.mean - whole.mean) < whole.standard_error
    assert 0 < abs(left.ratio - whole.ratio) < whole.ratio_high - whole.ratio


def test_a_session_that_failed_for_one_technique_counts_for_none():
    rng = np.random.default_rng(2)
    simulated, predicted = rng.random((2, 2, 200))
    paths, slope, count = rng.random((2, 300)), np.array([0.5, 0.0]), np.array([200, 9])
    simulated[1, 9:] = np.nan  # not run
    bad = simulated.copy()
    bad[0, 4] = np.nan
    cell = lambda mtcd: Cell(
        np.stack([mtcd, np.abs(mtcd)]), predicted, paths, slope, np.ones(2), count
    )
    assert not cell(simulated).has_failed().any()
    assert np.flatnonzero(cell(bad).has_failed()).tolist() == [4]
    assert cell(simulated).estimate(1, "propagate").value == pytest.approx(
        simulated[1, :9].mean(), rel=1e-14
    )
    assert cell(bad).estimate(1, "omit").value == pytest.approx(
        np.delete(bad[1, :9], 4).mean(), rel=1e-14
    )
    assert math.isnan(cell(bad).estimate(0, "propagate").value)
    assert math.isfinite(cell(bad).estimate(0, "omit").value)


@pytest.mark.slow
def test_quantiles_are_the_sessions_own(precise):
    rows = rows_of(precise[0])
    row = rows["none", "noise"]
    raw = precise[0]["mtcd"].sel(technique="none", scene="noise").values
    low, high = np.nanquantile(raw, [0.05, 0.95])
    assert low < row.q05 < row.q50 < row.q95 < high
    assert rows["freeze", "noise"].q95 == 0


@pytest.mark.parametrize(
    ("text", "expected"),
    [("30s", 30), ("90", 90), ("1.5m", 90), ("2 min", 120), ("1h", 3600), (".5s", 0.5)],
)
def test_times_are_read(text, expected):
    assert definition.seconds(text) == expected


@pytest.mark.parametrize("text", ["", "s", "0s", "-3s", "ten", "3 days", "1e3", "nan"])
def test_no_times_are_refused(text):
    with pytest.raises(ValueError, match=r"budget must be a time above 0, like 30s"):
        definition.seconds(text)


@pytest.mark.exhaustive
@pytest.mark.parametrize("tolerance", [0.05, 0.02])
def test_intervals_cover(tolerance, capsys):
    """Of 200 replications at least 180 cover, means and ratios.

    Nominal is 97.5 % (the first interim analysis) and more. At 95 % the chance of fewer
    than 180 of 200 is 0.2 %, for the six numbers here together below 1.2 %.
    """
    truth = rows_of(study().run(1_000_000, tolerance=tolerance / 10))
    names = [("none", "mean"), ("head_movement", "mean"), ("head_movement", "ratio")]
    covered = dict.fromkeys(names, 0)
    sessions = []
    replications = 200
    for seed in range(replications):
        rows = rows_of(study().run(seed, tolerance=tolerance))
        for technique, number in names:
            row, true = rows[technique, "noise"], truth[technique, "noise"]
            value = getattr(true, number)
            low = row.low if number == "mean" else row.ratio_low
            high = row.high if number == "mean" else row.ratio_high
            covered[technique, number] += low <= value <= high
        sessions.append(rows["none", "noise"].sessions)
    with capsys.disabled():
        for name, count in covered.items():
            print(
                f"\n{tolerance:.0%}: {name} covered {count} of {replications}, "
                f"{np.mean(sessions):.0f} sessions",
                end="",
            )
            if count > 0.995 * replications:
                print(" (more than 99.5 %)", end="")
    assert min(covered.values()) >= 180


def test_plans_read_like_a_sentence():
    plan = until.ScenePlan("grass", "simulation", "it is cheap", 1234, 0, 5.0)
    assert (
        str(plan) == "grass: simulation, 1,234 sessions, 5.0 s expected (it is cheap)"
    )
    paths = dataclasses.replace(plan, paths=5678)
    assert "1,234 sessions and 5,678 predicted paths" in str(paths)


# --- runs that show nothing new ---


# Fakes stand for sessions and textures.
FakeSampler: Any = samples.Sampler
FakeScene: Any = samples.SceneSampler


class Numbered:
    """Sessions that are only numbers."""

    def batch(self, start, size):
        numbers = np.arange(start, start + size)
        origins = np.zeros((size, 1))
        return SimpleNamespace(size=size, motion=numbers, origins=origins)


@pytest.mark.parametrize("sparse", [False, True])
def test_a_run_goes_on_if_it_varies_after_all(untyped, sparse):
    calls = []

    def simulate(scene, texture, batch):
        calls.append(len(batch.motion))
        mtcd = np.where(sparse & (batch.motion == 5), 1.0, 0.0)
        return np.stack([mtcd, mtcd])[:, None]

    techniques = [NoAntialiasing()]
    silent = lambda *event: None
    sampler = FakeSampler(techniques, Numbered(), None, None, simulate, silent)
    scene = FakeScene(sampler, "sparse", None, None)
    scene.close(np.array([True]))
    cell = Cell.plain(np.zeros((2, 1, 0)))
    scene.add_sessions(cell, 256, math.inf)
    assert cell.count.tolist() == [256 if sparse else samples.LEAST_SESSIONS]
    assert sum(calls) == cell.count[0] == cell.measured.shape[-1]
    assert not cell.has_failed().any()
    assert cell.estimate(0, "propagate").value == (1 / 256 if sparse else 0.0)


@pytest.mark.slow
def test_a_budget_is_not_spent_on_what_never_varies():
    frozen = hj.Study(
        scenes={"noise": hj.scenes.power_law_noise()},
        techniques=(Freeze(),),
        baseline="freeze",
        head=hj.HeadMotion.fixating(),
        camera=hj.Camera(64, 64, 8.0, 60.0),
        measure=Tiles(1, 16),
        frames=3,
        warmup=2,
    ).run(0, budget_s=600.0)
    assert frozen.sizes["session"] == samples.LEAST_SESSIONS
    assert not frozen["mtcd"].values.any()


def test_a_pilot_that_varies_once_is_not_overwritten(untyped):
    def simulate(scene, texture, batch):
        first = np.where(batch.motion == samples.PILOT_START, 5.0, 0.0)
        return np.stack([first, first])[:, None]

    silent = lambda *event: None
    runs = [NoAntialiasing()]
    sampler = FakeSampler(runs, Numbered(), None, None, simulate, silent)
    found, predicted, seconds = FakeScene(sampler, "", None, None).pilot()
    assert found[0].sum() == 5.0
    assert found[0].shape == predicted.shape == (1, samples.PILOT_SESSIONS)
    assert seconds > 0
