"""Large regions are simulated block by block, so that a block's pictures stay in cache.

A technique's step sees one block at a time. Its state is the whole region's: histories
are read across block edges, and put together again from what each block shows.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._types import Planes
from ..camera import Region
from ..frames.sources import History

LARGEST_PX = (64, 128)
"""Height and width of a block: its pictures fit a level-2 cache of 1 MiB."""

RIM_PX = 4
"""Repeated edge pixels around a history, as far as slices may reach over its edge."""


class Blocks(eqx.Module):
    """A region cut into equal blocks.

    - `region`: what is cut.
    - `width`, `height`: of a block, px; they divide the region's.
    """

    region: Region
    width: int = eqx.field(static=True)
    height: int = eqx.field(static=True)

    @property
    def count(self) -> int:
        """Blocks in the region."""
        columns = self.region.width // self.width
        return columns * (self.region.height // self.height)

    def place(self, index: Int[Array, ""]) -> tuple[Array, Array]:
        """Column and row of a block's first pixel in the region."""
        columns = self.region.width // self.width
        return (index % columns) * self.width, (index // columns) * self.height

    def block(self, index: Int[Array, ""]) -> Region:
        """Return a block, as a place in the camera frame."""
        column, row = self.place(index)
        x0, y0 = self.region.x0 + column, self.region.y0 + row
        return Region(x0, y0, self.width, self.height)


def cut(region: Region) -> Blocks:
    """Cut a region into the largest blocks that divide it and are small enough."""
    height, width = LARGEST_PX
    if region.width * region.height <= 2 * height * width:
        return uncut(region)
    return Blocks(
        region, _divisor(region.width, width), _divisor(region.height, height)
    )


def uncut(region: Region) -> Blocks:
    """Leave a region in one piece."""
    return Blocks(region, region.width, region.height)


def _divisor(size: int, limit: int) -> int:
    """Largest divisor up to a limit; sizes with no good one are not divided."""
    best = max(d for d in range(1, limit + 1) if size % d == 0)
    return best if best >= min(size, limit / 4) else size


def _is_history(node: Any) -> bool:
    return isinstance(node, History)


def _over_histories(change: Any, state: Any, *others: Any) -> Any:
    """Map over the histories of states; what else there is comes from the last one."""

    def at(*nodes: Any) -> Any:
        if _is_history(nodes[0]):
            return change(*nodes)
        last = nodes[-1]
        is_shape = isinstance(last, jax.ShapeDtypeStruct)
        return jnp.zeros(last.shape, last.dtype) if is_shape else last

    return jax.tree.map(at, state, *others, is_leaf=_is_history)


def is_cuttable(state: Any) -> bool:
    """Whether all that a state keeps per pixel is kept as histories."""
    leaves = jax.tree.leaves(state, is_leaf=_is_history)
    return all(_is_history(leaf) or jnp.ndim(leaf) < 2 for leaf in leaves)


def kept(state: Any, region: Region, rim_px: int) -> Any:
    """State of a region, as the next frame reads it: histories get a rim."""
    return _over_histories(lambda history: history.with_rim(region, rim_px), state)


def blank(state: Any, region: Region, rim_px: int) -> Any:
    """State of a region whose histories are still to be written.

    **Arguments:** `state`: of the region or of a block, or its shapes.
    """

    def empty(history: History) -> History:
        *phases, channels, _, _ = history.texels.shape
        size = (region.height + 2 * rim_px, region.width + 2 * rim_px)
        zeros = jnp.zeros((*phases, channels, *size), history.texels.dtype)
        return History(zeros, region, rim_px)

    return _over_histories(empty, state)


def written(state: Any, of_block: Any, block: Region) -> Any:
    """State of a region with that of a block written into it."""
    write = lambda history, part: history.written(part.under(block), block)
    return _over_histories(write, state, of_block)


def rimmed(state: Any) -> Any:
    """State of a region with its edge pixels repeated all around."""
    return _over_histories(lambda history: history.rimmed(), state)


def part_of(
    planes: Planes, region: Region, block: Region
) -> Float[Array, "channels block_height block_width"]:
    """Cut a block out of a region's planes; both are places in the camera frame."""
    if (region.height, region.width) == (block.height, block.width):
        return planes
    place = start(region, block)
    return jax.lax.dynamic_slice(
        planes, place, (planes.shape[0], block.height, block.width)
    )


def start(region: Region, block: Region) -> list[Int[Array, ""]]:
    """Index of a block's first pixel in a region's planes."""
    indices = (0, block.y0 - region.y0, block.x0 - region.x0)
    return [jnp.asarray(index, jnp.int32) for index in indices]
