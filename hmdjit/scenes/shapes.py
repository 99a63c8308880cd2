"""Shapes to put scenes together from, objects made of them, how these move, the light.

Lengths in metres, in a world that has the eye of the hold pose at its origin, +x right,
+y up and -z ahead. Each function returns the primitives of a shape.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from .. import _checks
from .._types import Scalar
from ..frames.frame import MOTION_CLASSES
from .primitives import Capsules, Primitive, Quads, Spheres
from .surfaces import AnyArray, Surface


class Part(NamedTuple):
    """One primitive and its surface."""

    primitive: Primitive
    surface: Surface


Shape = list[Part]
Place = Sequence[float | int | np.floating] | np.ndarray
"""Three numbers, m."""


def _vector(name: str, value: Place) -> np.ndarray:
    vector = np.asarray(value, np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f"{name} must be three finite numbers, m, got {value}.")
    return vector


def _unit(name: str, value: Place) -> tuple[np.ndarray, float]:
    vector = _vector(name, value)
    length = float(np.linalg.norm(vector))
    _checks.in_range(f"length of {name}", length, 0, open_low=True)
    return vector / length, length


def _across(axis: np.ndarray) -> np.ndarray:
    """Return some unit vector across an axis, ahead of the eye where that is across."""
    other = np.array([0.0, 0.0, 1.0]) if abs(axis[2]) < 0.9 else np.array([1.0, 0, 0])
    right = np.cross(axis, other)
    return right / np.linalg.norm(right)


def _quad(
    centre: Place,
    right: Place,
    up: Place,
    surface: Surface,
    *,
    is_round: bool = False,
    is_one_sided: bool = False,
) -> Shape:
    (right, width), (up, height) = _unit("right", right), _unit("up", up)
    if abs(right @ up) > 1e-9:
        raise ValueError("right and up must be at right angles to each other.")
    half = np.array([width / 2, height / 2])
    flags = np.asarray(is_round), np.asarray(is_one_sided)
    place = _vector("centre", centre)
    return [Part(Quads(place, right, up, half, *flags), surface)]


def rectangle(centre: Place, right: Place, up: Place, surface: Surface) -> Shape:
    """Make a rectangle, seen from both sides; `right` and `up` are its whole sides."""
    return _quad(centre, right, up, surface)


def disc(centre: Place, right: Place, up: Place, surface: Surface) -> Shape:
    """Make an ellipse, seen from both sides; `right` and `up` are its whole axes."""
    return _quad(centre, right, up, surface, is_round=True)


def plane(point: Place, right: Place, up: Place, surface: Surface) -> Shape:
    """Make a plane without end, along two directions."""
    ((quad, _),) = _quad(point, right, up, surface)
    endless = np.array([np.inf, np.inf])
    return [Part(Quads(**{**vars(quad), "half_m": endless}), surface)]


def box(
    centre: Place,
    size: Place,
    surface: Surface,
    turn: Place = (0.0, 0.0, 0.0),
) -> Shape:
    """Make a box of `size` (right, up, back), turned about its centre by a vector, rad.

    Its sides are seen from outside.
    """
    place = _vector("centre", centre)
    axes = Rotation.from_rotvec(_vector("turn", turn)).as_matrix().T
    axes = axes * _vector("size", size)[:, None]
    sides = []
    for out, right, up in ((0, 2, 1), (1, 0, 2), (2, 0, 1)):
        for way in (1.0, -1.0):
            # Right times up is outwards.
            outwards = np.cross(axes[right], axes[up]) @ (way * axes[out])
            across = axes[right] * np.sign(outwards)
            middle = place + way * axes[out] / 2
            sides += _quad(middle, across, axes[up], surface, is_one_sided=True)
    return sides


def sphere(centre: Place, radius_m: float | int, surface: Surface) -> Shape:
    """Make a sphere, seen from outside."""
    _checks.in_range("radius_m", radius_m, 0, open_low=True)
    place, right, up = _vector("centre", centre), np.eye(3)[0], np.eye(3)[1]
    radius = np.asarray(radius_m, np.float64)
    return [Part(Spheres(place, right, up, radius), surface)]


def capsule(start: Place, end: Place, radius_m: float | int, surface: Surface) -> Shape:
    """Make a cylinder with round ends about two points, seen from outside."""
    return _round(start, end, radius_m, surface, is_open=False)


def cylinder(
    start: Place, end: Place, radius_m: float | int, surface: Surface
) -> Shape:
    """Make a cylinder with flat ends, seen from outside."""
    tube = _round(start, end, radius_m, surface, is_open=True)
    axis = _vector("end", end) - _vector("start", start)
    right = _across(axis / np.linalg.norm(axis))
    ahead = np.cross(axis / np.linalg.norm(axis), right)
    wide = 2 * radius_m
    lids = []
    for middle, sides in ((end, (right, ahead)), (start, (right, -ahead))):
        across, along = (wide * side for side in sides)
        lids += _quad(middle, across, along, surface, is_round=True, is_one_sided=True)
    return tube + lids


def moved(shape: Shape, shift: Place, turn: Place = (0.0, 0.0, 0.0)) -> Shape:
    """Turn a shape about the origin by a rotation vector, rad, then shift it, m."""
    rotation, shift = (
        Rotation.from_rotvec(_vector("turn", turn)),
        _vector("shift", shift),
    )
    to = lambda points: rotation.apply(points) + shift
    return [
        Part(part.primitive.turned(rotation.apply, to), part.surface) for part in shape
    ]


def copies(shape: Shape, places: Iterable[Place]) -> Shape:
    """Put a shape, made about the origin, at each of several places."""
    return [part for place in places for part in moved(shape, place)]


def _round(
    start: Place,
    end: Place,
    radius_m: float | int,
    surface: Surface,
    *,
    is_open: bool,
) -> Shape:
    _checks.in_range("radius_m", radius_m, 0, open_low=True)
    start, end = _vector("start", start), _vector("end", end)
    axis, length = _unit("axis, from start to end,", end - start)
    row = Capsules(
        (start + end) / 2,
        _across(axis),
        axis,
        np.asarray(length / 2),
        np.asarray(radius_m, np.float64),
        np.asarray(is_open),
    )
    return [Part(row, surface)]


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
