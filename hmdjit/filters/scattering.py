"""Where several things move to one place, which of them is there."""

from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

Sources = Int[Array, " cells"]


def winners(
    targets: Sources, keys: Sequence[Float[Array, " cells"]], order: Sources
) -> Sources:
    """Which source each cell gets: the least by the first key, of these by the next.

    Exact, in integers and comparisons: nothing of it has a derivative.

    **Arguments:**

    - `targets`: the cell that each source goes to; their number, if to none.
    - `keys`: what decides, of each source.
    - `order`: each source's place among all of them, which decides in the end.

    **Returns:** the winner's `order`; the number of cells where nothing came.
    """
    count = len(targets)
    for key in keys:
        # What has lost goes nowhere.
        least = jnp.full(count, jnp.inf, key.dtype).at[targets].min(key, mode="drop")
        is_least = key == least.at[targets].get(mode="clip")
        targets = jnp.where(is_least, targets, count)
    return jnp.full(count, count, order.dtype).at[targets].min(order, mode="drop")
