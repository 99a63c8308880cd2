"""The ranges of arguments, with their extremes: what the rows of the table share."""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..theory.picture_statistics import DIRECTIONS
from . import exact_geometry as exact
from .row import Argument, Number, Rng

ANGLES = (
    *(0.0, 5e-310, 1e-40, 1e-30, 1e-20, 1e-12, 1e-9, 1e-7, 1e-6, 1e-5, 1e-4, 3e-4),
    *(1e-3, 1e-2, 0.1, 1.0, 2.0, 3.0, math.pi - 1e-3, math.pi - 1e-6, math.pi),
)
"""Rotations, rad: none, denormals, below all squares, jitter, and to half a turn."""
RATES_HZ = (1.0, 60.0, 90.0, 1000.0, 10_000.0)
TIMES_S = (1e-6, 1e-3, 0.1, 1.0, 15.0, 1e3, 1e6)
COORDINATES = (
    *(0.0, 1e-9, -1e-9, 1.0, -1.0, 20.0, -20.0, 46.0, -46.0, 50.0, -50.0),
    *(700.0, -700.0, math.inf, -math.inf),
)
"""Of searches, which go through any real numbers."""


def unit(vector: np.ndarray) -> np.ndarray:
    """Vector of length 1."""
    return vector / np.linalg.norm(vector)


def turned(start: Any, rotation: Any) -> np.ndarray:
    """Quaternion of a pose, turned by a rotation vector about its own axes."""
    return np.array([float(x) for x in exact.multiply(start, exact.exp(rotation))])


# --- scalars ---


def _scalar(over: str, extremes: tuple, drawn: Any, spare: int) -> Argument:
    count = len(extremes)

    def draw(rng: Rng, dtype: np.dtype, n: int) -> Number:
        place = n % (count + spare)
        return extremes[place] if place < count else float(drawn(rng))

    return Argument(over, draw)


def uniform(
    over: str, *extremes: Number, low: Number = 0, high: Number = 0
) -> Argument:
    """Extremes in turn; if there is a range, then as many (at least 4) within it."""
    spare = max(len(extremes), 4) if high else 0
    return _scalar(over, extremes, lambda rng: rng.uniform(low, high), spare)


def logarithmic(over: str, *extremes: Number, low: Number, high: Number) -> Argument:
    """Return the same, the range on a logarithmic scale."""
    ends, spare = np.log10([low, high]), max(len(extremes), 4)
    return _scalar(over, extremes, lambda rng: 10 ** rng.uniform(*ends), spare)


_SHARES = (0.0, 1.0, 0.5, 2 / 3, 1e-30, 1e-6, 1 - 1e-6, 0.25, 0.75)
SHARE = uniform("share 0, 1e-30 to 1", *_SHARES, high=1)
FOV = uniform("0.1 to 179.9 deg", 0.1, 1.0, 16.0, 96.0, 96.0, 150.0, 179.0, 179.9)
WEIGHT = uniform("0 to 1", 0.0, 1.0, 1e-30, 1e-8, 1 - 1e-6, high=1)
CLOSENESS = uniform("d 0 to 1", 0.0, 1.0, 2 / 3, 1e-6, high=1)
_FRACTIONS = (0.0, 1.0, 0.5, 1 / 3, 1e-6, 1 - 1e-6, -1.0, 2.0)
FRACTION = uniform("fraction -1 to 2", *_FRACTIONS, high=1)
EXPONENT = logarithmic("exponent 0.5 to 100", 0.5, 1.0, 2.0, 100.0, low=0.5, high=100)
RATE = uniform("1 to 10,000 Hz", *RATES_HZ)
BASE = Argument("bases 2, 3, 5", lambda rng, dtype, n: (2, 3, 5)[n % 3])
INDEX = Argument(
    "indices to 1e9",
    lambda rng, dtype, n: (0, 1, 2, 15, int(rng.integers(10**9)))[n % 5],
)
VECTOR = Argument(
    "vectors of 1e-6 to 1e6",
    lambda rng, dtype, n: rng.normal(size=3) * 10 ** rng.uniform(-6, 6),
)
_COLOURS = (
    *(0.0, 5e-310, 1e-40, 1e-30, 1e-8, 1e-3, 0.0031308, 0.04045, 0.04, 0.05, 0.5),
    *(1 - 1e-6, 1.0, 2.0, 1e3, 1e6, -1e-3),
)
"""Black, far below a code value, the curve's joints, white, and high dynamic range."""
_HDR = "0, denormals, 1e-30 to 1e6"
COLOUR = logarithmic(_HDR, *_COLOURS, low=1e-12, high=1e6)
_SIZE = logarithmic("", *_COLOURS, low=1e-8, high=1e6)


