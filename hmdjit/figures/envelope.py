"""Errors in float32 against rotation angle, ours beside the textbook's forms."""

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from .. import camera as pinhole
from .. import quaternion
from ..camera import Camera
from ..envelope import exact_geometry as exact
from ..envelope.arguments import turned, unit
from ..envelope.engine import DIGITS, distances, exact_numbers, mp
from ..frames.motion import rebased_motion
from . import drawing

_STYLES = (("#0072B2", "o"), ("#D55E00", "s"), ("#009E73", "^"))
_LOWEST, _HIGHEST = 1e-12, 10.0  # what is drawn; answers that are wrong are 1
_IDENTITY = np.eye(4)[0]

_Panel = tuple[str, str, dict[str, list[float]]]


def write_figure(path: Path, seed: int = 0, points: int = 121) -> Path:
    """Draw and save the figure."""
    return drawing.save(draw(seed, points), path, tight=False)


def draw(seed: int = 0, points: int = 121) -> Figure:
    """Draw float32 errors against rotation angle, ours beside the textbook's forms."""
    angles = np.geomspace(1e-30, math.pi * 0.999, points)
    rng = np.random.default_rng(seed)
    figure = Figure(figsize=(11, 7.6), dpi=drawing.DPI, layout="constrained")
    FigureCanvasAgg(figure)
    panels: Any = figure.subplots(2, 2)
    with jax.enable_x64(True), mp.workdps(DIGITS):
        measured = [f(rng, angles) for f in (_logs, _increments, _slerps, _past)]
    for axes, (title, unit_text, lines) in zip(panels.flat, measured, strict=True):
        for (label, errors), (color, marker) in zip(
            lines.items(), _STYLES, strict=False
        ):
            shown = np.clip(np.nan_to_num(errors, nan=np.inf), _LOWEST, _HIGHEST)
            axes.plot(angles, shown, marker, color=color, ms=2.5, label=label)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_title(title, loc="left", fontsize=10, fontweight="bold")
        axes.set_ylabel(unit_text, fontsize=9)
        axes.set_xlabel("rotation, rad", fontsize=9)
        axes.axvspan(1e-5, 1e-2, color=drawing.SHADE, zorder=-1)
        axes.grid(color="#e6e6e6", lw=0.6)
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(labelsize=8)
        axes.set_ylim(_LOWEST / 3, 3e4)
        axes.legend(fontsize=8, frameon=False, loc="upper left")
    figure.suptitle(
        "Errors in float32 against rotation angle, drawn from 1e-12 to 10 "
        "(shaded: a head that holds still)",
        x=0.01,
        ha="left",
        fontsize=12,
        fontweight="bold",
    )
    return figure


# --- the textbook's forms ---


@jax.jit
def _acos_log(q: Any) -> Any:
    """`2 acos(w) v / |v|`, as it is often written."""
    sine = jnp.sqrt(jnp.maximum(q[1:] @ q[1:], 1e-38))
    return 2 * jnp.arccos(jnp.clip(q[0], -1, 1)) * q[1:] / sine


def _acos_slerp(start: Any, end: Any, fraction: Any) -> Any:
    """Shoemake's weights with the angle from `acos(dot)`."""
    angle = jnp.arccos(jnp.clip(start @ end, -1, 1))
    sine = jnp.sin(angle)
    weights = [jnp.sin(s * angle) for s in (1 - fraction, fraction)]
    mixed = (weights[0] * start + weights[1] * end) / sine
    return jnp.where(sine > 0, mixed, start)


def _increments_of(poses: np.ndarray) -> dict[str, Any]:
    """Rotation between two poses: ours, and two forms of it from float32 poses."""
    start, end = (jnp.asarray(q, jnp.float32) for q in poses)
    turn = quaternion.multiply(quaternion.conjugate(start), end)
    return {
        "rebased in float64": rebased_motion(poses, jnp.float32).increment[1],
        "two float32 poses, atan2": quaternion.log(turn),
        "two float32 poses, acos": _acos_log(turn),
    }


