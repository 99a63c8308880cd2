"""How far the baked texture moves what a study measures, scene by scene."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hmdjit as hj
from hmdjit.camera import pixel_to_ray
from hmdjit.color import decode, encode
from hmdjit.sample_patterns import ordered_grid
from hmdjit.simulation.session import session
from hmdjit.techniques import SSAA, NoAntialiasing

CAMERA = hj.Camera()
SIZE, FRAMES, SESSIONS = 32, 4, 24

# Relative bias of the mean MTCD, in percent: none, and the SSAA(4) reference in one
# lookup. Measured with the sessions below; the bound is half as much again plus 0.2.
BIAS_PERCENT = {
    # One texel per pixel: the 2x texture holds the photograph itself.
    "astronaut": (0.0, -1.1),
    "cat": (0.0, -3.1),
    "coffee": (0.0, -0.6),
    "galaxies": (0.0, -2.1),
    "grass": (0.0, -2.2),
    "retina": (0.0, -3.1),
    "rocket": (0.0, -5.4),
    "text": (-3.0, -5.5),
    "checkerboard": (3.8, -5.3),
    "noise": (-9.2, -4.1),  # texels as large as pixels, but not on them
    "almost_uniform": (0.0, 0.0),
}


@jax.jit
def _exact(scene, region, offsets, samples):
    """MTCD of the exact scene function: `samples` points per pixel, no texture."""
    x = (region.columns().astype(float) + 0.5) * jnp.ones((SIZE, 1))
    y = (region.rows().astype(float) + 0.5) * jnp.ones((1, SIZE))

    def frame(offset):
        turn = hj.quaternion.exp(offset)

        def picture(sample):
            position = jnp.stack([x + sample[0], y + sample[1]], axis=-1)
            seen = lambda p: hj.quaternion.rotate(turn, pixel_to_ray(CAMERA, p))
            rays = jax.vmap(jax.vmap(seen))(position)
            return scene.color(CAMERA, jnp.moveaxis(rays, -1, 0))

        return encode(jnp.mean(decode(jax.lax.map(picture, samples)), axis=0))

    frames = jax.lax.map(frame, offsets)
    return hj.metrics.mtcd(jnp.moveaxis(frames, 1, -1))


def biases(scene):
    """Bias of a scene's mean MTCD, percent: of none and of SSAA(4)."""
    texture = hj.scenes.bake(scene, CAMERA, dtype=jnp.float64)
    head = hj.HeadMotion(  # a Gaussian one without resonances
        (1.12, 0.91, 0.93), (0.10, 0.124, 0.029), (0.0037, 0.0036, 0.0034)
    )
    totals = np.zeros((2, 2))
    for i in range(SESSIONS):
        key, place = jax.random.split(jax.random.fold_in(jax.random.key(7), i))
        motion = hj.Motion.of(head.sample(key, 60.0, FRAMES))
        x0, y0 = jax.random.randint(place, (2,), 0, 1024 - SIZE, jnp.int32)
        region = hj.Region(x0, y0, SIZE, SIZE)
        for j, (technique, grid) in enumerate([(NoAntialiasing(), 1), (SSAA(4), 4)]):
            baked = _baked(texture, technique, motion, region)
            samples = jnp.asarray(ordered_grid(grid))
            totals[j] += (
                float(baked),
                float(_exact(scene, region, motion.offset, samples)),
            )
    return 100 * (totals[:, 0] / totals[:, 1] - 1)


@jax.jit
def _baked(texture, technique, motion, region):
    (result,) = session(texture, CAMERA, (technique,), motion, region, region, warmup=0)
    return result.mtcd


@pytest.mark.exhaustive
def test_bias_of_the_texture_is_as_stated():
    for name, scene in hj.scenes.study_set().items():
        found = biases(scene)
        for bias, stated in zip(found, BIAS_PERCENT[name], strict=True):
            assert abs(bias) <= 1.5 * abs(stated) + 0.2, (name, found)
