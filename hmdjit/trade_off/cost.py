"""What techniques cost on this machine: of a picture, and of channels of solids apart.

Both in ns per pixel and frame, on one core or device.
"""

import time
from collections.abc import Callable, Collection, Iterable, Iterator
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .. import _checks
from ..camera import Camera, Region
from ..frames.motion import Motion
from ..frames.sources import AbstractSource
from ..head_motion import HeadMotion
from ..metrics import MTCD
from ..rendering import render
from ..sample_patterns import centre
from ..scenes.baking import bake
from ..scenes.base import AbstractScene
from ..simulation.session import fastest_reading
from ..simulation.simulate import simulate
from ..technique_contract.base import AbstractTechnique

SIDE_PX, FRAMES = 512, 96  # so many that checks of the first do not count
SOLIDS_SIDE_PX, SOLIDS_FRAMES = 128, 12
_FOV_DEG, _RATE_HZ = 48.0, 60.0


def techniques_ns(
    techniques: Iterable[AbstractTechnique], scene: AbstractScene, repeats: int = 3
) -> Iterator[float]:
    """Yield how long a pixel of a frame takes, rendered and measured by MTCD, ns.

    **Arguments:** `repeats`: timings, of which the shortest counts; at least 1.
    """
    camera, texture = Camera(SIDE_PX, SIDE_PX, _FOV_DEG, _RATE_HZ), None
    poses = HeadMotion.fixating().sample(jax.random.key(0), _RATE_HZ, FRAMES)
    for technique in techniques:
        texture = texture or bake(scene, camera)
        run = partial(simulate, texture, camera, technique, poses, metrics=(MTCD(),))
        (seconds,) = _shortest_s(repeats, run)
        yield seconds * 1e9 / (FRAMES * SIDE_PX**2)


def channels_ns(
    solids: AbstractSource, channels: Collection[str], repeats: int = 9
) -> float:
    """Return how much longer a pixel with channels takes than its colour alone, ns.

    **Arguments:** `channels`: their names; `repeats`: timings, of which the shortest
    counts; at least 1.
    """
    if set(channels) <= {"color"}:
        return 0.0
    camera = Camera(SOLIDS_SIDE_PX, SOLIDS_SIDE_PX, _FOV_DEG, _RATE_HZ)
    poses = HeadMotion.fixating().sample(jax.random.key(0), _RATE_HZ, SOLIDS_FRAMES)
    motion = Motion.of(poses)
    alone_s, together_s = _shortest_s(
        repeats,
        partial(_drawn, solids, camera, motion, ("color",)),
        partial(_drawn, solids, camera, motion, tuple(sorted({"color", *channels}))),
    )
    return (together_s - alone_s) * 1e9 / (SOLIDS_FRAMES * SOLIDS_SIDE_PX**2)


def _shortest_s(repeats: int, *runs: Callable[[], object]) -> list[float]:
    """Time some runs in turn, so that a busy moment is not one's alone."""
    _checks.whole("repeats", repeats, 1)
    for run in runs:
        jax.block_until_ready(run())  # compiles
    seconds = []
    for _ in range(repeats):
        for run in runs:
            start = time.perf_counter()
            jax.block_until_ready(run())
            seconds.append(time.perf_counter() - start)
    return [min(seconds[place :: len(runs)]) for place in range(len(runs))]


@partial(jax.jit, static_argnames=("channels",))
def _drawn(
    source: AbstractSource, camera: Camera, motion: Motion, channels: tuple[str, ...]
) -> Float[Array, " frames"]:
    """Add up all that is rendered, so that none of it is left out."""
    region, reading = Region.whole(camera), fastest_reading()

    def frame(step: tuple[Motion, Array]) -> Array:
        now, k = step
        names, at = channels, centre()
        found = render(
            source, camera, region, now, at, frame=k, channels=names, reading=reading
        )
        planes = [found.color, *found.channels.values()]
        finite = [jnp.where(jnp.isfinite(each), each, 0) for each in planes]
        sums = [jnp.sum(each, dtype=motion.offset.dtype) for each in finite]
        return jnp.sum(jnp.stack(sums))

    steps = jnp.arange(motion.offset.shape[0], dtype=jnp.int32)
    return jax.lax.map(frame, (motion, steps))
