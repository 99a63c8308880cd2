"""Scenes on the command line: listed, rendered, named in studies."""

from pathlib import Path

import numpy as np
import pytest
import small
from PIL import Image

import hmdjit as hj
from hmdjit.cli import definition, main, render
from hmdjit.scenes import registry
from hmdjit.trade_off import cost

PICTURE = hj.scenes.uniform(name="grey")
KNOWN = {"grey": PICTURE}


@pytest.fixture(autouse=True)
def few_scenes(monkeypatch):
    pipe = small.solids(movement=None)
    solids = {"fence": small.solids(), "pipe": pipe}
    made = [
        {name: lambda scene=scene: scene for name, scene in known.items()}
        for known in (KNOWN, solids | {"grey": small.NOISE})
    ]
    monkeypatch.setattr(registry, "_PICTURES", made[0])
    monkeypatch.setattr(registry, "SOLIDS", made[1])
    for where in (registry, hj.scenes):
        monkeypatch.setattr(where, "NAMES", ("grey", "fence", "pipe"))


@pytest.fixture
def picture(tmp_path):
    path = tmp_path / "photo.png"
    Image.fromarray(np.full((8, 8, 3), 90, np.uint8)).save(path)
    return path


def test_scenes_are_listed_with_what_they_give(capsys):
    assert main.run(["scenes"]) == 0
    grey, fence, _ = capsys.readouterr().out.splitlines()
    assert grey.split()[:2] == ["grey", "picture"]
    assert "solids   2 objects, 2 primitives" in fence
    assert "moves" in fence
    assert {"depth", "object_id", "velocity"} <= set(fence.split("gives")[1].split())


def test_techniques_are_listed_with_all_there_is_to_know(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    assert main.run(["techniques"]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    known = {row[0]: " ".join(row[1:]) for row in rows[2:] if row}
    assert [*known][: len(hj.techniques.IDS)] == [*hj.techniques.IDS]
    assert known["none"] == "- no 1 color"
    assert known["smaa"] == "Jimenez et al. 2012 no 1 color"
    assert known["accumulation16"] == "Oliveros 2018 no 16 color"
    assert main.run(["techniques", "fxa"]) == 2
    assert "Did you mean 'fxaa'?" in capsys.readouterr().err


def test_costs_are_measured(capsys, monkeypatch):
    sizes = {"SIDE_PX": 32, "FRAMES": 3, "SOLIDS_SIDE_PX": 32, "SOLIDS_FRAMES": 2}
    for name, size in sizes.items():
        monkeypatch.setattr(cost, name, size)
    monkeypatch.setattr(definition.scenes, "study_set", lambda: {"coffee": PICTURE})
    monkeypatch.setattr(render, "fence", small.solids)
    assert main.run(["techniques", "none", "--cost"]) == 0
    lines = capsys.readouterr().out.splitlines()
    (row,) = [line.split() for line in lines if line.startswith("none ")]
    assert float(row[-2]) > 0
    assert row[-1] == "0"
    found = cost.channels_ns(small.solids(), {"color", "depth"}, 1)
    assert np.isfinite(found)


def test_a_study_mixes_solids_pictures_and_files(picture):
    names = ("fence", str(picture), "grey")
    study = definition.build(definition.Options(scenes=names, techniques=("none",)))
    assert list(study.scenes) == ["fence", "photo", "grey"]
    assert study.scenes["grey"] is PICTURE  # the default study's come first
    assert study.neck is not None


def test_what_solids_rest_on_is_an_option_and_a_key(tmp_path, picture):
    path = tmp_path / "study.toml"
    path.write_text(
        "scenes = ['fence', 'photo.png']\nno_neck = true\n"
        "reference_samples = 4\nreference_every = 3\n"
    )
    options, _ = definition.read_toml(path)
    study = definition.build(options)
    assert list(study.scenes) == ["fence", "photo"]
    assert study.neck is None
    assert (study.reference_samples, study.reference_every) == (4, 3)


def test_baked_solids_have_colours_alone():
    settings = {"scenes": ("pipe",), "baked": True, "no_neck": True}
    options = definition.Options(**settings, techniques=("none",))
    assert "depth" not in definition.build(options).scenes["pipe"].gives
    with pytest.raises(ValueError, match="msaa4 needs coverage, which pipe"):
        definition.build(definition.Options(**settings, techniques=("msaa4",)))
    with pytest.raises(ValueError, match="it has depth"):
        hj.scenes.bake(small.solids(), small.CAMERA)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["study", "--scenes", "fense"], "Did you mean 'fence'"),
        (["study", "--scenes", "fence", "fence"], "got fence twice"),
        (["study", "--scenes", "lost.png"], "lost.png"),
        (["study", "--scenes", "fence", "--reference-every", "0"], "--reference-every"),
        (["study", "--scenes", "fence", "--baked"], "--baked must go with --no-neck"),
        (
            ["study", "--scenes", "fence", "--baked", "--no-neck"],
            "fence must not move to be baked",
        ),
        (["render", "fense"], "Did you mean 'fence'"),
        (["render", "fence", "--channel", "deep"], "Did you mean 'depth'"),
        (["render", "fence", "--out", "x.gif"], "--out must end in .png or .npy"),
        (
            ["render", "fence", "--channel", "depth", "--technique", "none"],
            "--technique must go with the channel color alone",
        ),
    ],
)
def test_wrong_scenes_are_named_in_one_line(arguments, message, capsys):
    assert main.run(arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line


SIZE = ["--width", "24", "--height", "18", "--fov", "4"]


def rendered(tmp_path, capsys, *arguments, out="x.png"):
    path = tmp_path / out
    assert main.run(["render", *arguments, *SIZE, "--out", str(path)]) == 0
    return path, capsys.readouterr().out


def test_depth_is_written_as_numbers_and_shown_in_words(tmp_path, capsys):
    words = ["fence", "--channel", "depth"]
    path, said = rendered(tmp_path, capsys, *words, out="x.npy")
    depth = np.load(path)
    assert depth.shape == (18, 24)
    assert depth.min() == pytest.approx(1.0, abs=0.02)
    assert depth.max() == pytest.approx(2.0, abs=1e-3)
    shown, said = rendered(tmp_path, capsys, *words)
    assert "white is the nearest" in said
    lightest = np.asarray(Image.open(shown))[depth == depth.min()]
    assert (lightest == 255).all()


@pytest.mark.parametrize("channel", ["object_id", "motion_class", "velocity"])
def test_other_channels_are_shown(channel, tmp_path, capsys):
    path, _ = rendered(tmp_path, capsys, "fence", "--channel", channel)
    picture = np.asarray(Image.open(path))
    assert picture.shape == (18, 24, 3)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 1


def test_a_technique_shows_its_first_frame(tmp_path, capsys):
    path, _ = rendered(tmp_path, capsys, "grey", "--technique", "msaa4")
    assert len(np.unique(np.asarray(Image.open(path)))) == 1
    assert Path(path).exists()
