"""A fitted curve in words: its numbers, and what it gains over Kim et al.'s constants.

Flicker and detail loss are relative to no anti-aliasing, on sessions that the curve was
not fitted to.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from rich import box
from rich.table import Table

from .._version import __version__
from ..curve_fitting.results import CurveFit, FrontPoint, Kept, gain_at_equal_detail
from ..estimates.intervals import Interval
from ..techniques import HeadMovement

KIM = HeadMovement().id
FITTED = "fitted"
LABELS = {KIM: "Kim et al.'s constants", FITTED: "fitted curve"}

_DIGITS = 6


def kim_numbers(fit: CurveFit) -> list[float | None]:
    """Kim et al.'s numbers in the order of the space's names; None where there is none.

    Of a curve of another family they are those of the nearest one.
    """
    space = fit.space
    values = np.asarray(space.natural(space.near(HeadMovement())), float)
    several = space.samples > 1
    return [
        None if several and name.startswith(("closeness", "weights")) else float(value)
        for name, value in zip(space.names, values, strict=True)
    ]


def numbers_table(fit: CurveFit) -> Table:
    """Lay out the fitted numbers, how sure they are, and Kim et al.'s."""
    found = _empty("parameter", "fitted", "std. error", "95 % interval", "Kim et al.")
    sure = fit.errors
    rows = zip(
        fit.space.names,
        fit.numbers,
        sure.standard_error,
        sure.low,
        sure.high,
        kim_numbers(fit),
        strict=True,
    )
    for name, value, error, low, high, kim in rows:
        found.add_row(
            name,
            f"{value:.4g}",
            f"{error:.2g}",
            f"[{low:.4g}, {high:.4g}]",
            "-" if kim is None else f"{kim:.4g}",
        )
    return found


def kept_table(kept: Mapping[str, Kept]) -> Table:
    """Lay out what each technique keeps of flicker and of detail."""
    found = _empty("technique", "flicker, of none", "detail loss, of none")
    for name, one in kept.items():
        cells = [_interval(interval) for interval in one.intervals()]
        bold = "bold" if name == FITTED else ""
        found.add_row(LABELS.get(name, name), *cells, style=bold)
    return found


def gain_percent(fit: CurveFit) -> Interval | None:
    """How much less the front flickers than Kim et al.'s constants, % of theirs.

    At their detail loss, on held-out sessions. The fitted curve is on the front too.

    **Returns:** None where the front does not reach that detail loss.
    """
    kim = fit.kept[KIM]
    own = FrontPoint(fit.weight, fit.technique, fit.kept[FITTED])
    found = gain_at_equal_detail([*fit.front, own], kim)
    return None if found is None else _percent(found)


def gain_sentence(fit: CurveFit) -> str:
    """Say what the family gains over Kim et al.'s constants at equal detail loss."""
    gain = gain_percent(fit)
    if gain is None:
        return (
            "The front does not reach the detail loss of Kim et al.'s constants: what "
            "it gains there is not known."
        )
    bounds = f"[{gain.low:.1f}, {gain.high:.1f}]"
    if gain.low > 0:
        return (
            f"At equal detail loss {gain.value:.1f} % less flicker {bounds} than Kim "
            "et al.'s constants."
        )
    if gain.high < 0:
        return (
            f"At equal detail loss {-gain.value:.1f} % more flicker "
            f"[{-gain.high:.1f}, {-gain.low:.1f}] than Kim et al.'s constants."
        )
    return (
        f"At equal detail loss {gain.value:.1f} % less flicker {bounds}: Kim et al.'s "
        "constants are on the front within what these sessions can tell."
    )


def pair_sentence(kept: Mapping[str, Kept]) -> str:
    """Say how the fitted curve differs from Kim et al.'s constants, session by session.

    In percent of their flicker and of their detail loss.
    """
    kim, fitted = kept[KIM], kept[FITTED]
    differences = fitted.gain_over(kim)
    words = [
        _difference(_percent(gain), what)
        for gain, what in zip(differences, ("flicker", "detail loss"), strict=True)
    ]
    words[-1] = words[-1].rstrip(",")
    return f"Than Kim et al.'s constants the fitted curve has {' and '.join(words)}."


def provenance(
    fit: CurveFit, study: Mapping[str, Any], lag_weight: float
) -> dict[str, Any]:
    """Say where a curve's numbers are from, as a table of its file.

    **Arguments:** `study`: what it was fitted on, as the command line named it.
    """
    space, sure = fit.space, fit.errors
    found: dict[str, Any] = {
        "family": space.family,
        "samples": space.samples,
        "localization": space.localization,
        **study,
        "detail_loss_bound": _short(fit.detail_bound),
        "detail_loss_weight": _short(fit.weight),
        "lag_weight": lag_weight,
        "search": fit.why,
        "steps": fit.steps,
        "standard_error": dict(
            zip(space.names, map(_short, sure.standard_error), strict=True)
        ),
        "interval_95": {
            name: [_short(low), _short(high)]
            for name, low, high in zip(space.names, sure.low, sure.high, strict=True)
        },
    }
    if (gain := gain_percent(fit)) is not None:
        found["gain_at_equal_detail_percent"] = _bounds(gain)
    for where, kept in (("", fit.kept), ("held_out_", fit.kept_elsewhere)):
        for name in (KIM, FITTED) if kept else ():
            who = "kim" if name == KIM else name
            flicker, loss = kept[name].intervals()
            found[f"{where}{who}_flicker"] = _bounds(flicker)
            found[f"{where}{who}_detail_loss"] = _bounds(loss)
    found["hmdjit_version"] = __version__
    return found


def _empty(first: str, *others: str) -> Table:
    found = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    found.add_column(first, no_wrap=True)
    for header in others:
        found.add_column(header, justify="right", no_wrap=True)
    return found


def _interval(interval: Interval) -> str:
    return f"{interval.value:.3f} [{interval.low:.3f}, {interval.high:.3f}]"


def _percent(interval: Interval) -> Interval:
    names = ("value", "low", "high", "standard_error")
    percent = {name: 100 * getattr(interval, name) for name in names}
    return dataclasses.replace(interval, **percent)


def _difference(gain: Interval, what: str) -> str:
    if gain.low <= 0 <= gain.high:
        return (
            f"{gain.value:.1f} % less {what} [{gain.low:.1f}, {gain.high:.1f}], the "
            "same within what these sessions can tell,"
        )
    word = "less" if gain.value > 0 else "more"
    low, high = sorted((abs(gain.low), abs(gain.high)))
    return f"{abs(gain.value):.1f} % {word} {what} [{low:.1f}, {high:.1f}]"


def _bounds(interval: Interval) -> dict[str, float]:
    return {
        "mean": _short(interval.value),
        "low": _short(interval.low),
        "high": _short(interval.high),
    }


def _short(value: Any) -> float:
    return float(f"{float(value):.{_DIGITS}g}")
