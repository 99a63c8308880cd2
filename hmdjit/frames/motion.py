"""Head motion at a frame and along a session, from checked poses."""

import equinox as eqx
import jax
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
    - `position_m`: where the eye is, from its place in the hold pose and in that pose's
      axes; None where a head only turns.
    - `translation_m`: how it moved since the last frame, in the head's axes now; 0 at
      the first frame. Kept, for the difference of two positions has fewer digits.
    """

    offset: Float[Array, "*frames 3"]
    increment: Float[Array, "*frames 3"]
    position_m: Float[Array, "*frames 3"] | None = None
    translation_m: Float[Array, "*frames 3"] | None = None

    @classmethod
    def of(cls, poses: Poses) -> "Motion":
        """Motion of a session; the first pose is the hold pose.

        **Arguments:** `poses`: `world_from_head`, `wxyz` of unit length, and where it
        is known the eye's position, m; shape `(frames, 4)` or `(frames, 7)`.
        """
        turns = poses[:, :4]
        turned = cls(quaternion.offsets(turns), quaternion.increments(turns))
        if poses.shape[1] == 4:
            return turned
        place = poses[:, 4:]
        moved = jnp.concatenate([jnp.zeros_like(place[:1]), jnp.diff(place, axis=0)])
        back = jax.vmap(quaternion.conjugate)(turns)
        rotate = jax.vmap(quaternion.rotate)
        held = jnp.broadcast_to(back[:1], back.shape)
        position_m = rotate(held, place - place[:1])
        return cls(turned.offset, turned.increment, position_m, rotate(back, moved))

    def turning(self) -> "Motion":
        """Return the same motion of a head that only turns."""
        return Motion(self.offset, self.increment)


def rebased_motion(
    poses: Float[np.ndarray, "frames components"], dtype: DTypeLike
) -> Motion:
    """Motion of recorded poses, re-based to the first in float64 before rounding.

    **Arguments:** `poses`: as `Motion.of`; `dtype`: of the result.
    """
    near = quaternion.rebase(np.asarray(poses, np.float64))
    return Motion.of(jnp.asarray(near, dtype))


def check_poses(poses: Array | np.ndarray) -> None:
    """Raise unless poses have a shape `(frames, 4)` or `(frames, 7)`, and a frame."""
    if poses.ndim != 2 or poses.shape[1] not in (4, 7):
        raise ValueError(
            "poses must have the shape (frames, 4), or (frames, 7) with positions, got "
            f"{tuple(poses.shape)}."
        )
    if not len(poses):
        raise ValueError("poses must have at least 1 row, got 0.")


def checked_motion(
    poses: Poses | Float[np.ndarray, "frames components"], dtype: DTypeLike
) -> Motion:
    """Motion of poses: checked and re-based in float64 unless they are being traced.

    **Errors:** `ValueError` for concrete poses that are not unit quaternions, or whose
    positions are not finite; NaN in the place of those that are being traced.
    """
    if _checks.is_traced(poses):
        poses = jnp.asarray(poses, dtype)
        length = jnp.sqrt(jnp.sum(poses[:, :4] ** 2, axis=1, keepdims=True))
        is_unit = jnp.abs(length - 1) <= _LENGTH_TOLERANCE
        return Motion.of(jnp.where(is_unit, poses, jnp.nan))
    concrete = np.array(poses, np.float64)
    norm = np.linalg.norm(concrete[:, :4], axis=1)
    worst = int(np.argmax(np.abs(norm - 1)))
    if not abs(norm[worst] - 1) <= _LENGTH_TOLERANCE:
        low, high = 1 - _LENGTH_TOLERANCE, 1 + _LENGTH_TOLERANCE
        raise ValueError(
            f"poses[{worst}] must have a length in [{low:g}, {high:g}], "
            f"got {_checks.apart(norm[worst], low, high)}."
        )
    lost = ~np.isfinite(concrete[:, 4:]).all(axis=1)
    if lost.any():
        row = int(np.argmax(lost))
        raise ValueError(
            f"poses[{row}] must have a finite position, got {concrete[row, 4:]}."
        )
    concrete[:, :4] /= norm[:, None]
    return rebased_motion(concrete, dtype)
