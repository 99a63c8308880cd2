"""A pattern in two colours, seen exactly: no texture lies between it and its samples.

A texture would smooth the very edges whose anti-aliasing is compared.
"""

from collections.abc import Collection

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped
from scipy import stats

from .. import color, quaternion, sample_patterns
from .._types import Numbers, Plane, Rgb, Scalar, WholeNumber
from ..camera import Camera, Region
from ..frames.motion import Motion
from ..frames.sources import AbstractSource, Places, View
from ..scenes.base import AbstractScene


class TwoColored(AbstractSource):
    """A black and white pattern, infinitely far away, in two colours instead.

    - `patterns`, `chosen`: the pattern is one of these, from 0 (`first`) to 1
      (`second`); those that share a list share a program.
    - `first`, `second`: gamma colours, `(3,)`, in `[0, 1]`.
    - `tilt_deg`: by which the pattern is turned clockwise about the view's centre.
    - `blur_px`: of the reference, standard deviation of a Gaussian; 0 is the mean over
      a pixel's square.
    """

    patterns: tuple[AbstractScene, ...]
    chosen: WholeNumber
    first: Float[Array | np.ndarray, "3"]
    second: Float[Array | np.ndarray, "3"]
    tilt_deg: Scalar = 0.0
    blur_px: float = eqx.field(static=True, default=0.0)

    @property
    def gives(self) -> frozenset[str]:
        """Colour alone."""
        return frozenset({"color"})

    def seen(
        self, view: View, samples_px: Places, channels: Collection[str]
    ) -> dict[str, Shaped[Array, "samples channels height width"]]:
        """Colour at each sample's own point."""
        share = self._share(view, jnp.asarray(samples_px, view.motion.offset.dtype))
        return {"color": _mixed(self.first, self.second, share[:, None])}

    def reference(self, view: View) -> Rgb:
        """Mix both in linear light, by their shares of a pixel's square, or of a blur.

        **Accuracy:** that of as many samples of a scrambled Halton sequence as the
        view's reading says.
        """
        dtype = view.motion.offset.dtype
        count = view.reading.reference_samples
        offsets = sample_patterns.halton(count, first=1, scrambled=True)
        if self.blur_px:
            offsets = self.blur_px * stats.norm.ppf(offsets)
        else:
            offsets = offsets - 0.5

        def add(total: Plane, offset: Array) -> tuple[Plane, None]:
            return total + self._share(view, offset[None])[0], None

        start = jnp.zeros((view.region.height, view.region.width), dtype)
        total, _ = jax.lax.scan(add, start, jnp.asarray(offsets, dtype))
        first, second = (jnp.asarray(c, dtype) for c in (self.first, self.second))
        light = _mixed(color.decode(first), color.decode(second), total[None] / count)
        return color.encode(light)

    def covers(self, camera: Camera, region: Region, motion: Motion) -> Bool[Array, ""]:
        """Whether the pose is known: the pattern has no end."""
        return jnp.isfinite(motion.offset).all()

    def _share(
        self, view: View, offsets_px: Float[Array, "samples 2"]
    ) -> Float[Array, "samples height width"]:
        """Share of the second colour at points of each pixel: 0 or 1."""
        camera, dtype = view.camera, offsets_px.dtype
        focal = jnp.asarray(camera.focal_px, dtype)
        dx, dy = (part[:, None, None] for part in offsets_px.T)
        x = view.region.columns().astype(dtype)[None] + 0.5 + dx
        y = view.region.rows().astype(dtype)[None] + 0.5 + dy
        x, y = (x - camera.width_px / 2) / focal, (camera.height_px / 2 - y) / focal
        ray = jnp.stack([*jnp.broadcast_arrays(x, y), -jnp.ones_like(x + y)])
        turn = quaternion.matrix_minus_identity(view.motion.offset)
        # In full precision: some devices shorten the numbers of products.
        moved = jnp.tensordot(turn, ray, 1, precision="highest")
        x, y, z = ray + moved
        tilt = jnp.deg2rad(jnp.asarray(self.tilt_deg, dtype))
        cos, sin = jnp.cos(tilt), jnp.sin(tilt)
        tilted = jnp.stack([cos * x - sin * y, sin * x + cos * y, z])
        each = [lambda ray, p=p: p.color(camera, ray)[0] for p in self.patterns]
        return jax.lax.switch(jnp.asarray(self.chosen, jnp.int32), each, tilted)


def _mixed(
    first: Array | np.ndarray, second: Array | np.ndarray, share: Numbers
) -> Numbers:
    """Mix two colours, `(3,)`, by planes of shares, `(..., 1, height, width)`."""
    shape = (*(1,) * (share.ndim - 3), 3, 1, 1)
    first, second = (
        jnp.asarray(c, share.dtype).reshape(shape) for c in (first, second)
    )
    return first + (second - first) * share
