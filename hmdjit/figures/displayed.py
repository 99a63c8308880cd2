"""Figures of displayed frames: where they flicker, how fast, how fine; and the head."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator

from ..head_motion.parameters import AXES
from . import drawing

Numbers = Float[np.ndarray, " _"]
Style = Mapping[str, tuple[str, Any, str]]


@drawing.styled
def flicker_maps(
    pictures: Mapping[str, Float[np.ndarray, "_ _ 3"]],
    maps: Mapping[str, Float[np.ndarray, "_ _"]],
    footer: str,
) -> Figure:
    """Show what each technique displays, and each pixel's MTCD, on one scale."""
    columns = min(5, len(maps))
    rows = -(-len(maps) // columns)
    height, width = next(iter(maps.values())).shape
    tall = rows * (0.5 + 4.2 * height / width)
    figure, panels = drawing.panels(
        2.2 * columns + 0.8, tall, footer, 2 * rows, columns
    )
    most = max(0.1, *(np.quantile(one, 0.995) for one in maps.values()))
    shown: Any = None
    for axes in panels.flat:
        axes.set_axis_off()
    for k, (name, flicker) in enumerate(maps.items()):
        row, column = divmod(k, columns)
        picture, below = panels[2 * row, column], panels[2 * row + 1, column]
        picture.imshow(pictures[name], interpolation="nearest")
        picture.set_title(name, fontsize=drawing.NAME)
        shown = below.imshow(
            flicker, cmap="magma", vmin=0, vmax=most, interpolation="nearest"
        )
        mean = f"mean {flicker.mean():.3g}"
        below.set_title(mean, fontsize=drawing.NOTE, fontweight="normal")
    bar = figure.colorbar(shown, ax=panels, shrink=0.5, aspect=30)
    bar.set_label("MTCD of a pixel, code values of 8 bits", fontsize=drawing.LABEL)
    return figure


@drawing.styled
def spectra(
    temporal: Mapping[str, tuple[Numbers, Numbers]],
    octaves: Mapping[str, tuple[Numbers, Numbers]],
    style: Style,
    footer: str,
) -> Figure:
    """Draw how fast, Hz, and how fine, cycles per degree, what is displayed changes."""
    figure, ((left, right),) = drawing.panels(10.5, 4.4, footer, columns=2)
    for name, (hz, density) in temporal.items():
        colour, dashes, _ = style[name]
        left.plot(hz, _positive(density), color=colour, ls=dashes, label=name, lw=1.6)
    finest = max(len(change) for _, change in octaves.values())
    for name, (_, change) in octaves.items():
        colour, dashes, marker = style[name]
        look = {"color": colour, "ls": dashes, "marker": marker, "ms": 4, "lw": 1.4}
        right.plot(np.arange(finest), change, clip_on=False, **look)
    edges = next(iter(octaves.values()))[0]
    right.set_xticks(range(finest), band_names(edges), rotation=30, ha="right")
    left.set(xscale="log", yscale="log")
    right.set_ylim(bottom=0)
    hz = next(iter(temporal.values()))[0]
    marks = FixedLocator(drawing.ticks(hz[0], hz[-1]))
    drawing.label_ticks(left.xaxis, marks)
    left.set_title("How fast it changes")
    left.set_xlabel("temporal frequency, Hz")
    left.set_ylabel("spectrum of a pixel, code values²/Hz")
    right.set_title("How fine what changes is")
    right.set_xlabel("spatial frequency, cycles per degree")
    right.set_ylabel("RMS change per frame, code values")
    for axes in (left, right):
        axes.grid()
    _legend(figure)
    return figure


def band_names(edges: Sequence[float] | Numbers) -> list[str]:
    """Name octaves of spatial frequency by their edges, cycles per degree."""
    names = [f"{a:.2g}–{b:.2g}" for a, b in itertools.pairwise(edges)]
    return [f"below {edges[1]:.2g}", *names[1:-1], f"above {edges[-2]:.2g}"]


@drawing.styled
def head(
    velocity: tuple[Numbers, Float[np.ndarray, "_ 3"]],
    px_per_frame: Numbers,
    wander: tuple[Numbers, Float[np.ndarray, "_ 3"]],
    footer: str,
) -> Figure:
    """Draw a study's heads: spectrum, turns per frame, and how far they wander.

    **Arguments:** `velocity`: Hz, and (deg/s)²/Hz of pitch, yaw and roll;
    `px_per_frame`: of every frame; `wander`: s, and 5, 50 and 95 % of sessions, deg.
    """
    figure, ((fast, far, wide),) = drawing.panels(11.0, 3.8, footer, columns=3)
    hz, density = velocity
    for k, axis in enumerate(AXES):
        look = {"color": drawing.COLOURS[k], "ls": drawing.DASHES[k], "lw": 1.6}
        fast.plot(hz, _positive(density[:, k]), label=axis, **look)
    fast.set(xscale="log", yscale="log")
    drawing.label_ticks(fast.xaxis, FixedLocator(drawing.ticks(hz[0], hz[-1])))
    fast.legend()
    fast.set_title("How heads turn")
    fast.set_xlabel("frequency, Hz")
    fast.set_ylabel("velocity spectrum, (deg/s)²/Hz")
    turns = np.sort(px_per_frame)
    far.plot(turns, (np.arange(len(turns)) + 1) / len(turns), color="black", lw=1.6)
    far.set_xlim(0, max(1e-6, float(np.quantile(turns, 0.99))))
    far.set_yticks(np.linspace(0, 1, 5), ["0", "25 %", "50 %", "75 %", "100 %"])
    far.set_title("How far the picture moves")
    far.set_xlabel("px per frame, in the centre")
    far.set_ylabel("frames that move at most this far")
    seconds, (low, middle, high) = wander[0], wander[1].T
    band = {"color": drawing.BLUE, "alpha": 0.25, "lw": 0, "label": "5 to 95 %"}
    wide.fill_between(seconds, low, high, **band)
    wide.plot(seconds, middle, color=drawing.BLUE, lw=1.6, label="median session")
    wide.legend(loc="upper left")
    wide.set_title("How far heads wander")
    wide.set_xlabel("time, s")
    wide.set_ylabel("deg from where they began")
    for axes in (fast, far, wide):
        axes.grid()
    return figure


@drawing.styled
def by_frame(
    values: Mapping[str, Numbers], label: str, style: Style, footer: str
) -> Figure:
    """Draw a value of each frame, of each clip."""
    figure, ((axes,),) = drawing.panels(9.0, 3.6, footer)
    for name, each in values.items():
        colour, dashes, _ = style[name]
        look = {"color": colour, "ls": dashes, "lw": 1.4, "label": name}
        axes.plot(np.arange(len(each)) + 1, each, **look)
    axes.set_ylim(bottom=0)
    axes.set_xlabel("frame")
    axes.set_ylabel(label)
    axes.grid()
    _legend(figure)
    return figure


def _legend(figure: Figure) -> None:
    beside: Any = "outside right"  # missing from matplotlib's own types
    figure.legend(loc=beside)


def _positive(values: np.ndarray) -> np.ndarray:
    return np.where(values > 0, values, np.nan)