# --- panels ---


def _turns(rng: np.random.Generator, angles: np.ndarray) -> Iterator[np.ndarray]:
    for angle in angles:
        yield turned(_IDENTITY, angle * unit(rng.normal(size=3)))


def _relative(
    function: Callable, oracle: Callable, inputs: Sequence[tuple[Any, ...]]
) -> list[float]:
    """Relative errors of the answer to each of the float32 inputs."""
    columns = [jnp.asarray(np.stack(c)) for c in zip(*inputs, strict=True)]
    found = np.asarray(jax.jit(jax.vmap(function))(*columns), float)
    answers = [oracle(*map(exact_numbers, given)) for given in inputs]
    return [
        float(max(distances(ours, answer)) / max(abs(x) for x in answer))
        for ours, answer in zip(found, answers, strict=True)
    ]


def _logs(rng: np.random.Generator, angles: np.ndarray) -> _Panel:
    inputs = [(q.astype(np.float32),) for q in _turns(rng, angles)]
    forms = {"quaternion.log": quaternion.log, "2 acos(w) v / |v|": _acos_log}
    lines = {name: _relative(form, exact.log, inputs) for name, form in forms.items()}
    return "Logarithm of a quaternion", "relative error", lines


def _increments(rng: np.random.Generator, angles: np.ndarray) -> _Panel:
    """Between two poses anywhere, against the turn before they were rounded."""
    lines: dict[str, list[float]] = {}
    for turn in _turns(rng, angles):
        truth = np.array([float(x) for x in exact.log(exact_numbers(turn))])
        hold = unit(rng.normal(size=4))
        poses = np.stack([hold, exact.multiply(hold, turn)])
        forms = _increments_of(poses)
        # Near the identity a float64 pose is the turn itself: no digit is lost there.
        near = _increments_of(np.stack([_IDENTITY, turn]))
        forms["rebased in float64"] = near["rebased in float64"]
        for name, found in forms.items():
            gap = np.max(np.abs(np.asarray(found, float) - truth))
            lines.setdefault(name, []).append(float(gap / np.max(np.abs(truth))))
    return "Increment between two poses", "relative error", lines


def _slerps(rng: np.random.Generator, angles: np.ndarray) -> _Panel:
    """How far a third of the way is from the start, which both know exactly."""
    start, third = _IDENTITY.astype(np.float32), np.asarray(1 / 3, np.float32)
    inputs = [(start, q.astype(np.float32), third) for q in _turns(rng, angles)]
    part = lambda slerp: lambda *given: slerp(*given)[1:]
    forms = {"quaternion.slerp": quaternion.slerp, "weights by acos(dot)": _acos_slerp}
    lines = {
        name: _relative(part(form), part(exact.slerp), inputs)
        for name, form in forms.items()
    }
    return "Slerp, d = 1/3: the part turned", "relative error", lines


def _past(rng: np.random.Generator, angles: np.ndarray) -> _Panel:
    """In the corner of the default camera, from a hold pose anywhere."""
    display, place = Camera(), np.array([1023.5, 0.5])
    lines: dict[str, list[float]] = {}
    moved = jax.jit(
        lambda r: jnp.stack(pinhole.displacement(display, r, *jnp.float32(place))[:2])
    )
    for turn in _turns(rng, np.minimum(angles, 0.3)):
        hold = unit(rng.normal(size=4))
        poses = np.stack([hold, exact.multiply(hold, turn)])
        rotation = exact.log(exact.relative(*exact_numbers(poses)))
        where = mp.mpf(96), rotation, exact_numbers(place), (1024, 1024)
        truth = exact.displacement(*where)
        for name, found in _increments_of(poses).items():
            gap = float(max(distances(moved(found), truth)))
            lines.setdefault(name, []).append(gap)
    return "Past sample, 1024 px, 96°, d = 0 (to 0.3 rad)", "error, px", lines
