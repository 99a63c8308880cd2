"""Temporal anti-aliasing improved with Sobel and model indices (Oliveros' thesis).

Static tests: a camera that stands still, whose pictures are held against the
accumulation buffer's. Ghosting tests: the same of things that move, frame by frame.
Pictures are what a display has, eight bits, and means are of gamma colours, as there.
"""

import dataclasses
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.stats import qmc

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
from .timing import times

TITLE = "Temporal anti-aliasing improved with Sobel and model indices (a thesis)"
CAMERA = Camera(width_px=64, height_px=64, fov_deg=18.0, refresh_hz=60.0)
SESSIONS, QUICK_SESSIONS = 64, 16

_FRAMES = 16  # of the jitter
_ROUNDS = 4  # of it, before a static picture is looked at
_SHARE = (
    4  # of sessions: one in so many sees what moves and what has hairs, the dearest
)
_HAIRY = {"hairball shadow", "hairball"}
_MOST_DEG = 2.0  # that a session looks aside
_ROLL_DEG = 20.0  # of the inclined camera
_TURN_RAD_S = 1.0  # of the hairball
_HAIRS = 200
_CHUNK = 16  # samples that are rendered at once: those of the smaller reference
_SPATIAL = NoAntialiasing(), FXAA(), SMAA(preset="ultra", edges="color")
_TEMPORAL = ThesisBaseline(), SobelTAA()


class Shown(NamedTuple):
    """What is seen of a session: what techniques read, and the reference.

    - `jittered`: frames, in the jitter's order.
    - `centre`: of the frame that is looked at, colour at pixels' centres.
    - `truths`: of that frame, means of 16 and of 128 renders.
    """

    jittered: Frame
    centre: Float[Array, "3 height width"]
    truths: Float[Array, "2 3 height width"]


def turning(ball: Solids, rate_rad_s: float) -> Solids:
    """Return a hairball that turns about its own axis, or stands still in its place."""
    turn = Movement(rotation_rad_s=(0.0, rate_rad_s, 0.0), pivot_m=(0.0, 0.0, -1.9))
    classes = np.array([0, 1], np.int32)
    return dataclasses.replace(
        ball, paths=Paths.of([turn]), classes=classes, moves=True
    )


def experiments() -> dict[str, Callable[[], Solids]]:
    """Return what makes the scene nearest to each table's, by names of `judged`."""
    hairs = lambda rate: turning(scenes.hairball(hairs=_HAIRS), rate)
    shadow = lambda rate: turning(scenes.hairball_shadow(hairs=_HAIRS), rate)
    return {
        "pipe": scenes.pipe,
        "inclined pipe": scenes.pipe,
        "blinds": scenes.blinds,
        "arched window": scenes.arched_window,
        "atrium": scenes.atrium,
        "flowers": scenes.flowers,
        "hard edges": scenes.wall_text,
        "hairball shadow": lambda: shadow(0.0),  # in the program of those that turn
        "hairball": lambda: hairs(0.0),
        "moving sphere": scenes.moving_sphere,
        "turning shadow": lambda: shadow(_TURN_RAD_S),
        "turning hairball": lambda: hairs(_TURN_RAD_S),
    }


@jax.jit
def _rendered(
    source: AbstractSource,
    camera: Camera,
    offset: Float[Array, "3"],
    looked: Int[Array, ""],
) -> Shown:
    """Render frames as temporal techniques see them, and the one that is looked at."""
    zero = jnp.zeros(3)
    region, still = Region.whole(camera), Motion(offset.astype(zero.dtype), zero)
    renderer = Renderer(source, camera, fastest_reading())
    pattern = Pattern.of(SobelTAA(), source.gives)
    samples = accumulation(128).reshape(-1, _CHUNK, 2)
    # One program renders all: the pixel's centre goes with each chunk.
    places = jnp.asarray(np.pad(samples, ((0, 0), (1, 0), (0, 0))), zero.dtype)

    def jittered(k: Array) -> Frame:
        frame = renderer.frame(pattern, region, k, still)
        # One program shows all: nothing depends on what the scene is, or if it moves.
        rest = jnp.zeros((1, 2, *frame.color.shape[-2:]), frame.color.dtype)
        channels = {"velocity": rest, **frame.channels}
        return dataclasses.replace(frame, channels=channels, steps=None)

    def chunk(some: Array) -> tuple[Array, Array]:
        seen = rendering.render(source, camera, region, still, some, frame=looked)
        return seen.color[0], seen.color[1:].mean(axis=0)

    centres, means = jax.lax.map(chunk, places)
    truths = jnp.stack([means[0], means.mean(axis=0)])
    return Shown(jax.lax.map(jittered, jnp.arange(_FRAMES)), centres[0], truths)


