"""What a search makes small: a mean over scenes and sessions of squared residuals."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..frames.texture import Texture
from ..simulation.sharding import program
from .search import Numbers
from .space import CurveSpace, Point
from .viewing import Viewing, values_and_slopes

_LEAST = 1e-12  # of a measure: the slope of its root stays finite


class Linearized(NamedTuple):
    """Residuals at a point, their slopes, and the measures that they are made of.

    - `relative`: the measures, in their units.
    """

    residuals: Float[np.ndarray, "scenes sessions measures"]
    slopes: Float[np.ndarray, "scenes sessions measures numbers"]
    relative: Float[np.ndarray, "scenes sessions measures"]

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(np.sum(np.square(self.residuals)))

    def gradients(self) -> Float[np.ndarray, "sessions numbers"]:
        """Half the gradient of each session's part of the cost."""
        return np.einsum("csm,csmp->sp", self.residuals, self.slopes)

    def curvatures(self) -> Float[np.ndarray, "sessions numbers numbers"]:
        """Half the curvature of each session's part, as if residuals had none."""
        return np.einsum("csmp,csmq->spq", self.slopes, self.slopes)


class Problem(eqx.Module):
    """Curves to choose from, the sessions they are judged by, and how.

    A residual is `(weight measure / unit)^power - target`; `viewing.values` says what
    is measured. These have the axes scene, session and measure, 1 where all are alike.
    """

    space: CurveSpace
    textures: Texture
    viewing: Viewing
    unit: Float[np.ndarray | Array, "scenes 1 measures"]
    weight: Float[np.ndarray | Array, "1 1 #measures"]
    power: Float[np.ndarray | Array, "1 1 #measures"]
    target: Float[np.ndarray | Array, "#scenes #sessions #measures"]

    def __call__(self, point: Point) -> tuple[Array, Array]:
        """Residuals in a row, and their slopes, in the precision of the point."""
        residuals, slopes, _ = self._linearized(point)
        return residuals.reshape(-1), slopes.reshape(-1, self.space.size)

    def at(self, point: Numbers) -> Linearized:
        """Measure flicker, detail loss and their slopes at a point."""
        found = _at(self, jnp.asarray(point, jnp.result_type(float)))
        return Linearized(*(np.asarray(part, float) for part in found))

    def _linearized(self, point: Point) -> tuple[Array, Array, Array]:
        own = point.astype(self.viewing.motion.offset.dtype)
        found = values_and_slopes(self.space, own, self.textures, self.viewing)
        measured, slopes = (part.astype(point.dtype) for part in found)
        unit, weight, power, target = (
            jnp.asarray(part, point.dtype)
            for part in (self.unit, self.weight, self.power, self.target)
        )
        relative = measured / unit
        weighted = jnp.maximum(weight * relative, _LEAST)
        root = weighted**power
        of_root = (power * root / weighted * weight / unit)[..., None] * slopes
        # A mean is what counts, however many sessions and scenes there are.
        share = 1 / np.sqrt(measured.shape[0] * measured.shape[1])
        return share * (root - target), share * of_root, relative


@program()
def _at(problem: Problem, point: Point) -> tuple[Array, Array, Array]:
    return problem._linearized(point)
