"""Objects of a scene, how they move by themselves, and the light on them."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .. import _checks
from .._types import Scalar
from ..frames.frame import MOTION_CLASSES
from .shapes import Shape
from .surfaces import AnyArray


class Movement(eqx.Module):
    """How an object moves by itself: a turn about an axis, and a straight motion.

    - `velocity_m_s`: of the straight motion.
    - `rotation_rad_s`: rotation vector per second, about an axis through `pivot_m`.
    - `motion_class`: `rigid`, or `deforming` for what techniques should not take to be
      rigid although it is drawn so.
    """

    velocity_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation_rad_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pivot_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    motion_class: str = eqx.field(static=True, default="rigid")

    def __check_init__(self):
        _checks.one_of("motion_class", self.motion_class, MOTION_CLASSES[1:])
        for name in ("velocity_m_s", "rotation_rad_s", "pivot_m"):
            for value in getattr(self, name):
                _checks.in_range(f"{name} of a movement", value)


class Object(eqx.Module):
    """Shapes that are one thing, and how it moves; None stands still."""

    shapes: Shape
    movement: Movement | None = None


class Sun(eqx.Module):
    """Light from one direction, and some from all sides.

    - `direction`: from the scene to the sun, any length.
    - `ambient`: share of the light that comes from all sides, in [0, 1].
    - `has_shadows`: whether surfaces cast hard shadows.
    """

    direction: tuple[float, float, float] = (0.4, 0.8, 0.45)
    ambient: Scalar = 0.35
    has_shadows: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        _checks.in_range("ambient", self.ambient, 0, 1)
        length = float(np.linalg.norm(self.direction))
        _checks.in_range("length of direction of a sun", length, 0, open_low=True)


class Paths(eqx.Module):
    """How objects move, one row each; the first is the background."""

    velocity: Float[AnyArray, "*objects 3"]
    rotation: Float[AnyArray, "*objects 3"]
    pivot: Float[AnyArray, "*objects 3"]

    @classmethod
    def of(cls, movements: Sequence[Movement | None]) -> "Paths":
        """Make the table."""
        known = [Movement() if one is None else one for one in (None, *movements)]
        names = ("velocity_m_s", "rotation_rad_s", "pivot_m")
        return cls(
            *(np.asarray([getattr(one, n) for one in known], np.float64) for n in names)
        )
