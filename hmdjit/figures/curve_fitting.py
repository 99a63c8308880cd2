"""Pictures of a fitted curve, and of the front that it is on."""

import textwrap
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from .. import blending
from .._types import Numbers
from ..curve_fitting.results import CurveFit, Kept
from ..curve_fitting.space import CurveSpace
from ..reports.curve_fitting import FITTED, KIM, gain_sentence
from ..techniques import HeadMovement
from .drawing import DPI, GREY, save, ticks

DIFFERENCES = (0.0, 0.2)
"""Colour differences at which weights are drawn, shares of the largest."""

_FITTED, _KIM, _FRONT, _OTHER = "#0072B2", "#D55E00", "#56B4E9", "black"
_NAME = "#2A7FB0"  # of the front, darker to be read
_LEVEL = 0.95
_STEPS = 201
_FASTEST_DEG_S = 60.0


def current_weight(
    technique: HeadMovement, speed_deg_s: Numbers, difference: Numbers
) -> Numbers:
    """Weight A of the current picture at a head speed and a colour difference.

    **Source:** Kim et al., equations (4) and (5).
    """
    minimum = blending.localized_minimum(
        technique.w_min, technique.w_lb, difference, technique.localization
    )
    ease = blending.ease(speed_deg_s, technique.h_max_deg_s, technique.ease)
    return blending.current_weight(minimum, ease)


@jax.jit
def _weights(
    space: CurveSpace,
    drawn: Float[Array, "draws names"],
    speeds_deg_s: Float[Array, " speeds"],
    difference: Numbers,
) -> Float[Array, "draws speeds"]:
    def one(numbers: Numbers) -> Float[Array, " speeds"]:
        technique = space.of_numbers(numbers)
        at = lambda speed: current_weight(technique, speed, difference)
        return jax.vmap(at)(speeds_deg_s)

    return jax.vmap(one)(drawn)


@jax.jit
def _minima(
    space: CurveSpace,
    drawn: Float[Array, "draws names"],
    differences: Float[Array, " differences"],
) -> Float[Array, "draws differences"]:
    def one(numbers: Numbers) -> Float[Array, " differences"]:
        technique = space.of_numbers(numbers)
        still = jnp.zeros((), numbers.dtype)
        at = lambda difference: current_weight(technique, still, difference)
        return jax.vmap(at)(differences)

    return jax.vmap(one)(drawn)


def write_curve(fit: CurveFit, path: Path, footer: str) -> Path:
    """Draw a fitted curve as a PNG file, written whole or not at all."""
    return save(draw_curve(fit, footer), path, bbox_inches="tight")


def write_front(fit: CurveFit, path: Path, footer: str) -> Path:
    """Draw a fit's front as a PNG file, written whole or not at all."""
    return save(draw_front(fit, footer), path, bbox_inches="tight")


def draw_curve(fit: CurveFit, footer: str) -> Figure:
    """Draw the weight of the current picture against head speed, beside Kim et al.'s.

    Where the localisation is free, the smallest weight against colour difference too.
    A band holds 95 % of the bootstrap's curves at each place.
    """
    is_local = fit.space.localization != "linear"
    figure, panels = _figure(6.8 + 4.4 * is_local, 4.6, 1 + is_local)
    drawn = jnp.asarray(fit.errors.drawn)
    kim = HeadMovement()
    fastest = max(float(fit.technique.h_max_deg_s), float(kim.h_max_deg_s))
    fastest = min(1.1 * fastest, _FASTEST_DEG_S)
    speeds = jnp.linspace(0, fastest, _STEPS, dtype=drawn.dtype)
    axes = panels[0]
    for difference, dashes in zip(DIFFERENCES, ("-", (0, (4, 2))), strict=True):
        at = jnp.asarray(difference, drawn.dtype)
        of = jax.vmap(current_weight, in_axes=(None, 0, None))
        where = f"colour difference {difference:g}"
        if difference == 0:
            _band(axes, speeds, _weights(fit.space, drawn, speeds, at))
        line = {"ls": dashes, "lw": 1.8}
        fitted = of(fit.technique, speeds, at)
        axes.plot(speeds, fitted, color=_FITTED, label=f"fitted, {where}", **line)
        kims = of(kim, speeds, at)
        axes.plot(speeds, kims, color=_KIM, label=f"Kim et al., {where}", **line)
    axes.set_xlabel("head speed, deg/s")
    axes.set_ylabel("weight of the current picture")
    _title(axes, "How much of the current picture is shown")
    if is_local:
        differences = jnp.linspace(0, 1, _STEPS, dtype=drawn.dtype)
        still = jnp.zeros((), drawn.dtype)
        of = jax.vmap(current_weight, in_axes=(None, None, 0))
        axes = panels[1]
        _band(axes, differences, _minima(fit.space, drawn, differences))
        fitted = of(fit.technique, still, differences)
        axes.plot(differences, fitted, color=_FITTED, lw=1.8, label="fitted")
        axes.plot(
            differences,
            of(kim, still, differences),
            color=_KIM,
            lw=1.8,
            label="Kim et al.",
        )
        axes.set_xlabel("colour difference, share of the largest")
        axes.set_ylabel("weight while the head is still")
        _title(axes, "Its minimum where pictures differ")
    for axes in panels:
        axes.set_ylim(0, 1.02)
        axes.margins(x=0)
        axes.legend(frameon=False, fontsize=8.5)
    bands = (
        f"Band: {100 * _LEVEL:g} % of a bootstrap over sessions, where colours do not "
        "differ."
    )
    _footer(figure, f"{bands} {footer}")
    return figure


