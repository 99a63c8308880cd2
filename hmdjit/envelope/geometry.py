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

_ANY, _PAIR, _PATH = [of.rotation()], [of.two_poses()], [of.PATH]
_MOVED = [of.QUATERNION, of.VECTOR]
_scaled = partial(Row, slope_unit=own_size)


def _has_denormals(rotation: np.ndarray) -> bool:
    return bool(0 < np.max(np.abs(rotation)) < np.finfo(rotation.dtype).tiny)


def _up_to_sign(q: Any) -> list:
    """At half a turn either sign is right; elsewhere the real part is not negative."""
    largest = max(q, key=abs)
    return [*(x if largest > 0 else -x for x in q), min(q[0] + 1e-9, 0)]


_half_turn = lambda q: abs(q[0]) < 1e-6
_rebased = lambda *poses: _up_to_sign(quaternion.rebase(np.stack(poses))[1])
_exact_rebased = lambda *poses: _up_to_sign(exact.relative(*poses))
_numpy = partial(Row, unit="absolute", eager=True, quick=0)
_HALF_TURNS, _ULPS = [of.two_poses(math.pi)], {"float64": Bound(4 * math.ulp(1.0))}

QUATERNIONS = [
    Row(quaternion.exp, exact.exp, _ANY, eps(4, 8)),
    Row(quaternion.log, exact.log, [of.QUATERNION], eps(6, 12), kink=_half_turn),
    Row(quaternion.angle, exact.angle, _ANY, eps(4, 8), kink=_has_denormals),
    Row(quaternion.multiply, exact.multiply, _PAIR, eps(4, 1)),
    Row(quaternion.conjugate, exact.conjugate, [of.QUATERNION], eps(0, 0)),
    Row(quaternion.rotate, exact.rotate, _MOVED, eps(8, 8)),
    Row(quaternion.relative, exact.relative, _PAIR, eps(4, 4)),
    _scaled(quaternion.slerp, exact.slerp, [*_PAIR, of.FRACTION], eps(8, 24)),
    Row(quaternion.increments, exact.increments, _PATH, eps(8, 16), quick=0),
    Row(quaternion.offsets, exact.offsets, _PATH, eps(8, 16)),
    Row(quaternion.matrix_minus_identity, exact.rotation_change, _ANY, eps(6, 16)),
    _numpy(_rebased, _exact_rebased, _HALF_TURNS, _ULPS, name="quaternion.rebase"),
]

# --- cameras ---


def _displacement(seen: Camera, turn: Any, pixel: Any) -> Any:
    return jnp.stack(camera.displacement(seen, turn, *pixel)[:2])


def _is_in_front(fov: Any, turn: Any, pixel: Any) -> bool:
    """Whether no ray nearly turns into the image plane, and projects to infinity."""
    ray = exact.turned(float(fov), turn.astype(float), pixel.astype(float))
    return bool(-ray[2] >= 1e-2 * exact.angle(ray)[0])


def _homography(fov: Any, rotation: Any) -> list:
    """`K R K^-1`."""
    focal, (cx, cy) = exact.focal_px(fov), (mp.mpf(size) / 2 for size in exact.SIZE_PX)
    to_ray = mp.matrix([[1, 0, -cx], [0, -1, cy], [0, 0, -focal]]) / focal
    to_pixel = mp.matrix([[-focal, 0, cx], [0, focal, cy], [0, 0, 1]])
    change = mp.matrix(np.reshape(exact.rotation_change(rotation), (3, 3)).tolist())
    return list(to_pixel * (change + mp.eye(3)) * to_ray)


def _largest_factor(focal: Any) -> Any:
    """By what K and K^-1 multiply R: f, or (W / 2)^2 / f of wide views.

    By it entries of K R K^-1 are judged where those of R cancel.
    """
    return focal + (exact.SIZE_PX[0] / 2) ** 2 / focal


def _far(seen: Camera, turn: Any) -> Any:
    found = camera.homography(seen, turn).ravel()
    return jnp.append(found, _largest_factor(seen.focal_px))


def _exact_far(fov: Any, turn: Any) -> list:
    return [*_homography(fov, turn), _largest_factor(exact.focal_px(fov))]


