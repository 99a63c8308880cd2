"""Baking: a scene seen from the hold pose, as one texture."""

import functools
import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, DTypeLike, Float, Int

from .. import _checks, color
from ..camera import Camera
from ..frames import resampling
from ..frames.resampling import Texels
from ..frames.sources import AbstractSource
from ..frames.texture import Texture
from .base import AbstractScene, Colors, check_scene, nameless

_SAMPLES = 4  # per display pixel and axis, in the SSAA(4) reference


_STRIP_ROWS = 32  # texel rows in work at once: about 4 MB of samples


_LIMIT_DEG = 85.0  # the image plane grows without bound towards 90 degrees


def bake(
    scene: AbstractScene,
    camera: Camera,
    *,
    oversampling: int = 2,
    margin_deg: float = 6.0,
    least_margin_px: int = 0,
    dtype: DTypeLike = jnp.float32,
) -> Texture:
    """Paint the image plane of the hold pose, with a margin, as a texture.

    **Arguments:**

    - `oversampling`: texels per display pixel and axis: 1, 2 or 4.
    - `margin_deg`: how far the head may wander; deg, at least 0. On all four sides the
      plane extends by what the axis with the wider field of view needs for it.
    - `least_margin_px`: or by so many display px, if that is more: textures of several
      cameras then have one shape.
    - `dtype`: of the texels: float32, float64, or bfloat16, painted in float32.

    **Returns:** a `Texture`, its colour exact at the texels' centres, its reference the
    SSAA(4) mean over one display pixel around them.

    **Errors:** `ValueError` if the oversampling is another, if half the field of view
    and the margin together reach 85 degrees, and for a scene that is none, or returns
    another shape or, outside compiled code, colours outside `[0, 1]`.

    **Accuracy:** what is read between texels is interpolated from them. One compilation
    serves all scenes of one class and shapes.
    """
    margin_px = max(check_baking(camera, oversampling, margin_deg), least_margin_px)
    check_scene(scene, camera)
    if isinstance(scene, AbstractSource):
        raise ValueError(
            f"scene {scene.name!r} must not be baked, for it has depth: it is seen as "
            "it is; hj.scenes.Baked(scene) is its colours alone."
        )
    # Positions have too many digits for a shorter dtype than float32.
    painted_dtype = jnp.dtype(jnp.float32 if jnp.dtype(dtype).itemsize < 4 else dtype)
    painted = _paint(nameless(scene), camera, oversampling, margin_px, painted_dtype)
    _checks.colors(f"colours of scene {scene.name!r}", painted[0])
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
