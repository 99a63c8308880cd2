"""Run a technique on frames that were rendered elsewhere: `apply`, `stream`."""

from collections.abc import Iterable, Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped

from .. import _checks
from .._types import Clip, Poses, Rgb
from ..camera import Camera
from ..frames.displacement import AT_REST, GATHER, Reading
from ..technique_contract.base import AbstractTechnique
from ..technique_contract.shapes import check_contract
from .rendered import KEYWORDS, Rendered, Views, checked_channels


@jax.jit
def _displayed(
    technique: AbstractTechnique, camera: Camera, clip: Rendered, views: Views
) -> Float[Array, "frames 3 height width"]:
    def advance(state: Any, step: tuple[Rendered, Views]) -> tuple[Any, Rgb]:
        rendered, view = step
        frame = rendered.frame(technique, camera, view)
        return technique.step(state, frame, view.motion)

    steps = (clip, views)
    first, view = jax.tree.map(lambda leaf: leaf[0], steps)
    state = technique.init(first.frame(technique, camera, view))
    begun = []
    if "velocity" in technique.needs:  # what moved before the first frame was not seen
        frame = first.frame(technique, camera, view, AT_REST)
        state, shown = technique.step(state, frame, view.motion)
        begun, steps = [shown[None]], jax.tree.map(lambda leaf: leaf[1:], steps)
    _, shown = jax.lax.scan(advance, state, steps)
    shown = jnp.concatenate([*begun, shown])
    is_known = jnp.isfinite(views.motion.offset).all()
    is_valid = is_known & camera.is_valid & technique.is_valid
    return jnp.where(is_valid, shown, jnp.nan)


def apply(
    technique: AbstractTechnique,
    camera: Camera,
    frames: Shaped[Array | np.ndarray, "..."],
    poses: Poses | Float[np.ndarray, "frames components"],
    *,
    static_mask: Bool[Array | np.ndarray, "frames height width"] | None = None,
    depth: Float[Array | np.ndarray, "..."] | None = None,
    object_id: Shaped[Array | np.ndarray, "..."] | None = None,
    motion_class: Shaped[Array | np.ndarray, "..."] | None = None,
    albedo: Shaped[Array | np.ndarray, "..."] | None = None,
    velocity_px: Float[Array | np.ndarray, "..."] | None = None,
    object_poses: Float[Array | np.ndarray, "frames objects 7"] | None = None,
    jitter_px: Float[Array | np.ndarray, "frames 2"] | None = None,
) -> Clip:
    """Run a technique on frames that were rendered elsewhere.

    **Arguments:**

    - `camera`: that the frames were rendered with; its size must be theirs.
    - `frames`: gamma colour, `(frames, height, width, 3)`; for techniques that resolve
      several samples `(frames, samples, height, width, 3)`. Floating in `[0, 1]`, or
      uint8 or uint16, whose largest code is 1. Shorter floats than float32 are computed
      in float32, history and result included.
    - `poses`: `world_from_head` of each frame, `(frames, 4)`, unit length; or with the
      eye's position in metres (world, x right, y up, z back) `(frames, 7)`.
    - `static_mask`: True where the scene is static, `(frames, height, width)`; for
      techniques that read it, which is head movement alone.

    Channels, of the shape of `frames` without its colours, for techniques that need
    them (`technique.needs`); what a technique does not need is checked and not used:

    - `depth`: distance from the eye along -z, m, above 0; inf where there is nothing.
    - `object_id`: whole numbers from 0 to 2^24 - 1; 0 is the background.
    - `motion_class`: 0 static, 1 rigid, 2 deforming.
    - `albedo`: gamma colour before it is lit, as `frames`.
    - `velocity_px`: how the content moved since the last frame, px, x right and y down,
      `(..., 2)`. Without it: as the head turns, where the eye stays in its place; else
      derived from `depth` and `poses`, and from `object_id` and `object_poses` where
      objects move by themselves.
      TIDOAA, which moves samples forward, does so by depth and poses alone, and by
      `object_poses`; it takes a velocity as a channel that is not used, so that all
      techniques may be given the same ones, and refuses rigid objects without poses.
    - `object_poses`: world from object, as `poses`, `(frames, objects, 7)`; row i is of
      the object with the id i.
    - `jitter_px`: where the one sample of each pixel lies, from its centre, px, x right
      and y down, `(frames, 2)`; without it by the technique's `sample_offsets_px`.

    **Returns:** displayed gamma frames, `(frames, height, width, 3)`; displayed frame 0
    is frame 0. NaN throughout if, inside compiled code, a pose is no unit quaternion or
    a number of the camera or of the technique is out of its range.

    **Errors:** `ValueError` if sizes, numbers of frames or of samples disagree, for
    frames of any other dtype or range, for a channel that is needed but neither given
    nor derived, and for a mask that the technique does not read.
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
    given = _given(depth, object_id, motion_class, albedo, velocity_px)
    view = (given, frames.dtype, poses, object_poses, jitter_px)
    views = Views.of(technique, *view)
    count, samples = frames.shape[0], 1 if frames.ndim == 4 else frames.shape[1]
    if count != poses.shape[0]:
        raise ValueError(
            f"poses must have one row per frame ({count}), got {poses.shape[0]}."
        )
    expected = technique.sample_offsets_px.shape[1]
    if samples != expected:
        raise ValueError(
            f"frames must have {expected} samples per pixel for {technique.id}, "
            f"got {samples}."
        )
    mask_shape = (count, *size[:2])
    mask = None if static_mask is None else jnp.asarray(static_mask, bool)
    if mask is not None:
        _checks.shape("static_mask", mask, mask_shape)
        if not technique.reads_static_mask:
            raise ValueError(f"{technique.id} reads no static_mask: leave it out.")
    shape = tuple(frames.shape[:-1])
    channels = checked_channels(technique, given, views, shape, frames.dtype)
    color = jnp.moveaxis(frames if frames.ndim == 5 else frames[:, None], -1, 2)
    clip = Rendered(color, channels, mask)
    shown = _displayed(technique, camera, clip, views.along(count))
    return jnp.moveaxis(shown, 1, -1)


def _given(*channels: Any) -> dict[str, Any]:
    """Name the channels that are not None, in the order of `apply`'s keywords."""
    named = zip(KEYWORDS, channels, strict=True)
    return {name: channel for name, channel in named if channel is not None}