def _px_per_deg(fov: Any, pixel: Any) -> list:
    """Speed of the picture when the head turns or nods."""
    x, y, _ = exact.ray(fov, pixel)
    scale, both = exact.focal_px(fov) * mp.pi / 180, (x * y) ** 2
    return [scale * mp.sqrt((1 + part**2) ** 2 + both) for part in (x, y)]


def _own_or_to_180(arguments: Inputs, index: int) -> float:
    """Return the unit of slopes, which a roll cancels: of wide views f goes to 0."""
    size = own_size(arguments, index)
    return size if index else min(size, 180.0 - size)


def _row(name: str, function: Callable, *given: Any, **options: Any) -> Row:
    of_fov = lambda fov, *at: function(Camera(*exact.SIZE_PX, fov, 60.0), *at)
    options = {"slope_unit": own_size, **options}
    return Row(of_fov, *given, name=f"camera.{name}", **options)


_behind = lambda fov, ray: bool(ray[2] >= 0)
_homographies = partial(_row, quick=0)
_TURNED, _FAR = [of.FOV, of.rotation(most=1.0)], [of.FOV, of.rotation(1.0)]
_ANYWHERE, _WHERE = [of.FOV, of.rotation(), of.PIXEL], [of.FOV, of.PIXEL]
_SMALL = [of.uniform("1024 px, 96 deg", 96.0), of.rotation(1e-7, 0.1), of.PIXEL]
_ABOUT = eps(16, 1e3)  # near the image plane a ray's slope is 100 times what it moves
_PX = {"float32": Bound(1e-3, 64), "float64": Bound(1e-11, 64)}
_MOST: Any = {"kept": _is_in_front, "count": 120}
_ROLL: Any = {"slope_unit": _own_or_to_180}
_RAYS, _BY_FACTOR = [of.FOV, of.RAY], "homography, of f + (W / 2)^2 / f"

CAMERAS = [
    _row("displacement", _displacement, exact.displacement, _ANYWHERE, _ABOUT, **_MOST),
    _row("displacement, px", _displacement, exact.displacement, _SMALL, _PX, "px"),
    _homographies(
        "homography", camera.homography, _homography, _TURNED, eps(16, 64), **_ROLL
    ),
    _homographies(_BY_FACTOR, _far, _exact_far, _FAR, eps(16, 64)),
    _row("pixel_to_ray", camera.pixel_to_ray, exact.ray, _WHERE, eps(4, 8)),
    _row(
        "ray_to_pixel",
        camera.ray_to_pixel,
        exact.project,
        _RAYS,
        eps(8, 16),
        kink=_behind,
    ),
    _row("px_per_deg", camera.px_per_deg, _px_per_deg, _WHERE, eps(8, 16)),
]

# --- Kim et al.'s equation (1) ---


def _past(turn: Any, closeness: Any) -> Any:
    small = Camera(3, 2, 96.0, 60.0)
    moved = Displacement(small, Region.whole(small), (1 - closeness) * turn)
    return jnp.stack(moved.px())


def _exact_past(turn: Any, closeness: Any) -> list:
    pixels = [(i + mp.mpf(0.5), j + mp.mpf(0.5)) for j, i in np.ndindex(2, 3)]
    part, fov = [(1 - closeness) * x for x in turn], mp.mpf(96)
    moved = [exact.displacement(fov, part, pixel, (3, 2)) for pixel in pixels]
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
    return exact.displacement(mp.mpf(96), turn, place, (1024, 1024))


def _eager(dtype: str, bound: float) -> Row:
    function, name = (
        partial(_past_of_poses, dtype),
        f"reprojection.past_position, {dtype}",
    )
    arguments, bounds = [of.HOLD_AND_TURN, of.PLACE], {dtype: Bound(bound)}
    kept: Any = {"eager": True, "count": 240}
    return Row(function, _exact_past_of_poses, arguments, bounds, "px", name, **kept)


_CLOSE = [of.rotation(most=0.3), of.CLOSENESS]
_PART = "frames.displacement.Displacement.px, (1 - d) r"

PASTS = [
    _scaled(_past, _exact_past, _CLOSE, eps(16, 16), name=_PART),
    # What is asked for; 2.6e-5 px is found in float32.
    _eager("float32", 1e-3),
    _eager("float64", 1e-11),
]
