"""How wide a halo keeps what a region's edge does out of the measured pixels.

How far a technique reads its history is found by tracing its step; how much of an error
there can remain is its hint, or all of it.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..camera import Camera, Region
from ..frames.displacement import AnyDisplacement, DisplacementField
from ..frames.motion import Motion
from ..frames.sources import AbstractSource, View, recorded_reads
from ..technique_contract.base import AbstractTechnique
from ..technique_contract.shapes import blank_frame
from ..technique_contract.stencil import stencil_radius_px
from . import blocks

HALO_TOLERANCE = 1e-5
"""What a halo's outer edge does may reach measured pixels with less than this."""


_SEEN = {"velocity", "depth"}  # by which reads of the past depend on what is seen
_WIDEST_PX = 4096  # a halo as wide as this reaches the edges of the camera frame


def required_halo_px(
    inwards_px: Float[np.ndarray, "*sessions frames 4"],
    gain: Float[np.ndarray, "*sessions frames"],
    *,
    tolerance: float = HALO_TOLERANCE,
) -> Int[np.ndarray, "*sessions"]:
    """Halo that keeps what its outer edge does out of the measured pixels.

    Let `e_j` bound the error at depth j pixels from an edge. Pixels beyond the edge are
    wrong by up to 1. A history read from up to `s = n + f` px nearer to the edge mixes
    depths `j - n` and `j - n - 1` with weights `1 - f` and `f` (bilinear), and of that
    mix at most the technique's gain g remains:
    `e_j <- g ((1 - f) e_{j-n} + f e_{j-n-1})`. A negative s, a read from farther
    inside, takes error away from the edge.

    **Arguments:**

    - `inwards_px`: how far history may come in through a region's left, top, right and
      bottom edge in each frame; negative where it is read from farther inside.
    - `gain`: how much of an error in the history can remain.

    **Returns:** per session, the smallest whole halo, px, whose error after any frame,
    horizontal plus vertical, is below `tolerance` (of the colour range).
    """
    *sessions, frames, _ = inwards_px.shape
    # The four edges are four cases of one recursion. No frame is wider than the limit.
    inwards_px = np.clip(inwards_px, -_WIDEST_PX, _WIDEST_PX)
    step = np.moveaxis(inwards_px, -1, 0).reshape(-1, frames)
    gain = np.broadcast_to(gain, (4, *gain.shape)).reshape(-1, frames)
    whole = np.floor(step).astype(int)
    fraction = step - whole
    deepest = int(np.max(np.sum(np.maximum(whole + 1, 0), axis=1), initial=0))
    deepest = min(deepest, _WIDEST_PX)
    depth = np.arange(1, deepest + 1)
    error = np.zeros((len(step), deepest + 1))  # depth 0 is beyond the edge
    error[:, 0] = 1.0
    halo = np.zeros(len(step), int)
    for k in range(frames):
        near_depth = np.clip(depth - whole[:, k, None], 0, deepest)
        far_depth = np.clip(depth - whole[:, k, None] - 1, 0, deepest)
        near = np.take_along_axis(error, near_depth, axis=1)
        far = np.take_along_axis(error, far_depth, axis=1)
        mixed = near + fraction[:, k, None] * (far - near)
        # An error cannot exceed the colour range.
        error[:, 1:] = np.minimum(gain[:, k, None] * mixed, 1.0)
        # Errors fall with depth, so those above the tolerance are the first ones; at
        # each of two edges (left or right, top or bottom) half of it is allowed.
        halo = np.maximum(halo, np.sum(error >= tolerance / 2, axis=1) - 1)
    return np.max(halo.reshape(4, *sessions), axis=0)


_NEAR_PX = 32  # how far around a block its displacements are bounded
_AT_A_TIME = 64  # sessions, to compile once for batches and the last of them


