"""Exact rotations and cameras, in mpmath numbers: shared with nothing they judge."""

from typing import Any

import numpy as np

from .engine import mp

Numbers = Any  # a NumPy array of mpmath numbers
SIZE_PX = 1024, 768


def multiply(left: Numbers, right: Numbers) -> Numbers:
    """Hamilton product."""
    a, b, u, v = left[0], right[0], left[1:], right[1:]
    return np.array([a * b - u.dot(v), *(v * a + u * b + np.cross(u, v))])


def rotate(q: Numbers, vector: Numbers) -> Numbers:
    """`v + 2 w (u x v) + 2 u x (u x v)`, the polynomial, of any length of q."""
    once = np.cross(q[1:], vector)
    return vector + once * (2 * q[0]) + np.cross(q[1:], once) * 2


def exp(rotation: Numbers) -> Numbers:
    """Quaternion of a rotation vector."""
    half = mp.norm(rotation) / 2
    return np.array([mp.cos(half), *(rotation * (mp.sinc(half) / 2))])


def log(q: Numbers) -> Numbers:
    """Rotation vector of a quaternion of any length, along the shorter arc."""
    q = -q if q[0] < 0 else q
    sine = mp.norm(q[1:])
    return q[1:] * (2 * mp.atan2(sine, q[0]) / sine if sine else 2 / q[0])


def relative(start: Numbers, end: Numbers) -> Numbers:
    """`start^-1 end`, along the shorter arc."""
    return multiply(conjugate(start), -end if start.dot(end) < 0 else end)


def conjugate(q: Numbers) -> Numbers:
    """Inverse of a quaternion of unit length."""
    return q * np.array([1, -1, -1, -1])


def turn(start: Numbers, end: Numbers) -> Numbers:
    """Rotation vector from one orientation to another, along the shorter arc."""
    return log(relative(start, end))


def slerp(start: Numbers, end: Numbers, fraction: Any) -> Numbers:
    """Orientation at a fraction of the shorter arc; outside `[0, 1]` it goes on."""
    return multiply(start, exp(turn(start, end) * fraction))


def rotation_change(rotation: Numbers) -> Numbers:
    """`R - I` by Rodrigues."""
    angle = mp.norm(rotation)
    cross = np.cross(rotation, np.eye(3, dtype=int)).T
    return cross * mp.sinc(angle) + cross.dot(cross) * (mp.sinc(angle / 2) ** 2 / 2)


def focal_px(fov: Any, width: int = SIZE_PX[0]) -> Any:
    """Focal length of a camera whose horizontal field of view is in degrees."""
    return width / mp.tan(fov * mp.pi / 360) / 2


def ray(fov: Any, pixel: Numbers, size: tuple[int, int] = SIZE_PX) -> Numbers:
    """Ray of a pixel position."""
    x, y = (pixel - np.array(size) / 2) / focal_px(fov, size[0])
    return np.array([x, -y, -mp.one])


def project(fov: Any, ray: Numbers, size: tuple[int, int] = SIZE_PX) -> Numbers:
    """Pixel position of a ray; NaN behind the camera."""
    depth = -ray[2] if ray[2] < 0 else mp.nan
    place = np.array([ray[0], -ray[1]]) / depth
    return place * focal_px(fov, size[0]) + np.array(size) / 2


def displacement(fov: Any, turn: Numbers, pixel: Numbers, size: Any = SIZE_PX) -> Any:
    """Where a rotated ray projects, from its pixel; 0 behind the camera."""
    after = rotate(exp(turn), ray(fov, pixel, size))
    return project(fov, after, size) - pixel if after[2] < 0 else pixel * 0
