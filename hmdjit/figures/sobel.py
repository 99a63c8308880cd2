"""The thesis' figures, drawn anew: pictures with their SSIM maps, and all errors."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .. import metrics
from ..reproductions.claims import Found
from ..reproductions.sobel_claims import NAMES, UNIT
from ..studies.identity import made_by
from . import drawing

_PICTURED = 5  # of the conditions
_SHOWN = ("pipe", "arched window", "flowers", "moving sphere")


def draw(found: Found) -> dict[str, Figure]:
    """Return the figures by the names of their files."""
    footer = f"{found.about} {made_by()}."
    return {"ssim_maps": _maps(found, footer), "errors": _errors(found, footer)}


@drawing.styled
def _maps(found: Found, footer: str) -> Figure:
    """Show what is seen by each condition, and where it is unlike the reference."""
    figure, panels = drawing.panels(
        2.1 * (_PICTURED + 1), 4.4 * len(_SHOWN), footer, 2 * len(_SHOWN), _PICTURED + 1
    )
    for k, case in enumerate(_SHOWN):
        *pictures, _, truth = np.asarray(found.pictures[case], np.float32)
        above, below = panels[2 * k], panels[2 * k + 1]
        _show(above[0], truth, f"{case}: reference")
        below[0].set_axis_off()
        for n in range(_PICTURED):
            alike = metrics.ssim_volume_map(pictures[n], truth, peak=1.0)
            alike = np.asarray(alike).mean(axis=-1)
            _show(above[n + 1], pictures[n], NAMES[n])
            _show(below[n + 1], alike.clip(0, 1), f"SSIM {alike.mean():.3f}")
    return figure


def _show(axes: Axes, picture: np.ndarray, title: str) -> None:
    axes.imshow(picture, cmap="gray", vmin=0, vmax=1, interpolation="nearest")
    axes.set_title(title, fontsize=drawing.LABEL)
    axes.set_axis_off()


@drawing.styled
def _errors(found: Found, footer: str) -> Figure:
    """Show the mean squared error of the five conditions, by table."""
    figure, ((axes,),) = drawing.panels(11.0, 4.6, footer)
    rows = [row for row in found.measured if row.measure.endswith(")")]
    cases = list(dict.fromkeys(row.case for row in rows))
    for n, name in enumerate(NAMES[:_PICTURED]):
        here = {row.case: row for row in rows if row.condition == name}
        for place, case in enumerate(cases):
            row = here[case]
            drawing.errorbar(
                axes,
                place + 0.13 * (n - (_PICTURED - 1) / 2),
                (row.value, row.low, row.high),
                color=drawing.COLOURS[n],
                marker="os^Dv"[n],
                linestyle="none",
                capsize=2,
                label=name if place == 0 else None,
            )
    tables = [row.measure.split(" (")[0] for row in rows if row.condition == NAMES[0]]
    heads = [
        f"{case.replace(' ', chr(10))}\n{t}"
        for case, t in zip(cases, tables, strict=True)
    ]
    axes.set_yscale("log")
    axes.set_xticks(range(len(cases)), heads, fontsize=drawing.LABEL)
    axes.set_ylabel(f"MSE to 128 renders, {UNIT}")
    axes.grid(axis="y")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.22), ncols=_PICTURED)
    return figure
