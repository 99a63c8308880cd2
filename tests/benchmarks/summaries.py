"""What is said about timings: medians, quartiles, ratios of pairs, slopes."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

_DRAWS = 2000
_LEVEL = 0.95


class Spread(NamedTuple):
    """Median and quartiles of some timings, s."""

    median: float
    low: float
    high: float


class Ratio(NamedTuple):
    """How many times as fast as another, with a 95 % interval."""

    value: float
    low: float
    high: float


def spread(seconds: Sequence[float]) -> Spread:
    """Median and quartiles, by linear interpolation."""
    low, median, high = np.quantile(seconds, [0.25, 0.5, 0.75])
    return Spread(float(median), float(low), float(high))


def times_as_fast(ours: Sequence[float], theirs: Sequence[float]) -> Ratio:
    """Median of theirs over median of ours: above 1, ours is faster.

    The runs are interleaved, so what disturbs a machine for a while disturbs run i of
    both: the bootstrap draws rounds, not runs.
    """
    pairs = np.array([ours, theirs])
    rounds = pairs.shape[1]
    drawn = np.random.default_rng(0).integers(rounds, size=(_DRAWS, rounds))
    medians = np.median(pairs[:, drawn], axis=-1)
    tail = (1 - _LEVEL) / 2
    low, high = np.quantile(medians[1] / medians[0], [tail, 1 - tail])
    value = np.median(pairs[1]) / np.median(pairs[0])
    return Ratio(float(value), float(low), float(high))


def slope(sizes: Sequence[float], seconds: Sequence[float]) -> float:
    """Exponent p of `seconds ~ sizes^p`, a straight line on logarithmic axes."""
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


def nanoseconds(seconds: float, pixel_frames: int) -> float:
    """Time per pixel and frame, ns."""
    return seconds / pixel_frames * 1e9


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Plain text in columns; the first one is flush left."""
    cells = [list(head), *(list(row) for row in rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(head))]

    def line(row: Sequence[str]) -> str:
        first = row[0].ljust(widths[0])
        others = zip(row[1:], widths[1:], strict=True)
        return "  ".join([first, *(cell.rjust(width) for cell, width in others)])

    return "\n".join(line(row) for row in cells)
