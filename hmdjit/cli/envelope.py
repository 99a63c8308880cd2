"""The command line's `hmdjit envelope`: how right each function is, and where."""

import dataclasses
import time
from pathlib import Path
from typing import Annotated

import rich.console

from .._files import check_can_write
from ..studies.progress import Progress
from ..studies.study import check_seed
from .options import FAILED, OK, shown
from .progress import Display

_FOLDER = Path("hmdjit-envelope")


@dataclasses.dataclass(frozen=True)
class EnvelopeCommand:
    """Measure the numerical envelope: errors of values and gradients at the extremes.

    Holds the functions of its table against answers of 300 digits, over their ranges on
    a logarithmic scale, in float32 and float64, and says whether stated bounds hold.
    Takes a few minutes; `--quick` less than one.

    For example: hmdjit envelope --quick
    """

    quick: Annotated[bool, shown("", "Fewer inputs, shorter runs.")] = False
    seed: Annotated[int, shown("N", "Seed of all inputs")] = 0
    out: Annotated[Path, shown("DIR", "Folder for what is written")] = _FOLDER

    def run(self, console: rich.console.Console) -> int:
        """Measure, print, write and draw; an unmet bound is a failure."""
        check_seed(self.seed)
        check_can_write(self.out)
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

        start = time.monotonic()
        rows = []
        with Display(console) as display:
            for row in engine.measure(ROWS, seed=self.seed, quick=self.quick):
                display(Progress(doing=row.name))
                rows.append(row)
        console.print(report.table(rows, console.width))
        console.out(report.explanation(rows))
        file = report.write_csv(rows, self.out / "envelope.csv")
        points = 49 if self.quick else 121
        picture = figure.write_figure(file.with_suffix(".png"), self.seed, points)
        seconds = time.monotonic() - start
        console.out(f"Wrote {file} and {picture} after {seconds:.0f} s.")
        return OK if all(row.holds for row in rows) else FAILED
