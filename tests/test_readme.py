import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import hmdjit as hj
from hmdjit import scenes

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
TEXT = README.read_text(encoding="utf-8")
PAGES = (README, ROOT / ".github" / "CONTRIBUTING.md", *ROOT.glob("examples/*.md"))


def _blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", TEXT, re.S)


FRAMES, TECHNIQUE, INTERFACE = _blocks("python")


def _printed(block, capsys):
    exec(compile(block, "README.md", "exec"), {})
    return capsys.readouterr().out


def test_two_lines_do_all_the_set_up():
    assert [block.count("\n") for block in _blocks("sh")] == [1, 1]


def test_it_is_short():
    assert TEXT.count("\n") <= 220


def test_frames_and_a_pose_log_run_as_printed(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    np.save("frames.npy", rng.random((4, 12, 16, 3), np.float32))
    trace = hj.Trace.read(ROOT / "traces" / "fixating_90hz.csv")
    hj.Trace(trace.t_s[:4], trace.world_from_head[:4]).write("poses.csv")
    rendered, shown = map(float, _printed(FRAMES, capsys).split())
    assert rendered > shown > 0


@pytest.mark.slow
def test_a_technique_of_ones_own_runs_as_printed(capsys):
    assert len(TECHNIQUE.partition("class ")[2].partition("\n\n\n")[0].split("\n")) < 20
    short = TECHNIQUE.replace("sessions=500", "sessions=4")
    assert short != TECHNIQUE
    values = re.findall(r"\[\s*([\d.]+)\s*\]", _printed(short, capsys))
    none, smoothing = map(float, values)
    assert none > smoothing > 0


@pytest.mark.slow
def test_the_example_of_the_interface_runs_as_printed(capsys):
    assert len([line for line in INTERFACE.splitlines() if line]) <= 14
    first, second = _printed(INTERFACE, capsys).splitlines()
    mtcd, loss = map(float, first.split())
    assert mtcd > 0
    assert loss > 0
    assert float(second) > 0  # more weight on the current picture: more flicker


@pytest.mark.parametrize("name", scenes.CREDITS)
def test_every_photograph_is_credited(name):
    assert name in TEXT


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_files_that_pages_name_exist(page):
    text = page.read_text(encoding="utf-8")
    linked = re.findall(r"\]\(([^):]+)\)", text)
    named = re.findall(r"`((?:hmdjit|tests|examples|traces|\.github)/[\w./]+)`", text)
    missing = [link for link in linked if not (page.parent / link).exists()]
    named = [name for name in named if "NAME" not in name]
    assert missing + [name for name in named if not (ROOT / name).exists()] == []


def test_every_page_of_numbers_is_linked():
    pages = {f"examples/{page.name}" for page in ROOT.glob("examples/*.md")}
    assert pages <= set(re.findall(r"\]\(([^)]+)\)", TEXT))


def test_the_citation_names_this_version():
    lines = (ROOT / "CITATION.cff").read_text(encoding="utf-8").splitlines()
    assert f"version: {hj.__version__}" in lines
    assert "title: hmdjit" in lines
    assert "license: MIT" in lines


def test_types_and_citation_are_packaged():
    assert (Path(hj.__file__).parent / "py.typed").is_file()
    build = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    sdist = build["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    assert all((ROOT / name).exists() for name in sdist)
    assert {"CITATION.cff", "README.md", "LICENSE", "hmdjit"} <= set(sdist)
