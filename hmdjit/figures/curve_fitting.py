"""Pictures of a fitted curve, and of the front that it is on."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator

from .. import blending
from .._types import Numbers
from ..curve_fitting.results import FITTED, KIM, CurveFit, Kept
from ..curve_fitting.space import CurveSpace
from ..techniques import HeadMovement
from . import drawing

DIFFERENCES = (0.0, 0.2)
"""Colour differences at which weights are drawn, shares of the largest."""

_FITTED, _KIM, _FRONT, _OTHER = drawing.BLUE, drawing.VERMILLION, drawing.SKY, "black"
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
    speeds_deg_s: Float[Array, " places"],
    differences: Float[Array, " places"],
) -> Float[Array, "draws places"]:
    at = jax.vmap(current_weight, in_axes=(None, 0, 0))
    one = lambda numbers: at(space.of_numbers(numbers), speeds_deg_s, differences)
    return jax.vmap(one)(drawn)


@drawing.styled
def draw_curve(fit: CurveFit, footer: str) -> Figure:
    """Draw the weight of the current picture against head speed, beside Kim et al.'s.

    Where the localisation is free, the smallest weight against colour difference too.
    A band holds 95 % of the bootstrap's curves at each place.
    """
    is_local = fit.space.localization != "linear"
    words = (
        f"Band: {100 * _LEVEL:g} % of a bootstrap over sessions, where colours do not "
        f"differ. {footer}"
    )
    width = 6.8 + 4.4 * is_local
    figure, (axes,) = drawing.panels(width, 4.6, words, columns=1 + is_local)
    ramp = jnp.linspace(0, 1, _STEPS, dtype=jnp.asarray(fit.errors.drawn).dtype)
    fastest = max(float(t.h_max_deg_s) for t in (fit.technique, HeadMovement()))
    speeds = ramp * min(1.1 * fastest, _FASTEST_DEG_S)
    for difference, dashes in zip(DIFFERENCES, ("-", (0, (4, 2))), strict=True):
        at = (speeds, jnp.full_like(ramp, difference))
        if difference == 0:
            _band(axes[0], fit, speeds, at)
        where = f", colour difference {difference:g}"
        _compare(axes[0], fit, speeds, at, where, ls=dashes)
    axes[0].set_xlabel("head speed, deg/s")
    axes[0].set_ylabel("weight of the current picture")
    axes[0].set_title("How much of the current picture is shown")
    if is_local:
        at = (jnp.zeros_like(ramp), ramp)
        _band(axes[1], fit, ramp, at)
        _compare(axes[1], fit, ramp, at)
        axes[1].set_xlabel("colour difference, share of the largest")
        axes[1].set_ylabel("weight while the head is still")
        axes[1].set_title("Its minimum where pictures differ")
    for panel in axes:
        panel.set_ylim(0, 1.02)
        panel.margins(x=0)
        panel.legend()
    return figure


_Places = tuple[Float[Array, " places"], Float[Array, " places"]]


def _band(axes: Axes, fit: CurveFit, x: Array, at: _Places) -> None:
    curves = _weights(fit.space, jnp.asarray(fit.errors.drawn), *at)
    low, high = np.quantile(curves, [(1 - _LEVEL) / 2, (1 + _LEVEL) / 2], axis=0)
    axes.fill_between(x, low, high, color=_FITTED, alpha=0.18, lw=0)


def _compare(
    axes: Axes, fit: CurveFit, x: Array, at: _Places, where: str = "", **style: Any
) -> None:
    of = jax.vmap(current_weight, in_axes=(None, 0, 0))
    fitted, kim = of(fit.technique, *at), of(HeadMovement(), *at)
    axes.plot(x, fitted, color=_FITTED, lw=1.8, label=f"fitted{where}", **style)
    axes.plot(x, kim, color=_KIM, lw=1.8, label=f"Kim et al.{where}", **style)


@drawing.styled
def draw_front(fit: CurveFit, gain: str, footer: str) -> Figure:
    """Draw flicker against detail loss: the family's front, and what lies about it.

    SSAA, which loses no detail, stands at the left edge; freeze is described in words.

    **Arguments:** `gain`: what the front gains over Kim et al.'s constants, in words.
    """
    freeze = fit.kept["freeze"].intervals()
    words = (
        f"{gain} Bars: 95 % over sessions that nothing was fitted to; all saw the same "
        "ones, so that differences are known better than that. Not shown: freeze, "
        f"flicker {freeze[0].value:.2g} at a detail loss of {freeze[1].value:.3g}. "
        f"{footer}"
    )
    figure, ((axes,),) = drawing.panels(7.2, 5.0, words)
    front = sorted([*(point.kept for point in fit.front), fit.kept[FITTED]], key=_place)
    axes.plot(*zip(*map(_place, front), strict=True), color=_FRONT, lw=1.8, zorder=2)
    for kept in front:
        _point(axes, kept, color=_FRONT, fmt="o", ms=5)
    for name, label, colour, marker, side in (
        ("none", "no anti-aliasing", _OTHER, "s", 1),
        (KIM, "Kim et al.", _KIM, "D", 1),
        (FITTED, "fitted", _FITTED, "o", -1),
    ):
        _point(axes, fit.kept[name], color=colour, fmt=marker, ms=7)
        _name(axes, _place(fit.kept[name]), label, colour, side)
    _name(axes, _place(front[-1]), f"front of the family {fit.space.family}", _NAME, -1)

    shown = [*front, fit.kept["none"], fit.kept[KIM]]
    flickers, losses = zip(*(kept.intervals() for kept in shown), strict=True)
    low = max(min(x.low for x in losses), min(x.value for x in losses) / 2) / 1.15
    high = max(x.high for x in losses) * 1.05
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    drawing.label_ticks(axes.xaxis, FixedLocator(drawing.ticks(low, high)))
    axes.set_ylim(0, 1.12 * max(y.high for y in flickers))
    ssaa = fit.kept["ssaa4"].intervals()[0]
    edge = low * (high / low) ** 0.015
    bar = (ssaa.value, ssaa.low, ssaa.high)
    drawing.errorbar(axes, edge, bar, fmt="<", color=drawing.GREY, ms=7, zorder=4)
    _name(axes, (edge, ssaa.value), "ssaa4: detail loss 0", drawing.GREY, 1)
    axes.set_xlabel("detail loss / that of no anti-aliasing (logarithmic)")
    axes.set_ylabel("MTCD / that of no anti-aliasing")
    axes.grid()
    axes.set_title("Flicker against loss of detail")
    return figure


def _place(kept: Kept) -> tuple[float, float]:
    return float(np.mean(kept.detail_loss)), float(np.mean(kept.flicker))


def _point(axes: Axes, kept: Kept, **style: Any) -> None:
    flicker, loss = ((x.value, x.low, x.high) for x in kept.intervals())
    drawing.errorbar(axes, loss, flicker, lw=1.1, zorder=3, **style)


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
        fontsize=drawing.LABEL,
        fontweight="bold",
        color=colour,
        zorder=6,
    )
