"""Anti-aliasing for headsets with samples at twice the resolution (TIDOAA).

A camera turns at a steady rate in a hut around which rigid things circle. What is shown
is held against four samples per pixel, as the paper holds it against MSAA: without
anti-aliasing, by a usual temporal filter (INSIDE's), and by TIDOAA.
"""

import dataclasses
import os
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import scenes
from ..camera import Camera
from ..frames.frame import MOTION_CLASSES
from ..frames.sources import AbstractSource
from ..scenes import props
from ..scenes.shapes import Object
from ..scenes.solids import Solids
from ..simulation.views import Pattern
from ..studies.progress import Progress, Tell
from ..techniques import MSAA, TIDOAA, AbstractTechnique, Inside, NoAntialiasing
from . import tidoaa_claims as judged
from .claims import Found
from .kept import kept
from .played import Moment, play, random_starts, squared_error, turning
from .timing import times

TITLE = "Temporal anti-aliasing with samples at twice the resolution (TIDOAA)"
CAMERA = Camera(width_px=160, height_px=160, fov_deg=60.0, refresh_hz=60.0)
SESSIONS, QUICK_SESSIONS = 96, 12

SPEEDS_DEG = (0.0, 0.1, 0.25, 0.5, 1.0, 2.0, 3.0, 5.0, 8.0, 12.0)  # per frame
_QUICK_SPEEDS_DEG = (0.25, 1.0, 3.0, 12.0)
_OBJECT_SPEED_DEG = 1.0  # of the camera, where single things are looked at: one of both
_WARMUP, _FRAMES = 8, 4  # TIDOAA's samples take turns over four
_TO_MIDDLE = _WARMUP + (_FRAMES - 1) / 2  # steps to that of what is measured
_MOST_DEG = 25.0  # that a session looks aside, in the middle of what is measured
_NEAR_PX, _TRAIL_FRAMES = 3, 4
_FENCE_M, _FENCE_SPEED_DEG = 6.0, 0.1
_LEAST_BAR, _LEAST_KEPT = 0.1, 0.5  # of a colour that a bar changes; of that change
_STATIC = Pattern((((0.0, 0.0),),), frozenset({"color", "motion_class"}))


def conditions() -> tuple[AbstractTechnique, ...]:
    """Return what the paper compares, and a form whose cells know their samples."""
    return NoAntialiasing(), Inside(), TIDOAA(), TIDOAA(subcell=True)


def deforming(solids: Solids) -> Solids:
    """Return a scene whose moving things say that they deform."""
    rigid, other = (MOTION_CLASSES.index(name) for name in ("rigid", "deforming"))
    classes = np.where(solids.classes == rigid, other, solids.classes)
    return dataclasses.replace(solids, classes=classes)


@jax.jit
def _errors(
    source: AbstractSource, camera: Camera, step: Array, yaws: Array, times: Array
) -> Float[Array, "session truth case technique"]:
    """Squared error to MSAA and to supersampling, a pixel's share of the frame's mean.

    Both are held against each other, too, behind the techniques. Cases: all pixels,
    those beside what moves, and those where it just was.
    """
    samples = Pattern.of(MSAA(4), source.gives).samples
    multisampled = Pattern.of(MSAA(4), source.gives)
    supersampled = Pattern(samples, frozenset({"color"}))

    def measure(carry: Any, moment: Moment) -> tuple[Any, Array]:
        nothing = jnp.zeros((2, 3, len(moment.shown) + 2), moment.shown.dtype)
        if carry is None:  # the first frame: it compiles in half the time without
            return (1, jnp.full(moment.shown.shape[2:], 99)), nothing
        k, age = carry
        moves = moment.render(_STATIC).motion_class > 0
        age = jnp.where(moves, 0, age + 1)  # frames since something moved there
        found = jax.lax.cond(
            k < _WARMUP, lambda: nothing, lambda: errors(moment, moves, age)
        )
        return (k + 1, age), found

    def errors(moment: Moment, moves: Array, age: Array) -> Array:
        truths = jnp.stack(
            [MSAA(4).resolve(moment.render(p)) for p in (multisampled, supersampled)]
        )
        shown = jnp.concatenate([moment.shown, truths])
        error = jnp.stack([squared_error(shown, truth) for truth in truths])
        around = jax.lax.reduce_window(
            moves, False, jnp.logical_or, (2 * _NEAR_PX + 1,) * 2, (1, 1), "SAME"
        )
        places = [
            jnp.ones_like(moves),
            around & ~moves,
            ~moves & (age <= _TRAIL_FRAMES),
        ]
        places = jnp.stack(places).astype(error.dtype)
        return jnp.einsum("chw,rthw->rct", places, error) / moves.size

    def session(each: tuple[Array, Array]) -> Array:
        yaw, time = each
        # Whatever the speed, what is measured looks the same way, on average.
        motion = turning(yaw - _TO_MIDDLE * step, step, _WARMUP + _FRAMES)
        found = play(source, camera, conditions(), motion, time, measure)
        return found[_WARMUP:].mean(axis=0)

    return jax.lax.map(session, (yaws, times))


