"""Unit quaternions `wxyz`: algebra, exp, log, slerp, increments and offsets.

A pose is `world_from_head`. Head jitter is 1e-5 to 1e-2 rad per frame, where
`acos(dot)` loses the whole angle in float32: every function here goes through the
vector part, which keeps its relative precision however small the rotation is.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Float64
from scipy.spatial.transform import Rotation

from ._types import Path, Poses, Quaternion, RotationVector, Scalar

_Matrix = Float[Array, "3 3"]


def _small(dtype: jnp.dtype) -> float:
    # Below this squared angle the next term of every series used here is under eps.
    return float(jnp.finfo(dtype).eps) ** 0.5


def _sin_ratio(angle_squared: Float[Array, ""]) -> Float[Array, ""]:
    """`sin(a) / a` as a function of `a^2`, smooth at 0."""
    is_small = angle_squared < _small(angle_squared.dtype)
    # The inner `where` keeps the unused branch finite, or NaN leaks into gradients.
    angle = jnp.sqrt(jnp.where(is_small, 1.0, angle_squared))
    series = 1 - angle_squared / 6 * (1 - angle_squared / 20)
    return jnp.where(is_small, series, jnp.sin(angle) / angle)


@jax.jit
def multiply(left: Quaternion, right: Quaternion) -> Quaternion:
    """Hamilton product: first `right`, then `left`.

    **Arguments:** two quaternions `wxyz`, shape `(4,)`.

    **Returns:** their product, shape `(4,)`; not normalised: lengths multiply.
    """
    w, v = left[0], left[1:]
    other_w, other_v = right[0], right[1:]
    vector = w * other_v + other_w * v + jnp.cross(v, other_v)
    return jnp.concatenate([(w * other_w - v @ other_v)[None], vector])


@jax.jit
def conjugate(q: Quaternion) -> Quaternion:
    """Inverse of a unit quaternion; shape `(4,)`."""
    return jnp.concatenate([q[:1], -q[1:]])


@jax.jit
def rotate(q: Quaternion, vector: Float[Array, "3"]) -> Float[Array, "3"]:
    """Rotate a vector by a unit quaternion, `q v q*`; shape `(3,)`, same units."""
    twice = 2 * jnp.cross(q[1:], vector)
    return vector + q[0] * twice + jnp.cross(q[1:], twice)


@jax.jit
def exp(rotation: RotationVector) -> Quaternion:
    """Return the unit quaternion of a rotation vector.

    **Arguments:** `rotation`: axis times angle, rad, shape `(3,)`.

    **Returns:** unit quaternion `wxyz`, shape `(4,)`.

    **Accuracy:** relative precision of the vector part up to half a turn; beyond, an
    error of about eps x angle. Gradients are finite at 0.
    """
    half = 0.5 * rotation
    angle_squared = half @ half
    vector = _sin_ratio(angle_squared) * half
    is_small = angle_squared < _small(rotation.dtype)
    cosine = jnp.cos(jnp.sqrt(jnp.where(is_small, 1.0, angle_squared)))
    series = 1 - angle_squared / 2 * (1 - angle_squared / 12)
    return jnp.concatenate([jnp.where(is_small, series, cosine)[None], vector])


@jax.jit
def log(q: Quaternion) -> RotationVector:
    """Rotation vector of a unit quaternion, along the shorter arc.

    **Arguments:** `q`: unit quaternion `wxyz`, shape `(4,)`; `q` and `-q` agree. A
    length that is off 1 cancels.

    **Returns:** rotation vector, rad, shape `(3,)`, length in `[0, pi]`; 0 for both
    `1` and `-1`, NaN for a length of 0.

    **Accuracy:** relative precision at every angle; gradients are finite at 0. At half
    a turn both arcs are equally short and either axis is right: that of `q` as given.

    **Source:** `2 atan2(|v|, w)`; `acos(w)` loses the angle below 3e-4 rad in float32.
    """
    q = jnp.where(q[0] < 0, -q, q)
    w, v = q[0], q[1:]
    sine_squared = v @ v
    # A denormal squares to 0; the threshold is relative to w, so length cancels.
    is_small = sine_squared < _small(q.dtype) * w**2
    sine = jnp.sqrt(jnp.where(is_small, 1.0, sine_squared))
    # atan(t) / t = 1 - t^2/3 + t^4/5 - ..., t = |v| / w
    safe_w = jnp.where(is_small, w, 1.0)
    t_squared = sine_squared / safe_w**2
    series = (1 - t_squared * (1 / 3 - t_squared / 5)) / safe_w
    return 2 * v * jnp.where(is_small, series, jnp.arctan2(sine, w) / sine)


@jax.jit
def angle(rotation: RotationVector) -> Scalar:
    """Length of a rotation vector, rad; its gradient at 0 is chosen as exactly 0."""
    # Scaling first keeps 1e-30 rad from vanishing when squared.
    largest = jnp.max(jnp.abs(rotation))
    is_zero = largest == 0
    scale = jax.lax.stop_gradient(jnp.where(is_zero, 1.0, largest))
    scaled = rotation / scale
    length = scale * jnp.sqrt(jnp.where(is_zero, 1.0, scaled @ scaled))
    return jnp.where(is_zero, 0.0, length)


@jax.jit
def relative(start: Quaternion, end: Quaternion) -> Quaternion:
    """Rotation from one orientation to another, `start^-1 end`, with `w >= 0`.

    **Arguments:** two unit quaternions `wxyz`, shape `(4,)`.

    **Returns:** unit quaternion, shape `(4,)`, in the frame of `start`.

    **Accuracy:** the vector part is formed from `end - start`: exactly 0 for equal
    orientations (the plain product leaves 1e-10 where XLA fuses multiply and add), and
    not rounded further for close ones.
    """
    end = jnp.where(start @ end < 0, -end, end)
    w, v = start[0], start[1:]
    change = end - start
    vector = w * change[1:] - change[0] * v - jnp.cross(v, change[1:])
    return jnp.concatenate([(start @ end)[None], vector])


@jax.jit
def slerp(start: Quaternion, end: Quaternion, fraction: Scalar) -> Quaternion:
    """Interpolate between two orientations along the shorter great-circle arc.

    **Arguments:**

    - `start`: orientation at `fraction = 0`; shape `(4,)`, unit length.
    - `end`: orientation at `fraction = 1`; shape `(4,)`, unit length.
    - `fraction`: dimensionless position on the arc; outside `[0, 1]` extrapolates.

    **Returns:** the orientation, shape `(4,)`, unit length up to rounding.

    **Accuracy:** gradients are finite everywhere, including `start == ±end`.

    **Source:** Shoemake, "Animating Rotation with Quaternion Curves", SIGGRAPH 1985,
    in the form `start * exp(fraction * log(start^-1 end))`.
    """
    return multiply(start, exp(fraction * log(relative(start, end))))


@jax.jit
def offsets(poses: Poses) -> Path:
    """Rotation from the first pose to each pose, in the first pose's frame.

    **Arguments:** `poses`: `world_from_head`, shape `(frames, 4)`, unit length.

    **Returns:** `log(q_0^-1 q_k)`, rad, shape `(frames, 3)`; the first is 0.

    **Accuracy:** absolute error of about eps x (angle between pose and the world's
    axes): hand float32 poses over near the identity, or see `rebase`.
    """
    return jax.vmap(lambda q: log(relative(poses[0], q)))(poses)


@jax.jit
def increments(poses: Poses) -> Path:
    """Rotation from each frame to the next, in the former's head frame.

    **Arguments:** `poses`: `world_from_head`, shape `(frames, 4)`, unit length.

    **Returns:** `log(q_{k-1}^-1 q_k)`, rad, shape `(frames, 3)`; the first is 0.
    """
    steps = jax.vmap(lambda last, q: log(relative(last, q)))(poses[:-1], poses[1:])
    return jnp.concatenate([jnp.zeros((1, 3), poses.dtype), steps])


@jax.jit
def matrix_minus_identity(rotation: RotationVector) -> _Matrix:
    """Return `R - I` of a rotation vector, without cancellation.

    **Arguments:** `rotation`: rad, shape `(3,)`.

    **Returns:** shape `(3, 3)`; up to about 1 rad each entry keeps its relative
    precision, which `R` itself loses below 1e-4 rad in float32. Near half a turn
    entries cancel: their error is then about eps of 1.

    **Source:** Rodrigues: `R - I = sinc(a) [r]x + 2 (sin(a/2) / a)^2 [r]x^2`.
    """
    x, y, z = rotation
    xx, yy, zz = x * x, y * y, z * z
    angle_squared = xx + yy + zz
    # Written out, with [r]x^2 = r r' - |r|^2: it is done per frame and source, where
    # one product of small matrices costs as much as all the rest.
    first = _sin_ratio(angle_squared)
    second = 0.5 * _sin_ratio(angle_squared / 4) ** 2
    rows = [
        [-second * (yy + zz), second * x * y - first * z, second * x * z + first * y],
        [second * x * y + first * z, -second * (xx + zz), second * y * z - first * x],
        [second * x * z - first * y, second * y * z + first * x, -second * (xx + yy)],
    ]
    return jnp.stack([jnp.stack(row) for row in rows])


def rebase(
    poses: Float64[np.ndarray, "frames components"],
) -> Float64[np.ndarray, "frames components"]:
    """Turn recorded poses so that the first one is the identity, in float64 NumPy.

    Two absolute float32 poses leave four digits of a 1e-4 rad increment. Poses near
    the identity keep them all: call this at the door, before float32.

    **Arguments:** `poses`: `world_from_head`, unit length, and where it is known the
    eye's position; shape `(frames, 4)` or `(frames, 7)`.

    **Returns:** `q_0^-1 q_k`, with `w >= 0`, and the position from the first one, in
    the first pose's axes; same shape.
    """
    w, v = poses[0, 0], -poses[0, 1:4]
    other_w, other_v = poses[:, :1], poses[:, 1:4]
    scalar = w * other_w - other_v @ v[:, None]
    vector = w * other_v + other_w * v + np.cross(v, other_v)
    relative = np.concatenate([scalar, vector], axis=1)
    relative = relative * np.where(relative[:, :1] < 0, -1.0, 1.0)
    place = poses[:, 4:] - poses[0, 4:]
    if place.size:
        place = Rotation.from_quat(poses[0, :4], scalar_first=True).inv().apply(place)
    return np.concatenate([relative, place], axis=1)
