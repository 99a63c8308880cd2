"""What tests look at, and how their heads move."""

import jax.numpy as jnp
import numpy as np
import oracles

import hmdjit as hj


def noise_texture(rng, camera, margin_px, *, dtype=float, blur_px=2.0):
    """Smooth noise, 2 texels per pixel; the reference is another, blurred more."""
    height, width = (
        2 * (n + 2 * margin_px) for n in (camera.height_px, camera.width_px)
    )
    color = oracles.smooth_noise(rng, height, width, 2 * blur_px)
    reference = oracles.smooth_noise(rng, height, width, 3 * blur_px)
    return hj.Texture.of(
        jnp.asarray(color, dtype), jnp.asarray(reference, dtype), 2, margin_px
    )


def path(rng, camera, frames, rms_px=0.4):
    """Poses of a head whose picture moves by about `rms_px` per frame and axis."""
    turns = rng.normal(size=(frames - 1, 3)) * rms_px / np.float64(camera.focal_px)
    return oracles.poses_after(turns)
