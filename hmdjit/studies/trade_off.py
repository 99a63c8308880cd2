"""Seconds against error: what was measured, the Pareto front, and a choice from it.

The error of a mean has two parts that time buys down differently. More sessions reduce
the Monte Carlo error, `sd / sqrt(n)`; the bias of a setting stays.
"""

import csv
import dataclasses
import math
import os
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from .. import _checks
from .._files import written_atomically
from .intervals import Z95
from .settings import DEFAULT


@dataclasses.dataclass(frozen=True)
class Identity:
    """What the rows of one trade-off rest on.

    `study_options` are those of `hmdjit study`, apart from the setting's own; `load` is
    the machine's load average when measuring began: above 0, something else ran.
    """

    scene: str
    head: str
    width_px: int
    height_px: int
    fov_deg: float
    refresh_hz: float
    frames: int
    warmup: int
    seed: int
    study_options: str
    device: str
    machine: str
    processor: str
    cores: int
    load: float
    hmdjit_version: str
    model_version: str
    jax_version: str
    numpy_version: str
    python_version: str


@dataclasses.dataclass(frozen=True)
class Row:
    """One setting and technique: a line of `trade_off.csv`, columns in this order.

    MTCD in code values of 8 bits, detail loss in their square; standard deviations are
    over sessions. `bias` is this setting's mean minus the reference's, `bias_by` how
    it was measured, `reference_mtcd` the reference's mean.
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
    identity: Identity

    @property
    def mtcd_se(self) -> float:
        """Monte Carlo standard error of the mean at the measured sessions."""
        return self.mtcd_sd / math.sqrt(self.sessions)

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
"""Bias, relative to MTCD, below which settings count as equally good."""


def front_of(rows: Sequence[Row], monte_carlo: float = 0.01) -> list[Row]:
    """Rows of one technique that no other is both faster and less biased than.

    **Arguments:** `monte_carlo`: relative standard error to which seconds are counted.
    """
    rows = [row for row in rows if row.reference_mtcd > 0 and not row.is_other_device]
    points = [
        (
            row.seconds_to(monte_carlo),
            max(abs(row.bias) / row.reference_mtcd, NEGLIGIBLE),
        )
        for row in rows
    ]
    is_on = pareto_front(np.array(points).reshape(-1, 2))
    front = [row for row, on in zip(rows, is_on, strict=True) if on]
    return sorted(front, key=lambda row: row.seconds_to(monte_carlo))


@dataclasses.dataclass(frozen=True)
class Choice:
    """A setting, how many sessions to run with it, and what to expect.

    - `rows`: of the setting, one per technique.
    - `seconds`: to run all of them, compiling and baking apart.
    - `error`: 95 % bound, relative to the mean MTCD; the worst of the techniques.
    """

    rows: tuple[Row, ...]
    sessions: int
    seconds: float
    error: float

    @property
    def setting(self) -> str:
        """Name of the setting."""
        return self.rows[0].setting


def candidates(
    rows: Iterable[Row], techniques: Sequence[str] | None = None
) -> list[tuple[Row, ...]]:
    """Group the rows by settings that approximate the reference.

    **Arguments:** `techniques`: those that a setting must have been measured with;
    None are those of the rows in which no knob is turned.

    **Errors:** `ValueError` for a technique that was not measured.
    """
    rows = [row for row in rows if row.reference_mtcd > 0 and row.knob != "samples"]
    measured = list(dict.fromkeys(row.technique for row in rows))
    if techniques is None:
        usual = [row.technique for row in rows if row.knob == DEFAULT]
        techniques = list(dict.fromkeys(usual)) or measured
    for technique in techniques:
        _checks.one_of("technique", technique, measured)
    groups: dict[str, dict[str, Row]] = {}
    for row in rows:
        if row.technique in techniques and not row.is_other_device:
            groups.setdefault(row.setting, {})[row.technique] = row
    return [
        tuple(group[t] for t in techniques)
        for group in groups.values()
        if len(group) == len(techniques)
    ]


def pick_tolerance(settings: Sequence[tuple[Row, ...]], tolerance: float) -> Choice:
    """Choose the cheapest setting, and its sessions, within a tolerance.

    Within it are bias, as far as that is known, and 1.96 Monte Carlo standard errors
    together, relative to the mean MTCD of the reference, for each technique.

    **Errors:** `ValueError` for a tolerance outside (0, 1), or if no setting reaches
    it; the message names the best there is.
    """
    _checks.in_range("tolerance", tolerance, 0, 1, open_low=True, open_high=True)
    _refuse_none(settings)
    found = []
    for rows in settings:
        room = [tolerance - row.bias_bound / row.reference_mtcd for row in rows]
        if min(room) > 0:
            needed = [
                (Z95 * row.mtcd_sd / row.reference_mtcd / left) ** 2
                for row, left in zip(rows, room, strict=True)
            ]
            found.append(_choice(rows, max(2, math.ceil(max(needed)))))
    if not found:
        best = min(settings, key=_worst_bias)
        raise ValueError(
            f"no setting reaches a tolerance of {tolerance:.3g}: the bias of the best, "
            f"{best[0].setting}, is known to lie below {_worst_bias(best):.3g} only."
        )
    return min(found, key=lambda choice: (choice.seconds, choice.error))


def pick_budget(settings: Sequence[tuple[Row, ...]], seconds: float) -> Choice:
    """Choose the most accurate setting, and its sessions, within some seconds.

    **Errors:** `ValueError` for a budget that is not above 0, or in which no setting
    measures two sessions.
    """
    _checks.in_range("budget", seconds, 0, open_low=True)
    _refuse_none(settings)
    found = [
        _choice(rows, int(seconds / _cost(rows)))
        for rows in settings
        if seconds >= 2 * _cost(rows)
    ]
    if not found:
        fastest = min(settings, key=_cost)
        raise ValueError(
            f"no setting measures two sessions in {seconds:.3g} s: the fastest, "
            f"{fastest[0].setting}, needs {2 * _cost(fastest):.3g} s."
        )
    return min(found, key=lambda choice: (choice.error, choice.seconds))


def _refuse_none(settings: Sequence[tuple[Row, ...]]) -> None:
    if not settings:
        raise ValueError("no setting has flicker in all of the techniques.")


def _cost(rows: tuple[Row, ...]) -> float:
    return sum(row.s_per_session for row in rows)


def _worst_bias(rows: tuple[Row, ...]) -> float:
    return max(row.bias_bound / row.reference_mtcd for row in rows)


def _choice(rows: tuple[Row, ...], sessions: int) -> Choice:
    bounds = [
        (row.bias_bound + Z95 * row.mtcd_sd / math.sqrt(sessions)) / row.reference_mtcd
        for row in rows
    ]
    return Choice(rows, sessions, sessions * _cost(rows), max(bounds))


_UNITS = {"": 1.0, "s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0, "ms": 1e-3}


def parse_seconds(text: str) -> float:
    """Read a duration such as `10s`, `2min`, `1h` or `90`, s.

    **Errors:** `ValueError` for anything else.
    """
    match = re.fullmatch(r"([0-9.]+(?:e-?\d+)?)\s*([a-z]*)", text.strip().lower())
    try:
        if match is not None and match[2] in _UNITS:
            return float(match[1]) * _UNITS[match[2]]
    except ValueError:
        pass
    raise ValueError(f"budget must be a duration such as 10s or 2min, got {text!r}.")


_READ: dict[Any, Callable[[str], Any]] = {
    str: str,
    int: int,
    float: float,
    bool: lambda text: {"True": True, "False": False}[text],
}
_OWN = [field for field in dataclasses.fields(Row) if field.name != "identity"]
_SHARED = dataclasses.fields(Identity)
COLUMNS = tuple(field.name for field in (*_OWN, *_SHARED))


def write_csv(rows: Sequence[Row], path: str | os.PathLike) -> Path:
    """Write rows, each with its identity, numbers to the last digit.

    **Returns:** the path. The file appears at once and whole.
    """
    with (
        written_atomically(path) as unfinished,
        open(unfinished, "w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        for row in rows:
            values = dataclasses.asdict(row)
            writer.writerow(values | values.pop("identity"))
    return Path(path)


def read_csv(path: str | os.PathLike) -> list[Row]:
    """Read rows back, equal to those written.

    **Errors:** `ValueError` naming the file: missing, or not written by `write_csv`.
    """
    try:
        with open(path, newline="", encoding="utf-8") as file:
            lines = list(csv.DictReader(file))
    except FileNotFoundError:
        raise ValueError(
            f"{path}: no such file: run `hmdjit trade-off` first."
        ) from None

    def values(fields: Iterable[dataclasses.Field], line: dict[str, str]) -> dict:
        return {field.name: _READ[field.type](line[field.name]) for field in fields}

    try:
        rows = [
            Row(**values(_OWN, line), identity=Identity(**values(_SHARED, line)))
            for line in lines
        ]
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"{path}: not a table of `hmdjit trade-off`: {error}."
        ) from None
    if not rows:
        raise ValueError(f"{path}: holds no row: run `hmdjit trade-off` first.")
    return rows
