"""Regions that move by themselves: what blending them costs, and how they are found.

Runs head movement with each way of leaving out what moves on scenes with and without
moving things, 256 x 256 px, a seated head on its neck. *known* is a mask that nobody
has in a headset without asking the renderer for more: what moves, and what a thing that
moves has uncovered. Writes `dynamic_regions.md` and a figure beside it.

    python examples/dynamic_regions.py --sessions 8
"""

import dataclasses
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pages
from jaxtyping import Array
from scipy import stats

import hmdjit as hj
from hmdjit import rendering, reprojection
from hmdjit.figures import drawing
from hmdjit.filters import dynamic_regions
from hmdjit.frames.displacement import SLICES
from hmdjit.frames.frame import Frame
from hmdjit.frames.motion import Motion, checked_motion
from hmdjit.frames.neck import NeckModel
from hmdjit.frames.sources import History
from hmdjit.scenes.solid_set import SOLIDS, hut
from hmdjit.scenes.solids import Solids
from hmdjit.simulation import blocks
from hmdjit.studies.identity import made_by
from hmdjit.techniques import HeadMovement

SCENES: dict[str, Callable[[], Any]] = {
    name: SOLIDS[name] for name in ("moving_sphere", "hut", "fence")
}
SCENES["hut_without_shadows"] = lambda: hut(shadows=False)
SCENES |= {name: SOLIDS[name] for name in ("flowers", "blinds")}  # nothing moves
SIDE_PX, WARMUP, FRAMES = 256, 8, 16
HELD = np.array([15, 23])  # frames that are held against the reference
CAMERA = hj.Camera(SIDE_PX, SIDE_PX, 45.0, 60.0)
WHOLE = hj.Region.whole(CAMERA)
CHANNELS = frozenset({"color", "motion_class"})
KIM = HeadMovement()
TECHNIQUES = {
    "none": KIM,
    "classes": HeadMovement(dynamic="classes"),
    "frames": HeadMovement(dynamic="frames"),
    "known": KIM,  # with a mask given
}
MASKS = tuple(TECHNIQUES)
AGES, BEHIND = 12, 4  # frames since a pixel was uncovered: drawn, and averaged
VISIBLE = 8 / 255  # of the RGB distance


def distance(one: Array, other: Array) -> Array:
    """RGB distance of two pictures, per pixel."""
    return jnp.sqrt(jnp.sum((one - other) ** 2, axis=0))


def mean_over(values: Array, where: Array) -> Array:
    """Mean over some pixels; NaN if there is none."""
    return jnp.sum(jnp.where(where, values, 0.0)) / jnp.sum(where)


class Seen(NamedTuple):
    """One frame of a session: pictures, masks, and how long ago pixels were uncovered.

    - `shown`: by each of `MASKS`, gamma.
    - `masks`: of all but `none`.
    - `age`: frames since a thing that moves uncovered the pixel; -1 of the thing.
    """

    color: Array
    shown: dict[str, Array]
    masks: dict[str, Array]
    age: Array


class Rendered(NamedTuple):
    """A session as it is rendered, `(frames, ...)`; of some frames a reference."""

    color: Array
    motion_class: Array
    reference: Array


@jax.jit
def rendered(source: Solids, motion: Motion) -> Rendered:
    """Render a session."""

    def look(now: tuple[Array, Motion]) -> tuple[Array, Array]:
        k, head = now
        each = {"frame": k, "channels": CHANNELS}
        frame = rendering.render(source, CAMERA, WHOLE, head, np.zeros((1, 2)), **each)
        return frame.color[0], frame.motion_class

    def hold(now: tuple[Array, Motion]) -> Array:
        return rendering.reference(source, CAMERA, WHOLE, now[1], frame=now[0])

    k = jnp.arange(WARMUP + FRAMES, dtype=jnp.int32)
    held = jax.tree.map(lambda leaf: leaf[HELD], (k, motion))
    colors, seen = jax.lax.map(look, (k, motion))
    return Rendered(colors, seen, jax.lax.map(hold, held))


def advance(carry: tuple, now: tuple[Array, Array, Motion]) -> tuple:
    """Step all techniques; return also what is seen, and what is measured of it."""
    states, before = carry
    color, motion_class, head = now
    channels = {"motion_class": motion_class[None, None]}
    frame = Frame(color[None], CAMERA, WHOLE, channels=channels)
    moves = motion_class > 0
    moved = History.of((before.age < 0).astype(color.dtype)[None])
    uncovered = ~moves & (moved.at(frame.displacement(head.increment))[0] > 0)
    age = jnp.where(moves, -1, jnp.where(uncovered, 0, before.age + 1))
    past = reprojection.past_position(frame, head.increment, KIM.closeness[0])
    found = dynamic_regions.unexplained(color, states["frames"].at(past))
    masks = {"classes": moves, "frames": found & past.inside()}
    masks["known"] = moves | uncovered
    given = dataclasses.replace(frame, static_mask=~masks["known"])
    states, shown = dict(states), {}
    for name, technique in TECHNIQUES.items():
        asked = given if name == "known" else frame
        states[name], shown[name] = technique.step(states[name], asked, head)
    seen = Seen(color, shown, masks, age)
    return (states, seen), (seen, measured(seen, before))


