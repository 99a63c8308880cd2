"""Pictures as a source: a scene baked to the image plane of the hold pose."""

from collections.abc import Collection

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Shaped

from .. import _checks, camera_bounds
from .._types import Picture, Rgb
from ..camera import Camera, Region
from . import resampling, sources
from .displacement import Displacement
from .frame import CHANNELS
from .motion import Motion
from .resampling import Texels
from .sources import AbstractSource, Places, View

_OF_A_PICTURE = {"depth": jnp.inf, "object_id": 0, "motion_class": 0, "coverage": 0}
PICTURE = frozenset({"color", "supersampled", "albedo", "velocity", *_OF_A_PICTURE})
"""What there is to ask of a picture."""

_UNROLLED = 4  # samples: a read takes seconds to compile, so more are made in a loop


class Texture(AbstractSource):
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
        cls,
        color: ArrayLike,
        supersampled: ArrayLike,
        oversampling: int,
        margin_px: int,
    ) -> "Texture":
        """Store two pictures `(height, width, 3)`, `oversampling` texels per pixel.

        **Arguments:** gamma: floating in `[0, 1]`, or uint8 or uint16, whose largest
        code is 1.

        **Errors:** `ValueError` for any other dtype, range or shape.
        """
        named = {"color": color, "supersampled": supersampled}
        first, second = (_checks.colors(*item) for item in named.items())
        fits = first.shape == second.shape and first.ndim == 3 and first.shape[2] == 3
        if not fits or any(side % oversampling for side in first.shape[:2]):
            raise ValueError(
                "color and supersampled must have one shape (height, width, 3), whole "
                f"multiples of oversampling = {oversampling}, got {first.shape} and "
                f"{second.shape}."
            )
        stored = resampling.texels(first, oversampling)
        return cls(stored, resampling.texels(second, oversampling), margin_px)

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
        return sources.read(
            texels, place, displacement, displacement.reading.texture_filter
        )

    @property
    def gives(self) -> frozenset[str]:
        """Colour, in one read the SSAA(4) reference, and what a picture has none of.

        A picture is a static background, infinitely far away, lit by itself.
        """
        return PICTURE

    def seen(
        self,
        view: View,
        samples_px: Places,
        channels: Collection[str],
    ) -> dict[str, Shaped[Array, "samples channels height width"]]:
        """Read a picture: it is as far away as can be, so only rotation counts."""
        dtype, region = view.motion.offset.dtype, view.region
        size = (len(samples_px), 1, region.height, region.width)
        found = {
            name: jnp.full(size, value, CHANNELS[name][1] or dtype)
            for name, value in _OF_A_PICTURE.items()
            if name in channels
        }
        read = [name for name in channels if name in ("color", "supersampled")]
        if "albedo" in channels and not read:
            read = ["color"]
        for name in read:
            at = lambda sample, name=name: self._at(view, sample, name)
            if len(samples_px) <= _UNROLLED:
                found[name] = jnp.stack([at(sample) for sample in samples_px])
            else:
                found[name] = jax.lax.map(at, jnp.asarray(samples_px, dtype))
        if "albedo" in channels:
            found["albedo"] = found[read[0]]
        return found

    def _at(self, view: View, sample_px: Array | np.ndarray, channel: str) -> Rgb:
        # A sample at the centre that is known to be one costs nothing.
        is_centre = isinstance(sample_px, np.ndarray) and not sample_px.any()
        offset = view.motion.offset
        shift = None if is_centre else jnp.asarray(sample_px, offset.dtype)
        displacement = Displacement(
            view.camera, view.region, offset, shift, view.reading
        )
        return self.at(displacement, supersampled=channel == "supersampled")

    def reference(self, view: View) -> Rgb:
        """Return the SSAA(4) picture in one read.

        **Accuracy:** the texture's box is one pixel of the hold pose's image plane; off
        the hold pose the true pixel is turned and scaled a little against it.
        """
        return self._at(view, np.zeros(2), "supersampled")

    def covers(self, camera: Camera, region: Region, motion: Motion) -> Bool[Array, ""]:
        """Whether the head stays within the margin."""
        bounds = jax.vmap(
            lambda r: camera_bounds.displacement_bound(camera, region, r)
        )(motion.offset)
        return jnp.all(bounds <= self.margin_px)
