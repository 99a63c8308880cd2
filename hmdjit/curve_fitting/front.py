"""The front between flicker and detail loss: best curves by weight, and one in a bound.

Each weight of detail loss gives a point of the front. A search begins at the nearest
one that is known; finished ones are kept in a file.
"""

import contextlib
import itertools
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy.optimize

from .. import _checks
from .._files import written_atomically
from ..studies.progress import Progress, Tell
from .errors import Errors, errors, newton_step
from .problem import Linearized, Problem
from .search import NoFitError, Numbers, least_squares

FIRST_WEIGHT = 0.1
FRONT_WEIGHTS = (0.3, 1.0, 0.03, 0.01)
"""Weights of detail loss along the front, after the first, in the order of search."""

_FURTHER_WEIGHTS = (3.0, 10.0, 30.0)  # where a bound lies beyond
_MOST_STEPS = 6  # of a search: a last step is Newton's own
_TOLERANCE = 5e-3  # of a search, before Newton's step
_BOUND_TOLERANCE = 2e-3  # by how much a bound on the detail loss may be passed
_DIFFERENCE = 0.02  # step of the differences that give curvatures, logits


class Best(NamedTuple):
    """The best curve for a weight: mean flicker and detail loss relative to none's.

    - `cost`: what was minimised; `why`: how the search ended.
    """

    point: Numbers
    flicker: float
    detail_loss: float
    cost: float
    why: str


class Front:
    """Points of the front that are known so far, by weight.

    - `problem`: gives what is minimised with a weight of detail loss.
    - `key`: of the fit, so that a journal of another one is not gone on from.
    - `steps`: how many curves were measured.
    """

    def __init__(
        self,
        problem: Callable[[float], Problem],
        journal: Path | None,
        key: str,
        tell: Tell,
    ):
        self._problem, self._tell = problem, tell
        self._journal, self._key = journal, key
        self._known: dict[float, Best] = {}
        self._finished: dict[str, list] = {}
        self.steps = 0
        if journal is not None:
            # One that cannot be read is as good as none: the fit begins anew.
            with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
                content = json.loads(journal.read_text(encoding="utf-8"))
                if content["key"] == key:
                    self._finished = dict(content["found"])

    def first(self, starts: Sequence[Numbers]) -> Best:
        """Best point for the first weight, from the best of several starts."""

        def best() -> Best:
            tried = [self._searched(FIRST_WEIGHT, start) for start in starts]
            nearest = min(tried, key=lambda found: found.cost)
            return self._searched(FIRST_WEIGHT, nearest.point)

        return self._once(FIRST_WEIGHT, best)

    def along(self, weight: float) -> Best:
        """Best point for a weight, from the nearest of the front so far."""

        def best() -> Best:
            near = min(self._known, key=lambda other: abs(math.log(other / weight)))
            return self._searched(weight, self._known[near].point)

        return self._once(weight, best)

    def within(self, bound: float) -> float:
        """Weight at which the detail loss is at its bound, or not far below.

        **Errors:** `NoFitError` where no weight leads so low.
        """

        def excess(log_weight: float) -> float:
            weight = float(f"{math.exp(log_weight):.6g}")  # known ones are found
            return math.log(self.along(weight).detail_loss / bound)

        least = lambda: min(best.detail_loss for best in self._known.values())
        for weight in _FURTHER_WEIGHTS:
            if least() > bound:
                self.along(weight)
        if least() > bound:
            raise NoFitError(
                "detail loss must be at least "
                f"{_checks.apart(least(), bound, spec='3f')} times that of no "
                f"anti-aliasing, the least that this family reaches, got {bound:g}."
            )
        for low, high in itertools.pairwise(sorted(self._known)):
            losses = (self._known[weight].detail_loss for weight in (low, high))
            if next(losses) > bound >= next(losses):
                ends = math.log(low), math.log(high)
                scipy.optimize.brentq(excess, *ends, xtol=0.02, maxiter=6, disp=False)
                break
        allowed = bound * (1 + _BOUND_TOLERANCE)
        good = [w for w, best in self._known.items() if best.detail_loss <= allowed]
        return min(good, key=lambda weight: self._known[weight].flicker)

    def polished(self, weight: float, bound: float) -> tuple[Numbers, Errors]:
        """Take Newton's step from a point of the front, unless it leaves the bound.

        Curvatures are differences of each session's gradient: where residuals do not
        vanish, Gauss and Newton's are too steep.
        """
        point = self._known[weight].point
        here = self._measured(weight, point)
        gradients = here.gradients()
        columns = [
            self._measured(weight, point + step).gradients() - gradients
            for step in _DIFFERENCE * np.eye(len(point))
        ]
        curvatures = np.stack(columns, axis=-1) / _DIFFERENCE
        newton = point + newton_step(gradients, curvatures)
        there = self._measured(weight, newton)
        is_within = there.relative[..., 1].mean() <= bound * (1 + _BOUND_TOLERANCE)
        if there.cost < here.cost and is_within:
            point, gradients = newton, there.gradients()
        space = self._problem(weight).space
        return point, errors(space, point, gradients, curvatures)

    def _once(self, weight: float, search: Callable[[], Best]) -> Best:
        """Search, unless that was done in this fit, or before it was interrupted."""
        if weight not in self._known:
            if (kept := self._finished.get(repr(weight))) is not None:
                self._known[weight] = Best(np.asarray(kept[0]), *kept[1:])
            else:
                self._known[weight] = search()
                self._keep(weight, self._known[weight])
        return self._known[weight]

    def _keep(self, weight: float, best: Best) -> None:
        self._finished[repr(weight)] = [best.point.tolist(), *best[1:]]
        if self._journal is not None:
            with written_atomically(self._journal) as unfinished:
                content = {"key": self._key, "found": self._finished}
                unfinished.write_text(json.dumps(content), encoding="utf-8")

    def _searched(self, weight: float, start: Numbers) -> Best:
        found = least_squares(
            self._problem(weight), start, tolerance=_TOLERANCE, most_steps=_MOST_STEPS
        )
        self.steps += found.steps
        here = self._measured(weight, found.point)
        means = here.relative.mean(axis=(0, 1))
        lag = f", lag {means[2]:.3f}" if len(means) > 2 else ""
        doing = (
            f"step {self.steps}: flicker {means[0]:.3f}, detail loss {means[1]:.3f}"
            f"{lag} of no anti-aliasing"
        )
        self._tell(Progress(doing=doing))
        flicker, loss = means[:2].tolist()
        return Best(found.point, flicker, loss, here.cost, found.why)

    def _measured(self, weight: float, point: Numbers) -> Linearized:
        self.steps += 1
        return self._problem(weight).at(point)
