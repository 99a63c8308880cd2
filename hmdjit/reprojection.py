"""Where the past is: Kim et al., equation (1).

The equation reads `P slerp(V_{n-1}, V_n, d) V_n^-1 P^-1 v`: a pixel's ray, turned back
by `1 - d` of the head's last increment, projected again. With pure rotation depth drops
out. `d = 1` is the current pose (no displacement), `d = 0` the previous one.
"""

from ._types import RotationVector, Scalar
from .frames.displacement import Displacement
from .frames.frame import Frame


def past_position(
    frame: Frame, increment: RotationVector, closeness: Scalar
) -> Displacement:
    """Where the past sample of each pixel lies in the previous frame.

    **Arguments:**

    - `frame`: the pixels; only its camera and region matter.
    - `increment`: `log(q_{k-1}^-1 q_k)`, rad, shape `(3,)`.
    - `closeness`: Kim's d, in `[0, 1]`.

    **Returns:** the displacement `project(R(exp((1 - d) increment)) ray) - pixel`.

    **Accuracy:** the slerp is a fraction of the increment, never the difference of two
    poses: float32 is right to 1e-3 px.

    **Source:** Kim et al., equation (1). The paper's one sentence "closeness to
    V_{n-1}" contradicts its text and its equation; the equation rules.
    """
    return frame.displacement((1 - closeness) * increment)
