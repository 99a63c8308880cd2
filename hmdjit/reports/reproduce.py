"""A paper's claims in words: the tables that the command line prints, and CSV."""

from collections.abc import Sequence
from pathlib import Path

from .. import _files
from ..reproductions.claims import Claim, Found
from . import tables


def verdicts(found: Found) -> tables.Continued:
    """Lay out the paper's own questions: each claim with what was measured of it."""
    columns = {"claim": tables.WORDS, "verdict": tables.WORDS}
    columns |= {"value": tables.READY, "95 % interval": tables.READY}
    rows = [
        (
            f"{k}. {claim.claim}",
            claim.verdict,
            number(claim.value),
            f"{number(claim.low)} to {number(claim.high)}",
        )
        for k, claim in enumerate(found.asked, 1)
    ]
    return tables.table(columns, rows, fold=True)


def by_measure(found: Found) -> tables.Continued:
    """Lay out what each measure says of the same claims, by their numbers."""
    columns = {"measured by": tables.WORDS}
    columns |= {f"{k}.": tables.WORDS for k in range(1, len(found.asked) + 1)}
    verdicts = {(c.measure, c.claim): c.verdict for c in found.claims}
    rows = [
        (measure, *(verdicts.get((measure, c.claim), "-") for c in found.asked))
        for measure in found.measures
    ]
    return tables.table(columns, rows)


def explanation(found: Found) -> str:
    """Say what was run, why the verdicts are what they are, and what else there is."""
    reasons = [
        f"{k}. {claim.verdict} ({_named(claim)}): {claim.reason}."
        for k, claim in enumerate(found.asked, 1)
    ]
    return "\n".join([*reasons, *found.lines, found.about])


def _named(claim: Claim) -> str:
    return ", ".join(filter(None, [claim.quantity, claim.unit]))


def page(found: Found, figures: Sequence[str]) -> str:
    """Write all of it as Markdown; `figures`: files beside it."""
    rows = [
        (
            claim.claim + (f" ({claim.source})" if claim.source else ""),
            f"{claim.quantity}: {number(claim.value)} {claim.unit}".rstrip(),
            f"{number(claim.low)} to {number(claim.high)}",
            f"**{claim.verdict}**",
            claim.reason,
        )
        for claim in found.claims
    ]
    heads = ("the paper says", "ours", "95 %", "verdict", "why")
    lines = ["| " + " | ".join(row) + " |" for row in (heads, ["---"] * 5, *rows)]
    pictures = [f"![{name}]({name})" for name in figures]
    parts = [f"# {found.title}", found.about, "\n".join(lines), *pictures, *found.lines]
    return "\n\n".join(parts) + "\n"


def write_csv(found: Found, folder: Path) -> list[Path]:
    """Write claims, what was measured, and further tables; return the files."""
    tables_ = {"claims": found.claims, "measured": found.measured, **found.tables}
    return [
        _files.write_csv(folder / f"{name}.csv", rows) for name, rows in tables_.items()
    ]


def number(value: float) -> str:
    """Write a number in three digits."""
    return f"{value:.3g}"