def measured(seen: Seen, before: Seen) -> dict[str, Array]:
    """Numbers of a frame; NaN where there is nothing to measure."""
    age, found = seen.age, seen.masks["frames"]
    moves, uncovered, changed = age < 0, age == 0, seen.masks["known"]
    off = {name: distance(shown, seen.color) for name, shown in seen.shown.items()}
    numbers = {
        "precision": jnp.where(changed.any(), mean_over(changed, found), jnp.nan),
        "precision, moves": jnp.where(moves.any(), mean_over(moves, found), jnp.nan),
        "recall, moves": mean_over(found, moves),
        "recall, uncovered": mean_over(found, uncovered),
        "recall, visible": mean_over(found, changed & (off["none"] > VISIBLE)),
        "false": mean_over(found, age >= AGES),
        "rest": mean_over(distance(seen.color, before.color), age >= AGES),
    }
    for name in MASKS:
        change = distance(seen.shown[name], before.shown[name])
        numbers[f"mtcd {name}"] = change.mean()
        numbers[f"rest {name}"] = mean_over(change, age >= AGES)
        numbers[f"behind {name}"] = mean_over(off[name], (age >= 0) & (age < BEHIND))
        trail = [mean_over(off[name], age == a) for a in range(AGES)]
        numbers[f"trail {name}"] = jnp.stack(trail)
    return numbers


@jax.jit
def session(of: Rendered, motion: Motion) -> tuple[Seen, dict[str, Array]]:
    """Run a session; return its last frame, and what is measured of each frame."""
    color, moves = of.color[0], of.motion_class[0] > 0
    states = {name: History.of(color) for name in MASKS}
    blank = {name: jnp.zeros_like(moves) for name in MASKS[1:]}
    seen = Seen(color, dict.fromkeys(MASKS, color), blank, jnp.where(moves, -1, AGES))
    frames = of.color, of.motion_class, motion
    _, (pictures, numbers) = jax.lax.scan(advance, (states, seen), frames)
    last = jax.tree.map(lambda leaf: leaf[-1], pictures)
    numbers = {name: each[WARMUP:] for name, each in numbers.items()}
    for name, shown in pictures.shown.items():
        error = (shown[HELD] - of.reference) ** 2
        numbers[f"loss {name}"] = jnp.mean(error, axis=(1, 2, 3))
    return last, numbers


def sessions(scene: str, count: int) -> tuple[Seen, dict[str, np.ndarray]]:
    """Last frame of the first session, and means over frames, `(sessions, ...)`."""
    found, last = [], None
    for key in jax.random.split(jax.random.key(0), count):
        poses = hj.HeadMotion.seated().sample(key, 60.0, WARMUP + FRAMES)
        motion = NeckModel().moved(checked_motion(poses, jnp.float32))
        seen, numbers = session(rendered(SCENES[scene](), motion), motion)
        last = seen if last is None else last
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Mean of empty slice")
            found.append({n: np.nanmean(v, axis=0) for n, v in numbers.items()})
    assert last is not None
    return last, {name: np.stack([one[name] for one in found]) for name in found[0]}


def half_width(values: np.ndarray) -> np.ndarray:
    """Half of the 95 % interval of means over sessions, by Student's t."""
    count = len(values)
    return stats.t.ppf(0.975, count - 1) * values.std(axis=0, ddof=1) / count**0.5


def cell(values: np.ndarray, scale: float = 1.0, form: str = ".1f") -> str:
    """Mean over sessions, and half of its interval."""
    if np.isnan(values).any():
        return "-"
    mean, half = scale * values.mean(), scale * float(half_width(values))
    return f"{mean:{form}} ± {half:{form}}"


def finding(scene: str, of: dict[str, np.ndarray]) -> tuple[str, ...]:
    """Row of the table of masks, per cent."""
    names = ("precision", "precision, moves", "recall, moves", "recall, uncovered")
    names += ("recall, visible",)
    cells = [cell(of[name], 100, ".0f") for name in names]
    return scene, *cells, cell(of["false"], 100, ".2f")


def effects(scene: str, of: dict[str, np.ndarray]) -> list[tuple[str, ...]]:
    """Rows of the table of effects."""
    rows = []
    for name in MASKS:
        ratio = of[f"rest {name}"] / of["rest"]
        row = (scene, name, cell(of[f"mtcd {name}"], 255, ".2f"))
        row += (cell(ratio, 1, ".3f"), cell(of[f"loss {name}"], 255**2, ".1f"))
        rows.append((*row, cell(of[f"behind {name}"], 255)))
    return rows


