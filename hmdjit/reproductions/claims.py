"""Claims of a paper: what was measured of each, and whether it holds.

A verdict is that of a 95 % interval, and never of the value alone.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ..estimates.intervals import Interval, mean_interval

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
    - `source`: where in the paper: its section, figure or table, as far as it is known.
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
    source: str = ""

    @classmethod
    def of(
        cls,
        claim: str,
        measure: str,
        quantity: str,
        found: Interval,
        unit: str,
        verdict: str,
        reason: str,
        source: str = "",
    ) -> "Claim":
        """Return a claim with an interval."""
        numbers = (found.value, found.low, found.high)
        return cls(claim, measure, quantity, *numbers, unit, verdict, reason, source)


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

    @classmethod
    def mean(
        cls,
        measure: str,
        case: str,
        condition: str,
        sessions: Float[np.ndarray, " session"],
        unit: str,
    ) -> "Measured":
        """Return the mean over sessions."""
        found = mean_interval(sessions)
        numbers = (found.value, found.low, found.high)
        return cls(measure, case, condition, *numbers, unit)


class Found(NamedTuple):
    """What running a paper's experiment again found.

    - `title`: of the paper; `about`: what was run, in sentences.
    - `claims`: of each the first row, by its measure, is the paper's own question.
    - `measured`: what the claims rest on; of the first measure figures show the means.
    - `cases`: those of `measured` that a figure shows.
    - `lines`: what else is to be read, a line each.
    - `tables`: further rows, by the name of their file.
    - `pictures`: gamma frames, by condition, where the paper shows some.
    """

    title: str
    about: str
    claims: Sequence[Claim]
    measured: Sequence[Measured]
    cases: Sequence[str]
    lines: Sequence[str]
    tables: Mapping[str, Sequence[Any]]
    pictures: Mapping[str, np.ndarray] = {}

    @property
    def measures(self) -> list[str]:
        """By what claims were measured, the paper's own question first."""
        return list(dict.fromkeys(claim.measure for claim in self.claims))

    @property
    def asked(self) -> list[Claim]:
        """The paper's own questions: each claim by the first of its measures."""
        first: dict[str, Claim] = {}
        for claim in self.claims:
            first.setdefault(claim.claim, claim)
        return list(first.values())


def above(found: Interval, threshold: float = 0.0) -> str:
    """Whether a quantity lies above a threshold, by its whole interval."""
    if not (math.isfinite(found.low) and math.isfinite(found.high)):
        return UNTOLD
    if found.low > threshold:
        return HOLDS
    return FAILS if found.high < threshold else UNTOLD


def below(found: Interval, threshold: float) -> str:
    """Whether a quantity lies below a threshold, by its whole interval."""
    turned = {HOLDS: FAILS, FAILS: HOLDS, UNTOLD: UNTOLD}
    return turned[above(found, threshold)]


def within(found: Interval, margin: float) -> str:
    """Whether a quantity lies within a margin of 0 to both sides, by its interval."""
    if not (math.isfinite(found.low) and math.isfinite(found.high)):
        return UNTOLD
    if -margin < found.low and found.high < margin:
        return HOLDS
    return FAILS if found.low > margin or found.high < -margin else UNTOLD


def less(found: Interval, number: float) -> Interval:
    """Return by how much a quantity is more than a number."""
    value, low, high = (n - number for n in (found.value, found.low, found.high))
    return Interval(value, low, high, found.standard_error, found.method)


def every(verdicts: Sequence[str]) -> str:
    """Verdict of a claim that is several at once: it fails where any of them does."""
    if FAILS in verdicts:
        return FAILS
    return UNTOLD if UNTOLD in verdicts or not verdicts else HOLDS
