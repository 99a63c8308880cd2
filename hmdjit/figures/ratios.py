"""Figure of a study: how much flicker each technique leaves, scene by scene."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..camera import Camera
from ..estimates.summary import GEOMETRIC_MEAN, POOLED, SummaryRow
from . import drawing
from .techniques import Compared

KIM_RATIO, KIM_CAMERA = 0.56, Camera()
"""Kim et al.: MTCD of their head-movement based filter, as a share of the original.

It depends on how many pixels a head's turns are: it is drawn beside ratios of the
camera that stands for theirs, the default one, alone.
"""


def draw_ratios(study: Compared) -> Figure:
    """Draw each technique's ratio to the baseline, over scenes and in each of them."""
    others = study.others
    flicker = lambda s: study.rows[study.baseline, s].mean
    scenes = sorted(study.scenes, key=lambda s: -np.nan_to_num(flicker(s)))
    lines = [POOLED, GEOMETRIC_MEAN, *scenes]
    pitch = max(0.3, 0.07 * len(others) + 0.06)
    # The headline's row is tall enough to write each technique's number beside it.
    tall = max(1.4, 0.15 * (len(others) + 1) / pitch)
    place = np.array([0, tall / 2 + 0.5, *(np.arange(len(scenes)) + tall / 2 + 1.8)])
    figure, axes = study.axes(
        8.0,
        1.6 + pitch * (tall + len(lines)),
        "How much flicker is left: " * study.is_flicker
        + f"{study.headline} as a share of {study.baseline}'s",
    )
    axes.axhspan(-tall / 2, tall / 2 + 1, color=drawing.SHADE, lw=0, zorder=0)
    for y in place[2:]:
        axes.axhline(y, color=drawing.GRID, lw=0.6, zorder=0)
    room = np.array([tall - 0.4, *[0.6] * (len(lines) - 1)])
    share = (np.arange(len(others)) + 0.5) / max(len(others), 1) - 0.5
    dodges = share[:, None] * room
    ends = [1.1]
    for technique, dodge in zip(others, dodges, strict=True):
        for line, y in zip(lines, place + dodge, strict=True):
            row = study.rows[technique, line]
            if math.isfinite(row.ratio):
                ends.append(1.05 * np.nanmax([row.ratio, row.ratio_high]))
                style = study.points(technique) | {"ms": 4.5, "lw": 1.2, "capsize": 2}
                ratio = (row.ratio, row.ratio_low, row.ratio_high)
                drawing.errorbar(
                    axes, ratio, float(y), clip_on=False, zorder=4, **style
                )
    reach = max(ends)
    for technique, y in zip(others, dodges[:, 0], strict=True):
        _name_headline(axes, study, study.rows[technique, POOLED], y, reach)
    for line, y in zip(lines, place, strict=True):
        cells = [study.rows[technique, line] for technique in others]
        if cells and not any(math.isfinite(row.ratio) for row in cells):
            style = {"ha": "center", "va": "center", "bbox": drawing.PAPER}
            axes.text(0.3, y, cells[0].note, **style, **drawing.SMALL)
    axes.axvline(1, color="black", lw=1.2, zorder=1)
    head = f"{study.baseline} = 1"
    above = {"transform": axes.get_xaxis_transform(), "ha": "center", "va": "bottom"}
    axes.text(1, 1.005, head, fontsize=drawing.NOTE, **above)
    is_kims = any(technique.startswith("head_movement") for technique in others)
    is_kims &= study.is_flicker and study.baseline.startswith(("none", "msaa"))
    if is_kims and study.camera == KIM_CAMERA:
        axes.axvline(KIM_RATIO, color=drawing.GREY, lw=1.2, ls="--", zorder=1)
        kim = f"Kim et al.: {KIM_RATIO}"
        axes.text(KIM_RATIO, 1.005, kim, **above, **drawing.SMALL)
    names = ["all scenes:\nratio of means", "all scenes:\ngeometric mean"]
    names += [f"{scene}  ({flicker(scene):.2g})" for scene in scenes]
    axes.set_yticks(place, names, fontsize=drawing.LABEL)
    axes.tick_params(axis="y", length=0)
    axes.set_xlim(0, reach)
    axes.set_ylim(place[-1] + 0.6, -tall / 2)
    axes.grid(axis="x")
    axes.set_xlabel(f"ratio of mean {study.headline}, with 95 % interval")
    unit = study.unit.replace(" of 8 bits", "")
    axes.set_ylabel(f"scene  ({study.headline} of {study.baseline}, {unit})")
    return figure


def _name_headline(
    axes: Axes, study: Compared, row: SummaryRow, y: float, reach: float
) -> None:
    """Write a technique's name and pooled ratio on the side that has room."""
    if not math.isfinite(row.ratio):
        return
    is_right = row.ratio < 0.5 * reach
    end = row.ratio_high if is_right else row.ratio_low
    bounds = f"  [{row.ratio_low:.3f}, {row.ratio_high:.3f}]"
    axes.annotate(
        f"{study.label(row.technique)}  {row.ratio:.3f}"
        + (bounds if math.isfinite(end) else ""),
        (end if math.isfinite(end) else row.ratio, y),
        (7 if is_right else -7, 0),
        textcoords="offset points",
        ha="left" if is_right else "right",
        va="center_baseline",
        fontsize=drawing.NOTE,
        fontweight="bold",
        color=study.style[row.technique][0],
        bbox=drawing.PAPER | {"facecolor": drawing.SHADE},
        zorder=3,
    )
