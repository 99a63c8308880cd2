"""What solids are made of: quadrilaterals, spheres, capsules; and how a ray meets them.

Each kind is a table with one row per primitive, lengths in metres. A scene's world has
the eye of the hold pose at its origin, +x right, +y up and -z ahead. A ray is an origin
and a direction, each three numbers or planes that broadcast together.

`hit` says how far along a ray a primitive begins, `skin` goes on beyond its edges: what
a surface shows of a pixel whose centre it just misses.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .surfaces import AnyArray, Paint

Number = Any
"""A number or a plane of them, traced or not."""

Vector = tuple[Number, Number, Number]
Vectors = Float[AnyArray, "*rows 3"]

NEAR_M = 0.05
"""Nearer to the eye nothing is seen."""


def dot(one: Vector, other: Vector) -> Number:
    """Inner product, written out: planes stay planes."""
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


def _minus(one: Vector, other: Vector) -> Vector:
    return one[0] - other[0], one[1] - other[1], one[2] - other[2]


def along(origin: Vector, direction: Vector, length: Number) -> Vector:
    """Point of a ray at a length, in lengths of the direction."""
    x, y, z = (o + length * d for o, d in zip(origin, direction, strict=True))
    return x, y, z


def _of(vector: Vectors) -> Vector:
    return vector[0], vector[1], vector[2]


class Meeting(NamedTuple):
    """Where a ray meets a surface, or its skin.

    - `length`: along the ray, in lengths of its direction.
    - `normal`: of the surface, unit length.
    - `place_m`: where on the surface, in its own two coordinates.
    """

    length: Number
    normal: Vector
    place_m: tuple[Number, Number]


class Quads(eqx.Module):
    """Rectangles and ellipses.

    - `centre`, `right`, `up`: place, and unit vectors along the sides.
    - `half_m`: half of each side, or each half-axis; inf of a plane.
    - `is_round`: whether it is an ellipse.
    - `is_one_sided`: whether it is seen from the front only, as a box's side is.
    """

    centre: Vectors
    right: Vectors
    up: Vectors
    half_m: Float[AnyArray, "*rows 2"]
    is_round: Bool[AnyArray, "*rows"]
    is_one_sided: Bool[AnyArray, "*rows"]

    def turned(self, turn: Callable, shift: Callable) -> "Quads":
        """Turn and move all rows: `turn` and `shift` act on vectors `(rows, 3)`."""
        return eqx.tree_at(
            lambda q: (q.centre, q.right, q.up),
            self,
            (shift(self.centre), turn(self.right), turn(self.up)),
        )

    def bounds(self) -> tuple[Vectors, Float[AnyArray, "*rows"]]:
        """Centre and radius of a sphere around each."""
        return self.centre, jnp.sqrt(jnp.sum(self.half_m**2, axis=-1))

    def reach(self, direction: Number) -> Float[AnyArray, "*rows"]:
        """How far each extends from its centre along a unit vector, `(3,)`."""
        right, up = jnp.abs(self.right @ direction), jnp.abs(self.up @ direction)
        return right * self.half_m[..., 0] + up * self.half_m[..., 1]

    def is_seen(self) -> Bool[Array, "*rows"]:
        """Whether the origin is on a side from which it is seen."""
        normal = jnp.cross(self.right, self.up)
        return ~jnp.asarray(self.is_one_sided) | (
            jnp.sum(normal * self.centre, axis=-1) < 0
        )

    def skin(self, origin: Vector, direction: Vector) -> Meeting:
        """Meet the plane of one row."""
        right, up, centre = _of(self.right), _of(self.up), _of(self.centre)
        nx, ny, nz = _of(jnp.cross(self.right, self.up))
        slope = dot((nx, ny, nz), direction)
        gap = dot((nx, ny, nz), _minus(centre, origin))
        is_along = slope == 0
        length = jnp.where(is_along, -1.0, gap / jnp.where(is_along, 1.0, slope))
        place = _minus(along(origin, direction, length), centre)
        # Towards the origin, even where a skin goes on beyond the horizon.
        side = jnp.where(gap > 0, -1.0, 1.0)
        normal = (side * nx, side * ny, side * nz)
        return Meeting(length, normal, (dot(right, place), dot(up, place)))

    def hit(self, origin: Vector, direction: Vector) -> tuple[Number, Number]:
        """Length at which a ray meets one row, and whether it does."""
        length, _, (a, b) = self.skin(origin, direction)
        width, height = self.half_m
        normal = _of(jnp.cross(self.right, self.up))
        is_shown = ~self.is_one_sided | (dot(normal, direction) < 0)
        is_in = jnp.where(
            self.is_round,
            (a / width) ** 2 + (b / height) ** 2 <= 1,
            (jnp.abs(a) <= width) & (jnp.abs(b) <= height),
        )
        return length, (length > 0) & is_in & is_shown


class Spheres(eqx.Module):
    """Spheres, seen from outside.

    - `centre`, `radius_m`: place and size.
    - `right`, `up`: unit vectors from which longitude and latitude count.
    """

    centre: Vectors
    right: Vectors
    up: Vectors
    radius_m: Float[AnyArray, "*rows"]

    turned = Quads.turned

    def bounds(self) -> tuple[Vectors, Float[AnyArray, "*rows"]]:
        """Centre and radius of a sphere around each."""
        return self.centre, self.radius_m

    def reach(self, direction: Number) -> Float[AnyArray, "*rows"]:
        """How far each extends from its centre along a unit vector, `(3,)`."""
        return self.radius_m

    def is_seen(self) -> Bool[Array, "*rows"]:
        """All are."""
        return jnp.ones(self.radius_m.shape, bool)

    def hit(self, origin: Vector, direction: Vector) -> tuple[Number, Number]:
        """Length at which a ray meets one row, and whether it does."""
        to_centre = _minus(_of(self.centre), origin)
        length, room = _ball(to_centre, direction, self.radius_m)
        return length, (room >= 0) & (length > 0)

    def skin(self, origin: Vector, direction: Vector) -> Meeting:
        """Meet one row, or pass it at its nearest."""
        to_centre = _minus(_of(self.centre), origin)
        length, _ = _ball(to_centre, direction, self.radius_m)
        normal = _unit(_minus(along((0.0, 0.0, 0.0), direction, length), to_centre))
        right, up = _of(self.right), _of(self.up)
        ahead = _of(jnp.cross(self.up, self.right))
        longitude = _angle(dot(ahead, normal), dot(right, normal))
        height = dot(up, normal)
        latitude = jnp.arcsin(jnp.clip(height, -_BELOW_1, _BELOW_1))
        place = (self.radius_m * longitude, self.radius_m * latitude)
        return Meeting(length, normal, place)


class Capsules(eqx.Module):
    """Cylinders with round ends, or open ones; seen from outside.

    - `centre`, `up`: middle, and unit vector along the axis.
    - `right`: unit vector from which the angle around it counts.
    - `half_m`: half of the axis; inf of a cylinder without end.
    - `radius_m`: of cylinder and ends.
    - `is_open`: whether it has no ends.
    """

    centre: Vectors
    right: Vectors
    up: Vectors
    half_m: Float[AnyArray, "*rows"]
    radius_m: Float[AnyArray, "*rows"]
    is_open: Bool[AnyArray, "*rows"]

    turned = Quads.turned

    def bounds(self) -> tuple[Vectors, Float[AnyArray, "*rows"]]:
        """Centre and radius of a sphere around each."""
        return self.centre, self.half_m + self.radius_m

    def reach(self, direction: Number) -> Float[AnyArray, "*rows"]:
        """How far each extends from its centre along a unit vector, `(3,)`."""
        return jnp.abs(self.up @ direction) * self.half_m + self.radius_m

    def is_seen(self) -> Bool[Array, "*rows"]:
        """All are."""
        return jnp.ones(self.radius_m.shape, bool)

    def _meet(self, origin: Vector, direction: Vector):
        """Length, whether the ray meets it, and the end's shift along the axis."""
        axis, to_centre = _of(self.up), _minus(_of(self.centre), origin)
        pace, ahead = dot(axis, direction), dot(axis, to_centre)
        across = along(direction, axis, -pace)
        length, room = _ball(along(to_centre, axis, -ahead), across, self.radius_m)
        place = length * pace - ahead  # along the axis, from the middle
        end = jnp.clip(place, -self.half_m, self.half_m)
        is_beyond = end != place
        finite = jnp.where(jnp.isfinite(self.half_m), end, 0.0)
        ball, ball_room = _ball(
            along(to_centre, axis, jnp.where(is_beyond, finite, 0.0)),
            direction,
            self.radius_m,
        )
        is_met = (room >= 0) & (~is_beyond | ~self.is_open & (ball_room >= 0))
        # The skin of an open cylinder goes on beyond its ends.
        is_ball = is_beyond & ~self.is_open
        length = jnp.where(is_ball, ball, length)
        return length, is_met & (length > 0), jnp.where(is_ball, finite, place)

    def hit(self, origin: Vector, direction: Vector) -> tuple[Number, Number]:
        """Length at which a ray meets one row, and whether it does."""
        length, is_met, _ = self._meet(origin, direction)
        return length, is_met

    def skin(self, origin: Vector, direction: Vector) -> Meeting:
        """Meet one row, or pass it at its nearest."""
        length, _, place = self._meet(origin, direction)
        axis, centre = _of(self.up), _minus(_of(self.centre), origin)
        point = _minus(along((0.0, 0.0, 0.0), direction, length), centre)
        normal = _unit(along(point, axis, -place))
        right, ahead = _of(self.right), _of(jnp.cross(self.up, self.right))
        around = self.radius_m * _angle(dot(ahead, normal), dot(right, normal))
        return Meeting(length, normal, (around, dot(axis, point)))


