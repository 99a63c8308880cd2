"""What a scene is, how a stored picture is read, and how a scene is baked to a texture.

A scene is a function from a direction in the head frame of the *hold pose* (x right,
y up, -z forward) to a gamma colour. Flat scenes are painted on the plane z = -1, the
image plane of the hold pose: a point of it is `(x, y)`, right and up, in tangent units,
each `camera.focal_px` display pixels. A size in degrees is one at the centre, where a
degree is pi / 180 tangent units (8.05 px with the default camera).
"""

import abc
import dataclasses
import functools
import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, DTypeLike, Float, Int, Num

from .. import _checks, color, resampling
from ..camera import Camera
from ..resampling import Texels
from ..sources import Texture

Directions = Float[Array, "3 *size"]
Colors = Float[Array, "3 *size"]
Coordinate = Float[Array, "*size"]
StoredPlanes = Num[Array, "channels height width"]
Index = Int[Array, "*size"]

_SAMPLES = 4  # per display pixel and axis, in the SSAA(4) reference
_STRIP_ROWS = 32  # texel rows in work at once: about 4 MB of samples
_LIMIT_DEG = 85.0  # the image plane grows without bound towards 90 degrees


class AbstractScene(eqx.Module):
    """A static world that fills the view, seen from a head that only turns.

    Everything that decides the picture is a field: numbers and texels are leaves.

    - `name`: what tables call it.
    """

    name: eqx.AbstractVar[str]

    @abc.abstractmethod
    def color(self, camera: Camera, direction: Directions) -> Colors:
        """Gamma colour seen along a direction: one exact point, no anti-aliasing.

        **Arguments:** `direction`: head frame of the hold pose, any length but 0, shape
        `(3, *size)`.

        **Returns:** in `[0, 1]`, shape `(3, *size)`, dtype of `direction`.
        """


class AbstractFlatScene(AbstractScene):
    """A scene painted on the image plane of the hold pose."""

    @abc.abstractmethod
    def plane_color(self, camera: Camera, x: Coordinate, y: Coordinate) -> Colors:
        """Gamma colour at `(x, y)` of the plane z = -1, tangent units."""

    def color(self, camera: Camera, direction: Directions) -> Colors:
        """Gamma colour where the direction meets the plane; NaN where it does not."""
        depth = -direction[2]
        in_front = depth > 0
        safe = jnp.where(in_front, depth, 1.0)
        colors = self.plane_color(camera, direction[0] / safe, direction[1] / safe)
        return jnp.where(in_front[None], colors, jnp.nan)


def mirror(index: Index, size: int) -> Index:
    """Fold an index back at the outer edges of the border texels."""
    index = repeat(index, 2 * size)
    return jnp.minimum(index, 2 * size - 1 - index)


def repeat(index: Index, size: int) -> Index:
    """Wrap an index around."""
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
    picture = np.asarray(picture)
    if picture.ndim not in (2, 3) or picture.shape[2:] not in ((), (3,)):
        raise ValueError(
            "picture must have the shape (height, width) or (height, width, 3), "
            f"got {picture.shape}."
        )
    if 0 in picture.shape:
        raise ValueError(f"picture must be at least 1 x 1, got {picture.shape}.")
    if np.issubdtype(picture.dtype, np.floating):
        for value in (picture.min(), picture.max()):
            _checks.in_range("picture", value, 0, 1)
    elif picture.dtype not in (np.uint8, np.uint16):
        raise ValueError(
            f"picture must be uint8, uint16 or floating, got {picture.dtype}."
        )
    channels_last = picture if picture.ndim == 3 else picture[..., None]
    return jnp.asarray(np.moveaxis(channels_last, -1, 0))


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


def bake(
    scene: AbstractScene,
    camera: Camera,
    *,
    oversampling: int = 2,
    margin_deg: float = 6.0,
    dtype: DTypeLike = jnp.float32,
) -> Texture:
    """Paint the image plane of the hold pose, with a margin, as a texture.

    **Arguments:**

    - `oversampling`: texels per display pixel and axis: 1, 2 or 4.
    - `margin_deg`: how far the head may wander; deg, at least 0. On all four sides the
      plane extends by what the axis with the wider field of view needs for it.
    - `dtype`: of the texels: float32, float64, or bfloat16, painted in float32.

    **Returns:** a `Texture`, its colour exact at the texels' centres, its reference the
    SSAA(4) mean over one display pixel around them.

    **Errors:** `ValueError` if the oversampling is another, or half the field of view
    and the margin together reach 85 degrees.

    **Accuracy:** what is read between texels is interpolated from them. One compilation
    serves all scenes of one class and shapes.
    """
    margin_px = check_baking(camera, oversampling, margin_deg)
    # The name is part of the program's identity: without it, scenes share a program.
    nameless = dataclasses.replace(scene, name="")
    # Positions have too many digits for a shorter dtype than float32.
    painted_dtype = jnp.dtype(jnp.float32 if jnp.dtype(dtype).itemsize < 4 else dtype)
    painted = _paint(nameless, camera, oversampling, margin_px, painted_dtype)
    colors, supersampled = (texels.astype(dtype) for texels in painted)
    return Texture(colors, supersampled, margin_px)


