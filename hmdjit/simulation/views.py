"""What techniques see of a pose, and what a session has to know of them beforehand.

Each sample pattern is rendered once, for all techniques that ask for it.
"""

import dataclasses
from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .. import rendering
from .._types import Rgb, WholeNumber
from ..camera import Camera, Region
from ..frames.displacement import Reading
from ..frames.frame import Frame
from ..frames.motion import Motion
from ..frames.sources import INSTEAD_OF_COLOR, AbstractSource, History
from ..technique_contract.base import AbstractTechnique, State
from . import blocks


class Pattern(NamedTuple):
    """How pixels are sampled: techniques with equal patterns see the same frame.

    - `samples`: the table of sample positions, `[period][sample][x, y]`, px.
    - `channels`: what the frame holds.
    """

    samples: tuple
    channels: frozenset[str]

    @property
    def jitters(self) -> bool:
        """Whether one sample per pixel goes from place to place, or lies beside."""
        return len(self.samples[0]) == 1 and bool(np.any(self.samples))

    @classmethod
    def of(cls, technique: AbstractTechnique, gives: Collection[str]) -> "Pattern":
        """Return the pattern that a technique asks for; `gives`: what a source has."""
        if technique.reads_supersampled and "supersampled" in gives:
            return REFERENCE
        table = technique.sample_offsets_px
        rows = tuple(tuple(map(tuple, row)) for row in table.tolist())
        if technique.shades_once_per_pixel and "multisampled" in gives:
            return cls(rows, technique.needs - {"color"} | {"multisampled"})
        return cls(rows, technique.needs)


REFERENCE = Pattern((((0.0, 0.0),),), frozenset({"supersampled"}))


class Renderer(NamedTuple):
    """Renders patterns of a source."""

    source: AbstractSource
    camera: Camera
    reading: Reading

    def frame(
        self, pattern: Pattern, part: Region, k: WholeNumber, now: Motion
    ) -> Frame:
        """Render frame k of a part of the camera frame."""
        # Rows of a table of one stay NumPy: a sample at the centre costs nothing.
        rows = np.asarray(pattern.samples)
        row = rows[0] if len(rows) == 1 else jnp.asarray(rows)[k % len(rows)]
        frame = rendering.render(
            self.source,
            self.camera,
            part,
            now,
            row,
            frame=k,
            channels=pattern.channels,
            reading=self.reading,
        )
        if not pattern.jitters:
            return frame
        jitter_px = jnp.asarray(row[0], now.offset.dtype)
        return dataclasses.replace(frame, jitter_px=jitter_px)

    def reference(self, part: Region, k: WholeNumber, now: Motion) -> Rgb:
        """Render the picture that frame k is held against."""
        return rendering.reference(
            self.source, self.camera, part, now, self.reading, frame=k
        )


class Shots:
    """Frames of one pose: each pattern is rendered once, and cut out of what is there.

    - `whole`: what was rendered of a block.
    """

    def __init__(self, renderer: Renderer, k: WholeNumber, now: Motion, whole: dict):
        self._renderer, self._k, self._now = renderer, k, now
        self._whole, self._parts = dict(whole), {}

    def whole(self, pattern: Pattern, block: Region) -> Frame:
        """Frame of a block."""
        if pattern not in self._whole:
            frame = self._renderer.frame(pattern, block, self._k, self._now)
            self._whole[pattern] = frame
        return self._whole[pattern]

    def part(self, pattern: Pattern, part: Region) -> Frame:
        """Frame of a part of the block."""
        if pattern not in self._parts:
            if pattern in self._whole:
                self._parts[pattern] = _cropped(self._whole[pattern], part)
            else:
                frame = self._renderer.frame(pattern, part, self._k, self._now)
                self._parts[pattern] = frame
        return self._parts[pattern]

    def reference(self, part: Region) -> Rgb:
        """Picture of a part that detail loss is measured against."""
        if "supersampled" in self._renderer.source.gives:
            return self.part(REFERENCE, part).color[0]
        return self._renderer.reference(part, self._k, self._now)


