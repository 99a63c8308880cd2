import re
import tomllib
from pathlib import Path

import jax
import numpy as np
import pytest
from matplotlib.image import imread, imsave
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

import hmdjit as hj
from hmdjit.cli import definition
from hmdjit.cli import main as cli
from hmdjit.head_fitting import fitting

MODEL = """speed_rms_deg_s = [1.0, 0.8, 0.6]
correlation_time_s = [0.15, 0.2, 0.1]
tracker_noise_deg = [0.004, 0.004, 0.003]
"""
TURNING = """speed_rms_deg_s = [0, 1, 0]
correlation_time_s = [0.1, 0.1, 0.1]
tracker_noise_deg = [0, 0, 0]
"""
SHORT = ("--seconds", 4, "--rate", 30)


def write_trace(path, seconds=40.0, rate_hz=30.0, seed=0, speed_deg_s=(1.0, 0.8, 0.6)):
    """Write a head whose velocity is correlated for 0.15 s, with no help of hmdjit."""
    rng = np.random.default_rng(seed)
    count, memory = round(seconds * rate_hz), np.exp(-1 / (0.15 * rate_hz))
    noise = np.sqrt(1 - memory**2) * rng.standard_normal((count, 3))
    velocity = lfilter([1], [1, -memory], noise, axis=0) * speed_deg_s
    angle_deg = np.cumsum(
        np.concatenate([np.zeros((1, 3)), velocity / rate_hz]), axis=0
    )
    angle_deg += 0.004 * np.sign(speed_deg_s) * rng.standard_normal(angle_deg.shape)
    turns = Rotation.from_rotvec(angle_deg, degrees=True)
    t_s = np.arange(count + 1) / rate_hz
    rows = np.column_stack([t_s, turns.as_quat(scalar_first=True)])
    np.savetxt(path, rows, delimiter=",", header="t_s,qw,qx,qy,qz", comments="")
    return path


def with_rows(path, copy, change):
    """Write a copy of a trace file, its rows changed."""
    rows = change(np.loadtxt(path, delimiter=",", skiprows=1))
    np.savetxt(copy, rows, delimiter=",", header="t_s,qw,qx,qy,qz", comments="")
    return copy


def in_ms(rows):
    return rows * [1000, 1, 1, 1, 1]


