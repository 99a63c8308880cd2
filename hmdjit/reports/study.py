"""Report of a study: tables for the terminal, `summary.csv`, and the figures."""

import json
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich import box
from rich.console import Console, Group
from rich.table import Table
from rich.text import Text

from ..estimates.estimate import MIN_BASELINE_MTCD, NO_FLICKER
from ..estimates.intervals import Z95
from ..estimates.summary import (
    GEOMETRIC_MEAN,
    ONE_SESSION,
    POOLED,
    SummaryRow,
    summarize,
    write_csv,
)
from ..figures.drawing import footer
from ..figures.study import write_figures as write_figures

if TYPE_CHECKING:
    import xarray

_PLAIN = str.maketrans({"±": "+-", "–": "-", "²": "^2", "×": "x", "°": " deg"})


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
    parts: list[Text | Table] = [
        Text("Flicker and detail, mean over scenes", style="bold"),
        _pooled_table([cells[t, POOLED] for t in techniques], baseline, width),
    ]
    others = [t for t in techniques if t != baseline]
    if others and len(scenes) > 1:
        title = f"MTCD as a share of {baseline}'s, by scene"
        parts.append(Text("\n" + title, style="bold"))
        lines = [*scenes, POOLED, GEOMETRIC_MEAN]
        room = width - max(map(len, lines)) - len(baseline) - 6
        while others:
            fitting = max(1, _fitting([max(len(t), 11) + 2 for t in others], room))
            parts.append(_scene_table(cells, lines, baseline, others[:fitting]))
            others = others[fitting:]
    parts.append(Text("\n" + _caption(dataset, rows), style="dim"))
    if not utf:
        parts = [_plain(part) for part in parts]
    return Group(*parts)


def _pooled_table(rows: Sequence[SummaryRow], baseline: str, width: int) -> Table:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, width >= 90), show_edge=False)
    table.add_column("technique", overflow="fold", min_width=8)
    for header in ("MTCD", "median", "5–95 %", f"ratio to {baseline}", "detail loss"):
        table.add_column(header, justify="right", no_wrap=True)
    mean = _decimals([_half(row.low, row.high) for row in rows])
    ratio = min(3, _decimals([_half(row.ratio_low, row.ratio_high) for row in rows]))
    losses = [row.others["detail_loss"] for row in rows]
    loss = _decimals([Z95 * one.standard_error for one in losses])
    for row, lost in zip(rows, losses, strict=True):
        shown = _number(row.ratio, ratio)
        if row.ratio_low < row.ratio_high:
            shown += f" [{row.ratio_low:.{ratio}f}, {row.ratio_high:.{ratio}f}]"
        if row.technique == baseline and math.isfinite(row.ratio):
            shown = "1 (baseline)"
        spread = [_number(q, mean) for q in (row.q05, row.q95)]
        table.add_row(
            row.technique,
            _with_error(row.mean, _half(row.low, row.high), mean),
            _number(row.q50, mean),
            "–".join(spread) if math.isfinite(row.q05) else "–",
            shown,
            _with_error(lost.mean, Z95 * lost.standard_error, loss),
            style="bold" if row.technique == baseline else "",
        )
    return table


def _scene_table(
    cells: dict[tuple[str, str], SummaryRow],
    lines: Sequence[str],
    baseline: str,
    techniques: Sequence[str],
) -> Table:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    table.add_column("scene", overflow="fold")
    table.add_column(baseline, justify="right", no_wrap=True, style="dim")
    for technique in techniques:
        table.add_column(technique, justify="right")
    for line in lines:
        if line == POOLED:
            table.add_section()
        flicker = cells[baseline, line].mean
        ratios = [cells[technique, line] for technique in techniques]
        table.add_row(
            line,
            "" if math.isnan(flicker) else f"{flicker:#.3g}",
            *(
                _with_error(row.ratio, _half(row.ratio_low, row.ratio_high), 3)
                for row in ratios
            ),
        )
    return table


def _caption(dataset: "xarray.Dataset", rows: Sequence[SummaryRow]) -> str:
    a = dataset.attrs
    over = next(
        row.interval
        for row in rows
        if (row.technique, row.scene) == (a["baseline"], POOLED)
    )
    words = [
        "MTCD in code values of 8 bits: what the picture changes from frame to frame. "
        "Detail loss: squared error to "
        f"{a.get('reference', 'the reference')}, code values². MTCD alone is won by a "
        "frozen picture, so read it together with detail loss.",
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


def _number(value: float, decimals: int) -> str:
    if math.isnan(value):
        return "–"
    return "0" if value == 0 else f"{value:.{decimals}f}"


def _with_error(value: float, half: float, decimals: int) -> str:
    if math.isnan(value) or math.isnan(half) or half == 0:
        return _number(value, decimals)
    return f"{value:.{decimals}f} ±{half:.{decimals}f}"


def _fitting(widths: Sequence[int], room: int) -> int:
    """How many of the first columns fit beside each other."""
    return int(np.searchsorted(np.cumsum(widths), room, side="right"))


def _plain(part: Text | Table) -> Text | Table:
    """Replace what an encoding other than Unicode cannot show."""
    if isinstance(part, Text):
        return Text(part.plain.translate(_PLAIN), style=part.style)
    for column in part.columns:
        column.header = str(column.header).translate(_PLAIN)
        column._cells = [str(cell).translate(_PLAIN) for cell in column._cells]
    return part
