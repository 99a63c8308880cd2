"""What a curve does: flicker, detail loss and lag of sessions, and their slopes.

Sessions have common random numbers: the same heads and tiles whatever the curve. Slopes
in the numbers of a curve are by forward mode, for they are few: a session keeps one
picture per number beside its own, however many frames it has.
"""

from collections.abc import Callable, Sequence
from typing import Any

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
from ..frames.texture import Texture
from ..simulation.session import Result, session
from ..simulation.sharding import over_devices, placed, program
from ..studies.runner import regions
from ..studies.sessions import Batch
from ..techniques import HeadMovement
from .space import CurveSpace, Point

TURN_DEG, TURN_S = 4.0, 0.15
"""A quick glance aside, after which lag is measured; 50 deg/s at its fastest."""

_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))

Values = Float[Array, "scenes sessions measures"]
Slopes = Float[Array, "scenes sessions measures numbers"]


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


def stacked(textures: Sequence[Texture]) -> Texture:
    """Textures of several scenes as one, on all devices."""
    return placed(jax.tree.map(lambda *leaves: jnp.stack(leaves), *textures))


def one_of(textures: Texture, scene: int) -> Texture:
    """Texture of one scene of several."""
    return jax.tree.map(lambda leaf: leaf[scene], textures)


@program()
def values(
    space: CurveSpace, point: Point, textures: Texture, viewing: Viewing
) -> Values:
    """Return what sessions measure with the curve of a point.

    **Arguments:** `textures`: of several scenes, `stacked`.

    **Returns:** MTCD in code values, then detail loss and, where there are turned
    paths, the detail loss after a turn, in code values squared.
    """

    def one(shared: tuple, item: tuple) -> Array:
        point, camera, texture = shared
        return _measured(space.technique(point), camera, texture, item, viewing)

    return _in_each(one, point, textures, viewing)


def values_and_slopes(
    space: CurveSpace, point: Point, textures: Texture, viewing: Viewing
) -> tuple[Values, Slopes]:
    """Return `values`, and their derivative in the numbers of the point; not jitted."""

    def one(shared: tuple, item: tuple) -> tuple[Array, Array]:
        at, camera, texture = shared

        def of(point: Point) -> tuple[Array, Array]:
            curve = space.technique(point)
            found = _measured(curve, camera, texture, item, viewing)
            return found, found

        slopes, found = jax.jacfwd(of, has_aux=True)(at)
        return found, slopes

    return _in_each(one, point, textures, viewing)


def _in_each(one: Callable, point: Point, textures: Texture, viewing: Viewing) -> Any:
    """Apply a function to each scene, and in it to each session."""
    items = (viewing.motion, viewing.turned, viewing.origins)

    def of_scene(texture: Texture) -> Any:
        shared = (point, viewing.camera, texture)
        return over_devices(one, shared, items, viewing.mesh)

    return jax.lax.map(of_scene, textures)


def _measured(
    technique: HeadMovement,
    camera: Camera,
    texture: Texture,
    item: tuple[Motion, Motion | None, Int[Array, "2"]],
    viewing: Viewing,
) -> Float[Array, " measures"]:
    """Measure one session; of `viewing` only what is static."""
    motion, turned, origin = item
    block = (viewing.tile_px, viewing.tile_px)
    places = regions(camera, origin, block, viewing.halo_px)

    def measure(motion: Motion) -> Result:
        (found,) = session(
            texture,
            camera,
            (technique,),
            motion,
            *places,
            warmup=viewing.warmup,
            reading=viewing.reading,
        )
        return found

    still = measure(motion)
    found = [still.mtcd, still.detail_loss]
    if turned is not None:
        found.append(measure(turned).detail_loss)
    return jnp.stack(found)
