"""What rays from the eye meet: the nearest surfaces, what they show, their shadows.

Of a block of rays only the primitives that it can meet are looked at, found anew for
each block and frame from how far they extend.
"""

import functools
from collections.abc import Callable, Collection
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._types import Mask, Numbers, Plane
from . import surfaces
from .primitives import NEAR_M, Quads, Table, Vector, along, dot
from .stored import StoredPlanes

Surfaces = Int[Array, "slots height width"]
"""Row of each pixel's primitive, counted through all tables; -1 is the background."""

Painted = dict[str, Array]
_EYE: Vector = (0.0, 0.0, 0.0)


class Rays(NamedTuple):
    """A block of rays `(x, y, -1)`: their lengths are depths.

    - `x`, `y`: slopes; they broadcast to the block's shape.
    """

    x: Numbers
    y: Numbers

    @property
    def size(self) -> tuple[int, ...]:
        """Shape of the block."""
        return jnp.broadcast_shapes(self.x.shape, self.y.shape)

    @property
    def direction(self) -> Vector:
        """Directions of the rays."""
        return self.x, self.y, jnp.full((1,) * self.x.ndim, -1.0, self.x.dtype)


class Chosen(NamedTuple):
    """Some rows of a table: the first `used` of `rows`."""

    rows: Int[Array, " rows"]
    used: Int[Array, ""] | int


class World(eqx.Module):
    """A scene at one frame, in the head's axes, with the eye at the origin.

    - `tables`: of primitives, none of them empty.
    - `to_sun`: unit vector, shape `(3,)`.
    - `ambient`: share of the light that comes from everywhere.
    - `background`: linear light, shape `(3,)`.
    - `classes`: motion class of each object; the first is the background.
    - `steps`: increment and translation of the head against each object since the last
      frame, or against all of them; None if only its own turn moves the picture.
    - `kinds`: of patterns that there are.
    - `has_sun`, `has_shadows`: whether surfaces are lit, whether they cast shadows.
    """

    tables: tuple[Table, ...]
    to_sun: Float[Array, "3"]
    ambient: Numbers
    background: Float[Array, "3"]
    pictures: tuple[StoredPlanes, ...]
    masks: Bool[Array, "masks _ _"] | None
    classes: Int[Array, " objects"]
    steps: tuple[Float[Array, "*objects 3"], Float[Array, "*objects 3"]] | None
    kinds: tuple[int, ...] = eqx.field(static=True)
    has_sun: bool = eqx.field(static=True)
    has_shadows: bool = eqx.field(static=True)

    def everything(self) -> list[Chosen]:
        """Choose all rows: loops then have a known length, and derivatives."""
        counts = [table.count for table in self.tables]
        return [Chosen(jnp.arange(n, dtype=jnp.int32), n) for n in counts]

    def met_by(self, rays: Rays, room: Numbers | float) -> list[Chosen]:
        """Choose what a block of rays can meet, `room` beside them in slope."""
        low_x, high_x = jnp.min(rays.x) - room, jnp.max(rays.x) + room
        low_y, high_y = jnp.min(rays.y) - room, jnp.max(rays.y) + room

        # Outwards from each side of the pyramid of rays, and from before the eye.
        sides = [(-1, 0, -low_x), (1, 0, high_x), (0, -1, -low_y), (0, 1, high_y)]
        outwards = [jnp.stack([jnp.asarray(v, low_x.dtype) for v in n]) for n in sides]
        outwards = [n * jax.lax.rsqrt(jnp.sum(n * n)) for n in outwards]
        ahead = jnp.array([0, 0, 1], low_x.dtype)

        def chosen(table: Table) -> Chosen:
            centre, reach = table.rows.centre, table.rows.reach
            beyond = [centre @ n > reach(n) for n in outwards]
            beyond.append(centre @ ahead + NEAR_M > reach(ahead))
            beyond.append(~table.rows.is_seen())
            is_beyond = functools.reduce(jnp.logical_or, beyond)
            return _picked(jnp.logical_not(is_beyond))

        return [chosen(table) for table in self.tables]

    def casting(self, points: Vector, is_there: Bool[Array, "..."]) -> list[Chosen]:
        """Choose what can lie between points and the sun."""
        # In axes of the sun: a shadow falls along the last.
        is_right = jnp.abs(self.to_sun[0]) > 0.9
        other = jnp.where(is_right, jnp.eye(3)[1], jnp.eye(3)[0])
        across = jnp.cross(self.to_sun, other.astype(self.to_sun.dtype))
        across = across * jax.lax.rsqrt(jnp.sum(across * across))
        axes = across, jnp.cross(self.to_sun, across), self.to_sun

        def ends(axis: Array) -> tuple[Array, Array]:
            place = dot((axis[0], axis[1], axis[2]), points)
            low = jnp.min(jnp.where(is_there, place, jnp.inf))
            return low, jnp.max(jnp.where(is_there, place, -jnp.inf))

        spans = [(axis, *ends(axis)) for axis in axes]

        def chosen(table: Table) -> Chosen:
            centre, reach = table.rows.centre, table.rows.reach
            beyond = [centre @ axis + reach(axis) < low for axis, low, _ in spans]
            beyond += [centre @ axis - reach(axis) > end for axis, _, end in spans[:2]]
            return _picked(is_there.any() & ~functools.reduce(jnp.logical_or, beyond))

        return [chosen(table) for table in self.tables]


def _picked(mask: Bool[Array, " rows"]) -> Chosen:
    (rows,) = jnp.nonzero(mask, size=mask.size, fill_value=0)
    return Chosen(rows.astype(jnp.int32), jnp.sum(mask, dtype=jnp.int32))


