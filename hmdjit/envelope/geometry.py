"""The envelope's rows of rotations, cameras, and where the past is.

Bounds in eps count roundings: about one per operation on the way of a value, twice as
many of a gradient, with some room, since processors differ in what they fuse.
"""

import math
from collections.abc import Callable
from functools import partial, wraps
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .. import camera, quaternion
from ..camera import Camera, Region
from ..frames.frame import Frame
from ..frames.motion import rebased_motion
from ..reprojection import past_position
from . import arguments as of
from . import exact_geometry as exact
from .engine import Argument, Bound, Rng, Row, eps, in_numpy, mp, own_size, scaled


@partial(Argument, "any angle, q and -q, length 0.99 to 1.01")
def _quaternion(rng: Rng, dtype: np.dtype, n: int) -> np.ndarray:
    length = (-1) ** n * (1 + 0.01 * (n % 3 - 1))
    return length * of.turned([1, 0, 0, 0], of.rotation().draw(rng, dtype, n))


@partial(Argument, "")
def _pixel(rng: Rng, dtype: np.dtype, n: int) -> np.ndarray:
    edges, size = rng.integers(0, 3, 2) / 2, np.array(exact.SIZE_PX)
    return edges * (size - 1) + 0.5 if n % 2 else rng.uniform(0, 1, 2) * size


@partial(Argument, "depth 1e-3 to 1e3, NaN behind")
def _ray(rng: Rng, dtype: np.dtype, n: int) -> np.ndarray:
    depth = (-1) ** (n % 5 == 4) * -(10 ** rng.uniform(-3, 3))
    return np.array([*rng.normal(size=2), depth])


_FOV = of.numbers("0.1 to 179.9 deg", 0.1, 1.0, 16.0, 96.0, 96.0, 150.0, 179.0, 179.9)


def _up_to_sign(q: Any) -> list:
    """At half a turn either sign is right; elsewhere the real part is not negative."""
    largest = max(q, key=abs)
    return [*(x if largest > 0 else -x for x in q), min(q[0] + 1e-9, 0)]


_rebased = lambda *poses: _up_to_sign(quaternion.rebase(np.stack(poses))[1])
_exact_rebased = lambda *poses: _up_to_sign(exact.relative(*poses))
_increments = lambda q: np.stack([exact.turn(*q[[max(n - 1, 0), n]]) for n in range(4)])
_offsets = lambda poses: np.stack([exact.turn(poses[0], pose) for pose in poses])
_half_turn = lambda q: abs(q[0]) < 1e-6
_has_denormals = lambda r: 0 < np.max(np.abs(r)) < np.finfo(r.dtype).tiny
_ROTATION = [of.rotation()]
_apart = partial(of.poses, "0, denormals, 1e-30 to pi rad apart, q and -q")
_PAIR = [of.apart(_apart(of.rotation(most=math.pi - 1e-5)))]
_ANY_PAIR, _ULPS = [of.apart(_apart(of.rotation()))], {"float64": Bound(2.0**-50)}
_NEAR = "0, denormals, 1e-30 to 1 rad, from the hold pose"
_PATH = [of.poses(_NEAR, *[of.rotation(most=1.0)] * 3, is_anywhere=False)]
_VECTOR = of.vectors(of.logarithmic("vectors of 1e-6 to 1e6", within=(1e-6, 1e6)))


def _row(function: Callable, *given: Any, **options: Any) -> Row:
    at = lambda fov, *others: function(Camera(*exact.SIZE_PX, fov, 60.0), *others)
    return scaled(wraps(function)(at), *given, **options)


def _is_in_front(*given: Any) -> bool:
    """Whether no ray nearly turns into the image plane, and projects to infinity."""
    fov, turn, pixel = (x.astype(float) for x in given)
    ray = exact.rotate(exact.exp(turn), exact.ray(fov, pixel))
    return -ray[2] >= 1e-2 * mp.norm(ray)


def _homography(fov: Any, rotation: Any) -> Any:
    """`K R K^-1`, of pixels of rays that lie at -1."""
    focal, (cx, cy) = exact.focal_px(fov), (size / 2 for size in exact.SIZE_PX)
    to_pixel = mp.matrix([[-focal, 0, cx], [0, focal, cy], [0, 0, 1]])
    turn = mp.eye(3) + mp.matrix(exact.rotation_change(rotation).tolist())
    return [*(to_pixel * turn * -(to_pixel**-1))]


def _px_per_deg(fov: Any, pixel: Any) -> list:
    x, y, _ = exact.ray(fov, pixel)
    scale, both = exact.focal_px(fov) * mp.pi / 180, (x * y) ** 2
    return [scale * mp.sqrt((1 + part**2) ** 2 + both) for part in (x, y)]


