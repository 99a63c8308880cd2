"""Ghosts: error over time as a sphere flies by, and error against rotation speed.

Each technique shows a sphere that flies by before a head at rest, and the same before a
head that turns evenly. What it shows is held against the accumulated picture
of the same pose and time. Writes `ghosting.md` and a picture.

    python examples/ghosting.py --side 128
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pages
from jaxtyping import Array, Float
from matplotlib.ticker import FixedLocator

import hmdjit as hj
from hmdjit.camera import Region
from hmdjit.figures import drawing
from hmdjit.frames.displacement import GATHER
from hmdjit.frames.motion import Motion
from hmdjit.frames.sources import AbstractSource, View
from hmdjit.scenes.solid_set import moving_sphere
from hmdjit.simulation.views import Pattern, Renderer
from hmdjit.technique_contract.base import AbstractTechnique, AbstractTemporal

TECHNIQUES = ("none", "head_movement")
TECHNIQUES += tuple(
    id
    for id in hj.techniques.IDS
    if isinstance(hj.techniques.by_id(id), AbstractTemporal)
)
RATE_HZ, FRAMES, WARMUP = 60.0, 24, 8
SPEEDS_DEG = (0.0, 0.1, 0.3, 1.0, 3.0, 10.0)  # per frame


@jax.jit
def references(
    source: AbstractSource, camera: hj.Camera, motion: Motion
) -> Float[Array, "frames 3 height width"]:
    """Accumulated pictures of all poses."""
    region, steps = (
        Region.whole(camera),
        jnp.arange(len(motion.offset), dtype=jnp.int32),
    )
    look = lambda now, k: source.reference(View(camera, region, now, k, GATHER))
    return jax.lax.map(lambda step: look(*step), (motion, steps))


@jax.jit
def squared_error(
    technique: AbstractTechnique,
    source: AbstractSource,
    camera: hj.Camera,
    motion: Motion,
    true: Float[Array, "frames 3 height width"],
) -> Float[Array, " frames"]:
    """MSE of each frame, code values squared."""
    renderer, region = Renderer(source, camera, GATHER), Region.whole(camera)
    pattern = Pattern.of(technique, source.gives)
    frame = lambda k, now: renderer.frame(pattern, region, k, now)
    start = technique.init(frame(0, jax.tree.map(lambda leaf: leaf[0], motion)))

    def step(state: object, now: tuple) -> tuple[object, Array]:
        k, moved, expected = now
        state, shown = technique.step(state, frame(k, moved), moved)
        return state, jnp.mean((255 * (shown - expected)) ** 2)

    steps = jnp.arange(len(motion.offset), dtype=jnp.int32)
    return jax.lax.scan(step, start, (steps, motion, true))[1]


def turning(speed_deg: float, frames: int) -> Motion:
    """Return an even turn about the vertical axis, deg per frame, that ends ahead."""
    yaw = np.radians(speed_deg) * (np.arange(frames) - (frames - 1))
    turns = np.stack([0 * yaw, yaw, 0 * yaw], axis=1)
    steps = np.diff(turns, axis=0, prepend=turns[:1])
    return Motion(jnp.asarray(turns, jnp.float32), jnp.asarray(steps, jnp.float32))


@drawing.styled
def draw(
    over_time: dict[str, np.ndarray],
    by_speed: dict[str, np.ndarray],
    side: int,
    path: Path,
) -> None:
    """Draw both experiments."""
    footer = f"{side} x {side} px, {RATE_HZ:g} Hz."
    figure, (panels,) = drawing.panels(13, 5.5, footer, columns=2)
    for i, id in enumerate(over_time):
        look = {"color": drawing.COLOURS[i % 7], "ls": drawing.DASHES[i // 7]}
        panels[0].plot(1 + np.arange(len(over_time[id])), over_time[id], **look)
        panels[1].plot(SPEEDS_DEG, by_speed[id], marker="o", ms=3, label=id, **look)
    panels[0].set(title="A sphere flies by, a head at rest", xlabel="frame")
    panels[0].set_ylabel("mean squared error, code values²")
    panels[1].set(title="A head that turns", xlabel="degrees per frame")
    panels[1].set_xscale("symlog", linthresh=0.1)
    drawing.label_ticks(panels[1].xaxis, FixedLocator(SPEEDS_DEG))
    panels[1].legend(loc="upper left", bbox_to_anchor=(1, 1))
    drawing.save(figure, path)


def main() -> None:
    """Simulate, and write the page."""
    parser = pages.arguments(__file__, __doc__)
    parser.add_argument("--side", type=int, default=128)
    parser.add_argument("--techniques", nargs="+", default=list(TECHNIQUES))
    options = parser.parse_args()
    camera = hj.Camera(options.side, options.side, 48.0, RATE_HZ)
    sphere, found = moving_sphere(), []
    motions = [turning(speed, FRAMES) for speed in (0.0, *SPEEDS_DEG[1:])]
    true = [references(sphere, camera, motion) for motion in motions]
    for id in options.techniques:
        technique = hj.techniques.by_id(id)
        errors = [
            np.asarray(squared_error(technique, sphere, camera, *pair))
            for pair in zip(motions, true, strict=True)
        ]
        found.append((id, errors))
        print(id, flush=True)
    over_time = {id: errors[0] for id, errors in found}
    by_speed = {
        id: np.array([each[WARMUP:].mean() for each in errors]) for id, errors in found
    }
    draw(over_time, by_speed, options.side, options.out.with_suffix(".png"))
    head = ["technique"] + [f"{speed:g}° per frame" for speed in SPEEDS_DEG]
    rows = [(f"`{id}`", *(f"{x:.1f}" for x in by_speed[id])) for id in by_speed]
    blocks = {"errors": pages.table(head, rows)}
    pages.write(__file__, blocks, options.out)


if __name__ == "__main__":
    main()
