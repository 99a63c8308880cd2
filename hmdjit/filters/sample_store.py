"""Samples of the last frames at twice the resolution, moved with what they show.

A pixel has four cells. Where cells meet, the newest stays, then the nearest, then the
first in rows from the top.

**Source:** TIDOAA, with the choices that its text leaves open.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._types import Numbers, Rgb, WholeNumber
from ..frames.frame import MOTION_CLASSES, Frame
from ..frames.motion import Motion
from ..frames.velocity import next_displacement
from . import scattering

_LEAST_VALIDITY = 0.1
_DECAY = 0.5  # of validity, per frame: a sample lives for four
_RIGHT, _LOWER = np.array([[0, 1, 0, 1], [0, 0, 1, 1]], np.int32)[:, :, None, None]
_STATIC, _RIGID = map(MOTION_CLASSES.index, ("static", "rigid"))


class Store(NamedTuple):
    """Four cells of each pixel, row by row: a picture of twice the resolution.

    - `color`: as it was inserted.
    - `validity`: 1 of a sample of this frame, halved with each; 0 of an empty cell.
    - `depth`: distance from the eye along -z, m.
    - `thing`: 0 of all that is static, the id + 1 of what is rigid, below 0 of what
      deforms.
    - `offset_px`: where the sample lies, from the cell's centre; None is there.
    - `frame`: its number.
    """

    color: Float[Array, "3 cells height width"]
    validity: Float[Array, "cells height width"]
    depth: Float[Array, "cells height width"]
    thing: Int[Array, "cells height width"]
    offset_px: Float[Array, "2 cells height width"] | None
    frame: WholeNumber


def empty(like: Rgb, *, has_offsets: bool) -> Store:
    """Return a store without a sample, of pictures like one."""
    dtype, size = like.dtype, (4, *like.shape[-2:])
    return Store(
        color=jnp.zeros((3, *size), dtype),
        validity=jnp.zeros(size, dtype),
        depth=jnp.ones(size, dtype),
        thing=jnp.zeros(size, jnp.int32),
        offset_px=jnp.zeros((2, *size), dtype) if has_offsets else None,
        frame=jnp.int32(0),
    )


def inserted(
    store: Store,
    frame: Frame,
    seen: Rgb,
    cell: WholeNumber,
    sample_px: Float[Array, "2"],
) -> Store:
    """Put a frame's samples in one cell of each pixel, instead of what is there.

    **Arguments:** `seen`: its colours; `cell`: 0 to 3; `sample_px`: where the samples
    lie, from the pixel's centre.
    """
    kind, offset_px = frame.motion_class, store.offset_px
    if offset_px is not None:
        centre_px = jnp.stack([cell % 2, cell // 2]) / 2 - 0.25
        here = sample_px - centre_px.astype(sample_px.dtype)
        offset_px = offset_px.at[:, cell].set(here[:, None, None])
    own = jnp.where(kind == _RIGID, frame.object_id + 1, -1 - frame.object_id)
    return Store(
        color=store.color.at[:, cell].set(seen),
        validity=store.validity.at[cell].set(1),
        depth=store.depth.at[cell].set(jax.lax.stop_gradient(frame.depth)),
        thing=store.thing.at[cell].set(jnp.where(kind == _STATIC, 0, own)),
        offset_px=offset_px,
        frame=store.frame + 1,
    )


def resolved(store: Store) -> Rgb:
    """Mean of each pixel's valid cells."""
    is_valid = store.validity >= _LEAST_VALIDITY
    seen = jnp.where(is_valid[None], store.color, 0)
    total = functools.reduce(jnp.add, jnp.moveaxis(seen, 1, 0))
    count = functools.reduce(jnp.add, is_valid.astype(total.dtype))
    return total / count[None]


