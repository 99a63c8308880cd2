"""How many sessions an error takes, and when an interim analysis may stop a study."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from scipy import stats

from .estimate import Estimate

FLOOR_MTCD = 0.005
"""Code values; no tolerance is below it, so that a uniform picture terminates."""

PATHS_PER_TILE = 150.0
"""Predicted paths that cost as much as one simulated tile.

Measured with the default study on two cores: 130 to 200. It is fixed, so that a plan
depends on no clock; near the optimum the cost is flat in it.
"""


@dataclasses.dataclass(frozen=True)
class Need:
    """What one number needs: a standard error, from two samples' variances.

    - `error`: the standard error that is asked for.
    - `session_variance`: of one simulated session's part in it.
    - `path_variance`: of one predicted path's part.
    """

    error: float
    session_variance: float
    path_variance: float


def sessions_needed(
    needs: Sequence[Need], session_cost: float, path_cost: float
) -> tuple[int, int]:
    """Sessions to simulate and paths to predict for the least work.

    With r paths for each session a number needs `n = (v + w / r) / e^2` sessions; the r
    that is cheapest for the hardest of all numbers is searched for.

    **Arguments:** cost of a session and of a path; path variances of 0 need none.

    **Returns:** `(n, m)`, sessions and paths.
    """
    session = np.array([need.session_variance / need.error**2 for need in needs])
    path = np.array([need.path_variance / need.error**2 for need in needs])
    if not path.any():
        return math.ceil(session.max()), 0
    per_session = np.geomspace(1e-2, 1e4, 241)
    count = np.max(session + path / per_session[:, None], axis=1)
    best = int(np.argmin(count * (session_cost + per_session * path_cost)))
    return math.ceil(count[best]), math.ceil(count[best] * per_session[best])


def interim_level(analysis: int) -> float:
    """Half-width of an interim analysis's intervals, in standard errors.

    Analysis k, counted from 1, may err with probability `0.05 / 2^k`: together no more
    than 5 %, however many there are (the union bound). The first, which nearly always
    is the last, has 2.24 standard errors where a single one would have 1.96.
    """
    return float(stats.norm.isf(0.025 / 2**analysis))


def figure_of_merit(estimate: Estimate, seconds: float) -> float:
    """`1 / (relative error^2 x seconds)`, 1/s; NaN where there is no error."""
    relative = estimate.standard_error / abs(estimate.value) if estimate.value else 0.0
    return 1 / (relative**2 * seconds) if relative and seconds else math.nan