def needed_halo_px(
    technique: AbstractTechnique,
    camera: Camera,
    motion: Motion,
    origins: Int[Array | np.ndarray, "sessions blocks 2"],
    block: tuple[int, int],
    source: AbstractSource | None = None,
) -> Int[np.ndarray, " sessions"]:
    """Halo that the blocks of each session need with a technique; `(sessions,)`.

    **Arguments:**

    - `origins`, `block`: the measured blocks' places, and their width and height, px.
    - `source`: what is seen, where it says how fast its things move; None is a picture.

    **Errors:** `ValueError` for a technique that reads its history inside of another
    traced function.
    """
    if technique.needs.isdisjoint(_SEEN):  # no read depends on what is seen
        source = None
    count, frame = origins.shape[0], (camera.width_px, camera.height_px)
    if block == frame:
        return np.zeros(count, int)
    increment = np.asarray(motion.increment)
    speed = np.linalg.norm(increment, axis=-1)
    speed_deg_s = np.degrees(speed) * float(camera.refresh_hz)
    stencil, around = stencil_radius_px(technique), technique.history_radius_px
    around = stencil if around is None else around
    gain = technique.history_gain(speed_deg_s)

    def halo(around_px: int) -> Int[np.ndarray, " sessions"]:
        inwards = _inwards_px(
            technique, camera, source, motion, origins, block, around_px
        )
        if inwards is None:
            return np.full(count, stencil)
        # Errors in the current frame's edge come in as well, once.
        tolerance = HALO_TOLERANCE / technique.display_slope
        return stencil + required_halo_px(inwards + around, gain, tolerance=tolerance)

    needed = halo(_NEAR_PX)
    if np.any(needed > _NEAR_PX):
        # So wide a halo reaches pixels that may move faster: bound the whole frame.
        needed = np.where(needed > _NEAR_PX, halo(max(frame)), needed)
    return needed


def _inwards_px(
    technique: AbstractTechnique,
    camera: Camera,
    source: AbstractSource | None,
    motion: Motion,
    origins: Int[Array | np.ndarray, "sessions blocks 2"],
    block: tuple[int, int],
    around_px: int,
) -> Float[np.ndarray, "sessions frames 4"] | None:
    """How far a session's history comes in through its blocks' edges; None if unread.

    Bounded over what lies `around_px` around the blocks.
    """
    count = len(origins)
    filled = np.resize(np.arange(count), -(-count // _AT_A_TIME) * _AT_A_TIME)
    moves = jax.tree.map(lambda leaf: np.asarray(leaf)[filled], motion)
    places = origins[filled]
    try:
        spans = np.asarray(
            _spans(technique, camera, source, moves, places, block, around_px)
        )
    except jax.errors.UnexpectedTracerError:
        raise ValueError(
            f"step of {technique.id} must read its history outside of jit, vmap, cond "
            "and loops: how far it reads cannot be found."
        ) from None
    spans = spans[:, :count]
    if not spans.shape[3]:
        return None
    low, high = spans[..., 0, :].min(axis=(0, 3)), spans[..., 1, :].max(axis=(0, 3))
    return np.concatenate([-low, high], axis=-1)


@partial(jax.jit, static_argnames=("block", "around_px"))
def _spans(
    technique: AbstractTechnique,
    camera: Camera,
    source: AbstractSource | None,
    motion: Motion,
    origins: Int[Array, "sessions blocks 2"],
    block: tuple[int, int],
    around_px: int,
) -> Float[Array, "blocks sessions frames reads 2 2"]:
    """Range of the displacements by which a technique reads its history, px."""
    width = min(block[0] + 2 * around_px, camera.width_px)
    height = min(block[1] + 2 * around_px, camera.height_px)
    dtype = motion.increment.dtype
    steps = jnp.arange(motion.increment.shape[1], dtype=jnp.int32)

    def span(now: Motion, k: Array, origin: Array) -> Array:
        # Clipped to the frame, as a region is; its place there does not narrow it.
        x0, y0 = origin - around_px
        left = jnp.clip(x0, 0, camera.width_px - width)
        top = jnp.clip(y0, 0, camera.height_px - height)
        region = Region(left, top, width, height)
        # Of the step only where it reads is used: no picture is computed.
        bounds, nearest_m = None, jnp.inf
        if source is not None:
            view = View(camera, region, now, k)
            bounds, nearest_m = source.velocity_bounds(view), source.nearest_m(view)
        frame = blank_frame(technique, camera, region, dtype, bounds, nearest_m)
        state = technique.init(frame)
        with recorded_reads() as reads:
            technique.step(state, frame, now)
        unmoved = jnp.zeros((2, 2), dtype)
        found = [unmoved if read is None else _bounded(read) for read in reads]
        # What is kept otherwise stays where it is.
        if not blocks.is_cuttable(state) or (jax.tree.leaves(state) and not found):
            found.append(unmoved)
        return jnp.stack(found) if found else jnp.zeros((0, 2, 2), dtype)

    over_frames = jax.vmap(span, (0, 0, None))
    over_sessions = jax.vmap(over_frames, (0, None, 0))
    return jax.vmap(over_sessions, (None, None, 1))(motion, steps, origins)


def _bounded(read: AnyDisplacement) -> Float[Array, "2 2"]:
    """Range of a displacement; of a field without bounds, black as it is, all."""
    if isinstance(read, DisplacementField) and read.bounds is None:
        return jnp.asarray([[-jnp.inf] * 2, [jnp.inf] * 2], read.dtype)
    return read.span()