# --- rotations and the camera ---


def _rotation(rng: Rng, n: int, least: float, most: float) -> np.ndarray:
    """About each axis, and about others, some near the picture's plane."""
    angles = [a for a in ANGLES if a == 0 or least <= a <= most]
    angles = angles[least > 0.9 * most :]
    drawn = 10 ** rng.uniform(math.log10(max(least, 1e-30)), math.log10(most))
    axis = unit(rng.normal(size=3) * [1, 1, (1, 0.03)[n % 2]])
    axis = np.eye(3)[n % 9] if n % 9 < 3 else axis
    return (angles[n] if n < len(angles) else drawn) * axis


def rotation(least: float = 0.0, most: float = math.pi) -> Argument:
    """Rotation vectors of every angle, rad; none among them unless all are large."""
    words = f"{least:g}" if least else "denormals, 1e-30"
    words = "0, " * (least < 1) + f"{words} to {most:.3g} rad"
    return Argument(words, lambda rng, dtype, n: _rotation(rng, n, least, most))


def _quaternion(rng: Rng, dtype: np.dtype, n: int) -> np.ndarray:
    q = turned([1, 0, 0, 0], _rotation(rng, n, 0.0, math.pi))
    return (-1) ** n * q * (1 + 0.01 * (n % 3 - 1))


QUATERNION = Argument("any angle, q and -q, length 0.99 to 1.01", _quaternion)


