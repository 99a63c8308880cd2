"""Figures of a study: distributions, ratios, Kim's Figure 3, flicker against detail."""

import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from ..estimates.intervals import Z95
from ..estimates.summary import GEOMETRIC_MEAN, POOLED, SummaryRow
from .drawing import GREY, PAPER, SHADE, Drawing, label_points, save, symlog, ticks

if TYPE_CHECKING:
    import xarray

KIM_RATIO = 0.56
"""Kim et al.: MTCD of their head-movement based filter, as a share of the original."""


def write_figures(
    dataset: "xarray.Dataset",
    rows: Sequence[SummaryRow],
    folder: str | os.PathLike,
) -> list[Path]:
    """Draw a study as PNG files of 150 dpi, each written whole or not at all.

    - `distributions.png`: cumulative distribution over sessions, per technique.
    - `ratios.png`: ratio to the baseline, per scene and over scenes.
    - `figure3.png`: largest, mean and smallest MTCD, as Kim's Figure 3.
    - `flicker_detail.png`: flicker against detail loss.

    **Arguments:** `dataset`, `rows`: a study's result, and `results.summarize` of it.

    **Returns:** the paths of the files.
    """
    drawings: dict[str, Callable[[Drawing], Figure]] = {
        "distributions.png": _distributions,
        "ratios.png": _ratios,
        "figure3.png": _figure3,
        "flicker_detail.png": _flicker_detail,
    }
    study = Drawing(dataset, rows)
    return [
        save(draw(study), Path(folder) / name, bbox_inches="tight")
        for name, draw in drawings.items()
    ]


def _distributions(study: Drawing) -> Figure:
    band = (
        "No bands: windows of one subject are not independent."
        if study.clustered
        else "Bands: 95 %, for the whole curve (Dvoretzky-Kiefer-Wolfowitz with "
        "Massart's constant)."
    )
    title = "How much sessions differ: flicker per session, mean over scenes"
    figure, axes = study.axes(8.5, 4.8, title, band)
    sessions = {
        technique: np.sort(values[np.isfinite(values)])
        for technique, values in zip(
            study.techniques, study.mtcd.mean(axis=1), strict=True
        )
    }
    sessions = {t: values for t, values in sessions.items() if values.size}
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
        colour, dashes = study.colour[technique], study.dashes[technique]
        median = f"{np.median(sessions[technique]):.3g}"
        label = f"{study.label(technique)}\nmedian {median}"
        axes.step(x, y, where="post", color=colour, ls=dashes, lw=1.8, label=label)
        if not study.clustered:
            # Dvoretzky, Kiefer and Wolfowitz 1956, with Massart's constant 2 (1990).
            margin = math.sqrt(math.log(2 / 0.05) / (2 * count))
            band = np.clip(y - margin, 0, 1), np.clip(y + margin, 0, 1)
            axes.fill_between(x, *band, step="post", color=colour, alpha=0.15, lw=0)
    axes.xaxis.set_major_locator(FixedLocator([zero] * has_zeros + ticks(low, high)))
    axes.xaxis.set_major_formatter(
        FuncFormatter(lambda v, _: "0" if has_zeros and v < low else f"{v:g}")
    )
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xlim(left, high)
    axes.set_ylim(0, 1.01)
    axes.set_yticks(np.linspace(0, 1, 5), ["0", "25 %", "50 %", "75 %", "100 %"])
    if has_zeros:
        place = axes.get_xaxis_transform()
        gap = math.sqrt(zero * low)
        look = {"fontsize": 9, "ha": "center", "va": "center", "clip_on": False}
        axes.text(gap, 0, "//", transform=place, bbox=PAPER, zorder=10, **look)
    axes.axhline(0.5, color=GREY, lw=0.6, ls=":")
    axes.set_xlabel("MTCD of a session, code values of 8 bits (logarithmic)")
    axes.set_ylabel("sessions that flicker at most this much")
    beside: Any = "outside right"  # missing from matplotlib's own types
    figure.legend(loc=beside, frameon=False, fontsize=8.5, labelspacing=0.9)
    return figure


