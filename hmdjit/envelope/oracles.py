"""Exact answers in many digits, written as the textbook has them.

Arguments are arrays of mpmath numbers, answers are flat lists. Nothing here is shared
with what it is held against, and digits that cancel are many fewer than there are.
"""

import itertools
from typing import Any

import numpy as np
from mpmath import mp as _context

mp: Any = _context  # its types know too little
Numbers = Any  # an array of mpmath numbers, or a list of them


def _dot(a: Numbers, b: Numbers) -> Any:
    return mp.fsum(x * y for x, y in zip(a, b, strict=True))


# --- quaternions ---


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
    w, x, y, z = q
    a, b, c = vector
    p, r, s = y * c - z * b, z * a - x * c, x * b - y * a
    twice = [y * s - z * r, z * p - x * s, x * r - y * p]
    return [
        v + 2 * w * one + 2 * two
        for v, one, two in zip(vector, (p, r, s), twice, strict=True)
    ]


def exp(rotation: Numbers) -> list:
    """Quaternion of a rotation vector."""
    angle = mp.sqrt(_dot(rotation, rotation))
    share = mp.sin(angle / 2) / angle if angle else mp.mpf(1) / 2
    return [mp.cos(angle / 2), *(share * x for x in rotation)]


def log(q: Numbers) -> list:
    """Rotation vector of a quaternion of any length, along the shorter arc."""
    q = [-x for x in q] if q[0] < 0 else list(q)
    sine = mp.sqrt(_dot(q[1:], q[1:]))
    share = 2 * mp.atan2(sine, q[0]) / sine if sine else 2 / q[0]
    return [share * x for x in q[1:]]


def angle(rotation: Numbers) -> list:
    """Length."""
    return [mp.sqrt(_dot(rotation, rotation))]


def relative(start: Numbers, end: Numbers) -> list:
    """`start^-1 end`, along the shorter arc."""
    sign = -1 if _dot(start, end) < 0 else 1
    return multiply(conjugate(start), [sign * x for x in end])


def slerp(start: Numbers, end: Numbers, fraction: Numbers) -> list:
    """`start exp(fraction log(start^-1 end))`."""
    turn = log(relative(start, end))
    return multiply(start, exp([fraction[()] * x for x in turn]))


def steps(poses: Numbers) -> list:
    """Increments of poses, the first 0, row by row."""
    rows = [log(relative(a, b)) for a, b in itertools.pairwise(poses)]
    return [mp.mpf(0)] * 3 + [x for row in rows for x in row]


def offsets(poses: Numbers) -> list:
    """Rotations from the first pose, row by row."""
    return [x for pose in poses for x in log(relative(poses[0], pose))]


def matrix(rotation: Numbers) -> list:
    """Rotation matrix, rows, by Rodrigues."""
    x, y, z = rotation
    a = mp.sqrt(_dot(rotation, rotation))
    first = mp.sin(a) / a if a else mp.mpf(1)
    second = (1 - mp.cos(a)) / a**2 if a else mp.mpf(1) / 2
    cross = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    square = [
        [_dot(row, column) for column in zip(*cross, strict=True)] for row in cross
    ]
    return [
        [(i == j) + first * cross[i][j] + second * square[i][j] for j in range(3)]
        for i in range(3)
    ]


def matrix_minus_identity(rotation: Numbers) -> list:
    """`R - I`."""
    turn = matrix(rotation)
    return [turn[i][j] - (i == j) for i in range(3) for j in range(3)]


# --- camera ---


