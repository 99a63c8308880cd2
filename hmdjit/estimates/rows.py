"""A row of a study's table."""

import dataclasses
import math
from collections.abc import Mapping
from typing import NamedTuple


class MeanAndError(NamedTuple):
    """Mean of a metric over sessions, its standard error, and its 95 % interval."""

    mean: float = math.nan
    standard_error: float = math.nan
    low: float = math.nan
    high: float = math.nan


@dataclasses.dataclass(frozen=True)
class SummaryRow:
    """One technique in one scene; a line of `summary.csv`, columns in this order.

    Of the study's first metric, MTCD in code values of 8 bits: `low` and `high` bound
    the mean, `q05`, `q50` and `q95` are quantiles of the sessions, `ratio` is to the
    baseline. `others` are its other metrics, by name. `interval` says how intervals
    were made, `note` why a number is NaN. Of a study with a goal: `seconds` spent on
    the scene in this run, and `1 / (relative error^2 x seconds)`. `pairing_gain` is by
    how much sharing heads and tiles with the baseline divides the ratio's variance.
    """

    technique: str
    scene: str
    sessions: int
    mean: float = math.nan
    standard_error: float = math.nan
    low: float = math.nan
    high: float = math.nan
    q05: float = math.nan
    q50: float = math.nan
    q95: float = math.nan
    ratio: float = math.nan
    ratio_low: float = math.nan
    ratio_high: float = math.nan
    others: Mapping[str, MeanAndError] = dataclasses.field(default_factory=dict)
    interval: str = ""
    note: str = ""
    seconds: float = math.nan
    figure_of_merit: float = math.nan
    pairing_gain: float = math.nan

    def columns(self) -> dict[str, str | float]:
        """Numbers by the names of their columns."""
        found = {}
        for name, value in vars(self).items():
            if name != "others":
                found[name] = value
                continue
            for metric, (mean, *rest) in self.others.items():
                names = (f"{metric}_{field}" for field in MeanAndError._fields[1:])
                found |= {metric: mean, **dict(zip(names, rest, strict=True))}
        return found
