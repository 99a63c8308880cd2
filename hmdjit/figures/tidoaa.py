"""TIDOAA's figure, drawn anew: error against the speed at which the camera turns."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator

from ..reproductions.claims import Found, Measured
from ..reproductions.tidoaa_claims import MEASURES, NAMES, REFERENCES
from ..studies.identity import made_by
from . import drawing

_PLAIN, _BASELINE, _OURS = NAMES[:3]
_LINES = {
    _PLAIN: drawing.GREY,
    _BASELINE: drawing.COLOURS[4],
    _OURS: drawing.BLUE,
    REFERENCES[0]: drawing.VERMILLION,
    REFERENCES[1]: drawing.COLOURS[2],
}
_HELD = ("MSAA, as in the paper", "MSAA's samples, each shaded")
_MARKERS = ("o", "s", "D", "^", "v")
_SLOW_DEG = 0.1  # per frame: below it speed is drawn to scale


def draw(found: Found) -> dict[str, Figure]:
    """Return the figure by the name of its file."""
    return {"error_by_speed": _by_speed(found)}


@drawing.styled
def _by_speed(found: Found) -> Figure:
    """Draw the error to both references, on one scale."""
    footer = f"Bars: 95 %. {found.about} {made_by()}."
    figure, (panels,) = drawing.panels(11.0, 4.9, footer, columns=2, sharey=True)
    for axes, measure, held in zip(panels, MEASURES, _HELD, strict=True):
        rows = [row for row in found.measured if row.measure == measure]
        _lines(axes, rows)
        axes.set_title(f"Held against {held}:\n{_finding(rows)}")
    panels[0].set_ylabel(f"mean squared error, {found.measured[0].unit}")
    panels[0].set_ylim(bottom=0)
    return figure


def _lines(axes: Axes, rows: list[Measured]) -> None:
    speeds = sorted({float(row.case) for row in rows})
    axes.set_xscale("symlog", linthresh=_SLOW_DEG, linscale=0.4)
    for k, (name, colour) in enumerate(_LINES.items()):
        of_speed = {float(row.case): row for row in rows if row.condition == name}
        if not of_speed:
            continue
        line = [of_speed[speed] for speed in speeds]
        values = [row.value for row in line]
        below = [max(row.value - row.low, 0) for row in line]
        above = [max(row.high - row.value, 0) for row in line]
        look = {"marker": _MARKERS[k], "ms": 5, "lw": 1.8}
        axes.errorbar(
            speeds,
            values,
            (below, above),
            color=colour,
            capsize=2.5,
            label=name,
            **look,
        )
    drawing.label_ticks(axes.xaxis, FixedLocator(speeds))
    axes.grid(axis="y")
    axes.set_xlabel("rotation speed, deg per frame")
    axes.legend(loc="upper left")


def _finding(rows: list[Measured]) -> str:
    """Say what share of the error without anti-aliasing is left."""
    speeds = {row.case for row in rows}
    error = {(row.condition, row.case): row.value for row in rows}

    def share(name: str) -> str:
        found = [100 * error[name, speed] / error[_PLAIN, speed] for speed in speeds]
        low, high = f"{min(found):.0f}", f"{max(found):.0f}"
        return f"{low} %" if low == high else f"{low} to {high} %"

    said = f"TIDOAA has {share(_OURS)} of no AA's error"
    is_of_msaa = any(name == REFERENCES[0] for name, _ in error)
    return f"{said}, MSAA {share(REFERENCES[0])}" if is_of_msaa else said
