"""Report of a study: tables for the terminal, `summary.csv`, and the figures."""

import json
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console, Group
from rich.text import Text

from ..estimates.intervals import MIN_BASELINE_MTCD, NO_FLICKER
from ..estimates.summary import (
    GEOMETRIC_MEAN,
    ONE_SESSION,
    POOLED,
    SummaryRow,
    summarize,
    write_csv,
)
from ..figures.study import write_figures
from ..studies.identity import footer, metric_ids, metric_words
from .tables import (
    READY,
    WORDS,
    Continued,
    Say,
    decimals,
    number,
    spelling,
    table,
    with_error,
    with_errors,
)

if TYPE_CHECKING:
    import xarray


def write_report(dataset: "xarray.Dataset", folder: str | os.PathLike) -> list[Path]:
    """Write `summary.csv` and the figures of a study into a folder.

    **Returns:** the paths of the files.

    **Errors:** those of `summarize`.
    """
    rows = summarize(dataset)
    table = write_csv(rows, Path(folder) / "summary.csv")
    return [table, *write_figures(dataset, rows, folder)]


def print_table(
    dataset: "xarray.Dataset",
    rows: Sequence[SummaryRow] | None = None,
    console: Console | None = None,
) -> None:
    """Print a study's tables: techniques over all scenes, then ratios per scene.

    What the terminal is too narrow for is continued in further tables.

    **Arguments:** `rows`: `summarize` of the dataset, if at hand; `console`: by default
    the terminal.

    **Errors:** those of `summarize`.
    """
    console = Console() if console is None else console
    rows = summarize(dataset) if rows is None else rows
    say, shown = spelling(console), []
    parts = titled_tables(dataset, rows, console.width, say).items()
    for k, (title, found) in enumerate(parts):
        shown += [Text(say("\n" * (k > 0) + title), style="bold"), found]
    shown.append(Text(say("\n" + "\n".join(caption(dataset, rows))), style="dim"))
    console.print(Group(*shown))


def titled_tables(
    dataset: "xarray.Dataset",
    rows: Sequence[SummaryRow],
    width: int = 120,
    say: Say = str,
) -> dict[str, Continued]:
    """Return a study's tables by title: over all scenes, and ratios per scene."""
    baseline = str(dataset.attrs["baseline"])
    cells = {(row.technique, row.scene): row for row in rows}
    techniques = [str(t) for t in dataset["technique"].values]
    scenes = [str(s) for s in dataset["scene"].values]
    headline, *others = metric_ids(dataset)
    title = "Flicker" if headline == "mtcd" else metric_words(headline)
    title += " and detail" * ("detail_loss" in others) + ", mean over scenes"
    pooled = [cells[t, POOLED] for t in techniques]
    found = {title: _pooled_table(pooled, baseline, headline, others, width, say)}
    compared = [t for t in techniques if t != baseline]
    if compared and len(scenes) > 1:
        title = f"{metric_words(headline)} as a share of {baseline}'s, by scene"
        lines = [*scenes, POOLED, GEOMETRIC_MEAN]
        found[title] = _scene_table(cells, lines, [baseline, *compared], say)
    return found


def _pooled_table(
    rows: Sequence[SummaryRow],
    baseline: str,
    headline: str,
    others: Sequence[str],
    width: int,
    say: Say,
) -> Continued:
    """Lay out the headline, its ratio to the baseline, and the means of all others."""
    halves = [_half(row.low, row.high) for row in rows]
    mean = decimals(halves)
    ratio = min(3, decimals([_half(row.ratio_low, row.ratio_high) for row in rows]))
    columns = {
        "technique": [row.technique for row in rows],
        metric_words(headline): with_errors([row.mean for row in rows], halves),
        "median": [number(row.q50, mean) for row in rows],
        "5–95 %": [
            f"{number(row.q05, mean)}–{number(row.q95, mean)}"
            if math.isfinite(row.q05)
            else "–"
            for row in rows
        ],
        f"ratio to {baseline}": [_ratio(row, baseline, ratio) for row in rows],
    }
    for name in others:
        found = [row.others[name] for row in rows]
        halves = [_half(one.low, one.high) for one in found]
        columns[metric_words(name)] = with_errors([one.mean for one in found], halves)
    return table(
        dict.fromkeys(columns, READY) | {"technique": WORDS},
        zip(*columns.values(), strict=True),
        bold=[row.technique == baseline for row in rows],
        fold=True,
        say=say,
        padding=(0, width >= 90),
    )


