"""Derivatives of MTCD on solids: right inside surfaces, and none at visible edges."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small import quickly

import hmdjit as hj
from hmdjit.frames.displacement import Reading
from hmdjit.frames.neck import NeckModel
from hmdjit.scenes import shapes, surfaces
from hmdjit.scenes.shapes import Movement, Object, Sun
from hmdjit.scenes.solids import Solids
from hmdjit.simulation.session import session

CAMERA = hj.Camera(48, 40, fov_deg=40.0, refresh_hz=60.0)
SURFACES = {"sphere": (20, 16), "wall": (2, 28), "capsule": (38, 16)}
"""Regions of 5 x 8 px that see nothing but one surface, whatever the head does."""
PLAIN = Reading("plain")


def waves(columns=24):
    """A smooth picture: bilinear between texels, which no sample leaves by the way."""
    y, x = np.mgrid[0:columns, 0:columns] * 2 * np.pi / columns
    return 0.5 + 0.2 * np.stack([np.sin(x), np.cos(y), np.sin(x + y)], axis=-1)


@pytest.fixture(scope="module")
def scene():
    paint = surfaces.picture(waves(), 40.0)  # less than a texel is crossed
    turning = Movement((0.2, 0.05, 0.1), (0.0, 0.3, 0.1), (0.0, 0.0, -3.0))
    return Solids.of(
        [
            Object(shapes.plane((0, 0, -6), (1, 0, 0), (0, 1, 0), paint)),
            Object(shapes.sphere((0, 0, -3), 0.5, paint), turning),
            Object(shapes.capsule((1.1, -0.8, -4), (1.1, 0.8, -4), 0.4, paint)),
        ],
        sun=Sun((0.3, 0.4, 1.0)),
    )


@pytest.fixture(scope="module")
def turns():
    rng = np.random.default_rng(3)
    return jnp.asarray(np.cumsum(rng.normal(size=(5, 3)) * 3e-3, axis=0))


@functools.partial(quickly, static_argnames="order")
def flicker(scene, place, turns, fov, w_min, scale, order=0):
    """MTCD of a region, or its derivatives in the last three."""
    x0, y0 = place
    region = hj.Region(x0, y0, 5, 8)

    def mtcd(fov, w_min, scale):
        path = hj.Motion(scale * turns, scale * jnp.diff(turns, axis=0, prepend=0))
        camera = eqx.tree_at(lambda c: c.fov_deg, CAMERA, fov)
        technique = hj.techniques.HeadMovement(w_min=w_min)
        (found,) = session(
            scene,
            camera,
            (technique,),
            NeckModel().moved(path),
            region,
            region,
            warmup=1,
            reading=PLAIN,
            metrics=(hj.metrics.MTCD(),),
        )
        return found.mtcd

    numbers = fov, w_min, scale
    return jax.grad(mtcd, argnums=(0, 1, 2))(*numbers) if order else mtcd(*numbers)


def check(scene, place, turns):
    at = (40.0, 0.3, 1.0)
    slopes = flicker(scene, place, turns, *at, order=1)
    for i, step in enumerate((1e-3, 1e-4, 1e-4)):
        ahead, back = list(at), list(at)
        ahead[i], back[i] = at[i] + step, at[i] - step
        change = flicker(scene, place, turns, *ahead) - flicker(
            scene, place, turns, *back
        )
        expected = float(change) / (2 * step)
        assert abs(expected) > 1e-6
        np.testing.assert_allclose(slopes[i], expected, rtol=1e-4)
    rest = flicker(scene, place, turns, 40.0, 0.3, 0.0, order=1)
    assert np.isfinite(rest).all()


def test_derivatives_of_flicker_are_right_on_a_sphere(scene, turns):
    alone = eqx.tree_at(lambda s: s.tables, scene, scene.tables[1:2])
    check(alone, SURFACES["sphere"], turns)


@pytest.mark.slow
@pytest.mark.parametrize("surface", SURFACES)
def test_derivatives_of_flicker_are_right_inside_a_surface(scene, turns, surface):
    check(scene, SURFACES[surface], turns)
