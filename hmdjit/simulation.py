"""One viewing session: a scan over frames, metrics reduced on the fly.

`simulate` runs a session on a scene, `apply` runs a technique on frames that were
rendered elsewhere. No frame is stored by `simulate`.
"""

from collections.abc import Iterable, Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from . import _checks, rendering
from . import camera as pinhole
from ._types import Clip, Planes, Poses, Rgb, RotationVector, Scalar, WholeNumber
from .camera import Camera, Region
from .frame import Frame, Motion, Texture, rebased_motion
from .metrics.image_error import mse
from .metrics.mtcd import CODE_VALUES, pair_distance
from .scenes.base import AbstractScene, bake
from .techniques import SSAA
from .techniques.base import AbstractTechnique


class Result(eqx.Module):
    """What a session measures.

    - `mtcd`: flicker, mean temporal colour difference, code values (0 to 441.7).
    - `detail_loss`: mean squared error of the displayed frames against the SSAA(4)
      reference of the same pose, code values squared.
    """

    mtcd: Float[Array | np.ndarray, "*sessions"]
    detail_loss: Float[Array | np.ndarray, "*sessions"]


def crop(
    planes: Planes, region: Region, block: Region
) -> Float[Array, "channels block_height block_width"]:
    """Cut a block out of a region's planes; both are places in the camera frame."""
    if (region.height, region.width) == (block.height, block.width):
        return planes
    place = (0, block.y0 - region.y0, block.x0 - region.x0)
    start = [jnp.asarray(index, jnp.int32) for index in place]
    return jax.lax.dynamic_slice(
        planes, start, (planes.shape[0], block.height, block.width)
    )


def session(
    texture: Texture,
    camera: Camera,
    technique: AbstractTechnique,
    motion: Motion,
    region: Region,
    block: Region,
    warmup: int,
) -> Result:
    """Simulate one session on one region; not jitted, unbatched.

    **Arguments:**

    - `motion`: of `warmup + frames` poses; the first offset is 0.
    - `region`: the pixels that are rendered and filtered.
    - `block`: the pixels that are measured; inside the region.
    - `warmup`: how many displayed frames are not measured; static.

    **Returns:** the measurements; NaN where the head leaves the texture's margin, for
    a clamped read would look like a calm picture.
    """
    bounds = jax.vmap(lambda r: pinhole.displacement_bound(camera, region, r))(
        motion.offset
    )
    is_covered = jnp.all(bounds <= texture.margin_px)

    table = technique.sample_offsets_px

    def frame_at(offset: RotationVector, k: WholeNumber) -> Frame:
        # Rows of a table of one stay NumPy: a sample at the centre then costs nothing.
        samples = table[0] if len(table) == 1 else jnp.asarray(table)[k % len(table)]
        return rendering.render(
            texture,
            camera,
            region,
            offset,
            samples,
            supersampled=technique.reads_supersampled,
        )

    first = warmup if not technique.remembers else 0
    state = technique.init(frame_at(motion.offset[first], first))
    shown = jnp.zeros((3, block.height, block.width), texture.color.dtype)
    zero = jnp.zeros((), texture.color.dtype)

    def advance(carry: tuple, step: tuple) -> tuple[tuple, None]:
        state, previous, flicker, loss = carry
        k, now = step
        state, displayed = technique.step(state, frame_at(now.offset, k), now)
        displayed = crop(displayed, region, block)

        def measure(flicker: Scalar, loss: Scalar) -> tuple[Scalar, Scalar]:
            # SSAA(4) is the reference: it is not read a second time.
            is_reference = isinstance(technique, SSAA) and technique.reads_supersampled
            reference = (
                displayed
                if is_reference
                else rendering.reference(texture, camera, block, now.offset)
            )
            distance = pair_distance(displayed, previous)
            # The first measured frame has no measured frame before it.
            flicker = flicker + jnp.where(k > warmup, distance, 0.0)
            return flicker, loss + CODE_VALUES**2 * mse(displayed, reference)

        flicker, loss = jax.lax.cond(
            k >= warmup, measure, lambda *sums: sums, flicker, loss
        )
        return (state, displayed, flicker, loss), None

    frames = motion.offset.shape[0]
    steps = jnp.arange(first, frames, dtype=jnp.int32)
    motions = jax.tree.map(lambda leaf: leaf[first:], motion)
    (_, _, flicker, loss), _ = jax.lax.scan(
        advance, (state, shown, zero, zero), (steps, motions)
    )
    measured = frames - warmup
    nothing = jnp.where(is_covered, 0.0, jnp.nan).astype(flicker.dtype)
    return Result(flicker / (measured - 1) + nothing, loss / measured + nothing)


