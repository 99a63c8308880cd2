"""Figures of a study: distributions, Kim's Figure 3, flicker against detail."""

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator

from ..estimates.intervals import Z95
from ..estimates.summary import POOLED, SummaryRow
from . import drawing
from .ratios import draw_ratios
from .techniques import Compared

if TYPE_CHECKING:
    import xarray


def write_figures(
    dataset: "xarray.Dataset",
    rows: Sequence[SummaryRow],
    folder: str | os.PathLike,
) -> list[Path]:
    """Draw a study as PNG files of 150 dpi and as SVG, each written whole or not.

    **Returns:** the paths of the files, named as `draw` names their figures.
    """
    return [
        path
        for name, figure in draw(dataset, rows).items()
        for path in drawing.save_both(figure, Path(folder) / f"{name}.png")
    ]


@drawing.styled
def draw(dataset: "xarray.Dataset", rows: Sequence[SummaryRow]) -> dict[str, Figure]:
    """Draw the figures of a study.

    - `distributions`: cumulative distribution over sessions, per technique.
    - `ratios`: ratio to the baseline, per scene and over scenes.
    - `figure3`: largest, mean and smallest MTCD, as Kim's Figure 3.
    - `flicker_detail`: flicker against detail loss, where that was measured.

    **Arguments:** `dataset`, `rows`: a study's result, and `summarize` of it.
    """
    study = Compared(dataset, rows)
    figures = {
        "distributions": _distributions(study),
        "ratios": draw_ratios(study),
        "figure3": _figure3(study),
    }
    if study.is_flicker and "detail_loss" in study.metrics:
        figures["flicker_detail"] = _flicker_detail(study)
    return figures


def _distributions(study: Compared) -> Figure:
    band = (
        "No bands: windows of one subject are not independent."
        if study.clustered
        else "Bands: 95 %, for the whole curve (Dvoretzky-Kiefer-Wolfowitz with "
        "Massart's constant)."
    )
    what = "flicker" if study.is_flicker else study.headline
    title = f"How much sessions differ: {what} per session, mean over scenes"
    figure, axes = study.axes(8.5, 4.8, title, band)
    sessions = dict(zip(study.techniques, study.mtcd.mean(axis=1), strict=True))
    sessions = {t: np.sort(x[np.isfinite(x)]) for t, x in sessions.items()}
    sessions = {t: x for t, x in sessions.items() if x.size}
    everything = np.concatenate([*sessions.values(), [0.0]])
    positive = everything[everything > 0]
    low, high = (positive.min(), positive.max()) if positive.size else (0.1, 10.0)
    low, high = low / 1.15, high * 1.15
    # A logarithmic axis has no 0: frozen sessions stand at its left end, set apart.
    has_zeros = any((values == 0).any() for values in sessions.values())
    zero = low / (high / low) ** 0.08
    left = zero / (high / low) ** 0.02 if has_zeros else low
    axes.set_xscale("log")
    for technique in sorted(sessions, key=lambda t: float(np.median(sessions[t]))):
        values = np.where(sessions[technique] > 0, sessions[technique], zero)
        count = values.size
        x = np.concatenate([values[:1], values])
        y = np.arange(count + 1) / count
        colour, dashes, _ = study.style[technique]
        median = f"{np.median(sessions[technique]):.3g}"
        label = f"{study.label(technique)}\nmedian {median}"
        axes.step(x, y, where="post", color=colour, ls=dashes, lw=1.8, label=label)
        if not study.clustered:
            # Dvoretzky, Kiefer and Wolfowitz 1956, with Massart's constant 2 (1990).
            margin = math.sqrt(math.log(2 / 0.05) / (2 * count))
            band = np.clip(y - margin, 0, 1), np.clip(y + margin, 0, 1)
            axes.fill_between(x, *band, step="post", color=colour, alpha=0.15, lw=0)
    drawing.label_ticks(
        axes.xaxis,
        FixedLocator([zero] * has_zeros + drawing.ticks(low, high)),
        lambda value, _: "0" if has_zeros and value < low else f"{value:g}",
    )
    axes.set_xlim(left, high)
    axes.set_ylim(0, 1.01)
    axes.set_yticks(np.linspace(0, 1, 5), ["0", "25 %", "50 %", "75 %", "100 %"])
    if has_zeros:
        place = axes.get_xaxis_transform()
        gap = math.sqrt(zero * low)
        style = {
            "ha": "center",
            "va": "center",
            "clip_on": False,
            "bbox": drawing.PAPER,
        }
        axes.text(gap, 0, "//", size=drawing.NAME, transform=place, zorder=10, **style)
    axes.axhline(0.5, color=drawing.GREY, lw=0.6, ls=":")
    axes.set_xlabel(f"{study.headline} of a session, {study.unit} (logarithmic)")
    has = "flicker" if study.is_flicker else "have"
    axes.set_ylabel(f"sessions that {has} at most this much")
    beside: Any = "outside right"  # missing from matplotlib's own types
    figure.legend(loc=beside, labelspacing=0.9)
    return figure


