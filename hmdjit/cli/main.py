"""The command line: parse, run a command, and tell what went wrong in one line."""

import sys
from collections.abc import Sequence
from typing import Any

import rich.console
import tyro

from ..studies.failures import FailedSessionsError
from .apply import ApplyCommand
from .envelope import EnvelopeCommand
from .fit import FitCommand
from .head import HeadCommand
from .options import FAILED, WRONG_INPUT
from .options import INTERRUPTED as INTERRUPTED
from .study import StudyCommand
from .trade_off import PickCommand, TradeOffCommand

COMMANDS: dict[str, Any] = {
    "study": StudyCommand,
    "apply": ApplyCommand,
    "fit": FitCommand,
    "head": HeadCommand,
    "trade-off": TradeOffCommand,
    "pick": PickCommand,
    "envelope": EnvelopeCommand,
}


def run(arguments: Sequence[str]) -> int:
    """Run a command; returns the exit code."""
    command: Any = tyro.extras.subcommand_cli_from_dict(
        COMMANDS,
        prog="hmdjit",
        description="How much does the picture flicker when a head holds still?",
        args=list(arguments),
        config=(tyro.conf.FlagCreatePairsOff,),
    )
    try:
        return command.run(rich.console.Console(markup=False, highlight=False))
    except KeyboardInterrupt as stop:
        print(f"hmdjit: {str(stop) or 'stopped.'}", file=sys.stderr)
        return INTERRUPTED
    except FailedSessionsError as error:
        return _complain(error, FAILED)
    except (ValueError, ImportError) as error:
        return _complain(error, WRONG_INPUT)
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        return _complain(f"{place}{error.strerror or error}", WRONG_INPUT)


def _complain(error: object, code: int) -> int:
    print(f"hmdjit: error: {' '.join(str(error).split())}", file=sys.stderr)
    return code
