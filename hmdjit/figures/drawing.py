"""The style of all figures: colours, titles, scales, footers, names apart, files."""

import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator, Locator, NullLocator
from matplotlib.transforms import Bbox

from .._files import written_atomically

DPI = 150

GREY, SHADE, GRID = "#666666", "#f2f2f2", "#e6e6e6"
PAPER = {"facecolor": "white", "edgecolor": "none", "pad": 0.5}
# Okabe and Ito's colours, which people with colour-blindness can tell apart; Tol's wine
# stands for their yellow, too pale to read on white.
BLUE, VERMILLION, SKY = "#0072B2", "#D55E00", "#56B4E9"
COLOURS = [BLUE, VERMILLION, "#009E73", "#CC79A7", "#E69F00", SKY, "#882255"]
DASHES: list[Any] = ["-", (0, (5, 2)), (0, (1, 1.2)), (0, (6, 2, 1, 2)), (0, (3, 1.5))]

# Sizes of type, points: names of points, lines and rows, notes, numbers, small print.
NAME, LABEL, NOTE, NUMBER, FINE = 9.0, 8.5, 8.0, 7.5, 6.5
SMALL: dict[str, Any] = {"fontsize": NOTE, "color": GREY}

styled = matplotlib.rc_context(
    {
        "axes.axisbelow": True,
        "axes.spines.right": False,
        "axes.spines.top": False,
        "axes.titlelocation": "left",
        "axes.titlesize": 11,
        "axes.titleweight": "bold",
        "grid.color": GRID,
        "grid.linewidth": 0.6,
        "legend.fontsize": LABEL,
        "legend.frameon": False,
    }
)
"""Decorator of what draws figures: in this style, whatever is set elsewhere."""


def save(figure: Figure, path: Path, *, tight: bool = True) -> Path:
    """Save a figure as PNG, whole or not at all, and return its path.

    **Arguments:** `tight`: cut or widened to what is drawn; else as large as it says.
    """
    box = "tight" if tight else None
    with written_atomically(path) as unfinished:
        look: Any = {"dpi": DPI, "bbox_inches": box, "metadata": {"Software": None}}
        figure.savefig(unfinished, format="png", **look)
    return path


def panels(
    width: float,
    height: float,
    footer: str,
    rows: int = 1,
    columns: int = 1,
    **options: Any,
) -> tuple[Figure, np.ndarray]:
    """Return a figure, inches, with a footer below its edge, and its empty panels."""
    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    # The tight bounding box, with which figures are saved, takes the footer in.
    lines = textwrap.fill(footer, int(20 * width))
    figure.text(0.01, -0.02, lines, fontsize=FINE, color=GREY, va="top")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def errorbar(
    axes: Axes, x: float | Sequence[float], y: float | Sequence[float], **style: Any
) -> None:
    """Draw a point with its intervals: `x` and `y` are a value, or value, low, high."""
    for name, (value, *bounds) in {"x": np.ravel(x), "y": np.ravel(y)}.items():
        style[name] = value
        if bounds:
            spread = np.array([[value - bounds[0]], [bounds[1] - value]])
            style[f"{name}err"] = np.nan_to_num(spread).clip(0)
    axes.errorbar(**style)


def label_ticks(axis: Axis, locator: Locator, label: Any = "{x:g}") -> None:
    """Label an axis in plain numbers, without further ticks between them."""
    axis.set_major_locator(locator)
    axis.set_major_formatter(label)
    axis.set_minor_locator(NullLocator())


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
    high = 1.5 * max([*every, 10 * low])
    axis = getattr(axes, f"{name}axis")
    getattr(axes, f"set_{name}scale")("symlog", linthresh=low, linscale=0.4)
    axes.set(**{f"{name}lim": (0, high)})
    label_ticks(axis, FixedLocator([0.0, *ticks(low, high)]))


def label_points(
    figure: Figure,
    axes: Axes,
    points: list[tuple[float, float, str, str]],
    fontsize: float = NAME,
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
