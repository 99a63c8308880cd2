import math
import tomllib

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hmdjit import _toml
from hmdjit.head_motion import Amplitude, HeadMotion, Resonator, presets

TABLES = presets.tables()
CLASSMETHODS = {
    "seated": HeadMotion.seated,
    "fixating": HeadMotion.fixating,
    "free_viewing": HeadMotion.free_viewing,
    "tracker_noise": HeadMotion.tracker_noise,
}

PLAIN = """\
speed_rms_deg_s = [0.9, 0.6, 0.7]
correlation_time_s = [0.15, 0.23, 0.19]
tracker_noise_deg = [0.0038, 0.0037, 0.0036]
"""
MODE = (
    "{ speed_rms_deg_s = [1, 1, 1], frequency_hz = [3, 3, 3], damping = [0.1, 1, 2] }"
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("heads")


# --- the presets ---


def places(table):
    """Where a table holds numbers: the same nesting with None for each."""
    if isinstance(table, dict):
        return {key: places(value) for key, value in table.items()}
    if isinstance(table, list):
        return [places(entry) for entry in table]
    return None


@pytest.mark.parametrize("name", TABLES)
def test_presets_load_and_say_where_they_come_from(name):
    table = TABLES[name]
    head = HeadMotion.preset(name)
    assert CLASSMETHODS[name]() == head
    assert all(math.isfinite(leaf) for leaf in jax.tree.leaves(head))
    assert isinstance(table["source"], str)
    assert "arXiv" in table["source"] or "doi" in table["source"]


@pytest.mark.parametrize("name", TABLES)
def test_presets_are_known_by_their_numbers(name):
    head = HeadMotion.preset(name)
    assert presets.name_of(head) == name
    assert presets.name_of(jax.tree.map(lambda x: 1.5 * x, head)) is None


@pytest.mark.parametrize("name", [name for name in TABLES if name != "tracker_noise"])
def test_presets_say_how_sure_each_number_is(name):
    table = TABLES[name]
    numbers = {key: table[key] for key in table if key not in presets.ABOUT}
    assert places(table["standard_error"]) == places(numbers)
    of_head = _toml.table(HeadMotion.preset(name))
    assert places(numbers) == {key: places(of_head[key]) for key in numbers}
    errors = jax.tree.leaves(table["standard_error"])
    # NaN: not fitted.
    assert all(math.isnan(error) or error > 0 for error in errors)
    assert sum(map(math.isnan, errors)) <= 2


def test_every_preset_has_a_name_of_its_own():
    assert set(TABLES) == set(CLASSMETHODS)
    with pytest.raises(
        ValueError, match=r"head must be one of .* Did you mean 'seated"
    ):
        HeadMotion.preset("seatd")


# --- there and back ---

_positive = st.floats(1e-6, 1e6)
_not_negative = st.one_of(st.just(0.0), _positive)
_three = lambda numbers: st.tuples(numbers, numbers, numbers)
_modes = st.builds(
    Resonator, _three(_not_negative), _three(_positive), _three(_positive)
)
_bursts = st.builds(Amplitude, _not_negative, _positive)
heads = st.builds(
    HeadMotion,
    _three(_not_negative),
    _three(_positive),
    _three(_not_negative),
    return_time_s=_positive,
    person_sd=_not_negative,
    resonators=st.lists(_modes, max_size=3),
    amplitude=st.none() | _bursts,
)


@given(heads)
def test_tables_give_the_same_head(head):
    assert presets.from_table(HeadMotion, _toml.table(head)) == head


# What TOML cannot have in a string as it is, and more than one line.
_sources = st.text(
    st.characters(exclude_categories=("Cc", "Cs"), include_characters="\n")
)


@given(heads, _sources)
@settings(max_examples=25)
def test_files_give_the_same_head_to_six_digits(folder, head, source):
    path = folder / "head.toml"
    about = {"source": source, "fit": {"bic": [1, 2.5], "of": 'a "b" \\'}}
    presets.write(path, head, about | {"standard_error": {"return_time_s": math.nan}})
    rounded = jax.tree.map(lambda leaf: float(f"{leaf:.6g}"), head)
    assert HeadMotion.read(path) == rounded
    held = tomllib.loads(path.read_text(encoding="utf-8"))
    assert {key: held[key] for key in about} == about
    assert math.isnan(held["standard_error"]["return_time_s"])
    assert [entry.name for entry in folder.iterdir()] == ["head.toml"]


@pytest.mark.parametrize("name", TABLES)
def test_presets_survive_a_file(name, folder):
    path = folder / "head.toml"
    about = {key: TABLES[name][key] for key in presets.ABOUT if key in TABLES[name]}
    presets.write(path, HeadMotion.preset(name), about)
    assert HeadMotion.read(path) == HeadMotion.preset(name)
    held = tomllib.loads(path.read_text(encoding="utf-8"))
    for ours, recorded in zip(
        jax.tree.leaves({key: held[key] for key in about}),
        jax.tree.leaves(about),
        strict=True,
    ):
        assert ours == recorded or (np.isnan(ours) and np.isnan(recorded))


def test_a_table_needs_no_more_than_a_wander(folder):
    path = folder / "plain.toml"
    path.write_text(PLAIN)
    numbers = ((0.9, 0.6, 0.7), (0.15, 0.23, 0.19), (0.0038, 0.0037, 0.0036))
    assert HeadMotion.read(path) == HeadMotion(*numbers)
    path.write_text(f"{PLAIN}resonators = [{MODE}]\nreturn_time_s = 4\n")
    mode = Resonator((1, 1, 1), (3, 3, 3), (0.1, 1, 2))
    assert HeadMotion.read(path) == HeadMotion(*numbers, 4.0, resonators=(mode,))


# --- what is refused ---


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"speed_rms_deg_s is missing\."),
        (PLAIN.replace("tracker", "#"), r"tracker_noise_deg is missing\."),
        (
            PLAIN + "retrun_time_s = 3",
            r"unknown key retrun_time_s\. Did you mean return_time_s\?",
        ),
        (PLAIN + "[head]\nx = 1", r"unknown key head\. Known are speed_rms_deg_s, "),
        (PLAIN + "person_sd = true", r"person_sd must be a number, got True\."),
        (PLAIN + "person_sd = 'much'", r"person_sd must be a number, got 'much'\."),
        (
            PLAIN + "person_sd = [1, 1, 1]",
            r"person_sd must be a number, got \[1, 1, 1\]",
        ),
        (PLAIN + "person_sd = -1", r"person_sd must lie in \[0, inf\), got -1\."),
        (PLAIN + "return_time_s = inf", r"return_time_s must lie in .* got inf\."),
        (
            PLAIN.replace("[0.9, 0.6, 0.7]", "0.9"),
            r"speed_rms_deg_s must be a list of 3 numbers, got 0\.9\.",
        ),
        (
            PLAIN.replace("0.9, ", ""),
            r"speed_rms_deg_s must be a list of 3 .* got \[0\.6, 0\.7\]",
        ),
        (
            PLAIN.replace("0.9", "'0.9'"),
            r"speed_rms_deg_s must be a list of 3 numbers, got \[",
        ),
        (
            PLAIN.replace("0.15", "0"),
            r"correlation_time_s \(pitch\) must lie in \(0, inf",
        ),
        (PLAIN + "resonators = 3", r"resonators must be a list of tables, got 3\."),
        (
            PLAIN + f"resonators = {MODE}",
            r"resonators must be a list of tables, got \{",
        ),
        (PLAIN + "resonators = [1]", r"resonators\[0\] must be a table, got 1\."),
        (
            PLAIN + f"resonators = [{MODE}, {MODE.replace('damping', 'damp')}]",
            r"unknown key resonators\[1\]\.damp\. Did you mean reson.*\.damping",
        ),
        (
            PLAIN + f"resonators = [{MODE.replace('0.1, 1, 2', '0.1, 0, 2')}]",
            r"resonators\[0\]\.damping \(yaw\) must lie in \(0, inf\), got 0\.",
        ),
        (
            PLAIN + f"resonators = [{MODE.replace('3, 3, 3', '3, 3')}]",
            r"resonators\[0\]\.frequency_hz must be a list of 3 .* got \[3, 3\]\.",
        ),
        (PLAIN + "amplitude = 0.5", r"amplitude must be a table, got 0\.5\."),
        (PLAIN + "amplitude.sd = 0.5", r"amplitude\.correlation_time_s is missing\."),
        (
            PLAIN + "amplitude = { sd = -1, correlation_time_s = 1 }",
            r"amplitude\.sd must lie in \[0, inf\), got -1\.",
        ),
        (PLAIN + "person_sd = ", r".*line 4.*|.*end of document.*"),  # TOML's own words
        (PLAIN + PLAIN, r".*line 4.*"),
    ],
)
def test_malformed_tables_are_refused_in_one_line(text, message, folder):
    path = folder / "bad.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as error:
        HeadMotion.read(path)
    assert str(error.value).startswith(f"{path}: ")
    assert "\n" not in str(error.value)


def test_unreadable_files_are_refused(folder):
    with pytest.raises(ValueError, match=r"absent\.toml: cannot be read: No such file"):
        HeadMotion.read(folder / "absent.toml")
    with pytest.raises(ValueError, match=r"cannot be read: Is a directory"):
        HeadMotion.read(folder)
    (folder / "binary.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(ValueError, match=r"binary\.toml: .*can't decode"):
        HeadMotion.read(folder / "binary.toml")
