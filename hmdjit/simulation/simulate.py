"""Simulate one viewing session of a scene: `simulate`."""

from collections.abc import Collection, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .. import _checks, camera_bounds
from .._types import Poses
from ..camera import Camera, Region
from ..frames.displacement import Reading
from ..frames.motion import Motion, check_poses, checked_motion
from ..frames.neck import NeckModel
from ..frames.sources import AbstractSource
from ..frames.texture import Texture
from ..metrics import STANDARD, AbstractMetric
from ..metrics.base import check_metrics
from ..scenes.baking import bake
from ..scenes.base import AbstractScene, check_scene
from ..technique_contract.base import AbstractTechnique
from ..technique_contract.check import check_hints
from .session import Result, differentiable_session, fastest_reading


@partial(jax.jit, static_argnames=("warmup", "reading", "metrics"))
def _jitted_session(
    *arguments: Any,
    warmup: int,
    reading: Reading,
    metrics: tuple[AbstractMetric, ...],
) -> Result:
    """`session` of one technique, compiled."""
    (found,) = differentiable_session(warmup, reading, metrics)(*arguments)
    return found


def simulate(
    scene: AbstractScene | AbstractSource,
    camera: Camera,
    technique: AbstractTechnique,
    poses: Poses | Float[np.ndarray, "frames components"],
    *,
    warmup: int = 0,
    region: Region | None = None,
    neck: NeckModel | None = NeckModel(),  # noqa: B008 (frozen)
    reading: Reading | None = None,
    metrics: Sequence[AbstractMetric] = STANDARD,
) -> Result:
    """Simulate one viewing session and measure its flicker and its detail loss.

    Compiled once per shapes and technique; the numbers in camera and technique are
    leaves. Use `jax.vmap` and `jax.grad` over it freely; to simulate many sessions on
    one scene, bake it once (`scenes.bake`) and hand over the texture.

    **Arguments:**

    - `scene`: what is looked at. A picture is baked here, with 6 degrees of margin; a
      source, as solids are one, is seen as it is.
    - `poses`: `world_from_head` at each frame, `(warmup + frames, 4)`, unit length, or
      `(warmup + frames, 7)` with the eye's position, m, which pictures, infinitely far
      away, make nothing of. The first is the hold pose. Concrete poses are re-based in
      float64; float32 is the precision of the simulation, float64 where poses that are
      a JAX array, or a texture, have it.
    - `warmup`: displayed frames that are not measured; at least 0.
    - `region`: the part of the camera frame; None is the whole. Its edges are treated
      as a picture's edges: history clamps there.
    - `neck`: on which a head without positions turns before solids; None turns about
      the eye.
    - `reading`: how sources are read; None is the fastest exact way on this device.
    - `metrics`: what is measured.

    **Returns:** a `Result`; NaN if, inside compiled code, the head leaves the margin, a
    pose is no unit quaternion, or a number of camera or technique is out of its range.

    **Errors:** `ValueError` for a technique that needs what the scene does not give,
    for a warm-up that leaves fewer than 2 frames, for poses
    that are not unit quaternions, and for a head that leaves the texture's margin.

    **Accuracy:** differentiable in poses, camera and technique; at rest MTCD and its
    chosen gradient are exactly 0.
    """
    _checks.whole("warmup", warmup, 0)
    check_hints(technique)
    check_metrics(metrics)
    check_poses(poses)
    if poses.shape[0] - warmup < 2:
        raise ValueError(
            f"poses must hold at least 2 frames after warmup = {warmup}, "
            f"got {poses.shape[0]} in all."
        )
    is_jax = isinstance(poses, jax.Array)
    has_dtype = is_jax and jnp.issubdtype(poses.dtype, jnp.floating)
    motion = checked_motion(poses, poses.dtype if has_dtype else jnp.dtype(jnp.float32))
    region = Region.whole(camera) if region is None else region
    dtype = motion.offset.dtype
    is_source = isinstance(scene, AbstractSource)
    if not is_source:
        check_scene(scene, camera)
    check_gives(scene.gives, "this scene", technique)
    source = scene if is_source else bake(scene, camera, dtype=dtype)
    _check_region(camera, region)
    if isinstance(source, Texture):
        check_texture(source, camera)
        # Texels shorter than float32 are only stored so.
        stored = source.color_texels.dtype
        dtype = np.promote_types(stored, np.promote_types(dtype, "f4"))
        technique = technique.on_pictures()
        motion = jax.tree.map(lambda leaf: leaf.astype(dtype), motion.turning())
        if not _checks.is_traced(motion.offset):
            _check_margin(source, camera, region, motion)
    elif neck is not None:
        motion = neck.moved(motion)
    return _jitted_session(
        source,
        camera,
        (technique,),
        motion,
        region,
        region,
        warmup=warmup,
        reading=fastest_reading() if reading is None else reading,
        metrics=tuple(metrics),
    )


def check_gives(
    gives: Collection[str], scene: str, technique: AbstractTechnique
) -> None:
    """Raise unless a scene gives all channels that a technique needs."""
    lacking = sorted(technique.needs - set(gives))
    if technique.shades_once_per_pixel and not {"multisampled", "coverage"} & set(
        gives
    ):
        lacking.append("coverage")
    if lacking:
        raise ValueError(
            f"{technique.id} needs {', '.join(lacking)}, which {scene} does not give: "
            f"it gives {', '.join(sorted(gives))}."
        )


def check_texture(texture: Texture, camera: Camera) -> None:
    """Raise unless a texture was baked for a camera."""
    k, margin = texture.oversampling, texture.margin_px
    expected = (k * (camera.height_px + 2 * margin), k * (camera.width_px + 2 * margin))
    *_, rows, columns = texture.color_texels.shape
    if (k * rows, k * columns) != expected:
        raise ValueError(
            f"scene must be a texture baked for this camera, {expected} texels, got "
            f"{(k * rows, k * columns)}."
        )


def _check_region(camera: Camera, region: Region) -> None:
    if not (_checks.is_traced(region.x0) or _checks.is_traced(region.y0)):
        _checks.in_range("region x0", region.x0, 0, camera.width_px - region.width)
        _checks.in_range("region y0", region.y0, 0, camera.height_px - region.height)


def _check_margin(
    texture: Texture, camera: Camera, region: Region, motion: Motion
) -> None:
    bounds = jax.vmap(lambda r: camera_bounds.displacement_bound(camera, region, r))(
        motion.offset
    )
    if _checks.is_traced(bounds):
        return  # the session itself gives NaN then
    largest = np.max(np.asarray(bounds), axis=1)
    worst = int(np.argmax(largest))
    if largest[worst] > texture.margin_px:
        px = _checks.apart(largest[worst], texture.margin_px, spec="1f")
        turn = np.degrees(np.linalg.norm(np.asarray(motion.offset[worst])))
        raise ValueError(
            f"poses must stay within the texture's margin of {texture.margin_px} px, "
            f"got up to {px} px at frame {worst} ({turn:.2f} deg from the first pose); "
            "bake the scene with a larger margin_deg."
        )
