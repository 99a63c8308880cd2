"""Run a technique on frames that were rendered elsewhere: `apply`, `stream`."""

from collections.abc import Iterable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped

from .. import _checks
from .._types import Clip, Poses, Rgb
from ..camera import Camera, Region
from ..frames.frame import Frame
from ..frames.motion import Motion, check_poses, checked_motion
from ..techniques.base import AbstractTechnique
from ..techniques.contract import check_contract


@jax.jit
def _displayed(
    technique: AbstractTechnique,
    camera: Camera,
    samples: Float[Array, "frames samples 3 height width"],
    motion: Motion,
    static_mask: Bool[Array, "frames height width"] | None,
) -> Float[Array, "frames 3 height width"]:
    region = Region.whole(camera)

    def frame(color: Any, mask: Any) -> Frame:
        return Frame(color, camera, region, mask)

    def advance(state: Any, step: tuple) -> tuple[Any, Rgb]:
        now, color, mask = step
        return technique.step(state, frame(color, mask), now)

    first_mask = None if static_mask is None else static_mask[0]
    state = technique.init(frame(samples[0], first_mask))
    _, shown = jax.lax.scan(advance, state, (motion, samples, static_mask))
    is_valid = jnp.isfinite(motion.offset).all() & camera.is_valid & technique.is_valid
    return jnp.where(is_valid, shown, jnp.nan)


def apply(
    technique: AbstractTechnique,
    camera: Camera,
    frames: Shaped[Array | np.ndarray, "..."],
    poses: Poses | Float[np.ndarray, "frames 4"],
    *,
    static_mask: Bool[Array | np.ndarray, "frames height width"] | None = None,
) -> Clip:
    """Run a technique on frames that were rendered elsewhere.

    **Arguments:**

    - `camera`: that the frames were rendered with; its size must be theirs.
    - `frames`: gamma colour, `(frames, height, width, 3)`; for techniques that resolve
      several samples `(frames, samples, height, width, 3)`. Floating in `[0, 1]`, or
      uint8 or uint16, whose largest code is 1. Shorter floats than float32 are computed
      in float32, history and result included.
    - `poses`: `world_from_head` of each frame, `(frames, 4)`, unit length.
    - `static_mask`: True where the scene is static, `(frames, height, width)`.

    **Returns:** displayed gamma frames, `(frames, height, width, 3)`; displayed frame 0
    is frame 0. NaN throughout if, inside compiled code, a pose is no unit quaternion or
    a number of the camera or of the technique is out of its range.

    **Errors:** `ValueError` if sizes, numbers of frames or of samples disagree, or for
    frames of any other dtype or range.
    """
    check_contract(technique)
    frames = _checks.colors("frames", frames)
    frames = frames.astype(jnp.float32) if frames.dtype.itemsize < 4 else frames
    size = (camera.height_px, camera.width_px, 3)
    if frames.ndim not in (4, 5) or frames.shape[-3:] != size:
        raise ValueError(
            f"frames must have the camera's size {size} in their last three axes, "
            f"got shape {tuple(frames.shape)}."
        )
    if frames.ndim == 4:
        frames = frames[:, None]
    check_poses(poses)
    if frames.shape[0] != poses.shape[0]:
        raise ValueError(
            f"poses must have one row per frame ({frames.shape[0]}), "
            f"got {poses.shape[0]}."
        )
    expected = technique.sample_offsets_px.shape[1]
    if frames.shape[1] != expected:
        raise ValueError(
            f"frames must have {expected} samples per pixel for {technique.id}, "
            f"got {frames.shape[1]}."
        )
    mask_shape = (frames.shape[0], *size[:2])
    mask = None if static_mask is None else jnp.asarray(static_mask, bool)
    if mask is not None and mask.shape != mask_shape:
        raise ValueError(
            f"static_mask must have the shape {mask_shape}, got {tuple(mask.shape)}."
        )
    motion = checked_motion(poses, frames.dtype)
    samples = jnp.moveaxis(frames, -1, 2)
    shown = _displayed(technique, camera, samples, motion, mask)
    return jnp.moveaxis(shown, 1, -1)


@jax.jit
def _first(technique: AbstractTechnique, frame: Frame) -> Any:
    return technique.init(frame)


@jax.jit
def _next(
    technique: AbstractTechnique, state: Any, frame: Frame, motion: Motion
) -> tuple[Any, Rgb]:
    return technique.step(state, frame, motion)


def stream(
    technique: AbstractTechnique,
    camera: Camera,
    frames: Iterable[Float[np.ndarray, "height width 3"]],
    poses: Float[np.ndarray, "frames 4"] | None,
) -> Iterator[Float[np.ndarray, "height width 3"]]:
    """Run a technique on frames that come one by one; `apply` for long clips.

    **Arguments:** as `apply`; float32, one sample per pixel. `poses`: None where none
    are known.

    **Returns:** displayed gamma frames, one by one.

    **Errors:** `ValueError` for a technique that needs several samples per pixel, or
    poses where there are none.
    """
    samples = technique.sample_offsets_px.shape[1]
    if samples > 1:
        raise ValueError(
            f"frames must have {samples} samples per pixel for {technique.id}, got 1."
        )
    region = Region.whole(camera)
    unknown = jnp.full(3, jnp.nan, jnp.float32)  # shows wherever it is used
    path = Motion(unknown, unknown)
    if poses is not None:
        check_poses(poses)
        path = checked_motion(poses, jnp.dtype(jnp.float32))
    state = None
    for k, picture in enumerate(frames):
        if poses is not None and k >= len(poses):
            raise ValueError(f"poses must have one row per frame, got {len(poses)}.")
        picture = _checks.colors("frames", picture).astype(jnp.float32)
        color = jnp.moveaxis(picture, -1, 0)[None]
        frame = Frame(color, camera, region)
        state = _first(technique, frame) if k == 0 else state
        now = path if poses is None else jax.tree.map(lambda leaf, k=k: leaf[k], path)
        state, shown = _next(technique, state, frame, now)
        if poses is None and not jnp.isfinite(shown).all():
            raise ValueError(f"{technique.id} needs poses, got none.")
        yield np.moveaxis(np.asarray(shown), 0, -1)
