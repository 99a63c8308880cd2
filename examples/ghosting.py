"""Ghosts: the error behind a sphere that flies by, over time and against a turn.

Seated heads on their necks, which may turn evenly as well, see a sphere that uncovers
what is behind it. What each technique shows there is held against the accumulated
picture of the same pose and time, by how long ago the sphere was there; that is told by
the scene, seen from where the head is now, as it was before. Writes `ghosting.md` and
two pictures.

    python examples/ghosting.py --side 160 --heads 4
"""

import functools
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pages
from jaxtyping import Array, Float, Int
from matplotlib.ticker import FixedLocator
from scipy import stats

import hmdjit as hj
from hmdjit import quaternion, rendering
from hmdjit.camera import Region
from hmdjit.figures import drawing
from hmdjit.frames.displacement import GATHER
from hmdjit.frames.frame import Frame
from hmdjit.frames.motion import Motion
from hmdjit.frames.neck import NeckModel
from hmdjit.scenes.solid_set import moving_sphere
from hmdjit.scenes.solids import Solids
from hmdjit.simulation.views import Pattern, Renderer
from hmdjit.studies.identity import made_by
from hmdjit.technique_contract.base import AbstractTechnique, AbstractTemporal

TECHNIQUES = [
    id
    for id in hj.techniques.IDS
    if id.startswith(("none", "head_movement"))
    or isinstance(hj.techniques.by_id(id), AbstractTemporal)
]
RATE_HZ, FRAMES, HELD = 60.0, 24, 6  # of a session; held against a reference, the last
SPEEDS_DEG = (0.0, 1.0, 3.0)  # of the turn, per frame
AGES, BEHIND = 12, 4  # frames since a pixel was uncovered: drawn, and averaged
STEPS = jnp.arange(FRAMES, dtype=jnp.int32)


def turned(seated: Motion, speed_deg: float) -> Motion:
    """Add an even turn about the vertical axis, deg per frame, that ends ahead."""
    yaw = np.radians(speed_deg) * (np.arange(FRAMES) - (FRAMES - 1))
    turn = jnp.asarray(np.stack([0 * yaw, yaw, 0 * yaw], axis=1), jnp.float32)
    together = lambda a, b: quaternion.multiply(quaternion.exp(a), quaternion.exp(b))
    poses = jax.vmap(together)(turn, seated.offset)
    offsets = jax.vmap(quaternion.log)(poses)
    return NeckModel().moved(Motion(offsets, quaternion.increments(poses)))


@jax.jit
def truth(
    source: Solids, camera: hj.Camera, motion: Motion
) -> tuple[Float[Array, "held 3 height width"], Int[Array, "held height width"]]:
    """Accumulated pictures, and frames since the sphere left; -1 on it, else `AGES`."""
    region = Region.whole(camera)

    def covered(k: Array, now: Motion, ago: Array) -> Array:
        given = {"frame": k - ago, "channels": {"color", "motion_class"}}
        seen = rendering.render(source, camera, region, now, np.zeros((1, 2)), **given)
        return seen.motion_class > 0

    def look(k: Array, now: Motion) -> tuple[Array, Array]:
        picture = rendering.reference(source, camera, region, now, frame=k)
        was = jax.lax.map(lambda ago: covered(k, now, ago), jnp.arange(AGES + 1))
        age = jnp.where(was.any(axis=0), jnp.argmax(was, axis=0) - 1, AGES)
        return picture, age

    held = jax.tree.map(lambda leaf: leaf[-HELD:], (STEPS, motion))
    return jax.lax.map(lambda step: look(*step), held)


@functools.partial(jax.jit, static_argnames="pattern")
def rendered(
    pattern: Pattern, source: Solids, camera: hj.Camera, motion: Motion
) -> Frame:
    """Frames of a session, sampled in one way."""
    renderer, region = Renderer(source, camera, GATHER), Region.whole(camera)
    look = lambda step: renderer.frame(pattern, region, *step)
    return jax.lax.map(look, (STEPS, motion))


@jax.jit
def errors(
    technique: AbstractTechnique,
    frames: Frame,
    motion: Motion,
    true: tuple[Array, Array],
) -> Float[Array, " ages"]:
    """RMSE, code values, by frames since uncovered.

    Then where the sphere was not, and of all that was uncovered of late.
    """
    start = technique.init(jax.tree.map(lambda leaf: leaf[0], frames))
    _, shown = jax.lax.scan(
        lambda state, step: technique.step(state, *step), start, (frames, motion)
    )
    pictures, age = true
    squares = jnp.mean((255 * (shown[-HELD:] - pictures)) ** 2, axis=1)
    of_age = age == jnp.arange(AGES + 1)[:, None, None, None]
    sums = jnp.sum(jnp.where(of_age, squares, 0), axis=(1, 2, 3))
    counts = of_age.sum(axis=(1, 2, 3))
    late = sums[:BEHIND].sum() / counts[:BEHIND].sum()
    return jnp.sqrt(jnp.concatenate([sums / counts, late[None]]))


