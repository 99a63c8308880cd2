"""Report of a study: tables for the terminal, `summary.csv`, and the figures."""

import json
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console, Group
from rich.table import Table
from rich.text import Text

from ..estimates.intervals import MIN_BASELINE_MTCD, NO_FLICKER, Z95
from ..estimates.summary import (
    GEOMETRIC_MEAN,
    ONE_SESSION,
    POOLED,
    SummaryRow,
    summarize,
    write_csv,
)
from ..figures.study import write_figures
from ..studies.identity import footer, metric_ids
from .tables import READY, WORDS, number, plain, table, with_error

if TYPE_CHECKING:
    import xarray


def write_report(dataset: "xarray.Dataset", folder: str | os.PathLike) -> list[Path]:
    """Write `summary.csv` and the figures of a study into a folder.

    **Returns:** the paths of the files.

    **Errors:** those of `results.summarize`.
    """
    rows = summarize(dataset)
    table = write_csv(rows, Path(folder) / "summary.csv")
    return [table, *write_figures(dataset, rows, folder)]


def print_table(
    dataset: "xarray.Dataset",
    rows: Sequence[SummaryRow] | None = None,
    console: Console | None = None,
) -> None:
    """Print a study's tables, by default to the terminal.

    **Arguments:** `rows`: `results.summarize` of the dataset, if at hand.

    **Errors:** those of `results.summarize`.
    """
    console = Console() if console is None else console
    rows = summarize(dataset) if rows is None else rows
    utf = console.encoding.lower().startswith("utf")
    console.print(tables(dataset, rows, width=console.width, utf=utf))


def tables(
    dataset: "xarray.Dataset",
    rows: Sequence[SummaryRow],
    *,
    width: int = 80,
    utf: bool = True,
) -> Group:
    """Lay out a study's tables: techniques over all scenes, then ratios per scene.

    **Arguments:**

    - `dataset`, `rows`: a study's result, and `results.summarize` of it.
    - `width`: of the terminal, in characters; more techniques than fit are continued
      in a further table.
    - `utf`: whether the terminal can show `±` and the like.

    **Returns:** what `rich` prints.
    """
    baseline = str(dataset.attrs["baseline"])
    cells = {(row.technique, row.scene): row for row in rows}
    techniques = [str(t) for t in dataset["technique"].values]
    scenes = [str(s) for s in dataset["scene"].values]
    others = metric_ids(dataset)[1:]
    title = " and detail" * ("detail_loss" in others) + ", mean over scenes"
    say = str if utf else plain
    pooled = [cells[t, POOLED] for t in techniques]
    parts: list[Text | Table] = [
        Text(f"Flicker{title}", style="bold"),
        _pooled_table(pooled, baseline, others, width, utf),
    ]
    compared = [t for t in techniques if t != baseline]
    if compared and len(scenes) > 1:
        title = f"\nMTCD as a share of {baseline}'s, by scene"
        parts.append(Text(say(title), style="bold"))
        lines = [*scenes, POOLED, GEOMETRIC_MEAN]
        room = width - max(map(len, lines)) - len(baseline) - 6
        while compared:
            widths = np.cumsum([max(len(t), 11) + 2 for t in compared])
            fitting = max(1, int(np.searchsorted(widths, room, side="right")))
            shown = [baseline, *compared[:fitting]]
            parts.append(_scene_table(cells, lines, shown, utf))
            compared = compared[fitting:]
    caption = _caption(dataset, rows)
    return Group(*parts, Text(say(f"\n{caption}"), style="dim"))


