"""Channels of a region of solids, block by block: what `frames.frame.Frame` carries."""

from collections.abc import Callable, Collection
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Shaped

from .. import color
from .._types import Numbers, Rgb
from ..camera import Region
from ..camera_bounds import displacement_range
from ..frames.sources import View
from ..frames.velocity import past_displacement
from . import ray_casting
from .primitives import NEAR_M, Quads
from .ray_casting import Chosen, Painted, Rays, World

_BLOCK_PX = 64  # side of a block of rays, which share what they can meet
_ROOM_PX = 2.0  # by which a sample may lie beside its block
_LIGHT = {"color": "light", "multisampled": "shared light"}


def seen(
    world: World,
    view: View,
    offsets: Float[Array, "samples 2"],
    channels: Collection[str],
) -> dict[str, Shaped[Array, "samples planes height width"]]:
    """Channels of a region at samples, colours gamma."""
    wanted = {_LIGHT.get(name, name) for name in channels}
    planes = _by_blocks(view.region, lambda r: _block(world, view, r, offsets, wanted))
    for name in {"light", "shared light", "albedo"} & wanted:
        planes[name] = color.encode(planes[name])
    return {name: planes[_LIGHT.get(name, name)] for name in channels}


def accumulated(world: World, view: View, offsets: Float[Array, "samples 2"]) -> Rgb:
    """Mean over samples of a region in linear light, gamma."""

    def block(region: Region) -> dict[str, Array]:
        def add(total: Array, offset: Array) -> tuple[Array, None]:
            found = _block(world, view, region, offset[None], {"light"})
            return total + found["light"], None

        start = jnp.zeros((1, 3, region.height, region.width), offsets.dtype)
        total, _ = jax.lax.scan(add, start, offsets)
        return {"light": total / len(offsets)}

    return color.encode(_by_blocks(view.region, block)["light"][0])


def velocity_bounds(world: World, view: View) -> Float[Array, "2 2"] | None:
    """Smallest and largest displacement to where what a region shows was, px.

    Never too narrow: each object is taken to be all over the region, as near as any
    sphere around its primitives. None where only the head's turn moves the picture.
    """
    if world.steps is None:
        return None
    increments, translations = (jnp.atleast_2d(step) for step in world.steps)
    region = view.region
    # A sample may lie beside its pixel.
    wider = Region(region.x0 - 1, region.y0 - 1, region.width + 2, region.height + 2)
    near = nearness(world, view, len(increments))
    shift = jnp.linalg.norm(translations, axis=1) * jnp.maximum(near, 0.0)
    span = jax.vmap(lambda *step: displacement_range(view.camera, wider, *step))
    low, high = jnp.moveaxis(span(increments, shift), 1, 0)
    is_seen = (near >= 0)[:, None]
    low = jnp.min(jnp.where(is_seen, low, jnp.inf), axis=0)
    return jnp.stack([low, jnp.max(jnp.where(is_seen, high, -jnp.inf), axis=0)])


def nearness(world: World, view: View, count: int = 1) -> Float[Array, " objects"]:
    """Largest 1 / depth of each object, or of all as one; -1 of what is not seen.

    Never too small: as near as any sphere around its primitives. The first is the
    background, 0, which all objects are counted to if `count` is 1.
    """
    camera, dtype = view.camera, view.motion.offset.dtype
    half = max(camera.width_px, camera.height_px) / 2 + 1
    half = half / jnp.asarray(camera.focal_px, dtype)
    longest = jnp.sqrt(1 + 2 * half**2)  # of the frame's rays
    near = jnp.full(count, -1.0, dtype).at[0].set(0.0)  # unseen; the sky
    for table in world.tables:
        rows = table.rows
        centre, radius = rows.bounds()
        away = jnp.sqrt(jnp.sum(centre**2, axis=1)) - radius
        if isinstance(rows, Quads):  # no point is nearer than its plane
            normal = jnp.cross(rows.right, rows.up)
            away = jnp.maximum(away, jnp.abs(jnp.sum(normal * centre, axis=1)))
        depth = jnp.maximum(-centre[:, 2] - radius, away / longest)
        depth = 0.9999 * jnp.maximum(depth, NEAR_M)  # rounding
        is_ahead = radius - centre[:, 2] >= NEAR_M
        owner = table.object if count > 1 else jnp.zeros_like(table.object)
        near = near.at[owner].max(jnp.where(is_ahead, 1 / depth, -1.0))
    return near


