"""The envelope's cases, as data: rotations, camera, reprojection.

Bounds are in eps where an answer keeps its digits. They count roundings: about one per
operation on the way of a value, twice as many of a gradient, with some room, since
processors differ in what they fuse.
"""

import math
from collections.abc import Callable, Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np

from .. import camera, quaternion
from ..camera import Camera, Region
from ..frames.displacement import Displacement
from . import oracles as exact
from .measuring import DTYPES, Bound, Case, Inputs
from .poses import IDENTITY, poses_of, product, unit

_Rng = np.random.Generator

ANGLES = (
    *(0.0, 5e-310, 1e-40, 1e-30, 1e-20, 1e-12, 1e-9, 1e-7, 1e-6, 1e-5, 1e-4, 3e-4),
    *(1e-3, 1e-2, 0.1, 1.0, 2.0, 3.0, math.pi - 1e-3, math.pi - 1e-6, math.pi),
)
"""Rotations, rad: none, denormals, below all squares, jitter, and to half a turn."""

FRACTIONS = (0.0, 1.0, 0.5, 1 / 3, 1e-6, 1 - 1e-6, -1.0, 2.0)


def eps(value: float | int, gradient: float | int | None = None) -> dict[str, Bound]:
    """Return the same bounds, in eps, for both dtypes."""
    return dict.fromkeys(DTYPES, Bound(value, gradient))


def _axes(rng: _Rng) -> Iterator[np.ndarray]:
    while True:
        yield from np.eye(3)
        for _ in range(6):
            yield unit(rng.normal(size=3))


def _angles(rng: _Rng, drawn: int = 30, low: float = -30.0) -> list[float]:
    spread = 10 ** rng.uniform(low, math.log10(math.pi), drawn)
    return [*(a for a in ANGLES if a == 0 or a >= 10**low), *spread.tolist()]


def _turns(rng: _Rng, dtype: np.dtype, *, most: float = math.pi) -> Iterator[Inputs]:
    for angle, axis in zip(_angles(rng), _axes(rng), strict=False):
        if angle <= most:
            yield (np.asarray(angle * axis, dtype),)


