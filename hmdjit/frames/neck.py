"""Where the eye is when a head turns on its neck."""

import equinox as eqx
import jax
import jax.numpy as jnp

from .. import _checks, quaternion
from .._types import Scalar
from .motion import Motion


class NeckModel(eqx.Module):
    """A head that turns about one point below and behind the eye.

    - `up_m`, `forward_m`: the eye from that point while the head is upright, m.

    **Source:** the defaults are those of Google's Cardboard and Daydream, for heads of
    which only the rotation is tracked.
    """

    up_m: Scalar = eqx.field(converter=_checks.number, default=0.075)
    forward_m: Scalar = eqx.field(converter=_checks.number, default=0.0805)

    def __check_init__(self):
        _checks.in_range("up_m", self.up_m, -1, 1)
        _checks.in_range("forward_m", self.forward_m, -1, 1)

    def moved(self, motion: Motion) -> Motion:
        """Add where the eye is to the motion of a session, unless that is known.

        **Accuracy:** positions and their changes keep their relative precision however
        little the head turns.
        """
        if motion.position_m is not None:
            return motion
        eye = jnp.array([0.0, self.up_m, -self.forward_m], motion.offset.dtype)
        turn = quaternion.matrix_minus_identity
        turned = jax.vmap(lambda r: jnp.sum(turn(r) * eye[None], axis=1))
        return Motion(
            motion.offset,
            motion.increment,
            turned(motion.offset),
            -turned(-motion.increment),
        )
