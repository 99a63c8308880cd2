"""Kim et al.'s figures, drawn anew: figure 3, figure 4, and the map of the ratio."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedLocator, NullLocator

from ..head_motion import HeadMotion
from ..reproductions.claims import Found
from ..reproductions.kim import CAMERA
from ..reproductions.kim_claims import PAPERS_RATIO
from ..reproductions.kim_map import Place, motion_of
from ..studies.identity import made_by
from . import drawing

_ZOOM_PX, _GAIN = 48, 4  # of what is magnified, and how much differences are


def draw(found: Found) -> dict[str, Figure]:
    """Return the figures by the names of their files."""
    footer = f"{found.about} {made_by()}."
    one = f"One person who fixates, the middle of a picture. {made_by()}."
    return {
        "figure_4": two_frames(found.pictures, one, across=len(found.pictures)),
        "map": _map(list(found.tables["map"]), footer),
    }


@drawing.styled
def two_frames(
    pictures: Mapping[str, Float[np.ndarray, "2 height width 3"]],
    footer: str,
    across: int = 1,
) -> Figure:
    """Show two consecutive frames by each condition, and how they differ.

    **Arguments:** `across`: conditions side by side.
    """
    rows = 2 * -(-len(pictures) // across)
    figure, panels = drawing.panels(
        6.9 * across, 2.5 * rows, footer, rows=rows, columns=3 * across
    )
    flicker = {}
    for k, (name, frames) in enumerate(pictures.items()):
        before, after = frames
        difference = np.abs(after - before)
        flicker[name] = 255 * np.sqrt((difference**2).sum(axis=-1)).mean()
        shown = {
            f"{name}: a frame": before,
            "the next one": after,
            f"difference x {_GAIN}": np.clip(_GAIN * difference, 0, 1),
        }
        size = np.array(frames.shape[1:3])
        side = min(_ZOOM_PX, *size)
        top, left = (size - side) // 2
        part = slice(top, top + side), slice(left, left + side)
        row, column = 2 * (k // across), 3 * (k % across)
        mine = panels[row : row + 2, column : column + 3].T
        for (title, picture), (whole, zoomed) in zip(shown.items(), mine, strict=True):
            whole.imshow(picture, interpolation="nearest")
            whole.set_title(title, fontsize=drawing.NAME)
            corner = (left - 0.5, top - 0.5)
            frame = {"fill": False, "ec": drawing.VERMILLION, "lw": 1.5}
            whole.add_patch(Rectangle(corner, side, side, **frame))
            zoomed.imshow(picture[part], interpolation="nearest")
            for axes in (whole, zoomed):
                axes.set(xticks=[], yticks=[])
                axes.spines[:].set_visible(True)
            zoomed.spines[:].set(color=drawing.VERMILLION, linewidth=1.5)
    said = ", ".join(f"{name} {mtcd:.1f}" for name, mtcd in flicker.items())
    figure.suptitle(
        "What flickers from a frame to the next, and the same magnified.\n"
        f"MTCD of this pair, code values: {said}",
        fontsize=11,
    )
    return figure


@drawing.styled
def _map(places: list[Place], footer: str) -> Figure:
    """Show the ratio over correlation and motion, 0.56 as a line."""
    kinds = list(dict.fromkeys((p.scene, p.refresh_hz, p.warmup) for p in places))
    columns = min(4, len(kinds))
    rows = -(-len(kinds) // columns)
    figure, panels = drawing.panels(
        1 + 3.6 * columns, 3.4 * rows, footer, rows, columns, sharex=True, sharey=True
    )
    for axes, kind in zip(panels.flat, kinds, strict=False):
        scene, rate_hz, warmup = kind
        here = [p for p in places if (p.scene, p.refresh_hz, p.warmup) == kind]
        _ratios(axes, here)
        axes.set_title(f"{scene}, {rate_hz:g} Hz, warm-up {warmup}", fontsize=9)
    figure.suptitle(
        "MTCD of head movement over no AA's depends on how smoothly a head turns\n"
        f"Orange: where it is the paper's {PAPERS_RATIO:g}. Cross: people who fixate",
        fontsize=10,
    )
    for axes in panels[-1]:
        axes.set_xlabel("px per frame and axis, RMS")
    for axes in panels[:, 0]:
        axes.set_ylabel("correlation of a frame's\nturn with the next")
    return figure


def _ratios(axes: Axes, places: list[Place]) -> None:
    across = sorted({p.px_per_frame for p in places})
    down = sorted({p.correlation for p in places})
    ratio = {(p.correlation, p.px_per_frame): p.ratio for p in places}
    grid = np.array([[ratio[rho, px] for px in across] for rho in down])
    axes.imshow(grid, cmap="viridis", vmin=0.4, vmax=1, origin="lower", aspect="auto")
    for (row, column), value in np.ndenumerate(grid):
        colour = "white" if value < 0.75 else "black"
        axes.text(
            column,
            row - 0.33,  # above it is room for the cross
            f"{value:.2f}",
            ha="center",
            va="center",
            fontsize=drawing.NUMBER,
            color=colour,
        )
    head = motion_of(HeadMotion.fixating(), CAMERA, places[0].refresh_hz)
    correlation, px = (
        np.interp(value, marks, range(len(marks)))
        for value, marks in zip(head, (down, across), strict=True)
    )
    axes.plot(px, correlation, "x", color="white", ms=9, mew=2.5)
    if grid.min() < PAPERS_RATIO < grid.max():
        axes.contour(grid, [PAPERS_RATIO], colors=drawing.VERMILLION, linewidths=2)
    for axis, marks in ((axes.xaxis, across), (axes.yaxis, down)):
        axis.set_major_locator(FixedLocator(range(len(marks))))
        axis.set_minor_locator(NullLocator())
        axis.set_ticklabels([f"{mark:g}" for mark in marks])