def _ratios(study: Drawing) -> Figure:
    others = [t for t in study.techniques if t != study.baseline]
    flicker = lambda s: study.rows[study.baseline, s].mean
    scenes = sorted(study.scenes, key=lambda s: -np.nan_to_num(flicker(s)))
    lines = [POOLED, GEOMETRIC_MEAN, *scenes]
    pitch = max(0.3, 0.07 * len(others) + 0.06)
    # The headline's row is tall enough to write each technique's number beside it.
    tall = max(1.4, 0.15 * (len(others) + 1) / pitch)
    place = np.array([0, tall / 2 + 0.5, *(np.arange(len(scenes)) + tall / 2 + 1.8)])
    figure, axes = study.axes(
        8.0,
        1.6 + pitch * (tall + len(lines)),
        f"How much flicker is left: MTCD as a share of {study.baseline}'s",
    )
    axes.axhspan(-tall / 2, tall / 2 + 1, color=SHADE, lw=0, zorder=0)
    for y in place[2:]:
        axes.axhline(y, color="#eeeeee", lw=0.8, zorder=0)
    room = np.array([tall - 0.4, *[0.6] * (len(lines) - 1)])
    share = (np.arange(len(others)) + 0.5) / max(len(others), 1) - 0.5
    dodges = share[:, None] * room
    reach = 1.1
    for index, technique in enumerate(others):
        cells = [study.rows[technique, line] for line in lines]
        points = [
            (row.ratio, y, row.ratio - row.ratio_low, row.ratio_high - row.ratio)
            for row, y in zip(cells, place + dodges[index], strict=True)
            if math.isfinite(row.ratio)
        ]
        if not points:
            continue
        x, y, below, above = np.array(points).T
        reach = max(reach, float(np.nanmax(x + np.nan_to_num(above))) * 1.05)
        axes.errorbar(
            x,
            y,
            xerr=np.nan_to_num(np.stack([below, above])).clip(0),
            fmt=study.marker[technique],
            color=study.colour[technique],
            ms=4.5,
            lw=1.2,
            capsize=2,
            clip_on=False,
            zorder=4,
        )
    for technique, y in zip(others, dodges[:, 0], strict=True):
        _name_headline(axes, study, study.rows[technique, POOLED], y, reach)
    for line, y in zip(lines, place, strict=True):
        cells = [study.rows[technique, line] for technique in others]
        if cells and not any(math.isfinite(row.ratio) for row in cells):
            note = cells[0].note
            look = {"color": GREY, "fontsize": 8, "ha": "center", "va": "center"}
            axes.text(0.3, y, note, bbox=PAPER, **look)
    axes.axvline(1, color="black", lw=1.2, zorder=1)
    head = f"{study.baseline} = 1"
    above = {"transform": axes.get_xaxis_transform(), "ha": "center", "va": "bottom"}
    axes.text(1, 1.005, head, fontsize=8, **above)
    if any(technique.startswith("head_movement") for technique in others):
        axes.axvline(KIM_RATIO, color=GREY, lw=1.2, ls="--", zorder=1)
        kim = f"Kim et al.: {KIM_RATIO}"
        axes.text(KIM_RATIO, 1.005, kim, fontsize=8, color=GREY, **above)
    names = ["all scenes:\nratio of means", "all scenes:\ngeometric mean"]
    names += [f"{scene}  ({flicker(scene):.2g})" for scene in scenes]
    axes.set_yticks(place, names, fontsize=8.5)
    axes.tick_params(axis="y", length=0)
    axes.set_xlim(0, reach)
    axes.set_ylim(place[-1] + 0.6, -tall / 2)
    axes.grid(axis="x", color="#dddddd", lw=0.6, zorder=0)
    axes.set_axisbelow(True)
    axes.set_xlabel("ratio of mean MTCD, with 95 % interval")
    axes.set_ylabel(f"scene  (MTCD of {study.baseline}, code values)")
    return figure


def _name_headline(
    axes: Axes, study: Drawing, row: SummaryRow, y: float, reach: float
) -> None:
    """Write a technique's name and pooled ratio on the side that has room."""
    if not math.isfinite(row.ratio):
        return
    is_right = row.ratio < 0.5 * reach
    end = row.ratio_high if is_right else row.ratio_low
    bounds = f"  [{row.ratio_low:.3f}, {row.ratio_high:.3f}]"
    axes.annotate(
        f"{study.label(row.technique)}  {row.ratio:.3f}"
        + (bounds if math.isfinite(end) else ""),
        (end if math.isfinite(end) else row.ratio, y),
        (7 if is_right else -7, 0),
        textcoords="offset points",
        ha="left" if is_right else "right",
        va="center_baseline",
        fontsize=8,
        fontweight="bold",
        color=study.colour[row.technique],
        bbox=PAPER | {"facecolor": SHADE},
        zorder=3,
    )


