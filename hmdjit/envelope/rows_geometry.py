"""The envelope's rows of rotations, cameras, and where the past is.

Bounds are in eps where an answer keeps its digits. They count roundings: about one per
operation on the way of a value, twice as many of a gradient, with some room, since
processors differ in what they fuse.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .. import camera, quaternion
from ..camera import Camera, Region
from ..frames.displacement import Displacement
from ..frames.frame import Frame
from ..frames.motion import rebased_motion
from ..reprojection import past_position
from . import arguments as of
from . import exact_geometry as exact
from .row import Bound, Inputs, Row, eps, mp, own_size

_PINHOLE, _SMALL = exact.Pinhole(of.WIDTH, of.HEIGHT), exact.Pinhole(3, 2)
_ANY, _PAIR, _PATH = [of.rotation()], [of.two_poses()], [of.PATH]
_scaled = partial(Row, slope_unit=own_size)


def _half_turn(q: np.ndarray) -> bool:
    return abs(float(q[0])) < 1e-6


def _has_denormals(rotation: np.ndarray) -> bool:
    return bool(0 < np.max(np.abs(rotation)) < np.finfo(rotation.dtype).tiny)


def _up_to_sign(q: Any) -> list:
    """At half a turn either sign is right; elsewhere the real part is not negative."""
    largest = max(q, key=abs)
    return [*(x if largest > 0 else -x for x in q), min(q[0] + 1e-9, 0)]


def _rebased(*poses: np.ndarray) -> list:
    return _up_to_sign(quaternion.rebase(np.stack(poses))[1])


def _exact_rebased(*poses: Any) -> list:
    return _up_to_sign(exact.relative(*poses))


_numpy = partial(Row, unit="absolute", eager=True, quick=0)

QUATERNIONS = [
    Row(quaternion.exp, exact.exp, _ANY, eps(4, 8)),
    Row(quaternion.log, exact.log, [of.QUATERNION], eps(6, 12), kink=_half_turn),
    Row(quaternion.angle, exact.angle, _ANY, eps(4, 8), kink=_has_denormals),
    Row(quaternion.multiply, exact.multiply, _PAIR, eps(4, 1)),
    Row(quaternion.conjugate, exact.conjugate, [of.QUATERNION], eps(0, 0)),
    Row(quaternion.rotate, exact.rotate, [of.QUATERNION, of.VECTOR], eps(8, 8)),
    Row(quaternion.relative, exact.relative, _PAIR, eps(4, 4)),
    _scaled(quaternion.slerp, exact.slerp, [*_PAIR, of.FRACTION], eps(8, 24)),
    Row(quaternion.increments, exact.increments, _PATH, eps(8, 16), quick=0),
    Row(quaternion.offsets, exact.offsets, _PATH, eps(8, 16)),
    Row(quaternion.matrix_minus_identity, exact.rotation_change, _ANY, eps(6, 16)),
    _numpy(
        _rebased,
        _exact_rebased,
        [of.two_poses(math.pi)],
        {"float64": Bound(4 * math.ulp(1.0))},
        name="quaternion.rebase",
    ),
]

# --- cameras ---


def _displacement(seen: Camera, turn: Any, pixel: Any) -> Any:
    return jnp.stack(camera.displacement(seen, turn, *pixel)[:2])


def _far_homography(seen: Camera, turn: Any) -> Any:
    """With that factor by which its entries are judged where those of R cancel."""
    found = camera.homography(seen, turn).ravel()
    return jnp.append(found, _PINHOLE.largest_factor(seen.focal_px))


def _is_in_front(fov: Any, turn: Any, pixel: Any) -> bool:
    """Whether no ray nearly turns into the image plane, and projects to infinity."""
    ray = _PINHOLE.turned(float(fov), turn.astype(float), pixel.astype(float))
    return bool(-ray[2] >= 1e-2 * exact.angle(ray)[0])


def _own_or_to_180(arguments: Inputs, index: int) -> float:
    """Return the unit of slopes, which a roll cancels: of wide views f goes to 0."""
    size = own_size(arguments, index)
    return size if index else min(size, 180.0 - size)


def _row(name: str, function: Callable, *given: Any, **options: Any) -> Row:
    of_fov = lambda fov, *at: function(Camera(of.WIDTH, of.HEIGHT, fov, 60.0), *at)
    options = {"slope_unit": own_size, **options}
    return Row(of_fov, *given, name=f"camera.{name}", **options)


_TURNED, _SMALL_TURNS = [of.FOV, of.rotation(most=1.0)], of.rotation(1e-7, 0.1)
_FAR, _WHERE = [of.FOV, of.rotation(1.0)], [of.FOV, of.PIXEL]
_ABOUT = eps(16, 1e3)  # near the image plane a ray's slope is 100 times what it moves
_PX = {"float32": Bound(1e-3, 64), "float64": Bound(1e-11, 64)}

CAMERAS = [
    _row(
        "displacement",
        _displacement,
        _PINHOLE.displacement,
        [of.FOV, of.rotation(), of.PIXEL],
        _ABOUT,
        kept=_is_in_front,
        count=120,
    ),
    _row(
        "displacement, px",
        _displacement,
        _PINHOLE.displacement,
        [of.uniform("1024 px, 96 deg", 96.0), _SMALL_TURNS, of.PIXEL],
        _PX,
        "px",
    ),
    _row(
        "homography",
        camera.homography,
        _PINHOLE.homography,
        _TURNED,
        eps(16, 64),
        slope_unit=_own_or_to_180,
        quick=0,
    ),
    _row(
        "homography, of f + (W / 2)^2 / f",
        _far_homography,
        _PINHOLE.far_homography,
        _FAR,
        eps(16, 64),
        quick=0,
    ),
    _row("pixel_to_ray", camera.pixel_to_ray, _PINHOLE.ray, _WHERE, eps(4, 8)),
    _row(
        "ray_to_pixel",
        camera.ray_to_pixel,
        _PINHOLE.project,
        [of.FOV, of.RAY],
        eps(8, 16),
        kink=lambda fov, ray: bool(ray[2] >= 0),
    ),
    _row("px_per_deg", camera.px_per_deg, _PINHOLE.px_per_deg, _WHERE, eps(8, 16)),
]

# --- Kim et al.'s equation (1) ---


def _past(turn: Any, closeness: Any) -> Any:
    small = Camera(3, 2, 96.0, 60.0)
    moved = Displacement(small, Region.whole(small), (1 - closeness) * turn)
    return jnp.stack(moved.px())


def _exact_past(turn: Any, closeness: Any) -> list:
    pixels = [(i + mp.mpf(0.5), j + mp.mpf(0.5)) for j, i in np.ndindex(2, 3)]
    part = [(1 - closeness) * x for x in turn]
    moved = [_SMALL.displacement(mp.mpf(96), part, pixel) for pixel in pixels]
    return [x for axis in zip(*moved, strict=True) for x in axis]


@jax.jit
def _past_px(increment: Any, x0: Any, y0: Any) -> Any:
    empty = jnp.zeros((1, 3, 1, 1), increment.dtype)
    frame = Frame(empty, Camera(1024, 1024, 96.0, 60.0), Region(x0, y0, 1, 1))
    return jnp.stack(past_position(frame, increment, 0.0).px())


def _past_of_poses(dtype: str, poses: np.ndarray, pixel: np.ndarray) -> Any:
    increment = rebased_motion(poses, dtype).increment[2]
    return _past_px(increment, *(jnp.int32(x) for x in pixel))


def _exact_past_of_poses(poses: Any, pixel: Any) -> list:
    turn, place = exact.log(exact.relative(*poses[1:])), pixel + mp.mpf(0.5)
    return exact.Pinhole(1024, 1024).displacement(mp.mpf(96), turn, place)


PASTS = [
    _scaled(
        _past,
        _exact_past,
        [of.rotation(most=0.3), of.CLOSENESS],
        eps(16, 16),
        name="frames.displacement.Displacement.px, (1 - d) r",
    ),
    *(
        Row(
            partial(_past_of_poses, dtype),
            _exact_past_of_poses,
            [of.HOLD_AND_TURN, of.PLACE],
            {dtype: Bound(bound)},
            "px",
            f"reprojection.past_position, {dtype}",
            eager=True,
            count=240,
        )
        # What is asked for; 2.6e-5 px is found in float32.
        for dtype, bound in (("float32", 1e-3), ("float64", 1e-11))
    ),
]
