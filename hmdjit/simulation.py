"""One viewing session: a scan over frames, metrics reduced on the fly.

`simulate` runs a session on a scene, `apply` runs a technique on frames that were
rendered elsewhere. No frame is stored by `simulate`.
"""

import dataclasses
from collections.abc import Iterable, Iterator
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from . import _checks, blocks, color, rendering
from . import camera as pinhole
from ._types import Clip, Poses, Rgb, RotationVector, WholeNumber
from .camera import Camera, Region
from .frame import (
    AT_REST,
    GATHER,
    SLICES,
    Frame,
    Motion,
    Reading,
    Texture,
    rebased_motion,
)
from .metrics.mtcd import CODE_VALUES
from .scenes.base import AbstractScene, bake
from .techniques import SSAA
from .techniques.base import AbstractTechnique, State


class Result(eqx.Module):
    """What a session measures.

    - `mtcd`: flicker, mean temporal colour difference, code values (0 to 441.7).
    - `detail_loss`: mean squared error of the displayed frames against the SSAA(4)
      reference of the same pose, code values squared.
    """

    mtcd: Float[Array | np.ndarray, "*sessions"]
    detail_loss: Float[Array | np.ndarray, "*sessions"]


def session(
    texture: Texture,
    camera: Camera,
    technique: AbstractTechnique,
    motion: Motion,
    region: Region,
    measured: Region,
    *,
    warmup: int,
    reading: Reading = GATHER,
    detail_loss: bool = True,
) -> Result:
    """Simulate one session on one region; not jitted, unbatched.

    **Arguments:**

    - `motion`: of `warmup + frames` poses; the first offset is 0.
    - `region`: the pixels that are rendered and filtered.
    - `measured`: those that are measured; inside the region.
    - `warmup`: how many displayed frames are not measured; static.
    - `reading`: how sources are read; static.
    - `detail_loss`: whether to measure it (else it is 0); static.

    **Returns:** the measurements; NaN where the head leaves the texture's margin, for
    a clamped read would look like a calm picture.
    """
    bounds = jax.vmap(lambda r: pinhole.displacement_bound(camera, region, r))(
        motion.offset
    )
    is_covered = jnp.all(bounds <= texture.margin_px)
    table = technique.sample_offsets_px
    dtype = motion.offset.dtype
    is_reference = isinstance(technique, SSAA) and technique.reads_supersampled

    def frame_at(part: Region, offset: RotationVector, k: WholeNumber) -> Frame:
        # Rows of a table of one stay NumPy: a sample at the centre then costs nothing.
        samples = table[0] if len(table) == 1 else jnp.asarray(table)[k % len(table)]
        return rendering.render(
            texture,
            camera,
            part,
            offset,
            samples,
            supersampled=technique.reads_supersampled,
            reading=reading,
        )

    first = warmup if not technique.remembers else 0
    rim_px = blocks.RIM_PX if reading.sampler == "slices" else 0

    def init(part: Region) -> State:
        return technique.init(frame_at(part, motion.offset[first], first))

    state = jax.eval_shape(init, region)
    # A stencil would find no neighbours at a block's edge.
    is_local = technique.stencil_radius_px == 0 and blocks.is_cuttable(state)
    is_cut = reading.sampler == "slices" and is_local
    grid = blocks.cut(region) if is_cut else blocks.uncut(region)
    is_whole = grid.count == 1
    # Of a region in one piece only the measured part is kept of what is shown.
    shown_region = measured if is_whole else region

    def shown_block(
        state: State, block: Region, k: WholeNumber, now: Motion
    ) -> tuple[State, Rgb]:
        """State and display of a block.

        The first frame starts the history. That choice is also a boundary that XLA does
        not fuse across: it would blend anew for each use of the displayed picture.
        """
        frame = frame_at(block, now.offset, k)
        still = dataclasses.replace(frame, reading=AT_REST)

        def displayed(before: State, frame: Frame) -> tuple[State, Rgb | None]:
            new, shown = technique.step(before, frame, now)
            return new, None if technique.displays_history else shown

        new, shown = jax.lax.cond(
            k == first,
            lambda: displayed(technique.init(frame), still),
            lambda: displayed(state, frame),
        )
        return new, new.under(block) if shown is None else shown

    def sums(shown: Rgb, previous: Rgb, part: Region, offset: RotationVector) -> Array:
        """Distance to the frame before, and squared error, summed over pixels."""
        found = [color.distance(shown, previous)]
        if detail_loss and not is_reference:
            reference = rendering.reference(texture, camera, part, offset, reading)
            found.append(color.squared_distance(shown, reference))
        if not _same_size(shown_region, measured):
            found = [jnp.where(part.is_in(measured), plane, 0) for plane in found]
        totals = [jnp.sum(plane) for plane in found]
        return jnp.stack([*totals, jnp.zeros((), dtype)][:2])

    def advance(carry: tuple, step: tuple) -> tuple[tuple, None]:
        state, previous, total = carry
        k, now = step
        # The first measured frame has no measured frame before it.
        is_counted = jnp.stack([k > warmup, k >= warmup])

        def on_block(n: Array, carry: tuple) -> tuple:
            new, latest, total = carry
            block = grid.block(n)
            mine, shown = shown_block(state, block, k, now)
            part = measured if is_whole else block
            shown = blocks.part_of(shown, block, part)

            if technique.displays_history:
                before = state.under(part)
            else:
                before = blocks.part_of(previous, shown_region, part)
            found = jax.lax.cond(
                k >= warmup,
                lambda: sums(shown, before, part, now.offset),
                lambda: jnp.zeros(2, dtype),
            )
            total = total + jnp.where(is_counted, found, 0)
            if is_whole:
                return blocks.kept(mine, region, rim_px), shown, total
            if not technique.displays_history:
                place = blocks.start(region, part)
                latest = jax.lax.dynamic_update_slice(latest, shown, place)
            return blocks.written(new, mine, block), latest, total

        if is_whole:
            new, latest, total = on_block(jnp.int32(0), (state, previous, total))
        else:
            blank = blocks.blank(state, region, rim_px)
            start = (blank, jnp.zeros_like(previous), total)
            new, latest, total = jax.lax.fori_loop(0, grid.count, on_block, start)
            new = blocks.rimmed(new)
        return (new, previous if technique.displays_history else latest, total), None

    size = (3, shown_region.height, shown_region.width)
    previous = jnp.zeros((0,) if technique.displays_history else size, dtype)
    state = blocks.blank(state, region, rim_px)

    frames = motion.offset.shape[0]
    steps = jnp.arange(first, frames, dtype=jnp.int32)
    motions = jax.tree.map(lambda leaf: leaf[first:], motion)
    start = (state, previous, jnp.zeros(2, dtype))
    (_, _, total), _ = jax.lax.scan(advance, start, (steps, motions))
    flicker, loss = total / (measured.width * measured.height)
    pairs = frames - warmup - 1
    nothing = jnp.where(is_covered, 0.0, jnp.nan).astype(dtype)
    return Result(
        CODE_VALUES * flicker / pairs + nothing,
        CODE_VALUES**2 * loss / (3 * (pairs + 1)) + nothing,
    )