_jitted_session = jax.jit(session, static_argnames="warmup")


def simulate(
    scene: AbstractScene | Texture,
    camera: Camera,
    technique: AbstractTechnique,
    poses: Poses | Float[np.ndarray, "frames 4"],
    *,
    warmup: int = 0,
    region: Region | None = None,
) -> Result:
    """Simulate one viewing session and measure its flicker and its detail loss.

    Compiled once per shapes and technique; the numbers in camera and technique are
    leaves. Use `jax.vmap` and `jax.grad` over it freely; to simulate many sessions on
    one scene, bake it once (`scenes.bake`) and hand over the texture.

    **Arguments:**

    - `scene`: what is looked at. It is baked here, with 6 degrees of margin.
    - `poses`: `world_from_head` at each frame, `(warmup + frames, 4)`, unit length. The
      first is the hold pose. Concrete poses are re-based in float64; float32 is the
      precision of the simulation unless a JAX float64 array comes in, or a texture.
    - `warmup`: displayed frames that are not measured; at least 0.
    - `region`: the part of the camera frame; None is the whole. Its edges are treated
      as a picture's edges: history clamps there.

    **Returns:** a `Result`; NaN if, inside compiled code, the head leaves the margin.

    **Errors:** `ValueError` for a warm-up that leaves fewer than 2 frames, for poses
    that are not unit quaternions, and for a head that leaves the texture's margin.

    **Accuracy:** differentiable in poses, camera and technique; at rest MTCD and its
    chosen gradient are exactly 0.
    """
    _checks.whole("warmup", warmup, 0)
    _check_pose_shape(poses)
    if poses.shape[0] - warmup < 2:
        raise ValueError(
            f"poses must hold at least 2 frames after warmup = {warmup}, "
            f"got {poses.shape[0]} in all."
        )
    is_jax = isinstance(poses, jax.Array)
    motion = _motion(poses, poses.dtype if is_jax else jnp.dtype(jnp.float32))
    region = Region.whole(camera) if region is None else region
    dtype = motion.offset.dtype
    texture = scene if isinstance(scene, Texture) else bake(scene, camera, dtype=dtype)
    _check_texture(texture, camera, region)
    # A texture that was baked before brings the precision of the simulation.
    motion = jax.tree.map(lambda leaf: leaf.astype(texture.color.dtype), motion)
    if not _checks.is_traced(motion.offset):
        _check_margin(texture, camera, region, motion)
    return _jitted_session(
        texture, camera, technique.on_pictures(), motion, region, region, warmup=warmup
    )


def _check_pose_shape(poses: Array | np.ndarray) -> None:
    if poses.ndim != 2 or poses.shape[1] != 4:
        raise ValueError(
            f"poses must have the shape (frames, 4), got {tuple(poses.shape)}."
        )


def _motion(poses: Poses | Float[np.ndarray, "frames 4"], dtype: Any) -> Motion:
    if _checks.is_traced(poses):
        return Motion.of(jnp.asarray(poses, dtype))
    concrete = np.asarray(poses, np.float64)
    norm = np.linalg.norm(concrete, axis=1)
    worst = int(np.argmax(np.abs(norm - 1)))
    if not abs(norm[worst] - 1) <= 0.01:
        raise ValueError(
            f"poses[{worst}] must have a length in [0.99, 1.01], got {norm[worst]:g}."
        )
    return rebased_motion(concrete / norm[:, None], dtype)


