"""Exact rotations and cameras in many digits, written as the textbook has them.

Arguments are mpmath numbers and arrays of them, answers are flat lists. Nothing here is
shared with what it is held against, and digits that cancel are fewer than there are.
"""

import itertools
from typing import Any

import numpy as np

from .row import mp

Numbers = Any  # an array of mpmath numbers, or a list of them
SIZE_PX = 1024, 768


def dot(a: Numbers, b: Numbers) -> Any:
    """Scalar product."""
    return mp.fsum(x * y for x, y in zip(a, b, strict=True))


def multiply(left: Numbers, right: Numbers) -> list:
    """Hamilton product."""
    a, b, c, d = left
    e, f, g, h = right
    return [
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    ]


def conjugate(q: Numbers) -> list:
    """Inverse of a unit quaternion."""
    return [q[0], *(-x for x in q[1:])]


def rotate(q: Numbers, vector: Numbers) -> list:
    """`v + 2 w (u x v) + 2 u x (u x v)`, the polynomial, of any length of q."""
    cross = lambda a, b: np.array(multiply([0, *a], [0, *b])[1:])
    once = cross(q[1:], vector)
    return list(vector + 2 * q[0] * once + 2 * cross(q[1:], once))


def exp(rotation: Numbers) -> list:
    """Quaternion of a rotation vector."""
    (length,) = angle(rotation)
    share = mp.sin(length / 2) / length if length else mp.mpf(1) / 2
    return [mp.cos(length / 2), *(share * x for x in rotation)]


def log(q: Numbers) -> list:
    """Rotation vector of a quaternion of any length, along the shorter arc."""
    q = [-x for x in q] if q[0] < 0 else list(q)
    (sine,) = angle(q[1:])
    share = 2 * mp.atan2(sine, q[0]) / sine if sine else 2 / q[0]
    return [share * x for x in q[1:]]


def angle(rotation: Numbers) -> list:
    """Length."""
    return [mp.sqrt(dot(rotation, rotation))]


def relative(start: Numbers, end: Numbers) -> list:
    """`start^-1 end`, along the shorter arc."""
    sign = -1 if dot(start, end) < 0 else 1
    return multiply(conjugate(start), [sign * x for x in end])


def slerp(start: Numbers, end: Numbers, fraction: Any) -> list:
    """`start exp(fraction log(start^-1 end))`."""
    turn = log(relative(start, end))
    return multiply(start, exp([fraction * x for x in turn]))


def increments(poses: Numbers) -> list:
    """Increments of poses, the first 0, row by row."""
    turns = [log(relative(a, b)) for a, b in itertools.pairwise(poses)]
    return [mp.mpf(0)] * 3 + [x for turn in turns for x in turn]


def offsets(poses: Numbers) -> list:
    """Rotations from the first pose, row by row."""
    return [x for pose in poses for x in log(relative(poses[0], pose))]


def rotation_change(rotation: Numbers) -> list:
    """`R - I` by Rodrigues, row by row."""
    x, y, z = rotation
    (a,) = angle(rotation)
    first = mp.sin(a) / a if a else mp.mpf(1)
    second = (1 - mp.cos(a)) / a**2 if a else mp.mpf(1) / 2
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], object)
    return list((first * cross + second * cross.dot(cross)).ravel())


def focal_px(fov: Any, width: Any = SIZE_PX[0]) -> Any:
    """Focal length of a camera; its field of view in degrees."""
    return mp.mpf(width) / 2 / mp.tan(fov * mp.pi / 360)


def ray(fov: Any, pixel: Numbers, size: tuple[int, int] = SIZE_PX) -> list:
    """Ray of a pixel position."""
    (x, y), (width, height), focal = pixel, size, focal_px(fov, size[0])
    return [(x - mp.mpf(width) / 2) / focal, (mp.mpf(height) / 2 - y) / focal, -mp.one]


def project(fov: Any, ray: Numbers, size: tuple[int, int] = SIZE_PX) -> list:
    """Pixel position of a ray; NaN behind the camera."""
    if not ray[2] < 0:
        return [mp.nan, mp.nan]
    scale, (width, height) = focal_px(fov, size[0]) / -ray[2], size
    return [mp.mpf(width) / 2 + ray[0] * scale, mp.mpf(height) / 2 - ray[1] * scale]


def turned(fov: Any, rotation: Numbers, pixel: Numbers, size: Any = SIZE_PX) -> Numbers:
    """Ray of a pixel position, rotated."""
    change, before = rotation_change(rotation), ray(fov, pixel, size)
    return np.reshape(change, (3, 3)).dot(before) + before


def displacement(fov: Any, turn: Numbers, pixel: Numbers, size: Any = SIZE_PX) -> list:
    """Where a rotated ray projects, from its pixel; 0 behind the camera."""
    after = turned(fov, turn, pixel, size)
    if not after[2] < 0:
        return [mp.mpf(0), mp.mpf(0)]
    place = project(fov, after, size)
    return [a - b for a, b in zip(place, pixel, strict=True)]
