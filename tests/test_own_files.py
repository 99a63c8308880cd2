"""Techniques and scenes that a user's own Python files name."""

import re
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small

import hmdjit as hj
from hmdjit.cli import definition
from hmdjit.cli import main as cli
from hmdjit.studies.store import without_version

TECHNIQUE = """
import hmdjit as hj
import own_numbers
from hmdjit.frames.sources import History


class Smoothing(hj.techniques.AbstractTechnique):
    version = 1
    id = "smoothing"

    def init(self, frame):
        return History.of(frame.color[0])

    def step(self, state, frame, motion):
        past = state.at(frame.displacement(motion.increment))
        shown = past + own_numbers.ALPHA * (frame.color[0] - past)
        return History.of(shown), shown


class Half(hj.techniques.AbstractTechnique):
    id = "half"

    def init(self, frame):
        return None


class Darker(hj.techniques.AbstractSpatial):
    id = "darker"

    def resolve(self, frame):
        return 0.5 * frame.color[0]


class Asking(Darker):
    alpha: float


smoothing = Smoothing()
number = 3
"""
SCENE = """
import jax.numpy as jnp
import hmdjit as hj


def stripes(x, y):
    return jnp.where(jnp.sin(x) > 0, 1.0, 0.0)


def scene():
    return hj.scenes.from_function(stripes)


made = hj.scenes.uniform(name="plain")
number = 3


def failing():
    return 1 / 0
"""


@pytest.fixture
def files(tmp_path, monkeypatch):
    """A folder with files, forgotten afterwards."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    before = set(sys.modules)
    contents = {
        "own_technique": TECHNIQUE,
        "own_numbers": "ALPHA = 0.2\n",
        "own_scene": SCENE,
        "own_wrong": "x = (\n",
        "own_broken": "import hmdjit\n\nhmdjit.nothing\n",
        "json": "x = 1\n",
    }
    for name, text in contents.items():
        (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    for name in set(sys.modules) - before:
        if name.startswith("own_"):
            del sys.modules[name]


def test_a_study_takes_techniques_and_scenes_of_ones_own(files):
    options = definition.Options(
        techniques=("none", "own_technique.py:Smoothing"),
        scenes=("noise", "own_scene.py:scene", f"{files}/own_scene.py:made"),
    )
    study = definition.build(options)
    assert [technique.id for technique in study.techniques] == ["none", "smoothing"]
    assert list(study.scenes) == ["noise", "stripes", "plain"]
    assert without_version(study.techniques) == []
    assert without_version(study.scenes["stripes"]) == ["stripes"]
    sharp = hj.techniques.by_id("own_technique.py:smoothing+sharpen")
    assert sharp.id == "smoothing+sharpen"


def test_files_in_a_definition_are_beside_it(files):
    (files / "there").mkdir()
    (files / "own_scene.py").rename(files / "there" / "own_scene.py")
    (files / "there" / "STUDY.toml").write_text(
        'scenes = ["own_scene.py:made"]\ntechniques = ["own_technique.py:Smoothing"]\n'
    )
    options, _ = definition.read_toml(files / "there" / "STUDY.toml")
    assert list(definition.named_scenes(options.scenes)) == ["plain"]
    assert options.techniques == (str(files / "there/own_technique.py:Smoothing"),)


WRONG = [
    (["--techniques", "own_none.py:A"], r"own_none\.py: there is no such file"),
    (
        ["--techniques", "own_technique.py:Smothing"],
        r"own_technique\.py: has no 'Smothing'\. Did you mean 'Smoothing'\?",
    ),
    (
        ["--techniques", "own_technique.py:Half"],
        r"own_technique\.py:Half: TypeError: .*abstract.*step",
    ),
    (["--techniques", "own_technique.py:Asking"], r"Asking: TypeError: .*alpha"),
    (["--techniques", "own_technique.py:number"], r"must be a subclass of .*, got int"),
    (["--techniques", "own_technique.py:Darker"], r"darker must keep a constant scene"),
    (["--techniques", "own_wrong.py:A"], r"own_wrong\.py, line 1: SyntaxError"),
    (["--scenes", "own_broken.py:A"], r"own_broken\.py, line 3: AttributeError"),
    (["--scenes", "json.py:x"], r"json\.py: must have another name"),
    (["--scenes", "own_scene.py:number"], r"number must be a scene, .* got int"),
    (
        ["--scenes", "own_scene.py:failing"],
        r"own_scene\.py:failing, line 19: ZeroDivisionError",
    ),
]


@pytest.mark.parametrize(("arguments", "message"), WRONG)
def test_wrong_files_end_in_one_clear_line(arguments, message, files, capsys):
    assert cli.run(["study", *arguments]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert re.search(message, line), line


# --- scenes of functions ---


def _checks(x, y):
    return jnp.mod(jnp.floor(x / 2) + jnp.floor(y / 2), 2)


def test_a_function_paints_what_the_same_pattern_does():
    ours, theirs = (
        np.asarray(hj.scenes.bake(scene, small.CAMERA, margin_deg=1.0).color)
        for scene in (hj.scenes.from_function(_checks), hj.scenes.checkerboard(2.0))
    )
    np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("form", [list, tuple, jnp.stack])
def test_colours_are_three_numbers_to_the_right_and_up(form):
    f = lambda x, y: form([0.5 + x / 200, 0.5 + y / 200, 0.25 + 0 * x])
    scene = hj.scenes.from_function(f, name="ramps")
    assert scene.name == "ramps"
    direction = jnp.array([np.tan(0.1), np.tan(0.2), -1.0])
    found = scene.color(hj.Camera(), direction)
    right, up = np.degrees(np.tan([0.1, 0.2]))
    np.testing.assert_allclose(found, [0.5 + right / 200, 0.5 + up / 200, 0.25])
    assert jax.jit(lambda d: scene.color(hj.Camera(), d))(direction).shape == (3,)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda x, y: 2.0 + 0 * x, r"\[2.0, 2.0, 2.0\] at \(-80, -80\)"),
        (lambda x, y: jnp.sin(x) / x * 0 + 0.5, r"nan.* at \(0, -80\)"),
        (lambda x, y: (x, y), r"it returned 2 numbers"),
        (lambda x, y: None, r"got ValueError: None is"),
        (lambda x, y: 1.0 if x > 0 else 0.0, r"got TracerBoolConversionError"),
        (lambda x: x, r"got TypeError: .*positional argument"),
    ],
)
def test_what_is_no_colour_is_refused_at_the_door(function, message):
    start = "function 'lambda' must return a number or three in"
    with pytest.raises(ValueError, match=start) as error:
        hj.scenes.from_function(function)
    assert re.search(message, str(error.value)), error.value


def test_a_function_with_a_version_is_known():
    def f(x, y):
        return 0.5

    assert without_version(hj.scenes.from_function(f)) == [f.__qualname__]
    setattr(f, "version", 1)  # noqa: B010  as pyright knows no attributes of functions
    assert without_version(hj.scenes.from_function(f)) == []
