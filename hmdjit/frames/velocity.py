"""Where what a pixel shows was in the last frame: of surfaces at some depth.

What is seen at a point p of the head's axes now lay at `R (p + t)` of its axes in the
last frame: R turns by the head's increment, t is its translation. What moves by itself
has an R and a t of its own.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .. import quaternion
from .._types import Numbers, RotationVector
from ..camera import Camera, moved_px
from .motion import Motion

_FAR_FRAMES = 4.0  # sides of the frame: farther than any source that can be read


def past_displacement(
    camera: Camera,
    x_px: Numbers,
    y_px: Numbers,
    depth: Numbers,
    increment: Float[Array, "*objects 3"],
    translation_m: Float[Array, "*objects 3"],
    object_id: Int[Array, "..."] | None = None,
) -> tuple[Numbers, Numbers]:
    """Where the surface points that pixels show projected in the last frame.

    **Arguments:**

    - `x_px`, `y_px`: pixel positions, px; any shapes that broadcast together.
    - `depth`: distance of each pixel's surface from the eye along -z, m, above 0; inf
      of what is too far to move with the head.
    - `increment`, `translation_m`: the head's, of `Motion` at a frame, shape `(3,)`; or
      one of each object, `(objects, 3)`, see `against_object`.
    - `object_id`: of the latter which is meant, a whole number per pixel.

    **Returns:** `(dx, dy)` from the positions, px. What lay behind the camera, or more
    than 4 frames aside, is put outside of the frame, at a finite place.

    **Accuracy:** relative precision however little anything moves; at an infinite depth
    the displacement of the rotation alone. Gradients are finite.
    """
    surface = (x_px, y_px, depth)
    dx, dy, _ = _moved(camera, surface, increment, translation_m, object_id)
    return dx, dy


def next_displacement(
    camera: Camera,
    x_px: Numbers,
    y_px: Numbers,
    depth: Numbers,
    increment: Float[Array, "*objects 3"],
    translation_m: Float[Array, "*objects 3"],
    object_id: Int[Array, "..."] | None = None,
) -> tuple[Numbers, Numbers, Numbers]:
    """Where the surface points that the last frame showed project now.

    The inverse of `past_displacement`, with its arguments: positions, depth and ids are
    those of the last frame.

    **Returns:** `(dx, dy)` from the positions, px, and the depth now, m.
    """
    turn = lambda turned, moved: quaternion.rotate(quaternion.exp(turned), moved)
    for _ in increment.shape[:-1]:
        turn = jax.vmap(turn)
    surface, back = (x_px, y_px, depth), -turn(increment, translation_m)
    return _moved(camera, surface, -increment, back, object_id)


def _moved(
    camera: Camera,
    surface: tuple[Numbers, Numbers, Numbers],
    increment: Float[Array, "*objects 3"],
    translation_m: Float[Array, "*objects 3"],
    object_id: Int[Array, "..."] | None,
) -> tuple[Numbers, Numbers, Numbers]:
    """How far surface points move on the screen, and their depth after that."""
    x_px, y_px, depth = surface
    dtype = increment.dtype
    turn, move = quaternion.matrix_minus_identity, translation_m
    if object_id is None:
        turn = turn(increment)
    else:
        turn = jnp.moveaxis(jax.vmap(turn)(increment)[object_id], (-2, -1), (0, 1))
        move = jnp.moveaxis(translation_m[object_id], -1, 0)
    focal = jnp.asarray(camera.focal_px, dtype)
    ray_x = (x_px - jnp.asarray(camera.width_px / 2, dtype)) / focal
    ray_y = (jnp.asarray(camera.height_px / 2, dtype) - y_px) / focal
    is_far = depth == jnp.inf  # where no derivative may be infinite either
    nearness = jnp.where(is_far, 0.0, 1 / jnp.where(is_far, 1.0, depth))
    shift = [nearness * move[i] for i in range(3)]
    point = ray_x + shift[0], ray_y + shift[1], shift[2] - 1
    # R (point) - ray, of which R - I and the shift keep the digits.
    move_x, move_y, move_z = (
        turn[i, 0] * point[0] + turn[i, 1] * point[1] + turn[i, 2] * point[2] + shift[i]
        for i in range(3)
    )
    dx, dy, is_in_front = moved_px(focal, (ray_x, ray_y), (move_x, move_y, move_z))
    far = _FAR_FRAMES * max(camera.width_px, camera.height_px)
    is_behind = ~is_in_front & ~jnp.isnan(dx)
    dx = jnp.where(is_behind, far, jnp.clip(dx, -far, far))
    return dx, jnp.clip(dy, -far, far), depth * (1 - move_z)


def against_object(
    motion: Motion,
    place_m: Float[Array, "3"],
    turned: RotationVector,
    moved_m: Float[Array, "3"],
) -> tuple[RotationVector, Float[Array, "3"]]:
    """Increment and translation of a head against an object that moves by itself.

    **Arguments:** of the object, in the axes of the hold pose:

    - `place_m`: its origin now, from the eye's place in the hold pose, m.
    - `turned`, `moved_m`: how it turned, and its origin moved, since the last frame,
      rad and m.

    **Returns:** what `past_displacement` asks for; of an object at rest, the head's.
    """
    still = jnp.zeros_like(motion.offset)
    eye_m = still if motion.position_m is None else motion.position_m
    step_m = still if motion.translation_m is None else motion.translation_m
    to_head = quaternion.conjugate(quaternion.exp(motion.offset))
    in_head = lambda vector: quaternion.rotate(to_head, vector)
    place_m, turned = in_head(place_m - eye_m), in_head(turned)
    step_m = step_m - in_head(moved_m)
    swing = quaternion.matrix_minus_identity(turned)
    increment = quaternion.multiply(
        quaternion.exp(motion.increment), quaternion.exp(-turned)
    )
    return quaternion.log(increment), step_m + swing @ (place_m + step_m)