def _band(axes: Axes, x: Array, curves: Array) -> None:
    low, high = np.quantile(curves, [(1 - _LEVEL) / 2, (1 + _LEVEL) / 2], axis=0)
    axes.fill_between(x, low, high, color=_FITTED, alpha=0.18, lw=0)


def draw_front(fit: CurveFit, footer: str) -> Figure:
    """Draw flicker against detail loss: the family's front, and what lies about it.

    SSAA, which loses no detail, stands at the left edge; freeze is told in words.
    """
    figure, (axes,) = _figure(7.2, 5.0, 1)
    front = [*(point.kept for point in fit.front), fit.kept[FITTED]]
    front.sort(key=_detail)
    places = np.array([_place(kept) for kept in front])
    axes.plot(*places.T, color=_FRONT, lw=1.8, zorder=2)
    for kept in front:
        _point(axes, kept, _FRONT, "o")
    for name, label, colour, marker, side in (
        ("none", "no anti-aliasing", _OTHER, "s", 1),
        (KIM, "Kim et al.", _KIM, "D", 1),
        (FITTED, "fitted", _FITTED, "o", -1),
    ):
        _point(axes, fit.kept[name], colour, marker, size=7)
        _name(axes, _place(fit.kept[name]), label, colour, side)
    _name(axes, _place(front[-1]), f"front of the family {fit.space.family}", _NAME, -1)

    shown = [*front, fit.kept["none"], fit.kept[KIM]]
    flickers, losses = zip(*(kept.intervals() for kept in shown), strict=True)
    low = max(min(x.low for x in losses), min(x.value for x in losses) / 2) / 1.15
    high = max(x.high for x in losses) * 1.05
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    axes.xaxis.set_major_locator(FixedLocator(ticks(low, high)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_ylim(0, 1.12 * max(y.high for y in flickers))
    ssaa = fit.kept["ssaa4"].intervals()[0]
    edge = low * (high / low) ** 0.015
    spread = [[ssaa.value - ssaa.low], [ssaa.high - ssaa.value]]
    axes.errorbar(edge, ssaa.value, yerr=spread, fmt="<", color=GREY, ms=7, zorder=4)
    _name(axes, (edge, ssaa.value), "ssaa4: detail loss 0", GREY, 1)
    axes.set_xlabel("detail loss / that of no anti-aliasing (logarithmic)")
    axes.set_ylabel("MTCD / that of no anti-aliasing")
    axes.grid(color="#e6e6e6", lw=0.6)
    axes.set_axisbelow(True)
    _title(axes, "Flicker against loss of detail")
    freeze = fit.kept["freeze"].intervals()
    _footer(
        figure,
        f"{gain_sentence(fit)} Bars: 95 % over sessions that nothing was fitted to; "
        "all saw the same ones, so that differences are known better than that. "
        f"Not shown: freeze, flicker {freeze[0].value:.2g} at a detail loss of "
        f"{freeze[1].value:.3g}. {footer}",
    )
    return figure


def _detail(kept: Kept) -> float:
    return float(np.mean(kept.detail_loss))


def _place(kept: Kept) -> tuple[float, float]:
    return _detail(kept), float(np.mean(kept.flicker))


def _point(axes: Axes, kept: Kept, colour: str, marker: str, size: int = 5) -> None:
    flicker, loss = kept.intervals()
    axes.errorbar(
        loss.value,
        flicker.value,
        xerr=[[loss.value - loss.low], [loss.high - loss.value]],
        yerr=[[flicker.value - flicker.low], [flicker.high - flicker.value]],
        fmt=marker,
        color=colour,
        ms=size,
        lw=1.1,
        zorder=3,
    )


def _name(
    axes: Axes, place: tuple[float, float], name: str, colour: str, side: int
) -> None:
    """Write a name above and right of a point (1), or below and left of it (-1)."""
    axes.annotate(
        name,
        place,
        xytext=(7 * side, 6 * side),
        textcoords="offset points",
        ha="left" if side > 0 else "right",
        va="bottom" if side > 0 else "top",
        fontsize=8.5,
        fontweight="bold",
        color=colour,
        zorder=6,
    )


def _figure(width: float, height: float, count: int) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    panels = list(figure.subplots(1, count, squeeze=False)[0])
    for axes in panels:
        axes.spines[["top", "right"]].set_visible(False)
    return figure, panels


def _title(axes: Axes, text: str) -> None:
    axes.set_title(text, loc="left", fontsize=11, fontweight="bold")


def _footer(figure: Figure, words: str) -> None:
    lines = textwrap.fill(words, int(17 * figure.get_figwidth()))
    # Below the figure's edge: the tight bounding box takes it in.
    figure.text(0.01, -0.02, lines, fontsize=6.5, color=GREY, va="top")