def every_second_pose(rows):
    return np.column_stack([rows[:, 0], rows[np.arange(len(rows)) // 2 * 2, 1:]])


def run(*arguments):
    return cli.run(["head", *map(str, arguments)])


@pytest.fixture(scope="module")
def traces(tmp_path_factory):
    folder = tmp_path_factory.mktemp("traces")
    names = ("a_one.csv", "b_two.csv")
    return [write_trace(folder / name, seed=i) for i, name in enumerate(names)]


@pytest.mark.slow
def test_fit_writes_a_model_that_can_be_read_and_drawn_from(traces, tmp_path, capsys):
    out = tmp_path / "made" / "me.toml"
    assert run("fit", *traces, "--order", 0, "--out", out) == 0
    printed = " ".join(capsys.readouterr().out.split())
    for part in (
        "Reading 2 recordings.",
        "30.00 Hz",
        "Fitting order 0",
        "about a minute, most of it to compile",
        "tracker_noise_deg",
        "95 % interval",
        "of 2 subjects, between these windows only",
        "Order 0, as given",
        "wander in 20 s, deg",
        "excess kurtosis",
        "of 24 bins",
        f"Wrote {out}",
    ):
        assert part in printed, part

    content = tomllib.loads(out.read_text())
    assert content["source"] == "a_one.csv, b_two.csv"
    rests_on = content["fit"]
    assert rests_on["order"] == 0
    assert rests_on["subjects"] == 2
    assert rests_on["still_s"] == pytest.approx(80, abs=8)
    assert rests_on["hmdjit_version"] == hj.__version__
    assert content["standard_error"]["speed_rms_deg_s"][0] > 0
    picture = imread(out.with_suffix(".png"))
    assert 0.005 < (picture[..., :3].min(axis=-1) < 0.9).mean() < 0.5
    assert sorted(path.name for path in out.parent.iterdir()) == ["me.png", "me.toml"]

    # The fitted head is one that the other commands take.
    head = definition.head_model(str(out))
    assert float(head.speed_rms_deg_s[0]) == pytest.approx(1.0, rel=0.3)


@pytest.mark.slow
def test_a_sample_is_the_head_models_own_draw(tmp_path, capsys):
    out = tmp_path / "me.csv"
    arguments = ("sample", "--seed", 3, *SHORT, "--out", out)
    assert run(*arguments) == 0
    assert "drawn" in capsys.readouterr().out
    trace = hj.Trace.read(out)
    assert trace.duration_s == pytest.approx(4.0)
    assert trace.rate_hz == pytest.approx(30.0)
    key = jax.random.key(3, impl="threefry2x32")
    poses = hj.HeadMotion.preset(definition.HEAD).sample(key, 30.0, 121)
    np.testing.assert_allclose(trace.world_from_head, poses, rtol=0, atol=1e-12)
    assert imread(out.with_suffix(".png")).shape[1] == 1650

    # The same command writes the same bytes.
    first = [out.read_bytes(), out.with_suffix(".png").read_bytes()]
    assert run(*arguments) == 0
    assert first == [out.read_bytes(), out.with_suffix(".png").read_bytes()]

    # Whatever JAX's settings are.
    with jax.threefry_partitionable(False):
        assert run(*arguments) == 0
    assert out.read_bytes() == first[0]


def test_description_tells_what_was_recorded(traces, tmp_path, capsys):
    rows = traces[0].read_text().splitlines()
    # Two frames lost, then a gap of 5.
    broken = tmp_path / "c_three.csv"
    broken.write_text("\n".join(rows[:400] + rows[402:800] + rows[805:]))
    out = tmp_path / "seen.png"
    assert run("describe", broken, traces[1], "--out", out) == 0
    printed = capsys.readouterr().out
    assert re.search(r"subjects +2 \(2 with still segments\)", printed)
    assert re.search(r"gaps +1 \(0\.2 s\)", printed)
    assert re.search(r"lost frames, bridged +2 of", printed)
    assert "speed median, deg/s" in printed
    assert "model" not in printed
    assert imread(out).shape[1] == 1650


@pytest.fixture
def stopped(monkeypatch):
    """Commands that stop once they have read their recordings and told of them."""

    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("hmdjit.head_fitting.statistics.describe", stop)
    monkeypatch.setattr(hj.Study, "run", stop)


@pytest.mark.usefixtures("stopped")
def test_held_poses_are_told_and_can_be_left_out(traces, tmp_path, capsys):
    path = with_rows(traces[0], tmp_path / "a_held.csv", every_second_pose)
    assert run("describe", path) == 130
    printed = " ".join(capsys.readouterr().out.split())
    assert "a_held.csv: poses are held: 600 of 1201 rows repeat the pose" in printed
    assert "new ones come at 15 Hz" in printed
    assert "frame rate 30.00 Hz" in printed
    assert run("describe", path, "--skip-held") == 130
    printed = " ".join(capsys.readouterr().out.split())
    assert "a_held.csv: left out 600 of 1201 rows as held." in printed
    assert "frame rate 15.00 Hz" in printed
    assert "poses are held" not in printed


@pytest.mark.usefixtures("stopped")
def test_damaged_rows_are_left_out_on_request(traces, tmp_path, capsys):
    rows = traces[0].read_text().splitlines()
    path = tmp_path / "a_cut.csv"
    path.write_text("\n".join([*rows[:90], rows[89], "# pause", *rows[90:], "40.1,1"]))
    assert run("describe", path) == 2
    assert "line 92: must have 5 fields" in capsys.readouterr().err
    assert run("describe", path, "--skip-damaged") == 130
    printed = " ".join(capsys.readouterr().out.split())
    for part in ("comments or blank lines (1)", "the header (1)", "do not rise (1)"):
        assert part in printed
    assert "lost frames, bridged 0 of 1201" in printed


@pytest.mark.slow
def test_a_description_sets_a_preset_beside_the_recordings(traces, tmp_path, capsys):
    out = tmp_path / "seen.png"
    assert run("describe", *traces, "--model", "tracker_noise", "--out", out) == 0
    printed = capsys.readouterr().out
    assert "difference" in printed
    assert re.search(r"speed RMS, deg/s .*-\d\d\.\d%", printed)
    assert out.exists()


@pytest.mark.slow
def test_axes_that_never_move_are_described(tmp_path, capsys):
    (tmp_path / "turning.toml").write_text(TURNING)
    drawn, seen = tmp_path / "drawn.csv", tmp_path / "seen.png"
    model = ("--model", tmp_path / "turning.toml")
    assert run("sample", *model, *SHORT, "--out", drawn) == 0
    assert run("describe", drawn, *model, "--out", seen) == 0
    assert not capsys.readouterr().err


WRONG = [
    (["fit"], "traces must name at least one recording, got none"),
    (["fit", "{missing}"], "missing.csv: cannot be read"),
    (["fit", "{short}"], "at least 30 s of still data"),
    (["fit", "{fast}"], "traces must hold still for 2 s at a time, below 5 deg/s"),
    (["fit", "{frozen}"], "traces must move in all axes to be fitted, none does in p"),
    (["fit", "{slow}", "{good}"], "share one rate within 2 %"),
    (["fit", "{good}", "--order", "3"], "order must be one of 0, 1, 2, got '3'"),
    (["fit", "{good}", "--axes", "unty"], r"axes must be one of .* mean 'unity'\?"),
    (["fit", "{good}", "--time-unit", "h"], "--time-unit must be one of"),
    (["fit", "{good}", "--max-speed", "0"], r"--max-speed must lie in \(0, inf\)"),
    (["fit", "{good}", "--out", "x.json"], "out must end in .toml, got x.json"),
    (["fit", "{good}", "--out", "{folder}"], "out must be a file, but .* is a folder"),
    (["fit", "{good}", "--out", "{good}/x.toml"], "good.csv is a file"),
    (["describe", "{text}"], "notes.csv, line 1"),
    (["describe", "{brief}"], "at least 4 s for a spectrum, the longest lasts 3.00 s"),
    (["describe", "{hourly}"], r"hourly.csv: frame rate must lie in \[5, 2000\]"),
    (
        ["fit", "{ms}"],
        r"ms.csv: frame rate .*, got 0.03 Hz; name the unit .* time_unit",
    ),
    (["fit", "{good}", "{ms}"], r"ms.csv: frame rate must lie in \[5, 2000\]"),
    (["fit", "{almost}"], r"at least 30 s of still data, .*; got 29\.9\d+ s in 1 seg"),
    (["describe", "{good}", "--columns", "t_s", "qw"], "good.csv"),
    (["describe", "{good}", "--model", "seatd"], "--model must be one of .* 'seated'"),
    (["describe", "{good}", "--model", "{missing_toml}"], "missing.toml: cannot be re"),
    (["describe", "{good}", "--out", "{good}"], "out must end in .png"),
    (["sample", "--rate", "0"], r"rate must lie in \[5, 2000\], got 0"),
    (["sample", "--rate", "nan"], r"rate must lie in \[5, 2000\], got nan"),
    (["sample", "--seconds", "3"], r"seconds must lie in \[4, .*\], got 3"),
    (["sample", "--seconds", "1e9"], r"seconds must lie in \[4, 111111\], got 1e\+09"),
    (["sample", "--seed", "-1"], "seed must be a whole number >= 0, got -1"),
    (["sample", "--model", "{bad_key}"], "bad_key.toml: unknown key .* person_sd"),
    (["sample", "--model", "{bad_type}"], "bad_type.toml: speed_.* be a list of 3"),
    (["sample", "--model", "{bad_value}"], r"bad_value.toml: person_sd must lie in"),
    (["sample", "--model", "{bad_syntax}"], r"bad_syntax.toml: "),
    (
        ["sample", "--model", "{dead}", "--seconds", "4", "--rate", "30"],
        "heads must move to be drawn",
    ),
    (["sample", "--model", "{folder}"], "folder.toml: cannot be read: Is a dir"),
]


@pytest.fixture(scope="module")
def places(tmp_path_factory):
    folder = tmp_path_factory.mktemp("places")
    hours = "".join(f"{3600 * i},1,0,0,0\n" for i in range(5))
    contents = {
        "text": ("notes.csv", "no trace\n"),
        "hourly": ("hourly.csv", "t_s,qw,qx,qy,qz\n" + hours),
        "bad_key": ("bad_key.toml", MODEL + "persn_sd = 0.1\n"),
        "bad_type": ("bad_type.toml", MODEL.replace("[1.0", "['fast'")),
        "bad_value": ("bad_value.toml", MODEL + "person_sd = -1\n"),
        "bad_syntax": ("bad_syntax.toml", "speed_rms_deg_s = = 3\n"),
        "dead": ("dead.toml", TURNING.replace("[0, 1, 0]", "[0, 0, 0]")),
    }
    for name, text in contents.values():
        (folder / name).write_text(text)
    (folder / "folder.toml").mkdir()
    return {key: folder / name for key, (name, _) in contents.items()} | {
        "missing": folder / "missing.csv",
        "missing_toml": folder / "missing.toml",
        "folder": folder / "folder.toml",
        "good": write_trace(folder / "good.csv"),
        "slow": write_trace(folder / "slow.csv", rate_hz=20.0),
        "ms": with_rows(folder / "good.csv", folder / "ms.csv", in_ms),
        "almost": write_trace(folder / "almost.csv", seconds=29.967),
        "short": write_trace(folder / "short.csv", seconds=10.0),
        "brief": write_trace(folder / "brief.csv", seconds=3.0),
        "frozen": write_trace(folder / "frozen.csv", speed_deg_s=(0.0, 1.0, 0.0)),
        "fast": write_trace(folder / "fast.csv", speed_deg_s=(40.0, 40.0, 40.0)),
    }


@pytest.mark.parametrize(("arguments", "message"), WRONG)
def test_wrong_inputs_end_in_one_clear_line(
    arguments, message, places, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    folder = places["good"].parent
    before = set(folder.rglob("*"))
    assert run(*(argument.format(**places) for argument in arguments)) == 2
    error = capsys.readouterr().err.strip()
    assert error.startswith("hmdjit: error: ")
    assert "\n" not in error
    assert re.search(message, error), error
    # Nothing half-written.
    assert not list(tmp_path.iterdir())
    assert set(folder.rglob("*")) == before


@pytest.mark.parametrize("name", ["fit", "describe"])
def test_an_interruption_ends_with_a_word_and_without_files(
    name, traces, tmp_path, capsys, monkeypatch
):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(fitting, "fit_heads", interrupt)
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", interrupt)
    assert run(name, *traces) == 130
    assert capsys.readouterr().err == "hmdjit: stopped.\n"
    assert not list(tmp_path.iterdir())


def test_a_failed_figure_leaves_no_model(traces, tmp_path, monkeypatch, capsys):
    def fail(_, path, **options):
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", fail)
    out = tmp_path / "out" / "me.csv"
    model = tmp_path / "turning.toml"
    model.write_text(TURNING)
    assert run("sample", "--model", model, *SHORT, "--out", out) == 2
    message = f"{out.with_name('me.png')}: No space left on device"
    assert capsys.readouterr().err == f"hmdjit: error: {message}\n"
    assert not list(out.parent.iterdir())


@pytest.mark.slow
def test_recorded_people_are_fitted_with_an_order_that_is_chosen(
    tmp_path, shared, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert run("fit", *sorted(Path(shared, "traces").glob("fix_*_still.csv"))) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "Deviance on held-out data by order: 0: " in printed
    assert "over 10 subjects" in printed
    assert len(hj.HeadMotion.read("head.toml").resonators) == 2
    assert Path("head.png").exists()


@pytest.mark.usefixtures("stopped")
def test_a_study_reads_logs_as_the_other_commands_do(
    traces, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    imsave("one.png", np.zeros((16, 16, 3)))
    study = lambda *args: cli.run(["study", *map(str, args), "--images", "one.png"])
    held = with_rows(traces[0], tmp_path / "held.csv", every_second_pose)
    assert study("--trace", held) == 130
    printed = capsys.readouterr().out
    assert "held.csv: poses are held: 600 of 1201 rows" in printed
    assert "replayed at 30 Hz" in printed
    (tmp_path / "study.toml").write_text('trace = ["held.csv"]\nskip_held = true\n')
    assert study("study.toml") == 130
    assert "replayed at 15 Hz" in capsys.readouterr().out

    ms = with_rows(traces[0], tmp_path / "ms.csv", in_ms)
    assert study("--trace", ms, "--time-unit", "ms") == 130
    assert "replayed at 30 Hz" in capsys.readouterr().out
    for refresh in ((), ("--refresh", 90)):
        assert study("--trace", ms, *refresh) == 2
        assert "ms.csv: frame rate must lie in [5, 2000]" in capsys.readouterr().err
    assert study("--axes", "unity") == 2
    assert "--axes is of recorded heads: name a --trace." in capsys.readouterr().err
