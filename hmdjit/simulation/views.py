"""What techniques see of a pose: each sample pattern is rendered once for all of them.

And what is to be known of a technique before it runs: what it keeps, what it shows.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .. import rendering
from .._types import WholeNumber
from ..camera import Camera, Region
from ..frames.displacement import Reading
from ..frames.frame import Frame
from ..frames.motion import Motion
from ..frames.sources import AbstractSource, History
from ..techniques.base import AbstractTechnique, State
from . import blocks


class View(NamedTuple):
    """How a pixel is sampled: techniques with equal views see the same frame.

    - `samples`: the table of sample positions, as bytes; empty for the SSAA(4) channel.
    - `channels`: what else the frame holds.
    """

    samples: bytes
    channels: frozenset[str]


REFERENCE = View(b"", frozenset({"supersampled"}))


def view_of(technique: AbstractTechnique) -> View:
    """Return the view that a technique asks for."""
    if technique.reads_supersampled:
        return REFERENCE
    return View(technique.sample_offsets_px.tobytes(), technique.needs)


class Renderer:
    """Renders the views of some techniques."""

    def __init__(
        self,
        source: AbstractSource,
        camera: Camera,
        techniques: Sequence[AbstractTechnique],
        reading: Reading,
    ):
        self._source, self._camera, self._reading = source, camera, reading
        self._tables = {view_of(t): t.sample_offsets_px for t in techniques}

    def frame(self, view: View, part: Region, k: WholeNumber, now: Motion) -> Frame:
        """Render frame k of a part of the camera frame."""
        table = self._tables.get(view)
        if view == REFERENCE or table is None:
            row = jnp.zeros((1, 2), now.offset.dtype)
        else:
            # Rows of a table of one stay NumPy: a sample at the centre costs nothing.
            row = table[0] if len(table) == 1 else jnp.asarray(table)[k % len(table)]
        return rendering.render(
            self._source,
            self._camera,
            part,
            now.offset,
            row,
            position_m=now.position_m,
            channels=view.channels,
            supersampled=view == REFERENCE,
            reading=self._reading,
        )


def cropped(frame: Frame, part: Region) -> Frame:
    """Cut a part out of a frame, which holds it."""

    def cut(planes: Array) -> Array:
        return jax.vmap(lambda each: blocks.part_of(each, frame.region, part))(planes)

    channels = {name: cut(planes) for name, planes in frame.channels.items()}
    return dataclasses.replace(
        frame, color=cut(frame.color), region=part, channels=channels
    )


def shows_its_history(
    technique: AbstractTechnique, state: State, frame: Frame, motion: Motion
) -> bool:
    """Whether all that a technique keeps is what it displays, by how it computes them.

    **Arguments:** `state`: its shapes suffice. False is always safe: what is displayed
    is then carried along as well.
    """
    if not isinstance(state, History):
        return False
    step = lambda state, frame, motion: technique.step(state, frame, motion)
    traced, (kept, _) = jax.make_jaxpr(step, return_shape=True)(state, frame, motion)
    leaves = jax.tree.leaves(kept)
    if not isinstance(kept, History) or len(leaves) != 1:
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
