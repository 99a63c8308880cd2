"""Pinhole camera and regions: pixel <-> ray, displacement and homography of a rotation.

A pixel position `(x, y)` is continuous; pixel (column i, row j) has its centre at
`(i + 0.5, j + 0.5)`, row 0 on top. Its ray in the head frame (x right, y up, -z
forward) is `((x - W/2) / f, (H/2 - y) / f, -1)` with `f = (W/2) / tan(fov / 2)` px.
"""

import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from . import _checks, quaternion
from ._types import Numbers, RotationVector, Scalar, WholeNumber


class Camera(eqx.Module):
    """A display's camera: square pixels, pinhole, centred.

    - `width_px`, `height_px`: resolution; whole pixels, at least 1.
    - `fov_deg`: horizontal field of view; degrees, in `(0, 180)`.
    - `refresh_hz`: frames per second; Hz, above 0.

    The defaults are the camera of the default study: 8.05 px/deg in the centre.
    """

    width_px: int = eqx.field(static=True, default=1024)
    height_px: int = eqx.field(static=True, default=1024)
    fov_deg: Scalar = eqx.field(converter=_checks.number, default=96.0)
    refresh_hz: Scalar = eqx.field(converter=_checks.number, default=60.0)

    def __check_init__(self):
        _checks.whole("width_px", self.width_px, 1)
        _checks.whole("height_px", self.height_px, 1)
        _checks.in_range("fov_deg", self.fov_deg, 0, 180, open_low=True, open_high=True)
        _checks.in_range("refresh_hz", self.refresh_hz, 0, open_low=True)

    @property
    def focal_px(self) -> Scalar:
        """Focal length `(W/2) / tan(fov/2)`, px."""
        # Near 180 degrees the cotangent of the rest keeps the digits that pi / 2 - half
        # would lose: 292 eps at 179.9 degrees.
        rest = 180 - self.fov_deg
        is_wide = self.fov_deg > 90
        if isinstance(self.fov_deg, jax.Array):
            tangent = jnp.tan(jnp.where(is_wide, rest, self.fov_deg) * (np.pi / 360))
            return self.width_px / 2 * jnp.where(is_wide, tangent, 1 / tangent)
        tangent = float(np.tan((rest if is_wide else self.fov_deg) * (np.pi / 360)))
        return self.width_px / 2 * (tangent if is_wide else 1 / tangent)

    @property
    def is_valid(self) -> Bool[Array, ""] | bool:
        """Whether its numbers are in range: known only while running inside `jit`."""
        is_rate = (self.refresh_hz > 0) & (self.refresh_hz < math.inf)
        return (self.fov_deg > 0) & (self.fov_deg < 180) & is_rate

    @property
    def frame_time_s(self) -> Scalar:
        """Time from one frame to the next, s."""
        return 1.0 / self.refresh_hz


class Region(eqx.Module):
    """The part of the camera frame that is simulated: the whole frame or a tile.

    - `x0`, `y0`: column and row of its first pixel (numbers: one compilation serves all
      tiles).
    - `width`, `height`: its shape; static.
    """

    x0: WholeNumber
    y0: WholeNumber
    width: int = eqx.field(static=True)
    height: int = eqx.field(static=True)

    @classmethod
    def whole(cls, camera: Camera) -> "Region":
        """Return the whole camera frame."""
        return cls(0, 0, camera.width_px, camera.height_px)

    def is_in(self, other: "Region") -> Bool[Array, "height width"]:
        """Which of its pixels lie in another region."""
        x, y = self.columns() - other.x0, self.rows() - other.y0
        return (x >= 0) & (x < other.width) & (y >= 0) & (y < other.height)

    def columns(self) -> Numbers:
        """Column of each pixel in the camera frame, shape `(1, width)`, int32."""
        return (self.x0 + jnp.arange(self.width, dtype=jnp.int32))[None, :]

    def rows(self) -> Numbers:
        """Row of each pixel in the camera frame, shape `(height, 1)`, int32."""
        return (self.y0 + jnp.arange(self.height, dtype=jnp.int32))[:, None]


@jax.jit
def pixel_to_ray(camera: Camera, position_px: Float[Array, "2"]) -> Float[Array, "3"]:
    """Ray of a pixel position in the head frame, with `z = -1`.

    **Arguments:** `position_px`: `(x, y)`, px, shape `(2,)`.

    **Returns:** shape `(3,)`, not normalised.
    """
    x, y = position_px
    focal = camera.focal_px
    return jnp.stack(
        [
            (x - camera.width_px / 2) / focal,
            (camera.height_px / 2 - y) / focal,
            -jnp.ones_like(x),
        ]
    )


@jax.jit
def ray_to_pixel(camera: Camera, ray: Float[Array, "3"]) -> Float[Array, "2"]:
    """Pixel position where a ray of the head frame meets the image plane.

    **Arguments:** `ray`: any length, shape `(3,)`, in front of the camera (`z < 0`).

    **Returns:** `(x, y)`, px, shape `(2,)`; NaN for a ray that is not in front.
    """
    in_front = ray[2] < 0
    scale = camera.focal_px / jnp.where(in_front, -ray[2], 1.0)
    x = camera.width_px / 2 + ray[0] * scale
    y = camera.height_px / 2 - ray[1] * scale
    return jnp.where(in_front, jnp.stack([x, y]), jnp.nan)