def _pooled_table(
    rows: Sequence[SummaryRow],
    baseline: str,
    others: Sequence[str],
    width: int,
    utf: bool,
) -> Table:
    headers = ["MTCD", "median", "5–95 %", f"ratio to {baseline}"]
    headers += [name.replace("_", " ") for name in others]
    mean = _decimals([_half(row.low, row.high) for row in rows])
    ratio = min(3, _decimals([_half(row.ratio_low, row.ratio_high) for row in rows]))
    means = {name: [getattr(row, name) for row in rows] for name in others}
    halves = {
        name: [Z95 * getattr(row, f"{name}_standard_error") for row in rows]
        for name in others
    }
    laid_out = []
    for place, row in enumerate(rows):
        shown = number(row.ratio, ratio)
        if row.ratio_low < row.ratio_high:
            shown += f" [{row.ratio_low:.{ratio}f}, {row.ratio_high:.{ratio}f}]"
        if row.technique == baseline and math.isfinite(row.ratio):
            shown = "1 (baseline)"
        spread = "–".join(number(q, mean) for q in (row.q05, row.q95))
        laid_out.append(
            (
                row.technique,
                with_error(row.mean, _half(row.low, row.high), mean),
                number(row.q50, mean),
                spread if math.isfinite(row.q05) else "–",
                shown,
                *(
                    with_error(
                        means[name][place],
                        halves[name][place],
                        _decimals(halves[name]),
                    )
                    for name in others
                ),
            )
        )
    return table(
        {"technique": WORDS, **dict.fromkeys(headers, READY)},
        laid_out,
        bold=[row.technique == baseline for row in rows],
        fold=True,
        utf=utf,
        padding=(0, width >= 90),
    )


def _scene_table(
    cells: dict[tuple[str, str], SummaryRow],
    lines: Sequence[str],
    techniques: Sequence[str],
    utf: bool,
) -> Table:
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
    return table(columns, rows, fold=True, no_wrap=False, utf=utf)


def _caption(dataset: "xarray.Dataset", rows: Sequence[SummaryRow]) -> str:
    a = dataset.attrs
    over = next(
        row.interval
        for row in rows
        if (row.technique, row.scene) == (a["baseline"], POOLED)
    )
    of_metrics = [
        "MTCD in code values of 8 bits: what the picture changes from frame to frame."
    ]
    for name in metric_ids(dataset)[1:]:
        if name == "detail_loss":
            of_metrics.append(
                f"Detail loss: squared error to {a.get('reference', 'the reference')}, "
                "code values². MTCD alone is won by a frozen picture, so read it together "
                "with detail loss."
            )
        else:
            said, unit = name.replace("_", " "), dataset[name].attrs.get("units", "")
            of_metrics.append(f"{said.capitalize()} in {unit}." if unit else "")
    words = [
        " ".join(filter(None, of_metrics)),
        f"± and [ ]: 95 % interval over sessions ({over}); scenes are fixed.",
        footer(dataset),
    ]
    if any(row.note == NO_FLICKER for row in rows):
        words.append(
            f"No ratio (–) where the baseline's MTCD is at most {MIN_BASELINE_MTCD}: "
            f"{NO_FLICKER}, left out of the geometric mean."
        )
    words += [_pairing(technique, rows) for technique in _varying(rows)]
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
    return "\n".join([words[0], words[1], " ".join(words[2:])])


def _varying(rows: Sequence[SummaryRow]) -> list[str]:
    """Techniques whose ratios vary, so that pairing them can gain something."""
    varying = [row.technique for row in rows if math.isfinite(row.pairing_gain)]
    return list(dict.fromkeys(varying))


def _pairing(technique: str, rows: Sequence[SummaryRow]) -> str:
    gains = [
        f"{row.scene} {row.pairing_gain:.0f}"
        for row in rows
        if row.technique == technique and math.isfinite(row.pairing_gain)
    ]
    return (
        f"Variance of {technique}'s ratios with sessions of its own, in multiples of "
        f"the paired one: {', '.join(gains)}."
    )


def _half(low: float, high: float) -> float:
    return (high - low) / 2


def _decimals(half_widths: Sequence[float]) -> int:
    """Decimals that give a typical half-width of a column two digits."""
    positive = [half for half in half_widths if half > 0]
    if not positive:
        return 3
    return min(4, max(0, 1 - math.floor(math.log10(np.median(positive)))))
