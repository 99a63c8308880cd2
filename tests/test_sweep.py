import csv
import dataclasses
import re

import jax
import numpy as np
import pytest
import small
import xarray
from matplotlib.text import Text

import hmdjit as hj
from hmdjit.cli import definition
from hmdjit.cli import main as cli
from hmdjit.figures.sweep import draw
from hmdjit.simulation.session import Result
from hmdjit.studies import runner
from hmdjit.sweep.dataset import cells_of, summarized
from hmdjit.sweep.sweep import MOST_CELLS

SEATED = hj.HeadMotion.seated()
FASTER = dataclasses.replace(
    SEATED, speed_rms_deg_s=tuple(2 * s for s in SEATED.speed_rms_deg_s)
)
HEADS = {"seated": SEATED, "faster": FASTER}
AXES = {"head": ["seated", "faster"], "refresh_hz": [60.0, 90.0], "fov_deg": [8.0, 9.0]}


def cell(head="seated", refresh_hz=60.0, fov_deg=8.0, w_min=0.1, **changes):
    techniques = [hj.techniques.NoAntialiasing(), hj.techniques.HeadMovement(w_min)]
    camera = hj.Camera(64, 64, fov_deg, refresh_hz)
    settings = {"head": HEADS[head], "camera": camera, "techniques": techniques}
    return small.study(**settings | changes)


@pytest.fixture(scope="module")
def grid(tmp_path_factory):
    """A sweep of three axes, its folder, and how often its program was traced."""
    folder, traced = tmp_path_factory.mktemp("sweep"), []
    usual, after_cells = runner.one_session, []

    def one_session(*arguments, **named):
        traced.append(named["halo"])
        return usual(*arguments, **named)

    def progress(event):
        if event.done and event.done % 24 == 0:
            after_cells.append(len(traced))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "one_session", one_session)
        dataset = hj.Sweep(cell, AXES).run(3, out=folder, progress=progress)
    return dataset, folder, after_cells


@pytest.fixture
def simulated(monkeypatch):
    """Techniques of each batch that is simulated, but for the simulation itself."""
    batches = []

    def run(self, techniques, source, batch):
        batches.append([technique.id for technique in techniques])
        level = 2.0 + np.arange(batch.size) / batch.size
        scale = {"none": 1.0, "msaa4": 0.9}
        values = [level * scale.get(technique.id, 0.6) for technique in techniques]
        return [Result({"mtcd": one, "detail_loss": 2 * one}) for one in values]

    monkeypatch.setattr(runner.Runner, "run", run)
    monkeypatch.setattr(definition, "_scenes", lambda options: {"noise": small.NOISE})
    return batches


def test_one_program_serves_all_heads_rates_and_fields_of_view(grid):
    _, _, after_cells = grid
    assert len(after_cells) >= 8
    assert len(set(after_cells)) == 1
    assert after_cells[0] > 0


def test_axes_are_dimensions_and_cells_come_apart(grid):
    dataset, folder, _ = grid
    dims = (*AXES, "technique", "scene", "session")
    assert dataset["mtcd"].dims == dims
    assert dataset["mtcd"].shape == (2, 2, 2, 2, 1, 12)
    assert dataset["rotation_deg"].dims == (*AXES, "session")
    assert list(dataset["head"].values) == AXES["head"]
    assert dataset.attrs["seed"] == 3
    assert "fov_deg" not in dataset.attrs  # differs
    points, cells = zip(*cells_of(dataset), strict=True)
    assert points[5] == {"head": "faster", "refresh_hz": 60.0, "fov_deg": 9.0}
    assert cells[5].attrs["fov_deg"] == 9.0
    assert cells[5].attrs["px_per_deg_centre"] < cells[4].attrs["px_per_deg_centre"]
    with xarray.open_dataset(folder / "sweep.nc", engine="h5netcdf") as kept:
        xarray.testing.assert_identical(kept.load(), dataset)
        assert str(summarized(kept)) == str(summarized(dataset))  # NaN differs from NaN


@pytest.mark.slow
def test_a_cell_is_the_study_by_itself(grid):
    dataset, _, _ = grid
    here = dataset.sel(head="faster", refresh_hz=90.0, fov_deg=9.0)
    alone = cell("faster", 90.0, 9.0).run(3)
    for name in ("mtcd", "detail_loss"):
        np.testing.assert_allclose(alone[name], here[name], rtol=1e-4, atol=1e-4)
    np.testing.assert_array_equal(alone["rotation_deg"], here["rotation_deg"])
    # The same person sits down at another rate and another field of view.
    slow = dataset.sel(head="seated", refresh_hz=60.0)["rotation_deg"].values
    np.testing.assert_array_equal(slow[0], slow[1])


