"""The picture of a paper's claims: what was measured, and which verdicts follow."""

import textwrap
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..reproductions.claims import FAILS, HOLDS, UNTOLD, Found
from ..studies.identity import made_by
from . import drawing

_FILL = {HOLDS: "#cfe8df", FAILS: "#f6d9c6", UNTOLD: "#ececec"}
_MARKERS = ("o", "s", "D", "^")


@drawing.styled
def draw(found: Found) -> Figure:
    """Draw what was measured on the left, and each claim's verdicts on the right.

    Left is the paper's own question; on the right it is the first row of each claim's
    column, and what other measures say of it lies below.
    """
    names = {row.condition for row in found.measured}
    sides = [max(3.75, 0.8 * len(names)), 2.45 * len(found.asked)]
    height = max(4.0, 1.6 + 0.62 * len(found.measures))
    footer = f"{found.about} {made_by()}."
    figure, ((left, right),) = drawing.panels(
        sum(sides), height, footer, columns=2, width_ratios=sides
    )
    _means(left, found)
    _matrix(right, found)
    return figure


def _means(axes: Axes, found: Found) -> None:
    first = [row for row in found.measured if row.measure == found.measures[0]]
    names = list(dict.fromkeys(row.condition for row in first))
    for k, case in enumerate(found.cases):
        rows = {row.condition: row for row in first if row.case == case}
        for place, name in enumerate(names):
            row = rows[name]
            drawing.errorbar(
                axes,
                place + 0.24 * (k - (len(found.cases) - 1) / 2),
                (row.value, row.low, row.high),
                color=drawing.COLOURS[k],
                marker=_MARKERS[k % len(_MARKERS)],
                linestyle="none",
                capsize=2.5,
                label=case if place == 0 else None,
            )
    ticks = [textwrap.fill(name, 10) for name in names]
    lines = 1 + max(tick.count("\n") for tick in ticks)
    axes.set_xticks(range(len(names)), ticks, fontsize=drawing.LABEL)
    axes.set_xlim(-0.6, len(names) - 0.4)
    axes.set_ylim(bottom=0)
    axes.grid(axis="y")
    axes.set_ylabel(textwrap.fill(f"{first[0].measure}, {first[0].unit}", 34))
    axes.set_title("What was measured")
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.04 - 0.065 * lines), ncols=4
    )


def _matrix(axes: Axes, found: Found) -> None:
    claims = list(dict.fromkeys(claim.claim for claim in found.claims))
    for claim in found.claims:
        x, y = claims.index(claim.claim), found.measures.index(claim.measure)
        axes.fill(
            [x - 0.48, x + 0.48, x + 0.48, x - 0.48],
            [y - 0.46, y - 0.46, y + 0.46, y + 0.46],
            color=_FILL[claim.verdict],
            lw=0,
        )
        weight = "bold" if claim in found.asked else "normal"
        middle: Any = {"ha": "center", "va": "center"}
        axes.text(
            x, y - 0.17, claim.verdict, fontsize=drawing.NAME, weight=weight, **middle
        )
        numbers = f"{claim.value:.3g} [{claim.low:.3g}, {claim.high:.3g}]"
        axes.text(x, y + 0.2, numbers, fontsize=drawing.NUMBER, **middle)
    asked = {claim.claim: claim.quantity for claim in found.asked}
    heads = [
        textwrap.fill(f"{k}. {claim}", 30)
        + "\n"
        + textwrap.fill(f"({asked[claim]})", 32)
        for k, claim in enumerate(claims, 1)
    ]
    axes.xaxis.tick_top()
    axes.set_xticks(range(len(claims)), heads, fontsize=drawing.LABEL)
    units = {claim.measure: claim.unit for claim in found.claims}
    names = [f"{name},\n{units[name]}".rstrip(",\n") for name in found.measures]
    axes.set_yticks(range(len(names)), names, fontsize=drawing.LABEL)
    axes.tick_params(length=0)
    axes.set_xlim(-0.5, len(claims) - 0.5)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.spines[:].set_visible(False)
    axes.set_title("What it says of the paper's claims, by each measure", pad=10)
