"""Replicates of an estimate: the same from sessions, or subjects, that are drawn anew.

Subjects may have very many windows: how often each is drawn takes one byte, and
replicates are made some at a time.
"""

import functools
from collections.abc import Iterator

import numpy as np
from jaxtyping import Int64, UInt8

from .estimate import Replicates, Resampling

_REPLICATES = 2000
_SEED = 20260101
_AT_A_TIME = 2**20  # numbers, of sessions and replicates


def replicates(
    sample: Resampling, subjects: Int64[np.ndarray, " drawn"] | None
) -> Replicates:
    """Return the estimate of 2,000 samples like its own; not finite where it has none.

    **Arguments:** `subjects`: number, from 0, of the subject of each session that was
    drawn: subjects are drawn, and then each one's sessions. None draws sessions.
    """
    drawn = sample.drawn
    count = int(drawn.sum())
    times = _times(count, None if subjects is None else subjects.tobytes())
    found = []
    for some in _pieces(drawn.size):
        weights = times[:, some].astype(float)
        if count < drawn.size:
            weights = np.zeros((drawn.size, weights.shape[1]))
            weights[drawn] = times[:, some]
        # Sessions without any flicker can leave a replicate that has no ratio.
        with np.errstate(divide="ignore", invalid="ignore"):
            found.append(sample.replicate(weights))
    return np.concatenate(found)


def _pieces(sessions: int) -> Iterator[slice]:
    step = max(1, _AT_A_TIME // sessions)
    return (slice(first, first + step) for first in range(0, _REPLICATES, step))


@functools.lru_cache(maxsize=2)
def _times(count: int, clusters: bytes | None) -> UInt8[np.ndarray, "session _"]:
    """How often each session is drawn in each replicate, `(session, replicate)`.

    Once on average, and never 256 times. One seed: cells with the same sessions are
    resampled alike.
    """
    rng = np.random.default_rng(_SEED)
    if clusters is None:
        drawn = rng.multinomial(count, np.full(count, 1 / count), size=_REPLICATES)
        return drawn.T.astype(np.uint8)
    index = np.frombuffer(clusters, dtype=np.int64)
    units = int(index.max()) + 1
    of_unit = rng.multinomial(units, np.full(units, 1 / units), size=_REPLICATES)
    times = np.zeros((count, _REPLICATES), np.uint8, order="F")
    for unit in range(units):
        windows = np.flatnonzero(index == unit)
        share = np.full(len(windows), 1 / len(windows))
        for some in _pieces(len(windows)):
            # A subject drawn k times: k draws of its number of windows, in one.
            drawn = rng.multinomial(of_unit[some, unit] * len(windows), share)
            times[windows, some] = drawn.T
    return times
