import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
QUICK = {
    "axes_of_a_head.py": (),
    "flicker_of_heads.py": ("--sessions", "4", "--scenes", "astronaut"),
    "ratio_against_correlation.py": ("--sessions", "4", "--crop", "16"),
}


def test_every_example_is_run():
    assert {path.name for path in EXAMPLES.glob("*.py")} == set(QUICK)


@pytest.mark.slow
@pytest.mark.parametrize("name", QUICK)
def test_examples_write_their_picture(name, tmp_path):
    out = tmp_path / "picture.png"
    command = [sys.executable, str(EXAMPLES / name), *QUICK[name], "--out", str(out)]
    subprocess.run(command, check=True, cwd=EXAMPLES.parent, timeout=300)
    assert out.stat().st_size > 10_000
