"""Pictures that are read only through `source.at(displacement)`: history, texture.

A displacement says where a pixel's source lies relative to the pixel's own centre. That
keeps the digits that a position near 1000 px would lose, and leaves storage and taps to
the source: a faster source changes no technique.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from .._types import Picture, Plane, Planes, Rgb, WholeNumber
from ..camera import Region
from . import resampling
from .displacement import Displacement
from .resampling import Texels


class History(eqx.Module):
    """A displayed region, read by the frames after it.

    Reads beyond the region clamp to its edge.

    - `texels`: the region, with a rim of `rim_px` repeated edge pixels around it.
    - `region`: which pixels these are; None means those of whoever reads.
    """

    texels: Texels
    region: Region | None = None
    rim_px: int = eqx.field(static=True, default=0)

    @classmethod
    def of(cls, planes: Planes) -> "History":
        """Keep planes `(channels, height, width)`."""
        return cls(planes[None, None])

    def with_rim(self, region: Region, rim_px: int) -> "History":
        """Repeat the edge pixels all around, so that slices may reach over it."""
        widths = [(0, 0)] * 3 + [(rim_px, rim_px)] * 2
        return History(jnp.pad(self.texels, widths, mode="edge"), region, rim_px)

    def written(self, planes: Planes, region: Region) -> "History":
        """Replace some of its pixels; the rim stays as it was."""
        column, row = self._place(region)
        start = [jnp.asarray(i, jnp.int32) for i in (0, 0, 0, row, column)]
        texels = jax.lax.dynamic_update_slice(self.texels, planes[None, None], start)
        return History(texels, self.region, self.rim_px)

    def rimmed(self) -> "History":
        """Repeat the edge pixels all around once more."""
        rim, rows, columns = self.rim_px, *self.texels.shape[-2:]
        if not rim:
            return self

        def edges() -> list[Texels]:
            rows = self.texels[..., [rim, -rim - 1], rim:-rim]
            ends = [(0, 0)] * 4 + [(rim, rim)]
            top, bottom = jnp.split(jnp.pad(rows, ends, mode="edge"), 2, axis=-2)
            left = self.texels[..., rim:-rim, rim : rim + 1]
            right = self.texels[..., rim:-rim, -rim - 1 : -rim]
            upright = [jnp.repeat(edge, rim, axis=-1) for edge in (left, right)]
            return [jnp.repeat(edge, rim, axis=-2) for edge in (top, bottom)] + upright

        # All edges are read before any is written, and XLA is shown that they are:
        # else it copies the whole picture four times.
        is_known = jnp.isfinite(self.texels[0, 0, 0, rim, rim])
        known = jax.lax.cond(is_known, edges, edges)
        places = [(0, 0), (rows - rim, 0), (rim, 0), (rim, columns - rim)]
        texels = self.texels
        for edge, place in zip(known, places, strict=True):
            texels = jax.lax.dynamic_update_slice(texels, edge, (0, 0, 0, *place))
        return History(texels, self.region, rim)

    def _place(self, region: Region) -> tuple[WholeNumber, WholeNumber]:
        """Where a region begins in the texels."""
        mine = region if self.region is None else self.region
        column = region.x0 - mine.x0 + self.rim_px
        return column, region.y0 - mine.y0 + self.rim_px

    def under(self, region: Region) -> Planes:
        """Planes of some of its pixels, unmoved."""
        _, _, channels, *_ = self.texels.shape
        column, row = self._place(region)
        start = [jnp.asarray(i, jnp.int32) for i in (0, 0, 0, row, column)]
        size = (1, 1, channels, region.height, region.width)
        return jax.lax.dynamic_slice(self.texels, start, size)[0, 0]

    def at(self, displacement: Displacement) -> Planes:
        """Planes read where each pixel's source lies, `(channels, height, width)`."""
        if displacement.reading.sampler == "at_rest":
            return self.under(displacement.region)
        place = self._place(displacement.region)
        filter_ = displacement.reading.history_filter
        return _read(self.texels, place, displacement, filter_)


class Texture(eqx.Module):
    """A scene seen from the hold pose, baked: the image plane with a margin around it.

    Texel `k (i + margin_px)` of a row, k the oversampling, has its centre in that of
    pixel column i, and the k - 1 after it lie evenly between it and the next: the hold
    pose reads the scene exactly.

    - `color_texels`: gamma colour at each texel's centre.
    - `supersampled_texels`: the SSAA(4) reference at each texel's centre: 16 samples
      over one display pixel, averaged in linear light, gamma again.
    - `margin_px`: how far the plane extends beyond the camera frame, display px.

    Both are stored by phase, see `resampling`: `(k, k, 3, rows, columns)`.
    """

    color_texels: Texels
    supersampled_texels: Texels
    margin_px: int = eqx.field(static=True)

    @classmethod
    def of(
        cls, color: Picture, supersampled: Picture, oversampling: int, margin_px: int
    ) -> "Texture":
        """Store two pictures `(height, width, 3)`, `oversampling` texels per pixel."""
        stored = resampling.texels(color, oversampling)
        return cls(stored, resampling.texels(supersampled, oversampling), margin_px)

    @property
    def oversampling(self) -> int:
        """Texels per display pixel and axis, in the hold pose's plane."""
        return self.color_texels.shape[0]

    @property
    def color(self) -> Picture:
        """The colour as a picture, `(height, width, 3)`."""
        return resampling.picture(self.color_texels)

    @property
    def supersampled(self) -> Picture:
        """The reference as a picture, `(height, width, 3)`."""
        return resampling.picture(self.supersampled_texels)

    def at(self, displacement: Displacement, *, supersampled: bool = False) -> Rgb:
        """Colour, `(3, height, width)`, or the reference, where each source lies."""
        texels = self.supersampled_texels if supersampled else self.color_texels
        region = displacement.region
        place = (region.x0 + self.margin_px, region.y0 + self.margin_px)
        return _read(texels, place, displacement, displacement.reading.texture_filter)


def _read(
    texels: Texels,
    place: tuple[WholeNumber, WholeNumber],
    displacement: Displacement,
    filter_: str,
) -> Planes:
    """Read texels behind a boundary that XLA does not fuse across.

    On the CPU, XLA would read anew for every use of the result, six times in a blend;
    only a conditional that it cannot decide stops it. A rotation that is not finite
    gives NaN, so the condition also means something.
    """
    k, _, channels, *_ = texels.shape
    region, rotation = displacement.region, displacement.rotation
    column, row = place

    field = displacement.field()

    def offset() -> tuple[Plane, Plane]:
        dx, dy = field()
        return k * dx, k * dy

    if displacement.reading.sampler == "slices" and filter_ == "bilinear":
        shape = (region.height, region.width)
        span = k * displacement.span()
        return resampling.bilinear_by_slices(texels, column, row, shape, span, offset)

    def read() -> Planes:
        x = k * (column + jnp.arange(region.width, dtype=jnp.int32))[None, :]
        y = k * (row + jnp.arange(region.height, dtype=jnp.int32))[:, None]
        read_with = getattr(resampling, filter_)
        return read_with(texels, x, y, *offset()).astype(rotation.dtype)

    if displacement.reading.sampler == "plain":
        # Under `vmap` the condition would be one per run, and JAX cannot transpose the
        # tangents of such a conditional.
        return read()
    unknown = (channels, region.height, region.width)
    return jax.lax.cond(
        jnp.isfinite(rotation).all(),
        read,
        lambda: jnp.full(unknown, jnp.nan, rotation.dtype),
    )
