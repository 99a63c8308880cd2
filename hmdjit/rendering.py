"""Rendering: a baked scene, a camera, a region and a head pose give a frame."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._types import Rgb, RotationVector
from .camera import Camera, Region
from .frame import Displacement, Frame, Texture


def render(
    texture: Texture,
    camera: Camera,
    region: Region,
    offset: RotationVector,
    samples_px: Float[np.ndarray, "samples 2"] | Float[Array, "samples 2"],
    *,
    supersampled: bool = False,
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
        return Frame(reference(texture, camera, region, offset)[None], camera, region)

    def at(sample: Array | np.ndarray) -> Rgb:
        is_centre = isinstance(sample, np.ndarray) and not sample.any()
        shift = None if is_centre else jnp.asarray(sample, offset.dtype)
        return texture.at(Displacement(camera, region, offset, shift))

    return Frame(jnp.stack([at(s) for s in samples_px]), camera, region)


def reference(
    texture: Texture, camera: Camera, region: Region, offset: RotationVector
) -> Rgb:
    """Return the SSAA(4) reference picture of a region, gamma, `(3, height, width)`.

    **Accuracy:** the texture's box is one pixel of the hold pose's image plane; off the
    hold pose the true pixel is turned and scaled a little against it.
    """
    return texture.at(Displacement(camera, region, offset), supersampled=True)
