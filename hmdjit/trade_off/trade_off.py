"""Seconds against error: what was measured, its file, and the Pareto front.

The error of a mean has two parts that time buys down differently. More sessions reduce
the Monte Carlo error, `sd / sqrt(n)`; the bias of a setting stays.
"""

import csv
import dataclasses
import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from .. import _files
from ..estimates.intervals import Z95

_COLUMNS = (
    "scene head width_px height_px fov_deg refresh_hz frames warmup seed study_options "
    "device machine processor cores load hmdjit_version model_version jax_version "
    "numpy_version python_version"
)
IDENTITY = tuple(_COLUMNS.split())
"""What the rows of one trade-off rest on: columns of their file. `study_options` are
those of `hmdjit study`, apart from the setting's own; `load` is the machine's load
average when measuring began: above 0, something else ran."""


@dataclasses.dataclass(frozen=True)
class Row:
    """One setting and technique: a line of `trade_off.csv`, columns in this order.

    MTCD in code values of 8 bits, detail loss in their square; standard deviations are
    over sessions. `bias` is this setting's mean minus the reference's, `bias_by` how
    it was measured, `reference_mtcd` the reference's mean. `identity` holds the columns
    of `IDENTITY`, as text.
    """

    setting: str
    knob: str
    technique: str
    dtype: str
    sessions: int
    mtcd: float
    mtcd_sd: float
    bias: float
    bias_se: float
    bias_by: str
    reference_mtcd: float
    frame_difference: float
    frame_difference_se: float
    detail_loss: float
    detail_loss_sd: float
    detail_loss_bias: float
    detail_loss_bias_se: float
    seconds: float
    s_per_session: float
    compile_s: float
    bake_s: float
    is_other_device: bool
    setting_options: str
    python_fields: str
    identity: dict[str, str]

    @property
    def bias_bound(self) -> float:
        """What |bias| does not exceed, as far as it is known."""
        return abs(self.bias) + Z95 * self.bias_se

    def error(self, seconds: float) -> float:
        """Total error of the mean after some seconds, relative to the reference."""
        found = total_error(self.bias, self.mtcd_sd, self.s_per_session, seconds)
        return found / self.reference_mtcd

    def seconds_to(self, monte_carlo: float) -> float:
        """Seconds to a relative Monte Carlo standard error; NaN without flicker."""
        if not self.reference_mtcd > 0:
            return math.nan
        relative_sd = self.mtcd_sd / self.reference_mtcd
        return self.s_per_session * (relative_sd / monte_carlo) ** 2


def total_error(bias: float, sd: float, s_per_session: float, seconds: float) -> float:
    """Root mean square error of a mean: bias, and what is left to chance.

    **Arguments:** `bias`, `sd` of a session, in one unit; `s_per_session` and
    `seconds`: cost and budget, s, above 0.

    **Returns:** `sqrt(bias^2 + sd^2 s_per_session / seconds)`, unit of `bias`.
    """
    return math.hypot(bias, sd * math.sqrt(s_per_session / seconds))


def pareto_front(points: Float[np.ndarray, "points 2"]) -> Bool[np.ndarray, " points"]:
    """Which points no other one is at least as good as in both, and better in one.

    **Arguments:** `points`: smaller is better; a point with a NaN is never on it.
    """
    points = np.asarray(points, float).reshape(-1, 2)
    front = np.zeros(len(points), bool)
    last = np.full(2, np.inf)  # of the front so far, from the left
    order = np.lexsort((points[:, 1], points[:, 0]))
    for i in order[np.isfinite(points[order]).all(axis=1)]:
        if points[i, 1] < last[1] or (points[i] == last).all():
            front[i], last = True, points[i]
    return front


NEGLIGIBLE = 1e-4
"""Step of biases, relative to MTCD: those within it count as equally good."""


def front_of(rows: Sequence[Row], monte_carlo: float = 0.01) -> list[Row]:
    """Rows of one technique that no other is both faster and less biased than.

    **Arguments:** `monte_carlo`: relative standard error to which seconds are counted.
    """
    rows = [row for row in rows if row.reference_mtcd > 0 and not row.is_other_device]
    points = [
        (
            row.seconds_to(monte_carlo),
            max(1, round(abs(row.bias) / row.reference_mtcd / NEGLIGIBLE)),
        )
        for row in rows
    ]
    is_on = pareto_front(np.array(points).reshape(-1, 2))
    front = [row for row, on in zip(rows, is_on, strict=True) if on]
    return sorted(front, key=lambda row: row.seconds_to(monte_carlo))


_READ: dict[Any, Callable[[str], Any]] = {
    **{kind: kind for kind in (str, int, float)},
    bool: {"True": True, "False": False}.__getitem__,
}


def write_csv(rows: Sequence[Row], path: str | os.PathLike) -> Path:
    """Write rows, each with its identity, whole or not at all."""
    return _files.write_csv(path, rows)


def read_csv(path: str | os.PathLike) -> list[Row]:
    """Read rows back, equal to those written.

    **Errors:** `ValueError` naming the file: missing, or not written by `write_csv`.
    """
    *own, _ = dataclasses.fields(Row)
    rows = []
    try:
        with open(path, newline="", encoding="utf-8") as file:
            for line in csv.DictReader(file):
                values = {f.name: _READ[f.type](line[f.name]) for f in own}
                rows.append(Row(**values, identity={n: line[n] for n in IDENTITY}))
    except FileNotFoundError:
        raise ValueError(
            f"{path}: no such file: run `hmdjit trade-off` first."
        ) from None
    except (csv.Error, KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"{path}: not a table of `hmdjit trade-off`: {error}."
        ) from None
    if not rows:
        raise ValueError(f"{path}: holds no row: run `hmdjit trade-off` first.")
    return rows
