"""Temporal anti-aliasing improved with Sobel and model indices (Oliveros' thesis).

Static tests: a camera that stands still, whose pictures are held against the
accumulation buffer's. Ghosting tests: the same of things that move, frame by frame.
Pictures are what a display has, eight bits, and means are of gamma colours, as there.
"""

import dataclasses
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import rendering, scenes
from ..camera import Camera, Region
from ..frames.frame import Frame
from ..frames.motion import Motion
from ..frames.sources import AbstractSource, History
from ..sample_patterns import accumulation
from ..scenes.shapes import Movement, Paths
from ..scenes.solids import Solids
from ..simulation.session import fastest_reading
from ..simulation.views import Pattern, Renderer
from ..studies.progress import Progress, Tell
from ..technique_contract.display_stages import Sharpening
from ..techniques import FXAA, SMAA, NoAntialiasing, SobelTAA, ThesisBaseline
from . import sobel_claims as judged
from .claims import Found
from .kept import kept

TITLE = "Temporal anti-aliasing improved with Sobel and model indices (a thesis)"
CAMERA = Camera(width_px=64, height_px=64, fov_deg=18.0, refresh_hz=60.0)
SESSIONS, QUICK_SESSIONS = 24, 6

_ROUNDS = 4  # of the jitter, before a static picture is looked at
_GHOST_FRAMES = 24
_GHOSTS = (12, 16, 20, 23)  # frames that are measured
_MOST_DEG = 2.0  # that a session looks aside
_ROLL_DEG = 20.0  # of the inclined camera
_TURN_RAD_S = 1.0  # of the hairball
_HAIRS = 200
_CHUNK = 16  # samples that are rendered at once: those of the smaller reference
_CENTRE = Pattern((((0.0, 0.0),),), frozenset({"color"}))
_SPATIAL = NoAntialiasing(), FXAA(), SMAA(preset="ultra", edges="color")
_TEMPORAL = ThesisBaseline(), SobelTAA()


class Shown(NamedTuple):
    """What is seen of a session: what techniques read, and the reference.

    - `centre`: colour at pixels' centres; `jittered`: frames, in the jitter's order.
    - `truths`: means of 16 and of 128 renders.
    """

    centre: Float[Array, "frames 3 height width"]
    jittered: Frame
    truths: Float[Array, "frames 2 3 height width"]


def turning_hairs(ball: Solids) -> Solids:
    """Return a hairball that turns about its own axis."""
    turn = Movement(rotation_rad_s=(0.0, _TURN_RAD_S, 0.0), pivot_m=(0.0, 0.0, -1.9))
    classes = np.array([0, 1], np.int32)
    return dataclasses.replace(
        ball, paths=Paths.of([turn]), classes=classes, moves=True
    )


def experiments() -> dict[str, Callable[[], Solids]]:
    """Return what makes the scene nearest to each table's, by names of `judged`."""
    hairs = lambda: scenes.hairball(hairs=_HAIRS)
    shadow = lambda: scenes.hairball_shadow(hairs=_HAIRS)
    return {
        "pipe": scenes.pipe,
        "inclined pipe": scenes.pipe,
        "blinds": scenes.blinds,
        "arched window": scenes.arched_window,
        "atrium": scenes.atrium,
        "flowers": scenes.flowers,
        "hard edges": scenes.wall_text,
        "hairball shadow": shadow,
        "hairball": hairs,
        "moving sphere": scenes.moving_sphere,
        "turning shadow": lambda: turning_hairs(shadow()),
        "turning hairball": lambda: turning_hairs(hairs()),
    }


@jax.jit
def _rendered(
    source: AbstractSource, camera: Camera, offset: Array, frames: Array, looked: Array
) -> Shown:
    """Render frames as temporal techniques see them, and those that are looked at."""
    region, still = Region.whole(camera), Motion(offset, jnp.zeros(3))
    renderer = Renderer(source, camera, fastest_reading())
    pattern = Pattern.of(SobelTAA(), source.gives)
    places = jnp.asarray(accumulation(128).reshape(-1, _CHUNK, 2), jnp.float32)

    def jittered(k: Array) -> Frame:
        frame = renderer.frame(pattern, region, k, still)
        return dataclasses.replace(frame, steps=None)  # whose size is the scene's

    def looked_at(k: Array) -> tuple[Array, Array]:
        def mean(chunk: Array) -> Array:
            seen = rendering.render(source, camera, region, still, chunk, frame=k)
            return seen.color.mean(axis=0)

        means = jax.lax.map(mean, places)
        centre = renderer.frame(_CENTRE, region, k, still).color[0]
        return centre, jnp.stack([means[0], means.mean(axis=0)])

    centre, truths = jax.lax.map(looked_at, looked)
    return Shown(centre, jax.lax.map(jittered, frames), truths)