def test_it_goes_on_where_it_stopped(grid, simulated):
    dataset, folder, _ = grid
    # More values of an axis: only their cells are run.
    more = AXES | {"fov_deg": [8.0, 9.0, 9.5], "head": ["faster", "seated"]}
    found = hj.Sweep(cell, more).run(3, out=folder)
    assert len(simulated) == 4
    old = found.sel(fov_deg=[8.0, 9.0], head=["seated", "faster"])
    np.testing.assert_array_equal(old["mtcd"], dataset["mtcd"])
    with pytest.raises(ValueError, match=r"result of another study.*fov_deg = 9\.5"):
        hj.Sweep(cell, AXES).run(3, out=folder)
    with pytest.raises(ValueError, match="result of another study"):
        hj.Sweep(cell, more).run(4, out=folder)


def test_what_no_axis_changes_is_simulated_once(simulated):
    axes = {"w_min": [0.1, 0.2, 0.3]}
    dataset = hj.Sweep(cell, axes).run()
    assert simulated == [["none", "head_movement"], *[["head_movement"]] * 2]
    figures = draw(dataset, summarized(dataset))
    (figure,) = figures.values()
    assert list(figures) == ["sweep-w_min"]
    assert [axes.get_title(loc="left") for axes in figure.axes] == [
        "MTCD: ratio to none",
        "detail loss, code values²",
    ]
    assert {axes.get_xlabel() for axes in figure.axes} == {"w min"}


def test_pairs_of_axes_are_heat_maps_with_intervals(grid):
    dataset, _, _ = grid
    figures = draw(dataset, summarized(dataset))
    assert list(figures) == [
        "sweep-head-refresh_hz",
        "sweep-head-fov_deg",
        "sweep-refresh_hz-fov_deg",
    ]
    last = figures["sweep-refresh_hz-fov_deg"]
    words = [text.get_text() for text in last.findobj(Text)]
    assert {"refresh, Hz", "fov, deg", "head_movement"} <= set(words)
    assert any(word.startswith("At head = seated.") for word in words)
    (row,) = [
        row
        for point, row in summarized(dataset)
        if point == {"head": "seated", "refresh_hz": 90.0, "fov_deg": 8.0}
        and (row.technique, row.scene) == ("head_movement", "all")
    ]
    half = (row.ratio_high - row.ratio_low) / 2
    assert f"{row.ratio:.3g}\n±{half:.1g}" in words


def test_all_of_a_sweep_is_checked_first(untyped):
    with pytest.raises(ValueError, match=r"refresh_hz = -1: refresh_hz must lie in"):
        hj.Sweep(cell, {"refresh_hz": [60, -1]})
    with pytest.raises(ValueError, match="axis w_min must be a list of values, got '0"):
        hj.Sweep(cell, {"w_min": "0.1"})
    with pytest.raises(ValueError, match="axis w_min must have each value once"):
        hj.Sweep(cell, {"w_min": [0.1, 0.1]})
    with pytest.raises(
        ValueError, match=f"at most {MOST_CELLS:,} cells, got 1,000,000"
    ):
        hj.Sweep(cell, {"fov_deg": range(1000), "refresh_hz": range(1000)})
    with pytest.raises(ValueError, match="must be the same in all cells"):
        hj.Sweep(
            lambda baseline: cell(baseline=baseline),
            {"baseline": ["none", "head_movement"]},
        )
    trace = hj.Trace(np.arange(90) / 60.0, np.tile([1.0, 0, 0, 0], (90, 1)))
    with pytest.raises(ValueError, match=r"'drawn heads'.*'recorded heads'"):
        hj.Sweep(
            lambda head: small.study(head=head), {"head": [SEATED, hj.Replay((trace,))]}
        )


SWEEP = """
scenes = ["noise"]
techniques = ["none", "head_movement"]
width = 64
height = 64
fov = 8
tiles = 1
sessions = 4
frames = 3
warmup = 1
[head_movement]
w_min = 0.2
"""


