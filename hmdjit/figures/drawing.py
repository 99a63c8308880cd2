"""What the figures of a study share: looks, titles, scales, labels apart."""

import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator
from matplotlib.transforms import Bbox

from .._files import written_atomically
from ..estimates.summary import SummaryRow

if TYPE_CHECKING:
    import xarray

DPI = 150

GREY = "#666666"
SHADE = "#f2f2f2"
PAPER = {"facecolor": "white", "edgecolor": "none", "pad": 0.5}
# Okabe and Ito's colours, which people with colour-blindness can tell apart; black is
# the baseline's, and Tol's wine stands for their yellow, too pale to read on white.
_COLOURS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#882255"]
_DASHES = ["-", (0, (5, 2)), (0, (1, 1.2))]
_MARKERS = ["o", "s", "D", "^", "v", "P", "X"]


def save(figure: Figure, path: Path, **options: Any) -> Path:
    """Save a figure as PNG, whole or not at all, and return its path."""
    with written_atomically(path) as unfinished:
        figure.savefig(
            unfinished, format="png", dpi=DPI, metadata={"Software": None}, **options
        )
    return path


def footer(dataset: "xarray.Dataset") -> str:
    """Say what a picture of this study depends on, in two or three sentences."""
    a, count = dataset.attrs, dataset.sizes["session"]
    sessions = f"{count:,} session" + "s" * (count != 1)
    if "slope" in dataset:  # a study with a goal runs as many as each scene needs
        sessions = f"Up to {sessions} per scene"
    words = [
        f"Camera {a.get('width_px')} × {a.get('height_px')} px, "
        f"{_number(a, 'fov_deg')}° wide, {_number(a, 'refresh_hz')} Hz: "
        f"{_number(a, 'px_per_deg_centre')} px/deg in the centre, "
        f"{_number(a, 'px_per_deg_side')} at the side, "
        f"{_number(a, 'px_per_deg_mean')} on average; "
        f"{a.get('measure', 'unknown part')} measured.",
        f"Head: {textwrap.shorten(str(a.get('head', 'unknown')), 90)}.",
        f"{sessions} of {a.get('frames')} frames after "
        f"{a.get('warmup')} of warm-up, seed {a.get('seed')};",
        f"hmdjit {a.get('hmdjit_version')}, model {a.get('model_version')}, "
        f"config {str(a.get('config_hash'))[:8]}.",
    ]
    return " ".join(words)


def _number(attributes: dict, name: str) -> str:
    return f"{float(attributes[name]):.4g}" if name in attributes else "?"


class Drawing:
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
        """Return the technique's id and its role in the study."""
        role = {self.reference: " (reference)", self.baseline: " (baseline)"}
        return technique + role.get(technique, "")

    def axes(
        self, width: float, height: float, title: str, subtitle: str = ""
    ) -> tuple[Figure, Axes]:
        """Return an empty figure, inches, with its titles and footer."""
        figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.add_subplot()
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_title(title, loc="left", fontsize=11, fontweight="bold", pad=22)
        place = {"xycoords": "axes fraction", "textcoords": "offset points"}
        small = {"fontsize": 8, "color": GREY, "va": "bottom"}
        axes.annotate(subtitle, (0, 1), (0, 6), **place, **small)
        lines = textwrap.fill(self.footer, int(20 * width))
        # Below the figure's edge: the tight bounding box takes it in.
        figure.text(0.01, -0.02, lines, fontsize=6.5, color=GREY, va="top")
        return figure, axes


def ticks(low: float, high: float) -> list[float]:
    """Return round numbers in a logarithmic range, few enough to label."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    found: list[float] = []
    for steps in ([1], [1, 2, 5], [1, 2, 3, 4, 5, 6, 8]):
        marks = [step * 10.0**power for power in powers for step in steps]
        found = [mark for mark in marks if low <= mark <= high]
        if len(found) >= 4:
            break
    return found


def symlog(
    axes: Axes, name: str, pooled: Sequence[float], every: Sequence[float]
) -> None:
    """Scale axis `name` logarithmically where the pooled values lie, with 0 on it."""
    pooled, every = ([v for v in values if v > 0] for values in (pooled, every))
    low = min(pooled, default=1.0) / 4
    power = 10.0 ** math.floor(math.log10(low))
    low = power * max(step for step in (1, 2, 5) if step * power <= low * (1 + 1e-9))
    high = max([*every, 10 * low])
    set_scale = axes.set_xscale if name == "x" else axes.set_yscale
    set_limits = axes.set_xlim if name == "x" else axes.set_ylim
    set_scale("symlog", linthresh=low, linscale=0.4)
    set_limits(0, high * 1.5)
    axis = axes.xaxis if name == "x" else axes.yaxis
    axis.set_major_locator(FixedLocator([0.0, *ticks(low, high * 1.5)]))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())


def label_points(
    figure: Figure,
    axes: Axes,
    points: list[tuple[float, float, str, str]],
    fontsize: float = 9,
) -> None:
    """Write each point's name beside it, where it covers no other name or point.

    **Arguments:** `points`: x, y, name and colour of each.
    """
    figure.draw_without_rendering()
    renderer = FigureCanvasAgg(figure).get_renderer()
    to_pixels = axes.transData.transform
    unit = DPI / 72
    where = [np.asarray(to_pixels((x, y))) for x, y, *_ in points]
    taken = [Bbox((point - 7 * unit, point + 7 * unit)) for point in where]
    for x, y, name, colour in points:
        for distance, turn in _PLACES:
            shift = distance * np.array([math.cos(turn), math.sin(turn)])
            side = "left" if shift[0] > 1 else "right" if shift[0] < -1 else "center"
            text = axes.annotate(
                name,
                (x, y),
                xytext=tuple(shift),
                textcoords="offset points",
                ha=side,
                va="center",
                fontsize=fontsize,
                fontweight="bold",
                color=colour,
                path_effects=[Stroke(linewidth=2.5, foreground="white"), Normal()],
                arrowprops={"arrowstyle": "-", "lw": 0.6, "color": GREY}
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
            text = axes.annotate(name, (x, y), fontsize=fontsize)
            words = text.get_window_extent()
        taken.append(words.padded(2 * unit))


_PLACES = [
    (distance, math.radians(turn))
    for distance in (10, 18, 30, 45, 65)
    for turn in (0, 180, 90, -90, 35, -35, 145, -145, 65, -65, 115, -115)
]
