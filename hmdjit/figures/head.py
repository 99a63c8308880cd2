"""One figure of what heads do: spectra, turns and speeds, recorded and modelled.

Velocities are raw frame differences: the tracker's noise is in all that is drawn.
"""

import math
import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogFormatter, PercentFormatter

from ..head_fitting import statistics
from ..head_fitting.spectra import Periodograms
from ..head_fitting.statistics import Description
from ..head_motion import HeadMotion, Trace
from ..head_motion.parameters import AXES
from ..studies.identity import counted
from .drawing import DPI, GREY, styled

# Okabe and Ito's blue, vermillion and green: lighter for models, darker for heads.
_LIGHT = dict(zip(AXES, ("#3D9BD5", "#F08A45", "#35B892"), strict=True))
_DARK = dict(zip(AXES, ("#00486F", "#8C3D00", "#00543D"), strict=True))
_SENSE = {"pitch": "nod", "yaw": "turn", "roll": "tilt"}
_MARKERS = dict(zip(AXES, "os^", strict=True))
_DASHED: dict[str, Any] = {"lw": 2, "ls": (0, (4, 1.5))}
_SOFT = {"alpha": 0.3, "lw": 0}
_PALE = "#858585"
_PLAIN: dict[str, Any] = {"fontsize": 10, "fontweight": "normal"}
_SPEEDS = {"median": 0.5, "95 %": 0.95}
_PERSONS = 1.645  # 90 % of persons lie within so many standard deviations
_BINS = 60
_TITLE = 110  # characters

_Spectrum = Float64[np.ndarray, "freqs 3"]


@styled
def draw(
    title: str,
    segments: Sequence[Trace],
    recorded: Description,
    head: HeadMotion | None = None,
    model: Description | None = None,
    *,
    word: str = "recorded",
) -> Figure:
    """Draw what still heads do, and what a model's do beside it.

    **Arguments:**

    - `title`: whose heads they are.
    - `segments`, `recorded`: still heads, and what they do.
    - `head`, `model`: a model, and what heads drawn from it do.
    - `word`: where the heads come from.

    **Errors:** `ValueError` for heads that never move.
    """
    if not recorded.speed_rms_deg_s:
        raise ValueError("heads must move to be drawn, but all their turns are 0.")
    figure = Figure(figsize=(11, 7.8), dpi=DPI, layout="constrained")
    plan = figure.add_gridspec(2, 1)
    upper: Any = plan[0].subgridspec(1, 3).subplots(sharex=True, sharey=True)
    lower: Any = plan[1].subgridspec(1, 2).subplots()
    periodograms = Periodograms.of(segments, recorded.rate_hz)
    _spectra(list(upper), periodograms, head)
    _structure(lower[0], recorded, head)
    _speeds(lower[1], recorded, model, word)
    for axes in figure.axes:
        axes.grid()
        axes.tick_params(labelsize=8.5)
    subjects = len(periodograms.subjects)
    about = (
        f"{counted(subjects, 'subject')}, {recorded.rate_hz:.4g} Hz, "
        f"{recorded.still_s:,.0f} s {'held still' if word == 'recorded' else word}"
    )
    left = {"x": 0.01, "ha": "left", "va": "top"}
    title = textwrap.shorten(title, _TITLE)
    figure.suptitle(title, y=0.99, fontsize=12, fontweight="bold", **left)
    figure.text(y=0.955, s=about, fontsize=9, color=GREY, **left)
    engine: Any = figure.get_layout_engine()
    engine.set(rect=(0, 0, 1, 0.93), hspace=0.03)
    handles = _legend(word, subjects > 1, head is not None)
    below: Any = "outside lower center"  # missing from matplotlib's own types
    figure.legend(handles=handles, loc=below, ncols=4, fontsize=9)
    return figure


def _spectra(
    panels: Sequence[Axes], periodograms: Periodograms, head: HeadMotion | None
) -> None:
    bins = _bins(periodograms.frequency_hz)
    frequency_hz = bins @ periodograms.frequency_hz
    mean = _positive(bins @ periodograms.power.mean(axis=0))
    subjects = [_positive(bins @ one) for one in periodograms.by_subject()]
    persons = None
    if head is not None:
        persons = [_positive(bins @ one) for one in _persons(head, periodograms)]
    for k, (axis, axes) in enumerate(zip(AXES, panels, strict=True)):
        if len(subjects) > 1:
            for one in subjects:
                axes.plot(frequency_hz, one[:, k], color=GREY, lw=0.5, alpha=0.45)
        axes.plot(frequency_hz, mean[:, k], color=_DARK[axis], lw=1.8)
        if persons is not None:
            low, middle, high = (spectrum[:, k] for spectrum in persons)
            axes.fill_between(frequency_hz, low, high, color=_LIGHT[axis], **_SOFT)
            axes.plot(frequency_hz, middle, color=_LIGHT[axis], **_DASHED)
        _logarithmic(axes)
        axes.set_title(f"{axis} ({_SENSE[axis]})", size=10, color=_DARK[axis])
        axes.set_xlabel("frequency, Hz")
    panels[0].set_ylabel("velocity spectrum, (deg/s)²/Hz")


