"""The envelope as a table for the terminal, and as a figure of errors against angle."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from mpmath import mp
from rich import box
from rich.table import Table

from .. import camera as pinhole
from .. import quaternion
from ..camera import Camera
from ..envelope import (
    bounds,
    cases,
    curves,
    estimators,
    extremes,
    heads,
    holes,
    intervals,
    metrics,
    pictures,
    runs,
)
from ..envelope import oracles as exact
from ..envelope.measuring import (
    DIGITS,
    Case,
    Row,
    Run,
    distance,
    exact_numbers,
    measure,
)
from ..envelope.poses import IDENTITY, poses_of, product, unit
from ..figures import drawing
from ..frames.motion import rebased_motion

_OURS, _OTHER, _THIRD = "#0072B2", "#D55E00", "#009E73"
_LOWEST, _HIGHEST = 1e-12, 10.0  # what is drawn; answers that are wrong are 1


def table(rows: Sequence[Row], width: int = 80) -> Table:
    """Lay out rows: what was asked, the largest errors, and whether bounds hold.

    **Arguments:** `width`: of the terminal, characters: narrow ones are told no ranges.
    """
    found = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    is_wide = width >= 120
    found.add_column("function", overflow="fold")
    if is_wide:
        found.add_column("range")
    found.add_column("dtype", no_wrap=True)
    for name in ("error", "bound", "slope,\neps", "bound"):
        found.add_column(name, justify="right", no_wrap=True)
    found.add_column("holds", no_wrap=True)
    last = ""
    for row in rows:
        is_same = row.name == last
        last = row.name
        found.add_row(
            "" if is_same else row.name,
            *["" if is_same else row.over] * is_wide,
            row.dtype,
            f"{row.error:.2g} {row.unit}",
            *(number(x) for x in (row.bound, row.gradient, row.gradient_bound)),
            "yes" if row.holds else "NO",
            style="" if row.holds else "bold",
        )
    return found


def number(value: float) -> str:
    """Write a number in few digits; `-` where there is none."""
    return "-" if math.isnan(value) else f"{value:.3g}"


def explanation(rows: Sequence[Row]) -> str:
    """Say what the table's words mean, and sum it up."""
    broken = [row for row in rows if not row.holds]
    words = [
        f"{len(rows) - len(broken)} of {len(rows)} bounds hold. eps: relative to the "
        "answer's largest entry, in units of the dtype's spacing at 1 (1.2e-7 and "
        f"2.2e-16). Answers have {DIGITS} digits (mpmath), gradients are theirs; "
        "`simulate` (but for counts), `theory.predict` and `scenes.bake` are held "
        "against float64. Worst inputs are in the CSV."
    ]
    for row in broken:
        where = row.worst if row.error > row.bound else row.worst_gradient
        words.append(f"Does not hold: {row.name} ({row.dtype}) at {where}.")
    return "\n".join(words)


# --- figure ---


def _textbook_log(q: Any) -> Any:
    """`2 acos(w) v / |v|`, as it is often written."""
    sine = jnp.sqrt(jnp.maximum(q[1:] @ q[1:], 1e-38))
    return 2 * jnp.arccos(jnp.clip(q[0], -1, 1)) * q[1:] / sine


def _two_pose_log(start: Any, end: Any) -> Any:
    """Logarithm of the plain product, by atan2."""
    return quaternion.log(quaternion.multiply(quaternion.conjugate(start), end))


def _textbook_slerp(start: Any, end: Any, fraction: Any) -> Any:
    """Shoemake's weights with the angle from `acos(dot)`."""
    angle = jnp.arccos(jnp.clip(start @ end, -1, 1))
    sine = jnp.sin(angle)
    weights = [jnp.sin(s * angle) for s in (1 - fraction, fraction)]
    mixed = (weights[0] * start + weights[1] * end) / sine
    return jnp.where(sine > 0, mixed, start)


def _errors(
    function: Callable, oracle: Callable, inputs: Sequence[tuple[Any, ...]]
) -> list[float]:
    """Relative errors of the answer to each of the float32 inputs."""
    columns = [jnp.asarray(np.stack(c)) for c in zip(*inputs, strict=True)]
    found = np.asarray(jax.jit(jax.vmap(function))(*columns), float)
    errors = []
    for ours, arguments in zip(found, inputs, strict=True):
        answer = oracle(*map(exact_numbers, arguments))
        size = max(abs(x) for x in answer)
        errors.append(float(distance(ours, answer) / size))
    return errors


def draw(seed: int = 0, points: int = 121) -> Figure:
    """Draw float32 errors against rotation angle, ours beside the textbook's forms."""
    angles = np.geomspace(1e-30, math.pi * 0.999, points)
    rng = np.random.default_rng(seed)
    figure = Figure(figsize=(11, 7.6), dpi=drawing.DPI, layout="constrained")
    FigureCanvasAgg(figure)
    panels: Any = figure.subplots(2, 2)
    with jax.enable_x64(True), mp.workdps(DIGITS):
        for axes, panel in zip(
            panels.flat, (_logs, _increments, _slerps, _past), strict=True
        ):
            title, unit, lines = panel(rng, angles)
            for (label, errors), (color, marker) in zip(
                lines.items(),
                ((_OURS, "o"), (_OTHER, "s"), (_THIRD, "^")),
                strict=False,
            ):
                shown = np.clip(np.nan_to_num(errors, nan=np.inf), _LOWEST, _HIGHEST)
                axes.plot(angles, shown, marker, color=color, ms=2.5, label=label)
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.set_title(title, loc="left", fontsize=10, fontweight="bold")
            axes.set_ylabel(unit, fontsize=9)
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