def _same_size(one: Region, other: Region) -> bool:
    return (one.width, one.height) == (other.width, other.height)


def differentiable_session(
    texture: Texture,
    camera: Camera,
    technique: AbstractTechnique,
    motion: Motion,
    region: Region,
    measured: Region,
    *,
    warmup: int,
    reading: Reading,
) -> Result:
    """Simulate a session as `session` does: fast, yet ready for `vmap` and `grad`.

    Slices must stay slices: under `jax.vmap` they would become gathers, hundreds of
    times as slow, so a batch runs one session after the other. Derivatives are those of
    the plain gather form, which also vectorises.
    """
    arguments = (texture, camera, technique, motion, region, measured)
    if reading.sampler != "slices":
        return session(*arguments, warmup=warmup, reading=reading)
    plain = dataclasses.replace(reading, sampler="plain")
    fast = jax.custom_jvp(
        jax.custom_batching.sequential_vmap(
            partial(session, warmup=warmup, reading=reading)
        )
    )
    fast.defjvp(partial(jax.jvp, partial(session, warmup=warmup, reading=plain)))
    return fast(*arguments)


def fastest_reading() -> Reading:
    """Return how sources are read fastest here: by slices on a CPU, else by gathers."""
    return SLICES if jax.default_backend() == "cpu" else GATHER


_jitted_session = jax.jit(differentiable_session, static_argnames=("warmup", "reading"))


def simulate(
    scene: AbstractScene | Texture,
    camera: Camera,
    technique: AbstractTechnique,
    poses: Poses | Float[np.ndarray, "frames 4"],
    *,
    warmup: int = 0,
    region: Region | None = None,
    reading: Reading | None = None,
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
    - `reading`: how pictures are read; None is the fastest exact way on this device.

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
    # A texture that was baked before brings the precision of the simulation, down to
    # float32: shorter texels are only stored so.
    stored = texture.color_texels.dtype
    dtype = jnp.dtype(jnp.float32) if stored.itemsize < 4 else stored
    motion = jax.tree.map(lambda leaf: leaf.astype(dtype), motion)
    if not _checks.is_traced(motion.offset):
        _check_margin(texture, camera, region, motion)
    return _jitted_session(
        texture,
        camera,
        technique.on_pictures(),
        motion,
        region,
        region,
        warmup=warmup,
        reading=fastest_reading() if reading is None else reading,
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
    *_, rows, columns = texture.color_texels.shape
    if (k * rows, k * columns) != expected:
        raise ValueError(
            f"scene must be a texture baked for this camera, {expected} texels, got "
            f"{(k * rows, k * columns)}."
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
