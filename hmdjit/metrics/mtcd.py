"""MTCD, mean temporal colour difference: how much a displayed clip flickers."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .. import color
from .._types import Clip, Rgb, Scalar

CODE_VALUES = 255.0  # of an 8-bit display; MTCD is on gamma colours, unquantised


def pair_distance(displayed: Rgb, previous: Rgb) -> Scalar:
    """Mean over pixels of the RGB distance between two displayed pictures.

    **Arguments:** gamma colours in `[0, 1]`, shape `(3, height, width)`.

    **Returns:** code values (0 to 255 sqrt(3)).

    **Source:** Kim et al., equation (6): the term of one pair of frames.
    """
    return CODE_VALUES * jnp.mean(color.distance(displayed, previous))


@jax.jit
def mtcd(clip: Clip) -> Scalar:
    """Mean over pixels and consecutive pairs of the RGB distance, same pixel.

    **Arguments:** `clip`: displayed gamma frames, `(frames >= 2, height, width, 3)`.

    **Returns:** code values; 0 for a clip that never changes.

    **Errors:** `ValueError` for fewer than 2 frames.

    **Source:** Kim et al., equation (6).
    """
    if clip.shape[0] < 2:
        raise ValueError(f"clip must have at least 2 frames, got {clip.shape[0]}.")
    planes = jnp.moveaxis(clip, -1, 1)
    return jnp.mean(jax.vmap(pair_distance)(planes[1:], planes[:-1]))


class StreamedMtcd:
    """MTCD of a clip that comes picture by picture, in float64 NumPy."""

    def __init__(self):
        self._last: Float[np.ndarray, "height width 3"] | None = None
        self._sum, self._pairs = 0.0, 0

    def add(self, picture: Float[np.ndarray, "height width 3"]) -> None:
        """Take in the next picture; gamma colours in `[0, 1]`."""
        if self._last is not None:
            change = np.asarray(picture, np.float64) - self._last
            distance = np.sqrt(np.sum(change**2, axis=-1))
            self._sum += CODE_VALUES * float(np.mean(distance))
            self._pairs += 1
        self._last = np.array(picture)

    @property
    def value(self) -> float:
        """MTCD so far, code values; NaN before the second picture."""
        return self._sum / self._pairs if self._pairs else float("nan")
