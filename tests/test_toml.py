import re
import tomllib

import pytest

from hmdjit import _toml
from hmdjit.head_motion import HeadMotion, presets
from hmdjit.head_motion.parameters import Resonator

ABOUT = ("source", "fit", "standard_error")
HEAD = {
    "speed_rms_deg_s": [1, 2.0, 3.0],
    "correlation_time_s": [0.1, 0.1, 0.1],
    "tracker_noise_deg": [0.0, 0.0, 0.0],
}
MODE = {name: [1.0, 1.0, 1.0] for name in ("speed_rms_deg_s", "frequency_hz")}


@pytest.mark.parametrize("name", list(presets.tables()))
def test_nested_tables_make_a_config_and_come_back(name, tmp_path):
    table = {k: v for k, v in presets.tables()[name].items() if k not in ABOUT}
    head = _toml.config(HeadMotion, table)
    assert head == HeadMotion.preset(name)
    _toml.write(tmp_path / "a.toml", _toml.table(head), {"about": {"x y": 1}})
    held = tomllib.loads((tmp_path / "a.toml").read_text())
    assert held.pop("about") == {"x y": 1}
    assert _toml.config(HeadMotion, held) == head


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"speed": 1}, "unknown key head.speed."),
        ({"person_sd": "a"}, "head.person_sd must be a number, got 'a'."),
        ({"person_sd": -1}, "head.person_sd must lie in [0, inf), got -1."),
        (
            {"tracker_noise_deg": [1.0]},
            "head.tracker_noise_deg must be a list of 3 numbers, got [1.0].",
        ),
        ({"resonators": 3}, "head.resonators must be a list of tables, got 3."),
        ({"resonators": [3]}, "head.resonators[0] must be a table, got 3."),
        ({"resonators": [MODE]}, "head.resonators[0].damping is missing."),
        ({"amplitude": {"sd": True}}, "head.amplitude.sd must be a number, got True."),
    ],
)
def test_what_is_wrong_is_named_with_what_is_allowed(change, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}"):
        _toml.config(HeadMotion, HEAD | change, "head")


def test_whole_numbers_stand_for_numbers():
    mode = _toml.config(Resonator, MODE | {"damping": [1, 1, 1]})
    assert mode.damping == (1.0, 1.0, 1.0)