def _check_texture(texture: Texture, camera: Camera, region: Region) -> None:
    k, margin = texture.oversampling, texture.margin_px
    expected = (k * (camera.height_px + 2 * margin), k * (camera.width_px + 2 * margin))
    if texture.color.shape[:2] != expected:
        raise ValueError(
            f"scene must be a texture baked for this camera, {expected} texels, got "
            f"{tuple(texture.color.shape[:2])}."
        )
    if not (_checks.is_traced(region.x0) or _checks.is_traced(region.y0)):
        _checks.in_range("region x0", region.x0, 0, camera.width_px - region.width)
        _checks.in_range("region y0", region.y0, 0, camera.height_px - region.height)


def _check_margin(
    texture: Texture, camera: Camera, region: Region, motion: Motion
) -> None:
    bounds = jax.vmap(lambda r: pinhole.displacement_bound(camera, region, r))(
        motion.offset
    )
    if _checks.is_traced(bounds):
        return  # the session itself gives NaN then
    largest = np.max(np.asarray(bounds), axis=1)
    worst = int(np.argmax(largest))
    if largest[worst] > texture.margin_px:
        turn = np.degrees(np.linalg.norm(np.asarray(motion.offset[worst])))
        raise ValueError(
            f"poses must stay within the texture's margin of {texture.margin_px} px, "
            f"got up to {largest[worst]:.1f} px at frame {worst} ({turn:.2f} deg from "
            "the first pose); bake the scene with a larger margin_deg."
        )


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
    return shown


def apply(
    technique: AbstractTechnique,
    camera: Camera,
    frames: Float[Array, "..."] | Float[np.ndarray, "..."],
    poses: Poses | Float[np.ndarray, "frames 4"],
    *,
    static_mask: Bool[Array | np.ndarray, "frames height width"] | None = None,
) -> Clip:
    """Run a technique on frames that were rendered elsewhere.

    **Arguments:**

    - `camera`: that the frames were rendered with; its size must be theirs.
    - `frames`: gamma colour in `[0, 1]`, `(frames, height, width, 3)`; for techniques
      that resolve several samples `(frames, samples, height, width, 3)`.
    - `poses`: `world_from_head` of each frame, `(frames, 4)`, unit length.
    - `static_mask`: True where the scene is static, `(frames, height, width)`.

    **Returns:** displayed gamma frames, `(frames, height, width, 3)`; displayed frame 0
    is frame 0.

    **Errors:** `ValueError` if sizes, numbers of frames or of samples disagree.
    """
    frames = jnp.asarray(frames)
    if not jnp.issubdtype(frames.dtype, jnp.floating):
        raise ValueError(f"frames must be floats in [0, 1], got {frames.dtype}.")
    size = (camera.height_px, camera.width_px, 3)
    if frames.ndim not in (4, 5) or frames.shape[-3:] != size:
        raise ValueError(
            f"frames must have the camera's size {size} in their last three axes, "
            f"got shape {tuple(frames.shape)}."
        )
    if frames.ndim == 4:
        frames = frames[:, None]
    _check_pose_shape(poses)
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
    motion = _motion(poses, frames.dtype)
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
    poses: Float[np.ndarray, "frames 4"],
) -> Iterator[Float[np.ndarray, "height width 3"]]:
    """Run a technique on frames that come one by one; `apply` for long clips.

    **Arguments:** as `apply`; float32, one sample per pixel.

    **Returns:** displayed gamma frames, one by one.

    **Errors:** `ValueError` for a technique that needs several samples per pixel.
    """
    samples = technique.sample_offsets_px.shape[1]
    if samples > 1:
        raise ValueError(
            f"frames must have {samples} samples per pixel for {technique.id}, got 1."
        )
    _check_pose_shape(poses)
    region = Region.whole(camera)
    path = _motion(poses, jnp.dtype(jnp.float32))
    state = None
    for k, picture in enumerate(frames):
        if k >= len(poses):
            raise ValueError(f"poses must have one row per frame, got {len(poses)}.")
        color = jnp.moveaxis(jnp.asarray(picture, jnp.float32), -1, 0)[None]
        frame = Frame(color, camera, region)
        state = _first(technique, frame) if k == 0 else state
        now = jax.tree.map(lambda leaf, k=k: leaf[k], path)
        state, shown = _next(technique, state, frame, now)
        yield np.moveaxis(np.asarray(shown), 0, -1)
