"""Scenes of solids: put together from shapes, seen by ray casting.

Edges of what is visible carry no derivative: a sample sees one surface or the other,
and MTCD of one session is piecewise smooth in where the edge lies. Derivatives are of
what surfaces show inside of their edges.
"""

from collections.abc import Collection, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped

from .. import color, quaternion, sample_patterns
from .._types import Numbers, Rgb, Scalar
from ..camera import Camera, Region
from ..frames.frame import MOTION_CLASSES as _CLASSES
from ..frames.frame import Steps
from ..frames.motion import Motion
from ..frames.sources import AbstractSource, Places, View
from ..frames.velocity import against_object
from . import primitives, solid_channels, surfaces
from .base import AbstractScene, Colors, Directions
from .primitives import Primitive, Quads, Table
from .ray_casting import Rays, World
from .shapes import Object, Paths, Sun
from .stored import StoredPlanes
from .surfaces import AnyArray

GIVES = frozenset(
    """color multisampled albedo depth object_id motion_class velocity
    coverage""".split()  # noqa: SIM905
)
"""What there is to ask of solids."""


class Solids(AbstractScene, AbstractSource):
    """A scene of solids; `of` puts it together.

    - `tables`: of primitives, none of them empty.
    - `paths`, `classes`: how objects move, and their motion class.
    - `to_sun`, `ambient`, `background`: see `ray_casting.World`.
    - `moves`: whether any object moves.
    """

    tables: tuple[Table, ...]
    paths: Paths
    classes: Int[AnyArray, " objects"]
    to_sun: Float[AnyArray, "3"]
    ambient: Scalar | Float[np.ndarray, ""]
    background: Float[AnyArray, "3"]
    pictures: tuple[StoredPlanes, ...]
    masks: Bool[AnyArray, "masks _ _"] | None
    kinds: tuple[int, ...] = eqx.field(static=True)
    has_sun: bool = eqx.field(static=True)
    has_shadows: bool = eqx.field(static=True)
    moves: bool = eqx.field(static=True)
    name: str = eqx.field(static=True, default="solids")

    @classmethod
    def of(
        cls,
        objects: Sequence[Object],
        *,
        sun: Sun | None = Sun(),  # noqa: B008 (frozen)
        background: surfaces.Gamma = (0.62, 0.74, 0.86),
        name: str = "solids",
    ) -> "Solids":
        """Put a scene together; object i has the id i + 1.

        **Arguments:** `sun`: None shows all surfaces in their own colours;
        `background`: gamma.

        **Errors:** `ValueError` for a scene without a shape, and masks that differ in
        size.
        """
        gallery, rows = surfaces.Gallery(), {}
        for number, one in enumerate(objects, start=1):
            for primitive, surface in one.shapes:
                _check_holes(primitive, surface)
                own = np.asarray(number, np.int32)
                row = Table(primitive, gallery.paint(surface), own)
                rows.setdefault(type(primitive), []).append(row)
        if not rows:
            raise ValueError("objects must have at least one shape, got none.")
        tables = tuple(primitives.stacked(found) for found in rows.values())
        sizes = {mask.shape for mask in gallery.masks}
        if len(sizes) > 1:
            raise ValueError(f"masks of a scene must have one size, got {sizes}.")
        light = Sun() if sun is None else sun
        direction = np.asarray(light.direction, np.float64)
        movements = [one.movement for one in objects]
        class_of = lambda one: 0 if one is None else _CLASSES.index(one.motion_class)
        return cls(
            tables=tables,
            paths=Paths.of(movements),
            classes=np.asarray([0, *map(class_of, movements)], np.int32),
            to_sun=direction / np.linalg.norm(direction),
            ambient=np.asarray(light.ambient, np.float64),
            background=surfaces.linear(background),
            pictures=tuple(gallery.pictures),
            masks=np.stack(gallery.masks) if gallery.masks else None,
            kinds=tuple(sorted(gallery.kinds)),
            has_sun=sun is not None,
            has_shadows=light.has_shadows,
            moves=any(movement is not None for movement in movements),
            name=name,
        )

    @property
    def gives(self) -> frozenset[str]:
        """All that there is, but the SSAA(4) picture ready made."""
        return GIVES

    def color(self, camera: Camera, direction: Directions) -> Colors:
        """Gamma colour seen from the hold pose at its time."""
        dtype = direction.dtype
        still = Motion(jnp.zeros(3, dtype), jnp.zeros(3, dtype))
        world = self.world(View(camera, Region.whole(camera), still))
        depth = -direction[2]
        is_ahead = depth > 0
        safe = jnp.where(is_ahead, depth, 1.0)
        x, y = ((d / safe).reshape(1, -1) for d in direction[:2])
        rays = Rays(x, y)
        seen = solid_channels.at_rays(world, rays, world.met_by(rays, 0.0), {"light"})
        gamma = color.encode(seen["light"]).reshape(direction.shape)
        return jnp.where(is_ahead[None], gamma, jnp.nan)

    def seen(
        self,
        view: View,
        samples_px: Places,
        channels: Collection[str],
    ) -> dict[str, Shaped[Array, "samples channels height width"]]:
        """Cast a ray through each sample of each pixel."""
        offsets = jnp.asarray(samples_px, view.motion.offset.dtype)
        world = self.world(view, has_steps="velocity" in channels)
        found = set(channels) if world.steps is not None else {*channels} - {"velocity"}
        return solid_channels.seen(world, view, offsets, found)

    def reference(self, view: View) -> Rgb:
        """Accumulate samples of a scrambled Halton sequence in linear light.

        **Source:** the accumulation buffer of Oliveros' thesis, indices from 0 on.
        """
        count = view.reading.reference_samples
        offsets = jnp.asarray(
            sample_patterns.accumulation(count), view.motion.offset.dtype
        )
        return solid_channels.accumulated(self.world(view), view, offsets)

    def covers(self, camera: Camera, region: Region, motion: Motion) -> Bool[Array, ""]:
        """Whether the pose is known: a ray may go anywhere."""
        known = jnp.isfinite(motion.offset).all()
        if motion.position_m is not None:
            known = known & jnp.isfinite(motion.position_m).all()
        return known

    def velocity_bounds(self, view: View) -> Float[Array, "2 2"] | None:
        """Smallest and largest displacement to where what is seen was, px."""
        return solid_channels.velocity_bounds(self.world(view, has_steps=True), view)

    def steps(self, view: View) -> Steps | None:
        """Return how objects moved, if any does."""
        return self.world(view, has_steps=True).steps if self.moves else None

    def nearest_m(self, view: View) -> Scalar:
        """Smallest depth that a region can show, m; never too large."""
        return 1 / jnp.max(solid_channels.nearness(self.world(view), view))

    def world(self, view: View, *, has_steps: bool = False) -> World:
        """Return the scene at a frame, in the head's axes.

        **Arguments:** `has_steps`: whether it says how things moved since the last one.
        """
        motion, dtype = view.motion, view.motion.offset.dtype
        own = lambda leaf: (
            jnp.asarray(leaf, dtype)
            if jnp.issubdtype(jnp.result_type(leaf), jnp.floating)
            else jnp.asarray(leaf)
        )
        tables, paths = jax.tree.map(own, (self.tables, self.paths))
        back = quaternion.matrix_minus_identity(-motion.offset)
        rate = jnp.asarray(view.camera.refresh_hz, dtype)
        time = jnp.asarray(view.frame, dtype) / rate

        def moved(rows: Primitive, thing: AnyArray) -> Primitive:
            turns = jax.vmap(quaternion.matrix_minus_identity)(paths.rotation * time)
            turn = lambda vectors: vectors + _apply(turns[thing], vectors)
            pivot, gone = paths.pivot[thing], paths.velocity[thing] * time
            return rows.turned(turn, lambda points: pivot + turn(points - pivot) + gone)

        def placed(table: Table) -> Table:
            rows = moved(table.rows, table.object) if self.moves else table.rows
            to_head = lambda vectors: vectors + _apply(back[None], vectors)
            eye = motion.position_m
            from_eye = lambda points: points if eye is None else points - eye[None]
            rows = rows.turned(to_head, lambda points: to_head(from_eye(points)))
            paint = table.paint.needed(self.kinds, self.masks is not None)
            return Table(rows, paint, table.object)

        to_sun = own(self.to_sun)
        return World(
            tuple(placed(table) for table in tables),
            to_sun + _apply(back, to_sun),
            own(self.ambient),
            own(self.background),
            tuple(self.pictures),
            None if self.masks is None else jnp.asarray(self.masks),
            jnp.asarray(self.classes),
            self._steps(motion, paths, time, 1 / rate) if has_steps else None,
            self.kinds,
            self.has_sun,
            self.has_sun and self.has_shadows,
        )

    def _steps(
        self, motion: Motion, paths: Paths, time_s: Numbers, step_s: Numbers
    ) -> tuple[Array, Array] | None:
        """Increment and translation of the head against objects, since a frame ago."""
        if not self.moves:
            moved = motion.translation_m
            return None if moved is None else (motion.increment, moved)

        place = paths.pivot + paths.velocity * time_s
        turned, moved = paths.rotation * step_s, paths.velocity * step_s
        against = lambda *path: against_object(motion, *path)
        return jax.vmap(against)(place, turned, moved)


