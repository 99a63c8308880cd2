"""A paper's claims in words: the tables that the command line prints, and CSV."""

from pathlib import Path

from .. import _files
from ..reproductions.claims import Claim, Found
from . import tables


def verdicts(found: Found) -> tables.Continued:
    """Lay out the paper's own question: each claim with what was measured of it."""
    columns = {"claim": tables.WORDS, "verdict": tables.WORDS}
    columns |= {"value": tables.READY, "95 % interval": tables.READY}
    rows = [
        (
            f"{k}. {claim.claim}",
            claim.verdict,
            number(claim.value),
            f"{number(claim.low)} to {number(claim.high)}",
        )
        for k, claim in enumerate(_of(found, found.measures[0]), 1)
    ]
    return tables.table(columns, rows, fold=True)


def by_measure(found: Found) -> tables.Continued:
    """Lay out what each measure says of the same claims, by their numbers."""
    first = _of(found, found.measures[0])
    columns = {"measured by": tables.WORDS}
    columns |= {f"{k}.": tables.WORDS for k in range(1, len(first) + 1)}
    rows = [
        (measure, *(claim.verdict for claim in _of(found, measure)))
        for measure in found.measures
    ]
    return tables.table(columns, rows)


def explanation(found: Found) -> str:
    """Say what was run, why the verdicts are what they are, and what else there is."""
    reasons = [
        f"{k}. {claim.verdict} ({claim.quantity}, {claim.unit}): {claim.reason}."
        for k, claim in enumerate(_of(found, found.measures[0]), 1)
    ]
    return "\n".join([*reasons, *found.lines, found.about])


def write_csv(found: Found, folder: Path) -> list[Path]:
    """Write claims, what was measured, and further tables; return the files."""
    tables_ = {"claims": found.claims, "measured": found.measured, **found.tables}
    return [
        _files.write_csv(folder / f"{name}.csv", rows) for name, rows in tables_.items()
    ]


def number(value: float) -> str:
    """Write a number in three digits."""
    return f"{value:.3g}"


def _of(found: Found, measure: str) -> list[Claim]:
    return [claim for claim in found.claims if claim.measure == measure]