class Pinhole:
    """Camera of whole pixels; its field of view, degrees, is an argument."""

    def __init__(self, width: int, height: int):
        self.width, self.height = width, height

    def focal(self, fov: Numbers) -> Any:
        """Focal length, px."""
        return mp.mpf(self.width) / 2 / mp.tan(fov[()] * mp.pi / 360)

    def ray(self, fov: Numbers, x: Any, y: Any) -> list:
        """Ray of a pixel position."""
        focal = self.focal(fov)
        half_width, half_height = mp.mpf(self.width) / 2, mp.mpf(self.height) / 2
        return [(x - half_width) / focal, (half_height - y) / focal, mp.mpf(-1)]

    def project(self, fov: Numbers, ray: Numbers) -> list:
        """Pixel position of a ray."""
        if not ray[2] < 0:
            return [mp.nan, mp.nan]
        scale = self.focal(fov) / -ray[2]
        half_width, half_height = mp.mpf(self.width) / 2, mp.mpf(self.height) / 2
        return [half_width + ray[0] * scale, half_height - ray[1] * scale]

    def displacement(
        self, fov: Numbers, rotation: Numbers, x: Numbers, y: Numbers
    ) -> list:
        """Where a turned ray projects, from its pixel; 0 behind the camera."""
        x, y = x[()], y[()]
        turned = [_dot(row, self.ray(fov, x, y)) for row in matrix(rotation)]
        if not turned[2] < 0:
            return [mp.mpf(0), mp.mpf(0)]
        moved_x, moved_y = self.project(fov, turned)
        return [moved_x - x, moved_y - y]

    def homography(self, fov: Numbers, rotation: Numbers) -> list:
        """`K R K^-1`."""
        focal = self.focal(fov)
        cx, cy = mp.mpf(self.width) / 2, mp.mpf(self.height) / 2
        to_ray = mp.matrix([[1, 0, -cx], [0, -1, cy], [0, 0, -focal]]) / focal
        to_pixel = mp.matrix([[-focal, 0, cx], [0, focal, cy], [0, 0, 1]])
        found = to_pixel * mp.matrix(matrix(rotation)) * to_ray
        return list(found)

    def largest_factor(self, focal: Any) -> Any:
        """By what K and K^-1 multiply R: f, or (W / 2)^2 / f of wide views."""
        return focal + (self.width / 2) ** 2 / focal

    def far_homography(self, fov: Numbers, rotation: Numbers) -> list:
        """`K R K^-1`, and that factor."""
        factor = self.largest_factor(self.focal(fov))
        return [*self.homography(fov, rotation), factor]

    def px_per_deg(self, fov: Numbers, position: Numbers) -> list:
        """Speed of the picture when the head turns or nods."""
        x, y, _ = self.ray(fov, *position)
        scale = self.focal(fov) * mp.pi / 180
        return [
            scale * mp.sqrt((1 + x**2) ** 2 + (x * y) ** 2),
            scale * mp.sqrt((1 + y**2) ** 2 + (x * y) ** 2),
        ]


# --- colour and blending ---


def encode(linear: Numbers) -> list:
    """SRGB gamma of linear light."""
    x = linear[()]
    if x <= mp.mpf("0.0031308"):
        return [mp.mpf("12.92") * x]
    return [mp.mpf("1.055") * x ** (1 / mp.mpf("2.4")) - mp.mpf("0.055")]


def decode(gamma: Numbers) -> list:
    """Linear light of sRGB gamma."""
    x = gamma[()]
    if x <= mp.mpf("0.04045"):
        return [x / mp.mpf("12.92")]
    return [((x + mp.mpf("0.055")) / mp.mpf("1.055")) ** mp.mpf("2.4")]


def luma(rgb: Numbers) -> list:
    """Rec. 709 luma."""
    return [_dot([mp.mpf(w) for w in ("0.2126", "0.7152", "0.0722")], rgb)]


def squared_distance(one: Numbers, other: Numbers) -> list:
    """Squared Euclidean distance."""
    return [_dot(one - other, one - other)]


def distance(one: Numbers, other: Numbers) -> list:
    """Euclidean distance."""
    return [mp.sqrt(_dot(one - other, one - other))]