def test_the_command_reads_lists_and_ranges(file, tmp_path, capsys, simulated):
    path = file(
        f"{SWEEP}[sweep]\nmargin = {{ from = 4, to = 6, steps = 2 }}\n"
        "head_movement.h_max_deg_s = [4.0, 8.0]\n",
        "grid.toml",
    )
    out = tmp_path / "out"
    assert cli.run(["sweep", str(path), "--out", str(out), "--refresh", "72"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "4 cells (margin, deg: 2; head movement.h max, deg/s: 2)" in printed
    assert "at most 32 simulations. About" in printed
    with xarray.open_dataset(out / "sweep.nc", engine="h5netcdf") as found:
        assert dict(found.sizes) == {
            "margin_deg": 2,
            "head_movement.h_max_deg_s": 2,
            "technique": 2,
            "scene": 1,
            "session": 4,
        }
        assert found["margin_deg"].values.tolist() == [4, 6]
        assert found.attrs["refresh_hz"] == 72.0
    with open(out / "sweep.csv", newline="", encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines))
    assert len(rows) == 4 * 2 * 3
    assert rows[-1]["margin_deg"] == "6"
    assert (out / "sweep-margin_deg-head_movement.h_max_deg_s.png").stat().st_size > 0


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("", r"\[sweep\] must be a table of what varies, got \{\}"),
        (
            "refresh_hz = [60]",
            r"unknown key sweep.refresh_hz. Did you mean .*refresh\?",
        ),
        ("scenes = ['text']", r"sweep must not have scenes: .* list them above"),
        ("fov = 90", "sweep.fov must be a list or a range, got 90"),
        ("fov = [9]", r"fov is said twice, once in \[sweep\]"),
        ("head_movement.w_min = [1]", "w_min is said twice"),
        ("refresh = { from = 1, to = 2, step = 3 }", "step. Did you mean .*steps"),
        ("refresh = { from = 1, to = 2 }", "refresh.steps must be a number, got None"),
        ("refresh = { from = 1, to = inf, steps = 3 }", "refresh.to must lie in"),
        ("refresh = { from = 1, to = 2, steps = 9999999999 }", "steps must lie in"),
        ("refresh = []", r"axis refresh_hz must be a list of values, got \[\]"),
        ("refresh = [60, 'a']", "refresh_hz must be all numbers or words"),
        ("refresh = ['a', 'b']", "refresh must be a number, got 'a'"),
        ("head = ['seated', 'seate']", "head = seate: .*Did you mean 'seated'"),
        ("head_movement.w_mi = [1]", r"unknown key head_movement.w_mi. Did you mean"),
    ],
)
def test_wrong_sweeps_are_told_in_one_line(
    table, message, file, tmp_path, capsys, simulated
):
    path = file(f"{SWEEP}[sweep]\n{table}\n", "grid.toml")
    out = tmp_path / "out"
    assert cli.run(["sweep", str(path), "--out", str(out)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert re.search(message, line), line
    assert not out.exists()


@pytest.mark.parametrize(
    ("axis", "option"),
    [
        ("head = ['seated', 'fixating']", ["--trace", "me.csv"]),
        ("tiles = [1, 2]", ["--crop", "32"]),
        ("fov = [8, 9]", ["--fov", "8"]),
    ],
)
def test_no_option_replaces_an_axis(axis, option, file, capsys, simulated):
    text = SWEEP.replace("fov = 8\n", "").replace("tiles = 1\n", "")
    path = file(f"{text}[sweep]\n{axis}\n", "grid.toml")
    assert cli.run(["sweep", str(path), *option]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{option[0]} must not replace {axis.split()[0]}, an axis" in line, line


def test_an_interrupted_sweep_says_how_to_go_on(
    file, tmp_path, capsys, monkeypatch, simulated
):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(runner.Runner, "run", interrupt)
    path = file(f"{SWEEP}[sweep]\nrefresh = [60, 90]\n", "grid.toml")
    assert cli.run(["sweep", str(path), "--out", str(tmp_path / "out")]) == 130
    error = capsys.readouterr().err
    assert re.fullmatch(r"hmdjit: stopped;[^\n]*run the same command[^\n]*\n", error)


@pytest.mark.slow
def test_sessions_of_a_replay_differ_between_cells(simulated):
    def replayed(rows):
        poses = np.asarray(SEATED.sample(jax.random.key(rows), 60.0, rows))
        trace = hj.Trace(np.arange(rows) / 60.0, poses, subject=f"of {rows}")
        return small.study(head=hj.Replay((trace,)))

    dataset = hj.Sweep(replayed, {"rows": [30, 80]}).run()
    assert dataset["sessions"].values.tolist() == [4, 11]
    assert dataset["subject"].values[0, 4:].tolist() == [""] * 7
    (_, first), (_, second) = cells_of(dataset)
    assert (first.sizes["session"], second.sizes["session"]) == (4, 11)
    assert np.isfinite(first["mtcd"]).all()