def _block(
    world: World,
    view: View,
    region: Region,
    offsets: Float[Array, "samples 2"],
    wanted: Collection[str],
) -> dict[str, Shaped[Array, "samples planes height width"]]:
    """Channels of a block; light is linear."""
    camera, dtype = view.camera, offsets.dtype
    focal = jnp.asarray(camera.focal_px, dtype)
    every = view.reading.sampler == "plain"

    def place(offset: Array) -> tuple[Numbers, Numbers]:
        x = region.columns().astype(dtype) + 0.5
        return x + offset[0], region.rows().astype(dtype) + 0.5 + offset[1]

    def rays(offset: Array) -> Rays:
        x, y = place(offset)
        return Rays(
            (x - camera.width_px / 2) / focal, (camera.height_px / 2 - y) / focal
        )

    centres = rays(jnp.zeros(2, dtype))
    chosen = world.everything() if every else world.met_by(centres, _ROOM_PX / focal)
    alone = set(wanted) - {"shared light"}

    def sample(offset: Array) -> Painted:
        if "velocity" not in alone or world.steps is None:
            return at_rays(world, rays(offset), chosen, alone, every=every)
        increment, translation = world.steps
        each_moves = increment.ndim == 2
        more = {"depth", "object_id"} if each_moves else {"depth"}
        found = at_rays(world, rays(offset), chosen, alone | more, every=every)
        dx, dy = past_displacement(
            camera,
            *place(offset),
            found["depth"][0],
            increment,
            translation,
            found["object_id"][0] if each_moves else None,
        )
        found["velocity"] = -jnp.stack([dx, dy])
        return {name: found[name] for name in alone}

    found = _each(sample, offsets) if alone else {}
    if "shared light" in wanted:
        look = lambda offset: ray_casting.nearest(world, rays(offset), chosen)[1]
        surface = _each(look, offsets)
        shared = _painted(world, centres, surface, chosen, {"light"}, every)
        found["shared light"] = shared["light"]
    return found


def at_rays(
    world: World,
    rays: Rays,
    chosen: list[Chosen],
    wanted: Collection[str],
    *,
    every: bool = False,
) -> dict[str, Shaped[Array, "planes height width"]]:
    """Channels at one ray of each pixel, all but velocity."""
    depth, surface = ray_casting.nearest(world, rays, chosen)
    painting = {"light", "albedo", "depth", "object_id"} & set(wanted)
    if "motion_class" in wanted:
        painting |= {"object_id"}
    found = _painted(world, rays, surface[None], chosen, painting, every, depth[None])
    found = {name: planes[0] for name, planes in found.items()}
    if "motion_class" in wanted:
        found["motion_class"] = world.classes[found["object_id"]]
    if "coverage" in wanted:
        found["coverage"] = surface[None] + 1
    return {name: found[name] for name in wanted if name in found}


def _painted(
    world: World,
    rays: Rays,
    surface: Int[Array, "slots height width"],
    chosen: list[Chosen],
    channels: Collection[str],
    every: bool,
    depth: Float[Array, "slots height width"] | None = None,
) -> Painted:
    """Paint what is seen; `depth`: of it, None where that is on surfaces' skins."""
    if not channels:
        return {}
    lit = None
    if "light" in channels and world.has_shadows:
        if depth is None:
            where = ray_casting.painted(world, rays, surface, chosen, {"depth"})
            depth = where["depth"][:, 0]
        lit = ray_casting.lit(world, rays, surface, depth, every=every)
    return ray_casting.painted(world, rays, surface, chosen, channels, lit)


def _each(look: Callable, offsets: Float[Array, "samples 2"]) -> Any:
    """Look at each sample; one needs no loop."""
    if len(offsets) == 1:
        return jax.tree.map(lambda leaf: leaf[None], look(offsets[0]))
    return jax.lax.map(look, offsets)


def _by_blocks(region: Region, block: Callable[[Region], Painted]) -> Painted:
    """Look at a region block by block, and put it together."""
    height, width = region.height, region.width
    if max(height, width) <= 2 * _BLOCK_PX:
        return block(region)
    rows, columns = -(-height // _BLOCK_PX), -(-width // _BLOCK_PX)

    def one(number: Array) -> Painted:
        y0 = region.y0 + (number // columns) * _BLOCK_PX
        x0 = region.x0 + (number % columns) * _BLOCK_PX
        return block(Region(x0, y0, _BLOCK_PX, _BLOCK_PX))

    found = jax.lax.map(one, jnp.arange(rows * columns, dtype=jnp.int32))

    def joined(blocks: Array) -> Array:
        _, samples, planes, *_ = blocks.shape
        grid = blocks.reshape(rows, columns, samples, planes, _BLOCK_PX, _BLOCK_PX)
        whole = jnp.transpose(grid, (2, 3, 0, 4, 1, 5))
        size = (samples, planes, rows * _BLOCK_PX, columns * _BLOCK_PX)
        return whole.reshape(size)[:, :, :height, :width]

    return jax.tree.map(joined, found)