def euclidean_difference(one: Numbers, other: Numbers) -> list:
    """Distance over its maximum, at most 1."""
    return [min(distance(one, other)[0] / mp.sqrt(3), mp.mpf(1))]


def max_channel_difference(one: Numbers, other: Numbers) -> list:
    """Largest channel difference, at most 1."""
    return [min(max(abs(one - other)), mp.mpf(1))]


def ease(speed: Numbers, h_max: Numbers) -> list:
    """Equation (4): `((1 - cos(pi h / h_max)) / 2)^2`."""
    share = min(speed[()], h_max[()]) / h_max[()]
    return [((1 - mp.cos(mp.pi * share)) / 2) ** 2]


def past_color(samples: Numbers, weights: Numbers) -> list:
    """Equation (2), of weights that sum to 1: the last one is what the others leave."""
    rest = 1 - mp.fsum(weights[:-1])
    return [_dot([*weights[:-1], rest], column) for column in samples.T]


def blend(current: Numbers, history: Numbers, weight: Numbers) -> list:
    """Equation (3)."""
    return list(weight[()] * current + (1 - weight[()]) * history)


def current_weight(minimum: Numbers, easing: Numbers) -> list:
    """Equation (4)."""
    return [minimum[()] + (1 - minimum[()]) * easing[()]]


def localized_minimum(w_min: Numbers, w_lb: Numbers, difference: Numbers) -> list:
    """Equation (5)."""
    return [w_min[()] - (w_min[()] - w_lb[()]) * difference[()]]


# --- resampling ---


def _texel(picture: Numbers, row: int, column: int) -> Any:
    height, width = picture.shape
    return picture[min(max(row, 0), height - 1), min(max(column, 0), width - 1)]


def _parts(place: Any) -> tuple[int, Any]:
    # A clamped position farther out reads the same texel, whole.
    whole = int(mp.floor(place))
    return (whole, place - whole) if abs(whole) < 10**6 else (whole, mp.mpf(0))


def bilinear(picture: Numbers, dx: Numbers, dy: Numbers) -> list:
    """Tents around the 2 x 2 texels; position from the centre of texel (2, 2)."""
    (i, u), (j, v) = _parts(2 + dx[()]), _parts(2 + dy[()])
    rows = [
        (1 - u) * _texel(picture, k, i) + u * _texel(picture, k, i + 1)
        for k in (j, j + 1)
    ]
    return [(1 - v) * rows[0] + v * rows[1]]


def catmull_rom(picture: Numbers, dx: Numbers, dy: Numbers) -> list:
    """Keys' kernel, a = -1/2, over the 4 x 4 texels."""
    (i, u), (j, v) = _parts(2 + dx[()]), _parts(2 + dy[()])

    def kernel(t: Any) -> Any:
        t = abs(t)
        if t < 1:
            return (3 * t**3 - 5 * t**2 + 2) / 2
        return (-(t**3) + 5 * t**2 - 8 * t + 4) / 2

    taps = range(-1, 3)
    return [
        mp.fsum(
            kernel(u - m) * kernel(v - n) * _texel(picture, j + n, i + m)
            for m in taps
            for n in taps
        )
    ]


def nearest(picture: Numbers, dx: Numbers, dy: Numbers) -> list:
    """Texel whose centre is nearest."""
    half = mp.mpf(1) / 2
    j, i = int(mp.floor(2 + dy[()] + half)), int(mp.floor(2 + dx[()] + half))
    return [_texel(picture, j, i)]


# --- heads: an angle's covariance is a sum of exponentials ---