def _bins(
    frequency_hz: Float64[np.ndarray, " freqs"],
) -> Float64[np.ndarray, "_ freqs"]:
    """Weights that average over logarithmic bins, those that hold a frequency."""
    edges = np.geomspace(frequency_hz[0], frequency_hz[-1], _BINS)
    held = np.searchsorted(edges, frequency_hz)
    is_in = (np.unique(held)[:, None] == held).astype(float)
    return is_in / is_in.sum(axis=1, keepdims=True)


def _persons(
    head: HeadMotion, periodograms: Periodograms
) -> tuple[_Spectrum, _Spectrum, _Spectrum]:
    """Spectra expected of calm persons (5 %), of all on average, of lively ones."""
    spread = math.exp(2 * _PERSONS * float(head.person_sd))
    low, mean, high = (
        statistics.expected_spectrum(head, periodograms, power)
        for power in (1 / spread, None, spread)
    )
    return low, mean, high


def _structure(axes: Axes, recorded: Description, head: HeadMotion | None) -> None:
    for k, axis in enumerate(AXES):
        points = {"color": _DARK[axis], "marker": _MARKERS[axis], "ms": 3.5, "lw": 0}
        turned = _positive(recorded.structure_deg2[:, k])
        axes.plot(recorded.lag_s, turned, label=axis, **points)
    if head is not None:
        lag_s = np.geomspace(recorded.lag_s[0], recorded.lag_s[-1], 200)
        turned = statistics.expected_structure(head, lag_s)
        for k, axis in enumerate(AXES):
            axes.plot(lag_s, _positive(turned[:, k]), color=_LIGHT[axis], **_DASHED)
    _logarithmic(axes)
    axes.set_title("how far heads turn within a time", **_PLAIN)
    axes.set_xlabel("lag, s")
    axes.set_ylabel("structure function, deg²")
    above: Any = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.98)}
    axes.legend(ncols=3, fontsize=9, columnspacing=1.2, **above)


def _speeds(
    axes: Axes, recorded: Description, model: Description | None, word: str
) -> None:
    heads: list[tuple[str, Description, dict[str, Any]]] = [
        (word, recorded, {"color": "black", "lw": 1.8})
    ]
    if model is not None:
        heads.append(("model", model, {"color": _PALE, **_DASHED}))
    shares = np.linspace(0, 1, len(recorded.speed_quantile_deg_s))
    for who, one, style in heads:
        axes.plot(one.speed_quantile_deg_s, shares, label=who, **style)
    for name, share in _SPEEDS.items():
        furthest = max(one.speed_quantile(share) for _, one, _ in heads)
        for line, (who, one, style) in enumerate(heads):
            speed = one.speed_quantile(share)
            axes.plot(speed, share, "o", color=style["color"], ms=5)
            axes.annotate(
                f"{name}: {speed:#.3g} deg/s, {who}",
                (furthest, share),
                (12, -5 - 13 * line),
                textcoords="offset points",
                color=style["color"],
                va="top",
                fontsize=9,
            )
    fastest = max(one.speed_quantile(0.95) for _, one, _ in heads)
    axes.set_xlim(0, 1.8 * fastest or 1.0)
    axes.set_ylim(0, 1.01)
    axes.yaxis.set_major_formatter(PercentFormatter(1))
    axes.set_title("how fast heads are", **_PLAIN)
    axes.set_xlabel("angular speed, deg/s")
    axes.set_ylabel("frames that are at most this fast")


def _positive(values: np.ndarray) -> np.ndarray:
    """Values as a logarithmic axis shows them: NaN for an axis that never moves."""
    return np.where(values > 0, values, np.nan)


def _logarithmic(axes: Axes) -> None:
    axes.set(xscale="log", yscale="log")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(LogFormatter())


def _legend(word: str, has_many: bool, has_model: bool) -> list[Line2D | Patch]:
    name = f"{word}, mean" if has_many else word
    handles: list[Line2D | Patch] = [Line2D([], [], color="black", lw=1.8, label=name)]
    if has_many:
        thin = {"color": GREY, "lw": 0.7, "alpha": 0.7}
        handles.append(Line2D([], [], label=f"{word}, each subject", **thin))
    if has_model:
        mean, persons = "model, mean over persons", "model, 5 to 95 % of its persons"
        handles.append(Line2D([], [], color=_PALE, label=mean, **_DASHED))
        handles.append(Patch(color=_PALE, label=persons, **_SOFT))
    return handles
