"""The picture of a trade-off: seconds against error, and the Pareto front in it."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from ..estimates.intervals import Z95
from ..studies.identity import camera_words, frames_words
from ..trade_off.settings import DEFAULT
from ..trade_off.trade_off import NEGLIGIBLE, Row, front_of
from . import drawing

_MONTE_CARLO = 0.01  # relative standard error to which seconds are counted
_FRONT, _DEFAULT, _OTHER = drawing.BLUE, drawing.VERMILLION, "#777777"
_NAME = "#4d4d4d"  # of the others, darker to be read
_MOST_CURVES = 6
_SESSIONS = 500  # of the default study, marked on the curves


@drawing.styled
def draw(rows: Sequence[Row]) -> Figure:
    """Draw a trade-off, two panels per technique whose knobs were turned.

    Left, one point per setting: seconds to a Monte Carlo standard error of 1 % against
    |bias|. Right, total error against seconds for the settings of the front.

    **Errors:** `ValueError` without a row that has flicker in its reference.
    """
    shown = [row for row in rows if row.reference_mtcd > 0 and row.knob != "samples"]
    usual = [row.technique for row in shown if row.knob == DEFAULT]
    techniques = list(dict.fromkeys(usual or [row.technique for row in shown]))
    if not techniques:
        raise ValueError("rows must hold a setting with flicker to be drawn, got none.")
    figure, axes = drawing.panels(
        13.0,
        5.2 * len(techniques),
        _footer(rows[0].identity),
        rows=len(techniques),
        columns=2,
        width_ratios=[1.45, 1],
    )
    for technique, (left, right) in zip(techniques, axes, strict=True):
        mine = [row for row in shown if row.technique == technique]
        _plane(left, mine)
        _curves(right, mine)
        left.set_title(f"{technique}: bias against time")
        right.set_title(f"total error against time; dots: {_SESSIONS} sessions")
    for technique, (left, right) in zip(techniques, axes, strict=True):
        _label(figure, left, right, [r for r in shown if r.technique == technique])
    return figure


def _footer(identity: dict[str, str]) -> str:
    return (
        f"Scene {identity['scene']}; camera {camera_words(identity)}; "
        f"{frames_words(identity)}. "
        "Reference: texture 4x, float64, homography. Bars: 95 % of the bias. "
        f"{machine_words(identity)}; hmdjit {identity['hmdjit_version']}, model "
        f"{identity['model_version']}, JAX {identity['jax_version']}. Time to run; "
        "compiling and baking apart."
    )


def machine_words(identity: dict[str, str]) -> str:
    """Say on what a trade-off was timed, and how busy it was."""
    return (
        "{device}, {cores} cores ({processor}), load ".format_map(identity)
        + f"{float(identity['load']):.2g} before"
    )


def _place(row: Row) -> tuple[float, float]:
    """Seconds, and |bias| in percent, not below what is negligible."""
    relative = max(abs(row.bias) / row.reference_mtcd, NEGLIGIBLE)
    return row.seconds_to(_MONTE_CARLO), 100 * relative


def _look(row: Row, front: Sequence[Row]) -> tuple[str, str, str]:
    """Colour, marker and name of what kind of point a row is."""
    if row in front:
        return _FRONT, "o", "on the Pareto front"
    if row.is_other_device:
        return _OTHER, "x", "another device, not an approximation"
    if row.bias_by == "frame mean":
        return _OTHER, "D", "not a sample of the frame's pixels"
    return _OTHER, "o", "behind the front"


def _plane(axes: Axes, rows: Sequence[Row]) -> None:
    front, floor = front_of(rows), 100 * NEGLIGIBLE
    for row in rows:
        seconds, bias = _place(row)
        if not np.isfinite(seconds):
            continue
        colour, marker, name = _look(row, front)
        spread = 100 * Z95 * row.bias_se / row.reference_mtcd
        is_front = row in front
        drawing.errorbar(
            axes,
            seconds,
            (bias, max(bias - spread, floor), bias + spread * (spread > floor)),
            color=colour,
            marker=marker,
            markersize=8 if is_front else 6,
            markerfacecolor=colour if is_front else "white",
            lw=0.9,
            alpha=1 if is_front else 0.85,
            zorder=4 if is_front else 3,
            label=name,
        )
    if len(front) > 1:
        places = np.array([_place(row) for row in front])
        axes.step(*places.T, where="post", color=_FRONT, lw=1.6, alpha=0.6, zorder=2)
    axes.set_xlabel("seconds to a Monte Carlo standard error of 1 % of MTCD")
    axes.set_ylabel("|bias| of MTCD, % of the reference")
    _logarithmic(axes)
    bottom, top = axes.get_ylim()
    axes.set_ylim(min(bottom, floor) / 2, top)
    axes.axhline(floor, color=drawing.GREY, lw=0.6, ls=(0, (2, 2)), zorder=1)
    axes.annotate(
        f"{floor:g} % or less",
        (1, floor),
        xycoords=("axes fraction", "data"),
        xytext=(-2, -3),
        textcoords="offset points",
        fontsize=drawing.NUMBER,
        color=drawing.GREY,
        va="top",
        ha="right",
    )
    handles, names = axes.get_legend_handles_labels()
    kinds = dict(zip(names, handles, strict=True))
    below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.13)}
    axes.legend(kinds.values(), kinds.keys(), ncols=2, **below)


def _shown_curves(rows: Sequence[Row]) -> list[Row]:
    front = front_of(rows)
    # Of a long front, what lies closest to its ends is drawn, and what is between.
    if len(front) > _MOST_CURVES:
        chosen = np.linspace(0, len(front) - 1, _MOST_CURVES).round().astype(int)
        front = [front[i] for i in chosen]
    usual = [row for row in rows if row.knob == DEFAULT and row not in front]
    return front + usual


def _curves(axes: Axes, rows: Sequence[Row]) -> None:
    curves = _shown_curves(rows)
    seconds = _seconds(curves)
    for i, row in enumerate(curves):
        errors = [100 * row.error(t) for t in seconds]
        colour = _DEFAULT if row.knob == DEFAULT else _FRONT
        dashes = drawing.DASHES[i % len(drawing.DASHES)]
        axes.plot(seconds, errors, color=colour, ls=dashes, lw=1.8)
        at = _SESSIONS * row.s_per_session
        axes.plot(at, 100 * row.error(at), "o", color="black", ms=4, zorder=5)
    if curves:
        axes.set_xlim(seconds[0], seconds[-1])
    axes.set_xlabel("seconds of running")
    axes.set_ylabel("error of MTCD: bias and Monte Carlo, RMS, %")
    _logarithmic(axes)


def _seconds(curves: Sequence[Row]) -> np.ndarray:
    """Span from a Monte Carlo error of 10 % at best to one of 0.3 % at worst."""
    fast = min((row.seconds_to(0.1) for row in curves), default=0.1)
    slow = max((row.seconds_to(0.003) for row in curves), default=100.0)
    return np.geomspace(fast, slow, 120)


def _logarithmic(axes: Axes) -> None:
    axes.set(xscale="log", yscale="log")
    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        subs = (1.0,) if high / low > 1000 else (1.0, 2.0, 5.0)
        drawing.label_ticks(axis, LogLocator(subs=subs))
    axes.grid()


def _label(figure: Figure, left: Axes, right: Axes, rows: Sequence[Row]) -> None:
    front = front_of(rows)
    ordered = [*front, *(row for row in rows if row not in front)]
    points = [
        (*_place(row), row.setting, _FRONT if row in front else _NAME)
        for row in ordered
        if np.isfinite(row.seconds_to(_MONTE_CARLO))
    ]
    drawing.label_points(figure, left, points, fontsize=drawing.NOTE)
    curves = _shown_curves(rows)
    seconds = _seconds(curves)
    # Each name stands on its curve, the flattest ones at the right.
    order = sorted(curves, key=lambda row: -abs(row.bias) / row.reference_mtcd)
    names = []
    for i, row in enumerate(order):
        share = 0.92 - 0.72 * i / max(1, len(order) - 1)
        at = float(seconds[int(share * (len(seconds) - 1))])
        colour = _DEFAULT if row.knob == DEFAULT else _FRONT
        names.append((at, 100 * row.error(at), row.setting, colour))
    drawing.label_points(figure, right, names, fontsize=drawing.NOTE)
