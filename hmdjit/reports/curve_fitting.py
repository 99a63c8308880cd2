"""A fitted curve in words: its numbers, and what it gains over Kim et al.'s constants.

Flicker and detail loss are relative to no anti-aliasing, on sessions that the curve was
not fitted to.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from .._version import __version__
from ..curve_fitting.results import (
    FITTED,
    KIM,
    CurveFit,
    FrontPoint,
    Kept,
    gain_at_equal_detail,
)
from ..estimates.intervals import Interval
from ..techniques import HeadMovement
from . import tables

LABELS = {KIM: "Kim et al.'s constants", FITTED: "fitted curve"}


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


def numbers_table(fit: CurveFit) -> tables.Continued:
    """Lay out the fitted numbers, how sure they are, and Kim et al.'s."""
    columns = {
        "parameter": tables.WORDS,
        "fitted": "{:.4g}",
        "std. error": "{:.2g}",
        "95 % interval": "[{:.4g}, {:.4g}]",
        "Kim et al.": "{:.4g}",
    }
    sure = fit.errors
    bounds = zip(sure.low, sure.high, strict=True)
    numbers = (fit.numbers, sure.standard_error, bounds, kim_numbers(fit))
    return tables.table(columns, zip(fit.space.names, *numbers, strict=True))


def kept_table(kept: Mapping[str, Kept]) -> tables.Continued:
    """Lay out what each technique keeps of flicker and of detail."""
    interval = tables.INTERVAL
    columns = {
        "technique": tables.WORDS,
        "flicker, of none": interval,
        "detail loss, of none": interval,
    }
    rows = [
        (LABELS.get(name, name), *((x.value, x.low, x.high) for x in one.intervals()))
        for name, one in kept.items()
    ]
    return tables.table(columns, rows, bold=[name == FITTED for name in kept])


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
    is_sure = not gain.low <= 0 <= gain.high
    rest = (
        " than Kim et al.'s constants."
        if is_sure
        else ": Kim et al.'s constants are on the front within what these sessions can "
        "tell."
    )
    return f"At equal detail loss {_less(gain, 'flicker')}{rest}"


def pair_sentence(kept: Mapping[str, Kept]) -> str:
    """Say how the fitted curve differs from Kim et al.'s constants, session by session.

    In percent of their flicker and of their detail loss.
    """
    words = []
    gains = map(_percent, kept[FITTED].gain_over(kept[KIM]))
    for gain, what in zip(gains, ("flicker", "detail loss"), strict=True):
        is_same = gain.low <= 0 <= gain.high
        same = ", the same within what these sessions can tell," * is_same
        words.append(_less(gain, what) + same)
    said = " and ".join(words).rstrip(",")
    return f"Than Kim et al.'s constants the fitted curve has {said}."


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


def _percent(interval: Interval) -> Interval:
    names = ("value", "low", "high", "standard_error")
    percent = {name: 100 * getattr(interval, name) for name in names}
    return dataclasses.replace(interval, **percent)


def _less(gain: Interval, what: str) -> str:
    """Say by how many percent something is less, or more where that is sure."""
    sign, word = (-1, "more") if gain.high < 0 else (1, "less")
    low, high = sorted((sign * gain.low, sign * gain.high))
    return f"{sign * gain.value:.1f} % {word} {what} [{low:.1f}, {high:.1f}]"


def _bounds(interval: Interval) -> dict[str, float]:
    numbers = {"mean": interval.value, "low": interval.low, "high": interval.high}
    return {name: _short(value) for name, value in numbers.items()}


def _short(value: Any) -> float:
    return float(f"{float(value):.6g}")
