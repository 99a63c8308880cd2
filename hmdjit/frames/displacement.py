"""Where the sources of a region's pixels lie, and how sources are read there."""

import abc
import functools
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .. import _checks, camera_bounds
from .. import camera as pinhole
from .._types import Mask, Numbers, Plane, RotationVector
from ..camera import Camera, Region

SAMPLERS = ("slices", "gather", "plain", "at_rest")
FILTERS = ("nearest", "bilinear", "catmull_rom")
WARPS = ("homography", "affine", "shift")


class Reading(eqx.Module):
    """How sources are read: what there is to choose between speed and accuracy.

    - `sampler`: `"slices"`, fast on a CPU for pixels that move nearly alike;
      `"gather"`, for anything, as on a GPU; `"plain"`, the same without a boundary to
      fusion, for derivatives; `"at_rest"`, where nothing has moved since the history
      was kept.
    - `texture_filter`: `"nearest"`, `"bilinear"` or `"catmull_rom"` between texels.
    - `history_filter`: the same between displayed pixels. Not an approximation but a
      part of the modelled device: a sharper one changes MTCD by several percent.
    - `reference_samples`: rays per pixel of solids in the picture that detail loss is
      measured against; a baked picture has that picture ready made.
    - `reference_every`: it is measured on the first of so many measured frames only.
    - `warp`: how a rotation moves the pixels of a region, or of the blocks that a large
      one is cut into. `"homography"` is exact, `"affine"` linear about the centre,
      `"shift"` moves all like the centre.
    """

    sampler: str = eqx.field(static=True, default="gather")
    texture_filter: str = eqx.field(static=True, default="bilinear")
    history_filter: str = eqx.field(static=True, default="bilinear")
    warp: str = eqx.field(static=True, default="homography")
    reference_samples: int = eqx.field(static=True, default=16)
    reference_every: int = eqx.field(static=True, default=1)

    def __check_init__(self):
        _checks.one_of("sampler", self.sampler, SAMPLERS)
        _checks.one_of("texture_filter", self.texture_filter, FILTERS)
        _checks.one_of("history_filter", self.history_filter, FILTERS)
        _checks.one_of("warp", self.warp, WARPS)
        _checks.whole("reference_samples", self.reference_samples, 1)
        _checks.whole("reference_every", self.reference_every, 1)


GATHER = Reading()
SLICES = Reading("slices")
AT_REST = Reading("at_rest")


class AbstractDisplacement(eqx.Module):
    """Where the sources of a region's pixels lie, px from each pixel's centre."""

    @abc.abstractmethod
    def field(self) -> Callable[[], tuple[Plane, Plane]]:
        """Return `px` as a function, its scalars computed already."""

    def px(self) -> tuple[Plane, Plane]:
        """Source position from each pixel's centre, px, two `(height, width)`."""
        return self.field()()

    @abc.abstractmethod
    def span(self) -> Float[Array, "2 2"]:
        """Smallest and largest `(dx, dy)` over the region, px; never too narrow."""

    @abc.abstractmethod
    def inside(self) -> Mask:
        """Whether the source lies in the camera frame and in front of the camera."""

    @property
    @abc.abstractmethod
    def _known_span(self) -> Float[Array, "2 2"] | None:
        """Return `span` if no plane has to be looked at for it."""

    def changed(
        self,
        change_x: Callable[[Numbers], Numbers],
        change_y: Callable[[Numbers], Numbers],
    ) -> "DisplacementField":
        """Return it with both parts changed, px, each by a monotone function."""
        dx, dy = self.px()
        span = self._known_span
        if span is not None:
            ends = [change_x(span[:, 0]), change_y(span[:, 1])]
            span = jnp.sort(jnp.stack(ends, axis=1), axis=0)
        camera, region, reading = self._place
        field = (camera, region, change_x(dx), change_y(dy))
        return DisplacementField(*field, span, reading)

    @property
    @abc.abstractmethod
    def _place(self) -> tuple[Camera, Region, Reading]:
        """Whose pixels these are, and how their sources are read."""

    @property
    @abc.abstractmethod
    def _numbers(self) -> tuple[Array, ...]:
        """What it was made of."""

    @property
    def dtype(self) -> jnp.dtype:
        """Type of its floats."""
        return self._numbers[0].dtype

    def is_finite(self) -> Bool[Array, ""]:
        """Whether what it was made of is finite."""
        first, *others = (jnp.isfinite(numbers).all() for numbers in self._numbers)
        return functools.reduce(jnp.logical_and, others, first)


