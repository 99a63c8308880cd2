"""Figures of a sweep: lines along each axis, a heat map for each pair of axes."""

import itertools
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from ..estimates.summary import POOLED, SummaryRow
from ..studies.identity import counted, metric_ids, metric_words
from ..sweep.dataset import axes_of, axis_words
from . import drawing
from .techniques import Compared

if TYPE_CHECKING:
    import xarray

Rows = Sequence[tuple[dict[str, Any], SummaryRow]]


def write_figures(
    dataset: "xarray.Dataset", rows: Rows, folder: str | os.PathLike
) -> list[Path]:
    """Draw a sweep as PNG files, each written whole or not at all.

    **Returns:** the paths of the files.
    """
    return [
        drawing.save(figure, Path(folder) / f"{name}.png")
        for name, figure in draw(dataset, rows).items()
    ]


@drawing.styled
def draw(dataset: "xarray.Dataset", rows: Rows) -> dict[str, Figure]:
    """Draw lines with intervals of one axis, or heat maps of each pair of axes.

    Over all scenes; of further axes, at their first value, which the footer names.

    **Arguments:** `rows`: `summarized` of the dataset.
    """
    grid = _Grid(dataset, rows)
    if len(grid.axes) == 1:
        return {f"sweep-{grid.axes[0]}": _lines(grid, grid.axes[0])}
    pairs = itertools.combinations(grid.axes, 2)
    return {f"sweep-{one}-{two}": _maps(grid, one, two) for one, two in pairs}


class _Grid:
    """Pooled values of a sweep: `what` by technique and the axes, with low and high."""

    def __init__(self, dataset: "xarray.Dataset", rows: Rows):
        self.axes = axes_of(dataset)
        self.values = {name: dataset[name].values.tolist() for name in self.axes}
        self.techniques = [str(name) for name in dataset["technique"].values]
        self.baseline = str(dataset.attrs["baseline"])
        self.headline, *others = metric_ids(dataset)
        pooled = [row for _, row in rows if row.scene == POOLED]
        first = {name: 0 for name in self.axes}
        cell = dataset.isel(first)
        self.style = Compared(cell, []).style
        shape = [len(values) for values in self.values.values()]
        shape += [len(self.techniques), 3]

        def spread(each: list[tuple[float, float, float]]) -> np.ndarray:
            return np.reshape(np.array(each), shape)

        name = metric_words(self.headline)
        self.panels = {
            f"{name}: ratio to {self.baseline}": spread(
                [(row.ratio, row.ratio_low, row.ratio_high) for row in pooled]
            )
        }
        if "detail_loss" in others:
            of = [row.others["detail_loss"] for row in pooled]
            title = "detail loss, code values²"
            self.panels[title] = spread([(one.mean, one.low, one.high) for one in of])
        else:
            means = [(row.mean, row.low, row.high) for row in pooled]
            self.panels[f"{name}, mean"] = spread(means)
        self.footer = (
            f"Mean over {counted(dataset.sizes['scene'], 'scene')}, up to "
            f"{counted(dataset.sizes['session'], 'session')} in each cell, "
            f"seed {dataset.attrs['seed']} in all; intervals 95 %, over "
            f"sessions. hmdjit {dataset.attrs['hmdjit_version']}, model "
            f"{dataset.attrs['model_version']}."
        )

    def at(self, what: str, kept: Sequence[str]) -> Float[np.ndarray, "..."]:
        """Take the first value of all axes but those that are kept."""
        place = tuple(slice(None) if axis in kept else 0 for axis in self.axes)
        return self.panels[what][place]

    def where(self, kept: Sequence[str]) -> str:
        """Say where on the other axes this is."""
        others = [axis for axis in self.axes if axis not in kept]
        words = [f"{axis_words(a)} = {_text(self.values[a][0])}" for a in others]
        return f"At {'; '.join(words)}. {self.footer}" if words else self.footer


def _lines(grid: _Grid, axis: str) -> Figure:
    figure, (row,) = drawing.panels(9.0, 4.2, grid.where([axis]), 1, len(grid.panels))
    values = grid.values[axis]
    is_number = all(isinstance(value, int | float) for value in values)
    x = np.array(values, float) if is_number else np.arange(len(values), dtype=float)
    for axes, title in zip(row, grid.panels, strict=True):
        found = grid.at(title, [axis])
        for k, technique in enumerate(grid.techniques):
            colour, dashes, marker = grid.style[technique]
            value, low, high = found[:, k].T
            spread = np.nan_to_num([value - low, high - value]).clip(0)
            look = {"color": colour, "ls": dashes, "marker": marker, "ms": 4}
            axes.errorbar(
                x, value, spread, capsize=2.5, lw=1.4, label=technique, **look
            )
        axes.set_title(title)
        axes.set_xlabel(axis_words(axis))
        axes.set_xticks(x, map(_text, values))
        axes.set_ylim(bottom=0)
        axes.grid()
    beside: Any = "outside right"  # missing from matplotlib's own types
    figure.legend(*row[0].get_legend_handles_labels(), loc=beside)
    return figure


def _maps(grid: _Grid, one: str, two: str) -> Figure:
    """Draw a row of heat maps, a technique each, for each panel."""
    shown = {
        title: [
            k
            for k, name in enumerate(grid.techniques)
            if name != grid.baseline or "ratio" not in title
        ]
        for title in grid.panels
    }
    across, down = grid.values[two], grid.values[one]
    columns = max(map(len, shown.values()))
    width = 1.2 + columns * max(1.8, 0.62 * len(across) + 0.5)
    height = 0.8 + len(shown) * max(1.7, 0.34 * len(down) + 1.1)
    figure, panels = drawing.panels(
        width, height, grid.where([one, two]), len(shown), columns
    )
    for row, (title, techniques) in zip(panels, shown.items(), strict=True):
        found = grid.at(title, [one, two])
        finite = found[..., techniques, 0]
        finite = finite[np.isfinite(finite)]
        low, high = (finite.min(), finite.max()) if finite.size else (0.0, 1.0)
        image = None
        for axes, k in itertools.zip_longest(row, techniques):
            if k is None:
                axes.set_axis_off()
                continue
            values, bounds = found[..., k, 0], found[..., k, 1:]
            image = axes.imshow(
                values, cmap="viridis", vmin=low, vmax=high, aspect="auto"
            )
            axes.set_title(grid.techniques[k], fontsize=drawing.NAME)
            axes.set_xticks(range(len(across)), map(_text, across), size=drawing.NOTE)
            axes.set_yticks(range(len(down)), map(_text, down), size=drawing.NOTE)
            axes.set_xlabel(axis_words(two), size=drawing.NOTE)
            for (i, j), value in np.ndenumerate(values):
                half = (bounds[i, j, 1] - bounds[i, j, 0]) / 2
                text = "–" if math.isnan(value) else f"{value:.3g}"
                text += f"\n±{half:.1g}" if half > 0 else ""
                dark = not (value - low) > 0.6 * (high - low)
                look = {"ha": "center", "va": "center", "size": drawing.FINE}
                axes.text(j, i, text, color="white" if dark else "black", **look)
        row[0].set_ylabel(axis_words(one), size=drawing.NOTE)
        if image is not None:
            bar = figure.colorbar(image, ax=list(row), pad=0.01)
            bar.set_label(title, size=drawing.NOTE)
    return figure


def _text(value: Any) -> str:
    return value if isinstance(value, str) else f"{value:g}"
