"""How right the public functions of numbers are, by module: the worst of each.

Runs `hmdjit envelope`, which leaves its CSV and its picture beside the page, or takes a
CSV that it has left, and writes `envelope.md`. Further options are those of
`hmdjit envelope`.

    python examples/envelope.py --csv examples/envelope.csv
"""

import csv
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import pages

from hmdjit.cli.main import run

Row = dict[str, str]


def module(row: Row) -> str:
    """Return what the page counts a function under."""
    return row["name"].partition(".")[0].partition(",")[0]


def worst(rows: Sequence[Row], value: str, bound: str) -> str:
    """Return the largest of the values, and its bound; empty where there is none."""
    found = [row for row in rows if not math.isnan(float(row[value]))]
    if not found:
        return ""
    row = max(found, key=lambda row: float(row[value]))
    return f"{float(row[value]):.2g} ({float(row[bound]):.4g})"


def table(rows: Sequence[Row]) -> str:
    """Lay out a row for each module, unit and dtype."""
    keys = sorted({(module(row), row["unit"], row["dtype"]) for row in rows})
    cells = []
    for name, unit, dtype in keys:
        one = [
            r for r in rows if (module(r), r["unit"], r["dtype"]) == (name, unit, dtype)
        ]
        error = worst(one, "error", "bound")
        slope = worst(one, "gradient", "gradient_bound")
        names = len({row["name"] for row in one})
        cells.append((name, f"{names}", dtype, f"{error} {unit}", slope))
    head = (
        "module",
        "rows",
        "dtype",
        "worst error (bound)",
        "worst slope, eps (bound)",
    )
    return pages.table(head, cells)


def main() -> None:
    """Measure unless that is done, and write the page."""
    parser = pages.arguments(__file__, __doc__)
    parser.add_argument("--csv", type=Path, help="what `hmdjit envelope` left")
    options, further = parser.parse_known_args()
    file = options.csv or options.out.with_name("envelope.csv")
    if options.csv is None:
        code = run(["envelope", *further, "--out", str(file.parent)])
        if code:
            sys.exit(code)
    with file.open(newline="", encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines))
    # Statistics are held in float64 alone, everything else is told in float32. A bound
    # of 0 is on what must not happen at all.
    single = {row["name"] for row in rows if row["dtype"] == "float32"}
    never = [row for row in rows if float(row["bound"]) == 0]
    told = [
        row
        for row in rows
        if row not in never and (row["dtype"] == "float32" or row["name"] not in single)
    ]
    holds = sum(row["holds"] == "True" for row in rows)
    blocks = {
        "holds": f"{holds} of {len(rows)} bounds hold, {len(never)} of them on what "
        f"must not happen at all; seed {rows[0]['seed']}.",
        "worst": table(told),
    }
    pages.write(__file__, blocks, options.out, is_measured=options.csv is None)


if __name__ == "__main__":
    main()
