"""The sessions of a study: their head paths and the blocks that they measure.

Head paths come either from a model, drawn anew for each session, or from recorded
traces, cut into windows. Session i depends only on (study, seed, i):
what JAX's settings would change of its draws is fixed here.
"""

import contextlib
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, DTypeLike, Float, Int

from .._types import RandomKey
from ..camera import Camera
from ..frames.motion import Motion
from ..frames.neck import NeckModel
from ..head_motion import HeadMotion
from ..head_motion.replay import Replay
from ..simulation.sharding import over_sessions
from .measured_blocks import Measurement

Head = HeadMotion | Replay


def _drawn_path(
    shared: tuple[RandomKey, HeadMotion],
    session: Int[Array, ""],
    *,
    rate_hz: float,
    frames: int,
    dtype: DTypeLike,
) -> Motion:
    """Head path of a session, drawn from a model, `(frames, 3)`."""
    key, head = shared
    session_key = session_keys(key, session).head
    return Motion.of(head.sample(session_key, rate_hz, frames, dtype=dtype))


def _on_neck(neck: NeckModel, motion: Motion) -> Motion:
    """Add where the eye is to a session, unless that is known."""
    return neck.moved(motion)


@jax.jit
def _recorded_motion(poses: Float[Array, "sessions frames components"]) -> Motion:
    """Motion of re-based windows, `(sessions, frames, 3)`."""
    return jax.lax.map(Motion.of, poses)


class SessionKeys(eqx.Module):
    """The random keys of one session: of its head and of the blocks it measures."""

    head: RandomKey
    blocks: RandomKey


def session_keys(key: RandomKey, session: Int[Array, ""]) -> SessionKeys:
    """Keys of session i: they depend on the study's key and on i only."""
    head, blocks = jax.random.split(jax.random.fold_in(key, session))
    return SessionKeys(head, blocks)


def study_key(seed: int) -> RandomKey:
    """Return a study's key: threefry without offset, whatever the process's default."""
    data = jnp.array([0, seed], jnp.uint32)
    return jax.random.wrap_key_data(data, impl="threefry2x32")


def drawn_alike() -> contextlib.AbstractContextManager:
    """Within it keys give the same numbers, whatever `JAX_THREEFRY_PARTITIONABLE` is.

    It decides what is compiled, not what is traced: call compiled programs in it.
    """
    return jax.threefry_partitionable(True)


class Batch(NamedTuple):
    """Sessions from `start` on, with their paths and blocks."""

    start: int
    motion: Motion
    origins: Int[Array | np.ndarray, "sessions blocks 2"]

    @property
    def size(self) -> int:
        """Sessions in the batch."""
        return self.origins.shape[0]

    def select(self, index: Int[np.ndarray, " chosen"]) -> "Batch":
        """Pick sessions of the batch, any of them any number of times."""
        motion = jax.tree.map(lambda leaf: leaf[index], self.motion)
        return Batch(self.start, motion, self.origins[index])


_AT_A_TIME = 256  # sessions drawn by one call of a program


class Sessions:
    """The sessions of a study, made batch by batch.

    - `count`: how many there are; of a replay, at most its windows.
    - `subjects`: the subject of each, of a replay; else None.

    Paths of a model are drawn in `dtype`: another one draws other paths. Where the eye
    is matters to solids only (`has_places`): as recorded, or moved by a `neck`.
    """

    def __init__(
        self,
        seed: int,
        head: Head,
        camera: Camera,
        measure: Measurement,
        count: int,
        length: int,
        *,
        dtype: DTypeLike = jnp.float32,
        has_places: bool = False,
        neck: NeckModel | None = None,
    ):
        self._key = study_key(seed)
        self._head, self._camera, self._measure = head, camera, measure
        self._length, self._dtype = length, jnp.dtype(dtype)
        self._has_places, self._neck = has_places, neck
        self.count = count
        self.subjects: list[str] | None = None
        if isinstance(head, Replay):
            windows, subjects = head.windows(length)
            # The order is drawn for all windows, so a longer study begins alike.
            with drawn_alike():
                order = np.asarray(jax.random.permutation(self._key, len(windows)))
            order = order[:count]
            self.count = len(order)
            self._windows = windows[order]
            self.subjects = [subjects[i] for i in order]
        self._last: tuple[int, tuple[Motion, np.ndarray]] | None = None

    def batch(self, start: int, size: int) -> Batch:
        """Sessions from `start` on, `size` of them or what is left."""
        count = min(size, self.count - start)
        # Always as many are drawn at a time, to compile once whatever the size.
        first, last = start // _AT_A_TIME, (start + count - 1) // _AT_A_TIME
        drawn = [self._drawn(block) for block in range(first, last + 1)]
        motion, origins = jax.tree.map(lambda *leaves: np.concatenate(leaves), *drawn)
        chosen = start - first * _AT_A_TIME + np.arange(count)
        return Batch(start, motion, origins).select(chosen)

    def _drawn(self, block: int) -> tuple[Motion, np.ndarray]:
        """Draw all sessions of a block; the last one is kept, for batches are small."""
        if self._last is None or self._last[0] != block:
            with drawn_alike():
                self._last = block, self._draw(block * _AT_A_TIME, _AT_A_TIME)
        return self._last[1]

    def _draw(self, start: int, size: int) -> tuple[Motion, np.ndarray]:
        indices = jnp.arange(start, start + size, dtype=jnp.int32)
        origins = _blocks(self._key, self._measure, self._camera, indices)
        if isinstance(self._head, HeadMotion):
            # Sessions are mapped, not vectorised, so that a session's bits do not
            # depend on which others are drawn with it.
            motion = over_sessions(
                _drawn_path,
                (self._key, self._head),
                indices,
                rate_hz=float(self._camera.refresh_hz),
                frames=self._length,
                dtype=self._dtype,
            )
        else:
            windows = np.arange(start, start + size) % self.count
            motion = _recorded_motion(jnp.asarray(self._windows[windows], jnp.float32))
        if not self._has_places:
            motion = motion.turning()
        elif self._neck is not None:
            motion = over_sessions(_on_neck, self._neck, motion)
        return jax.tree.map(np.asarray, (motion, origins))


@eqx.filter_jit
def _blocks(
    key: RandomKey,
    measure: Measurement,
    camera: Camera,
    indices: Int[Array, " sessions"],
) -> Int[Array, "sessions blocks 2"]:
    return jax.lax.map(
        lambda i: measure.draw(session_keys(key, i).blocks, camera), indices
    )
