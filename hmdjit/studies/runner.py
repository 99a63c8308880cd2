"""Measuring a batch of sessions: on all devices, each with the halo that it needs."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from ..camera import Camera, Region
from ..frames.displacement import Reading
from ..frames.motion import Motion
from ..frames.sources import AbstractSource
from ..frames.texture import Texture
from ..metrics import STANDARD, AbstractMetric
from ..simulation.halo import needed_halo_px
from ..simulation.session import Result, fastest_reading, session
from ..simulation.sharding import over_sessions
from ..technique_contract.base import AbstractTechnique
from ..technique_contract.check import check_hints
from .measured_blocks import Measurement
from .sessions import Batch
from .store import fingerprint

Techniques = Sequence[AbstractTechnique]


class Runner:
    """Runs batches of a study; decides how wide their halos are.

    `moving`: the source, where techniques follow what moves in it; `least_halo_px`: no
    halo is narrower.
    """

    def __init__(
        self,
        camera: Camera,
        measure: Measurement,
        techniques: Techniques,
        warmup: int,
        batch_size: int,
        pilot: Batch,
        reading: Reading | None = None,
        metrics: Sequence[AbstractMetric] = STANDARD,
        moving: AbstractSource | None = None,
        least_halo_px: int = 0,
    ):
        self.reading = fastest_reading() if reading is None else reading
        self.camera, self.warmup, self.batch_size = camera, warmup, batch_size
        self.metrics = tuple(metrics)
        self.block = measure.block_size(camera)
        self._moving = moving
        self._usual_halo: dict[str, int] = {}
        for technique in techniques:
            check_hints(technique)
            need = int(
                np.max(self._needed_halo(technique, pilot), initial=least_halo_px)
            )
            self._usual_halo[fingerprint(technique)] = -(-need // 4) * 4

    def run(
        self, techniques: Techniques, source: AbstractSource, batch: Batch
    ) -> list[Result]:
        """Measure a batch with some of the techniques, as NumPy arrays, `(sessions,)`.

        They share each session's frames, so several at once cost little more than one.
        """
        halo = self.halo(techniques, batch)
        usual = self.usual_halo(techniques)
        # Everyone runs with the usual halo, to compile once per set of techniques; the
        # few that need a wider one run again, eight at a time.
        found = self._dispatch(
            techniques, source, batch, usual, self.batch_size, self.reading
        )
        for width in np.unique(halo[halo > usual]):
            chosen = np.flatnonzero(halo == width)
            wide = batch.select(chosen)
            # Gathers are slower, but compile faster, and few need them.
            gathers = dataclasses.replace(self.reading, sampler="gather")
            reading = gathers if self.reading.sampler == "slices" else self.reading
            wider = self._dispatch(techniques, source, wide, int(width), 8, reading)
            for values, again in zip(
                jax.tree.leaves(found), jax.tree.leaves(wider), strict=True
            ):
                values[chosen] = again
        return list(found)

    def halo(
        self, techniques: Techniques, batch: Batch
    ) -> Int[np.ndarray, " sessions"]:
        """Halo of each session, px: the usual one, doubled until it suffices."""
        need = np.max([self._needed_halo(t, batch) for t in techniques], axis=0)
        halo = np.full(batch.size, self.usual_halo(techniques))
        while (short := halo < need).any():
            halo[short] = np.maximum(2 * halo[short], 4)
        return halo

    def is_wide(
        self, techniques: Techniques, batch: Batch
    ) -> Bool[np.ndarray, " sessions"]:
        """Which sessions of a batch need more than the usual halo."""
        return self.halo(techniques, batch) > self.usual_halo(techniques)

    def usual_halo(self, techniques: Techniques) -> int:
        """Halo that all sessions are run with first, px."""
        return max(self._usual_halo[fingerprint(technique)] for technique in techniques)

    def _needed_halo(
        self, technique: AbstractTechnique, batch: Batch
    ) -> Int[np.ndarray, " sessions"]:
        return needed_halo_px(
            technique,
            self.camera,
            batch.motion,
            batch.origins,
            self.block,
            self._moving,
        )

    def _dispatch(
        self,
        techniques: Techniques,
        source: AbstractSource,
        batch: Batch,
        halo: int,
        multiple: int,
        reading: Reading,
    ) -> tuple[Result, ...]:
        padded = -(-batch.size // multiple) * multiple
        filled = batch.select(np.resize(np.arange(batch.size), padded))
        found = over_sessions(
            one_session,
            _Shared(source, self.camera, tuple(techniques), self.metrics),
            (filled.motion, filled.origins),
            casts_rays=not isinstance(source, Texture),
            block=self.block,
            halo=halo,
            warmup=self.warmup,
            reading=reading,
        )
        return jax.tree.map(lambda leaf: np.array(leaf)[: batch.size], found)


def regions(
    camera: Camera, origin: Int[Array, "2"], block: tuple[int, int], halo: int
) -> tuple[Region, Region]:
    """Return what is simulated for a block, halo and all, and the block itself."""
    width = min(block[0] + 2 * halo, camera.width_px)
    height = min(block[1] + 2 * halo, camera.height_px)
    x0, y0 = origin
    # The region is shifted to stay within the frame: there its edge is the frame's.
    left = jnp.clip(x0 - halo, 0, camera.width_px - width)
    top = jnp.clip(y0 - halo, 0, camera.height_px - height)
    return Region(left, top, width, height), Region(x0, y0, *block)


class _Shared(NamedTuple):
    source: AbstractSource
    camera: Camera
    techniques: tuple[AbstractTechnique, ...]
    metrics: tuple[AbstractMetric, ...]


def one_session(
    shared: _Shared,
    mine: tuple[Motion, Int[Array, "blocks 2"]],
    *,
    block: tuple[int, int],
    halo: int,
    warmup: int,
    reading: Reading,
) -> tuple[Result, ...]:
    """Measure a session: the mean over its blocks of each metric of each technique."""
    motion, origins = mine

    def one_block(origin: Int[Array, "2"]) -> tuple[Result, ...]:
        return session(
            shared.source,
            shared.camera,
            shared.techniques,
            motion,
            *regions(shared.camera, origin, block, halo),
            warmup=warmup,
            reading=reading,
            metrics=shared.metrics,
        )

    found = jax.lax.map(one_block, origins)
    mean = lambda result: {m.id: m.mean(result.metrics[m.id]) for m in shared.metrics}
    return tuple(Result(mean(result)) for result in found)