@jax.jit
def homography(camera: Camera, rotation: RotationVector) -> Float[Array, "3 3"]:
    """Matrix that takes pixels `(x, y, 1)` to where their rotated rays project.

    **Arguments:** `rotation`: rotation vector applied to the rays, rad, shape `(3,)`.

    **Returns:** `K R K^-1`, shape `(3, 3)`, homogeneous.

    **Accuracy:** use `displacement` where a fraction of a pixel matters in float32.
    """
    focal = camera.focal_px
    x, y = camera.width_px / 2, camera.height_px / 2
    dtype = rotation.dtype
    to_ray = jnp.array([[1, 0, -x], [0, -1, y], [0, 0, -focal]], dtype) / focal
    # A ray (a, b, c) projects to (W/2 - f a / c, H/2 + f b / c).
    to_pixel = jnp.array([[-focal, 0, x], [0, focal, y], [0, 0, 1]], dtype)
    # K (R - I) K^-1, and K K^-1 = -I: else what the two do not cancel would stay.
    turn = quaternion.matrix_minus_identity(rotation)
    return to_pixel @ turn @ to_ray - jnp.eye(3, dtype=dtype)


@jax.jit
def displacement(
    camera: Camera, rotation: RotationVector, x_px: Numbers, y_px: Numbers
) -> tuple[Numbers, Numbers, Bool[Array, "..."]]:
    """How far a rotation of their rays moves pixels, without cancellation.

    **Arguments:**

    - `rotation`: rotation vector applied to the rays, rad, shape `(3,)`.
    - `x_px`, `y_px`: pixel positions, px; any shapes that broadcast together.

    **Returns:** `(dx, dy, in_front)`: where the rotated ray projects, relative to the
    position, px; and whether it is in front of the camera at all (behind it
    `dx = dy = 0`; NaN where the rotation is NaN).

    **Accuracy:** each keeps its relative precision however small the rotation is,
    which the difference of two projected positions near 1000 px does not.
    """
    return displacing(camera, rotation)(x_px, y_px)


def displacing(
    camera: Camera, rotation: RotationVector
) -> Callable[[Numbers, Numbers], tuple[Numbers, Numbers, Bool[Array, "..."]]]:
    """Return `displacement` as a function of position, its scalars computed already."""
    dtype = rotation.dtype
    focal = jnp.asarray(camera.focal_px, dtype)
    turn = quaternion.matrix_minus_identity(rotation)
    centre_x, centre_y = camera.width_px / 2, camera.height_px / 2

    def at(x_px: Numbers, y_px: Numbers) -> tuple[Numbers, Numbers, Array]:
        ray_x = (x_px - jnp.asarray(centre_x, dtype)) / focal
        ray_y = (jnp.asarray(centre_y, dtype) - y_px) / focal
        # The ray is (ray_x, ray_y, -1); (R - I) ray:
        move_x = turn[0, 0] * ray_x + turn[0, 1] * ray_y - turn[0, 2]
        move_y = turn[1, 0] * ray_x + turn[1, 1] * ray_y - turn[1, 2]
        move_z = turn[2, 0] * ray_x + turn[2, 1] * ray_y - turn[2, 2]
        return moved_px(focal, (ray_x, ray_y), (move_x, move_y, move_z))

    return at


def moved_px(
    focal: Scalar,
    ray: tuple[Numbers, Numbers],
    move: tuple[Numbers, Numbers, Numbers],
) -> tuple[Numbers, Numbers, Bool[Array, "..."]]:
    """How far a change of their rays moves pixels, without cancellation.

    **Arguments:** `focal`: px; `ray`: x and y of rays with `z = -1`; `move`: what is
    added to the rays, x, y and z.

    **Returns:** as `displacement`.
    """
    (ray_x, ray_y), (move_x, move_y, move_z) = ray, move
    depth = 1 - move_z
    # Asked this way round, a move that is not a number stays visible as NaN.
    is_behind = depth <= 0
    scale = focal / jnp.where(is_behind, 1.0, depth)
    dx = jnp.where(is_behind, 0.0, scale * (move_x + ray_x * move_z))
    dy = jnp.where(is_behind, 0.0, -scale * (move_y + ray_y * move_z))
    return dx, dy, depth > 0


@jax.jit
def px_per_deg(camera: Camera, position_px: Float[Array, "2"]) -> Float[Array, "2"]:
    """How fast the picture moves at a position when the head turns.

    **Arguments:** `position_px`: `(x, y)`, px, shape `(2,)`.

    **Returns:** px of picture motion per degree of yaw and per degree of pitch,
    shape `(2,)`. A 1024 px / 96 deg camera has 8.05 in the centre, 17.97 at the side.
    """
    ray = pixel_to_ray(camera, position_px)
    x, y = ray[0], ray[1]
    scale = camera.focal_px * (np.pi / 180)
    yaw = jnp.hypot(1 + x**2, x * y)
    pitch = jnp.hypot(1 + y**2, x * y)
    return scale * jnp.stack([yaw, pitch])
