"""Which curve a device blends by, from what its sessions were seen to do."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..frames.texture import Texture
from .errors import Errors, errors
from .problem import Problem
from .search import NoFitError, Numbers, least_squares
from .space import CurveSpace
from .viewing import Viewing, stacked

_TOLERANCE = 1e-3
_LEAST = 1e-6  # code values, and their squares: float32 pictures are rounded by 1e-5


class Recovered(NamedTuple):
    """The curve that explains what was seen best.

    - `point`: of the space; `numbers`, `errors`: in the order of `space.names`.
    - `why`: how the search ended.
    """

    point: Numbers
    numbers: Numbers
    errors: Errors
    why: str


def recover(
    space: CurveSpace,
    textures: Sequence[Texture],
    viewing: Viewing,
    observed: Float[np.ndarray, "scenes sessions measures"],
    start: Numbers | None = None,
) -> Recovered:
    """Find the curve whose sessions are most like observed ones, by least squares.

    **Arguments:**

    - `viewing`: the heads and tiles of the observed sessions.
    - `observed`: MTCD, detail loss and, with turned paths, lag, in code values and code
      values squared, with errors that are independent between sessions and alike
      relative to each measure's mean.
    - `start`: a point of the space; None is Kim et al.'s constants.

    **Errors:** `NoFitError` for too few sessions, for a picture that does not flicker,
    and where a number is not finite.
    """
    sessions = observed.shape[1]
    if sessions <= 2 * space.size:
        raise NoFitError(
            f"sessions must be more than {2 * space.size} to tell {space.size} numbers "
            f"of a curve, got {sessions}."
        )
    if not np.isfinite(observed).all():
        raise NoFitError("observed must be finite, got NaN or inf.")
    unit = observed.mean(axis=1, keepdims=True)
    if not np.all(unit > _LEAST):
        raise NoFitError(
            "observed must flicker and lose detail in every scene, by more than "
            f"{_LEAST:g}; got {np.min(unit):.2g}."
        )
    one = np.ones((1, 1, 1))
    problem = Problem(
        space, stacked(textures), viewing, unit, one, one, observed / unit
    )
    begun = np.asarray(space.starts()[0] if start is None else start)
    found = least_squares(problem, begun, tolerance=_TOLERANCE)
    here = problem.at(found.point)
    numbers = np.asarray(space.natural(jnp.asarray(found.point)))
    sure = errors(space, found.point, here.gradients(), here.curvatures())
    return Recovered(found.point, numbers, sure, found.why)