def _cropped(frame: Frame, part: Region) -> Frame:
    """Cut a part out of a frame, which holds it."""

    def cut(planes: Array) -> Array:
        return jax.vmap(lambda each: blocks.part_of(each, frame.region, part))(planes)

    channels = {name: cut(planes) for name, planes in frame.channels.items()}
    return dataclasses.replace(
        frame, color=cut(frame.color), region=part, channels=channels
    )


class Stepped(NamedTuple):
    """A technique, and what is known of it before it runs.

    - `empty`: shapes of its state.
    - `shows_its_history`: whether all that it keeps is what it displays.
    - `is_local`: whether it reads no neighbour, in the current frame or the past.
    """

    technique: AbstractTechnique
    pattern: Pattern
    empty: State
    shows_its_history: bool
    is_local: bool

    @classmethod
    def of(
        cls,
        technique: AbstractTechnique,
        renderer: Renderer,
        region: Region,
        motion: Motion,
    ) -> "Stepped":
        """Find out; `motion`: at one frame."""
        pattern = Pattern.of(technique, renderer.source.gives)
        render = lambda now: renderer.frame(pattern, region, 0, now)
        frame = jax.eval_shape(render, motion)
        empty = jax.eval_shape(technique.init, frame)
        shows = _shows_its_history(technique, empty, frame, motion)
        is_local = technique.stencil_radius_px == 0
        return cls(technique, pattern, empty, shows, is_local)

    @property
    def keeps(self) -> bool:
        """Whether it has a state; else it shows each frame on its own."""
        return bool(jax.tree.leaves(self.empty))

    def alone(self, shots: Shots, block: Region, part: Region, now: Motion) -> Rgb:
        """Display a part of a block, of a technique that keeps nothing."""
        if self.is_local:
            frame = shots.part(self.pattern, part)
            return self.technique.step(self.empty, frame, now)[1]
        frame = shots.whole(self.pattern, block)
        shown = self.technique.step(self.empty, frame, now)[1]
        return blocks.part_of(shown, block, part)


def seeing_together(players: Sequence[Stepped]) -> list[Stepped]:
    """Let techniques that sample alike see one frame, with all that any of them needs.

    A pose is then rendered once, and not once for each set of channels.
    """
    kind = lambda pattern: (pattern.samples, pattern.channels & INSTEAD_OF_COLOR)
    needed: dict[tuple, frozenset[str]] = {}
    for pattern in (player.pattern for player in players):
        known = needed.get(kind(pattern), frozenset())
        needed[kind(pattern)] = known | pattern.channels
    return [
        player._replace(pattern=Pattern(player.pattern.samples, needed[kind(pattern)]))
        for player, pattern in ((player, player.pattern) for player in players)
    ]


def _shows_its_history(
    technique: AbstractTechnique, state: State, frame: Frame, motion: Motion
) -> bool:
    """Whether all that a technique keeps is what it displays, by how it computes them.

    **Arguments:** `state`, `frame`: their shapes suffice. False is always safe: what is
    displayed is then carried along as well.
    """
    if not isinstance(state, History):
        return False
    step = lambda state, frame, motion: technique.step(state, frame, motion)
    traced, (kept, _) = jax.make_jaxpr(step, return_shape=True)(state, frame, motion)
    if not isinstance(kept, History) or len(jax.tree.leaves(kept)) != 1:
        return False
    made_by = {out: eqn for eqn in traced.jaxpr.eqns for out in eqn.outvars}

    def picture(variable: Any) -> Any:
        """Go back through what only changes a picture's shape."""
        while (eqn := made_by.get(variable)) is not None and (
            eqn.primitive.name in ("reshape", "broadcast_in_dim", "squeeze")
            and eqn.invars[0].aval.size == variable.aval.size
        ):
            variable = eqn.invars[0]
        return variable

    texels, displayed = map(picture, traced.jaxpr.outvars)
    return texels is displayed
