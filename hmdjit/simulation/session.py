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
from ..metrics.base import AbstractMetric, Values
from ..technique_contract.base import AbstractTechnique
from . import blocks
from .views import Renderer, Shots, Stepped, seeing_together


class Result(eqx.Module):
    """What a session measures of a technique: each metric is an attribute by its id.

    - `metrics`: values by ids, such as `mtcd` and `detail_loss`.
    """

    metrics: Values

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
    at_start = jax.tree.map(lambda leaf: leaf[0], motion)
    renderer = Renderer(source, camera, reading)
    players = seeing_together(
        [Stepped.of(t, renderer, region, at_start) for t in techniques]
    )
    # What keeps nothing shows each frame on its own: warm-up changes nothing of it.
    early = {player.pattern for player in players if player.keeps}
    first = 0 if early else warmup
    held = frozenset(metric.id for metric in metrics if metric.needs_reference)
    free = frozenset(metric.id for metric in metrics) - held
    has_reference = bool(held)
    is_always_held = not held or reading.reference_every == 1

    # A stencil would find no neighbours at a block's edge.
    empty = [player.empty for player in players]
    is_local = all(one.is_local for one in (*players, *metrics))
    is_cuttable = is_local and blocks.is_cuttable(empty)
    slices = reading.sampler == "slices"
    grid = blocks.cut(region) if slices and is_cuttable else blocks.uncut(region)
    is_whole = grid.count == 1
    rim_px = blocks.RIM_PX if slices else 0
    # Of a region in one piece only the measured part is kept of what is shown.
    shown_region = measured if is_whole else region
    is_all_measured = _same_size(shown_region, measured)

    def kept_block(states: list, seen: dict, k: WholeNumber, now: Motion) -> tuple:
        """States of a block after a frame, and what is displayed of it if it differs.

        The first frame starts the history. That choice is also a boundary that XLA does
        not fuse across: it would blend anew for each use of the displayed picture.
        """

        def step(states: list, seen: dict) -> tuple[list, list]:
            new: list = list(states)
            shown: list = [None] * len(players)
            for i, player in enumerate(players):
                if player.keeps:
                    frame = seen[player.pattern]
                    new[i], picture = player.technique.step(states[i], frame, now)
                    shown[i] = None if player.shows_its_history else picture
            return new, shown

        def begin() -> tuple[list, list]:
            still = {}
            for pattern, frame in seen.items():
                still[pattern] = dataclasses.replace(frame, reading=AT_REST)
            start = [
                p.technique.init(seen[p.pattern]) if p.keeps else p.empty
                for p in players
            ]
            return step(start, still)

        return jax.lax.cond(k == first, begin, lambda: step(states, seen))

    def measure(
        sums: list,
        shown: Rgb,
        before: Rgb,
        reference: Rgb | None,
        part: Region,
        k: Any,
        which: frozenset[str],
    ) -> list:
        is_measured = None if is_all_measured else part.is_in(measured)
        found = []
        for metric, total in zip(metrics, sums, strict=True):
            if metric.id not in which:
                found.append(total)
                continue
            previous = before if metric.is_of_pairs else None
            new = metric.step(total, shown, previous, reference, is_measured)
            if metric.is_of_pairs:  # the first measured frame has none before it
                choose = lambda now, was: jnp.where(k > warmup, now, was)
                new = jax.tree.map(choose, new, total)
            found.append(new)
        return found

    def advance(carry: tuple, step: tuple) -> tuple[tuple, None]:
        states, previous, sums = carry
        k, now = step

        def on_block(n: Array, carry: tuple) -> tuple:
            new, latest, sums = carry
            block = grid.block(n)
            part = measured if is_whole else block
            seen = {p: renderer.frame(p, block, k, now) for p in early}
            mine, pictures = kept_block(states, seen, k, now)
            shown, before = [], []
            for i, player in enumerate(players):
                if player.shows_its_history:
                    pictures[i] = mine[i].under(block)
                    before.append(states[i].under(part))
                else:
                    before.append(blocks.part_of(previous[i], shown_region, part))
                cut = lambda picture: blocks.part_of(picture, block, part)
                shown.append(cut(pictures[i]) if player.keeps else None)

            def measured_frame() -> tuple[list, list]:
                """Show what keeps nothing, and measure all."""
                shots = Shots(renderer, k, now, seen)
                every = [
                    shown[i] if p.keeps else p.alone(shots, block, part, now)
                    for i, p in enumerate(players)
                ]

                def taken(sums: list, reference: Rgb | None, which: frozenset) -> list:
                    return [
                        measure(*each, reference, part, k, which)
                        for each in zip(sums, every, before, strict=True)
                    ]

                if is_always_held:
                    reference = shots.reference(part) if has_reference else None
                    return every, taken(sums, reference, free | held)
                alone = taken(sums, None, free)
                is_due = (k - warmup) % reading.reference_every == 0
                beside = lambda: taken(alone, shots.reference(part), held)
                return every, jax.lax.cond(is_due, beside, lambda: alone)

            def wait() -> tuple[list, list]:
                pairs = zip(shown, before, strict=True)
                return [b if s is None else s for s, b in pairs], sums

            every, sums = jax.lax.cond(k >= warmup, measured_frame, wait)
            place = blocks.start(region, part)

            def kept(player: Stepped, old: Array, picture: Rgb) -> Array:
                if player.shows_its_history:
                    return old
                if is_whole:
                    return picture
                return jax.lax.dynamic_update_slice(old, picture, place)

            latest = list(map(kept, players, latest, every))
            if is_whole:
                return blocks.kept(mine, region, rim_px), latest, sums
            return blocks.written(new, mine, block), latest, sums

        if is_whole:
            return on_block(jnp.int32(0), (states, previous, sums)), None
        blank = blocks.blank(states, region, rim_px)
        start = (blank, [jnp.zeros_like(picture) for picture in previous], sums)
        new, latest, sums = jax.lax.fori_loop(0, grid.count, on_block, start)
        return (blocks.rimmed(new), latest, sums), None

    dtype = motion.offset.dtype
    size = (3, shown_region.height, shown_region.width)
    start = (
        blocks.blank(empty, region, rim_px),
        [jnp.zeros((0,) if p.shows_its_history else size, dtype) for p in players],
        [[metric.init(measured, dtype) for metric in metrics] for _ in players],
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


def _same_size(one: Region, other: Region) -> bool:
    return (one.width, one.height) == (other.width, other.height)


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
