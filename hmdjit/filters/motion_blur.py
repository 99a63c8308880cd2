"""Smearing a picture along its motion."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._types import Plane, Rgb
from ..frames import sources
from ..frames.displacement import AnyDisplacement
from ..frames.sources import History

_RIM_PX = 4  # repeated edge pixels, so that short smears are read by slices


def length(dx: Plane, dy: Plane) -> Plane:
    """Euclidean length, whose slope at 0 is chosen as 0."""
    squared = dx**2 + dy**2
    is_zero = squared == 0
    return jnp.where(is_zero, 0, jnp.sqrt(jnp.where(is_zero, 1, squared)))


def cut(dx: Plane, dy: Plane, longest_px: int) -> tuple[Plane, Plane]:
    """Shorten what is longer; what has no length stays as it is."""
    share = longest_px / jnp.maximum(length(dx, dy), longest_px)
    return dx * share, dy * share


def smeared(
    colors: Rgb,
    displacement: AnyDisplacement,
    aside_px: Float[Array, "2"] | None,
    taps: int,
) -> Rgb:
    """Mean along the way of each pixel, half of it ahead and half behind.

    **Arguments:** `displacement`: the way since the last frame; `aside_px`: from the
    pixel's centre to the middle of its way; `taps`: at equal distances, at least 2.
    """
    kept = History.of(colors).with_rim(displacement.region, _RIM_PX)
    # Not through the history's own door: this is the current frame.
    aside_x, aside_y = jnp.zeros(2, colors.dtype) if aside_px is None else aside_px
    place = (jnp.int32(_RIM_PX), jnp.int32(_RIM_PX))

    def add(total: Rgb, share: Array) -> tuple[Rgb, None]:
        there = displacement.changed(
            lambda dx: share * dx + aside_x, lambda dy: share * dy + aside_y
        )
        return total + sources.read(kept.texels, place, there, "bilinear"), None

    shares = jnp.linspace(-0.5, 0.5, taps, dtype=displacement.dtype)
    total, _ = jax.lax.scan(add, jnp.zeros_like(colors), shares)
    return total / taps
