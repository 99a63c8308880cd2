"""Choosing a setting of fidelity: the cheapest within a tolerance, or the best in time.

Expected seconds are those of one scene on the machine that was measured, in proportion
to sessions; compiling and baking are apart.
"""

import dataclasses
import math
from collections.abc import Iterable, Sequence

from .. import _checks
from ..estimates.intervals import Z95
from .settings import DEFAULT
from .trade_off import Row


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
        # What no option of a study sets is measured, but not chosen.
        is_offered = not (row.is_other_device or row.python_fields)
        if row.technique in techniques and is_offered:
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
            f"{best[0].setting}, is known to lie below "
            f"{_checks.apart(_worst_bias(best), tolerance, spec='3g')} only."
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
            f"{fastest[0].setting}, needs "
            f"{_checks.apart(2 * _cost(fastest), seconds, spec='3g')} s."
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
