"""One session: a scan over frames, metrics reduced on the fly. No frame is stored.

Each pose is rendered once per sample pattern, and the reference once; all techniques of
a study step on that. Unbatched, not jitted: `simulate` and studies compile it.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .. import metrics as standard
from .._types import Rgb, WholeNumber
from ..camera import Camera, Region
from ..frames.displacement import AT_REST, GATHER, SLICES, Reading
from ..frames.motion import Motion
from ..frames.sources import AbstractSource
from ..metrics.base import AbstractMetric, Measured
from ..techniques.base import AbstractTechnique
from . import blocks
from .views import REFERENCE, Renderer, View, cropped, shows_its_history, view_of


class Result(eqx.Module):
    """What a session measures of a technique: each metric is an attribute by its id.

    - `metrics`: values by ids, such as `mtcd` and `detail_loss`.
    """

    metrics: Measured

    def __getattr__(self, name: str) -> Any:
        if name != "metrics" and name in self.metrics:
            return self.metrics[name]
        raise AttributeError(f"there is no metric {name!r} in this result.")


def session(
    source: AbstractSource,
    camera: Camera,
    techniques: tuple[AbstractTechnique, ...],
    motion: Motion,
    region: Region,
    measured: Region,
    *,
    warmup: int,
    reading: Reading = GATHER,
    metrics: tuple[AbstractMetric, ...] = standard.STANDARD,
) -> tuple[Result, ...]:
    """Simulate one session on one region, all techniques at once; not jitted.

    **Arguments:**

    - `motion`: of `warmup + frames` poses; the first offset is 0.
    - `region`: the pixels that are rendered and filtered.
    - `measured`: those that are measured; inside the region.
    - `warmup`: how many displayed frames are not measured; static.
    - `reading`: how sources are read; static.

    **Returns:** what was measured of each technique; NaN where the head leaves what the
    source covers, for a clamped read would look like a calm picture, and where a number
    of the camera or of the technique is out of its range.
    """
    renderer = Renderer(source, camera, techniques, reading)
    views = [view_of(technique) for technique in techniques]
    everyone = range(len(techniques))
    at_start = jax.tree.map(lambda leaf: leaf[0], motion)
    frames = [
        jax.eval_shape(partial(renderer.frame, v, region, 0), at_start) for v in views
    ]
    shapes = [jax.eval_shape(techniques[i].init, frames[i]) for i in everyone]
    # What keeps nothing shows each frame on its own: warm-up changes nothing of it.
    keeping = [i for i in everyone if jax.tree.leaves(shapes[i])]
    first = 0 if keeping else warmup
    early = {views[i] for i in keeping}
    # Whoever shows what it keeps needs no second copy of it.
    shows_kept = [
        shows_its_history(techniques[i], shapes[i], frames[i], at_start)
        for i in everyone
    ]
    has_reference = any(metric.needs_reference for metric in metrics)

    # A stencil would find no neighbours at a block's edge.
    is_local = [technique.stencil_radius_px == 0 for technique in techniques]
    is_cuttable = all(is_local) and blocks.is_cuttable(shapes)
    slices = reading.sampler == "slices"
    grid = blocks.cut(region) if slices and is_cuttable else blocks.uncut(region)
    is_whole = grid.count == 1
    rim_px = blocks.RIM_PX if slices else 0
    # Of a region in one piece only the measured part is kept of what is shown.
    shown_region = measured if is_whole else region

    def kept_block(states: list, seen: dict, k: WholeNumber, now: Motion) -> tuple:
        """States of a block after a frame, and what is displayed of it if it differs.

        The first frame starts the history. That choice is also a boundary that XLA does
        not fuse across: it would blend anew for each use of the displayed picture.
        """

        def step(states: list, frames: dict) -> tuple[list, list]:
            new, shown = [], []
            for i, state in zip(keeping, states, strict=True):
                after, picture = techniques[i].step(state, frames[views[i]], now)
                new.append(after)
                shown.append(None if shows_kept[i] else picture)
            return new, shown

        def begin() -> tuple[list, list]:
            still = {
                v: dataclasses.replace(f, reading=AT_REST) for v, f in seen.items()
            }
            return step([techniques[i].init(seen[views[i]]) for i in keeping], still)

        return jax.lax.cond(k == first, begin, lambda: step(states, seen))

    def advance(carry: tuple, step: tuple) -> tuple[tuple, None]:
        states, previous, sums = carry
        k, now = step

        def on_block(n: Array, carry: tuple) -> tuple:
            new, latest, sums = carry
            block = grid.block(n)
            part = measured if is_whole else block
            seen = {view: renderer.frame(view, block, k, now) for view in early}
            mine, pictures = kept_block(states, seen, k, now)
            shown, before = {}, {}
            for place, i in enumerate(keeping):
                kept = mine[place].under(block) if shows_kept[i] else pictures[place]
                shown[i] = blocks.part_of(kept, block, part)
            for i in everyone:
                if shows_kept[i]:
                    before[i] = states[keeping.index(i)].under(part)
                else:
                    before[i] = blocks.part_of(previous[i], shown_region, part)

            def measured_frame() -> tuple[dict, list]:
                """Show what keeps nothing, and measure all."""
                late = {view: cropped(frame, part) for view, frame in seen.items()}

                def frame(view: View) -> Any:
                    if view not in late:
                        late[view] = renderer.frame(view, part, k, now)
                    return late[view]

                every = dict(shown)
                for i in set(everyone) - set(keeping):
                    if is_local[i]:
                        every[i] = techniques[i].step(None, frame(views[i]), now)[1]
                    else:
                        whole = renderer.frame(views[i], block, k, now)
                        picture = techniques[i].step(None, whole, now)[1]
                        every[i] = blocks.part_of(picture, block, part)
                reference = frame(REFERENCE).color[0] if has_reference else None
                return every, [
                    measure(sums[i], every[i], before[i], reference, part, k)
                    for i in everyone
                ]

            def wait() -> tuple[dict, list]:
                return before | shown, sums

            every, sums = jax.lax.cond(k >= warmup, measured_frame, wait)
            if is_whole:
                mine = blocks.kept(mine, region, rim_px)
                kept = [p if shows_kept[i] else every[i] for i, p in enumerate(latest)]
                return mine, kept, sums
            place = blocks.start(region, part)
            write = lambda old, i: jax.lax.dynamic_update_slice(old, every[i], place)
            kept = [p if shows_kept[i] else write(p, i) for i, p in enumerate(latest)]
            return blocks.written(new, mine, block), kept, sums

        if is_whole:
            return on_block(jnp.int32(0), (states, previous, sums)), None
        blank = blocks.blank(states, region, rim_px)
        start = (blank, [jnp.zeros_like(picture) for picture in previous], sums)
        new, latest, sums = jax.lax.fori_loop(0, grid.count, on_block, start)
        return (blocks.rimmed(new), latest, sums), None

    def measure(
        sums: list, shown: Rgb, before: Rgb, reference: Rgb | None, part: Region, k: Any
    ) -> list:
        is_same_size = (part.width, part.height) == (measured.width, measured.height)
        is_measured = None if is_same_size else part.is_in(measured)
        found = []
        for metric, total in zip(metrics, sums, strict=True):
            new = metric.step(total, shown, before, reference, is_measured)
            if metric.is_of_pairs:  # the first measured frame has none before it
                choose = lambda now, was: jnp.where(k > warmup, now, was)
                new = jax.tree.map(choose, new, total)
            found.append(new)
        return found

    dtype = motion.offset.dtype
    size = (3, shown_region.height, shown_region.width)
    start = (
        blocks.blank([shapes[i] for i in keeping], region, rim_px),
        [jnp.zeros((0,) if shows_kept[i] else size, dtype) for i in everyone],
        [[metric.init(measured, dtype) for metric in metrics] for _ in everyone],
    )
    steps = jnp.arange(first, motion.offset.shape[0], dtype=jnp.int32)
    motions = jax.tree.map(lambda leaf: leaf[first:], motion)
    # Reverse mode then keeps of each frame only what goes on to the next one.
    is_plain = reading.sampler == "plain"
    step = jax.checkpoint(advance, prevent_cse=False) if is_plain else advance
    (_, _, sums), _ = jax.lax.scan(step, start, (steps, motions))

    is_covered = source.covers(camera, region, motion) & camera.is_valid
    results = []
    for technique, totals in zip(techniques, sums, strict=True):
        failed = jnp.where(is_covered & technique.is_valid, 0.0, jnp.nan).astype(dtype)
        pairs = zip(metrics, totals, strict=True)
        results.append(Result({m.id: m.value(total) + failed for m, total in pairs}))
    return tuple(results)


def differentiable_session(
    warmup: int,
    reading: Reading,
    metrics: tuple[AbstractMetric, ...] = standard.STANDARD,
) -> Callable[..., tuple[Result, ...]]:
    """Return `session` for these: fast, yet ready for `vmap` and `grad`.

    Slices must stay slices: under `jax.vmap` they would become gathers, hundreds of
    times as slow, so a batch runs one session after the other. Derivatives are those of
    the plain gather form, which also vectorises.
    """
    run = partial(session, warmup=warmup, reading=reading, metrics=metrics)
    if reading.sampler != "slices":
        return run
    plain = partial(run, reading=dataclasses.replace(reading, sampler="plain"))
    fast = jax.custom_jvp(jax.custom_batching.sequential_vmap(run))
    fast.defjvp(partial(jax.jvp, plain))
    return fast


def fastest_reading() -> Reading:
    """Return how sources are read fastest here: by slices on a CPU, else by gathers."""
    return SLICES if jax.default_backend() == "cpu" else GATHER
