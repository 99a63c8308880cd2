"""The command line: parse, run a command, and tell what went wrong in one line."""

import codecs
import io
import os
import sys
from collections.abc import Sequence
from typing import Any

import rich.console
import tyro

from .._version import __version__
from ..reports.tables import spelled
from ..studies.failures import FailedSessionsError, LostWorkersError
from .apply import ApplyCommand
from .doctor import DoctorCommand
from .envelope import EnvelopeCommand
from .fit import FitCommand
from .head import HeadCommand
from .options import FAILED, OK, WRONG_INPUT, as_option
from .options import INTERRUPTED as INTERRUPTED
from .render import RenderCommand, ScenesCommand, TechniquesCommand
from .report import ReportCommand
from .reproduce import ReproduceCommand
from .study import StudyCommand
from .sweep import SweepCommand
from .trade_off import PickCommand, TradeOffCommand

COMMANDS: dict[str, Any] = {
    "study": StudyCommand,
    "sweep": SweepCommand,
    "apply": ApplyCommand,
    "fit": FitCommand,
    "head": HeadCommand,
    "trade-off": TradeOffCommand,
    "pick": PickCommand,
    "envelope": EnvelopeCommand,
    "reproduce": ReproduceCommand,
    "report": ReportCommand,
    "scenes": ScenesCommand,
    "techniques": TechniquesCommand,
    "render": RenderCommand,
    "doctor": DoctorCommand,
}
SPELLED = "hmdjit-spelled"
"""How a terminal or a pipe writes what its encoding has no letter for."""
codecs.register_error(SPELLED, spelled)


def run(arguments: Sequence[str]) -> int:
    """Run a command; returns the exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=SPELLED)
    if list(arguments) == ["--version"]:
        print(f"hmdjit {__version__}")
        return OK
    command: Any = None
    try:
        command = tyro.extras.subcommand_cli_from_dict(
            COMMANDS,
            prog="hmdjit",
            description="How much does the picture flicker when a head holds still? "
            "`--version` says which one this is.",
            args=list(arguments),
            config=(tyro.conf.FlagCreatePairsOff,),
        )
        return command.run(rich.console.Console(markup=False, highlight=False))
    except KeyboardInterrupt as stop:
        print(f"hmdjit: {str(stop) or 'stopped.'}", file=sys.stderr)
        return INTERRUPTED
    except FailedSessionsError as error:
        words = str(error).replace("omit_failed=True", "--omit-failed")
        return _complain(words.replace("margin_deg =", "--margin"), FAILED)
    except LostWorkersError as error:
        return _complain(error, FAILED)
    except (ValueError, ImportError) as error:
        words = as_option(str(error), command)
        return _complain(_hinted(words, arguments), WRONG_INPUT)
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        words = f"{place}{error.strerror or error}"
        return _complain(_hinted(words, arguments), WRONG_INPUT)


def _hinted(error: str, arguments: Sequence[str]) -> str:
    """Say too how several names are given, where an argument joined them by commas."""
    for argument in arguments:
        names = argument.partition("=")[2] if argument[:2] == "--" else argument
        if "," in names and names in error and not os.path.exists(names):
            apart = " ".join(name.strip() for name in names.split(",") if name)
            end = "" if error.endswith((".", "?")) else "."
            return f"{error}{end} Several are separated by spaces: {apart}."
    return error


def _complain(error: object, code: int) -> int:
    print(f"hmdjit: error: {' '.join(str(error).split())}", file=sys.stderr)
    return code
