"""Pictures that scenes store and read."""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Int, Num

from .. import _checks
from .base import Colors, Coordinate

StoredPlanes = Num[Array, "channels height width"]


Index = Int[Array, "*size"]


def mirror(index: Index, size: int) -> Index:
    """Fold an index back at the outer edges of the border texels."""
    index = repeat(index, 2 * size)
    return jnp.minimum(index, 2 * size - 1 - index)


def repeat(index: Index, size: int) -> Index:
    """Wrap an index around: the picture repeats."""
    # A division of floats is several times as fast as one of integers. It is right for
    # indices up to a million; what is farther away stays at least in bounds.
    turns = jnp.floor((index.astype(jnp.float32) + 0.5) / size)
    return jnp.clip(index - size * turns.astype(jnp.int32), 0, size - 1)


def clamp(index: Index, size: int) -> Index:
    """Keep an index at the border texel."""
    return jnp.clip(index, 0, size - 1)


def stored_planes(picture: ArrayLike) -> StoredPlanes:
    """Bring a picture to the form in which scenes keep it.

    **Arguments:** `picture`: gamma, shape `(height, width)` or `(height, width, 3)`;
    uint8, uint16, or floating in `[0, 1]`.

    **Returns:** the same codes, shape `(1, height, width)` or `(3, height, width)`.

    **Errors:** `ValueError` for any other shape, dtype or range.
    """
    _checks.unmasked("picture", picture)
    picture = np.asarray(picture)
    if picture.ndim not in (2, 3) or picture.shape[2:] not in ((), (3,)):
        raise ValueError(
            "picture must have the shape (height, width) or (height, width, 3), "
            f"got {picture.shape}."
        )
    if 0 in picture.shape:
        raise ValueError(f"picture must be at least 1 x 1, got {picture.shape}.")
    if jnp.issubdtype(picture.dtype, jnp.floating):
        for value in (picture.min(), picture.max()):
            _checks.in_range("picture", float(value), 0, 1)
    channels_last = picture if picture.ndim == 3 else picture[..., None]
    planes = jnp.asarray(np.moveaxis(channels_last, -1, 0))
    check_planes(planes)
    return planes


def check_planes(planes: StoredPlanes) -> None:
    """Raise unless planes are of a shape and a dtype that scenes keep."""
    if planes.ndim != 3 or planes.shape[0] not in (1, 3):
        raise ValueError(
            "planes must have the shape (1, height, width) or (3, height, width), got "
            f"{planes.shape}: Photograph.of and Panorama.of take (height, width, 3)."
        )
    if planes.dtype not in (jnp.uint8, jnp.uint16):
        _checks.floating("picture", planes, "uint8, uint16 or floating")


def read_planes(
    planes: StoredPlanes,
    column: Coordinate,
    row: Coordinate,
    fold_column: Callable[[Index, int], Index],
    fold_row: Callable[[Index, int], Index],
) -> Colors:
    """Read a stored picture bilinearly in gamma, as image viewers do.

    **Arguments:**

    - `planes`: see `stored_planes`; one channel is grey.
    - `column`, `row`: position, texels; texel i has its centre at i. Shape `size`.
    - `fold_column`, `fold_row`: `mirror`, `repeat` or `clamp`, what lies beyond edges.

    **Returns:** shape `(3, *size)`, dtype of `column`.
    """
    channels, height, width = planes.shape
    flat = planes.reshape(-1)
    # Grey is read three times, like red, green and blue: XLA would repeat one read for
    # each use of its three copies, and does it more slowly.
    channel = jnp.arange(3, dtype=jnp.int32) % channels
    first = (channel * (height * width)).reshape(3, *(1,) * column.ndim)
    left, top = jnp.floor(column), jnp.floor(row)
    u, v = (column - left)[None], (row - top)[None]
    x, y = left.astype(jnp.int32), top.astype(jnp.int32)
    x0, x1 = fold_column(x, width), fold_column(x + 1, width)
    y0, y1 = fold_row(y, height), fold_row(y + 1, height)

    def at(x: Index, y: Index) -> Colors:
        # Unsigned, or the gather would look for negative indices first.
        index = (first + (y * width + x)[None]).astype(jnp.uint32)
        return flat.at[index].get(mode="promise_in_bounds").astype(column.dtype)

    upper, lower = at(x0, y0), at(x0, y1)
    upper = upper + u * (at(x1, y0) - upper)
    lower = lower + u * (at(x1, y1) - lower)
    colors = upper + v * (lower - upper)
    if not jnp.issubdtype(planes.dtype, jnp.floating):
        colors = colors / jnp.iinfo(planes.dtype).max
    return colors
