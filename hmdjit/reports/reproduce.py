"""A paper's claims in words: the tables that the command line prints, and CSV."""

from collections.abc import Mapping, Sequence
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
            claim.claim,
            claim.source,
            f"{claim.quantity}: {number(claim.value)} {claim.unit}".rstrip(),
            f"{number(claim.low)} to {number(claim.high)}",
            f"**{claim.verdict}**",
            claim.reason,
        )
        for claim in found.claims
    ]
    heads = ("the paper says", "where", "ours", "95 %", "verdict", "why")
    pictures = [f"![{name}]({name})" for name in figures]
    whole = _markdown(heads, rows)
    parts = [f"# {found.title}", found.about, whole, *pictures, *found.lines]
    return "\n\n".join(parts) + "\n"


def overview(papers: Mapping[str, Found]) -> str:
    """Write the verdicts on several papers' own questions as one table, in Markdown."""
    rows = [
        (name, claim.claim, in_words(claim), f"**{claim.verdict}**")
        for name, found in papers.items()
        for claim in found.asked
    ]
    heads = ("paper", "it says", "ours [95 %]", "verdict")
    return f"# Papers' claims\n\n{_markdown(heads, rows)}\n"


def in_words(claim: Claim) -> str:
    """Write what was measured of a claim, with its interval."""
    numbers = f"{number(claim.value)} [{number(claim.low)}, {number(claim.high)}]"
    return f"{numbers} {claim.unit}".rstrip()


def _markdown(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = (heads, ["---"] * len(heads), *rows)
    return "\n".join("| " + " | ".join(row) + " |" for row in lines)


def write_csv(found: Found, folder: Path) -> list[Path]:
    """Write claims, what was measured, and further tables; return the files."""
    tables_ = {"claims": found.claims, "measured": found.measured, **found.tables}
    return [
        _files.write_csv(folder / f"{name}.csv", rows) for name, rows in tables_.items()
    ]


def number(value: float) -> str:
    """Write a number in three digits."""
    return f"{value:.3g}"
