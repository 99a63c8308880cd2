"""How much a picture differs from itself displaced, in each cell of the camera frame.

Tabled once per scene, it stands for the scene's pixels wherever only the size of
differences matters.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .. import _checks, color
from .._types import Numbers, Planes, Scalar
from ..camera import Camera
from ..frames import resampling
from ..frames.resampling import Texels
from ..frames.texture import Texture

DIRECTIONS = 8
"""Tabled directions, over half a circle: a picture differs as much there and back."""

# Multiples of these, modulo 1, fill a square evenly (Roberts' R2 sequence).
_R2 = (0.7548776662466927, 0.5698402909980532)

Cells = Int[Array, " cells"]
Vector = Float[Array, "2"]
Harmonics = Float[Array, "octaves harmonics"]


class PictureStatistics(eqx.Module):
    """How much a picture differs from itself displaced, in each cell of the frame.

    Let `D(u)` be the mean over a cell's pixels of the RGB distance between the picture
    and itself displaced by u, colours in `[0, 1]`. Cells go row by row, from the upper
    left one.

    - `slope_squared`: Fourier coefficients over the direction of u of `(D(u) / |u|)^2`,
      px^-2, for |u| of `finest_px`, twice, four times, ... that; shape
      `(cells, octaves, DIRECTIONS)`.
    - `finest_px`: up to this length D is proportional to it; px, above 0. Beyond the
      coarsest tabled length it is, too.
    - `cell_px`: side of a cell.
    - `supersampled`: whether of the texture's SSAA(4) reference.

    With one octave this is the small-motion limit: the mean length of the picture's
    gradient times u.
    """

    slope_squared: Float[Array, "cells octaves harmonics"]
    finest_px: Scalar = eqx.field(converter=_checks.number)
    cell_px: int = eqx.field(static=True)
    supersampled: bool = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        texture: Texture,
        camera: Camera,
        *,
        cell_px: int = 64,
        finest_px: float = 1 / 4,
        octaves: int = 6,
        supersampled: bool = False,
    ) -> "PictureStatistics":
        """Measure a baked scene, seen from the hold pose.

        **Arguments:**

        - `texture`: baked for this camera. Displacements beyond its margin clamp.
        - `cell_px`: must divide the camera's width and height; that of a study's tiles.
        - `finest_px`, `octaves`: the tabled lengths, px; up to 8 px by default, which a
          head of the fastest blended speed (25 deg/s) moves a picture at 60 Hz.
        - `supersampled`: measure the SSAA(4) reference, which SSAA(4) shows.

        **Errors:** `ValueError` for cells that do not divide the frame, and for lengths
        or numbers of octaves that are not positive.

        **Accuracy:** the picture is read as the simulation reads it, bilinearly, at one
        place of each pixel that differs from pixel to pixel: a moved head's pixels lie
        anywhere between texels. Between directions D^2 is interpolated by harmonics
        (exact where all gradients of a cell are parallel), between lengths linearly per
        octave.
        """
        _checks.whole("cell_px", cell_px, 1)
        _checks.whole("octaves", octaves, 1)
        _checks.in_range("finest_px", finest_px, 0, open_low=True)
        if camera.width_px % cell_px or camera.height_px % cell_px:
            raise ValueError(
                "cell_px must divide the camera frame "
                f"{camera.width_px} x {camera.height_px}, got {cell_px}."
            )
        slope_squared = _tabulate(
            texture.supersampled_texels if supersampled else texture.color_texels,
            camera,
            (texture.margin_px, texture.oversampling, cell_px, octaves),
            finest_px,
        )
        return cls(slope_squared, finest_px, cell_px, supersampled)

    def select(self, cells: Cells) -> "PictureStatistics":
        """Pick cells by their numbers, any of them any number of times."""
        return eqx.tree_at(lambda s: s.slope_squared, self, self.slope_squared[cells])

    def difference(self, displacement_px: Float[Array, "cells 2"]) -> Numbers:
        """`D(u)` of each cell for a displacement each, shape `(cells,)`.

        **Arguments:** `displacement_px`: u, px, x right and y down.

        **Accuracy:** even in u; at 0 it is 0 and its gradient is chosen as exactly 0.
        """
        squared = jax.vmap(difference_squared, (0, None, 0))
        return root(squared(self.slope_squared, self.finest_px, displacement_px))


def cell_numbers(camera: Camera, cell_px: int, origins: Int[Array, "cells 2"]) -> Cells:
    """Numbers of cells, of which any pixels are given, `(x0, y0)`."""
    column, row = origins[:, 0] // cell_px, origins[:, 1] // cell_px
    return row * (camera.width_px // cell_px) + column


def root(squared: Numbers) -> Numbers:
    """Square root of what is not negative but for rounding; its gradient at 0 is 0."""
    is_positive = squared > 0
    # sqrt has an infinite slope at 0: keep 0 out of it, then put the value back.
    return jnp.where(is_positive, jnp.sqrt(jnp.where(is_positive, squared, 1.0)), 0.0)


def difference_squared(
    slope_squared: Harmonics, finest_px: Scalar, displacement_px: Vector
) -> Float[Array, ""]:
    """`D(u)^2` in one cell."""
    octaves, harmonics = slope_squared.shape
    largest = jnp.max(jnp.abs(displacement_px))
    is_zero = largest == 0
    # In units of the larger part: in float32 small numbers have a square of 0, and a
    # quotient's slope divides by the square of its divisor.
    unit = jax.lax.stop_gradient(jnp.where(is_zero, 1.0, largest))
    dx, dy = displacement_px[0] / unit, displacement_px[1] / unit
    dx = jnp.where(is_zero, 1.0, dx)
    length_squared = dx**2 + dy**2
    cosine, sine = (dx**2 - dy**2) / length_squared, 2 * dx * dy / length_squared
    waves = [jnp.ones_like(dx)]
    c, s = cosine, sine  # of twice the direction
    while len(waves) < harmonics:
        waves += [c, s]
        c, s = c * cosine - s * sine, s * cosine + c * sine
    wave = jnp.stack(waves[:harmonics])
    octave = 0.5 * jnp.log2(length_squared) + jnp.log2(unit / finest_px)
    node = jnp.arange(octaves, dtype=octave.dtype)
    share = jnp.maximum(1 - jnp.abs(jnp.clip(octave, 0, octaves - 1) - node), 0)
    squared = unit**2 * (length_squared * (share @ (slope_squared @ wave)))
    return jnp.where(is_zero, 0.0, squared)


def _to_harmonics(dtype: jnp.dtype) -> Float[Array, "harmonics directions"]:
    """Matrix from values at `DIRECTIONS` to the waves 1, cos 2a, sin 2a, cos 4a, ..."""
    angle = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    orders = [(f, n) for n in range(1, DIRECTIONS // 2 + 1) for f in (np.cos, np.sin)]
    rows = [np.ones(DIRECTIONS)] + [2 * f(n * angle) for f, n in orders[:-1]]
    rows[-1] /= 2  # the shortest wave is seen at its crests only
    return jnp.asarray(np.stack(rows) / DIRECTIONS, dtype)


@partial(jax.jit, static_argnames="layout")
def _tabulate(
    texels: Texels, camera: Camera, layout: tuple[int, ...], finest_px: Scalar
) -> Float[Array, "cells octaves harmonics"]:
    margin_px, scale, cell_px, octaves = layout
    width, dtype = camera.width_px, texels.dtype
    i = jnp.arange(width, dtype=jnp.int32)[None, :]
    lengths = finest_px * 2.0 ** jnp.arange(octaves, dtype=dtype)
    angles = jnp.asarray(np.pi * np.arange(DIRECTIONS) / DIRECTIONS, dtype)
    pairs = jnp.repeat(lengths, DIRECTIONS), jnp.tile(angles, octaves)

    def of_row(row: Int[Array, ""]) -> Float[Array, "pairs columns"]:
        """Mean slopes in a row of cells."""
        j = (row * cell_px + jnp.arange(cell_px, dtype=jnp.int32))[:, None]

        def place(a: float, b: float) -> Float[Array, "rows columns"]:
            """Where in its texel each pixel is read: different from place to place."""
            return jnp.mod(a * i.astype(dtype) + b * j.astype(dtype), 1.0) - 0.5

        x, y = place(*_R2), place(_R2[1], -_R2[0])

        def read(moved_px: Float[Array, "2"]) -> Planes:
            dx, dy = scale * moved_px
            return resampling.bilinear_by_slices(
                texels,
                margin_px,
                margin_px + row * cell_px,
                (cell_px, width),
                scale * moved_px[None] + jnp.array([[-0.5], [0.5]], dtype),
                lambda: (x + dx, y + dy),
            )

        unmoved = read(jnp.zeros(2, dtype))

        def slope(displacement: tuple) -> Float[Array, " columns"]:
            length, angle = displacement
            moved = read(length * jnp.stack([jnp.cos(angle), jnp.sin(angle)]))
            differing = color.distance(moved, unmoved)
            cells = differing.reshape(cell_px, width // cell_px, cell_px)
            return jnp.mean(cells, (0, 2)) / length

        return jax.lax.map(slope, pairs)

    rows = jnp.arange(camera.height_px // cell_px, dtype=jnp.int32)
    slopes = jnp.moveaxis(jax.lax.map(of_row, rows), 1, 0)
    slopes = slopes.reshape(octaves, DIRECTIONS, -1)
    return jnp.einsum("hd,odc->coh", _to_harmonics(dtype), slopes**2)
