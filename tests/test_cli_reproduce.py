"""Papers' experiments on the command line: written, judged, resumed, refused."""

import csv
import functools

import pytest

from hmdjit.cli import main
from hmdjit.reproductions import color_space
from hmdjit.studies import runner

TINY = ["reproduce", "colour-space", "--sessions", "3"]
TINY += ["--width", "24", "--height", "24", "--fov", "6"]


@pytest.fixture(autouse=True)
def tiny(monkeypatch):
    """Few measures, one pair of colours from a coarse grid, few samples and frames."""
    search = functools.partial(color_space.most_different, 1, levels=3)
    monkeypatch.setattr(color_space, "most_different", search)
    every = color_space.measures
    few = lambda camera: [every(camera)[i] for i in (0, 1, -1)]
    monkeypatch.setattr(color_space, "measures", few)
    for name, number in {"_RAYS": 8, "_FRAMES": 2, "_EVERY": 1, "_BATCH": 2}.items():
        monkeypatch.setattr(color_space, name, number)


def _rows(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def test_each_claim_is_written_with_its_verdict_and_a_stopped_run_goes_on(
    tmp_path, capsys, monkeypatch
):
    out, ran = tmp_path / "out", []
    run = runner.Runner.run

    def stops(self, techniques, source, batch):
        if len(ran) == 2:
            raise KeyboardInterrupt
        ran.append(batch.start)
        return run(self, techniques, source, batch)

    monkeypatch.setattr(runner.Runner, "run", stops)
    assert main.run([*TINY, "--out", str(out)]) == main.INTERRUPTED
    assert "run the same command to go on" in capsys.readouterr().err
    assert not list(out.glob("*.csv"))

    def counts(self, techniques, source, batch):
        ran.append(batch.start)
        return run(self, techniques, source, batch)

    monkeypatch.setattr(runner.Runner, "run", counts)
    assert main.run([*TINY, "--out", str(out)]) == 0
    assert ran == 4 * [0, 2]  # two batches of two patterns in two studies, each once
    printed = capsys.readouterr().out
    rows = _rows(out / "claims.csv")
    assert len(rows) == 4 * 3
    for row in rows:
        assert row["verdict"] in ("holds", "does not hold", "cannot be told")
        assert float(row["low"]) <= float(row["value"]) <= float(row["high"])
        assert row["unit"]
        assert row["reason"]
    for claim in {row["claim"] for row in rows}:
        assert claim.split()[0] in printed
    assert "LL > BL ~ LG > BG" in printed
    assert len(_rows(out / "measured.csv")) == 3 * 4 * 2 * 2
    (pair,) = _rows(out / "color_pairs.csv")
    assert pair["first"][0] == "#"
    assert (out / "claims.png").stat().st_size > 10_000

    # Once more finds everything, and says the same.
    before = (out / "claims.csv").read_bytes()
    assert main.run([*TINY, "--out", str(out)]) == 0
    assert len(ran) == 8
    assert (out / "claims.csv").read_bytes() == before


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ["color-space"],
            "paper must be one of kim, tidoaa, sobel, colour-space, all, got "
            "'color-space'.",
        ),
        (["colour-space", "--quick", "--sessions", "9"], "--quick and --sessions excl"),
        (["colour-space", "--sessions", "1"], "--sessions must be a whole number >= 2"),
        (
            ["colour-space", "--seed", "-1"],
            "--seed must be a whole number >= 0, got -1",
        ),
        (["colour-space", "--fov", "190"], "--fov must lie in (0, 180), got 190"),
        (["colour-space", "--width", "37"], "--width and --height must be multiples"),
    ],
)
def test_wrong_input_is_refused_in_one_line(options, message, tmp_path, capsys):
    assert main.run(["reproduce", *options, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_a_file_in_the_way_is_refused(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main.run([*TINY, "--out", str(tmp_path / "file")]) == 2
    assert "--out must be where files can be made" in capsys.readouterr().err
