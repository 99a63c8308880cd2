import dataclasses
from pathlib import Path

import jax
import pytest

import hmdjit as hj
from hmdjit.cli import definition
from hmdjit.cli.definition import Options
from hmdjit.head_motion import presets
from hmdjit.studies import identity
from hmdjit.techniques import SSAA, NoAntialiasing

FEW = Options(scenes=("noise",), techniques=("none",))


def test_what_is_not_said_keeps_the_default_study():
    study = definition.build(FEW)
    assert study.sessions == 500
    assert study.camera == hj.Camera()
    assert jax.tree.leaves(study.head) == jax.tree.leaves(
        hj.HeadMotion.preset(definition.HEAD)
    )


@pytest.mark.parametrize("name", list(presets.tables()))
def test_every_preset_is_a_head_of_a_study(name):
    study = definition.build(dataclasses.replace(FEW, head=name))
    assert study.head == hj.HeadMotion.preset(name)
    assert identity.head_words(study.head) == name


@pytest.mark.parametrize("name", ["me.toml", "me"])
def test_a_file_is_a_head_whatever_it_is_called(name, tmp_path):
    head = hj.HeadMotion((0.5,) * 3, (0.1,) * 3, (0.004,) * 3)
    presets.write(tmp_path / name, head, {})
    assert str(definition.head_model(str(tmp_path / name))) == str(head)
    # Of a definition, it lies beside the file that names it.
    (tmp_path / "study.toml").write_text(f"head = '{name}'")
    options, _ = definition.read_toml(tmp_path / "study.toml")
    assert options.head == str(tmp_path / name)


def test_a_definition_names_presets_as_they_are(tmp_path):
    (tmp_path / "study.toml").write_text("head = 'fixating'")
    options, _ = definition.read_toml(tmp_path / "study.toml")
    assert options.head == "fixating"


def test_a_definition_may_leave_failed_sessions_out(tmp_path):
    (tmp_path / "study.toml").write_text("omit_failed = true")
    options, _ = definition.read_toml(tmp_path / "study.toml")
    assert options.omit_failed
    assert not Options().omit_failed
    assert definition.merged(options, Options()).omit_failed


def test_a_table_named_like_a_technique_holds_its_numbers(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(
        "scenes = ['noise']\ntechniques = ['none', 'ssaa2', 'ssaa4']\n"
        "[ssaa4]\nspace = 'gamma'\n"
    )
    study = definition.build(*definition.read_toml(path))
    none, two, four = study.techniques
    assert (none, two) == (NoAntialiasing(), SSAA(2))
    assert four == SSAA(4, "gamma")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[ssaa4]\nfactor = 2", "unknown key ssaa4.factor"),
        ("[ssaa4]\nspace = 'srgb'", "ssaa4.space must be one of gamma, linear"),
        ("[msa4]\n", r"unknown key msa4. Did you mean msaa4\?"),
        ("[sessions]\n", "sessions must be a whole number, got {}"),
        ("whole_frame = 1", "whole_frame must be true or false, got 1"),
        ("scenes = []", r"scenes must be a list of at least one string, got \[\]"),
    ],
)
def test_wrong_keys_of_a_definition_are_named(text, message, tmp_path):
    (tmp_path / "study.toml").write_text(text)
    with pytest.raises(ValueError, match=f"study.toml: {message}"):
        definition.read_toml(tmp_path / "study.toml")


@pytest.mark.parametrize(
    ("low", "high"),
    [
        ({"head": "fixating"}, {"trace": (Path("me.csv"),)}),
        ({"trace": (Path("me.csv"),)}, {"head": "fixating"}),
        ({"crop": 64}, {"tiles": 3}),
        ({"tile_size": 32}, {"whole_frame": True}),
        ({"images": (Path("a.png"),)}, {"scenes": ("noise",)}),
    ],
)
def test_the_command_line_overrides_a_files_rivals(low, high):
    assert definition.merged(Options(**low), Options(**high)) == Options(**high)


def test_a_head_overrides_how_a_files_logs_are_read():
    low = Options(trace=(Path("a.csv"),), axes="unity", skip_held=True, frames=4)
    expected = Options(head="seated", frames=4)
    assert definition.merged(low, Options(head="seated")) == expected


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ({"head": "seated", "trace": (Path("me.csv"),)}, "--head and --trace exclude"),
        ({"tiles": 0, "crop": 64}, "--tiles and --crop exclude"),
        ({"tile_size": 32, "whole_frame": True}, "--tiles and --whole-frame exc"),
        (
            {"scenes": ("noise",), "images": (Path("a.png"),)},
            "--scenes and --images ex",
        ),
    ],
)
def test_rivals_are_refused(said, message):
    with pytest.raises(ValueError, match=message):
        definition.build(Options(**said))
