"""Where the past is: Kim et al., equation (1).

The equation reads `P slerp(V_{n-1}, V_n, d) V_n^-1 P^-1 v`: a pixel's ray, turned back
by `1 - d` of the head's last increment, projected again. With pure rotation depth drops
out. `d = 1` is the current pose (no displacement), `d = 0` the previous one. Where the
eye moves as well, the transform between is rigid, and depth says how far a pixel goes.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from . import camera_bounds, quaternion
from ._types import RotationVector, Scalar
from .frames.displacement import AnyDisplacement, DisplacementField
from .frames.frame import Frame
from .frames.velocity import past_displacement


def past_position(
    frame: Frame,
    increment: RotationVector,
    closeness: Scalar,
    translation_m: Float[Array, "3"] | None = None,
) -> AnyDisplacement:
    """Where the past sample of each pixel lies in the previous frame.

    **Arguments:**

    - `frame`: the pixels; only its camera and region matter, and its depth where the
      eye moves.
    - `increment`: `log(q_{k-1}^-1 q_k)`, rad, shape `(3,)`.
    - `closeness`: Kim's d, in `[0, 1]`.
    - `translation_m`: how the eye moved, in the axes of the current pose, m; None asks
      for the rotation alone.

    **Returns:** the displacement `project(R(exp((1 - d) increment)) ray) - pixel`; with
    a translation t, of points p = depth x ray that stand still in the world, to
    `R(exp((1 - d) increment)) (p + (1 - d) t)`: a slerp of the rotations, and the eye's
    place linear in d.

    **Accuracy:** the slerp is a fraction of the increment, never the difference of two
    poses: float32 is right to 1e-3 px.

    **Source:** Kim et al., equation (1), and section 4.1 for six degrees of freedom.
    The paper's one sentence "closeness to V_{n-1}" contradicts its text and its
    equation; the equation rules.
    """
    increment = (1 - closeness) * increment
    if translation_m is None:
        return frame.displacement(increment)
    translation_m = (1 - closeness) * translation_m
    camera, region, depth = frame.camera, frame.region, frame.depth
    x, y = (i.astype(depth.dtype) + 0.5 for i in (region.columns(), region.rows()))
    dx, dy = past_displacement(camera, x, y, depth, increment, translation_m)
    # Bounds decide how a history is read, not what is read: they have no derivative.
    turn, move, nearest_m = jax.lax.stop_gradient(
        (increment, translation_m, jnp.min(depth))
    )
    shift = quaternion.angle(move) / nearest_m
    bounds = camera_bounds.displacement_range(camera, region, turn, shift)
    return DisplacementField(camera, region, dx, dy, bounds, frame.reading)
