"""MTCD, mean temporal colour difference: how much a displayed clip flickers."""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from .. import _checks, color
from .._types import Clip, Plane, Rgb, Scalar
from ..camera import Region
from ..color import CODE_VALUES as CODE_VALUES
from .base import PixelMean, at_least_single


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


def mtcd(clip: ArrayLike) -> Float[Array, ""]:
    """MTCD of a clip.

    **Arguments:** `clip`: displayed gamma frames, `(frames >= 2, height, width, 3)`;
    floating in `[0, 1]`, or uint8 or uint16, whose largest code is 1.

    **Returns:** code values; 0 for a clip that never changes. At least float32.

    **Errors:** `ValueError` for any other shape, dtype or range. Inside compiled code
    the range is not checked.

    **Source:** Kim et al., equation (6).
    """
    colors = _checks.colors("clip", clip)
    if colors.ndim != 4 or colors.shape[3] != 3:
        raise ValueError(
            f"clip must have the shape (frames, height, width, 3), got {colors.shape}."
        )
    if len(colors) < 2:
        raise ValueError(f"clip must have at least 2 frames, got {len(colors)}.")
    return _mtcd(at_least_single(colors))


@jax.jit
def _mtcd(clip: Clip) -> Scalar:
    _, height, width, _ = clip.shape
    planes, metric = jnp.moveaxis(clip, -1, 1), MTCD()
    step = lambda state, pair: (metric.step(state, pair[0], pair[1], None), None)
    start = metric.init(Region(0, 0, width, height), clip.dtype)
    return metric.value(jax.lax.scan(step, start, (planes[1:], planes[:-1]))[0])