def two_poses(most: float = math.pi - 1e-5) -> Argument:
    """Return unit quaternions at every angle from each other, anywhere."""

    def draw(rng: Rng, dtype: np.dtype, n: int) -> tuple[np.ndarray, np.ndarray]:
        # From the identity small angles have all digits.
        start = np.eye(4)[0] if n % 2 else unit(rng.normal(size=4))
        start = start.astype(dtype).astype(float)
        end = turned(start, _rotation(rng, n, 0.0, most))
        return start, (-1) ** (n // 2) * end

    return Argument("0, denormals, 1e-30 to pi rad apart, q and -q", draw)


def _hold_and_turn(rng: Rng, dtype: np.dtype, n: int) -> np.ndarray:
    hold, away = unit(rng.normal(size=4)), rng.uniform(0, 0.35)
    previous = turned(hold, away * unit(rng.normal(size=3)))
    now = turned(previous, 10 ** rng.uniform(-7, -1) * unit(rng.normal(size=3)))
    return np.stack([hold, previous, now])


HOLD_AND_TURN = Argument(
    "1e-7 to 0.1 rad per frame, any hold pose, up to 20 deg off it", _hold_and_turn
)


def _path(rng: Rng, dtype: np.dtype, n: int) -> np.ndarray:
    size = np.linalg.norm(_rotation(rng, n, 0.0, 1.0))
    turns = size * rng.normal(size=(3, 3))
    return np.stack([np.eye(4)[0], *(turned(np.eye(4)[0], turn) for turn in turns)])


PATH = Argument("0, denormals, 1e-30 to 1 rad about the hold pose", _path)


def _pixel(rng: Rng, dtype: np.dtype, n: int) -> np.ndarray:
    size = np.array(exact.SIZE_PX)
    edges = rng.integers(0, 3, 2) * (size - 1) / 2 + 0.5
    return edges if rng.random() < 0.5 else rng.uniform(0, 1, 2) * size


def _ray(rng: Rng, dtype: np.dtype, n: int) -> np.ndarray:
    depth = (-1) ** (n % 5 == 4) * -(10 ** rng.uniform(-3, 3))
    return np.array([*rng.normal(size=2), depth])


PLACE = Argument("1024 px, 96 deg", lambda rng, *_: rng.choice([0, 100, 511, 1023], 2))
PIXEL, RAY = Argument("", _pixel), Argument("depth 1e-3 to 1e3, NaN behind", _ray)


# --- colours and pictures ---


def two_colours(most: float = 1e6) -> Argument:
    """Colours that are equal, nearly equal, and unrelated."""

    def draw(rng: Rng, dtype: np.dtype, n: int) -> tuple[np.ndarray, np.ndarray]:
        size = min(abs(_SIZE.draw(rng, dtype, n)), most)
        one = size * rng.uniform(0, 1, 3)
        near = one * (1 + 1e-5 * rng.normal(size=3))
        return one, (one, near, size * rng.random(3))[n % 3].clip(max=most)

    return Argument(f"0, denormals, 1e-30 to {most:g}", draw)


ONE_COLOUR = Argument(_HDR, lambda *given: two_colours().draw(*given)[0])


def _past(rng: Rng, dtype: np.dtype, n: int) -> tuple[np.ndarray, np.ndarray]:
    count = (1, 2, 4, 16)[n % 4]
    weights = np.pad(rng.random(count) + 1e-3, (16 - count, 0))
    samples = rng.random((count, 3)) * 10 ** rng.uniform(-8, 6)
    return np.resize(samples, (16, 3)), weights / weights.sum()


PAST = Argument("1 to 16 past samples, 1e-8 to 1e6", _past)


def _speed(rng: Rng, dtype: np.dtype, n: int) -> tuple[Any, Any]:
    h_max = dtype.type((1e-25, 1e-6, 25.0, 25.0, 1e9, 1e25)[n // 11 % 6])
    beside = [np.nextafter(h_max, end) for end in (0 * h_max, dtype.type(np.inf))]
    speeds = (*(0.0, 1e-9, 1e-3, 0.5, 1.0, 2.0), *rng.random(3))
    return [*(dtype.type(s) * h_max for s in speeds), *beside][n % 11], h_max


SPEED = Argument("h 0 to 2 h_max, an ulp beside it; h_max 1e-25 to 1e25 deg/s", _speed)


def _rises(rng: Rng, dtype: np.dtype, n: int) -> np.ndarray:
    spread = 10 ** rng.uniform(-12, 12, 5)
    return (np.ones(5), np.eye(5)[n % 5], rng.random(5), spread)[n % 4]


RISES = Argument("rises 0, 1e-12 to 1e12", _rises)


def picture(stored: Any = None) -> Argument:
    """Pictures of 4 x 5 texels, rounded to the dtype that they are stored in."""

    def draw(rng: Rng, dtype: np.dtype, n: int) -> np.ndarray:
        texels = rng.random((4, 5)).astype(dtype)
        return np.asarray(jnp.asarray(texels, stored), dtype)

    return Argument("", draw)


_OFFSETS = (0.0, 1.0, -2.0, 3.0, 1e6, -1e6, 1e-30, -1e-30, 1e-6, -1e-6, 0.5 - 1e-3)
OFFSET = uniform("0, 1e-30 to 1e6 texels, beyond edges", *_OFFSETS, low=-5, high=6)


def _clip(rng: Rng, dtype: np.dtype, n: int) -> np.ndarray:
    """Three frames of 2 x 2 pixels; what differs does so by more than 1e-17."""
    # The oracle's step must be small beside a difference.
    shape, near = (3, 2, 2, 3), max(4 * float(np.finfo(dtype).eps), 1e-9)
    level = (1e-8, 1e-3, 0.5, 1.0, 255.0, 1e6)[n // 4 % 6] if n else 0.0
    one = np.full(shape, level)
    one[1, 0, 1, 2] *= 1 + near
    beside = level * (1 + near * rng.integers(-8, 9, shape))
    return (level * rng.random(shape), np.full(shape, level), one, beside)[n % 4]


def _test_and_reference(
    rng: Rng, dtype: np.dtype, n: int
) -> tuple[np.ndarray, np.ndarray]:
    clip = _clip(rng, dtype, n // 3)
    return [
        (clip[1, 0], clip[0, 0]),
        (clip[1, 1], clip[0, 1] / 2),
        (clip[1, 1], np.zeros((2, 3))),
    ][n % 3]


_LEVELS = "0, 1e-8 to 1e6: equal, one channel of one pixel, all by 4 eps or 1e-9"
CLIP, TWO_PICTURES = Argument(_LEVELS, _clip), Argument(_LEVELS, _test_and_reference)


LONG_CLIP = Argument(
    "1e4 frames of 1e-8 to 1e6",
    lambda rng, dtype, n: 10.0 ** (n * 14 / 5 - 8) * rng.random((10_000, 1, 2, 3)),
)


def _displaced(rng: Rng, dtype: np.dtype, n: int) -> tuple[np.ndarray, float, Any]:
    lengths = (0.0, 1e-15, 1e-6, 0.2, 0.3, 0.6, 0.9, 3.0, 1e3, 1e6)
    length = lengths[n % 10] if n < 20 else 10 ** rng.uniform(-2, 2)
    waves = rng.uniform(-0.1, 0.1, (3, DIRECTIONS))
    waves[:, 0] = 1.0
    direction = (0.0, math.tau / 8, rng.uniform(0, math.tau))[n % 3]
    vector = length * np.array([math.cos(direction), math.sin(direction)])
    return waves * 10 ** rng.uniform(-6, 0), 0.25, vector


DISPLACED = Argument(
    "0, 1e-15 to 1e6 px, before, between and beyond tabled lengths", _displaced
)
