"""Which blocks of the camera frame a study measures, and how wide a halo they need.

A tile is a block that is measured, inside a halo that is rendered and filtered but not
measured. Tiles are drawn from a grid that covers the frame exactly, so their mean is
the whole frame's, edges included. Blocks of one size that do not divide the frame
cannot measure all of its pixels equally often: the corner is in one block only.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from .. import _checks
from .._types import RandomKey
from ..camera import Camera


class Tiles(eqx.Module):
    """Measure some tiles per session: unbiased for the whole frame, far cheaper.

    - `count`: tiles per session, at least 1.
    - `size_px`: side of a measured tile; must divide the camera's width and height.
    """

    count: int = eqx.field(static=True, default=2)
    size_px: int = eqx.field(static=True, default=64)

    def __check_init__(self):
        _checks.whole("tiles count", self.count, 1)
        _checks.whole("tiles size_px", self.size_px, 1)

    @classmethod
    def fitting(cls, camera: Camera, count: int = 2, most_px: int = 64) -> "Tiles":
        """Tiles of the largest size, up to 64 px, of which a grid has so many.

        **Errors:** `ValueError` where so little of a larger frame says next to nothing:
        below 4 px.
        """
        width, height = camera.width_px, camera.height_px
        common = math.gcd(width, height)
        least_px = 4 if max(width, height) > 64 else 1
        sizes = [d for d in range(least_px, most_px + 1) if common % d == 0]
        if not sizes:
            raise ValueError(
                "width_px and height_px must be multiples of one size of 4 to "
                f"{most_px} px, the tiles', got {width} x {height}; a study can "
                "measure the whole frame, a central crop, or tiles of "
                f"{_largest_divisor(common, most_px)} px."
            )
        enough = [d for d in sizes if width * height >= count * d * d]
        return cls(count, max(enough, default=min(sizes)))

    def __str__(self) -> str:
        tiles = "1 tile" if self.count == 1 else f"{self.count} tiles"
        return f"{tiles} of {self.size_px} x {self.size_px} px per session"

    def block_size(self, camera: Camera) -> tuple[int, int]:
        """Width and height of a measured block, px.

        **Errors:** `ValueError` unless the size divides the camera frame.
        """
        width, height = camera.width_px, camera.height_px
        if width % self.size_px or height % self.size_px:
            fit = _largest_divisor(math.gcd(width, height), 128)
            raise ValueError(
                f"tiles size_px must divide the camera frame {width} x {height}, got "
                f"{self.size_px}; {fit} does."
            )
        cells = (width // self.size_px) * (height // self.size_px)
        if self.count > cells:
            raise ValueError(f"tiles count must lie in [1, {cells}], got {self.count}.")
        return self.size_px, self.size_px

    def draw(self, key: RandomKey, camera: Camera) -> Int[Array, "blocks 2"]:
        """Positions `(x0, y0)` of a session's tiles, px; shape `(count, 2)`.

        The grid's cells, in the order of a Z-curve, are cut into `count` strata of
        equal measure, and one cell is drawn from each: every cell is drawn with the
        same probability, and the tiles of a session lie apart.
        """
        cells = jnp.asarray(_cells_along_z_curve(camera, self.size_px))
        # In 2^-20ths of a stratum: what rounding adds to a cell's share is below 2e-4.
        within = jax.random.randint(key, (self.count,), 0, 1 << 20, jnp.int32)
        stratum = jnp.arange(self.count, dtype=jnp.float32)
        share = (stratum * 2**20 + within.astype(jnp.float32)) / (self.count * 2**20)
        index = jnp.floor(share * len(cells)).astype(jnp.int32)
        return cells[jnp.clip(index, 0, len(cells) - 1)]


class WholeFrame(eqx.Module):
    """Measure every pixel of the camera frame."""

    count: int = eqx.field(static=True, default=1)

    def __str__(self) -> str:
        return "the whole frame"

    def block_size(self, camera: Camera) -> tuple[int, int]:
        """Width and height of the frame, px."""
        return camera.width_px, camera.height_px

    def draw(self, key: RandomKey, camera: Camera) -> Int[Array, "blocks 2"]:
        """Return the frame's origin, shape `(1, 2)`."""
        return jnp.zeros((1, 2), jnp.int32)


class CentralCrop(eqx.Module):
    """Measure a block in the centre only.

    Not a sample of the frame: the picture moves by 8.05 px/deg in the centre of the
    default camera, by 11.75 averaged over its frame.

    - `size_px`: side of the block; at most the camera's smaller side.
    """

    size_px: int = eqx.field(static=True, default=256)
    count: int = eqx.field(static=True, default=1)

    def __check_init__(self):
        _checks.whole("crop size_px", self.size_px, 1)

    def __str__(self) -> str:
        return f"a central block of {self.size_px} px (not a sample of the frame)"

    def block_size(self, camera: Camera) -> tuple[int, int]:
        """Width and height of the block, px.

        **Errors:** `ValueError` if it exceeds the camera frame.
        """
        smaller = min(camera.width_px, camera.height_px)
        if self.size_px > smaller:
            raise ValueError(
                f"crop size_px must lie in [1, {smaller}], got {self.size_px}."
            )
        return self.size_px, self.size_px

    def draw(self, key: RandomKey, camera: Camera) -> Int[Array, "blocks 2"]:
        """Return the block's origin, shape `(1, 2)`."""
        x0 = (camera.width_px - self.size_px) // 2
        y0 = (camera.height_px - self.size_px) // 2
        return jnp.array([[x0, y0]], jnp.int32)


Measurement = Tiles | WholeFrame | CentralCrop


def _largest_divisor(number: int, most: int) -> int:
    return max(d for d in range(1, min(number, most) + 1) if number % d == 0)


def _cells_along_z_curve(camera: Camera, size: int) -> Int[np.ndarray, "cells 2"]:
    columns, rows = camera.width_px // size, camera.height_px // size
    y, x = np.mgrid[0:rows, 0:columns].astype(np.int64)
    order = np.zeros_like(x)
    for bit in range(16):
        order |= ((x >> bit) & 1) << (2 * bit) | ((y >> bit) & 1) << (2 * bit + 1)
    place = np.argsort(order.ravel(), kind="stable")
    cells = np.stack([x.ravel(), y.ravel()], axis=1)[place]
    return (cells * size).astype(np.int32)
