"""Exact rotations and cameras in many digits, written as the textbook has them.

Arguments are mpmath numbers and arrays of them, answers are flat lists. Nothing here is
shared with what it is held against, and digits that cancel are fewer than there are.
"""

import itertools
from typing import Any

import numpy as np

from .row import mp

Numbers = Any  # an array of mpmath numbers, or a list of them


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


class Pinhole:
    """Camera of whole pixels; its field of view, degrees, is an argument."""

    def __init__(self, width: int, height: int):
        self.width = width
        self.centre = mp.mpf(width) / 2, mp.mpf(height) / 2

    def focal(self, fov: Any) -> Any:
        """Focal length, px."""
        return self.centre[0] / mp.tan(fov * mp.pi / 360)

    def ray(self, fov: Any, pixel: Numbers) -> list:
        """Ray of a pixel position."""
        (x, y), (cx, cy), focal = pixel, self.centre, self.focal(fov)
        return [(x - cx) / focal, (cy - y) / focal, mp.mpf(-1)]

    def project(self, fov: Any, ray: Numbers) -> list:
        """Pixel position of a ray; NaN behind the camera."""
        if not ray[2] < 0:
            return [mp.nan, mp.nan]
        scale = self.focal(fov) / -ray[2]
        return [self.centre[0] + ray[0] * scale, self.centre[1] - ray[1] * scale]

    def turned(self, fov: Any, rotation: Numbers, pixel: Numbers) -> Numbers:
        """Ray of a pixel position, rotated."""
        rows = np.reshape(rotation_change(rotation), (3, 3))
        return rows.dot(self.ray(fov, pixel)) + self.ray(fov, pixel)

    def displacement(self, fov: Any, rotation: Numbers, pixel: Numbers) -> list:
        """Where a rotated ray projects, from its pixel; 0 behind the camera."""
        ray = self.turned(fov, rotation, pixel)
        if not ray[2] < 0:
            return [mp.mpf(0), mp.mpf(0)]
        return [a - b for a, b in zip(self.project(fov, ray), pixel, strict=True)]

    def homography(self, fov: Any, rotation: Numbers) -> list:
        """`K R K^-1`."""
        focal, (cx, cy) = self.focal(fov), self.centre
        to_ray = mp.matrix([[1, 0, -cx], [0, -1, cy], [0, 0, -focal]]) / focal
        to_pixel = mp.matrix([[-focal, 0, cx], [0, focal, cy], [0, 0, 1]])
        change = mp.matrix(np.reshape(rotation_change(rotation), (3, 3)).tolist())
        return list(to_pixel * (change + mp.eye(3)) * to_ray)

    def largest_factor(self, focal: Any) -> Any:
        """By what K and K^-1 multiply R: f, or (W / 2)^2 / f of wide views."""
        return focal + (self.width / 2) ** 2 / focal

    def far_homography(self, fov: Any, rotation: Numbers) -> list:
        """`K R K^-1`, and that factor."""
        factor = self.largest_factor(self.focal(fov))
        return [*self.homography(fov, rotation), factor]

    def px_per_deg(self, fov: Any, pixel: Numbers) -> list:
        """Speed of the picture when the head turns or nods."""
        x, y, _ = self.ray(fov, pixel)
        scale, both = self.focal(fov) * mp.pi / 180, (x * y) ** 2
        return [scale * mp.sqrt((1 + part**2) ** 2 + both) for part in (x, y)]