def _figure3(study: Drawing) -> Figure:
    names = [
        study.label(technique).replace(" ", "\n") for technique in study.techniques
    ]
    longest = max(len(line) for name in names for line in name.split("\n"))
    figure, axes = study.axes(
        max(7.0, max(1.3, 0.09 * longest) * len(names) + 1),
        4.4,
        "Largest, mean and smallest flicker over all scenes and sessions",
        "As Kim et al., Figure 3. The largest and the smallest lie further apart the "
        "more sessions there are.",
    )
    # Else the small label of the mean gives way to the technique's name below it.
    axes.xaxis.remove_overlapping_locs = False
    places, marks = (-0.27, 0.0, 0.27), ("max", "mean", "min")
    for index, technique in enumerate(study.techniques):
        values = study.mtcd[index]
        values = values[np.isfinite(values)]
        colour = study.colour[technique]
        if not values.size:
            look = {"fontsize": 8, "color": GREY, "ha": "center", "va": "bottom"}
            axes.text(index, 0, "no session", **look)
            continue
        # Scenes count alike, however many sessions each of them has.
        scenes = [cell[np.isfinite(cell)] for cell in study.mtcd[index]]
        mean = float(np.mean([cell.mean() for cell in scenes if cell.size]))
        heights = [float(values.max()), mean, float(values.min())]
        for place, mark, height in zip(places, marks, heights, strict=True):
            is_mean = mark == "mean"
            alpha = 1.0 if is_mean else 0.45
            axes.bar(index + place, height, 0.25, color=colour, alpha=alpha)
            axes.annotate(
                f"{height:.0f}" if height >= 10 else f"{round(height, 3):.2g}",
                (index + place, height),
                xytext=(0, 2),
                textcoords="offset points",
                ha="center",
                fontsize=7.5,
                fontweight="bold" if is_mean else "normal",
            )
    axes.set_xticks(range(len(names)), names)
    axes.tick_params(axis="x", length=0, pad=14, labelsize=9)
    minor = [index + place for index in range(len(names)) for place in places]
    small = {"fontsize": 6.5, "color": GREY}
    axes.set_xticks(minor, [*marks] * len(names), minor=True, **small)
    axes.tick_params(axis="x", which="minor", length=0, pad=2)
    axes.set_ylabel("MTCD, code values of 8 bits")
    axes.margins(y=0.08)
    return figure


def _flicker_detail(study: Drawing) -> Figure:
    figure, axes = study.axes(
        8.0,
        5.6,
        "Flicker against lost detail: the best technique is low in both",
        "Large: mean over scenes, with 95 % intervals. Faint: each scene.",
    )
    shown = []
    for technique in study.techniques:
        cells = [study.rows[technique, scene] for scene in study.scenes]
        look: dict[str, Any] = {
            "color": study.colour[technique],
            "marker": study.marker[technique],
        }
        loss, mtcd = [_loss(row) for row in cells], [row.mean for row in cells]
        axes.scatter(loss, mtcd, s=14, alpha=0.3, lw=0, clip_on=False, **look)
        pooled = study.rows[technique, POOLED]
        if math.isfinite(pooled.mean + _loss(pooled)):
            shown.append(pooled)
            axes.errorbar(
                _loss(pooled),
                pooled.mean,
                xerr=np.nan_to_num(Z95 * pooled.others["detail_loss"].standard_error),
                yerr=np.nan_to_num(
                    [[pooled.mean - pooled.low], [pooled.high - pooled.mean]]
                ),
                ms=8,
                mec="white",
                lw=1.6,
                capsize=3,
                clip_on=False,
                zorder=5,
                **look,
            )
    every = study.rows.values()
    pooled = [row for row in every if row.scene == POOLED]
    symlog(axes, "x", [_loss(row) for row in pooled], [_loss(row) for row in every])
    symlog(axes, "y", [row.mean for row in pooled], [row.mean for row in every])
    axes.grid(color="#e6e6e6", lw=0.6)
    axes.set_axisbelow(True)
    axes.set_xlabel("detail loss: squared error to the reference, code values²")
    axes.set_ylabel("MTCD, code values of 8 bits")
    axes.annotate(
        "better",
        (0.03, 0.06),
        (0.11, 0.14),
        xycoords="axes fraction",
        textcoords="axes fraction",
        fontsize=9,
        color=GREY,
        arrowprops={"arrowstyle": "->", "color": GREY},
    )
    points = [
        (_loss(row), row.mean, study.label(name), study.colour[name])
        for name, row in ((row.technique, row) for row in shown)
    ]
    label_points(figure, axes, points)
    return figure


def _loss(row: SummaryRow) -> float:
    return row.others["detail_loss"].mean