class Exponentials:
    """`C(t) = sum of amplitude exp(-rate |t|)`, in pairs that may be complex."""

    def __init__(self, terms: list[tuple[Any, Any]]):
        self.terms = terms

    @classmethod
    def wander(cls, speed: Any, time_s: Any, return_s: Any) -> "Exponentials":
        """White noise through two exponentials."""
        a, b = 1 / time_s, 1 / return_s
        if a == b:
            b = b * (1 + mp.mpf(10) ** -20)  # the limit, to 20 digits
        scale = speed**2 * a / (b**2 - a**2)
        return cls([(scale / a, a), (-scale / b, b)])

    @classmethod
    def mode(cls, speed: Any, frequency_hz: Any, damping: Any) -> "Exponentials":
        """Damped oscillator, under- or overdamped."""
        if damping == 1:
            damping = 1 + mp.mpf(10) ** -20
        w = 2 * mp.pi * frequency_hz
        root = mp.sqrt(mp.mpc(damping**2 - 1))
        first, second = w * (damping - root), w * (damping + root)
        scale = (speed / w) ** 2 / (second - first)
        return cls([(scale * second, first), (-scale * first, second)])

    def covariance(self, lag: Any) -> Any:
        """Of the angle."""
        return mp.re(mp.fsum(c * mp.exp(-r * abs(lag)) for c, r in self.terms))

    def structure(self, lag: Any) -> Any:
        """Mean squared turn."""
        return mp.re(mp.fsum(-2 * c * mp.expm1(-r * abs(lag)) for c, r in self.terms))

    def of_increments(self, frames: int, dt: Any) -> Any:
        """Covariance of frame-to-frame turns."""
        around = [self.structure((frames + k) * dt) for k in (-1, 0, 1)]
        return (around[0] + around[2]) / 2 - around[1]

    def spectrum(self, frequency_hz: Any) -> Any:
        """One-sided density of the velocity."""
        w = 2 * mp.pi * frequency_hz
        two_sided = mp.fsum(2 * c * r / (r**2 + w**2) for c, r in self.terms)
        return 2 * w**2 * mp.re(two_sided)

    def sampled_spectrum(self, frequency_hz: Any, rate_hz: Any) -> Any:
        """One-sided density of the frame-difference velocity."""
        phase = 2 * mp.pi * frequency_hz / rate_hz
        differenced = 4 * mp.sin(phase / 2) ** 2
        if not differenced:
            return mp.mpf(0)
        kernel = lambda x: mp.sinh(x) / (2 * (mp.sinh(x / 2) ** 2 + differenced / 4))
        total = mp.fsum(c * kernel(r / rate_hz) for c, r in self.terms)
        return 2 * rate_hz * differenced * mp.re(total)


def transition(drift: np.ndarray, diffusion: np.ndarray, dt: Any) -> list:
    """Transition minus identity, and noise's covariance, of two coupled states.

    By eigenvalues; the noise is what a stationary law loses, of Lyapunov's equation.
    """
    a = mp.matrix(drift.tolist())
    half_trace = (a[0, 0] + a[1, 1]) / 2
    root = mp.sqrt(mp.mpc(((a[0, 0] - a[1, 1]) / 2) ** 2 + a[0, 1] * a[1, 0]))
    root = root or mp.mpf(10) ** -25
    grown = [mp.exp((half_trace + s * root) * dt) for s in (1, -1)]
    even, odd = (grown[0] + grown[1]) / 2, (grown[0] - grown[1]) / 2 / root
    moved = mp.matrix(2, 2)
    for i in range(2):
        for j in range(2):
            shifted = a[i, j] - (half_trace if i == j else 0)
            moved[i, j] = mp.re((even if i == j else 0) + odd * shifted)
    b, c, d, e = a[0, 0], a[0, 1], a[1, 0], a[1, 1]
    lyapunov = mp.matrix([[2 * b, 2 * c, 0], [d, b + e, c], [0, 2 * d, 2 * e]])
    law = mp.lu_solve(
        lyapunov, mp.matrix([-diffusion[0, 0], -diffusion[0, 1], -diffusion[1, 1]])
    )
    law = mp.matrix([[law[0], law[1]], [law[1], law[2]]])
    noise = law - moved * law * moved.T
    return [*(moved - mp.eye(2)), *noise]