def _about(rng: np.random.Generator, angles: np.ndarray) -> list[np.ndarray]:
    return [*poses_of(angles[:, None] * unit(rng.normal(size=(len(angles), 3))))]


_Panel = tuple[str, str, dict[str, list[float]]]


def _logs(rng: np.random.Generator, angles: np.ndarray) -> _Panel:
    inputs = [(q.astype(np.float32),) for q in _about(rng, angles)]
    lines = {
        "quaternion.log": _errors(quaternion.log, exact.log, inputs),
        "2 acos(w) v / |v|": _errors(_textbook_log, exact.log, inputs),
    }
    return "Logarithm of a quaternion", "relative error", lines


def _increments(rng: np.random.Generator, angles: np.ndarray) -> _Panel:
    """Between two poses anywhere, against the turn before they were rounded."""
    turns = _about(rng, angles)
    holds = unit(rng.normal(size=(len(turns), 4)))
    ends = product(holds, np.stack(turns))
    ours, two, acos = [], [], []
    jitted = jax.jit(_two_pose_log)
    for turn, hold, end in zip(turns, holds, ends, strict=True):
        truth = np.array([float(x) for x in exact.log([mp.mpf(x) for x in turn])])
        size = np.max(np.abs(truth))
        pair = [jnp.asarray(q, jnp.float32) for q in (hold, end)]
        # Near the identity a float64 pose is the turn itself: no digit is lost there.
        near = rebased_motion(np.stack([IDENTITY, turn]), jnp.float32)
        gap = lambda found, t=truth, s=size: float(
            np.max(np.abs(np.asarray(found, float) - t)) / s
        )
        ours.append(gap(near.increment[1]))
        two.append(gap(jitted(*pair)))
        turned = quaternion.multiply(quaternion.conjugate(pair[0]), pair[1])
        acos.append(gap(_textbook_log(turned)))
    lines = {
        "rebased in float64, quaternion.increments": ours,
        "two float32 poses, atan2": two,
        "two float32 poses, acos": acos,
    }
    return "Increment between two poses", "relative error", lines


def _slerps(rng: np.random.Generator, angles: np.ndarray) -> _Panel:
    """How far a third of the way is from the start, which both know exactly."""
    start = np.array([1, 0, 0, 0], np.float32)
    third = np.asarray(1 / 3, np.float32)
    inputs = [(start, q.astype(np.float32), third) for q in _about(rng, angles)]
    part = lambda slerp: lambda *given: slerp(*given)[1:]
    oracle = lambda *given: exact.slerp(*given)[1:]
    lines = {
        "quaternion.slerp": _errors(part(quaternion.slerp), oracle, inputs),
        "weights by acos(dot)": _errors(part(_textbook_slerp), oracle, inputs),
    }
    return "Slerp, d = 1/3: the part turned", "relative error", lines


def _past(rng: np.random.Generator, angles: np.ndarray) -> _Panel:
    """In the corner of the default camera, from a hold pose anywhere."""
    display, place = Camera(), (1023.5, 0.5)
    fov, corner = (
        np.array(mp.mpf(96), object),
        [np.array(mp.mpf(x), object) for x in place],
    )
    oracle = exact.Pinhole(1024, 1024)
    moved = jax.jit(
        lambda r: jnp.stack(
            pinhole.displacement(display, r, *map(jnp.float32, place))[:2]
        )
    )
    lines: dict[str, list[float]] = {
        "rebased in float64, displacement": [],
        "two float32 poses, atan2": [],
        "two float32 poses, acos": [],
    }
    for turn in _about(rng, np.minimum(angles, 0.3)):
        hold = unit(rng.normal(size=4))
        poses = product(hold, np.stack([IDENTITY, turn]))
        exact_poses = [np.array([mp.mpf(x) for x in q], object) for q in poses]
        rotation = exact.log(exact.relative(*exact_poses))
        truth = np.array(
            [float(x) for x in oracle.displacement(fov, rotation, *corner)]
        )
        pair = jnp.asarray(poses, jnp.float32)
        turned = quaternion.multiply(quaternion.conjugate(pair[0]), pair[1])
        rotations = (
            rebased_motion(poses, jnp.float32).increment[1],
            quaternion.log(turned),
            _textbook_log(turned),
        )
        for errors, rotation in zip(lines.values(), rotations, strict=True):
            gap = np.abs(np.asarray(moved(rotation), float) - truth)
            errors.append(float(np.max(gap)))
    return "Past sample, 1024 px, 96°, d = 0 (to 0.3 rad)", "error, px", lines


def entries() -> list[Case | Run]:
    """All that is measured."""
    return [
        *cases.cases(),
        *pictures.cases(),
        *curves.cases(),
        *heads.cases(),
        *metrics.cases(),
        *curves.runs(),
        *metrics.runs(),
        *runs.runs(),
        *extremes.runs(),
        *holes.runs(),
        *bounds.runs(),
        *intervals.runs(),
        *estimators.runs(),
    ]


def measured(**options: Any) -> list[Row]:
    """Measure all entries; options as `envelope.measure`."""
    return measure(entries(), **options)


def write_figure(path: Path, seed: int = 0, points: int = 121) -> Path:
    """Draw and save the figure."""
    return drawing.save(draw(seed, points), path)
