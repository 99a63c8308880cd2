import dataclasses
import re
import tomllib

import jax
import jax.numpy as jnp
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hmdjit import curves, techniques
from hmdjit.cli import definition
from hmdjit.techniques import SSAA, HeadMovement, curve_file

SPLINE = curves.Spline((0.1, 0.0, 1 / 3, 2e-9))
FULL = HeadMovement(
    w_min=0.1 + 0.2,
    w_lb=1e-05,
    h_max_deg_s=1e22,
    closeness=(1 / 3, 0.7),
    weights=(1.0, 3.0),
    difference="same_pixel",
    space="linear",
    ease=SPLINE,
    localization=curves.Cosine(0.7),
)


def written(path, technique, **options):
    curve_file.write(path, technique, **options)
    return curve_file.read(path)


@pytest.mark.parametrize("technique", [HeadMovement(), FULL], ids=["kim", "full"])
def test_a_file_holds_a_technique_to_the_bit(tmp_path, technique):
    again = written(tmp_path / "mine.toml", technique)
    assert again.id == "head_movement:mine"
    assert dataclasses.replace(again, label="") == technique


unit = st.floats(0, 1)


@given(st.tuples(unit, unit), st.lists(unit, min_size=3).filter(sum))
def test_any_numbers_come_back(tmp_path_factory, weights, increments):
    w_lb, w_min = sorted(weights)
    technique = HeadMovement(w_min, w_lb, ease=curves.Spline(increments))
    path = tmp_path_factory.mktemp("files") / "a.toml"
    assert jax.tree.leaves(written(path, technique)) == jax.tree.leaves(technique)


def test_numbers_in_arrays_are_written_too(tmp_path):
    technique = jax.tree.map(jnp.asarray, FULL)
    again = written(tmp_path / "a.toml", technique)
    assert jax.tree.leaves(again) == jax.tree.leaves(FULL)


def test_what_is_not_said_is_kims(file):
    path = file("[head_movement]\nw_min = 0.5\n[head_movement.ease]\nfamily='cosine'\n")
    expected = HeadMovement(0.5, ease=curves.Cosine(2.0), label="me")
    assert curve_file.read(path) == expected


def test_other_tables_are_written_and_passed_over(tmp_path):
    about = {"fit": {"head": 'a "b"', "x y": [1, 2.5, {"z": True}]}, "made by": {}}
    path = tmp_path / "a.toml"
    assert written(path, HeadMovement(), about=about) == HeadMovement(label="a")
    held = tomllib.loads(path.read_text())
    assert {name: held[name] for name in about} == about


class Mine(curves.Linear):
    """A curve of a user's own."""


@pytest.mark.parametrize(
    ("technique", "about", "message"),
    [
        (HeadMovement(resolve=SSAA(2)), {}, "resolve must be None in a file, got ssaa"),
        (
            HeadMovement(ease=Mine()),
            {},
            "ease must be of the families kim, .* got a Mine",
        ),
        (HeadMovement(), {"head_movement": {}}, "about must name other tables"),
    ],
)
def test_what_no_file_can_hold_is_refused(tmp_path, technique, about, message):
    with pytest.raises(ValueError, match=message):
        curve_file.write(tmp_path / "a.toml", technique, about)
    assert not list(tmp_path.iterdir())


