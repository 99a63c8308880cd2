"""What heads do, recorded and modelled, as tables for the terminal.

Velocities are raw frame differences: the tracker's noise is in all that is shown.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from rich.console import Console

from .. import _toml
from ..head_fitting.fitting import Fit
from ..head_fitting.statistics import SPECTRUM_BINS, WANDER_S, Description, Goodness
from ..head_motion import Trace
from ..head_motion.parameters import AXES
from ..studies.identity import counted
from . import tables
from .tables import READY, WORDS

_GAP_FRAMES = 3  # steps of more are gaps, see `Trace.frame_s`


def print_recordings(
    console: Console, traces: Sequence[Trace], segments: Sequence[Trace], rate_hz: float
) -> None:
    """Print what was recorded, how much of it is still, and what is missing."""
    steps = [np.diff(trace.frame_numbers) for trace in traces]
    gaps = np.concatenate([step[step > _GAP_FRAMES] for step in steps])
    bridged = sum(int(np.sum(step[step <= _GAP_FRAMES] - 1)) for step in steps)
    frames = sum(len(trace.t_s) for trace in traces) + bridged
    recorded_s = sum(trace.duration_s for trace in traces)
    still_s = sum(segment.duration_s for segment in segments)
    longest_s = max((segment.duration_s for segment in segments), default=0.0)
    subjects = {trace.subject for trace in traces}
    still_subjects = {segment.subject for segment in segments}
    rows = (
        ("recordings", f"{len(traces)}"),
        ("subjects", f"{len(subjects)} ({len(still_subjects)} with still segments)"),
        ("frame rate", f"{rate_hz:.2f} Hz"),
        ("recorded", f"{recorded_s:.1f} s"),
        ("held still", f"{still_s:.1f} s ({still_s / recorded_s:.1%})"),
        ("still segments", f"{len(segments)}, the longest of {longest_s:.1f} s"),
        ("gaps", f"{len(gaps)} ({gaps.sum() / rate_hz:.1f} s)"),
        ("lost frames, bridged", f"{bridged} of {frames} ({bridged / frames:.2%})"),
    )
    console.print(tables.table({"recorded heads": WORDS, "": WORDS}, rows))


def print_fit(console: Console, fit: Fit) -> None:
    """Print a fit's numbers with their errors, its order, and what both rest on."""
    columns = dict.fromkeys(("value", "std. error", "95 % interval"), READY)
    rows: list[tuple[str, ...]] = []
    parts = (fit.head, fit.standard_error, fit.low, fit.high)
    tables_of = [_toml.table(part) for part in parts]
    fit_error = tables_of[0].pop("fit_error", None)
    of_parts = zip(*map(_numbers, tables_of), strict=True)
    for (name, axis, value), *others in of_parts:
        error, low, high = (number for _, _, number in others)
        name, axis = _named(name, axis)
        if not math.isfinite(error):
            rows.append((name, axis, f"{value:.4g}", "not identifiable", ""))
            continue
        places = max(0, 1 - math.floor(math.log10(error))) if error else 4
        value, error, low, high = (
            f"{number:.{places}f}" for number in (value, error, low, high)
        )
        rows.append((name, axis, value, error, f"[{low}, {high}]"))
    console.print(
        tables.table({"number": WORDS, "axis": WORDS, **columns}, rows, fold=True)
    )
    console.print(
        f"Errors and intervals are over {fit.clusters}. Not identifiable: not fitted, "
        "or at a bound of its search."
    )
    if fit_error is not None:
        share = f"{100 * fit_error['rotation']:.1f} %"
        console.print(
            f"RMS rotation per frame: ± {share} (a standard error), which intervals "
            "of a study with this head hold."
        )
    console.print(_order(fit))


def _numbers(table: Any, place: str = "", axis: str = "") -> Iterator[tuple]:
    """Walk the numbers of a head's table: name, axis, value."""
    if isinstance(table, dict):
        for key, entry in table.items():
            yield from _numbers(entry, f"{place}.{key}" if place else key)
    elif isinstance(table, list) and isinstance(table[0] if table else {}, dict):
        for i, entry in enumerate(table):
            yield from _numbers(entry, f"{place}[{i}]")
    elif isinstance(table, list):
        for name, entry in zip(AXES, table, strict=True):
            yield from _numbers(entry, place, name)
    else:
        yield place, axis, table


def _order(fit: Fit) -> str:
    order = len(fit.head.resonators)
    modes = f"{counted(order, 'resonance')} per axis"
    if not fit.held_out_deviance:
        return f"Order {order}, as given: {modes}."
    scores = ", ".join(f"{k}: {v:.4f}" for k, v in fit.held_out_deviance.items())
    return (
        f"Order {order}: {modes}, the smallest order within a standard error of the "
        f"best. Deviance on held-out data by order: {scores}."
    )


def print_description(console: Console, recorded: Description) -> None:
    """Print what still heads do."""
    columns = {"what still heads do": WORDS, "axis": WORDS, "recorded": READY}
    rows = [(*_named(name, axis), _short(x)) for name, axis, x in _measures(recorded)]
    console.print(tables.table(columns, rows))


def print_goodness(
    console: Console, goodness: Goodness, *, word: str = "recorded"
) -> None:
    """Print what recorded heads do beside what the model's do.

    **Arguments:** `word`: where the heads come from.
    """
    recorded, model = goodness.recorded, goodness.model
    columns = {"what still heads do": WORDS, "axis": WORDS}
    columns |= dict.fromkeys((word, "model", "difference"), READY)
    rows = []
    pairs = zip(_measures(recorded), _measures(model), strict=True)
    for (name, axis, of_heads), (_, _, of_model) in pairs:
        change = of_model / of_heads - 1 if of_heads else math.nan
        shown = "-" if math.isnan(change) else f"{change:+.1%}"
        rows.append((*_named(name, axis), _short(of_heads), _short(of_model), shown))
    console.print(tables.table(columns, rows))
    errors = zip(AXES, goodness.spectrum_error_db, strict=True)
    low_hz, high_hz = recorded.frequency_hz[[0, -1]]
    console.print(
        "Log-spectral error: "
        + ", ".join(f"{axis} {_short(error_db)} dB" for axis, error_db in errors)
        + f" (RMS over the {len(recorded.frequency_hz)} of {SPECTRUM_BINS} bins that "
        f"hold a frequency, centred on {low_hz:.2f} to {high_hz:.1f} Hz)."
    )


def _measures(heads: Description) -> Iterator[tuple[str, str, float]]:
    yield "speed RMS, deg/s", "", heads.speed_rms_deg_s
    for name, share in {"median": 0.5, "95 %": 0.95}.items():
        yield f"speed {name}, deg/s", "", heads.speed_quantile(share)
    for time_s, wander_deg in zip(WANDER_S, heads.wander_deg, strict=True):
        for axis, value in zip(AXES, wander_deg, strict=True):
            yield f"wander in {time_s:g} s, deg", axis, value
    for axis, value in zip(AXES, heads.kurtosis, strict=True):
        yield "excess kurtosis of velocity", axis, value


def _named(name: str, axis: str) -> tuple[str, str]:
    """Name a row; of three axes only the first is named."""
    return (name if axis in ("", AXES[0]) else "", axis)


def _short(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:#.3g}".rstrip(".")