class DisplacementField(AbstractDisplacement):
    """Sources that lie anywhere: one displacement per pixel.

    - `dx`, `dy`: px, `(height, width)`; a source that no pixel can show lies far off.
    - `bounds`: smallest and largest `(dx, dy)`, px; None finds them.
    """

    camera: Camera
    region: Region
    dx: Plane
    dy: Plane
    bounds: Float[Array, "2 2"] | None = None
    reading: Reading = GATHER

    def field(self) -> Callable[[], tuple[Plane, Plane]]:
        """Return the field."""
        return lambda: (self.dx, self.dy)

    def span(self) -> Float[Array, "2 2"]:
        """Return the bounds, or the extremes of the field."""
        if self.bounds is not None:
            return self.bounds
        ends = [[f(self.dx), f(self.dy)] for f in (jnp.min, jnp.max)]
        return jnp.stack([jnp.stack(end) for end in ends])

    @property
    def _known_span(self) -> Float[Array, "2 2"] | None:
        return self.bounds

    @property
    def _place(self) -> tuple[Camera, Region, Reading]:
        return self.camera, self.region, self.reading

    def inside(self) -> Mask:
        """Whether the source lies in the camera frame."""
        x = self.region.columns().astype(self.dx.dtype) + 0.5 + self.dx
        y = self.region.rows().astype(self.dy.dtype) + 0.5 + self.dy
        in_width = (x >= 0) & (x <= self.camera.width_px)
        return in_width & (y >= 0) & (y <= self.camera.height_px)

    @property
    def _numbers(self) -> tuple[Array, ...]:
        return self.dx, self.dy


