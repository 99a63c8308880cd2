import re
import subprocess
import sys
import tomllib

import pytest
import rich.console

from hmdjit.cli import fit as cli_fit
from hmdjit.cli import main as cli
from hmdjit.cli.progress import Display
from hmdjit.studies.progress import Progress
from hmdjit.techniques import curve_file

TINY = [
    *("fit", "--width", "64", "--height", "64", "--fov", "6", "--sessions", "16"),
    *("--frames", "3", "--warmup", "2"),
]
CHECKERBOARD = [*TINY, "--scenes", "checkerboard", "--held-out", "none"]
STILL = """
speed_rms_deg_s = [0.0, 0.0, 0.0]
correlation_time_s = [0.1, 0.1, 0.1]
tracker_noise_deg = [0.0, 0.0, 0.0]
person_sd = 0.0
"""


@pytest.fixture
def fits(monkeypatch):
    """Study and held-out scenes of each fit, which is interrupted as it begins."""
    begun = []

    def begin(study, space, *, held_out, **_):
        begun.append((study, held_out))
        raise KeyboardInterrupt

    monkeypatch.setattr(cli_fit, "fit", begin)
    return begun


def _refused(arguments, out, capsys):
    """Error of a fit that ends with one line, exit code 2 and no result."""
    assert cli.run([*arguments, "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert re.fullmatch(r"hmdjit: error: [^\n]+[.?]\n", error)
    assert not out.is_file()
    assert not list(out.parent.glob("*.png"))
    return error


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--sessions", "15"], "sessions must be a whole number >= 16, got 15"),
        (["--scenes", "coffe"], "scenes must be one of .* Did you mean 'coffee'"),
        (["--held-out", "nois"], "held-out must be one of .* Did you mean 'noise'"),
        (["--held-out", "almost_uniform"], "held-out must be one of"),
        (["--held-out", "checkerboard"], "other scenes than scenes, got checkerboard"),
        (["--family", "kin"], "family must be one of .* Did you mean 'kim'"),
        (["--samples", "5"], r"samples must lie in \[1, 4\], got 5"),
        (["--localization", "cubic"], "localization must be one of linear, spline"),
        (["--detail-loss", "0"], r"detail-loss must lie in \(0, inf\), got 0"),
        (["--lag", "-1"], r"lag must lie in \[0, inf\), got -1"),
        (["--head", "seatd"], "Did you mean 'seated'"),
        (["--seed", "-1"], "seed must be a whole number >= 0"),
        (["--width", "67"], "--width and --height must .* 4 to 64 px.* got 67 x 64"),
    ],
)
def test_wrong_options_are_refused_at_once(arguments, words, tmp_path, capsys):
    error = _refused([*CHECKERBOARD, *arguments], tmp_path / "curve.toml", capsys)
    assert re.search(words, error)


def test_a_file_that_cannot_be_written_is_refused(tmp_path, capsys):
    assert "end in .toml" in _refused(CHECKERBOARD, tmp_path / "curve.csv", capsys)
    (tmp_path / "file").touch()
    error = _refused(CHECKERBOARD, tmp_path / "file" / "curve.toml", capsys)
    assert "is a file" in error
    (tmp_path / "curve-front.png").mkdir()
    assert cli.run([*CHECKERBOARD, "--out", str(tmp_path / "curve.toml")]) == 2
    assert "curve-front.png is a folder" in capsys.readouterr().err


@pytest.mark.slow
def test_what_does_not_flicker_is_refused(tmp_path, capsys):
    out = tmp_path / "curve.toml"
    uniform = [*TINY, "--scenes", "almost_uniform", "--held-out", "none"]
    assert "no flicker to remove" in _refused(uniform, out, capsys)
    still = tmp_path / "still.toml"
    still.write_text(STILL)
    error = _refused([*CHECKERBOARD, "--head", str(still)], out, capsys)
    assert "checkerboard flickers by 0 code values" in error


@pytest.mark.parametrize(
    ("said", "fitted_to", "held_out"),
    [
        ([], 8, {"checkerboard", "noise"}),
        (["--held-out", "none"], 8, set()),
        (["--held-out", "cat"], 7, {"cat"}),
        (["--scenes", "cat", "text", "--held-out", "noise"], 2, {"noise"}),
    ],
)
def test_scenes_are_fitted_to_or_held_out(said, fitted_to, held_out, fits):
    assert cli.run([*TINY, *said]) == 130
    ((study, judges),) = fits
    assert len(study.scenes) == fitted_to
    assert set(judges) == held_out
    assert not {"almost_uniform", *judges} & set(study.scenes)


