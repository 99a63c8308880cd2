"""What a curve does: flicker, detail loss and lag of sessions, and their slopes.

Sessions have common random numbers: the same heads and tiles whatever the curve. Slopes
in the numbers of a curve are by forward mode, for they are few: a session keeps one
picture per number beside its own, however many frames it has.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Float, Int

from .. import quaternion
from ..camera import Camera
from ..frames.displacement import Reading
from ..frames.motion import Motion
from ..frames.sources import Texture
from ..simulation.session import Result, session
from ..simulation.sharding import over_devices, program
from ..studies.runner import regions
from ..studies.sessions import Batch
from ..techniques import HeadMovement
from .space import CurveSpace, Point

TURN_DEG, TURN_S = 4.0, 0.15
"""A quick look aside, after which lag is measured; 50 deg/s at its fastest."""

_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))

Values = Float[Array, "sessions measures"]
Slopes = Float[Array, "sessions measures numbers"]


def turned(batch: Batch, refresh_hz: float, warmup: int) -> Batch:
    """Let heads make a quick turn that stops at the first measured frame.

    By `TURN_DEG` in `TURN_S`, or what the warm-up leaves of it, with least jerk, each
    session to another side; the jitter goes on throughout.
    """
    length = batch.motion.offset.shape[1]
    frames = min(max(1, round(TURN_S * refresh_hz)), max(warmup, 1))
    share = np.clip((np.arange(length) - (warmup - frames)) / frames, 0, 1)
    angle = np.radians(TURN_DEG) * (share**3 * (10 + share * (6 * share - 15)))
    side = _GOLDEN_ANGLE * (batch.start + np.arange(batch.size))
    axis = np.stack([np.sin(side), np.cos(side), np.zeros_like(side)], axis=-1)
    turns = jnp.asarray(axis[:, None] * angle[:, None], batch.motion.offset.dtype)
    return batch._replace(motion=_with_turns(batch.motion, turns))


@jax.jit
def _with_turns(motion: Motion, turns: Float[Array, "sessions frames 3"]) -> Motion:
    def pose(turn: Array, offset: Array) -> Array:
        return quaternion.multiply(quaternion.exp(turn), quaternion.exp(offset))

    def one(turns: Array, offsets: Array) -> Motion:
        return Motion.of(jax.vmap(pose)(turns, offsets))

    return jax.vmap(one)(turns, jnp.asarray(motion.offset))


class Viewing(eqx.Module):
    """Sessions that curves are measured on, with any scene.

    - `motion`, `origins`: of the sessions, and the tile of each.
    - `turned`: their paths with a quick turn, for the lag; None measures none.
    - `tile_px`, `halo_px`: what is measured, and what is rendered around it.
    """

    camera: Camera
    motion: Motion
    origins: Int[Array, "sessions 2"]
    turned: Motion | None
    warmup: int = eqx.field(static=True)
    tile_px: int = eqx.field(static=True)
    halo_px: int = eqx.field(static=True)
    reading: Reading
    mesh: Mesh = eqx.field(static=True)


class _Item(NamedTuple):
    motion: Motion
    turned: Motion | None
    origin: Int[Array, "2"]


@program()
def values(
    space: CurveSpace, point: Point, texture: Texture, viewing: Viewing
) -> Values:
    """Return what sessions measure with the curve of a point.

    **Returns:** MTCD in code values, then detail loss and, where there are turned
    paths, the detail loss after a turn, in code values squared.
    """
    return _over_sessions(space, point, texture, viewing)[0]


@program()
def values_and_slopes(
    space: CurveSpace, point: Point, texture: Texture, viewing: Viewing
) -> tuple[Values, Slopes]:
    """Return `values`, and their derivative in the numbers of the point."""
    return _over_sessions(space, point, texture, viewing, has_slopes=True)


def _over_sessions(
    space: CurveSpace,
    point: Point,
    texture: Texture,
    viewing: Viewing,
    *,
    has_slopes: bool = False,
) -> tuple[Values, Values | Slopes]:
    block = (viewing.tile_px, viewing.tile_px)

    def one(shared: tuple, item: _Item) -> tuple[Array, Array]:
        point, camera, texture = shared
        whole, measured = regions(camera, item.origin, block, viewing.halo_px)

        def measure(technique: HeadMovement, motion: Motion) -> Result:
            return session(
                texture,
                camera,
                technique,
                motion,
                whole,
                measured,
                warmup=viewing.warmup,
                reading=viewing.reading,
            )

        def of(point: Point) -> tuple[Array, Array]:
            technique = space.technique(point)
            still = measure(technique, item.motion)
            found = [still.mtcd, still.detail_loss]
            if item.turned is not None:
                found.append(measure(technique, item.turned).detail_loss)
            return jnp.stack(found), jnp.stack(found)

        if not has_slopes:
            return of(point)
        slopes, found = jax.jacfwd(of, has_aux=True)(point)
        return found, slopes

    shared = (point, viewing.camera, texture)
    items = _Item(viewing.motion, viewing.turned, viewing.origins)
    return over_devices(one, shared, items, viewing.mesh)
