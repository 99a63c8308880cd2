"""Changed pixels: how much of the picture flickers at all, beside MTCD, by how much."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from .. import _checks, color
from .._types import Plane, Rgb
from .base import PixelMean

_ROUNDING = (
    1e-3  # code values: codes that differ by just the threshold do not exceed it
)


class ChangedPixels(PixelMean):
    """Share of pixels whose colour changes by more than a threshold, per frame.

    Percent, over pixels and consecutive displayed frames. The change is MTCD's RGB
    distance, unquantised, so that it is at most `100 MTCD / threshold`. It counts: its
    gradient is 0 everywhere, and says nothing.

    - `threshold`: code values of 255, a whole number of at least 1, the least change
      that a display of 8 bits can show.
    """

    unit: ClassVar[str] = "% of pixels"
    is_of_pairs: ClassVar[bool] = True

    threshold: int = eqx.field(static=True, default=1)

    def __check_init__(self):
        _checks.whole("threshold", self.threshold, 1)

    @property
    def id(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Name with the threshold: changed_over_1."""
        return f"changed_over_{self.threshold}"

    @property
    def about(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Sentence for captions."""
        return (
            f"Changed over {self.threshold}: % of pixels whose RGB distance from frame "
            f"to frame is more than {self.threshold} code values."
        )

    def per_pixel(
        self, shown: Rgb, previous: Rgb | None, reference: Rgb | None
    ) -> Plane:
        """100 where a pixel changes by more than the threshold, else 0."""
        assert previous is not None
        change = color.CODE_VALUES * color.distance(shown, previous)
        is_more = change > self.threshold + _ROUNDING
        return jnp.where(is_more, 100.0, 0.0).astype(shown.dtype)
