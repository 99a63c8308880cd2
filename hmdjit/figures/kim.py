"""Kim et al.'s figures, drawn anew: figure 3, figure 4, and the map of the ratio."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedLocator, NullLocator

from ..reproductions.claims import Found
from ..reproductions.kim_claims import PAPERS_RATIO
from ..reproductions.kim_map import Place
from ..studies.identity import made_by
from . import drawing

_ZOOM_PX, _GAIN = 48, 4  # of what is magnified, and how much differences are


def draw(found: Found) -> dict[str, Figure]:
    """Return the figures by the names of their files."""
    footer = f"{found.about} {made_by()}."
    return {
        "figure_4": two_frames(found.pictures, footer),
        "map": _map(list(found.tables["map"]), footer),
    }


@drawing.styled
def two_frames(
    pictures: Mapping[str, Float[np.ndarray, "2 height width 3"]], footer: str
) -> Figure:
    """Show two consecutive frames by each condition, and how they differ."""
    count = len(pictures)
    figure, panels = drawing.panels(7.2, 4.9 * count, footer, rows=2 * count, columns=3)
    for k, (name, frames) in enumerate(pictures.items()):
        before, after = frames
        difference = np.abs(after - before)
        mtcd = 255 * np.sqrt((difference**2).sum(axis=-1)).mean()
        shown = {
            f"{name}: a frame": before,
            "the next one": after,
            f"difference x {_GAIN}; MTCD {mtcd:.2f}": np.clip(_GAIN * difference, 0, 1),
        }
        size = np.array(frames.shape[1:3])
        side = min(_ZOOM_PX, *size)
        top, left = (size - side) // 2
        part = slice(top, top + side), slice(left, left + side)
        for column, (title, picture) in enumerate(shown.items()):
            whole, zoomed = panels[2 * k, column], panels[2 * k + 1, column]
            whole.imshow(picture, interpolation="nearest")
            whole.set_title(title, fontsize=drawing.NAME)
            corner = (left - 0.5, top - 0.5)
            frame = {"fill": False, "ec": drawing.VERMILLION, "lw": 1.2}
            whole.add_patch(Rectangle(corner, side, side, **frame))
            zoomed.imshow(picture[part], interpolation="nearest")
            for axes in (whole, zoomed):
                axes.set_axis_off()
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
        f"MTCD of head movement over no AA; the line is the paper's {PAPERS_RATIO:g}",
        fontsize=10,
    )
    for axes in panels[-1]:
        axes.set_xlabel("px per frame and axis, RMS")
    for axes in panels[:, 0]:
        axes.set_ylabel("correlation of a frame's turn with the next")
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
            row,
            f"{value:.2f}",
            ha="center",
            va="center",
            fontsize=drawing.NUMBER,
            color=colour,
        )
    if grid.min() < PAPERS_RATIO < grid.max():
        axes.contour(grid, [PAPERS_RATIO], colors=drawing.VERMILLION, linewidths=2)
    for axis, marks in ((axes.xaxis, across), (axes.yaxis, down)):
        axis.set_major_locator(FixedLocator(range(len(marks))))
        axis.set_minor_locator(NullLocator())
        axis.set_ticklabels([f"{mark:g}" for mark in marks])