def reprojected(store: Store, frame: Frame, motion: Motion) -> Store:
    """Move what is valid to where its surface is now, a frame older.

    What deforms is not moved. Only colours have derivatives.
    """
    frame, motion = jax.lax.stop_gradient((frame, motion))
    _, height, width = store.validity.shape
    cells = store.validity.size
    row, column = (
        (2 * jnp.arange(size, dtype=jnp.int32)).reshape(shape) + beside
        for size, shape, beside in (
            (height, (1, -1, 1), _LOWER),
            (width, (1, 1, -1), _RIGHT),
        )
    )
    dx, dy, depth = _displacement(store, frame, motion, row, column)
    offset_x, offset_y = (0, 0) if store.offset_px is None else store.offset_px
    rightwards = jnp.floor(2 * (offset_x + dx) + 0.5)
    downwards = jnp.floor(2 * (offset_y + dy) + 0.5)
    to_column = column.astype(dx.dtype) + rightwards
    to_row = row.astype(dy.dtype) + downwards
    is_in = (to_column >= 0) & (to_column < 2 * width)
    is_in = is_in & (to_row >= 0) & (to_row < 2 * height)
    goes = _goes(store) & is_in
    to_row, to_column = (
        jnp.where(goes, place, 0).astype(jnp.int32) for place in (to_row, to_column)
    )
    targets = jnp.where(goes, _index(to_row, to_column, height, width), cells)
    first = scattering.winners(
        targets.reshape(-1),
        [-store.validity.reshape(-1), depth.reshape(-1)],
        (2 * width * row + column).reshape(-1),
    )
    row = first // (2 * width)
    source = _index(row, first - 2 * width * row, height, width)

    def moved(planes: Array) -> Array:
        flat = planes.reshape(*planes.shape[:-3], cells)
        return flat.at[..., source].get(mode="clip").reshape(planes.shape)

    offset_px = store.offset_px
    if offset_px is not None:
        gone = jnp.stack([dx - rightwards / 2, dy - downwards / 2])
        offset_px = moved(offset_px + gone)
    is_filled = (first < cells).reshape(store.validity.shape)
    return Store(
        color=moved(store.color),
        validity=jnp.where(is_filled, moved(_DECAY * store.validity), 0),
        depth=moved(depth),
        thing=moved(store.thing),
        offset_px=offset_px,
        frame=store.frame,
    )


def _index(row: Numbers, column: Numbers, height: int, width: int) -> Numbers:
    """Where a cell of the picture of twice the resolution is in the store."""
    cell = 2 * (row % 2) + column % 2
    return (cell * height + row // 2) * width + column // 2


def _displacement(
    store: Store, frame: Frame, motion: Motion, row: Numbers, column: Numbers
) -> tuple[Numbers, Numbers, Numbers]:
    """How far cells move, px, and their depth after that."""
    region, dtype = frame.region, store.depth.dtype
    x = (column.astype(dtype) + 0.5) / 2 + jnp.asarray(region.x0, dtype)
    y = (row.astype(dtype) + 0.5) / 2 + jnp.asarray(region.y0, dtype)
    if store.offset_px is not None:
        x, y = x + store.offset_px[0], y + store.offset_px[1]
    still = jnp.zeros_like(motion.increment)
    moved_m = still if motion.translation_m is None else motion.translation_m
    steps, thing = (motion.increment, moved_m), None
    if frame.steps is not None:
        pairs = zip(steps, frame.steps, strict=True)
        steps = tuple(jnp.concatenate([own[None], each]) for own, each in pairs)
        thing = jnp.maximum(store.thing, 0)
    turned, moved = steps
    return next_displacement(frame.camera, x, y, store.depth, turned, moved, thing)


def _goes(store: Store) -> Array:
    """Which cells are moved: of several things in a pixel only the newest samples."""
    is_valid = store.validity > _LEAST_VALIDITY
    most = jnp.iinfo(store.thing.dtype).max
    least = functools.reduce(jnp.minimum, jnp.where(is_valid, store.thing, most))
    largest = functools.reduce(jnp.maximum, jnp.where(is_valid, store.thing, -most))
    newest = functools.reduce(jnp.maximum, store.validity)
    is_one = (least >= largest)[None] | (store.validity == newest[None])
    is_shown = _DECAY * store.validity >= _LEAST_VALIDITY  # else it need not move
    is_finite = functools.reduce(jnp.logical_and, jnp.isfinite(store.color))
    return is_shown & is_one & (store.thing >= 0) & is_finite
