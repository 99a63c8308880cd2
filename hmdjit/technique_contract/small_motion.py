"""How what a technique shows moves when the head moves little.

To first order a technique shows the scene displaced. These are the ways in which it
may; `theory` predicts flicker from them, without pixels.
"""

import equinox as eqx
from jaxtyping import Array, Float

from .. import blending
from .._types import Numbers, Scalar
from ..curves import AbstractCurve


class AsRendered(eqx.Module):
    """The display moves with the scene: each frame is shown on its own."""


class Still(eqx.Module):
    """The display never changes."""


class RecursiveBlend(eqx.Module):
    """Each frame is blended with the displayed one before, reprojected.

    - `closeness`: mean of the past samples' d, by their weights: 1 reads the past where
      it was shown, 0 where the head's rotation has moved it.
    - `compared`: the same of the past that the present is compared with.
    - `w_min`, `w_lb`, `h_max_deg_s`, `ease`, `localization`: of the current picture's
      weight, equations (3) to (5) of Kim et al.
    - `approximation`: in words, why predictions only resemble what is shown; empty
      where they describe it.
    """

    closeness: Scalar
    compared: Scalar
    w_min: Scalar
    w_lb: Scalar
    h_max_deg_s: Scalar
    ease: AbstractCurve
    localization: AbstractCurve
    approximation: str = eqx.field(static=True, default="")

    def easing(self, speed_deg_s: Float[Array, " frames"]) -> Float[Array, " frames"]:
        """Return `E` of each frame."""
        return blending.ease(speed_deg_s, self.h_max_deg_s, self.ease)

    def weight(self, difference: Numbers, easing: Numbers) -> Numbers:
        """Weight of the current picture where it differs so from the past."""
        minimum = blending.localized_minimum(
            self.w_min, self.w_lb, difference, self.localization
        )
        return blending.current_weight(minimum, easing)


SmallMotion = AsRendered | Still | RecursiveBlend