def ns_per_pixel(technique: HeadMovement, repeats: int = 15) -> float:
    """How long a step takes on one core, 512 x 512 px of noise and a plane, moved."""
    camera, frames = hj.Camera(512, 512, 48.0, 60.0), 16
    region, size = hj.Region.whole(camera), (512, 512)
    noise = jax.random.uniform(jax.random.key(0), (1, 3, *size))
    depth = jnp.broadcast_to(jnp.linspace(1.0, 3.0, 512), (1, 1, *size))
    classes = jnp.zeros((1, 1, *size), jnp.int32)
    turn = jnp.full((frames, 3), 1e-4)
    head = Motion(turn, turn, turn, jnp.full((frames, 3), 1e-4))
    channels = {"depth": depth, "motion_class": classes}
    channels = {name: channels[name] for name in technique.needs - {"color"}}
    start = Frame(noise, camera, region, None, SLICES, channels)

    @jax.jit
    def run(frame: Frame) -> Array:
        # Histories that are read by slices have a rim.
        kept = lambda state: blocks.kept(state, region, blocks.RIM_PX)
        step = lambda state, now: (kept(technique.step(state, frame, now)[0]), None)
        state, _ = jax.lax.scan(step, kept(technique.init(frame)), head)
        return state.texels.mean()

    seconds = []
    for _ in range(1 + repeats):  # the first compiles
        begun = time.perf_counter()
        run(start).block_until_ready()
        seconds.append(time.perf_counter() - begun)
    return 1e9 * min(seconds[1:]) / (frames * 512**2)


@drawing.styled
def draw(last: Seen, of: dict[str, np.ndarray], out: Path) -> None:
    """Draw masks of the moving sphere's last frame, and errors behind it over time."""
    footer = f"moving_sphere, {SIDE_PX} px, seated head; {made_by()}"
    figure, ((left, middle, right),) = drawing.panels(11, 3.7, footer, 1, 3)
    colour = np.moveaxis(np.asarray(last.shown["none"]), 0, -1)
    rows, columns = np.nonzero(np.asarray(last.masks["known"]))
    area = (slice(max(rows.min() - 30, 0), rows.max() + 30),)
    area += (slice(max(columns.min() - 60, 0), columns.max() + 20),)
    names = {"known": "What moves or was uncovered", "frames": "Found from frames"}
    for axes, (name, title) in zip((left, middle), names.items(), strict=True):
        mask = np.asarray(last.masks[name])[..., None]
        tint = np.array([0.0, 0.45, 0.7])
        axes.imshow(np.where(mask, 0.35 * colour + 0.65 * tint, colour)[area])
        axes.set_title(title)
        axes.set_axis_off()
    for number, name in enumerate(MASKS):
        trail = 255 * of[f"trail {name}"]
        mean, half = trail.mean(axis=0), half_width(trail)
        style = {"color": drawing.COLOURS[number], "label": name}
        right.plot(np.arange(AGES), mean, ls=drawing.DASHES[number], **style)
        bounds = (mean - half, mean + half)
        right.fill_between(
            np.arange(AGES), *bounds, color=style["color"], alpha=0.2, lw=0
        )
    right.set_title("Error behind the sphere")
    right.set(xlabel="frames since uncovered", ylabel="RGB distance, code values")
    right.set_ylim(bottom=0)
    right.legend()
    print(f"Wrote {drawing.save(figure, out)}.")


def main() -> None:
    """Measure, and fill the page."""
    parser = pages.arguments(__file__, __doc__)
    parser.add_argument("--sessions", type=int, default=8)
    parser.add_argument("--scenes", nargs="+", default=list(SCENES))
    options = parser.parse_args()
    masks, rows = [], []
    for scene in options.scenes:
        last, of = sessions(scene, options.sessions)
        masks.append(finding(scene, of))
        rows += effects(scene, of)
        if scene == "moving_sphere":
            draw(last, of, options.out.with_suffix(".png"))
    head = ("scene", "precision, %", "of what moves, %", "recall of what moves, %")
    head += ("of uncovered, %", "of visible errors, %", "false alarms, %")
    found = pages.table(head, masks)
    head = ("scene", "mask", "MTCD, code values", "ratio where nothing moved")
    head += ("detail loss, code values²", "error behind, code values")
    effect = pages.table(head, rows)
    timed = [HeadMovement(dynamic=name) for name in MASKS[:3]]
    timed += [HeadMovement(reprojects="rigid")]
    cost = [(f"`{each.id}`", f"{ns_per_pixel(each):.1f}") for each in timed]
    costs = pages.table(("technique", "ns per pixel"), cost)
    blocks_ = {"found": found, "effects": effect, "costs": costs}
    pages.write(__file__, blocks_, options.out)


if __name__ == "__main__":
    main()
