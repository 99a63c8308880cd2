"""One small display, picture, path and study that tests share, so that programs repeat.

What is compiled depends on shapes and choices. A test that needs no size of its own
takes these, and finds its program in their folder if another has compiled it.
"""

import functools

import jax
import numpy as np
import viewing

import hmdjit as hj
from hmdjit.studies.measured_blocks import Tiles

# Optimising a program takes longer than all the rest of a test.
quickly = functools.partial(
    jax.jit, compiler_options={"xla_backend_optimization_level": "1"}
)

WIDTH, HEIGHT, FRAMES = 24, 18, 8
SIZE = (HEIGHT, WIDTH, 3)
# 917 px per rad: people who sit still move the picture by some 0.3 px per frame.
CAMERA = hj.Camera(width_px=WIDTH, height_px=HEIGHT, fov_deg=1.5, refresh_hz=60.0)
MARGIN_PX = 16
WARMUP = 3
STILL = np.tile([1.0, 0.0, 0.0, 0.0], (FRAMES, 1))

CAMERA_8_PX_PER_DEG = hj.Camera(64, 64, fov_deg=8.0, refresh_hz=60.0)  # a study's
NOISE = hj.scenes.power_law_noise(size=256, texels_per_deg=8.0)


def texture(rng, camera=CAMERA, margin_px=MARGIN_PX, **options):
    """Smooth noise; see `viewing.noise_texture`."""
    return viewing.noise_texture(rng, camera, margin_px, **options)


def path(rng, frames=FRAMES, rms_px=0.4, camera=CAMERA):
    """Poses of a head whose picture moves by about `rms_px` per frame and axis."""
    return viewing.path(rng, camera, frames, rms_px)


def study(**changes):
    """Twelve sessions of two techniques on one scene."""
    settings = {
        "scenes": {"noise": NOISE},
        "techniques": [hj.techniques.NoAntialiasing(), hj.techniques.HeadMovement()],
        "baseline": "none",
        "head": hj.HeadMotion.seated(),
        "camera": CAMERA_8_PX_PER_DEG,
        "sessions": 12,
        "frames": 4,
        "warmup": WARMUP,
        "measure": Tiles(1, 16),
        "oversampling": 1,
        "margin_deg": 4.0,
    }
    return hj.Study(**(settings | changes))


def solids(**changes):
    """Put up a striped wall behind a striped plate that flies by: one kind of all."""
    from hmdjit.scenes import shapes, surfaces
    from hmdjit.scenes.solids import Solids

    dark = (0.1, 0.2, 0.1)
    wall = surfaces.stripes((1.0, 1.0, 1.0), dark, 0.011, 0.013)
    plate = surfaces.stripes((0.9, 0.3, 0.2), dark, 0.006, 0.004)
    settings = {
        "wall": shapes.rectangle(
            (0.0, 0.0, -2.0), (4.0, 0.4, 0.0), (-0.4, 4.0, 0.0), wall
        ),
        "plate": shapes.rectangle(
            (-0.02, 0.0, -1.0), (0.05, 0.0, 0.02), (0.0, 0.04, 0.0), plate
        ),
        "movement": shapes.Movement(velocity_m_s=(0.35, 0.1, 0.0)),
    } | changes
    plate = shapes.Object(settings["plate"], settings["movement"])
    return Solids.of([shapes.Object(settings["wall"]), plate], sun=None)
