import re
from pathlib import Path

import pytest

from hmdjit import scenes

README = Path(__file__).parents[1] / "README.md"


def _blocks(language):
    text = README.read_text(encoding="utf-8")
    return re.findall(rf"```{language}\n(.*?)```", text, re.S)


def test_two_lines_do_all_the_set_up():
    assert [block.count("\n") for block in _blocks("sh")] == [1, 1]


@pytest.mark.slow
def test_the_example_of_the_interface_runs_as_printed(capsys):
    (example,) = _blocks("python")
    assert len([line for line in example.splitlines() if line]) <= 14
    exec(compile(example, "README.md", "exec"), {})
    first, second = capsys.readouterr().out.splitlines()
    mtcd, loss = map(float, first.split())
    assert mtcd > 0
    assert loss > 0
    assert float(second) > 0  # more weight on the current picture: more flicker


@pytest.mark.parametrize("name", scenes.CREDITS)
def test_every_photograph_is_credited(name):
    assert name in README.read_text(encoding="utf-8")
