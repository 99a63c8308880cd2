"""What fitted curves keep of flicker and of detail, and how much they gain."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..estimates.estimate import mean_of
from ..estimates.intervals import Interval, student_interval
from ..techniques import HeadMovement
from .errors import Errors
from .search import Numbers
from .space import CurveSpace

KIM, FITTED = HeadMovement().id, "fitted"
"""Kim et al.'s constants and the fitted curve, among what techniques keep."""


def _mean(x: Float[np.ndarray, " sessions"]) -> Interval:
    return student_interval(mean_of(x))


def _ratio(
    x: Float[np.ndarray, "*scenes sessions"], y: Float[np.ndarray, "*scenes sessions"]
) -> Float[np.ndarray, "*scenes sessions"]:
    """Values of sessions whose mean is `mean(x) / mean(y)`, and whose spread its error.

    That ratio, and each session's influence on it: `(x_i - R y_i) / mean(y)`.
    """
    below = np.mean(y, axis=-1, keepdims=True)
    ratio = np.mean(x, axis=-1, keepdims=True) / below
    return ratio + (x - ratio * y) / below


class Kept(NamedTuple):
    """What a technique keeps of flicker and of detail, relative to no anti-aliasing.

    - `flicker`, `detail_loss`: of each session, `(sessions,)`: their means are ratios
      of means, averaged over scenes, and their spread is the error of that.
    """

    flicker: Float[np.ndarray, " sessions"]
    detail_loss: Float[np.ndarray, " sessions"]

    @classmethod
    def of(
        cls,
        measured: Float[np.ndarray, "scenes 2 sessions"],
        none: Float[np.ndarray, "scenes 2 sessions"],
    ) -> "Kept":
        """Relate MTCD and detail loss to those of no anti-aliasing, scene by scene."""
        return cls(*np.mean(_ratio(measured, none), axis=0))

    def intervals(self) -> tuple[Interval, Interval]:
        """Mean flicker and mean detail loss, with 95 % intervals over sessions."""
        return _mean(self.flicker), _mean(self.detail_loss)

    def gain_over(self, other: "Kept") -> tuple[Interval, Interval]:
        """How much less flicker and detail loss than another has, as shares of its."""
        pairs = zip(self, other, strict=True)
        mine, theirs = (_mean(_ratio(b - a, b)) for a, b in pairs)
        return mine, theirs


class FrontPoint(NamedTuple):
    """A curve of the front: its weight of detail loss, and what it keeps, held out."""

    weight: float
    technique: HeadMovement
    kept: Kept


class CurveFit(NamedTuple):
    """A fitted curve, how sure it is, and what it gains.

    - `technique`: head movement with the curve; `weight`: of detail loss.
    - `numbers`, `errors`: in the order of `space.names`; the errors are those at this
      weight: that it was chosen to meet a bound on the same sessions is left out.
    - `why`, `steps`: how the search ended, and how many curves were measured.
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

    As a share of the technique's. The front is taken as straight between its points.
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
            gain = other.flicker - flicker - slope * (other.detail_loss - loss)
            return _mean(_ratio(gain, other.flicker))
    return None