def check_baking(camera: Camera, oversampling: int, margin_deg: float) -> int:
    """Margin of a texture, px.

    **Errors:** those of `bake`, before anything is baked.
    """
    if oversampling not in (1, 2, 4):
        raise ValueError(f"oversampling must be 1, 2 or 4, got {oversampling!r}.")
    focal = float(camera.focal_px)
    half = math.atan(max(camera.width_px, camera.height_px) / 2 / focal)
    half_deg = math.degrees(half)
    _checks.in_range("field of view, deg", 2 * half_deg, 0, 2 * _LIMIT_DEG)
    room = _LIMIT_DEG - half_deg
    _checks.in_range("margin_deg", margin_deg, 0, room, open_high=True)
    margin = math.tan(half + math.radians(margin_deg)) - math.tan(half)
    return math.ceil(focal * margin)


@functools.partial(jax.jit, static_argnames=("oversampling", "margin_px", "dtype"))
def _paint(
    scene: AbstractScene,
    camera: Camera,
    oversampling: int,
    margin_px: int,
    dtype: jnp.dtype,
) -> tuple[Texels, Texels]:
    """Texels of the colour and of the reference."""
    width = oversampling * (camera.width_px + 2 * margin_px)
    height = oversampling * (camera.height_px + 2 * margin_px)
    # The samples of all texels lie on one grid, 1/4 px apart. A texel's box is
    # `oversampling` neighbouring groups of `group` samples along each axis.
    group = _SAMPLES // oversampling
    groups = width + oversampling - 1
    strip_groups = _STRIP_ROWS + oversampling - 1
    focal = jnp.asarray(camera.focal_px, dtype)
    origin_x = margin_px + camera.width_px / 2
    origin_y = margin_px + camera.height_px / 2
    first_sample = 0.5 / _SAMPLES - 0.5  # from a texel's centre

    def seen(column_px: Float[Array, " w"], row_px: Float[Array, " h"]) -> Colors:
        x = ((column_px - origin_x) / focal)[None, :]
        y = ((origin_y - row_px) / focal)[:, None]
        x, y = jnp.broadcast_arrays(x, y)
        return scene.color(camera, jnp.stack([x, y, -jnp.ones_like(x)]))

    def texels(first: Int[Array, ""] | int, count: int) -> Float[Array, " count"]:
        """Position of texels' centres, px; the first one's is that of a pixel."""
        index = (first + jnp.arange(count, dtype=jnp.int32)).astype(dtype)
        return 0.5 + index / oversampling

    def samples(first: Int[Array, ""] | int, count: int) -> Float[Array, " samples"]:
        """List the first sample of each group, then the second of each, ..."""
        in_group = jnp.arange(group, dtype=jnp.int32).astype(dtype) / _SAMPLES
        position = first_sample + in_group[:, None] + texels(first, count)[None, :]
        return position.reshape(-1)

    def strip(first_row: Int[Array, ""]) -> tuple[Float[Array, "rows w 3"], ...]:
        colors = seen(texels(0, width), texels(first_row, _STRIP_ROWS))
        gamma = seen(samples(0, groups), samples(first_row, strip_groups))
        light = color.decode(gamma)
        light = light.reshape(3, group, strip_groups, group, groups).sum((1, 3))
        rows = [light[:, i : i + _STRIP_ROWS] for i in range(oversampling)]
        light = functools.reduce(jnp.add, rows)
        columns = [light[:, :, i : i + width] for i in range(oversampling)]
        mean = color.encode(functools.reduce(jnp.add, columns) / _SAMPLES**2)
        return jnp.moveaxis(colors, 0, -1), jnp.moveaxis(mean, 0, -1)

    first_rows = jnp.arange(0, height, _STRIP_ROWS, dtype=jnp.int32)
    strips = jax.lax.map(strip, first_rows)
    pictures = (rows.reshape(-1, width, 3)[:height] for rows in strips)
    colors, means = (resampling.texels(picture, oversampling) for picture in pictures)
    return colors, means