WRONG = [
    ("x = = 3", "not a TOML file"),
    ("[fit]\na = 1", "table head_movement is missing"),
    ("w_min = 0.3", "unknown key w_min"),
    ("head_movment = 3", r"unknown key head_movment. Did you mean head_movement\?"),
    ("head_movement = 3", "head_movement must be a table, got 3"),
    (
        "[head_movement]\nwmin = 0.3",
        r"unknown key head_movement.wmin. Did you mean head_movement.w_min\?",
    ),
    ("[head_movement]\nlabel = 'a'", "unknown key head_movement.label"),
    (
        "[head_movement]\nw_min = 1.5",
        r"head_movement.w_min must lie in \[0, 1\], got 1.5.$",
    ),
    ("[head_movement]\nw_min = nan", r"w_min must lie in \[0, 1\], got nan.$"),
    ("[head_movement]\nw_min = true", "w_min must be a number, got True"),
    (f"[head_movement]\nh_max_deg_s = 1{400 * '0'}", "h_max_deg_s must be a number"),
    (
        "[head_movement]\ncloseness = 0.5",
        "closeness must be a list of at least one number, got 0.5",
    ),
    (
        "[head_movement]\ncloseness = ['a']",
        "closeness must be a list of at least one number",
    ),
    ("[head_movement]\nspace = 3", "space must be a string, got 3"),
    ("[head_movement]\nease = 3", "head_movement.ease must be a table with a family"),
    ("[head_movement.ease]\nexponent = 3", "ease must be a table with a family"),
    (
        "[head_movement.ease]\nfamily = 'cosin'",
        r"head_movement.ease.family must be one of .* Did you mean 'cosine'\?",
    ),
    (
        "[head_movement.ease]\nfamily = 'cosine'\nexponant = 3",
        r"unknown key head_movement.ease.exponant. Did you mean .*exponent\?",
    ),
    (
        "[head_movement.localization]\nfamily = 'cosine'\nexponent = 0.1",
        r"head_movement.localization.exponent must lie in \[0.5, inf\), got 0.1.$",
    ),
    (
        "[head_movement.ease]\nfamily = 'spline'",
        "head_movement.ease.increments is missing",
    ),
    (
        "[head_movement.ease]\nfamily = 'spline'\nincrements = [1, 2]",
        "head_movement.ease.increments must be at least 3 numbers, got 2",
    ),
]


@pytest.mark.parametrize(("text", "message"), WRONG)
def test_wrong_files_are_refused_in_one_line(file, text, message):
    path = file(text, "bad.toml")
    with pytest.raises(ValueError, match=f"bad.toml: .*{message}") as error:
        curve_file.read(path)
    assert "\n" not in str(error.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"no.toml: cannot be read: No such file"):
        techniques.by_id(f"head_movement:{tmp_path}/no.toml")


# --- by id, in studies ---


@pytest.mark.parametrize("folder", [".", "a+b", "a.toml+ssaa2"])
def test_an_id_may_name_a_file(tmp_path, folder):
    path = tmp_path / folder / "a+b.toml"
    curve_file.write(path, FULL)
    plain = techniques.by_id(f"head_movement:{path}")
    assert plain == curve_file.read(path)
    assert plain.id == "head_movement:a+b"
    resolving = techniques.by_id(f"head_movement:{path}+ssaa2")
    assert resolving.id == "head_movement:a+b+ssaa2"
    assert isinstance(resolving, HeadMovement)
    assert resolving.resolve == SSAA(2)
    assert resolving.ease == SPLINE


def test_a_definition_may_name_files_and_curves(tmp_path):
    curve_file.write(tmp_path / "mine.toml", FULL)
    path = tmp_path / "study.toml"
    path.write_text(
        "scenes = ['noise']\n"
        "techniques = ['head_movement:mine.toml', 'head_movement+ssaa2', 'none']\n"
        "[head_movement]\nw_min = 0.2\n"
        "ease = {family = 'spline', increments = [1, 2, 1]}\n"
    )
    study = definition.build(*definition.read_toml(path))
    mine, plain, _ = study.techniques
    # Relative to the definition, and unchanged by its table.
    assert mine == curve_file.read(tmp_path / "mine.toml")
    ease = curves.Spline((1, 2, 1))
    assert plain == HeadMovement(w_min=0.2, ease=ease, resolve=SSAA(2))


def test_a_table_for_plain_head_movement_needs_one(tmp_path):
    curve_file.write(tmp_path / "mine.toml", FULL)
    options = definition.Options(
        scenes=("noise",), techniques=(f"head_movement:{tmp_path}/mine.toml", "none")
    )
    with pytest.raises(ValueError, match=re.escape("[head_movement] is set, but no")):
        definition.build(options, {"head_movement": {"w_min": 0.2}})
