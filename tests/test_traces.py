"""The sample traces are what their README says: hmdjit's own, and readable."""

import re
from pathlib import Path

import jax
import numpy as np
import pytest

import hmdjit as hj
from hmdjit.studies.sessions import study_key

TRACES = Path(__file__).parents[1] / "traces"
COMMAND = re.compile(
    r"hmdjit head sample --model (\w+) --rate (\d+) --seconds (\d+) --seed (\d+) "
    r"--out traces/(\S+)"
)
COMMANDS = COMMAND.findall((TRACES / "README.md").read_text(encoding="utf-8"))


def test_every_sample_is_made_by_a_command():
    made = {name for *_, name in COMMANDS}
    assert made == {path.name for path in TRACES.glob("*.csv")}
    assert len(made) == 6


# Every length is a program of its own.
@pytest.mark.parametrize(
    ("model", "rate", "seconds", "seed", "name"),
    [
        pytest.param(*command, marks=[pytest.mark.slow] * (i > 0))
        for i, command in enumerate(COMMANDS)
    ],
)
def test_samples_are_what_their_command_draws(model, rate, seconds, seed, name):
    trace = hj.Trace.read(TRACES / name)
    assert trace.rate_hz == pytest.approx(float(rate), rel=1e-4)
    assert trace.duration_s == pytest.approx(float(seconds), abs=0.02)
    head = hj.HeadMotion.preset(model)
    # Without 64 bits, as the command runs.
    with jax.enable_x64(False):
        frames = len(trace.t_s)
        path = head.rotation_vectors(study_key(int(seed)), float(rate), frames)
        path = np.array(path, float)
    drawn = np.linalg.norm(path, axis=1)
    recorded = 2 * np.arccos(np.clip(np.abs(trace.world_from_head[:, 0]), 0, 1))
    # Angles of some degrees from w, which has some 1e-9.
    np.testing.assert_allclose(recorded, drawn, atol=1e-4)
