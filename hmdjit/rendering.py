"""Rendering: a baked scene, a camera, a region and a head pose give a frame."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._types import Rgb, RotationVector
from .camera import Camera, Region
from .frames.displacement import GATHER, Displacement, Reading
from .frames.frame import Frame
from .frames.sources import Texture


def render(
    texture: Texture,
    camera: Camera,
    region: Region,
    offset: RotationVector,
    samples_px: Float[np.ndarray, "samples 2"] | Float[Array, "samples 2"],
    *,
    supersampled: bool = False,
    reading: Reading = GATHER,
) -> Frame:
    """Frame of a region as the head sees it from a pose.

    **Arguments:**

    - `offset`: the pose, as rotation from the hold pose, rad, shape `(3,)`.
    - `samples_px`: sub-pixel samples, from the pixel centre, px; traced where they
      change from frame to frame.
    - `supersampled`: read the texture's SSAA(4) channel instead, once per pixel.

    **Returns:** a frame with colour only: that is all a picture has, and all that a
    technique can ask of it.
    """
    if supersampled:
        color = reference(texture, camera, region, offset, reading)[None]
        return Frame(color, camera, region, reading=reading)

    def at(sample: Array | np.ndarray) -> Rgb:
        is_centre = isinstance(sample, np.ndarray) and not sample.any()
        shift = None if is_centre else jnp.asarray(sample, offset.dtype)
        return texture.at(Displacement(camera, region, offset, shift, reading))

    color = jnp.stack([at(s) for s in samples_px])
    return Frame(color, camera, region, reading=reading)


def reference(
    texture: Texture,
    camera: Camera,
    region: Region,
    offset: RotationVector,
    reading: Reading = GATHER,
) -> Rgb:
    """Return the SSAA(4) reference picture of a region, gamma, `(3, height, width)`.

    **Accuracy:** the texture's box is one pixel of the hold pose's image plane; off the
    hold pose the true pixel is turned and scaled a little against it.
    """
    displacement = Displacement(camera, region, offset, None, reading)
    return texture.at(displacement, supersampled=True)