class Baked(AbstractScene):
    """Solids in which nothing moves, to be baked as a picture is: colours alone.

    For heads that turn about the eye, and techniques that need neither depth nor ids,
    nor, as multisampling does, edges.
    """

    solids: Solids
    name: str = eqx.field(static=True, default="baked")

    def __check_init__(self):
        if self.solids.moves:
            raise ValueError(f"{self.name} must not move to be baked, but things do.")

    @property
    def gives(self) -> frozenset[str]:
        """Colour, and how a head that turns moves it."""
        return frozenset({"color", "supersampled", "velocity"})

    def color(self, camera: Camera, direction: Directions) -> Colors:
        """Gamma colour of the solids."""
        return self.solids.color(camera, direction)


def _check_holes(primitive: Primitive, surface: surfaces.Surface) -> None:
    """Raise where a mask has no rectangle to lie on."""
    is_bounded = isinstance(primitive, Quads) and np.isfinite(primitive.half_m).all()
    if surface.mask is not None and not is_bounded:
        raise ValueError(
            "mask of a surface must lie on a rectangle or an ellipse, got a "
            f"{'plane' if isinstance(primitive, Quads) else 'round surface'}."
        )


def _apply(matrix: Array, vectors: Array) -> Array:
    """Multiply matrices and vectors, written out."""
    return jnp.sum(matrix * vectors[..., None, :], axis=-1)
