"""Whether an installation is well, and examples in the help of all commands."""

import importlib.metadata
import json
import re
import shlex

import jax
import pytest
import tyro

from hmdjit.cli import doctor
from hmdjit.cli import main as cli

COMMANDS = [*cli.COMMANDS, "head fit", "head describe", "head sample"]


def test_ten_lines_say_how_the_installation_is(capsys):
    assert cli.run(["doctor"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 10
    known = {line[:18].strip(): line[18:] for line in lines}
    assert jax.__version__ in known["jax"]
    assert known["program"].startswith("right, off by ")
    assert "study" in known["extras"] or "not known" in known["extras"]


def test_machines_are_told_the_same(capsys):
    assert cli.run(["doctor", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["devices"]
    assert found["dtype"] == "float64"  # of these tests
    assert found["program"]["well"]


def test_what_an_extra_lacks_is_named(monkeypatch):
    needs = [
        "jax>=0.8",
        "tyro>=0.9; extra == 'study'",
        "not-there[x]>=1 ; extra == 'study'",
        "numpy; extra == 'test'",
    ]
    monkeypatch.setattr(importlib.metadata, "requires", lambda name: needs)
    assert doctor._extras() == {"study": ["not-there"], "test": []}


def test_a_wrong_program_fails(monkeypatch, capsys):
    monkeypatch.setattr(doctor, "log", lambda q: 1.001 * q[1:])
    assert cli.run(["doctor"]) == 1
    assert "WRONG, off by" in capsys.readouterr().out


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_has_an_example_that_parses(command, capsys):
    with pytest.raises(SystemExit):
        cli.run([*command.split(), "--help"])
    found = re.search(r"For example: hmdjit (.+)", capsys.readouterr().out)
    assert found is not None
    arguments = shlex.split(found[1])
    assert arguments[: len(command.split())] == command.split() or command == "head"
    parsed = tyro.extras.subcommand_cli_from_dict(cli.COMMANDS, args=arguments)
    assert hasattr(parsed, "run")
