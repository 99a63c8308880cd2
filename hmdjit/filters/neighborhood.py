"""What lies around each pixel: shifted planes, means, sharpening.

Beyond the planes' edge lies what is at the edge. *Plus* is a pixel with its four
neighbours, *box* the 3 x 3 block.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Shaped

AnyPlanes = Shaped[Array, "*planes height width"]
FloatPlanes = Float[Array, "*planes height width"]


def shifted(planes: AnyPlanes, dx: int, dy: int, outside: float | None = None):
    """Planes read `dx` px to the right and `dy` px down of each pixel.

    **Arguments:**

    - `planes`: `(height, width)` or `(channels, height, width)`, of any dtype.
    - `dx`, `dy`: whole numbers that are known while compiling.
    - `outside`: what lies beyond the edge; None is what is at the edge.
    """
    return _shifted(_shifted(planes, dx, -1, outside), dy, -2, outside)


def _shifted(planes: AnyPlanes, by: int, axis: int, outside: float | None) -> AnyPlanes:
    size = planes.shape[axis]
    by = max(-size, min(by, size))
    if by == 0:
        return planes
    kept = lax.slice_in_dim(planes, max(by, 0), size + min(by, 0), axis=axis)
    at = size - 1 if by > 0 else 0
    edge = lax.slice_in_dim(planes, at, at + 1, axis=axis)
    if outside is not None:
        edge = jnp.full_like(edge, outside)
    beyond = jnp.repeat(edge, abs(by), axis=axis)
    return jnp.concatenate([kept, beyond] if by > 0 else [beyond, kept], axis=axis)


def neighbors(planes: AnyPlanes) -> tuple[AnyPlanes, AnyPlanes, AnyPlanes, AnyPlanes]:
    """Return the pixels above, below, to the left and to the right of each."""
    above, below = shifted(planes, 0, -1), shifted(planes, 0, 1)
    return above, below, shifted(planes, -1, 0), shifted(planes, 1, 0)


def plus_mean(planes: FloatPlanes) -> FloatPlanes:
    """Mean of each pixel and its four neighbours."""
    above, below, left, right = neighbors(planes)
    return (planes + ((above + below) + (left + right))) / 5


def box_mean(planes: FloatPlanes) -> FloatPlanes:
    """Mean of each 3 x 3 block, columns first."""
    column = planes + (shifted(planes, 0, -1) + shifted(planes, 0, 1))
    return (column + (shifted(column, -1, 0) + shifted(column, 1, 0))) / 9


def sharpened(planes: FloatPlanes, strength: float) -> FloatPlanes:
    """Add what sets each pixel apart from its four neighbours, `strength` times.

    A kernel of `1 + 4 strength` in the centre and `-strength` beside it, which sums to
    1: 1 is Xu's, 1/4 that of Oliveros' thesis. Nothing is clipped.
    """
    above, below, left, right = neighbors(planes)
    return planes + strength * (4 * planes - ((above + below) + (left + right)))