Primitive = Quads | Spheres | Capsules


class Table(eqx.Module):
    """Primitives of one kind, one row each; their paint, and their objects' ids."""

    rows: Primitive
    paint: Paint
    object: Int[AnyArray, "*rows"]

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(self.object)


_BELOW_1 = 1 - 1e-6  # where the slope of arcsin is finite


def _ball(
    to_centre: Vector, direction: Vector, radius: Number
) -> tuple[Number, Number]:
    """Length at which a ray enters a ball, and `radius^2 - distance^2` of its centre.

    Where it misses, the length of the ray's nearest point. By the centre's distance
    from the ray, not by the discriminant: it cancels in float32.
    """
    squared = dot(direction, direction)
    is_none = squared == 0  # across a cylinder that the ray is along
    squared = jnp.where(is_none, 1.0, squared)
    nearest = dot(to_centre, direction) / squared
    miss = _minus(to_centre, along((0.0, 0.0, 0.0), direction, nearest))
    room = radius * radius - dot(miss, miss)
    is_in = (room > 0) & ~is_none  # the square root has an infinite slope at 0
    depth = jnp.sqrt(jnp.where(is_in, room, 1.0) / squared)
    return nearest - jnp.where(is_in, depth, 0.0), room


def _unit(vector: Vector) -> Vector:
    squared = dot(vector, vector)
    scale = jax.lax.rsqrt(jnp.where(squared > 0, squared, 1.0))
    return vector[0] * scale, vector[1] * scale, vector[2] * scale


def _angle(sine: Number, cosine: Number) -> Number:
    is_axis = (sine == 0) & (cosine == 0)
    return jnp.arctan2(sine, jnp.where(is_axis, 1.0, cosine))


def stacked(rows: list[Table]) -> Table:
    """Make one table of rows of one kind."""
    return jax.tree.map(lambda *leaves: np.stack(leaves), *rows)
