"""What passes from stage to stage: motion, displacements, sources and frames.

History and texture are *sources*: they are read only through
`source.at(displacement)`, which says where a pixel's source lies relative to the
pixel's own centre. That keeps the digits that a position near 1000 px would lose, and
leaves storage and taps to the source: a faster source changes no technique.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float

from . import camera as pinhole
from . import quaternion, resampling
from ._types import Mask, Plane, Planes, Poses, Rgb, RotationVector, Samples
from .camera import Camera, Region
from .resampling import Texels


class Motion(eqx.Module):
    """Head motion at a frame, or along a session with a leading `frames` axis.

    - `offset`: `log(q_hold^-1 q_k)`, rad: where the head points now.
    - `increment`: `log(q_{k-1}^-1 q_k)`, rad: how it turned since the last frame; 0 at
      the first frame.
    """

    offset: Float[Array, "*frames 3"]
    increment: Float[Array, "*frames 3"]

    @classmethod
    def of(cls, poses: Poses) -> "Motion":
        """Motion of a session; the first pose is the hold pose.

        **Arguments:** `poses`: `world_from_head`, shape `(frames, 4)`, unit length.
        """
        return cls(quaternion.offsets(poses), quaternion.increments(poses))


class Displacement(eqx.Module):
    """Where the sources of a region's pixels lie when their rays are turned.

    A formula, not a field: sources evaluate it where they need it.

    - `rotation`: rotation vector applied to the rays, rad, shape `(3,)`.
    - `sample_px`: which point of each pixel is meant, px from its centre, shape `(2,)`,
      in `[-1.5, 1.5]` (jitter may leave the pixel); None is the centre itself.
    """

    camera: Camera
    region: Region
    rotation: RotationVector
    sample_px: Float[Array, "2"] | None = None

    def _positions(self) -> tuple[Float[Array, "1 width"], Float[Array, "height 1"]]:
        dtype = self.rotation.dtype
        x = self.region.columns().astype(dtype) + 0.5
        y = self.region.rows().astype(dtype) + 0.5
        if self.sample_px is not None:
            x, y = x + self.sample_px[0], y + self.sample_px[1]
        return x, y

    def px(self) -> tuple[Plane, Plane]:
        """Source position from each pixel's centre, px, two `(height, width)`."""
        dx, dy, _ = pinhole.displacement(self.camera, self.rotation, *self._positions())
        if self.sample_px is not None:
            dx, dy = dx + self.sample_px[0], dy + self.sample_px[1]
        return dx, dy

    def bounds(self) -> Float[Array, "2"]:
        """Largest |dx| and |dy| over the region, px; never too small."""
        region = self.region
        if self.sample_px is None:
            return pinhole.displacement_bound(self.camera, region, self.rotation)
        # A jittered sample may lie outside its pixel, where the picture moves faster.
        wider = Region(
            region.x0 - 1, region.y0 - 1, region.width + 2, region.height + 2
        )
        bound = pinhole.displacement_bound(self.camera, wider, self.rotation)
        return bound + jnp.abs(self.sample_px)

    def inside(self) -> Mask:
        """Whether the source lies in the camera frame and in front of the camera."""
        x, y = self._positions()
        dx, dy, in_front = pinhole.displacement(self.camera, self.rotation, x, y)
        in_width = (x + dx >= 0) & (x + dx <= self.camera.width_px)
        in_height = (y + dy >= 0) & (y + dy <= self.camera.height_px)
        return in_front & in_width & in_height


class History(eqx.Module):
    """A displayed region, read bilinearly by the frames after it.

    The bilinear read belongs to the modelled device: a sharper one changes MTCD by
    several percent. Taps beyond the region clamp to its edge.
    """

    texels: Texels

    @classmethod
    def of(cls, planes: Planes) -> "History":
        """Keep planes `(channels, height, width)`."""
        return cls(jnp.moveaxis(planes, 0, -1))

    @property
    def planes(self) -> Planes:
        """The region itself, unmoved, shape `(channels, height, width)`."""
        return jnp.moveaxis(self.texels, -1, 0)

    def at(self, displacement: Displacement) -> Planes:
        """Planes read where each pixel's source lies; same shape as the region."""
        height, width, _ = self.texels.shape
        column = jnp.arange(width, dtype=jnp.int32)[None, :]
        row = jnp.arange(height, dtype=jnp.int32)[:, None]
        return _read(self.texels, column, row, displacement)


class Texture(eqx.Module):
    """A scene seen from the hold pose, baked: the image plane with a margin around it.

    Texel `k (i + margin_px)` of a row, k the oversampling, has its centre in that of
    pixel column i, and the k - 1 after it lie evenly between it and the next: the hold
    pose reads the scene exactly.

    - `color`: gamma colour at each texel's centre, shape `(height, width, 3)`.
    - `supersampled`: the SSAA(4) reference at each texel's centre: 16 samples over one
      display pixel, averaged in linear light, gamma again; same shape.
    - `oversampling`: texels per display pixel and axis, in the hold pose's plane.
    - `margin_px`: how far the plane extends beyond the camera frame, display px.
    """

    color: Texels
    supersampled: Texels
    oversampling: int = eqx.field(static=True)
    margin_px: int = eqx.field(static=True)

    def at(self, displacement: Displacement, *, supersampled: bool = False) -> Rgb:
        """Colour, `(3, height, width)`, or the reference, where each source lies."""
        scale = self.oversampling
        region = displacement.region
        column = scale * (region.columns() + self.margin_px)
        row = scale * (region.rows() + self.margin_px)
        texels = self.supersampled if supersampled else self.color
        return _read(texels, column, row, displacement, scale)


def _read(
    texels: Texels,
    column: Array,
    row: Array,
    displacement: Displacement,
    scale: int = 1,
) -> Planes:
    """Bilinear read behind a boundary that XLA does not fuse across.

    On the CPU, XLA would gather anew for every use of the result, six times in a
    blend; only a conditional that it cannot decide stops it. A rotation that is not
    finite gives NaN, so the condition also means something.
    """
    region = displacement.region
    shape = (texels.shape[-1], region.height, region.width)

    def read() -> Planes:
        dx, dy = displacement.px()
        return resampling.bilinear(texels, column, row, scale * dx, scale * dy)

    return jax.lax.cond(
        jnp.isfinite(displacement.rotation).all(),
        read,
        lambda: jnp.full(shape, jnp.nan, texels.dtype),
    )


class Frame(eqx.Module):
    """What rendering hands to a technique: colour and only the channels asked for.

    - `color`: gamma, one picture per sub-pixel sample, `(samples, 3, height, width)`.
    - `camera`, `region`: which pixels these are.
    - `static_mask`: True where the scene is static, `(height, width)`; None is
      everywhere.
    """

    color: Samples
    camera: Camera
    region: Region
    static_mask: Bool[Array, "height width"] | None = None

    def displacement(self, rotation: RotationVector) -> Displacement:
        """Where the sources of this frame's pixels lie when their rays are turned."""
        return Displacement(self.camera, self.region, rotation)


def rebased_motion(poses: Float[np.ndarray, "frames 4"], dtype: DTypeLike) -> Motion:
    """Motion of recorded poses, re-based to the first in float64 before rounding.

    **Arguments:** `poses`: `world_from_head`, shape `(frames, 4)`; `dtype`: of the
    result.
    """
    near_identity = quaternion.rebase(np.asarray(poses, np.float64))
    return Motion.of(jnp.asarray(near_identity, dtype))
