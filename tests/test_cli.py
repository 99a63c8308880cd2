import csv
import gc
import io
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
import PIL.Image
import pytest
import xarray

import hmdjit as hj
from hmdjit import __main__ as entry
from hmdjit.cli import main as cli
from hmdjit.head_motion import presets
from hmdjit.reports import study as report
from hmdjit.simulation.session import Result
from hmdjit.studies import failures, runner

SMALL = [
    *("study", "--width", "64", "--height", "64", "--fov", "8", "--tiles", "1"),
    *("--scenes", "noise", "checkerboard", "--sessions", "6", "--frames", "3"),
    *("--warmup", "1", "--no-report"),
]


def _poses_file(path, rows=8, rate_hz=60.0):
    poses = hj.HeadMotion.seated().sample(jax.random.key(0), rate_hz, rows)
    table = np.column_stack([np.arange(rows) / rate_hz, np.asarray(poses)])
    np.savetxt(path, table, delimiter=",", header="t_s,qw,qx,qy,qz", comments="")
    return path


@pytest.mark.slow
def test_a_study_writes_all_its_files_and_prints_its_table(tmp_path, capsys):
    assert cli.run([*SMALL, "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    assert "Compiling" in printed
    for id in ("none", "msaa4", "head_movement", "freeze", "ssaa4"):
        assert id in printed
    for name in ("result.nc", "summary.csv", "ratios.png", "distributions.png"):
        assert (tmp_path / "out" / name).stat().st_size > 0
    with open(tmp_path / "out" / "summary.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["scene"] for row in rows} >= {"noise", "checkerboard", "all"}
    with xarray.open_dataset(tmp_path / "out/result.nc", engine="h5netcdf") as data:
        assert data.sizes["session"] == 6

    # The same study again finds everything.
    assert cli.run([*SMALL, "--out", str(tmp_path / "out")]) == 0


@pytest.mark.slow
def test_a_definition_file_is_overridden_by_the_command_line(tmp_path):
    picture = np.tile(np.arange(64, dtype=np.uint8), (64, 1)) * 4
    PIL.Image.fromarray(picture).save(tmp_path / "ramp.png")
    (tmp_path / "study.toml").write_text(
        "images = ['ramp.png']\ntechniques = ['none', 'head_movement']\n"
        "width = 64\nheight = 64\nfov = 8\ntiles = 1\nsessions = 3\nframes = 3\n"
        "warmup = 0\nout = 'there'\n[head_movement]\nw_min = 0.2\ncloseness = [0.5]\n"
    )
    assert cli.run(["study", str(tmp_path / "study.toml"), "--sessions", "2"]) == 0
    with xarray.open_dataset(tmp_path / "there/result.nc", engine="h5netcdf") as data:
        assert dict(data.sizes) == {"technique": 2, "scene": 1, "session": 2}
        assert list(data["scene"].values) == ["ramp"]


@pytest.mark.slow
def test_recorded_heads_are_replayed_at_their_own_rate(tmp_path):
    trace = _poses_file(tmp_path / "me.csv", rows=30, rate_hz=72.0)
    out = tmp_path / "out"
    assert cli.run([*SMALL, "--trace", str(trace), "--out", str(out)]) == 0
    with xarray.open_dataset(out / "result.nc", engine="h5netcdf") as data:
        assert data.attrs["refresh_hz"] == pytest.approx(72.0)


@pytest.mark.slow
def test_a_study_takes_a_head_by_name_or_file(tmp_path, capsys):
    head = hj.HeadMotion((0.5,) * 3, (0.1,) * 3, (0.004,) * 3)
    presets.write(tmp_path / "me.toml", head, {"source": "me"})
    folder = tmp_path / "named"
    folder.mkdir()
    (folder / "study.toml").write_text("head = '../me.toml'\nout = 'there'\n")
    small = [argument for argument in SMALL if argument != "study"]
    assert cli.run(["study", str(folder / "study.toml"), *small]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert f"Head: {folder}/../me.toml, model A, speed 0.5/0.5/0.5 deg/s" in printed
    with xarray.open_dataset(folder / "there/result.nc", engine="h5netcdf") as data:
        assert data.attrs["head"] == str(head)


def test_an_interruption_tells_how_to_go_on(tmp_path, capsys, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(runner.Runner, "run", interrupt)
    assert cli.run([*SMALL, "--out", str(tmp_path)]) == 130
    error = capsys.readouterr().err
    assert re.fullmatch(r"hmdjit: stopped;[^\n]*run the same command[^\n]*\n", error)


@pytest.mark.parametrize(
    ("more", "is_said"), [([], True), (["--tile-size", "8"], False)]
)
def test_small_tiles_are_said(more, is_said, tmp_path, capsys, monkeypatch):
    def stopped(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(hj.Study, "run", stopped)
    frame = ["--width", "1832", "--height", "1920"]
    assert cli.run([*SMALL, *frame, *more, "--out", str(tmp_path)]) == 130
    said = "Tiles are of 8 px only, for no larger size divides 1832 x 1920 px"
    assert (said in " ".join(capsys.readouterr().out.split())) == is_said


def _interrupted(out, after_s):
    """Exit code and errors of a study, interrupted so long after its first import."""
    study = [*SMALL, "--sessions", "99999", "--out", str(out)]
    process = subprocess.Popen(
        [sys.executable, "-m", "hmdjit", *study],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    maps = Path(f"/proc/{process.pid}/maps")
    if not maps.exists():
        process.kill()
        pytest.skip("this system does not tell what a process has imported")
    while "numpy" not in maps.read_text(encoding="utf-8"):
        time.sleep(0.01)
    time.sleep(after_s)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=300)
    return process.returncode, error


@pytest.mark.parametrize(
    "after_s",
    [0.0, *(pytest.param(s, marks=pytest.mark.slow) for s in (0.3, 1, 2, 4, 8, 16))],
)
def test_an_interruption_is_heeded_from_the_first_import_on(after_s, tmp_path):
    code, error = _interrupted(tmp_path, after_s)
    assert code == 130, error
    assert re.fullmatch(r"hmdjit: stopped[^\n]*\.\n", error), error


def test_an_interruption_that_is_swallowed_comes_again(monkeypatch):
    def swallow(phase, info):
        gc.callbacks.remove(swallow)
        raise KeyboardInterrupt

    monkeypatch.setattr(sys, "unraisablehook", entry._swallowed)
    gc.callbacks.append(swallow)
    usual = signal.getsignal(signal.SIGINT)
    try:
        gc.collect()
        with pytest.raises(KeyboardInterrupt):
            time.sleep(30)
    finally:
        signal.signal(signal.SIGINT, usual)


def test_the_version_is_told(capsys):
    assert cli.run(["--version"]) == 0
    assert capsys.readouterr().out == f"hmdjit {hj.__version__}\n"


def test_the_help_is_told_in_any_encoding(monkeypatch):
    pipe = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", pipe)
    with pytest.raises(SystemExit) as done:
        cli.run(["--help"])
    assert done.value.code == 0
    pipe.seek(0)
    assert "* study" in pipe.read()


def test_failed_sessions_are_left_out_only_by_choice(tmp_path, capsys, monkeypatch):
    def one_fails(self, techniques, texture, batch):
        mtcd = np.arange(1.0, 7.0)
        mtcd[3] = np.nan
        return [Result({"mtcd": mtcd, "detail_loss": mtcd}) for _ in techniques]

    monkeypatch.setattr(runner.Runner, "run", one_fails)
    monkeypatch.setattr(failures, "MOST_FAILED", 0.2)
    monkeypatch.setattr(report, "write_report", lambda *_: [])
    study = [*SMALL, "--out", str(tmp_path)]
    assert cli.run(study) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(
        "hmdjit: error: 1 of 6 sessions gave no finite number (3); --omit-failed "
        "leaves them out. One cause is a head that turns more than --margin 6 from"
    )
    assert cli.run([*study, "--omit-failed"]) == 0
    assert "Failed sessions, left out: 1." in " ".join(capsys.readouterr().out.split())


def test_the_help_names_the_choice(capsys):
    with pytest.raises(SystemExit):
        cli.run(["study", "--help"])
    assert "--omit-failed" in capsys.readouterr().out


WRONG_STUDIES = [
    (["--images", "{text}"], r"notes.png"),
    (["--images", "{missing}"], r"missing.png"),
    (["--trace", "{nan_trace}"], r"nan.csv.*line 4.*qy"),
    (["--techniques", "head_movment"], r"Did you mean 'head_movement'"),
    (
        ["--techniques", "none,msaa4"],
        r"--techniques must be .* Several are separated by spaces: none msaa4\.$",
    ),
    (["--scenes=text,coffee"], r"--scenes must be .* by spaces: text coffee\.$"),
    (["--images", "a.png,b.png"], r"separated by spaces: a.png b.png\.$"),
    (["--images", "a.png," * 60 + "b.png"], r"separated by spaces: a.png .* b.png\.$"),
    (["--sessions", "0"], r"sessions must be a whole number >= 1, got 0"),
    (["--frames", "1"], r"frames must be a whole number >= 2, got 1"),
    (["--warmup", "-1"], r"warmup must be a whole number >= 0, got -1"),
    (["--fov", "181"], r"--fov must lie in \(0, 180\), got 181"),
    (["--refresh", "0"], r"--refresh must lie in \(0, inf\), got 0"),
    (["--crop", "5000"], r"--crop must lie in \[1, 1024\], got 5000"),
    (["--crop", "64", "--whole-frame"], r"--crop and --whole-frame exclude each other"),
    (["--scenes", "nois"], r"Did you mean 'noise'"),
    (["--baseline", "ssaa3"], r"baseline must be one of"),
    (["{bad_key}"], r"bad_key.toml: unknown key sesions. Did you mean sessions\?"),
    (
        ["{bad_table}"],
        r"unknown key head_movement.wmin. Did you mean head_movement.w_mi",
    ),
    (["{bad_type}"], r"bad_type.toml: sessions must be a whole number, got 'many'"),
    (["--tile-size", "48"], r"--tile-size must divide .* 1024 x 1024, got 48; 128 doe"),
    (
        ["--width", "1000", "--height", "1001"],
        r"--width and --height must .* got 1000 x 10",
    ),
    (["--trace", "{trace}", "--tolerance", "0.1"], r"--tolerance and --budget need a"),
    (["--oversampling", "3"], r"oversampling must be 1, 2 or 4, got 3"),
    (["--tiles", "70000"], r"--tiles must lie in \[1, 65536\], got 70000"),
    (["--seed", "-1"], r"seed must be a whole number >= 0, got -1"),
    (["{bad_value}"], r"bad_value.toml: head_movement.closeness must be a list of at"),
    (
        ["{bad_range}"],
        r"bad_range.toml: head_movement.w_min must lie in \[0, 1\], got 2",
    ),
    (["--techniques", "head_movement:{missing_toml}"], r"missing.toml: cannot be read"),
    (["{bad_syntax}"], r"bad_syntax.toml: not a TOML file"),
    (["{missing_toml}"], r"missing.toml: cannot be read: No such file"),
    (["--head", "fixatin"], r"head must be one of .* Did you mean 'fixating'\?"),
    (["--head", "{missing_toml}"], r"missing.toml: cannot be read: No such file"),
    (["--head", "{bad_key}"], r"bad_key.toml: unknown key sesions\."),
    (
        ["--head", "seated", "--trace", "me.csv"],
        r"--head and --trace exclude each other",
    ),
    (["{bad_head}"], r"bad_head.toml: head must be a string, got 3"),
    (["--out", "{beneath}"], r"out must be where files can be made.* is a file"),
]


@pytest.fixture
def places(tmp_path):
    contents = {
        "text": ("notes.png", "no picture"),
        "trace": (
            "trace.csv",
            "t_s,qw,qx,qy,qz\n0,1,0,0,0\n0.1,1,0,0,0\n0.2,1,0,0,0\n",
        ),
        "nan_trace": (
            "nan.csv",
            "t_s,qw,qx,qy,qz\n0,1,0,0,0\n0.1,1,0,0,0\n0.2,1,0,nan,0\n",
        ),
        "bad_key": ("bad_key.toml", "sesions = 3\n"),
        "bad_table": ("bad_table.toml", "[head_movement]\nwmin = 0.3\n"),
        "bad_type": ("bad_type.toml", "sessions = 'many'\n"),
        "bad_value": ("bad_value.toml", "[head_movement]\ncloseness = 0.5\n"),
        "bad_range": ("bad_range.toml", "[head_movement]\nw_min = 2\n"),
        "bad_head": ("bad_head.toml", "head = 3\n"),
        "bad_syntax": ("bad_syntax.toml", "sessions = = 3\n"),
    }
    for name, text in contents.values():
        (tmp_path / name).write_text(text)
    return {key: tmp_path / name for key, (name, _) in contents.items()} | {
        "missing": tmp_path / "missing.png",
        "missing_toml": tmp_path / "missing.toml",
        "beneath": tmp_path / "notes.png" / "out",
    }


@pytest.mark.parametrize(("arguments", "message"), WRONG_STUDIES)
def test_wrong_studies_end_in_one_clear_line(
    arguments, message, places, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    before = set(tmp_path.rglob("*"))
    filled = [argument.format(**places) for argument in arguments]
    assert cli.run(["study", *filled]) == 2
    error = capsys.readouterr().err.strip()
    assert error.startswith("hmdjit: error: ")
    assert "\n" not in error
    assert re.search(message, error), error
    assert set(tmp_path.rglob("*")) == before  # nothing half-written


@pytest.mark.slow
def test_the_command_itself_prints_no_traceback(tmp_path):
    for arguments in (["study", "--fov", "181"], ["study", "--sesions", "3"], []):
        done = subprocess.run(
            [sys.executable, "-m", "hmdjit", *arguments],
            capture_output=True,
            text=True,
            check=False,
            cwd=tmp_path,
        )
        assert done.returncode == 2
        assert "Traceback" not in done.stdout + done.stderr
