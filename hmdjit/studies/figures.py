"""Figures of a study: distributions, ratios, Kim's Figure 3, flicker against detail."""

import math
import os
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator
from matplotlib.transforms import Bbox

from .results import GEOMETRIC_MEAN, POOLED, SummaryRow, written_atomically

if TYPE_CHECKING:
    import xarray

KIM_RATIO = 0.56
"""Kim et al.: MTCD of their head-movement based filter, as a share of the original."""

_DPI = 150
_Z95 = 1.959964
_GREY = "#666666"
_PAPER = {"facecolor": "white", "edgecolor": "none", "pad": 0.5}
# Okabe and Ito's colours, which people with colour-blindness can tell apart; black is
# the baseline's, and their yellow, too pale for lines on white, comes last.
_COLOURS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#F0E442"]
_DASHES = ["-", (0, (5, 2)), (0, (1, 1.2))]
_MARKERS = ["o", "s", "D", "^", "v", "P", "X"]


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
    drawings: dict[str, Callable[[_Study], Figure]] = {
        "distributions.png": _distributions,
        "ratios.png": _ratios,
        "figure3.png": _figure3,
        "flicker_detail.png": _flicker_detail,
    }
    study, paths = _Study(dataset, rows), []
    for name, draw in drawings.items():
        figure = draw(study)
        with written_atomically(Path(folder) / name) as unfinished:
            figure.savefig(
                unfinished,
                format="png",
                dpi=_DPI,
                bbox_inches="tight",
                metadata={"Software": None},
            )
        paths.append(Path(folder) / name)
    return paths


def footer(dataset: "xarray.Dataset") -> str:
    """Say what a picture of this study depends on, in two or three sentences."""
    a = dataset.attrs
    words = [
        f"Camera {a.get('width_px')} × {a.get('height_px')} px, "
        f"{_number(a, 'fov_deg')}° wide, {_number(a, 'refresh_hz')} Hz: "
        f"{_number(a, 'px_per_deg_centre')} px/deg in the centre, "
        f"{_number(a, 'px_per_deg_side')} at the side, "
        f"{_number(a, 'px_per_deg_mean')} on average; "
        f"{a.get('measure', 'unknown part')} measured.",
        f"Head: {textwrap.shorten(str(a.get('head', 'unknown')), 90)}.",
        f"{dataset.sizes['session']:,} sessions of {a.get('frames')} frames after "
        f"{a.get('warmup')} of warm-up, seed {a.get('seed')};",
        f"hmdjit {a.get('hmdjit_version')}, model {a.get('model_version')}, "
        f"config {str(a.get('config_hash'))[:8]}.",
    ]
    return " ".join(words)


def _number(attributes: dict, name: str) -> str:
    return f"{float(attributes[name]):.4g}" if name in attributes else "?"


