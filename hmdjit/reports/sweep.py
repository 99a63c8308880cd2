"""Report of a sweep: a table for the terminal, `sweep.csv`, and the figures."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console, Group
from rich.text import Text

from .. import _files
from ..estimates.summary import POOLED
from ..figures.sweep import write_figures
from ..studies.identity import metric_ids, metric_words
from ..sweep.dataset import axes_of, axis_words, summarized
from .tables import READY, WORDS, decimals, spelling, table, with_error

if TYPE_CHECKING:
    import xarray


def write_report(dataset: "xarray.Dataset", folder: str | os.PathLike) -> list[Path]:
    """Write `sweep.csv`, the rows of all cells, and the figures into a folder.

    **Returns:** the paths of the files.
    """
    rows = summarized(dataset)
    lines = [{**point, **row.columns()} for point, row in rows]
    path = _files.write_csv(Path(folder) / "sweep.csv", lines)
    return [path, *write_figures(dataset, rows, folder)]


def print_table(dataset: "xarray.Dataset", console: Console) -> None:
    """Print each cell's headline of the baseline, and the others' ratios to it."""
    say, axes = spelling(console), axes_of(dataset)
    baseline, headline = str(dataset.attrs["baseline"]), metric_ids(dataset)[0]
    techniques = [str(name) for name in dataset["technique"].values]
    others = [name for name in techniques if name != baseline]
    cells = {}
    for point, row in summarized(dataset):
        if row.scene == POOLED:
            cells.setdefault(tuple(point.values()), {})[row.technique] = row
    half = lambda row: (row.high - row.low) / 2
    places = decimals([half(rows[baseline]) for rows in cells.values()])
    lines = []
    for point, rows in cells.items():
        base = rows[baseline]
        ratios = [
            with_error(row.ratio, (row.ratio_high - row.ratio_low) / 2, 3)
            for row in (rows[name] for name in others)
        ]
        lines.append(
            [
                *(one if isinstance(one, str) else f"{one:g}" for one in point),
                with_error(base.mean, half(base), places),
                *ratios,
            ]
        )
    columns = {say(axis_words(axis)): WORDS for axis in axes}
    columns |= {f"{metric_words(headline)} of {baseline}": READY}
    columns |= {f"{name} / {baseline}": READY for name in others}
    title = f"{metric_words(headline)} over all scenes, and ratios to it"
    note = "±: half of a 95 % interval over sessions; scenes are fixed."
    console.print(
        Group(
            Text(say(title), style="bold"),
            table(columns, lines, no_wrap=False, say=say),
            Text(say(f"\n{note}"), style="dim"),
        )
    )