def _fold(world: World, chosen: list[Chosen], body: Callable, carry: Any) -> Any:
    """Go through chosen rows.

    `body` takes a row's number, its table, a function that picks the row of a part of
    the table (what is not picked is not in the program), and the carry.
    """
    first = 0
    for table, picks in zip(world.tables, chosen, strict=True):

        def one(i: Any, carry: Any, table=table, picks=picks, first=first) -> Any:
            place = picks.rows[i]
            pick = lambda part: jax.tree.map(lambda leaf: leaf[place], part)
            return body(first + place, table, pick, carry)

        carry = jax.lax.fori_loop(0, picks.used, one, carry)
        first += table.count
    return carry


def _hit(
    world: World, table: Table, pick: Callable, origin: Vector, direction: Vector
) -> tuple[Plane, Mask]:
    """Length at which rays meet a row, and whether they do: not through its holes."""
    row = pick(table.rows)
    length, is_hit = row.hit(origin, direction)
    if world.masks is None or not isinstance(row, Quads):
        return length, is_hit
    a, b = row.skin(origin, direction).place_m
    width, height = row.half_m
    return length, is_hit & surfaces.is_solid(
        pick(table.paint.mask), (a / width, b / height), world.masks
    )


def nearest(
    world: World, rays: Rays, chosen: list[Chosen]
) -> tuple[Plane, Int[Array, "height width"]]:
    """Depth and surface of what each ray meets first; inf and -1 of nothing.

    Which surface that is has no derivative: an edge moves, but a pixel's sample sees
    one side of it or the other.
    """
    world, rays = jax.lax.stop_gradient((world, rays))
    dtype = rays.x.dtype

    def look(number: Array, table: Table, pick: Callable, carry: tuple) -> tuple:
        best, surface = carry
        length, is_hit = _hit(world, table, pick, _EYE, rays.direction)
        is_nearer = is_hit & (length >= NEAR_M) & (length < best)
        return jnp.where(is_nearer, length, best), jnp.where(is_nearer, number, surface)

    start = jnp.full(rays.size, jnp.inf, dtype), jnp.full(rays.size, -1, jnp.int32)
    return _fold(world, chosen, look, start)


def painted(
    world: World,
    rays: Rays,
    surface: Surfaces,
    chosen: list[Chosen],
    channels: Collection[str],
    lit: Float[Array, "slots height width"] | None = None,
) -> Painted:
    """Look at given surfaces along rays, on their skins where they end before.

    **Arguments:** `channels`: of `light`, `albedo` (linear), `depth`, `object_id`;
    `lit`: how much of the sun gets there.

    **Returns:** by channel, `(slots, planes, height, width)`.
    """
    dtype = rays.x.dtype
    size = (*surface.shape[:1], 1, *rays.size)
    sky = jnp.broadcast_to(world.background[:, None, None], (size[0], 3, *rays.size))
    blank = {
        "light": sky,
        "albedo": sky,
        "depth": jnp.full(size, jnp.inf, dtype),
        "object_id": jnp.zeros(size, jnp.int32),
    }

    def paint(number: Array, table: Table, pick: Callable, carry: dict) -> dict:
        is_mine = surface == number

        def brush(carry: dict) -> dict:
            meeting = pick(table.rows).skin(_EYE, rays.direction)
            new = {}
            if "object_id" in carry:
                new["object_id"] = pick(table.object)[None, None, None, None]
            new["depth"] = jnp.broadcast_to(meeting.length, rays.size)[None, None]
            if {"light", "albedo"} & set(carry):
                albedo = surfaces.light(
                    pick(table.paint), meeting.place_m, world.kinds, world.pictures
                )
                new["albedo"] = jnp.broadcast_to(albedo, (3, *rays.size))[None]
            if "light" in carry:
                new["light"] = new["albedo"]
                if world.has_sun:
                    x, y, z = world.to_sun
                    sun = jnp.maximum(dot(meeting.normal, (x, y, z)), 0.0)
                    sun = jnp.broadcast_to(sun, rays.size)[None]
                    sun = sun if lit is None else sun * lit
                    share = world.ambient + (1 - world.ambient) * sun
                    new["light"] = new["albedo"] * share[:, None]
            return {
                name: jnp.where(is_mine[:, None], new[name], old)
                for name, old in carry.items()
            }

        return jax.lax.cond(is_mine.any(), brush, lambda carry: carry, carry)

    return _fold(world, chosen, paint, {name: blank[name] for name in channels})


def lit(
    world: World,
    rays: Rays,
    surface: Surfaces,
    depth: Float[Array, "slots height width"],
    *,
    every: bool,
) -> Float[Array, "slots height width"]:
    """Whether the sun reaches what is seen: 1, or 0 in a hard shadow.

    A primitive, being convex, casts none on itself.
    """
    world, rays, depth = jax.lax.stop_gradient((world, rays, depth))
    x, y, z = world.to_sun

    def one(slot: tuple) -> Plane:
        surface, depth = slot
        is_there = surface >= 0
        points = along(_EYE, rays.direction, jnp.where(is_there, depth, 0.0))
        chosen = world.everything() if every else world.casting(points, is_there)

        def look(number: Array, table: Table, pick: Callable, is_dark: Array) -> Array:
            length, is_hit = _hit(world, table, pick, points, (x, y, z))
            return is_dark | is_hit & (length > 0) & (surface != number)

        is_dark = _fold(world, chosen, look, jnp.zeros(rays.size, bool))
        return jnp.where(is_dark, 0, 1).astype(depth.dtype)

    return jax.lax.map(one, (surface, depth))