def _figure3(study: Compared) -> Figure:
    names = [
        study.label(technique).replace(" ", "\n") for technique in study.techniques
    ]
    what = "flicker" if study.is_flicker else study.headline
    longest = max(len(line) for name in names for line in name.split("\n"))
    figure, axes = study.axes(
        max(7.0, max(1.3, 0.09 * longest) * len(names) + 1),
        4.4,
        f"Largest, mean and smallest {what} over all scenes and sessions",
        "As Kim et al., Figure 3. The largest and the smallest lie further apart the "
        "more sessions there are.",
    )
    # Else the small label of the mean gives way to the technique's name below it.
    axes.xaxis.remove_overlapping_locs = False
    places, marks = (-0.27, 0.0, 0.27), ("max", "mean", "min")
    for index, technique in enumerate(study.techniques):
        values = study.mtcd[index]
        values = values[np.isfinite(values)]
        colour = study.style[technique][0]
        if not values.size:
            style = {"ha": "center", "va": "bottom", **drawing.SMALL}
            axes.text(index, 0, "no session", **style)
            continue
        # Scenes count alike, however many sessions each of them has.
        scenes = [cell[np.isfinite(cell)] for cell in study.mtcd[index]]
        mean = float(np.mean([cell.mean() for cell in scenes if cell.size]))
        heights = [float(values.max()), mean, float(values.min())]
        for place, mark, height in zip(places, marks, heights, strict=True):
            is_mean = mark == "mean"
            alpha = 1.0 if is_mean else 0.45
            bar = axes.bar(index + place, height, 0.25, color=colour, alpha=alpha)
            text = f"{height:.0f}" if height >= 10 else f"{round(height, 3):.2g}"
            weight = "bold" if is_mean else "normal"
            axes.bar_label(bar, [text], padding=2, size=drawing.NUMBER, weight=weight)
    axes.set_xticks(range(len(names)), names)
    axes.tick_params(axis="x", length=0, pad=14, labelsize=drawing.NAME)
    minor = [index + place for index in range(len(names)) for place in places]
    small = {"fontsize": drawing.FINE, "color": drawing.GREY}
    axes.set_xticks(minor, [*marks] * len(names), minor=True, **small)
    axes.tick_params(axis="x", which="minor", length=0, pad=2)
    axes.set_ylabel(f"{study.headline}, {study.unit}")
    axes.margins(y=0.08)
    return figure


def _flicker_detail(study: Compared) -> Figure:
    figure, axes = study.axes(
        8.0,
        5.6,
        "Flicker against lost detail: the best technique is low in both",
        "Large: mean over scenes, with 95 % intervals. Faint: each scene.",
    )
    shown = []
    for technique in study.techniques:
        cells = [study.rows[technique, scene] for scene in study.scenes]
        style = study.points(technique)
        loss, mtcd = [_loss(r) for r in cells], [r.mean for r in cells]
        axes.scatter(loss, mtcd, s=14, alpha=0.3, lw=0, clip_on=False, **style)
        pooled = study.rows[technique, POOLED]
        if math.isfinite(pooled.mean + _loss(pooled)):
            shown.append(pooled)
            mean, half = (
                _loss(pooled),
                Z95 * pooled.others["detail_loss"].standard_error,
            )
            loss = (mean, mean - half, mean + half)
            mtcd = (pooled.mean, pooled.low, pooled.high)
            style |= {"ms": 8, "mec": "white", "lw": 1.6, "capsize": 3}
            drawing.errorbar(axes, loss, mtcd, clip_on=False, zorder=5, **style)
    every = study.rows.values()
    pooled = [row for row in every if row.scene == POOLED]
    losses = [_loss(row) for row in every]
    drawing.symlog(axes, "x", [_loss(row) for row in pooled], losses)
    drawing.symlog(axes, "y", [row.mean for row in pooled], [row.mean for row in every])
    axes.grid()
    axes.set_xlabel("detail loss: squared error to the reference, code values²")
    axes.set_ylabel("MTCD, code values of 8 bits")
    axes.annotate(
        "better",
        (0.03, 0.06),
        (0.11, 0.14),
        xycoords="axes fraction",
        textcoords="axes fraction",
        fontsize=drawing.NAME,
        color=drawing.GREY,
        arrowprops={"arrowstyle": "->", "color": drawing.GREY},
    )
    points = [
        (
            _loss(row),
            row.mean,
            study.label(row.technique),
            study.style[row.technique][0],
        )
        for row in shown
    ]
    drawing.label_points(figure, axes, points)
    return figure


def _loss(row: SummaryRow) -> float:
    return row.others["detail_loss"].mean
