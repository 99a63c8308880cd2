"""Which blocks of the camera frame a study measures, and how wide a halo they need.

A tile is a block that is measured, inside a halo that is rendered and filtered but not
measured. Tiles are drawn from a grid that covers the frame exactly, so their mean is
the whole frame's, edges included.
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
from ..techniques.base import HistoryReach

HALO_TOLERANCE = 1e-5
"""What a halo's outer edge does may reach measured pixels with less than this."""

_WIDEST_PX = 4096  # a halo as wide as this reaches the edges of the camera frame


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

    def __str__(self) -> str:
        tiles = "1 tile" if self.count == 1 else f"{self.count} tiles"
        return f"{tiles} of {self.size_px} x {self.size_px} px per session"

    def block_size(self, camera: Camera) -> tuple[int, int]:
        """Width and height of a measured block, px.

        **Errors:** `ValueError` unless the size divides the camera frame.
        """
        width, height = camera.width_px, camera.height_px
        if width % self.size_px or height % self.size_px:
            common = math.gcd(width, height)
            fit = max(d for d in range(1, min(common, 128) + 1) if common % d == 0)
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
        within = jax.random.randint(key, (self.count,), 0, 1 << 20)
        stratum = jnp.arange(self.count)
        share = (stratum * (1 << 20) + within) / (self.count << 20)
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


def _cells_along_z_curve(camera: Camera, size: int) -> Int[np.ndarray, "cells 2"]:
    columns, rows = camera.width_px // size, camera.height_px // size
    y, x = np.mgrid[0:rows, 0:columns].astype(np.int64)
    order = np.zeros_like(x)
    for bit in range(16):
        order |= ((x >> bit) & 1) << (2 * bit) | ((y >> bit) & 1) << (2 * bit + 1)
    place = np.argsort(order.ravel(), kind="stable")
    cells = np.stack([x.ravel(), y.ravel()], axis=1)[place]
    return (cells * size).astype(np.int32)


def required_halo_px(
    reach: HistoryReach, *, tolerance: float = HALO_TOLERANCE
) -> Int[np.ndarray, "*sessions"]:
    """Halo that keeps what its outer edge does out of the measured pixels.

    Let `e_j` bound the error at depth j pixels from an edge. Pixels beyond the edge are
    wrong by up to 1. A history read from up to `s = n + f` px nearer to the edge mixes
    depths `j - n` and `j - n - 1` with weights `1 - f` and `f` (bilinear), and of that
    mix at most the technique's gain g remains:
    `e_j <- g ((1 - f) e_{j-n} + f e_{j-n-1})`. A negative s, a read from farther
    inside, takes error away from the edge.

    **Arguments:** `reach`: of the frames of each session.

    **Returns:** per session, the smallest whole halo, px, whose error after any frame,
    horizontal plus vertical, is below `tolerance` (of the colour range).
    """
    *sessions, frames, _ = reach.inwards_px.shape
    tolerance /= reach.display_slope
    # The four edges are four cases of one recursion. No frame is wider than the limit.
    inwards_px = np.clip(reach.inwards_px, -_WIDEST_PX, _WIDEST_PX)
    step = np.moveaxis(inwards_px, -1, 0).reshape(-1, frames)
    gain = np.broadcast_to(reach.gain, (4, *reach.gain.shape)).reshape(-1, frames)
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
