"""The style of all figures: colours, titles, scales, footers, names apart, files."""

import contextlib
import io
import math
import textwrap
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator, Locator, NullLocator
from matplotlib.transforms import Bbox

from .._files import written_atomically
from ..studies.identity import made_by

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
        "text.parse_math": False,  # names of files and scenes may have a $
    }
)
"""Decorator of what draws figures: in this style, whatever is set elsewhere."""


def save(figure: Figure, path: Path, *, tight: bool = True) -> Path:
    """Save a figure, whole or not at all, and return its path: PNG, or SVG by name.

    The file says, as its `Source`, of which version and model it is.

    **Arguments:** `tight`: cut or widened to what is drawn; else as large as it says.
    """
    with written_atomically(path) as unfinished:
        _write(figure, unfinished, path.suffix[1:], tight)
    return path


def save_both(figure: Figure, path: Path) -> list[Path]:
    """Save a figure as PNG and as SVG, and return the paths."""
    return [save(figure, path.with_suffix(suffix)) for suffix in (".png", ".svg")]


def png(figure: Figure) -> bytes:
    """Return what a figure's PNG file would hold."""
    with io.BytesIO() as content:
        _write(figure, content, "png", True)
        return content.getvalue()


def _write(figure: Figure, file: Any, kind: str, tight: bool) -> None:
    about = {"Source": made_by()}
    about |= {"Date": None} if kind == "svg" else {"Software": None}
    look: Any = {"dpi": DPI, "bbox_inches": "tight" if tight else None}
    with quiet(), matplotlib.rc_context({"svg.hashsalt": made_by()}):
        figure.savefig(file, format=kind, metadata=about, **look)


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Draw boxes, without a warning, for letters of a name that the font lacks."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        yield


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
    """Write each point's name beside it, where it covers no other name, point or bar.

    Where none is free, it covers as little as it can.

    **Arguments:** `points`: x, y, name and colour of each.
    """
    with quiet():
        figure.draw_without_rendering()
    renderer = FigureCanvasAgg(figure).get_renderer()
    unit = DPI / 72
    where = [np.asarray(axes.transData.transform((x, y))) for x, y, *_ in points]
    marks = [Bbox((point - 7 * unit, point + 7 * unit)) for point in where]
    marks += [box.padded(3 * unit) for box in _drawn(axes)]
    words = [Text.get_window_extent(text, renderer) for text in axes.texts]
    look: dict[str, Any] = {"fontsize": fontsize, "fontweight": "bold", "va": "center"}
    for point, (x, y, name, colour) in zip(where, points, strict=True):
        sized = axes.text(x, y, name, **look)
        with quiet():
            size = np.asarray(Text.get_window_extent(sized, renderer).size)
        sized.remove()

        boxes = []
        for x_shift, y_shift, side in _PLACES:
            low = point + np.multiply((x_shift, y_shift), unit)
            low = low - size * ({"left": 0, "center": 0.5, "right": 1}[side], 0.5)
            boxes.append(Bbox((low, low + size)).padded(2 * unit))
        covered = [
            1000 * (not _is_inside(box, axes, figure))
            + 100 * sum(map(box.overlaps, words))
            + sum(map(box.overlaps, marks))
            for box in boxes
        ]
        best = int(np.argmin(covered))  # the first of them is the nearest
        words.append(boxes[best])
        x_shift, y_shift, side = _PLACES[best]
        axes.annotate(
            name,
            (x, y),
            xytext=(x_shift, y_shift),
            textcoords="offset points",
            ha=side,
            color=colour,
            path_effects=[Stroke(linewidth=2.5, foreground="white"), Normal()],
            arrowprops={"arrowstyle": "-", "lw": 0.6, "color": GREY}
            if math.hypot(x_shift, y_shift) > 15
            else None,
            zorder=6,
            **look,
        )


def _is_inside(box: Bbox, axes: Axes, figure: Figure) -> bool:
    """Whether a name lies in its panel, which it may leave at the right."""
    across = axes.bbox.x0 < box.x0 and box.x1 < figure.bbox.x1
    return bool(across and axes.bbox.y0 < box.y0 and box.y1 < axes.bbox.y1)


def _drawn(axes: Axes) -> Iterator[Bbox]:
    """Boxes of scattered points and of error bars, px."""
    for artist in axes.collections:
        places: Any = []
        if isinstance(artist, PathCollection):
            places = np.asarray(artist.get_offsets())[:, None]
        elif isinstance(artist, LineCollection):
            places = artist.get_segments()
        for one in places:
            found = axes.transData.transform(one)
            yield Bbox((found.min(axis=0), found.max(axis=0)))


def _place(distance: float, turn_deg: float) -> tuple[float, float, str]:
    """Offset of a name, points, and which side of it lies there."""
    turn = math.radians(turn_deg)
    x, y = distance * math.cos(turn), distance * math.sin(turn)
    return x, y, "left" if x > 1 else "right" if x < -1 else "center"


_PLACES = [
    _place(distance, turn_deg)
    for distance in (10.0, 18.0, 30.0, 45.0, 65.0)
    for turn_deg in (
        *(0.0, 180.0, 90.0, -90.0, 35.0, -35.0),
        *(145.0, -145.0, 65.0, -65.0, 115.0, -115.0),
    )
]
