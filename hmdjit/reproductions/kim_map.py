"""When 56 % comes out: Kim et al.'s ratio over heads, motion per frame and warm-up.

The ratio of MTCD with head movement to MTCD without is not a constant of the method. It
depends on how correlated a head's velocity is from one frame to the next, on how far a
frame moves the picture, on the refresh rate (by head speed alone) and on how long a
session has been running when it is measured.
"""

import dataclasses
import itertools
import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._types import Scalar
from ..camera import Camera, Region, px_per_deg
from ..estimates.intervals import ratio_interval
from ..frames.motion import Motion
from ..frames.texture import Texture
from ..head_motion import HeadMotion
from ..metrics import MTCD
from ..scenes.baking import bake
from ..scenes.base import AbstractScene
from ..simulation.session import fastest_reading, session
from ..studies.progress import Progress, Tell
from ..techniques import HeadMovement, NoAntialiasing
from .kept import kept

CORRELATIONS = (0.0, 0.3, 0.5, 0.8, 0.95, 0.99)
PX_PER_FRAME = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
REFRESH_HZ = (60.0, 90.0)
WARMUPS = (0, 12)
FRAMES = 10
_CROP_PX = 64
_LAGS = np.arange(2)


class Place(NamedTuple):
    """A place of the map, and the ratio there with its 95 % interval.

    - `correlation`: of a frame's rotation with the next one's.
    - `px_per_frame`: RMS of the picture's motion, px per frame and axis.
    - `warmup`: frames before those that are measured.
    """

    scene: str
    correlation: float
    px_per_frame: float
    refresh_hz: float
    warmup: int
    ratio: float
    low: float
    high: float


def head_of(correlation: float, deg_per_frame: float, rate_hz: float) -> HeadMotion:
    """Head of Ornstein-Uhlenbeck velocity about two axes, without tracker noise.

    **Arguments:** `correlation`: of velocity from frame to frame, in `[0, 1)`;
    `deg_per_frame`: RMS per frame and axis.
    """
    tau_s = 1e-4 if correlation == 0 else -1 / (rate_hz * np.log(correlation))
    model = HeadMotion(
        speed_rms_deg_s=(1.0, 1.0, 0.0),
        correlation_time_s=(tau_s, tau_s, tau_s),
        tracker_noise_deg=(0.0, 0.0, 0.0),
        person_sd=0.0,
    )
    scale = deg_per_frame / (float(model.increment_rms_deg(rate_hz)) / np.sqrt(2))
    return eqx.tree_at(lambda m: m.speed_rms_deg_s, model, (scale, scale, 0.0))


def motion_of(head: HeadMotion, camera: Camera, rate_hz: Scalar) -> tuple[float, float]:
    """Where a head lies on the map: its correlation, and px per frame and axis, RMS.

    Pitch and yaw are averaged; px are those in the middle of the frame.
    """
    at_centre = np.array([camera.width_px / 2, camera.height_px / 2])
    now, later = np.asarray(head.increment_covariance(_LAGS, rate_hz))[:, :2].mean(1)
    px = np.sqrt(now) * float(px_per_deg(camera, at_centre)[0])
    return float(later / now), float(px)


@partial(jax.jit, static_argnames=("warmup", "sessions"))
def _flicker(
    texture: Texture,
    camera: Camera,
    head: HeadMotion,
    key: Array,
    *,
    warmup: int,
    sessions: int,
) -> Float[Array, "sessions techniques"]:
    """MTCD of sessions in the middle of the frame, without and with head movement."""
    techniques, size = (NoAntialiasing(), HeadMovement()), _CROP_PX
    left, top = (camera.width_px - size) // 2, (camera.height_px - size) // 2
    # Rendered farther than it is measured, for the past comes in through the edges.
    rim = size // 2
    region = Region(left - rim, top - rim, size + 2 * rim, size + 2 * rim)
    measured = Region(left, top, size, size)

    def one(key: Array) -> Array:
        poses = head.sample(key, camera.refresh_hz, warmup + FRAMES)
        found = session(
            texture,
            camera,
            techniques,
            Motion.of(poses),
            region,
            measured,
            warmup=warmup,
            reading=fastest_reading(),
            metrics=(MTCD(),),
        )
        return jnp.stack([result.mtcd for result in found])

    return jax.lax.map(one, jax.random.split(key, sessions))


def ratios(
    scenes: dict[str, AbstractScene],
    camera: Camera,
    sessions: int,
    seed: int,
    *,
    out: str | os.PathLike,
    correlations: Sequence[float] = CORRELATIONS,
    px_per_frame: Sequence[float] = PX_PER_FRAME,
    refresh_hz: Sequence[float] = REFRESH_HZ,
    progress: Tell = lambda event: None,
) -> list[Place]:
    """Simulate the map, the same random numbers at each place.

    **Arguments:** `out`: folder where what is finished is kept; `correlations`: of the
    velocity at the frames.
    """
    at_centre = np.array([camera.width_px / 2, camera.height_px / 2])
    found = []
    for name, scene in scenes.items():
        texture = bake(scene, camera)
        places = itertools.product(WARMUPS, refresh_hz, correlations, px_per_frame)
        for warmup, rate_hz, correlation, px in places:
            progress(Progress(len(found), 0, f"map of the ratio, {name}"))
            deg = px / float(px_per_deg(camera, at_centre)[0])
            head = head_of(correlation, deg, rate_hz)
            place = dataclasses.replace(camera, refresh_hz=rate_hz)
            options = {"warmup": warmup, "sessions": sessions}
            compute = partial(
                _flicker, texture, place, head, jax.random.key(seed), **options
            )
            plain, blended = kept(
                Path(out) / "map",
                f"{name}_{len(found)}",
                (name, place, head, seed, FRAMES, _CROP_PX, options),
                lambda compute=compute: np.asarray(compute(), float),
            ).T
            ratio = ratio_interval(blended, plain)
            numbers = (ratio.value, ratio.low, ratio.high)
            turning = round(motion_of(head, camera, rate_hz)[0], 2)
            found.append(Place(name, turning, px, rate_hz, warmup, *numbers))
    return found