_focal = lambda fov: float(exact.focal_px(float(fov)))
# By what K and K^-1 multiply entries of R that cancel: f, or (W / 2)^2 / f.
_factor = lambda fov, turn: _focal(fov) + (exact.SIZE_PX[0] / 2) ** 2 / _focal(fov)
# The unit of slopes, which a roll cancels: wide views' f goes to 0; turns are small.
_own_or_to_180 = lambda *at: min(own_size(*at), 180.0 - own_size(*at))
_behind = lambda fov, ray: ray[2] >= 0
_stacked = lambda *at: jnp.stack(camera.displacement(*at[:2], *at[2])[:2])
_moved = partial(_row, _stacked, exact.displacement)
_matrix = partial(_row, camera.homography, _homography, slope_unit=_own_or_to_180)
_SMALL = [of.numbers("1024 px, 96 deg", 96.0), of.rotation(1e-7, 0.1), _pixel]
_PX = {"float32": Bound(1e-3, 64), "float64": Bound(1e-11, 64)}
_MOVED, _BY_FACTOR = "camera.displacement", "camera.homography, of f + (W / 2)^2 / f"
_JUDGED: Any = {"name": _BY_FACTOR, "floor": _factor, "quick": 0}
_FRONT: Any = {"name": _MOVED, "kept": _is_in_front, "count": 120}


def _px(display: Any, region: Any, turn: Any, closeness: Any) -> Any:
    empty = jnp.zeros((1, 3, region.height, region.width), turn.dtype)
    return jnp.stack(past_position(Frame(empty, display, region), turn, closeness).px())


def _exact_past(turn: Any, closeness: Any) -> Any:
    pixels = np.array([[i + 0.5, j + 0.5] for j, i in np.ndindex(2, 3)])
    moved = partial(exact.displacement, mp.mpf(96), turn * (1 - closeness))
    return np.stack([moved(pixel, (3, 2)) for pixel in pixels]).T


def _of_poses(dtype: str, bound: float, quick: int = 0) -> Row:
    display = Camera(1024, 1024, 96.0, 60.0)
    px = jax.jit(lambda turn, x0, y0: _px(display, Region(x0, y0, 1, 1), turn, 0.0))
    increment = lambda poses: rebased_motion(poses, dtype).increment[2]
    function = lambda poses, pixel: px(increment(poses), *pixel.astype(np.int32))
    oracle = lambda poses, pixel: exact.displacement(
        mp.mpf(96), exact.turn(*poses[1:]), pixel + 0.5, (1024, 1024)
    )
    name = f"reprojection.past_position, {dtype}"
    given = oracle, _DRAWN, {dtype: Bound(bound)}, "px"
    return Row(function, *given, name, eager=True, count=240, quick=quick)


_past = partial(_px, Camera(3, 2, 96.0, 60.0), Region(0, 0, 3, 2))
_WORDS = "1e-7 to 0.1 rad per frame, any hold pose, up to 0.35 rad off it"
_PLACE = Argument("1024 px, 96 deg", lambda rng, *_: rng.choice([0, 100, 511, 1023], 2))
_DRAWN = [of.poses(_WORDS, of.rotation(0.01, 0.35), of.rotation(1e-7, 0.1)), _PLACE]
_CLOSE, _PART = [of.rotation(most=0.3), of.SHARE], "frames.displacement.Displacement.px"

ROWS = [
    Row(quaternion.exp, exact.exp, _ROTATION, eps(4, 8)),
    Row(quaternion.log, exact.log, [_quaternion], eps(6, 12), kink=_half_turn),
    Row(quaternion.angle, mp.norm, _ROTATION, eps(4, 8), kink=_has_denormals),
    Row(quaternion.multiply, exact.multiply, _PAIR, eps(4, 1)),
    Row(quaternion.conjugate, exact.conjugate, [_quaternion], eps(0, 0)),
    Row(quaternion.rotate, exact.rotate, [_quaternion, _VECTOR], eps(8, 8)),
    Row(quaternion.relative, exact.relative, _PAIR, eps(4, 4)),
    scaled(quaternion.slerp, exact.slerp, [*_PAIR, of.FRACTION], eps(8, 24)),
    Row(quaternion.increments, _increments, _PATH, eps(8, 16), quick=0),
    Row(quaternion.offsets, _offsets, _PATH, eps(8, 16)),
    Row(quaternion.matrix_minus_identity, exact.rotation_change, _ROTATION, eps(6, 16)),
    in_numpy(
        _rebased, _exact_rebased, _ANY_PAIR, _ULPS, "absolute", "quaternion.rebase"
    ),
    # Near the image plane a ray's slope is 100 times what it moves.
    _moved([_FOV, of.rotation(), _pixel], eps(16, 1e3), **_FRONT),
    _moved(_SMALL, _PX, "px", f"{_MOVED}, px"),
    _matrix([_FOV, of.rotation(most=1.0)], eps(16, 64), quick=0),
    _matrix([_FOV, of.rotation(1.0)], eps(16, 64), **_JUDGED),
    _row(camera.pixel_to_ray, exact.ray, [_FOV, _pixel], eps(4, 8)),
    _row(camera.ray_to_pixel, exact.project, [_FOV, _ray], eps(8, 16), kink=_behind),
    _row(camera.px_per_deg, _px_per_deg, [_FOV, _pixel], eps(8, 16)),
    scaled(_past, _exact_past, _CLOSE, eps(16, 16), name=f"{_PART}, (1 - d) r"),
    # What is asked for; 2.6e-5 px is found in float32.
    _of_poses("float32", 1e-3, quick=24),
    _of_poses("float64", 1e-11),
]
