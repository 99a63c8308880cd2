"""Rendering: a source, a camera, a region and a head pose give a frame."""

from collections.abc import Collection

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._types import Planes, Rgb, RotationVector
from .camera import Camera, Region
from .frames.displacement import GATHER, Reading
from .frames.frame import Frame
from .frames.sources import AbstractSource, View

COLOR = frozenset({"color"})


def render(
    source: AbstractSource,
    camera: Camera,
    region: Region,
    offset: RotationVector,
    samples_px: Float[np.ndarray, "samples 2"] | Float[Array, "samples 2"],
    *,
    position_m: Float[Array, "3"] | None = None,
    channels: Collection[str] = COLOR,
    supersampled: bool = False,
    reading: Reading = GATHER,
) -> Frame:
    """Frame of a region as the head sees it from a pose.

    **Arguments:**

    - `offset`: the pose, as rotation from the hold pose, rad, shape `(3,)`.
    - `samples_px`: sub-pixel samples, from the pixel centre, px; traced where they
      change from frame to frame.
    - `position_m`: of the eye, from its place in the hold pose; None if it stays there.
    - `channels`: what the frame holds, of what the source gives: no more is computed.
    - `supersampled`: read the source's SSAA(4) channel instead, once per pixel.
    """
    view = View(camera, region, offset, position_m, None, reading)
    if supersampled:
        color = source.seen(view, {"supersampled"})["supersampled"][None]
        return Frame(color, camera, region, reading=reading)

    def at(sample: Array | np.ndarray) -> dict[str, Planes]:
        # A sample at the centre that is known to be one costs nothing.
        is_centre = isinstance(sample, np.ndarray) and not sample.any()
        shift = None if is_centre else jnp.asarray(sample, offset.dtype)
        moved = View(camera, region, offset, position_m, shift, reading)
        return source.seen(moved, channels)

    seen = [at(sample) for sample in samples_px]
    stacked = {name: jnp.stack([each[name] for each in seen]) for name in channels}
    color = stacked.pop("color")
    return Frame(color, camera, region, reading=reading, channels=stacked)


def reference(
    source: AbstractSource,
    camera: Camera,
    region: Region,
    offset: RotationVector,
    reading: Reading = GATHER,
    *,
    position_m: Float[Array, "3"] | None = None,
) -> Rgb:
    """Return the SSAA(4) reference picture of a region, gamma, `(3, height, width)`.

    **Accuracy:** the texture's box is one pixel of the hold pose's image plane; off the
    hold pose the true pixel is turned and scaled a little against it.
    """
    view = View(camera, region, offset, position_m, None, reading)
    return source.seen(view, {"supersampled"})["supersampled"]
