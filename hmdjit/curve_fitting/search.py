"""Searching a space of curves: least squares by Levenberg-Marquardt.

Each step asks for residuals and slopes at one point. They are measured outside of the
solver, scene by scene, with progress in between; the solver sees them as the linear
function that they are to it. An interrupted search therefore loses a step at most.
"""

import contextlib
import functools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array, Float

from .._files import written_atomically

Residuals = Float[np.ndarray, " residuals"]
Jacobian = Float[np.ndarray, "residuals numbers"]
Numbers = Float[np.ndarray, " numbers"]
Linearize = Callable[[Numbers], tuple[Residuals, Jacobian]]
"""Point to residuals, whose squares are summed, and their slopes."""

CONVERGED = "converged"

_DAMPING = 0.1  # of the largest curvature at the start
_FLAT = 1e-12  # a curvature, where there is none at all


class NoFitError(ValueError):
    """There is nothing to fit, or no curve fits; says why."""


class Found(NamedTuple):
    """Where a search ended.

    - `point`, `cost`: the best point, and its sum of squares.
    - `steps`: how often residuals were measured.
    - `why`: `"converged"`, or in words why not.
    """

    point: Numbers
    cost: float
    steps: int
    why: str


def _affine(point: Array, at: tuple) -> tuple[Array, None]:
    origin, residuals, slopes = at
    return residuals + slopes @ (point - origin), None


@functools.cache
def _solver(tolerance: float) -> Any:
    return optimistix.LevenbergMarquardt(rtol=tolerance, atol=tolerance)


@functools.cache
def _fresh_state(solver: Any, numbers: int, residuals: int, dtype: jnp.dtype) -> Any:
    """State before the first step; made once, for to compile is to know it again."""
    nowhere = jnp.zeros(numbers, dtype)
    shape = jax.ShapeDtypeStruct((residuals,), dtype)
    at = (nowhere, jnp.zeros(residuals, dtype), jnp.zeros((residuals, numbers), dtype))
    return solver.init(_affine, nowhere, at, {}, shape, None, frozenset())


@eqx.filter_jit
def _step(solver: Any, point: Array, at: tuple, state: Any) -> tuple:
    point, state, _ = solver.step(_affine, point, at, {}, state, frozenset())
    is_done, result = solver.terminate(_affine, point, at, {}, state, frozenset())
    return point, state, is_done, result


def least_squares(
    linearize: Linearize,
    start: Numbers,
    *,
    tolerance: float = 1e-3,
    most_steps: int = 30,
) -> Found:
    """Minimise a sum of squares from a start.

    **Arguments:** `tolerance`: of the point and of the residuals, relative and
    absolute, between accepted steps.

    **Errors:** `NoFitError` where a residual is not finite.

    **Source:** Levenberg-Marquardt as in `optimistix`, first damped in proportion to
    the largest curvature: Madsen, Nielsen and Tingleff, "Methods for Non-Linear Least
    Squares Problems", 2004, section 3.2.
    """
    solver = _solver(tolerance)
    # In JAX's own precision: the solver's other numbers have it.
    dtype = jnp.result_type(float)
    point = jnp.asarray(start, dtype)
    asked, state, why = point, None, ""
    costs: dict[bytes, float] = {}
    for _ in range(most_steps):
        residuals, slopes = linearize(np.asarray(asked))
        if not (np.isfinite(residuals).all() and np.isfinite(slopes).all()):
            raise NoFitError("the search met a curve that gives no finite number.")
        costs[np.asarray(asked).tobytes()] = float(np.sum(np.square(residuals)))
        at = (asked, jnp.asarray(residuals, dtype), jnp.asarray(slopes, dtype))
        if state is None:
            fresh = _fresh_state(solver, *slopes.shape[::-1], dtype)
            # The solver's own first damping, 1, is far above our curvatures.
            steepest = max(float(np.sum(np.square(slopes), axis=0).max()), _FLAT)
            trusted = jnp.asarray(1 / (_DAMPING * steepest), dtype)
            where = lambda s: (s.y_eval, s.search_state.step_size)
            state = eqx.tree_at(where, fresh, (point, trusted))
        point, state, is_done, result = _step(solver, point, at, state)
        asked = state.y_eval
        if bool(is_done):
            is_good = bool(result == optimistix.RESULTS.successful)
            why = CONVERGED if is_good else optimistix.RESULTS[result]
            break
    else:
        why = f"stopped after {most_steps} steps"
    found = np.asarray(point)
    return Found(found, costs[found.tobytes()], len(costs), why)


class Journal:
    """Finished searches of one fit, in a file."""

    def __init__(self, path: Path | None, key: str):
        self._path, self._key = path, key
        self._found: dict[str, list] = {}
        if path is not None:
            # One that cannot be read is as good as none: the fit begins anew.
            with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
                content = json.loads(path.read_text(encoding="utf-8"))
                if content["key"] == key:
                    self._found = dict(content["found"])

    def find(self, weight: float) -> Found | None:
        """Return a search that was finished before."""
        if (kept := self._found.get(repr(weight))) is None:
            return None
        point, *rest = kept
        return Found(np.asarray(point), *rest)

    def keep(self, weight: float, found: Found) -> None:
        """Keep a finished search."""
        self._found[repr(weight)] = [found.point.tolist(), *found[1:]]
        if self._path is not None:
            with written_atomically(self._path) as unfinished:
                content = {"key": self._key, "found": self._found}
                unfinished.write_text(json.dumps(content), encoding="utf-8")
