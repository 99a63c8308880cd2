"""Claims of a paper: what was measured of each, and whether it holds.

A verdict is that of a 95 % interval, and never of the value alone.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from ..estimates.intervals import Interval

HOLDS, FAILS, UNTOLD = "holds", "does not hold", "cannot be told"


@dataclasses.dataclass(frozen=True)
class Claim:
    """A claim, what was measured of it, and what that says.

    - `claim`: in words.
    - `measure`: what it was measured by; the paper's own question comes first.
    - `quantity`: what the value is, in words.
    - `value`, `low`, `high`, `unit`: with its 95 % interval.
    - `verdict`: `HOLDS`, `FAILS` or `UNTOLD`.
    - `reason`: why, with the figures that it rests on.
    """

    claim: str
    measure: str
    quantity: str
    value: float
    low: float
    high: float
    unit: str
    verdict: str
    reason: str


@dataclasses.dataclass(frozen=True)
class Measured:
    """What was measured of a condition in a case (a scene, or several), on average.

    - `value`, `low`, `high`, `unit`: with its 95 % interval.
    """

    measure: str
    case: str
    condition: str
    value: float
    low: float
    high: float
    unit: str


class Found(NamedTuple):
    """What running a paper's experiment again found.

    - `title`: of the paper; `about`: what was run, in sentences.
    - `claims`: those by the first measure are the paper's own question.
    - `measured`: what the claims rest on; of the first measure figures show the means.
    - `cases`: those of `measured` that a figure shows.
    - `lines`: what else is to be read, a line each.
    - `tables`: further rows, by the name of their file.
    """

    title: str
    about: str
    claims: Sequence[Claim]
    measured: Sequence[Measured]
    cases: Sequence[str]
    lines: Sequence[str]
    tables: Mapping[str, Sequence[Any]]

    @property
    def measures(self) -> list[str]:
        """By what claims were measured, the paper's own question first."""
        return list(dict.fromkeys(claim.measure for claim in self.claims))


def above(found: Interval, threshold: float = 0.0) -> str:
    """Whether a quantity lies above a threshold, by its whole interval."""
    if not (math.isfinite(found.low) and math.isfinite(found.high)):
        return UNTOLD
    if found.low > threshold:
        return HOLDS
    return FAILS if found.high < threshold else UNTOLD


def within(found: Interval, margin: float) -> str:
    """Whether a quantity lies within a margin of 0 to both sides, by its interval."""
    if not (math.isfinite(found.low) and math.isfinite(found.high)):
        return UNTOLD
    if -margin < found.low and found.high < margin:
        return HOLDS
    return FAILS if found.low > margin or found.high < -margin else UNTOLD


def every(verdicts: Sequence[str]) -> str:
    """Verdict of a claim that is several at once: it fails where any of them does."""
    if FAILS in verdicts:
        return FAILS
    return UNTOLD if UNTOLD in verdicts or not verdicts else HOLDS