@jax.jit
def _bars(
    with_bars: AbstractSource,
    without: AbstractSource,
    camera: Camera,
    step: Array,
    yaws: Array,
) -> Float[Array, "session technique"]:
    """Share of the pixels of thin bars in which these are seen."""

    def measure(carry: None, moment: Moment) -> tuple[None, tuple[Array, Array]]:
        behind = without.reference(moment.view)
        bar = with_bars.reference(moment.view) - behind
        strength = jnp.sum(bar**2, axis=0)
        is_bar = strength > _LEAST_BAR**2
        seen = jnp.sum((moment.shown - behind[None]) * bar[None], axis=1)
        is_seen = seen >= _LEAST_KEPT * strength[None]
        return None, ((is_seen & is_bar[None]).sum(axis=(1, 2)), is_bar.sum())

    def session(yaw: Array) -> Array:
        motion = turning(yaw - _TO_MIDDLE * step, step, _WARMUP + _FRAMES)
        start = jnp.int32(0)
        seen, bars = play(with_bars, camera, conditions(), motion, start, measure)
        share = seen[_WARMUP:].sum(axis=0) / bars[_WARMUP:].sum()
        return share

    return jax.lax.map(session, yaws)


def run(
    camera: Camera,
    sessions: int,
    *,
    seed: int = 0,
    out: str | os.PathLike,
    overwrite: bool = False,
    progress: Tell = lambda event: None,
) -> Found:
    """Run the experiment, or go on with it.

    **Arguments:** `out`: folder where what is finished is kept, by all that decides it:
    nothing of another experiment is replaced, whatever `overwrite`.
    """
    is_quick = sessions <= QUICK_SESSIONS
    speeds = _QUICK_SPEEDS_DEG if is_quick else SPEEDS_DEG
    starts = random_starts(seed, sessions, _MOST_DEG)
    hut, wires = scenes.hut(), scenes.fence(distance_m=_FENCE_M)
    meadow = Solids.of([Object(props.meadow())], name="meadow")
    todo: dict[str, tuple[Any, tuple]] = {
        f"hut_{speed:g}": (_errors, (hut, camera, _radians(speed), *starts))
        for speed in speeds
    }
    at_object = (camera, _radians(_OBJECT_SPEED_DEG), *starts)
    todo["deforming"] = _errors, (deforming(hut), *at_object)
    step = _radians(_FENCE_SPEED_DEG)
    todo["bars"] = _bars, (wires, meadow, camera, step, starts[0])
    found: dict[str, np.ndarray] = {}
    for name, (simulate, arguments) in todo.items():
        progress(Progress(len(found), len(todo), name, unit="experiments"))
        compute = lambda run=simulate, given=arguments: np.asarray(run(*given), float)
        parts = (conditions(), _WARMUP, _FRAMES, arguments)
        values = kept(Path(out) / "batches", name, parts, compute)
        found[name] = np.moveaxis(values, 0, -1)
    progress(Progress(len(found), len(todo), "timing", unit="experiments"))
    took = times(hut, camera, (NoAntialiasing(), MSAA(4), TIDOAA()))
    rigid, deforms = found[f"hut_{_OBJECT_SPEED_DEG:g}"], found["deforming"]
    of_speed = [
        {speed: found[f"hut_{speed:g}"][truth, 0] for speed in speeds}
        for truth in (0, 1)
    ]
    return Found(
        title=TITLE,
        about=_about(camera, sessions),
        claims=[
            *judged.by_speed(of_speed[0], 0),
            judged.on_bars(found["bars"]),
            judged.beside(rigid[0, 1], 0),
            judged.behind(deforms[0, 2], 0),
            judged.on_cost(took),
            *judged.by_speed(of_speed[1], 1),
            judged.beside(rigid[1, 1], 1),
            judged.behind(deforms[1, 2], 1),
        ],
        measured=[row for n in (0, 1) for row in judged.measured(of_speed[n], n)],
        cases=[f"{speed:g}" for speed in _QUICK_SPEEDS_DEG],
        lines=[judged.NOT_SIMULATED],
        tables={},
    )


def _radians(degrees: float) -> np.float32:
    return np.float32(np.radians(degrees))


def _about(camera: Camera, sessions: int) -> str:
    return (
        f"{sessions} sessions, each another way and time, {camera.width_px} x "
        f"{camera.height_px} px; the camera turns at a steady rate about the eye. "
        f"{_FRAMES} frames are measured after {_WARMUP}, not the paper's ten of one "
        "path: in ten a fast turn leaves all that there is to see. In their middle a "
        f"session looks within {_MOST_DEG:g} deg of the scene's, whatever the speed. "
        "Scene: hut, with five things that circle it; beside and behind these at "
        f"{_OBJECT_SPEED_DEG:g} deg per frame, with the same things said to deform for "
        f"what lies behind them; bars: fence at {_FENCE_M:g} m, whose wires are half a "
        "pixel wide, against a picture without it. Squared error to MSAA with four "
        "samples, as in the paper, whose colours are of pixels' centres, and to those "
        "samples, each with its own colour, which smooth what surfaces show as TIDOAA "
        "does. Intervals (95 %) are over sessions, paired."
    )
