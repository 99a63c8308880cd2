"""Measuring a batch of sessions: on all devices, each with the halo that it needs."""

import dataclasses
from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Float, Int

from .. import camera_bounds
from ..camera import Camera, Region
from ..frames.displacement import Reading
from ..frames.motion import Motion
from ..frames.sources import Texture
from ..simulation.halo import required_halo_px
from ..simulation.session import Result, fastest_reading, session
from ..simulation.sharding import mesh, over_devices, program
from ..techniques.base import AbstractTechnique
from .measured_blocks import Measurement
from .sessions import Batch
from .store import fingerprint

_NEAR_PX = 32  # how far around a block its displacements are bounded


class Runner:
    """Runs batches of a study; decides how wide their halos are."""

    def __init__(
        self,
        camera: Camera,
        measure: Measurement,
        techniques: Sequence[AbstractTechnique],
        warmup: int,
        batch_size: int,
        pilot: Batch,
        reading: Reading | None = None,
    ):
        self.reading = fastest_reading() if reading is None else reading
        self.camera, self.warmup, self.batch_size = camera, warmup, batch_size
        self.block = measure.block_size(camera)
        self.mesh = mesh()
        self._usual_halo: dict[str, int] = {}
        for technique in (t.on_pictures() for t in techniques):
            need = int(np.max(self._needed_halo(technique, pilot)))
            self._usual_halo[fingerprint(technique)] = -(-need // 4) * 4

    def run(
        self, technique: AbstractTechnique, texture: Texture, batch: Batch
    ) -> Result:
        """Measure a batch, as NumPy arrays, `(sessions,)`."""
        halo = self.halo(technique, batch)
        usual = self._usual_halo[fingerprint(technique)]
        # Everyone runs with the usual halo, to compile once per technique; the few
        # that need a wider one run again, eight at a time.
        result = self._dispatch(
            technique, texture, batch, usual, self.batch_size, self.reading
        )
        mtcd, loss = np.array(result.mtcd), np.array(result.detail_loss)
        for width in np.unique(halo[halo > usual]):
            chosen = np.flatnonzero(halo == width)
            wide = batch.select(chosen)
            # Gathers are slower, but compile faster, and few need them.
            gathers = dataclasses.replace(self.reading, sampler="gather")
            reading = gathers if self.reading.sampler == "slices" else self.reading
            result = self._dispatch(technique, texture, wide, int(width), 8, reading)
            mtcd[chosen], loss[chosen] = result.mtcd, result.detail_loss
        return Result(mtcd, loss)

    def halo(
        self, technique: AbstractTechnique, batch: Batch
    ) -> Int[np.ndarray, " sessions"]:
        """Halo of each session, px: the usual one, doubled until it suffices."""
        need = self._needed_halo(technique, batch)
        halo = np.full(batch.size, self._usual_halo[fingerprint(technique)])
        while (short := halo < need).any():
            halo[short] = np.maximum(2 * halo[short], 4)
        return halo

    def is_wide(self, technique: AbstractTechnique, batch: Batch) -> np.ndarray:
        """Which sessions of a batch need more than the usual halo."""
        usual = self._usual_halo[fingerprint(technique)]
        return self.halo(technique, batch) > usual

    def _needed_halo(
        self, technique: AbstractTechnique, batch: Batch
    ) -> Int[np.ndarray, " sessions"]:
        frame = (self.camera.width_px, self.camera.height_px)
        speed = np.linalg.norm(np.asarray(batch.motion.increment), axis=-1)
        speed_deg_s = np.degrees(speed) * float(self.camera.refresh_hz)

        def halo(around_px: int) -> Int[np.ndarray, " sessions"]:
            span = partial(_motion_span, self.camera, batch, self.block, around_px)
            reach = technique.history_reach(speed_deg_s, span)
            none = np.zeros(batch.size, int)
            needed = none if reach is None else required_halo_px(reach)
            return needed + technique.stencil_radius_px

        if self.block == frame:
            return np.zeros(batch.size, int)
        needed = halo(_NEAR_PX)
        if np.any(needed > _NEAR_PX):
            # So wide a halo reaches pixels that may move faster: bound the whole frame.
            needed = np.where(needed > _NEAR_PX, halo(max(frame)), needed)
        return needed

    def _dispatch(
        self,
        technique: AbstractTechnique,
        texture: Texture,
        batch: Batch,
        halo: int,
        multiple: int,
        reading: Reading,
    ) -> Result:
        padded = -(-batch.size // multiple) * multiple
        filled = batch.select(np.resize(np.arange(batch.size), padded))
        result = _measure(
            texture,
            self.camera,
            technique,
            filled.motion,
            filled.origins,
            mesh=self.mesh,
            block=self.block,
            halo=halo,
            warmup=self.warmup,
            reading=reading,
        )
        return jax.tree.map(lambda leaf: np.asarray(leaf)[: batch.size], result)


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


@program("mesh", "block", "halo", "warmup", "reading")
def _measure(
    texture: Texture,
    camera: Camera,
    technique: AbstractTechnique,
    motion: Motion,
    origins: Int[Array, "sessions blocks 2"],
    *,
    mesh: Mesh,
    block: tuple[int, int],
    halo: int,
    warmup: int,
    reading: Reading,
) -> Result:
    """Measure sessions: mapped one by one, the mean over their blocks each."""

    def one_session(shared: tuple, mine: tuple) -> Result:
        texture, camera, technique = shared
        motion, origins = mine

        def one_block(origin: Int[Array, "2"]) -> Result:
            region, measured = regions(camera, origin, block, halo)
            return session(
                texture,
                camera,
                technique,
                motion,
                region,
                measured,
                warmup=warmup,
                reading=reading,
            )

        return jax.tree.map(jnp.mean, jax.lax.map(one_block, origins))

    return over_devices(
        one_session, (texture, camera, technique), (motion, origins), mesh
    )


@partial(jax.jit, static_argnames=("block", "around_px"))
def _spans(
    camera: Camera,
    increments: Float[Array, "sessions frames 3"],
    origins: Int[Array, "sessions blocks 2"],
    block: tuple[int, int],
    around_px: int,
) -> Float[Array, "blocks sessions frames 2 2"]:
    width = min(block[0] + 2 * around_px, camera.width_px)
    height = min(block[1] + 2 * around_px, camera.height_px)

    def span(increment: Array, origin: Array) -> Array:
        # Clipped to the frame, as a region is; its place there does not narrow it.
        x0, y0 = origin - around_px
        left = jnp.clip(x0, 0, camera.width_px - width)
        top = jnp.clip(y0, 0, camera.height_px - height)
        region = Region(left, top, width, height)
        return camera_bounds.displacement_range(camera, region, increment)

    over_frames = jax.vmap(span, (0, None))
    over_sessions = jax.vmap(over_frames, (0, 0))
    return jax.vmap(over_sessions, (None, 1))(increments, origins)


def _motion_span(
    camera: Camera,
    batch: Batch,
    block: tuple[int, int],
    around_px: int,
    share: float,
) -> Float[np.ndarray, "sessions frames 2 2"]:
    """Range of displacements of a session's blocks by a share of each increment, px."""
    # Filled up to a round number, to compile once for batches and the last of them.
    filled = batch.select(np.resize(np.arange(batch.size), -(-batch.size // 64) * 64))
    spans = np.asarray(
        _spans(
            camera,
            share * filled.motion.increment,
            filled.origins,
            block,
            around_px=around_px,
        )
    )[:, : batch.size]
    low, high = spans[..., 0, :].min(axis=0), spans[..., 1, :].max(axis=0)
    return np.stack([low, high], axis=-2)
