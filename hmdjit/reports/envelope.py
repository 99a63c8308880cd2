"""The envelope as a table for the terminal and as CSV."""

import math
from collections.abc import Sequence
from pathlib import Path

from .. import _files
from ..envelope.engine import DIGITS, Measurement
from . import tables


def table(rows: Sequence[Measurement], width: int = 80) -> tables.Continued:
    """Lay out rows: what was asked, the largest errors, and whether bounds hold.

    **Arguments:** `width`: of the terminal, characters: narrow ones get no ranges.
    """
    columns = {"function": tables.WORDS}
    if width >= 120:
        columns["range"] = tables.WORDS
    columns["dtype"] = tables.WORDS
    numbers = ("error", "bound", "slope,\neps", "slope's\nbound", "holds")
    columns |= dict.fromkeys(numbers, tables.READY)
    laid_out, last = [], ""
    for row in rows:
        is_same, last = row.name == last, row.name
        shared = (row.name, row.over)[: len(columns) - 6]
        laid_out.append(
            (
                *(("",) * len(shared) if is_same else shared),
                row.dtype,
                f"{row.error:.2g} {row.unit}",
                *(number(x) for x in (row.bound, row.gradient, row.gradient_bound)),
                "yes" if row.holds else "NO",
            )
        )
    bold = [not row.holds for row in rows]
    return tables.table(columns, laid_out, bold=bold, fold=True)


def number(value: float) -> str:
    """Write a number in few digits; `-` where there is none."""
    return "-" if math.isnan(value) else f"{value:.3g}"


def explanation(rows: Sequence[Measurement]) -> str:
    """Say what the table's words mean, and sum it up."""
    broken = [row for row in rows if not row.holds]
    words = [
        f"{len(rows) - len(broken)} of {len(rows)} bounds hold. eps: relative to the "
        "answer's largest entry, in units of the dtype's spacing at 1 (1.2e-7 and "
        f"2.2e-16). Answers have {DIGITS} digits (mpmath), gradients are theirs. Worst "
        "inputs are in the CSV."
    ]
    for row in broken:
        where = row.worst if row.error > row.bound else row.worst_gradient
        words.append(f"Does not hold: {row.name} ({row.dtype}) at {where}.")
    return "\n".join(words)


def write_csv(rows: Sequence[Measurement], path: Path) -> Path:
    """Write all rows, whole or not at all."""
    return _files.write_csv(
        path, [row._asdict() | {"holds": row.holds} for row in rows]
    )
