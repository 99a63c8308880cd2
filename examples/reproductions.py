"""The papers' claims, judged with several seeds: which verdicts stand.

Runs `hmdjit reproduce PAPER --quick` of each paper with each seed, and lays out the
verdicts side by side. Fills `reproductions.md`, with the first seed's figures beside
it. What is interrupted goes on when the same command is run again: finished batches
are kept in a folder. Fills the README's table of verdicts too.

    python examples/reproductions.py --seeds 0 1 2
"""

import csv
import shutil
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import pages

from hmdjit.cli.main import run
from hmdjit.cli.reproduce import PAPERS
from hmdjit.reproductions.claims import FAILS, HOLDS, UNTOLD

README = Path(__file__).parents[1] / "README.md"

Row = Mapping[str, str]
Rows = Mapping[str, Sequence[Sequence[Row]]]
"""Rows of `claims.csv` by paper: for each claim and measure, one by each seed."""


def judged(paper: str, seed: int, folder: Path, how: Sequence[str]) -> list[Row]:
    """Run a paper's experiment, or go on with it; the rows of its claims."""
    command = ["reproduce", paper, "--seed", str(seed), "--out", str(folder), *how]
    if code := run(command):
        sys.exit(code)
    with open(folder / "claims.csv", newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def agreed(rows: Sequence[Row]) -> str:
    """Say the verdict, and of how many seeds it is."""
    (first, most), *others = Counter(row["verdict"] for row in rows).most_common()
    said = f"{first} ({most} of {len(rows)} seeds)"
    return ", ".join([said, *(f"{verdict} ({n})" for verdict, n in others)])


def measured(row: Row) -> str:
    """Write a value with its interval."""
    value, low, high = (f"{float(row[name]):.3g}" for name in ("value", "low", "high"))
    return f"{value} [{low}, {high}]"


def verdicts(found: Rows) -> str:
    """Lay out the papers' own questions: of each claim its first measure."""
    lines = []
    for paper, claims in found.items():
        asked: dict[str, Sequence[Row]] = {}
        for rows in claims:
            asked.setdefault(rows[0]["claim"], rows)
        lines += [
            (paper, claim, measured(rows[0]), agreed(rows))
            for claim, rows in asked.items()
        ]
    return pages.table(("paper", "it says", "ours [95 %]", "verdict"), lines)


def overview(found: Rows) -> str:
    """Lay out the papers' own questions by verdict, a line for each paper.

    A question asked of several scenes says of how many of them.
    """
    lines = []
    for paper, claims in found.items():
        asked: dict[str, list[Sequence[Row]]] = {}
        for rows in claims:
            own = asked.setdefault(rows[0]["claim"], [])
            if not own or _kind(rows) == _kind(own[0]):
                own.append(rows)
        cells: dict[str, list[str]] = {HOLDS: [], FAILS: [], UNTOLD: []}
        for claim, several in asked.items():
            said = Counter(one_verdict(rows) for rows in several)
            for verdict, count in said.items():
                values = measured(several[0][0])
                many = f"{count} of {len(several)}"
                cells[verdict].append(
                    f"{claim} ({values if len(several) == 1 else many})"
                )
        lines.append((paper, *("; ".join(cell) or "-" for cell in cells.values())))
    verdicts = (f"*{verdict}*" for verdict in (HOLDS, FAILS, UNTOLD))
    return pages.table(("paper", *verdicts), lines)


def _kind(rows: Sequence[Row]) -> str:
    """Return what a claim was measured by; tables are of a scene each."""
    measure = rows[0]["measure"]
    return "table" if measure.startswith("table ") else measure


def one_verdict(rows: Sequence[Row]) -> str:
    """Return the verdict on which all seeds agree; else it cannot be told."""
    said = {row["verdict"] for row in rows}
    return said.pop() if len(said) == 1 else UNTOLD


def measures(found: Rows) -> str:
    """Lay out each claim by each measure, with all seeds."""
    lines = [
        (
            paper,
            rows[0]["claim"],
            rows[0]["source"],
            rows[0]["measure"],
            ", ".join(filter(None, (rows[0]["quantity"], rows[0]["unit"]))),
            "; ".join(map(measured, rows)),
            agreed(rows),
        )
        for paper, claims in found.items()
        for rows in claims
    ]
    head = ("paper", "it says", "where", "measured by", "what that is")
    return pages.table((*head, "ours [95 %], by seed", "verdict"), lines)


def main() -> None:
    """Run all, fill the page, and copy figures."""
    parser = pages.arguments(__file__, __doc__)
    parser.add_argument("--papers", nargs="+", choices=PAPERS, default=list(PAPERS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--keep", type=Path, default=Path("reproductions"))
    parser.add_argument("--sessions", help="how many, instead of those of --quick")
    parser.add_argument("--readme", type=Path, default=README, help="also filled")
    parser.add_argument("--side", help="of the square frame, px")
    options = parser.parse_args()
    how = ["--sessions", options.sessions] if options.sessions else ["--quick"]
    if options.side:
        how += ["--width", options.side, "--height", options.side]
    found: dict[str, list[tuple[Row, ...]]] = {}
    for paper in options.papers:
        folders = {
            seed: options.keep / f"seed_{seed}" / paper for seed in options.seeds
        }
        each = [judged(paper, seed, folder, how) for seed, folder in folders.items()]
        found[paper] = list(zip(*each, strict=True))
        for figure in folders[options.seeds[0]].glob("*.png"):
            if figure.stem != "claims":  # which the page has as a table
                name = f"{options.out.stem}-{figure.name}"
                shutil.copy(figure, options.out.parent / name)
    blocks = {"verdicts": verdicts(found), "measures": measures(found)}
    pages.write(__file__, blocks, options.out)
    text = options.readme.read_text(encoding="utf-8")
    text = pages.filled(text, {"verdicts": overview(found)}, some=True)
    options.readme.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