def _ratio(row: SummaryRow, baseline: str, places: int) -> str:
    if row.technique == baseline and math.isfinite(row.ratio):
        return "1 (baseline)"
    shown = number(row.ratio, places)
    if row.ratio_low < row.ratio_high:
        shown += f" [{row.ratio_low:.{places}f}, {row.ratio_high:.{places}f}]"
    return shown


def _scene_table(
    cells: dict[tuple[str, str], SummaryRow],
    lines: Sequence[str],
    techniques: Sequence[str],
    say: Say,
) -> Continued:
    """Lay out ratios to the first technique, beside its own MTCD."""
    rows: list[Sequence | None] = []
    for line in lines:
        flicker, *ratios = (cells[technique, line] for technique in techniques)
        shown = "" if math.isnan(flicker.mean) else f"{flicker.mean:#.3g}"
        errors = [
            with_error(row.ratio, _half(row.ratio_low, row.ratio_high), 3)
            for row in ratios
        ]
        rows += [None] * (line == POOLED) + [(line, Text(shown, style="dim"), *errors)]
    columns = {"scene": WORDS, **dict.fromkeys(techniques, READY)}
    return table(columns, rows, fold=True, no_wrap=False, say=say)


def caption(dataset: "xarray.Dataset", rows: Sequence[SummaryRow]) -> list[str]:
    """Say what the numbers are, what intervals are over, and what all rests on."""
    a, headline = dataset.attrs, metric_words(metric_ids(dataset)[0])
    over = next(
        row.interval
        for row in rows
        if (row.technique, row.scene) == (a["baseline"], POOLED)
    )
    meanings = {
        "mtcd": "MTCD in code values of 8 bits: what the picture changes from frame to "
        "frame.",
        "detail_loss": "Detail loss: squared error to "
        f"{a.get('reference', 'the reference')}, code values². MTCD alone is won by a "
        "frozen picture, so read it together with detail loss.",
    }
    for name in metric_ids(dataset):
        about, words = dataset[name].attrs, metric_words(name)
        unit = about.get("units", "unknown units")
        more = "; more is better" * (about.get("better") == "more")
        meaning = f"{words[0].upper()}{words[1:]} in {unit}{more}."
        meanings.setdefault(name, about.get("long_name", meaning))
    words = [
        " ".join(meanings[name] for name in metric_ids(dataset)),
        f"± and [ ]: 95 % interval over sessions ({over}); scenes are fixed.",
        footer(dataset),
    ]
    if any(row.note == NO_FLICKER for row in rows):
        words.append(
            f"No ratio (–) where the baseline's {headline} is at most "
            f"{MIN_BASELINE_MTCD}: {NO_FLICKER}, left out of the geometric mean."
        )
    gains: dict[str, list[str]] = {}
    for row in rows:
        if math.isfinite(row.pairing_gain):  # of ratios that vary
            shown = f"{row.scene} {row.pairing_gain:.0f}"
            gains.setdefault(row.technique, []).append(shown)
    words += [
        f"Variance of {technique}'s ratios with sessions of its own, in multiples of "
        f"the paired one: {', '.join(shown)}."
        for technique, shown in gains.items()
    ]
    failed = len(json.loads(a.get("failed_sessions", "[]")))
    wide = int(a.get("wide_halo_sessions", 0))
    words += [
        f"{row.technique}: {row.note}."
        for row in rows
        if row.scene == POOLED and row.note not in ("", ONE_SESSION)
    ]
    if failed:
        left_out = ", left out" if a.get("omit_failed") else ""
        words.append(f"Failed sessions{left_out}: {failed}.")
    if wide:
        words.append(f"Sessions that needed a wider halo: {wide}.")
    return [words[0], words[1], " ".join(words[2:])]


def _half(low: float, high: float) -> float:
    return (high - low) / 2