@jax.jit
def _pictures(
    seen: Shown, rounds: Int[Array, ""]
) -> Float[Array, "picture 3 height width"]:
    """Show the last frame after rounds of them all, and the references behind it."""
    pick = lambda k: jax.tree.map(lambda leaf: leaf[k], seen.jittered)
    still = Motion(jnp.zeros(3), jnp.zeros(3))
    sharp = Sharpening("xu"), Sharpening("thesis")

    def step(k: Array, last: tuple[list, list]) -> tuple[list, list]:
        frame = pick(k % _FRAMES)
        pairs = zip(_TEMPORAL, last[0], strict=True)
        now = [technique.step(state, frame, still) for technique, state in pairs]
        return [state for state, _ in now], [picture for _, picture in now]

    states = [technique.init(pick(0)) for technique in _TEMPORAL]
    first = states, [jnp.zeros_like(seen.centre)] * len(_TEMPORAL)
    states, shown = jax.lax.fori_loop(0, rounds * _FRAMES, step, first)
    uncharted, master = _kept(states[0]), _kept(states[1].shown)
    last = pick(_FRAMES - 1)
    shown += [sharp[1].show(uncharted, last, still), sharp[0].show(master, last, still)]
    plain = dataclasses.replace(pick(0), color=seen.centre[None], jitter_px=None)
    spatial = [technique.resolve(plain) for technique in _SPATIAL]
    return jnp.stack([*spatial, *shown, uncharted, master, *seen.truths])


def _kept(history: History) -> Array:
    return history.texels[0, 0, :3]


def _codes(name: str, source: Solids, camera: Camera, offset: np.ndarray) -> np.ndarray:
    """Pictures of a session, `(picture, height, width, 3)`, 8 bits."""
    is_static = name in judged.STATIC
    seen = _rendered(source, camera, offset, 0 if is_static else _FRAMES - 1)
    pictures = np.asarray(_pictures(seen, _ROUNDS if is_static else 1))
    return np.moveaxis(np.rint(255 * pictures.clip(0, 1)).astype(np.uint8), 1, -1)


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
    # Spread evenly, so that seeds differ less than intervals, of random ones, allow.
    places = qmc.Halton(2, rng=np.random.default_rng([seed, sessions])).random(sessions)
    aside = np.radians(_MOST_DEG * (2 * places - 1))
    makers, errors, pictures = experiments(), {}, {}
    counts = {name: _count(name, sessions) for name in makers}
    done, total = 0, sum(counts.values())
    for name, make in makers.items():
        source, roll = make(), np.radians(_ROLL_DEG) * (name == "inclined pipe")
        scores = []
        for n in range(counts[name]):
            progress(Progress(done, total, name, unit="sessions"))
            given = name, source, camera, np.array([*aside[n], roll], np.float32)
            parts = (*given, _SPATIAL, _TEMPORAL, _FRAMES, _ROUNDS)
            compute = lambda given=given: _codes(*given)
            codes = kept(Path(out) / "batches", f"{name}_{n}", parts, compute)
            scores.append(judged.scored(codes))
            pictures.setdefault(name, codes / 255)
            done += 1
        errors[name] = judged.Errors(*np.moveaxis(np.array(scores), 0, -1))
    progress(Progress(total, total, "timing", unit="sessions"))
    seconds = times(scenes.pipe(), camera, _TEMPORAL)
    return Found(
        title=TITLE,
        about=_about(camera, counts),
        claims=[*judged.judge(errors), judged.on_cost(seconds)],
        measured=judged.measured(errors),
        cases=["pipe"],
        lines=[judged.NOT_SIMULATED],
        tables={},
        pictures=pictures,
    )


def _count(name: str, sessions: int) -> int:
    is_dear = name in judged.GHOSTING or name in _HAIRY
    return max(2, sessions // _SHARE) if is_dear else sessions


def _about(camera: Camera, counts: Mapping[str, int]) -> str:
    return (
        f"{max(counts.values())} sessions ({min(counts.values())} of what moves or has "
        f"hairs), each looking up to {_MOST_DEG:g} deg aside, {camera.width_px} x "
        f"{camera.height_px} px without the outer {judged.BORDER_PX}. Static tests: "
        f"the camera stands still and jitters, {_FRAMES * _ROUNDS} frames, the last is "
        f"measured; ghosting: things move, of {_FRAMES} frames the last is. Reference: "
        "mean of 128 renders, gamma; all in 8 bits, as in the thesis. Its units "
        "of depth, of which ten are an edge, are taken as metres. Nearest of our "
        f"scenes: the inclined camera is rolled by {_ROLL_DEG:g} deg; wall_text stands "
        f"for hard edges (table 5.8); hairballs have {_HAIRS} hairs, those that turn "
        f"{_TURN_RAD_S:g} rad/s. Errors within {100 * judged.ALIKE:g} % are alike. "
        "Intervals (95 %) are over sessions, paired, by Student's t."
    )