class _Study:
    """What all figures read: arrays, rows by cell, and one look per technique."""

    def __init__(self, dataset: "xarray.Dataset", rows: Sequence[SummaryRow]):
        order = ("technique", "scene", "session")
        self.techniques = [str(t) for t in dataset["technique"].values]
        self.scenes = [str(s) for s in dataset["scene"].values]
        self.mtcd = dataset["mtcd"].transpose(*order).values.astype(float)
        self.rows = {(row.technique, row.scene): row for row in rows}
        self.baseline = str(dataset.attrs["baseline"])
        self.reference = str(dataset.attrs.get("reference", ""))
        self.clustered = "subject" in dataset.coords
        self.footer = footer(dataset)
        others = [t for t in self.techniques if t != self.baseline]
        count = len(_COLOURS)
        self.colour = {t: _COLOURS[i % count] for i, t in enumerate(others)}
        self.dashes = {t: _DASHES[i // count % 3] for i, t in enumerate(others)}
        self.marker = {
            t: _MARKERS[(i + i // count) % count] for i, t in enumerate(others)
        }
        self.colour[self.baseline] = "black"
        self.dashes[self.baseline] = "-"
        self.marker[self.baseline] = "o"

    def label(self, technique: str) -> str:
        role = {self.reference: " (reference)", self.baseline: " (baseline)"}
        return technique + role.get(technique, "")

    def axes(
        self, width: float, height: float, title: str, subtitle: str = ""
    ) -> tuple[Figure, Axes]:
        """Return an empty figure, inches, with its titles and footer."""
        figure = Figure(figsize=(width, height), dpi=_DPI, layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.add_subplot()
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_title(title, loc="left", fontsize=11, fontweight="bold", pad=22)
        place = {"xycoords": "axes fraction", "textcoords": "offset points"}
        small = {"fontsize": 8, "color": _GREY, "va": "bottom"}
        axes.annotate(subtitle, (0, 1), (0, 6), **place, **small)
        lines = textwrap.fill(self.footer, int(20 * width))
        # Below the figure's edge: the tight bounding box takes it in.
        figure.text(0.01, -0.02, lines, fontsize=6.5, color=_GREY, va="top")
        return figure, axes


def _distributions(study: _Study) -> Figure:
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
    ticks = _ticks(low, high)
    axes.xaxis.set_major_locator(FixedLocator([zero] * has_zeros + ticks))
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
        axes.text(gap, 0, "//", transform=place, bbox=_PAPER, zorder=10, **look)
    axes.axhline(0.5, color=_GREY, lw=0.6, ls=":")
    axes.set_xlabel("MTCD of a session, code values of 8 bits (logarithmic)")
    axes.set_ylabel("sessions that flicker at most this much")
    figure.legend(loc="outside right", frameon=False, fontsize=8.5, labelspacing=0.9)
    return figure


def _ratios(study: _Study) -> Figure:
    others = [t for t in study.techniques if t != study.baseline]
    flicker = lambda s: study.rows[study.baseline, s].mean
    scenes = sorted(study.scenes, key=lambda s: -np.nan_to_num(flicker(s)))
    lines = [POOLED, GEOMETRIC_MEAN, *scenes]
    pitch = max(0.3, 0.07 * len(others) + 0.06)
    # The headline's row is tall enough to write each technique's number beside it.
    tall = max(1.4, 0.15 * (len(others) + 1) / pitch)
    place = np.array([0, tall / 2 + 0.5, *(np.arange(len(scenes)) + tall / 2 + 1.8)])
    figure, axes = study.axes(
        8.5,
        1.6 + pitch * (tall + len(lines)),
        f"How much flicker is left: MTCD as a share of {study.baseline}'s",
    )
    axes.axhspan(-tall / 2, tall / 2 + 1, color="#f0f0f0", lw=0, zorder=0)
    for y in place[2:]:
        axes.axhline(y, color="#eeeeee", lw=0.8, zorder=0)
    room = np.array([tall - 0.4, *[0.6] * (len(lines) - 1)])
    reach = 1.1
    for index, technique in enumerate(others):
        cells = [study.rows[technique, line] for line in lines]
        dodge = room * ((index + 0.5) / len(others) - 0.5)
        points = [
            (row.ratio, y, row.ratio - row.ratio_low, row.ratio_high - row.ratio)
            for row, y in zip(cells, place + dodge, strict=True)
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
            label=study.label(technique),
            clip_on=False,
            zorder=4,
        )
        headline = cells[0]
        if math.isfinite(headline.ratio):
            axes.annotate(
                f"{headline.ratio:.3f}  [{headline.ratio_low:.3f}, "
                f"{headline.ratio_high:.3f}]",
                (np.nanmax([headline.ratio, headline.ratio_high]), dodge[0]),
                (6, 0),
                textcoords="offset points",
                va="center",
                fontsize=7.5,
                color=study.colour[technique],
                bbox=_PAPER | {"facecolor": "#f0f0f0"},
                zorder=3,
            )
    for line, y in zip(lines, place, strict=True):
        cells = [study.rows[technique, line] for technique in others]
        if cells and not any(math.isfinite(row.ratio) for row in cells):
            note = cells[0].note
            look = {"color": _GREY, "fontsize": 8, "ha": "center", "va": "center"}
            axes.text(0.3, y, note, bbox=_PAPER, **look)
    axes.axvline(1, color="black", lw=1.2, zorder=1)
    head = f"{study.baseline} = 1"
    above = {"transform": axes.get_xaxis_transform(), "ha": "center", "va": "bottom"}
    axes.text(1, 1.005, head, fontsize=8, **above)
    if any(technique.startswith("head_movement") for technique in others):
        axes.axvline(KIM_RATIO, color=_GREY, lw=1.2, ls="--", zorder=1)
        kim = f"Kim et al.: {KIM_RATIO}"
        axes.text(KIM_RATIO, 1.005, kim, fontsize=8, color=_GREY, **above)
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
    if others:
        figure.legend(loc="outside right", frameon=False, fontsize=8.5)
    return figure


def _figure3(study: _Study) -> Figure:
    count = len(study.techniques)
    figure, axes = study.axes(
        max(7.0, 1.35 * count + 1),
        4.4,
        "Largest, mean and smallest flicker over all scenes and sessions",
        "The largest and the smallest lie further apart the more sessions there are.",
    )
    # Else the small label of the mean gives way to the technique's name below it.
    axes.xaxis.remove_overlapping_locs = False
    minor, names = [], []
    for index, technique in enumerate(study.techniques):
        values = study.mtcd[index]
        values = values[np.isfinite(values)]
        colour = study.colour[technique]
        reduce = [("max", np.max, 0.45), ("mean", np.mean, 1.0), ("min", np.min, 0.45)]
        for place, (name, function, alpha) in zip((-0.27, 0, 0.27), reduce, strict=True):
            minor.append(index + place)
            names.append(name)
            if not values.size:
                continue
            height = float(function(values))
            axes.bar(index + place, height, 0.25, color=colour, alpha=alpha)
            axes.annotate(
                f"{height:.0f}" if height >= 10 else f"{round(height, 3):.2g}",
                (index + place, height),
                xytext=(0, 2),
                textcoords="offset points",
                ha="center",
                fontsize=7.5,
                fontweight="bold" if name == "mean" else "normal",
            )
        if not values.size:
            axes.text(index, 0, "no session", fontsize=8, color=_GREY, ha="center", va="bottom")
    axes.set_xticks(range(count), [study.label(t).replace(" ", "\n") for t in study.techniques])
    axes.tick_params(axis="x", length=0, pad=14, labelsize=9)
    axes.set_xticks(minor, names, minor=True, fontsize=6.5, color=_GREY)
    axes.tick_params(axis="x", which="minor", length=0, pad=2)
    axes.set_ylabel("MTCD, code values of 8 bits")
    axes.margins(y=0.08)
    return figure


def _flicker_detail(study: _Study) -> Figure:
    figure, axes = study.axes(
        8.0,
        5.6,
        "Flicker against lost detail: less of one must not cost more of the other",
        "Large: mean over scenes, with 95 % intervals. Faint: each scene.",
    )
    shown = []
    for technique in study.techniques:
        cells = [study.rows[technique, scene] for scene in study.scenes]
        look = {"color": study.colour[technique], "marker": study.marker[technique]}
        loss, mtcd = [r.detail_loss for r in cells], [r.mean for r in cells]
        axes.scatter(loss, mtcd, s=14, alpha=0.3, lw=0, clip_on=False, **look)
        pooled = study.rows[technique, POOLED]
        if math.isfinite(pooled.mean) and math.isfinite(pooled.detail_loss):
            shown.append(pooled)
            axes.errorbar(
                pooled.detail_loss,
                pooled.mean,
                xerr=np.nan_to_num(_Z95 * pooled.detail_loss_standard_error),
                yerr=np.nan_to_num([[pooled.mean - pooled.low], [pooled.high - pooled.mean]]),
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
    _symlog(axes, "x", [[r.detail_loss for r in group] for group in (pooled, every)])
    _symlog(axes, "y", [[r.mean for r in group] for group in (pooled, every)])
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
        color=_GREY,
        arrowprops={"arrowstyle": "->", "color": _GREY},
    )
    _label_points(figure, axes, [(r.detail_loss, r.mean, r.technique) for r in shown], study)
    return figure


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers in a logarithmic range, few enough to label."""
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    steps = [1, 2, 5] if last - first <= 3 else [1]
    ticks = [step * 10.0**power for power in range(first, last + 1) for step in steps]
    return [tick for tick in ticks if low <= tick <= high]


def _symlog(axes: Axes, name: str, groups: Sequence[Sequence[float]]) -> None:
    """Scale one axis logarithmically where the pooled values lie, with 0 on it.

    **Arguments:** `groups`: the pooled values, and all.
    """
    pooled, every = ([v for v in values if v > 0] for values in groups)
    low = 10.0 ** math.floor(math.log10(min(pooled, default=1.0) / 4))
    high = max([*every, 10 * low])
    set_scale = axes.set_xscale if name == "x" else axes.set_yscale
    set_limits = axes.set_xlim if name == "x" else axes.set_ylim
    set_scale("symlog", linthresh=low, linscale=0.4)
    set_limits(0, high * 1.5)
    axis = axes.xaxis if name == "x" else axes.yaxis
    axis.set_major_locator(FixedLocator([0.0, *_ticks(low, high * 1.5)]))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())


def _label_points(
    figure: Figure, axes: Axes, points: list[tuple[float, float, str]], study: _Study
) -> None:
    """Write each point's name beside it, where it covers no other name or point."""
    figure.draw_without_rendering()
    renderer = FigureCanvasAgg(figure).get_renderer()
    to_pixels = axes.transData.transform
    unit = _DPI / 72
    where = [np.asarray(to_pixels((x, y))) for x, y, _ in points]
    taken = [Bbox.from_bounds(*(p - 7 * unit), 14 * unit, 14 * unit) for p in where]
    for (x, y, technique), own in zip(points, where, strict=True):
        for distance, turn in _PLACES:
            shift = distance * np.array([math.cos(turn), math.sin(turn)])
            side = "left" if shift[0] > 1 else "right" if shift[0] < -1 else "center"
            text = axes.annotate(
                study.label(technique),
                (x, y),
                xytext=tuple(shift),
                textcoords="offset points",
                ha=side,
                va="center",
                fontsize=9,
                fontweight="bold",
                color=study.colour[technique],
                arrowprops={"arrowstyle": "-", "lw": 0.6, "color": _GREY}
                if distance > 15
                else None,
                zorder=6,
            )
            # An annotation's own extent holds its leader too: only words must be free.
            text.update_positions(renderer)
            words = Text.get_window_extent(text, renderer)
            inside = axes.bbox.x0 < words.x0 and words.x1 < figure.bbox.x1
            inside &= axes.bbox.y0 < words.y0 and words.y1 < axes.bbox.y1
            if inside and not any(words.overlaps(box) for box in taken):
                break
            text.remove()
        else:
            text = axes.annotate(study.label(technique), (x, y), fontsize=9)
            words = text.get_window_extent()
        taken.append(words)


_PLACES = [
    (distance, math.radians(turn))
    for distance in (10, 18, 30, 45, 65)
    for turn in (0, 180, 90, -90, 35, -35, 145, -145, 65, -65, 115, -115)
]