@jax.jit
def _pictures(
    seen: Shown, order: Array, looked: Array
) -> Float[Array, "looked picture 3 height width"]:
    """Show frames in an order by each technique, and the references behind them."""
    pick = lambda k: jax.tree.map(lambda leaf: leaf[k], seen.jittered)
    still = Motion(jnp.zeros(3), jnp.zeros(3))

    def step(states: list, k: Array) -> tuple[list, Array]:
        frame = pick(k)
        now = [t.step(s, frame, still) for t, s in zip(_TEMPORAL, states, strict=True)]
        states = [state for state, _ in now]
        uncharted, master = _kept(states[0]), _kept(states[1].shown)
        sharp = [Sharpening("xu"), Sharpening("thesis")]
        shown = [picture for _, picture in now] + [uncharted, master]
        shown += [s.show(p, frame, still) for s in sharp for p in (uncharted, master)]
        return states, jnp.stack([*shown[:2], shown[6], shown[5], uncharted, master])

    states = [technique.init(pick(order[0])) for technique in _TEMPORAL]
    _, temporal = jax.lax.scan(step, states, order)

    def spatial(color: Array) -> Array:
        frame = dataclasses.replace(pick(0), color=color[None], jitter_px=None)
        return jnp.stack([technique.resolve(frame) for technique in _SPATIAL])

    parts = [jax.lax.map(spatial, seen.centre), temporal[looked], seen.truths]
    return jnp.concatenate(parts, axis=1)


def _kept(history: History) -> Array:
    return history.texels[0, 0, :3]


def _session(name: str, source: Solids, camera: Camera, offset: np.ndarray) -> tuple:
    """Render a session; return that, its frames' order, and which are looked at."""
    if name in judged.STATIC:
        frames, order, looked = 16, np.tile(np.arange(16), _ROUNDS), [-1]
        times = np.zeros(1, int)
    else:
        frames, order, looked = _GHOST_FRAMES, np.arange(_GHOST_FRAMES), [*_GHOSTS]
        times = np.array(looked)
    seen = _rendered(source, camera, offset, np.arange(frames), times)
    return seen, order, np.array(looked)


def _codes(name: str, source: Solids, camera: Camera, offset: np.ndarray) -> np.ndarray:
    """Pictures of a session, `(looked, picture, height, width, 3)`, 8 bits."""
    pictures = np.asarray(_pictures(*_session(name, source, camera, offset)))
    codes = np.rint(255 * pictures.clip(0, 1)).astype(np.uint8)
    return np.moveaxis(codes, 2, -1)


def _times(camera: Camera, repeats: int = 9, steps: int = 20) -> np.ndarray:
    """Seconds of a step of temporal techniques, in turns."""
    seen, *_ = _session("pipe", scenes.pipe(), camera, np.zeros(3, np.float32))
    frame = jax.tree.map(lambda leaf: leaf[1], seen.jittered)
    still = Motion(jnp.zeros(3), jnp.zeros(3))
    ready = [(jax.jit(t.step), jax.jit(t.init)(frame)) for t in _TEMPORAL]

    def seconds(step: Callable, state: object) -> float:
        start = time.perf_counter()
        for _ in range(steps):
            jax.block_until_ready(step(state, frame, still))
        return (time.perf_counter() - start) / steps

    for each in ready:  # the first run compiles
        seconds(*each)
    return np.array([[seconds(*each) for each in ready] for _ in range(repeats)])


def run(
    camera: Camera,
    sessions: int,
    *,
    seed: int = 0,
    out: str | os.PathLike,
    overwrite: bool = False,
    progress: Tell = lambda event: None,
) -> Found:
    """Run the experiments, or go on with them.

    **Arguments:** `out`: folder where what is finished is kept, by all that decides it:
    nothing of another experiment is replaced, whatever `overwrite`.
    """
    rng = np.random.default_rng([seed, sessions])
    aside = np.radians(rng.uniform(-_MOST_DEG, _MOST_DEG, (sessions, 3)))
    makers, errors, pictures = experiments(), {}, {}
    total = len(makers) * sessions
    for number, (name, make) in enumerate(makers.items()):
        source, roll = make(), np.radians(_ROLL_DEG) * (name == "inclined pipe")
        offsets = (aside * [1, 1, 0] + [0, 0, roll]).astype(np.float32)
        scores = []
        for n, offset in enumerate(offsets):
            progress(Progress(number * sessions + n, total, name, unit="sessions"))
            parts = (
                name,
                source,
                camera,
                offset,
                _SPATIAL,
                _TEMPORAL,
                _ROUNDS,
                _GHOSTS,
            )
            compute = lambda given=(name, source, camera, offset): _codes(*given)
            codes = kept(Path(out) / "batches", f"{name}_{n}", parts, compute)
            scores.append(judged.scored(codes))
            pictures.setdefault(name, codes[-1] / 255)
        errors[name] = judged.Errors(*np.moveaxis(np.array(scores), 0, -1))
    progress(Progress(total, total, "timing", unit="sessions"))
    return Found(
        title=TITLE,
        about=_about(camera, sessions),
        claims=[*judged.judge(errors), judged.on_cost(_times(camera))],
        measured=judged.measured(errors),
        cases=["pipe"],
        lines=[judged.NOT_SIMULATED],
        tables={},
        pictures=pictures,
    )


def _about(camera: Camera, sessions: int) -> str:
    return (
        f"{sessions} sessions, each looking up to {_MOST_DEG:g} deg aside, "
        f"{camera.width_px} x {camera.height_px} px. Static tests: the camera stands "
        f"still and jitters, {16 * _ROUNDS} frames, the last is measured; ghosting: "
        f"things move, frames {', '.join(map(str, _GHOSTS))} are. Reference: mean of "
        "128 renders, gamma; all in 8 bits, as in the thesis. Its units of depth, of "
        "which ten are an edge, are taken as metres. Nearest of our scenes: "
        f"the inclined camera is rolled by {_ROLL_DEG:g} deg; wall_text stands for "
        f"hard edges (table 5.8); hairballs have {_HAIRS} hairs, those that turn "
        f"{_TURN_RAD_S:g} rad/s. Intervals (95 %) are over sessions, paired."
    )
