"""Reading a picture between its pixels: nearest, bilinear, Catmull-Rom.

A picture is stored as *texels*, `(k, k, channels, rows, columns)`: of every k x k
texels the one at phase `(j, i)` lies in the plane `[j, i]`. Neighbouring display
pixels, k texels apart, are then neighbours in memory. Readers take the centre of texel
`(column, row)` moved by `(dx, dy)` texels. The displacement stays apart from the
position because their sum, near 1000, would lose the digits that matter. Positions
beyond the border clamp to it. The result is planes, `(channels, height, width)`.

`nearest`, `bilinear` and `catmull_rom` gather, for any displacement.
`bilinear_by_slices` is `bilinear` for a block of pixels that move nearly alike: several
times as fast on a CPU.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._types import Numbers, Picture, Planes, WholeNumber

# Not "height width": a stored picture may differ in shape from the region read.
Texels = Float[Array, "phases phases channels rows columns"]

TAPS = ((2, 2), (3, 3), (4, 4))
"""Rows and columns of texels that a block's pixels may reach, one program each."""


def texels(picture: Picture | Float[Array, "h w c"], oversampling: int = 1) -> Texels:
    """Store a picture `(height, width, channels)`, `oversampling` texels per pixel.

    Height and width must be multiples of the oversampling.
    """
    k = oversampling
    height, width, channels = picture.shape
    phases = picture.reshape(height // k, k, width // k, k, channels)
    return jnp.transpose(phases, (1, 3, 4, 0, 2))


def picture(texels: Texels) -> Float[Array, "h w c"]:
    """Return the picture that was stored, `(height, width, channels)`."""
    k, _, channels, rows, columns = texels.shape
    return jnp.transpose(texels, (3, 0, 4, 1, 2)).reshape(
        k * rows, k * columns, channels
    )


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
    k, _, _, rows, columns = texels.shape
    column = jnp.clip(column, 0, k * columns - 1)
    row = jnp.clip(row, 0, k * rows - 1)
    picked = texels.at[row % k, column % k, :, row // k, column // k]
    return picked.get(mode="promise_in_bounds")


def _to_planes(pixels: Float[Array, "h w c"]) -> Float[Array, "c h w"]:
    return jnp.moveaxis(pixels, -1, 0)


@jax.jit
def nearest(
    texels: Texels, column: Numbers, row: Numbers, dx: Numbers, dy: Numbers
) -> Float[Array, "channels h w"]:
    """Colour of the texel whose centre is nearest (to the right or below on a tie).

    **Arguments:**

    - `texels`: the stored picture.
    - `column`, `row`: whole texels, int32; shapes that broadcast to `(h, w)`.
    - `dx`, `dy`: displacement from that texel's centre, texels; shape `(h, w)`.

    **Returns:** shape `(channels, h, w)`, in the dtype of `texels`.
    """
    x = column + _to_index(jnp.floor(dx + 0.5))
    y = row + _to_index(jnp.floor(dy + 0.5))
    return _to_planes(_fetch(texels, x, y))


@jax.jit
def bilinear(
    texels: Texels, column: Numbers, row: Numbers, dx: Numbers, dy: Numbers
) -> Float[Array, "channels h w"]:
    """Weighted mean of the 2 x 2 texels around a position.

    **Arguments:** as `nearest`.

    **Returns:** shape `(channels, h, w)`, in the dtype of the displacement.

    **Accuracy:** exact for pictures that are affine in x and in y. Continuous; the
    gradient in the displacement is the one to the right where a texel's centre is hit.
    """
    x, y = _split(dx, column), _split(dy, row)
    u, v = x.fraction[..., None], y.fraction[..., None]
    fetch = lambda column, row: _fetch(texels, column, row).astype(dx.dtype)
    top_left = fetch(x.texel, y.texel)
    top_right = fetch(x.texel + 1, y.texel)
    low_left = fetch(x.texel, y.texel + 1)
    low_right = fetch(x.texel + 1, y.texel + 1)
    top = top_left + _part(u, top_right - top_left)
    low = low_left + _part(u, low_right - low_left)
    return _to_planes(top + _part(v, low - top))


@jax.custom_jvp
def _part(weight: Numbers, of: Numbers) -> Numbers:
    """Product whose slope in the weight is 0 where what it weighs is no number.

    A texel that is not finite shows as such. Where it is then masked out, it must not
    come back as 0 x NaN in the gradient of the position.
    """
    return weight * of


@_part.defjvp
def _part_jvp(primals: tuple, tangents: tuple) -> tuple[Numbers, Numbers]:
    (weight, of), (weight_dot, of_dot) = primals, tangents
    slope = jnp.where(jnp.isfinite(of), of, 0.0)
    return weight * of, weight_dot * slope + weight * of_dot


def bilinear_by_slices(
    texels: Texels,
    column: WholeNumber,
    row: WholeNumber,
    shape: tuple[int, int],
    span: Float[Array, "2 2"],
    displacement: Callable[[], tuple[Numbers, Numbers]],
) -> Planes:
    """Read a block bilinearly: one contiguous slice of the picture per tap.

    Where a block's pixels move nearly alike, all read the same few texels, each from
    its own place: a tap is then a slice, and its weight `max(0, 1 - |u - tap|)`. What
    reaches farther than `TAPS`, or beyond the stored picture, is gathered instead.

    The choice between them is also a boundary that XLA does not fuse across: left
    alone, it would read anew for every use of the result.

    **Arguments:**

    - `texels`: the stored picture; each phase has one texel per display pixel.
    - `column`, `row`: the display pixel that the block's first one lies on.
    - `shape`: height and width of the block, px; static.
    - `span`: smallest and largest `(dx, dy)` in the block, never too narrow; texels.
    - `displacement`: gives `(dx, dy)`, texels, each `shape`.

    **Returns:** shape `(channels, *shape)`, in the dtype of `span`.

    **Accuracy:** as `bilinear`, up to rounding. A texel that is not finite shows in all
    pixels that have a tap on it, whatever its weight, and in their slopes.
    """
    k, _, channels, rows, columns = texels.shape
    height, width = shape
    low, high = jnp.floor(span)
    reach = high - low + 2  # taps along x and y; not finite if the span is not
    first = _to_index(jnp.nan_to_num(low))
    start = jnp.stack([jnp.asarray(i, jnp.int32) for i in (column, row)])
    room = jnp.array([columns - width, rows - height], jnp.int32)

    def fits(taps: tuple[int, int]) -> Array:
        count = jnp.array(taps[::-1], jnp.int32)
        begin = start + first // k
        end = start + (first + count - 1) // k
        is_stored = (begin >= 0) & (end <= room)
        return jnp.all(is_stored & (reach <= count.astype(reach.dtype)))

    def sliced(taps: tuple[int, int]) -> Planes:
        dx, dy = displacement()

        def tap(j: int, i: int) -> Planes:
            x, y = first[0] + i, first[1] + j
            zero = jnp.zeros_like(x)
            place = (y % k, x % k, zero, start[1] + y // k, start[0] + x // k)
            size = (1, 1, channels, height, width)
            return jax.lax.dynamic_slice(texels, place, size)[0, 0].astype(dx.dtype)

        u, v = dx - low[0], dy - low[1]
        lines = [
            _between([tap(j, i) for i in range(taps[1])], u[None])
            for j in range(taps[0])
        ]
        return _between(lines, v[None])

    def gathered() -> Planes:
        dx, dy = displacement()
        x = k * (start[0] + jnp.arange(width, dtype=jnp.int32))[None, :]
        y = k * (start[1] + jnp.arange(height, dtype=jnp.int32))[:, None]
        return bilinear(texels, x, y, dx, dy)

    choices = [*(fits(taps) for taps in TAPS), jnp.array(True)]
    branches = [*(lambda taps=taps: sliced(taps) for taps in TAPS), gathered]
    return jax.lax.switch(jnp.argmax(jnp.stack(choices)), branches)


def _between(values: list[Planes], t: Numbers) -> Planes:
    """Piecewise linear through `values` at 0, 1, 2, ...; extrapolates beyond them."""
    if len(values) == 2:
        return values[0] + t * (values[1] - values[0])
    middle = values[1] + jnp.maximum(1 - t, 0) * (values[0] - values[1])
    for i in range(1, len(values) - 2):
        middle = middle + jnp.clip(t - i, 0, 1) * (values[i + 1] - values[i])
    last = len(values) - 2
    return middle + jnp.maximum(t - last, 0) * (values[-1] - values[-2])


@jax.jit
def catmull_rom(
    texels: Texels, column: Numbers, row: Numbers, dx: Numbers, dy: Numbers
) -> Float[Array, "channels h w"]:
    """Cubic interpolation through the 4 x 4 texels around a position.

    **Arguments, returns:** as `bilinear`; values may overshoot those of the texels.

    **Accuracy:** exact for quadratic pictures away from the border; smooth.

    **Source:** Catmull and Rom 1974; Keys 1981, equation 15 with a = -1/2.
    """
    x, y = _split(dx, column), _split(dy, row)
    total = jnp.zeros((), dx.dtype)
    for j, weight_y in enumerate(_catmull_rom_weights(y.fraction), start=-1):
        for i, weight_x in enumerate(_catmull_rom_weights(x.fraction), start=-1):
            tap = _fetch(texels, x.texel + i, y.texel + j).astype(dx.dtype)
            total = total + _part((weight_x * weight_y)[..., None], tap)
    return _to_planes(total)


def _catmull_rom_weights(t: Numbers) -> list[Numbers]:
    return [
        t * (-0.5 + t * (1 - 0.5 * t)),
        1 + t**2 * (-2.5 + 1.5 * t),
        t * (0.5 + t * (2 - 1.5 * t)),
        t**2 * (-0.5 + 0.5 * t),
    ]
