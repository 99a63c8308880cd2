"""MTCD, mean temporal colour difference: how much a displayed clip flickers."""

from typing import ClassVar

import jax
import jax.numpy as jnp

from .. import color
from .._types import Clip, Plane, Rgb, Scalar
from ..camera import Region
from ..color import CODE_VALUES as CODE_VALUES
from .base import PixelMean


class MTCD(PixelMean):
    """Mean over pixels and consecutive displayed frames of the RGB distance.

    Code values of 8 bits, 0 to 441.7; on gamma colours, unquantised.

    **Source:** Kim et al., equation (6).
    """

    id: ClassVar[str] = "mtcd"
    unit: ClassVar[str] = "code values of 255"
    is_of_pairs: ClassVar[bool] = True

    def per_pixel(
        self, shown: Rgb, previous: Rgb | None, reference: Rgb | None
    ) -> Plane:
        """Distance of a pixel's colours in two consecutive frames, code values."""
        assert previous is not None
        return CODE_VALUES * color.distance(shown, previous)


@jax.jit
def mtcd(clip: Clip) -> Scalar:
    """MTCD of a clip.

    **Arguments:** `clip`: displayed gamma frames, `(frames >= 2, height, width, 3)`.

    **Returns:** code values; 0 for a clip that never changes.

    **Errors:** `ValueError` for fewer than 2 frames.

    **Source:** Kim et al., equation (6).
    """
    frames, height, width, _ = clip.shape
    if frames < 2:
        raise ValueError(f"clip must have at least 2 frames, got {frames}.")
    planes, metric = jnp.moveaxis(clip, -1, 1), MTCD()
    step = lambda state, pair: (metric.step(state, pair[0], pair[1], None), None)
    start = metric.init(Region(0, 0, width, height), clip.dtype)
    return metric.value(jax.lax.scan(step, start, (planes[1:], planes[:-1]))[0])
