"""Head motion at a frame and along a session, from checked poses."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from .. import _checks, quaternion
from .._types import Poses

_LENGTH_TOLERANCE = 0.01  # by which a pose's length may be off 1


class Motion(eqx.Module):
    """Head motion at a frame, or along a session with a leading `frames` axis.

    - `offset`: `log(q_hold^-1 q_k)`, rad: where the head points now.
    - `increment`: `log(q_{k-1}^-1 q_k)`, rad: how it turned since the last frame; 0 at
      the first frame.
    - `position_m`: where the eye is, from its place in the hold pose; None where a head
      only turns.
    """

    offset: Float[Array, "*frames 3"]
    increment: Float[Array, "*frames 3"]
    position_m: Float[Array, "*frames 3"] | None = None

    @classmethod
    def of(cls, poses: Poses) -> "Motion":
        """Motion of a session; the first pose is the hold pose.

        **Arguments:** `poses`: `world_from_head`, shape `(frames, 4)`, unit length.
        """
        return cls(quaternion.offsets(poses), quaternion.increments(poses))


def rebased_motion(poses: Float[np.ndarray, "frames 4"], dtype: DTypeLike) -> Motion:
    """Motion of recorded poses, re-based to the first in float64 before rounding.

    **Arguments:** `poses`: `world_from_head`, shape `(frames, 4)`; `dtype`: of the
    result.
    """
    near_identity = quaternion.rebase(np.asarray(poses, np.float64))
    return Motion.of(jnp.asarray(near_identity, dtype))


def check_poses(poses: Array | np.ndarray) -> None:
    """Raise unless poses have the shape `(frames, 4)`, with a frame at least."""
    if poses.ndim != 2 or poses.shape[1] != 4:
        raise ValueError(
            f"poses must have the shape (frames, 4), got {tuple(poses.shape)}."
        )
    if not len(poses):
        raise ValueError("poses must have at least 1 row, got 0.")


def checked_motion(
    poses: Poses | Float[np.ndarray, "frames 4"], dtype: DTypeLike
) -> Motion:
    """Motion of poses: checked and re-based in float64 unless they are being traced.

    **Errors:** `ValueError` for concrete poses that are not unit quaternions; NaN in
    the place of those that are being traced.
    """
    if _checks.is_traced(poses):
        poses = jnp.asarray(poses, dtype)
        length = jnp.sqrt(jnp.sum(poses**2, axis=1, keepdims=True))
        is_unit = jnp.abs(length - 1) <= _LENGTH_TOLERANCE
        return Motion.of(jnp.where(is_unit, poses, jnp.nan))
    concrete = np.asarray(poses, np.float64)
    norm = np.linalg.norm(concrete, axis=1)
    worst = int(np.argmax(np.abs(norm - 1)))
    if not abs(norm[worst] - 1) <= _LENGTH_TOLERANCE:
        low, high = 1 - _LENGTH_TOLERANCE, 1 + _LENGTH_TOLERANCE
        raise ValueError(
            f"poses[{worst}] must have a length in [{low:g}, {high:g}], "
            f"got {_checks.apart(norm[worst], low, high)}."
        )
    return rebased_motion(concrete / norm[:, None], dtype)