class Displacement(AbstractDisplacement):
    """Where the sources of a region's pixels lie when their rays are turned.

    A formula, not a field: sources evaluate it where they need it.

    - `rotation`: rotation vector applied to the rays, rad, shape `(3,)`.
    - `sample_px`: which point of each pixel is meant, px from its centre, shape `(2,)`,
      in `[-1.5, 1.5]` (jitter may leave the pixel); None is the centre itself.
    - `reading`: how the source is read.
    """

    camera: Camera
    region: Region
    rotation: RotationVector
    sample_px: Float[Array, "2"] | None = None
    reading: Reading = GATHER

    def _positions(self) -> tuple[Float[Array, "1 width"], Float[Array, "height 1"]]:
        dtype = self.rotation.dtype
        x = self.region.columns().astype(dtype) + 0.5
        y = self.region.rows().astype(dtype) + 0.5
        if self.sample_px is not None:
            x, y = x + self.sample_px[0], y + self.sample_px[1]
        return x, y

    @property
    def _numbers(self) -> tuple[Array, ...]:
        return (self.rotation,)

    def field(self) -> Callable[[], tuple[Plane, Plane]]:
        """Return `px` as a function, its scalars computed already."""
        if self.reading.warp == "homography":
            moved = pinhole.displacing(self.camera, self.rotation)
        else:
            moved = self._linear()
        x, y = self._positions()

        def px() -> tuple[Plane, Plane]:
            dx, dy, *_ = moved(x, y)
            if self.sample_px is not None:
                return dx + self.sample_px[0], dy + self.sample_px[1]
            return dx, dy

        return px

    def _at_centre(
        self,
    ) -> tuple[Float[Array, "2"], Float[Array, "2"], Float[Array, "2 2"]]:
        """Middle of the region's samples, its displacement, and the slope there."""
        region, dtype = self.region, self.rotation.dtype
        x = jnp.asarray(region.x0, dtype) + region.width / 2
        centre = jnp.stack([x, jnp.asarray(region.y0, dtype) + region.height / 2])
        if self.sample_px is not None:
            centre = centre + self.sample_px
        moved = pinhole.displacing(self.camera, self.rotation)
        at = lambda place: jnp.stack(moved(*place)[:2])
        return centre, at(centre), jax.jacfwd(at)(centre)

    def _linear(self) -> Callable[[Numbers, Numbers], tuple[Plane, Plane]]:
        """Displacement about the region's centre, to order 1 or to order 0."""
        centre, offset, slope = self._at_centre()
        shape = (self.region.height, self.region.width)

        def shift(x: Numbers, y: Numbers) -> tuple[Plane, Plane]:
            return jnp.full(shape, offset[0]), jnp.full(shape, offset[1])

        def affine(x: Numbers, y: Numbers) -> tuple[Plane, Plane]:
            x, y = x - centre[0], y - centre[1]
            dx = offset[0] + slope[0, 0] * x + slope[0, 1] * y
            return dx, offset[1] + slope[1, 0] * x + slope[1, 1] * y

        return shift if self.reading.warp == "shift" else affine

    def span(self) -> Float[Array, "2 2"]:
        """Smallest and largest `(dx, dy)` over the region, px; never too narrow."""
        if self.reading.warp == "homography":
            return self._exact_span()
        _, offset, slope = self._at_centre()
        half = jnp.array([self.region.width / 2, self.region.height / 2], slope.dtype)
        extent = jnp.abs(slope) @ half if self.reading.warp == "affine" else 0 * half
        extent = extent + 8 * jnp.finfo(slope.dtype).eps * (jnp.abs(offset) + extent)
        span = jnp.stack([offset - extent, offset + extent])
        return span if self.sample_px is None else span + self.sample_px[None]

    @property
    def _known_span(self) -> Float[Array, "2 2"]:
        return self.span()

    @property
    def _place(self) -> tuple[Camera, Region, Reading]:
        return self.camera, self.region, self.reading

    def _exact_span(self) -> Float[Array, "2 2"]:
        """Return `span` without approximation."""
        region = self.region
        if self.sample_px is None:
            return camera_bounds.displacement_range(self.camera, region, self.rotation)
        # A jittered sample may lie outside its pixel, where the picture moves faster.
        wider = Region(
            region.x0 - 1, region.y0 - 1, region.width + 2, region.height + 2
        )
        span = camera_bounds.displacement_range(self.camera, wider, self.rotation)
        return span + self.sample_px[None]

    def inside(self) -> Mask:
        """Whether the source lies in the camera frame and in front of the camera.

        Exact, whatever the reading.
        """

        def each() -> Mask:
            x, y = self._positions()
            dx, dy, in_front = pinhole.displacement(self.camera, self.rotation, x, y)
            in_width = (x + dx >= 0) & (x + dx <= self.camera.width_px)
            in_height = (y + dy >= 0) & (y + dy <= self.camera.height_px)
            return in_front & in_width & in_height

        if self.reading.sampler != "slices":
            return each()
        # Away from the frame's edges a block is inside as a whole.
        region, (low, high) = self.region, self._exact_span()
        first = jnp.stack([jnp.asarray(i, low.dtype) for i in (region.x0, region.y0)])
        size = jnp.array([region.width, region.height], low.dtype)
        end = jnp.array([self.camera.width_px, self.camera.height_px], low.dtype)
        is_whole = jnp.all((first + low >= 0) & (first + size + high <= end))
        everywhere = lambda: jnp.ones((region.height, region.width), bool)
        return jax.lax.cond(is_whole, everywhere, each)


AnyDisplacement = Displacement | DisplacementField