def interval(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean over heads, the second axis from the end; half of Student's 95 %."""
    count = values.shape[-2]
    spread = values.std(axis=-2, ddof=1) / count**0.5
    return values.mean(axis=-2), stats.t.ppf(0.975, count - 1) * spread


@drawing.styled
def draw(
    found: dict[str, np.ndarray], side: int, path: Path, *, against_speed: bool
) -> None:
    """Draw a panel per technique: over time, or against the turn's speed."""
    heads = next(iter(found.values())).shape[1]
    footer = f"moving_sphere, {side} x {side} px, {RATE_HZ:g} Hz; bands: 95 % of "
    footer += f"{heads} seated heads; grey: none, likewise. {made_by()}"
    options = {"sharex": True, "sharey": True}
    rows = -(-(len(found) - 1) // 5)
    figure, panels = drawing.panels(12, 2.3 * rows + 0.4, footer, rows, 5, **options)
    whiches = (AGES + 1, AGES) if against_speed else (0, -1)
    names = ["a seated head", f"that turns by {SPEEDS_DEG[-1]:g}° per frame"]
    if against_speed:
        names = [f"0 to {BEHIND - 1} frames behind", "where the sphere was not"]
    x = np.arange(len(SPEEDS_DEG)) if against_speed else np.arange(AGES)

    def curve(id: str, which: int) -> tuple[np.ndarray, np.ndarray]:
        mean, half = interval(found[id])
        cut = (slice(None), which) if against_speed else (which, slice(AGES))
        return mean[cut], half[cut]

    for axes, id in zip(
        panels.flat, [id for id in found if id != "none"], strict=False
    ):
        for which, name, color in zip(whiches, names, drawing.COLOURS, strict=False):
            ls = "-" if color == drawing.BLUE else drawing.DASHES[1]
            axes.plot(x, curve("none", which)[0], color="0.7", ls=ls, lw=1)
            mean, half = curve(id, which)
            axes.plot(x, mean, color=color, ls=ls, label=name)
            bounds = (mean - half, mean + half)
            axes.fill_between(x, *bounds, color=color, alpha=0.2, lw=0)
        axes.set_title(id)
    for axes in panels.flat[len(found) - 1 :]:
        axes.set_axis_off()
    panels.flat[0].set_ylim(bottom=0)
    label = lambda value, _: f"{SPEEDS_DEG[round(value)]:g}"
    marks, said = x, "turn of the head, degrees per frame"
    if not against_speed:
        label, marks = "{x:g}", range(0, AGES, 4)
        said = "frames since the sphere uncovered the pixel"
    drawing.label_ticks(
        panels.flat[0].xaxis, FixedLocator([float(mark) for mark in marks]), label
    )
    figure.supxlabel(said, fontsize=drawing.NAME)
    figure.supylabel("RMS error, code values", fontsize=drawing.NAME)
    handles, labels = panels.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=2)
    drawing.save(figure, path)


def main() -> None:
    """Simulate, and write the page."""
    parser = pages.arguments(__file__, __doc__)
    parser.add_argument("--side", type=int, default=160)
    parser.add_argument("--heads", type=int, default=4)
    parser.add_argument("--techniques", nargs="+", default=TECHNIQUES)
    options = parser.parse_args()
    camera = hj.Camera(options.side, options.side, 48.0, RATE_HZ)
    sphere, keys = moving_sphere(), jax.random.split(jax.random.key(0), options.heads)
    seated = [
        Motion.of(hj.HeadMotion.seated().sample(key, RATE_HZ, FRAMES)) for key in keys
    ]
    sessions = [turned(head, speed) for speed in SPEEDS_DEG for head in seated]
    true = [jax.block_until_ready(truth(sphere, camera, each)) for each in sessions]
    print("references", flush=True)
    ids = dict.fromkeys(["none", *options.techniques])
    techniques = {id: hj.techniques.by_id(id) for id in ids}
    channels: dict[tuple, frozenset[str]] = {}  # each way to sample is rendered once
    for technique in techniques.values():
        samples, needed = Pattern.of(technique, sphere.gives)
        channels[samples] = channels.get(samples, frozenset()) | needed
    measured: dict[str, list[np.ndarray]] = {id: [] for id in techniques}
    for pattern in map(Pattern, channels, channels.values()):
        for motion, expected in zip(sessions, true, strict=True):
            frames = rendered(pattern, sphere, camera, motion)
            for id, each in techniques.items():
                if Pattern.of(each, sphere.gives).samples == pattern.samples:
                    error = errors(each, frames, motion, expected)
                    measured[id].append(np.asarray(error))
        done = [id for id, rows in measured.items() if rows]
        print(f"{len(done)} of {len(measured)}: {', '.join(done)}", flush=True)
    size = (len(SPEEDS_DEG), options.heads, -1)
    found = {id: np.reshape(rows, size) for id, rows in measured.items()}
    for name, against_speed in (("", False), ("-turning", True)):
        path = options.out.with_name(f"{options.out.stem}{name}.png")
        draw(found, options.side, path, against_speed=against_speed)
    head = ["technique", "where it was not"]
    head += [f"behind it, {speed:g}°" for speed in SPEEDS_DEG]
    rows = []
    for id, each in found.items():
        mean, half = interval(each)
        cells = [(mean[0, AGES], half[0, AGES])]
        cells += zip(mean[:, -1], half[:, -1], strict=True)
        rows.append((f"`{id}`", *(f"{m:.1f} ± {h:.1f}" for m, h in cells)))
    pages.write(__file__, {"errors": pages.table(head, rows)}, options.out)


if __name__ == "__main__":
    main()