def _near_identity(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    """Quaternions of every angle, of both signs, and of lengths off 1 by up to 1 %."""
    for n, (angle, axis) in enumerate(zip(_angles(rng), _axes(rng), strict=False)):
        q = (-1) ** n * poses_of(angle * axis) * (1 + 0.01 * (n % 3 - 1))
        yield (np.asarray(q, dtype),)


def _half_turn(q: np.ndarray) -> bool:
    return abs(float(q[0])) < 1e-6


def _pairs(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    """Pairs of unit quaternions at every angle from each other, anywhere."""
    for n, (angle, axis) in enumerate(zip(_angles(rng), _axes(rng), strict=False)):
        if angle > math.pi - 1e-5:
            continue  # both ways round are equally long: see test_quaternion.py
        # From the identity small angles have all digits.
        start = IDENTITY if n % 2 else unit(rng.normal(size=4))
        start = np.asarray(start, dtype).astype(float)
        end = (-1) ** (n // 2) * product(start, poses_of(angle * axis))
        yield np.asarray(start, dtype), np.asarray(end, dtype)


def _slerps(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    for n, (start, end) in enumerate(_pairs(rng, dtype)):
        drawn = (*FRACTIONS, *rng.uniform(0, 1, 4))
        yield start, end, np.asarray(drawn[n % len(drawn)], dtype)


def _paths(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    for angle in _angles(rng, 12):
        if angle < 1:
            turns = angle * rng.normal(size=(4, 3))
            turns[0] = 0.0
            yield (np.asarray(poses_of(turns), dtype),)


def _vectors(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    for (q,) in _near_identity(rng, dtype):
        vector = rng.normal(size=3) * 10 ** rng.uniform(-6, 6)
        yield q, np.asarray(vector, dtype)


def quaternions() -> list[Case]:
    """Rotations from 1e-30 rad to half a turn."""
    full = "0, denormals, 1e-30 to pi rad"
    poses = f"{full} apart, q and -q"
    return [
        Case("quaternion.exp", full, quaternion.exp, exact.exp, _turns, eps(4, 8)),
        Case(
            "quaternion.log",
            f"{full}, q and -q, length 0.99 to 1.01",
            quaternion.log,
            exact.log,
            _near_identity,
            eps(6, 12),
            has_kink=_half_turn,
        ),
        Case(
            "quaternion.angle", full, quaternion.angle, exact.angle, _turns, eps(4, 8)
        ),
        Case(
            "quaternion.multiply",
            "anywhere",
            quaternion.multiply,
            exact.multiply,
            _pairs,
            eps(4, 1),
        ),
        Case(
            "quaternion.conjugate",
            full,
            quaternion.conjugate,
            exact.conjugate,
            _near_identity,
            eps(0, 0),
        ),
        Case(
            "quaternion.rotate",
            "vectors of 1e-6 to 1e6",
            quaternion.rotate,
            exact.rotate,
            _vectors,
            eps(8, 8),
        ),
        Case(
            "quaternion.relative",
            poses,
            quaternion.relative,
            exact.relative,
            _pairs,
            eps(4, 4),
        ),
        Case(
            "quaternion.slerp",
            f"{poses}; fraction -1 to 2",
            quaternion.slerp,
            exact.slerp,
            _slerps,
            eps(8, 24),
            slope_floor=1.0,
        ),
        Case(
            "quaternion.increments",
            "0, 1e-30 to 1 rad about the hold pose",
            quaternion.increments,
            exact.steps,
            _paths,
            eps(8, 16),
            is_slow=True,
        ),
        Case(
            "quaternion.offsets",
            "0, 1e-30 to 1 rad about the hold pose",
            quaternion.offsets,
            exact.offsets,
            _paths,
            eps(8, 16),
        ),
        Case(
            "quaternion.matrix_minus_identity",
            full,
            quaternion.matrix_minus_identity,
            exact.matrix_minus_identity,
            _turns,
            eps(6, 16),
        ),
    ]


# --- camera ---


_WIDTH, _HEIGHT = 1024, 768
_FOVS = (0.1, 1.0, 16.0, 96.0, 96.0, 150.0, 179.0, 179.9)
_PINHOLE = exact.Pinhole(_WIDTH, _HEIGHT)


def _camera(fov: Any) -> Camera:
    return Camera(_WIDTH, _HEIGHT, fov, 60.0)


def _positions(rng: _Rng) -> np.ndarray:
    edges = rng.integers(0, 3, 2) * (np.array([_WIDTH, _HEIGHT]) - 1) / 2 + 0.5
    free = rng.uniform(0, 1, 2) * [_WIDTH, _HEIGHT]
    return edges if rng.random() < 0.5 else free


def _views(rng: _Rng, dtype: np.dtype, most: float = math.pi) -> Iterator[Inputs]:
    for n, (rotation,) in enumerate(_turns(rng, dtype, most=most)):
        fov = _FOVS[n % len(_FOVS)]
        x, y = _positions(rng)
        yield tuple(np.asarray(v, dtype) for v in (fov, rotation, x, y))


def _far_views(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    """Draw views turned by 1 rad to half a turn, axes in and off the image plane."""
    angles = [*(a for a in ANGLES if a > 1), *rng.uniform(1, math.pi, 43)]
    for n, (angle, axis) in enumerate(zip(angles, _axes(rng), strict=False)):
        axis = unit(axis * [1, 1, (1, 0.03)[n // 3 % 2]])
        fov = _FOVS[n % len(_FOVS)]
        yield np.asarray(fov, dtype), np.asarray(angle * axis, dtype)


def _jitters(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    for angle, axis in zip(_angles(rng, 60, low=-7.0), _axes(rng), strict=False):
        if angle <= 0.1:
            x, y = _positions(rng)
            yield tuple(np.asarray(v, dtype) for v in (96.0, angle * axis, x, y))


def _places(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    for fov in _FOVS * 4:
        yield np.asarray(fov, dtype), np.asarray(_positions(rng), dtype)


def _rays(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    for n, fov in enumerate(_FOVS * 4):
        ray = [*rng.normal(size=2), (-1) ** (n % 5 == 4) * -(10 ** rng.uniform(-3, 3))]
        yield np.asarray(fov, dtype), np.asarray(ray, dtype)


def _grazes(fov: np.ndarray, rotation: np.ndarray, x: Any, y: Any) -> bool:
    """Whether a ray nearly turns into the image plane, and projects to infinity."""
    x, y, z = (float(v) for v in _PINHOLE.ray(fov.astype(object), float(x), float(y)))
    q = poses_of(np.asarray(rotation, float))
    depth = -float(exact.rotate(q, [x, y, z])[2])
    return depth < 1e-2 * math.sqrt(x * x + y * y + z * z)


def _moved(fov: Any, rotation: Any, x: Any, y: Any) -> Any:
    return jnp.stack(camera.displacement(_camera(fov), rotation, x, y)[:2])


def _not_grazing(inputs: Callable) -> Callable:
    def kept(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
        return (found for found in inputs(rng, dtype) if not _grazes(*found))

    return kept


def _far_homography(fov: Any, rotation: Any) -> Any:
    """With that factor by which its entries are judged where those of R cancel."""
    seen = _camera(fov)
    found = camera.homography(seen, rotation).ravel()
    return jnp.append(found, _PINHOLE.largest_factor(seen.focal_px))


def cameras() -> list[Case]:
    """Fields of view from 0.1 to 179.9 degrees."""
    views = "0.1 to 179.9 deg"
    return [
        Case(
            "camera.displacement",
            f"0, 1e-30 to pi rad, {views}, in front",
            _moved,
            _PINHOLE.displacement,
            _not_grazing(_views),
            # Near the image plane a ray's slope is 100 times what it moves.
            eps(16, 1e3),
            slope_floor=1.0,
        ),
        Case(
            "camera.displacement, px",
            "0, 1e-7 to 0.1 rad, 1024 px, 96 deg",
            _moved,
            _PINHOLE.displacement,
            _jitters,
            {"float32": Bound(1e-3, 64), "float64": Bound(1e-11, 64)},
            unit="px",
            slope_floor=1.0,
        ),
        Case(
            "camera.homography",
            f"0, 1e-30 to 1 rad, {views}",
            lambda fov, r: camera.homography(_camera(fov), r),
            _PINHOLE.homography,
            lambda rng, dtype: (found[:2] for found in _views(rng, dtype, most=1.0)),
            eps(16, 64),
            slope_floor=1.0,
            is_slow=True,
        ),
        Case(
            "camera.homography, of f + (W / 2)^2 / f",
            f"1 to pi rad, {views}",
            _far_homography,
            _PINHOLE.far_homography,
            _far_views,
            eps(16, 64),
            slope_floor=1.0,
            is_slow=True,
        ),
        Case(
            "camera.pixel_to_ray",
            views,
            lambda fov, p: camera.pixel_to_ray(_camera(fov), p),
            lambda fov, p: _PINHOLE.ray(fov, *p),
            _places,
            eps(4, 8),
            slope_floor=1.0,
        ),
        Case(
            "camera.ray_to_pixel",
            f"{views}; NaN behind",
            lambda fov, ray: camera.ray_to_pixel(_camera(fov), ray),
            _PINHOLE.project,
            _rays,
            eps(8, 16),
            slope_floor=1.0,
            has_kink=lambda fov, ray: bool(ray[2] >= 0),
        ),
        Case(
            "camera.px_per_deg",
            views,
            lambda fov, p: camera.px_per_deg(_camera(fov), p),
            _PINHOLE.px_per_deg,
            _places,
            eps(8, 16),
            slope_floor=1.0,
        ),
    ]


def _past(rotation: Any, closeness: Any) -> Any:
    small = Camera(3, 2, 96.0, 60.0)
    moved = Displacement(small, Region.whole(small), (1 - closeness) * rotation)
    return jnp.stack(moved.px())


def _exact_past(rotation: Any, closeness: Any) -> list:
    pinhole, fov = exact.Pinhole(3, 2), np.array(exact.mp.mpf(96), object)
    part = [(1 - closeness[()]) * x for x in rotation]
    half = exact.mp.mpf(1) / 2
    place = lambda n: np.array(n + half, object)
    found = [
        pinhole.displacement(fov, part, place(i), place(j))
        for j in range(2)
        for i in range(3)
    ]
    return [*(x for x, _ in found), *(y for _, y in found)]


def _pasts_of_turns(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    ends = (0.0, 1.0, 2 / 3, 1e-6)
    for n, (rotation,) in enumerate(_turns(rng, dtype, most=0.3)):
        yield rotation, np.asarray((*ends, rng.random())[n % 5], dtype)


def reprojections() -> list[Case]:
    """Kim's equation (1)."""
    return [
        Case(
            "frame.Displacement.px, (1 - d) r",
            "0, 1e-30 to 0.3 rad, d 0 to 1",
            _past,
            _exact_past,
            _pasts_of_turns,
            eps(16, 16),
            slope_floor=1.0,
        )
    ]


def cases() -> list[Case]:
    """All of them."""
    return [*quaternions(), *cameras(), *reprojections()]