@jax.jit
def _first(
    technique: AbstractTechnique, camera: Camera, rendered: Rendered, view: Views
) -> Any:
    return technique.init(rendered.frame(technique, camera, view))


@partial(jax.jit, static_argnames="reading")
def _next(
    technique: AbstractTechnique,
    camera: Camera,
    state: Any,
    rendered: Rendered,
    view: Views,
    reading: Reading,
) -> tuple[Any, Rgb]:
    frame = rendered.frame(technique, camera, view, reading)
    return technique.step(state, frame, view.motion)


def stream(
    technique: AbstractTechnique,
    camera: Camera,
    frames: Iterable[Float[np.ndarray, "height width 3"]],
    poses: Float[np.ndarray, "frames components"] | None,
    *,
    depth: Iterable[np.ndarray] | None = None,
    object_id: Iterable[np.ndarray] | None = None,
    motion_class: Iterable[np.ndarray] | None = None,
    albedo: Iterable[np.ndarray] | None = None,
    velocity_px: Iterable[np.ndarray] | None = None,
    object_poses: Float[np.ndarray, "frames objects 7"] | None = None,
    jitter_px: Float[np.ndarray, "frames 2"] | None = None,
) -> Iterator[Float[np.ndarray, "height width 3"]]:
    """Run a technique on frames that come one by one; `apply` for long clips.

    **Arguments:** as `apply`; float32, one sample per pixel. Channels come one by one,
    too. `poses`: None where none are known.

    **Returns:** displayed gamma frames, one by one.

    **Errors:** `ValueError` for a technique that needs several samples per pixel, or
    poses where there are none.
    """
    samples = technique.sample_offsets_px.shape[1]
    if samples > 1:
        raise ValueError(
            f"frames must have {samples} samples per pixel for {technique.id}, got 1."
        )
    dtype = jnp.dtype(jnp.float32)
    given = _given(depth, object_id, motion_class, albedo, velocity_px)
    views = Views.of(technique, given, dtype, poses, object_poses, jitter_px)
    others = {name: iter(channel) for name, channel in given.items()}
    state = None
    for k, picture in enumerate(frames):
        for name, rows in (("poses", poses), ("jitter_px", jitter_px)):
            if rows is not None and k >= len(rows):
                raise ValueError(
                    f"{name} must have one row per frame, got {len(rows)}."
                )
        picture = _checks.colors("frames", picture).astype(jnp.float32)
        now = {}
        for name, channel in others.items():
            if (each := next(channel, None)) is None:
                keyword = KEYWORDS[name][0]
                raise ValueError(f"{keyword} must have one per frame, got {k}.")
            now[name] = each[None]
        shape = (1, camera.height_px, camera.width_px)
        channels = checked_channels(technique, now, views, shape, dtype)
        rendered = Rendered(
            jnp.moveaxis(picture, -1, 0)[None], {n: c[0] for n, c in channels.items()}
        )
        view = views.at(k)
        state = _first(technique, camera, rendered, view) if k == 0 else state
        is_first = k == 0 and "velocity" in technique.needs
        reading = AT_REST if is_first else GATHER
        state, shown = _next(technique, camera, state, rendered, view, reading)
        if poses is None and not jnp.isfinite(shown).all():
            raise ValueError(f"{technique.id} needs poses, got none.")
        yield np.moveaxis(np.asarray(shown), 0, -1)
