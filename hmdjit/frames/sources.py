"""What is read: histories and scenes, each through one door.

A displacement says where a pixel's source lies relative to the pixel's own centre. That
keeps the digits that a position near 1000 px would lose, and leaves storage and taps to
the source: a faster source changes no technique.
"""

import abc
import contextlib
import contextvars
from collections.abc import Collection, Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped

from .._types import Plane, Planes, Rgb, Scalar, WholeNumber
from ..camera import Camera, Region
from . import resampling
from .displacement import GATHER, AnyDisplacement, Reading
from .frame import Steps
from .motion import Motion
from .resampling import Texels

Reads = list[AnyDisplacement | None]

_recorded: contextvars.ContextVar[Reads | None]
_recorded = contextvars.ContextVar("recorded", default=None)


@contextlib.contextmanager
def recorded_reads() -> Iterator[Reads]:
    """Record where histories are read while a step is traced; None is unmoved."""
    reads: Reads = []
    token = _recorded.set(reads)
    try:
        yield reads
    finally:
        _recorded.reset(token)


def record_read(displacement: AnyDisplacement | None) -> None:
    """Tell that the past is read there: for states that are no `History`."""
    if (reads := _recorded.get()) is not None:
        reads.append(displacement)


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
        record_read(None)
        _, _, channels, *_ = self.texels.shape
        column, row = self._place(region)
        start = [jnp.asarray(i, jnp.int32) for i in (0, 0, 0, row, column)]
        size = (1, 1, channels, region.height, region.width)
        return jax.lax.dynamic_slice(self.texels, start, size)[0, 0]

    def at(self, displacement: AnyDisplacement) -> Planes:
        """Planes read where each pixel's source lies, `(channels, height, width)`."""
        record_read(displacement)
        if displacement.reading.sampler == "at_rest":
            return self.under(displacement.region)
        place = self._place(displacement.region)
        filter_ = displacement.reading.history_filter
        return read(self.texels, place, displacement, filter_)


INSTEAD_OF_COLOR = frozenset({"supersampled", "multisampled"})
"""Channels that take the place of a frame's colour."""


Places = Float[np.ndarray, "samples 2"] | Float[Array, "samples 2"]
"""Samples' places from the pixel centre, px: NumPy where a program knows them."""


class View(eqx.Module):
    """From where a region is seen.

    - `motion`: of the head at this frame, from the hold pose.
    - `frame`: number of the frame, from the hold pose on: its time in frames.
    """

    camera: Camera
    region: Region
    motion: Motion
    frame: WholeNumber = 0
    reading: Reading = GATHER


class AbstractSource(eqx.Module):
    """A scene, as rendering reads it."""

    @property
    @abc.abstractmethod
    def gives(self) -> frozenset[str]:
        """Channels that there are to ask for (see `Frame`); `"color"` always.

        Two are colours as well: `"supersampled"`, the SSAA(4) picture, of a source that
        has it ready made; `"multisampled"`, of each sample what its surface shows at
        the pixel's centre, of a source whose surfaces end.
        """

    @abc.abstractmethod
    def seen(
        self,
        view: View,
        samples_px: Places,
        channels: Collection[str],
    ) -> dict[str, Shaped[Array, "samples channels height width"]]:
        """Planes of the channels asked for, at points of each pixel of a region.

        `velocity` is left out where it is that of the head's rotation alone.

        **Arguments:** `samples_px`: from the pixel centre; NumPy where they are known
        before a program runs.
        """

    @abc.abstractmethod
    def reference(self, view: View) -> Rgb:
        """Picture without aliasing that detail loss is measured against, gamma."""

    @abc.abstractmethod
    def covers(self, camera: Camera, region: Region, motion: Motion) -> Bool[Array, ""]:
        """Whether all that a session sees of a region is there to be read."""

    def velocity_bounds(self, view: View) -> Float[Array, "2 2"] | None:
        """Smallest and largest displacement by which the past is reprojected, px.

        None where that is the head's rotation alone.
        """
        return None

    def steps(self, view: View) -> Steps | None:
        """Increment and translation of the head against each object (see `Frame`)."""
        return None

    def nearest_m(self, view: View) -> Scalar:
        """Smallest depth that a region can show, m; inf where all is that far away."""
        return jnp.inf


def read(
    texels: Texels,
    place: tuple[WholeNumber, WholeNumber],
    displacement: AnyDisplacement,
    filter_: str,
) -> Planes:
    """Read texels behind a boundary that XLA does not fuse across.

    On the CPU, XLA would read anew for every use of the result, six times in a blend;
    only a conditional that it cannot decide stops it. A displacement that is not finite
    gives NaN, so the condition also means something.
    """
    k, _, channels, *_ = texels.shape
    region, column, row = displacement.region, *place

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
        return read_with(texels, x, y, *offset()).astype(displacement.dtype)

    if displacement.reading.sampler == "plain":
        # Under `vmap` the condition would be one per run, and JAX cannot transpose the
        # tangents of such a conditional.
        return read()
    unknown = (channels, region.height, region.width)
    return jax.lax.cond(
        displacement.is_finite(),
        read,
        lambda: jnp.full(unknown, jnp.nan, displacement.dtype),
    )
