"""The ranges of arguments, with their extremes: what the rows of the table share."""

import math
from functools import partial
from typing import Any

import numpy as np

from . import exact_geometry as exact
from .engine import Argument, Number, Rng

# Rotations, rad: none, denormals, below all squares, jitter, and to half a turn.
ANGLES = (
    *(0.0, 5e-310, 1e-40, 1e-30, 1e-20, 1e-12, 1e-9, 1e-7, 1e-6, 1e-5, 1e-4, 3e-4),
    *(1e-3, 1e-2, 0.1, 1.0, 2.0, 3.0, math.pi - 1e-3, math.pi - 1e-6, math.pi),
)
RATES_HZ = (1.0, 60.0, 90.0, 1000.0, 10_000.0)
TIMES_S = (1e-6, 1e-3, 0.1, 1.0, 15.0, 1e3, 1e6)
# Of searches, which go through any real numbers.
COORDINATES = (
    *(0.0, 1e-9, -1e-9, 1.0, -1.0, 20.0, -20.0, 46.0, -46.0, 50.0, -50.0),
    *(700.0, -700.0, math.inf, -math.inf),
)
# Black, far below a code value, the curve's joints, white, and high dynamic range.
LEVELS = (
    *(0.0, 5e-310, 1e-40, 1e-30, 1e-8, 1e-3, 0.0031308, 0.04045, 0.04, 0.05, 0.5),
    *(1 - 1e-6, 1.0, 2.0, 1e3, 1e6),
)


def unit(vector: np.ndarray) -> np.ndarray:
    """Direction of a vector: the same, of length 1."""
    return vector / np.linalg.norm(vector)


def turned(start: Any, rotation: np.ndarray) -> np.ndarray:
    """Quaternion of a pose, turned by a rotation vector about its own axes."""
    return exact.multiply(np.asarray(start), exact.exp(rotation)).astype(float)


def numbers(
    over: str, *extremes: Number, within: tuple = (), decades: bool = False
) -> Argument:
    """Extremes in turn, and as many (at least 4) within a range or over its decades."""
    spare = max(len(extremes), 4) if within else 0
    ends: Any = np.log10(within) if decades else within

    def draw(rng: Rng, dtype: np.dtype, n: int) -> Number:
        place = n % (len(extremes) + spare)
        if place < len(extremes):
            return extremes[place]
        return 10 ** rng.uniform(*ends) if decades else rng.uniform(*ends)

    return Argument(over, draw)


logarithmic = partial(numbers, decades=True)


def vectors(length: Argument, size: int = 3) -> Argument:
    """Of lengths, along each axis, and others, some near the last one's plane."""

    def draw(rng: Rng, dtype: np.dtype, n: int) -> np.ndarray:
        axis = rng.normal(size=size)
        axis[-1] *= (1, 0.03)[n % 2]
        axis = np.eye(size)[n % 9] if n % 9 < size else unit(axis)
        return length.draw(rng, dtype, n) * axis

    return Argument(length.over, draw)


def arrays(size: Argument, *shape: int) -> Argument:
    """Of random entries of a size."""
    return Argument(size.over, lambda rng, *n: size.draw(rng, *n) * rng.random(shape))


def apart(array: Argument) -> Argument:
    """Of an array, its rows as arguments of their own."""
    return Argument(array.over, lambda *at: tuple(array.draw(*at)))


def weights(count: int) -> Argument:
    """Of a sum of 1: all alike, one alone, and over 1 and 24 decades."""

    def draw(rng: Rng, dtype: np.dtype, n: int) -> np.ndarray:
        spread = 10 ** rng.uniform(-12, 12, count)
        kinds = np.ones(count), np.eye(count)[n % count], rng.random(count), spread
        return kinds[n % 4] / kinds[n % 4].sum()

    return Argument("weights 0, 1e-24 to 1", draw)


def coordinates(*shape: int) -> Argument:
    """Coordinates of a search: all at an extreme, one of them, and a random mix."""
    mixed = [x for x in COORDINATES if abs(x) != 46]  # where they stop to count

    def draw(rng: Rng, dtype: np.dtype, n: int) -> np.ndarray:
        extreme, alone = COORDINATES[n // 3 % 15], rng.normal(size=shape)
        alone.flat[n // 3 % alone.size] = extreme
        return (np.full(shape, extreme), alone, rng.choice(mixed, shape))[n % 3]

    return Argument("coordinates 0, 1e-9 to 700, infinite", draw)


_SHARES = (0.0, 1.0, 0.5, 1 / 3, 2 / 3, 1e-30, 1e-8, 1e-6, 1 - 1e-6)
SHARE = numbers("share 0, 1e-30 to 1", *_SHARES, within=(0, 1))
FRACTION = numbers("fraction -1 to 2", *_SHARES, -1.0, 2.0, within=(0, 1))


def rotation(least: float = 0.0, most: float = math.pi) -> Argument:
    """Rotation vectors of every angle, rad; none among them unless all are large."""
    angles = [a for a in ANGLES if least <= a <= most or (a == 0 and least < 1)]
    words = f"{least:g}" if least else "denormals, 1e-30"
    words = "0, " * (least < 1) + f"{words} to {most:.3g} rad"
    return vectors(logarithmic(words, *angles, within=(max(least, 1e-30), most)))


def poses(over: str, *turns: Argument, is_anywhere: bool = True) -> Argument:
    """Quaternions, each turned from the last, q and -q; half start at the identity."""

    def draw(rng: Rng, dtype: np.dtype, n: int) -> np.ndarray:
        # From the identity small angles have all digits.
        is_identity = n % 2 or not is_anywhere
        start = np.eye(4)[0] if is_identity else unit(rng.normal(size=4))
        found = [start.astype(dtype).astype(float)]
        for turn in turns:
            found.append(turned(found[-1], turn.draw(rng, dtype, n)))
        return np.stack([*found[:-1], (-1) ** (n // 2) * found[-1]])

    return Argument(over, draw)


def pictures(*shape: int, levels: tuple = LEVELS) -> Argument:
    """Stacks of pictures: unrelated, equal, nearly so, or black but for the first."""

    def draw(rng: Rng, dtype: np.dtype, n: int) -> np.ndarray:
        # The oracle's step must be small beside a difference.
        near = max(4 * float(np.finfo(dtype).eps), 1e-9)
        drawn = levels[n % len(levels)] * rng.random(shape)
        equal = np.broadcast_to(drawn[0], shape)
        one, black = equal.copy(), drawn.copy()
        one[-1].flat[-1] *= 1 + near
        black[1:] = 0
        beside = equal * (1 + near * rng.integers(-8, 9, shape))
        return (drawn, equal, one, beside, black)[n % 5]

    least, most = sorted(levels)[1], max(levels)
    words = f"0, {'denormals, 1e-30' if least < 1e-30 else f'{least:g}'} to {most:g}"
    return Argument(f"{words}: unrelated, equal, nearly equal, black", draw)
