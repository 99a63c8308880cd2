"""The envelope as a table for the terminal and as CSV."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

from rich import box
from rich.table import Table

from .._files import written_atomically
from ..envelope.engine import DIGITS, Measurement


def table(rows: Sequence[Measurement], width: int = 80) -> Table:
    """Lay out rows: what was asked, the largest errors, and whether bounds hold.

    **Arguments:** `width`: of the terminal, characters: narrow ones get no ranges.
    """
    found = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    is_wide = width >= 120
    found.add_column("function", overflow="fold")
    if is_wide:
        found.add_column("range")
    found.add_column("dtype", no_wrap=True)
    for name in ("error", "bound", "slope,\neps", "bound"):
        found.add_column(name, justify="right", no_wrap=True)
    found.add_column("holds", no_wrap=True)
    last = ""
    for row in rows:
        is_same = row.name == last
        last = row.name
        found.add_row(
            "" if is_same else row.name,
            *["" if is_same else row.over] * is_wide,
            row.dtype,
            f"{row.error:.2g} {row.unit}",
            *(number(x) for x in (row.bound, row.gradient, row.gradient_bound)),
            "yes" if row.holds else "NO",
            style="" if row.holds else "bold",
        )
    return found


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
    with written_atomically(path) as unfinished, open(unfinished, "w", newline="") as f:
        lines = csv.writer(f)
        lines.writerow([*Measurement._fields, "holds"])
        lines.writerows([*row, row.holds] for row in rows)
    return path