def test_all_other_scenes_that_flicker_are_held_out(fits):
    assert cli.run([*TINY, "--scenes", "cat"]) == 130
    ((study, judges),) = fits
    assert list(study.scenes) == ["cat"]
    assert len(judges) == 9
    assert not {"cat", "almost_uniform"} & set(judges)


def test_an_interrupted_fit_says_how_to_go_on(tmp_path, capsys, fits):
    out = tmp_path / "curve.toml"
    assert cli.run([*CHECKERBOARD, "--out", str(out)]) == 130
    assert len(fits) == 1
    error = capsys.readouterr().err
    assert re.fullmatch(r"hmdjit: stopped;[^\n]*run the same command[^\n]*\n", error)
    assert not out.exists()


def test_lines_are_few_where_there_is_no_terminal(capsys):
    with Display(rich.console.Console()) as display:
        for step in range(100):
            line = "a plan" if step == 50 else ""
            display(Progress(step, 4000, f"step {step}", line=line, unit="simulations"))
    first, second = capsys.readouterr().out.splitlines()
    assert first.split() == ["0", "s", "0", "of", "4,000", "simulations,", "step", "0"]
    assert second == "a plan"


@pytest.mark.slow
def test_a_detail_loss_out_of_reach_is_refused(tmp_path, capsys):
    arguments = [*CHECKERBOARD, "--detail-loss", "1e-6"]
    error = _refused(arguments, tmp_path / "curve.toml", capsys)
    assert re.search(r"detail loss must be at least .*, got 1e-06", error)


@pytest.mark.slow
def test_a_fit_goes_on_and_a_study_reads_its_curve(tmp_path, capsys, monkeypatch):
    out, held_out = tmp_path / "curve.toml", ["--held-out", "noise"]
    command = [*TINY, "--scenes", "checkerboard", *held_out, "--out", str(out)]
    said = []

    def stop(event):
        """Press the key while the second search is on its way."""
        said.append(event.doing)
        if journal.exists():
            raise KeyboardInterrupt

    journal = tmp_path / ".curve.toml.journal.json"
    monkeypatch.setattr(Display, "__call__", lambda _, event: stop(event))
    assert cli.run(command) == 130
    assert journal.exists()
    assert not out.exists()
    first = sum(line.startswith("step") for line in said)
    capsys.readouterr()

    lines = []
    keep = lambda _, event: lines.append(event.doing)
    monkeypatch.setattr(Display, "__call__", keep)
    assert cli.run(command) == 0
    printed = capsys.readouterr().out
    assert {file.name for file in tmp_path.iterdir()} == {
        *("curve.toml", "curve.png", "curve-front.png"),
    }
    content = tomllib.loads(out.read_text(encoding="utf-8"))
    about, curve = content["fit"], curve_file.read(out)
    # A line per search; how a search is gone on from is `Front`'s, tested there.
    assert first > 3
    assert 0 < sum(line.startswith("step") for line in lines) < about["steps"]

    assert (about["scenes"], about["held_out"]) == (["checkerboard"], ["noise"])
    assert (about["sessions"], about["seed"], about["head"]) == (16, 0, "fixating")
    low, high = about["interval_95"]["w_min"]
    assert low < high
    assert about["held_out_fitted_flicker"]["low"] > 0
    assert about["fitted_detail_loss"]["mean"] < about["kim_detail_loss"]["mean"] * 1.5
    for name in ("w_min", "w_lb", "h_max_deg_s", "closeness[0]"):
        assert name in printed
    assert re.search(rf"w_min +{curve.w_min:.4g}", printed)
    assert "Held-out sessions of held-out scenes" in printed
    assert "Kim et al.'s constants" in printed

    study = [
        *("study", "--width", "64", "--height", "64", "--fov", "6", "--tiles", "1"),
        "--no-report",
        *("--scenes", "checkerboard", "--sessions", "6", "--frames", "3"),
        *("--techniques", "none", "head_movement", f"head_movement:{out}"),
        *("--out", str(tmp_path / "study")),
    ]
    assert cli.run(study) == 0
    table = (tmp_path / "study" / "summary.csv").read_text(encoding="utf-8")
    assert "head_movement:curve" in table


def test_help_names_what_is_left_out():
    run = subprocess.run(
        [sys.executable, "-m", "hmdjit", "fit", "--help"],
        capture_output=True,
        text=True,
        check=True,
    )
    words = " ".join(re.sub("[│╭╮╰╯─]", " ", run.stdout).split())
    assert "almost_uniform, which has no flicker to remove" in words
