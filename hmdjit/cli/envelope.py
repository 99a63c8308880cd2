"""The command line's `hmdjit envelope`: how right each function is, and where."""

import dataclasses
import time
from pathlib import Path
from typing import Annotated, Any

import rich.console
import tyro

from ..studies.study import check_seed
from .options import check_can_write, shown

_FOLDER = Path("hmdjit-envelope")


@dataclasses.dataclass(frozen=True)
class EnvelopeCommand:
    """Measure the numerical envelope: errors of values and gradients at the extremes.

    Holds the functions of its table against answers of 300 digits, over their ranges on
    a logarithmic scale, in float32 and float64, and says whether stated bounds hold.
    Takes a few minutes; `--quick` less than one.
    """

    quick: Annotated[
        bool, tyro.conf.FlagCreatePairsOff, shown("", "Fewer inputs, shorter runs.")
    ] = False
    seed: Annotated[int, shown("N", "Seed of all inputs (default: 0).")] = 0
    out: Annotated[
        Path, shown("DIR", f"Folder for what is written (default: {_FOLDER}).")
    ] = _FOLDER


COMMANDS: dict[str, Any] = {"envelope": EnvelopeCommand}


def run(command: EnvelopeCommand, console: rich.console.Console) -> bool:
    """Measure, print, write and draw; returns whether every bound holds."""
    check_seed(command.seed)
    check_can_write(command.out)
    try:
        import mpmath  # noqa: F401
    except ImportError as error:
        raise ImportError(
            "The envelope needs mpmath: install `hmdjit[study]`."
        ) from error
    from ..envelope import engine
    from ..envelope.table import ROWS
    from ..figures import envelope as figure
    from ..reports import envelope as report

    start, names = time.monotonic(), set()

    def say(row: engine.Measurement) -> None:
        if row.name not in names:
            names.add(row.name)
            seconds = time.monotonic() - start
            console.print(f"{seconds:5.0f} s  {row.name}", highlight=False)

    options: dict[str, Any] = {"seed": command.seed, "quick": command.quick}
    rows = engine.measure(ROWS, **options, progress=say)
    console.print(report.table(rows, console.width))
    explanation = report.explanation(rows)
    console.print(explanation, highlight=False, soft_wrap=True)
    file = report.write_csv(rows, command.out / "envelope.csv")
    points = 49 if command.quick else 121
    picture = figure.write_figure(file.with_suffix(".png"), command.seed, points)
    seconds = time.monotonic() - start
    console.print(
        f"Wrote {file} and {picture} after {seconds:.0f} s.",
        highlight=False,
        soft_wrap=True,
    )
    return all(row.holds for row in rows)
