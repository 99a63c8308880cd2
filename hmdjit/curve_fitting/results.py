"""What fitted curves keep of flicker and of detail, and how much they gain."""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.stats
from jaxtyping import Float

from ..studies.intervals import Interval
from ..techniques import HeadMovement
from .errors import Errors
from .search import Numbers
from .space import CurveSpace


def _mean(x: Float[np.ndarray, " sessions"]) -> Interval:
    """Mean with Student's 95 % interval."""
    error = float(np.std(x, ddof=1) / math.sqrt(len(x)))
    half = float(scipy.stats.t.ppf(0.975, len(x) - 1)) * error
    mean = float(np.mean(x))
    return Interval(mean, mean - half, mean + half, error, "Student's t over sessions")


class Kept(NamedTuple):
    """What a technique keeps of flicker and of detail, relative to no anti-aliasing.

    - `flicker`, `detail_loss`: means over scenes of each session, `(sessions,)`.
    """

    flicker: Float[np.ndarray, " sessions"]
    detail_loss: Float[np.ndarray, " sessions"]

    def intervals(self) -> tuple[Interval, Interval]:
        """Mean flicker and mean detail loss, with 95 % intervals over sessions."""
        return _mean(self.flicker), _mean(self.detail_loss)

    def gain_over(self, other: "Kept") -> tuple[Interval, Interval]:
        """How much less flicker and detail loss than another, of the same sessions."""
        return (
            _mean(other.flicker - self.flicker),
            _mean(other.detail_loss - self.detail_loss),
        )


class FrontPoint(NamedTuple):
    """A curve of the front: its weight of detail loss, and what it keeps, held out."""

    weight: float
    technique: HeadMovement
    kept: Kept


class CurveFit(NamedTuple):
    """A fitted curve, how sure it is, and what it gains.

    - `technique`: head movement with the curve; `weight`: of detail loss.
    - `numbers`, `errors`: in the order of `space.names`.
    - `why`, `steps`: how the search ended, and how often sessions were measured.
    - `kept`: by technique id, on held-out sessions of the scenes that were fitted to:
      none, freeze, ssaa4, Kim et al.'s constants and `fitted`.
    - `kept_elsewhere`: the same on held-out scenes; empty if there are none.
    - `front`: of the family, in the order of the weights.
    """

    space: CurveSpace
    technique: HeadMovement
    weight: float
    detail_bound: float
    numbers: Numbers
    errors: Errors
    why: str
    steps: int
    kept: dict[str, Kept]
    kept_elsewhere: dict[str, Kept]
    front: list[FrontPoint]


def gain_at_equal_detail(front: Sequence[FrontPoint], other: Kept) -> Interval | None:
    """How much less flicker the front has than a technique of the same detail loss.

    The front is taken as straight between its points, which is never in its favour.
    The interval allows for the place on it being estimated: a session moves the gain
    by its own difference of flicker, and of detail loss times the front's slope.

    **Returns:** None where the front does not reach that detail loss.
    """
    detail = float(np.mean(other.detail_loss))
    by_detail = sorted(front, key=lambda point: np.mean(point.kept.detail_loss))
    for fine, coarse in itertools.pairwise(point.kept for point in by_detail):
        low, high = np.mean(fine.detail_loss), np.mean(coarse.detail_loss)
        if low <= detail <= high and low < high:
            share = (detail - low) / (high - low)
            slope = (np.mean(coarse.flicker) - np.mean(fine.flicker)) / (high - low)
            flicker, loss = (
                (1 - share) * a + share * b for a, b in zip(fine, coarse, strict=True)
            )
            return _mean(other.flicker - flicker - slope * (other.detail_loss - loss))
    return None
