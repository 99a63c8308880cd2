"""How long techniques take for a frame, in turns, so that a busy machine hits all."""

import time
from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Float

from ..camera import Camera
from ..frames.sources import AbstractSource
from ..head_motion import HeadMotion
from ..metrics import MTCD
from ..scenes.base import AbstractScene
from ..simulation.simulate import simulate
from ..techniques import AbstractTechnique

_FRAMES = 12


def times(
    scene: AbstractScene | AbstractSource,
    camera: Camera,
    techniques: Sequence[AbstractTechnique],
    repeats: int = 7,
) -> Float[np.ndarray, "repeat technique"]:
    """Seconds per frame, rendered and shown; programs are compiled before."""
    poses = HeadMotion.fixating().sample(jax.random.key(0), 60.0, _FRAMES)

    def seconds(technique: AbstractTechnique) -> float:
        start = time.perf_counter()
        found = simulate(scene, camera, technique, poses, metrics=(MTCD(),))
        found.mtcd.block_until_ready()
        return (time.perf_counter() - start) / _FRAMES

    for technique in techniques:  # the first run compiles
        seconds(technique)
    return np.array([[seconds(t) for t in techniques] for _ in range(repeats)])
