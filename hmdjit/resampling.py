"""Reading a picture between its pixels: nearest, bilinear, Catmull-Rom.

All three read *texels*, a picture stored as `(height, width, channels)` rows so that
one gather fetches all channels, at the centre of texel `(column, row)` moved by
`(dx, dy)` texels. The displacement stays apart from the position because their sum,
near 1000, would lose the digits that matter. Positions beyond the border clamp to it.
The result is planes, `(channels, height, width)`.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._types import Numbers

# Not "height width": a stored picture may differ in shape from the region read.
Texels = Float[Array, "rows columns channels"]


class _Tap(NamedTuple):
    texel: Numbers
    fraction: Numbers


def _to_index(whole: Numbers) -> Numbers:
    # Far beyond any border, but adding to it does not overflow to the other side.
    return jnp.clip(whole, -(2.0**30), 2.0**30).astype(jnp.int32)


def _split(displacement: Numbers, origin: Numbers) -> _Tap:
    whole = jnp.floor(displacement)
    return _Tap(origin + _to_index(whole), displacement - whole)


def _fetch(texels: Texels, column: Numbers, row: Numbers) -> Float[Array, "h w c"]:
    height, width, _ = texels.shape
    column = jnp.clip(column, 0, width - 1)
    row = jnp.clip(row, 0, height - 1)
    return texels.at[row, column].get(mode="promise_in_bounds")


def _to_planes(pixels: Float[Array, "h w c"]) -> Float[Array, "c h w"]:
    return jnp.moveaxis(pixels, -1, 0)


@jax.jit
def nearest(
    texels: Texels, column: Numbers, row: Numbers, dx: Numbers, dy: Numbers
) -> Float[Array, "channels h w"]:
    """Colour of the texel whose centre is nearest (to the right or below on a tie).

    **Arguments:**

    - `texels`: the picture, shape `(height, width, channels)`.
    - `column`, `row`: whole texels, int32; shapes that broadcast to `(h, w)`.
    - `dx`, `dy`: displacement from that texel's centre, texels; shape `(h, w)`.

    **Returns:** shape `(channels, h, w)`.
    """
    x = column + _to_index(jnp.floor(dx + 0.5))
    y = row + _to_index(jnp.floor(dy + 0.5))
    return _to_planes(_fetch(texels, x, y))


@jax.jit
def bilinear(
    texels: Texels, column: Numbers, row: Numbers, dx: Numbers, dy: Numbers
) -> Float[Array, "channels h w"]:
    """Weighted mean of the 2 x 2 texels around a position.

    **Arguments, returns:** as `nearest`.

    **Accuracy:** exact for pictures that are affine in x and in y. Continuous; the
    gradient in the displacement is the one to the right where a texel's centre is hit.
    """
    x, y = _split(dx, column), _split(dy, row)
    u, v = x.fraction[..., None], y.fraction[..., None]
    top_left = _fetch(texels, x.texel, y.texel)
    top_right = _fetch(texels, x.texel + 1, y.texel)
    low_left = _fetch(texels, x.texel, y.texel + 1)
    low_right = _fetch(texels, x.texel + 1, y.texel + 1)
    top = top_left + u * (top_right - top_left)
    low = low_left + u * (low_right - low_left)
    return _to_planes(top + v * (low - top))


@jax.jit
def catmull_rom(
    texels: Texels, column: Numbers, row: Numbers, dx: Numbers, dy: Numbers
) -> Float[Array, "channels h w"]:
    """Cubic interpolation through the 4 x 4 texels around a position.

    **Arguments, returns:** as `nearest`; values may overshoot those of the texels.

    **Accuracy:** exact for quadratic pictures away from the border; smooth.

    **Source:** Catmull and Rom 1974; Keys 1981, equation 15 with a = -1/2.
    """
    x, y = _split(dx, column), _split(dy, row)
    total = jnp.zeros((), texels.dtype)
    for j, weight_y in enumerate(_catmull_rom_weights(y.fraction), start=-1):
        for i, weight_x in enumerate(_catmull_rom_weights(x.fraction), start=-1):
            tap = _fetch(texels, x.texel + i, y.texel + j)
            total = total + (weight_x * weight_y)[..., None] * tap
    return _to_planes(total)


def _catmull_rom_weights(t: Numbers) -> list[Numbers]:
    return [
        t * (-0.5 + t * (1 - 0.5 * t)),
        1 + t**2 * (-2.5 + 1.5 * t),
        t * (0.5 + t * (2 - 1.5 * t)),
        t**2 * (-0.5 + 0.5 * t),
    ]
