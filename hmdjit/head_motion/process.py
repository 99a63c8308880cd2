"""How a head that tries to hold still moves: a stochastic process.

Per axis an Ornstein-Uhlenbeck angular velocity `v`, integrated to an angle `x` that a
very weak spring returns, `dv = -v / tau dt + sqrt(2 s^2 / tau) dW` and
`dx = (v - x / T_r) dt`, seen by a tracker with white angle noise per sampled frame.

Arrays per axis are ordered pitch (x), yaw (y), roll (z). A state is `(x, v)`, in units
of `s tau` and `s`: without units its numbers stay near 1 at every rate.
"""

from collections.abc import Iterable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, DTypeLike, Float

from .. import _checks, quaternion
from .._types import Path, Poses, RandomKey, Scalar
from .base import discretise

_AXES = ("pitch", "yaw", "roll")
_PerAxis = tuple[Scalar, Scalar, Scalar]


class _System(NamedTuple):
    """The process of the median person, per axis, as a linear system."""

    angle_unit_deg: Float[Array, "3"]
    tracker_noise_deg: Float[Array, "3"]
    drift: Float[Array, "3 2 2"]
    diffusion: Float[Array, "3 2 2"]
    stationary: Float[Array, "3 2 2"]

    def sampled(self, dt_s: Scalar) -> tuple[Array, Array]:
        return jax.vmap(discretise, (0, 0, None))(self.drift, self.diffusion, dt_s)


def _per_axis(values: Iterable[Any]) -> tuple[Any, ...]:
    return tuple(_checks.number(value) for value in values)


class HeadMotion(eqx.Module):
    """Head motion of people who try to hold still, as one stochastic process.

    Per axis (pitch, yaw, roll):

    - `speed_rms_deg_s`: RMS of the angular velocity's Ornstein-Uhlenbeck process,
      deg/s, at least 0.
    - `correlation_time_s`: its correlation time, s, above 0.
    - `tracker_noise_deg`: RMS of the white angle noise per sampled frame, deg, at
      least 0; the same at every rate.

    For all axes:

    - `return_time_s`: time constant of the return to the hold pose, s, above 0.
    - `person_sd`: a session's person moves `exp(person_sd z)` times as much as the
      median one, z standard normal, in all axes; the tracker's noise does not scale.

    The laws below (`covariance`, spectra, ...) are those of the median person; over the
    population everything but the tracker's noise is multiplied by `person_power`. They
    have the precision of this model's numbers and are right to 1e-5 in float32, as long
    as `return_time_s` is not below `correlation_time_s`; the covariance of increments,
    which crosses 0, to 1e-5 of their variance.

    **Errors:** `ValueError` naming the field, the range and the value.
    """

    speed_rms_deg_s: _PerAxis = eqx.field(converter=_per_axis)
    correlation_time_s: _PerAxis = eqx.field(converter=_per_axis)
    tracker_noise_deg: _PerAxis = eqx.field(converter=_per_axis)
    return_time_s: Scalar = eqx.field(converter=_checks.number, default=15.0)
    person_sd: Scalar = eqx.field(converter=_checks.number, default=0.17)

    def __check_init__(self):
        for name in ("speed_rms_deg_s", "correlation_time_s", "tracker_noise_deg"):
            values = getattr(self, name)
            if len(values) != len(_AXES):
                raise ValueError(
                    f"{name} must have 3 numbers (pitch, yaw, roll), got {len(values)}."
                )
            for axis, value in zip(_AXES, values, strict=True):
                is_time = name == "correlation_time_s"
                _checks.in_range(f"{name} ({axis})", value, 0, open_low=is_time)
        _checks.in_range("return_time_s", self.return_time_s, 0, open_low=True)
        _checks.in_range("person_sd", self.person_sd, 0)

    @classmethod
    def seated(cls) -> "HeadMotion":
        """People seated with a supported back, waiting in a neutral pose.

        **Accuracy:** hits the recorded speeds (RMS 1.9 deg/s at 90 Hz); the wander in
        yaw is 25-35 % too large, that in roll 15-25 % too small; tails within minutes
        are too light (recorded excess kurtosis 2-4).

        **Source:** fitted to the spectra of 76 recordings of 28 persons, HTC Vive Pro
        Eye at 90 Hz, of Santos-Paz et al., PeerJ 2022, doi 10.7717/peerj.14031.
        """
        return cls(
            # Pitch, yaw, roll; 4 s Hann windows, 0.25 Hz to 0.97 of Nyquist.
            speed_rms_deg_s=(1.12, 0.91, 0.93),
            correlation_time_s=(0.10, 0.124, 0.029),
            tracker_noise_deg=(0.0037, 0.0036, 0.0034),
            return_time_s=15.0,  # the slowest drift that the recordings resolve
            person_sd=0.17,  # standard deviation of the persons' log speed
        )

    def __str__(self) -> str:
        def listed(values: tuple[Scalar, ...]) -> str:
            return "/".join(f"{float(value):g}" for value in values)

        return (
            f"model A, speed {listed(self.speed_rms_deg_s)} deg/s, "
            f"correlation time {listed(self.correlation_time_s)} s, "
            f"tracker noise {listed(self.tracker_noise_deg)} deg (pitch/yaw/roll)"
        )

    @property
    def person_power(self) -> Scalar:
        """Mean over persons of the squared scale, `exp(2 person_sd^2)`."""
        return jnp.exp(2 * self.person_sd**2)

    def sample(
        self,
        key: RandomKey,
        rate_hz: Scalar,
        frames: int,
        *,
        dtype: DTypeLike | None = None,
    ) -> Poses:
        """Draw a person and a session of poses; the hold pose is the identity.

        **Arguments:**

        - `key`: the session's random key.
        - `rate_hz`: frames per second, Hz, above 0.
        - `frames`: poses to draw, at least 1.
        - `dtype`: of the result; None follows this model's numbers.

        **Returns:** `world_from_head`, unit quaternions `wxyz`, shape `(frames, 4)`. A
        session starts anywhere in the stationary law, some 1.4 deg off the hold pose.

        **Errors:** `ValueError` for `rate_hz` and `frames` out of range.

        **Accuracy:** exact in law at every rate: 60 and 120 Hz sample the same process
        (but for the tracker's noise, which is per frame). In float32 increments are
        right to 2e-9 rad RMS.
        """
        path = self.rotation_vectors(key, rate_hz, frames, dtype=dtype)
        return jax.vmap(quaternion.exp)(path)

    def rotation_vectors(
        self,
        key: RandomKey,
        rate_hz: Scalar,
        frames: int,
        *,
        dtype: DTypeLike | None = None,
    ) -> Path:
        """Draw the logarithms of `sample`'s poses, rad, shape `(frames, 3)`."""
        _checks.in_range("rate_hz", rate_hz, 0, open_low=True)
        _checks.whole("frames", frames, 1)
        dtype = jnp.dtype(_dtype(self) if dtype is None else dtype)
        return _rotation_vectors(key, self, rate_hz, frames, dtype)

    def covariance(self, lag_s: ArrayLike) -> Float[Array, "*lags 3"]:
        """Covariance of the head's angle with itself `lag_s` later, deg^2."""
        return _covariance(self, jnp.asarray(lag_s, _dtype(self)))

    def increment_covariance(
        self, lag_frames: ArrayLike, rate_hz: Scalar
    ) -> Float[Array, "*lags 3"]:
        """Covariance of frame-to-frame rotations `lag_frames` apart, deg^2.

        The tracker's noise is included.
        """
        _checks.in_range("rate_hz", rate_hz, 0, open_low=True)
        return _increment_covariance(self, jnp.asarray(lag_frames, int), rate_hz)

    def increment_rms_deg(self, rate_hz: Scalar) -> Float[Array, ""]:
        """RMS rotation per frame, all axes together, tracker's noise included, deg."""
        return jnp.sqrt(jnp.sum(self.increment_covariance(0, rate_hz)))

    def velocity_spectrum(
        self, frequency_hz: ArrayLike
    ) -> Float[Array, "*frequencies 3"]:
        """One-sided spectral density of the angle's velocity, (deg/s)^2/Hz."""
        return _velocity_spectrum(self, jnp.asarray(frequency_hz, _dtype(self)))

    def sampled_velocity_spectrum(
        self, frequency_hz: ArrayLike, rate_hz: Scalar
    ) -> Float[Array, "*frequencies 3"]:
        """One-sided density of the frame-difference velocity, (deg/s)^2/Hz.

        The velocity is `(x_k + n_k - x_{k-1} - n_{k-1}) rate_hz`, with the tracker's
        noise `n`: frequencies lie in `[0, rate_hz / 2]`, and all aliases are included.
        """
        _checks.in_range("rate_hz", rate_hz, 0, open_low=True)
        frequency_hz = jnp.asarray(frequency_hz, _dtype(self))
        return _sampled_velocity_spectrum(self, frequency_hz, rate_hz)


def _dtype(head: HeadMotion) -> Any:
    return jnp.result_type(*jax.tree.leaves(head))


def _system(head: HeadMotion, dtype: Any) -> _System:
    per_axis = lambda values: jnp.stack([jnp.asarray(x, dtype) for x in values])
    correlation_time_s = per_axis(head.correlation_time_s)
    a = 1 / correlation_time_s
    b = jnp.full(3, 1 / jnp.asarray(head.return_time_s, dtype))
    zero = jnp.zeros_like(a)
    matrices = lambda *rows: jnp.moveaxis(jnp.array(rows), -1, 0)
    return _System(
        per_axis(head.speed_rms_deg_s) * correlation_time_s,
        per_axis(head.tracker_noise_deg),
        drift=matrices([-b, a], [zero, -a]),
        diffusion=matrices([zero, zero], [zero, 2 * a]),
        stationary=matrices(
            [a**2 / (b * (a + b)), a / (a + b)], [a / (a + b), jnp.ones_like(a)]
        ),
    )


def _apply(matrices: Float[Array, "3 2 2"], states: Float[Array, "3 2"]) -> Array:
    # A sum of products, as a matrix product would be rounded to TF32 on some devices.
    return jnp.sum(matrices * states[:, None, :], axis=-1)


@partial(jax.jit, static_argnames=("frames", "dtype"))
def _rotation_vectors(
    key: RandomKey, head: HeadMotion, rate_hz: Scalar, frames: int, dtype: Any
) -> Path:
    person_key, path_key = jax.random.split(key)
    system = _system(head, dtype)
    change, covariance = system.sampled(1 / jnp.asarray(rate_hz, dtype))
    spread = jnp.linalg.cholesky(covariance)

    # Per frame and axis two draws for the state, the first frame's for its start, and
    # one for the tracker, from one call: generators are slow to compile.
    noise = jax.random.normal(path_key, (frames, 3, 3), dtype)
    of_state, of_tracker = noise[..., :2], noise[..., 2]
    start = _apply(jnp.linalg.cholesky(system.stationary), of_state[0])

    def step(state, noise):
        state = state + _apply(change, state) + _apply(spread, noise)
        return state, state[:, 0]

    _, path = jax.lax.scan(step, start, of_state[1:])
    path = jnp.concatenate([start[None, :, 0], path])

    person_sd = jnp.asarray(head.person_sd, dtype)
    scale = jnp.exp(person_sd * jax.random.normal(person_key, (), dtype))
    angle_deg = (scale * system.angle_unit_deg)[None] * path
    return jnp.deg2rad(angle_deg + system.tracker_noise_deg[None] * of_tracker)


_each = partial(jnp.vectorize, signature="()->(3)")


@jax.jit
def _covariance(head: HeadMotion, lag_s: Array) -> Array:
    system = _system(head, lag_s.dtype)

    def law(lag_s: Scalar) -> Float[Array, "3"]:
        # All terms are positive: nothing cancels.
        change, _ = system.sampled(jnp.abs(lag_s))
        start = system.stationary[:, :, 0]
        return system.angle_unit_deg**2 * (start + _apply(change, start))[:, 0]

    return _each(law)(lag_s)


@jax.jit
def _increment_covariance(head: HeadMotion, lag: Array, rate_hz: Scalar) -> Array:
    dtype = _dtype(head)
    system = _system(head, dtype)
    frame_time_s = 1 / jnp.asarray(rate_hz, dtype)
    change, noise = system.sampled(frame_time_s)
    # The increment is `angle_change @ state + noise`, in terms of the state before it:
    # a sum of positive terms, where differences of `covariance` would cancel.
    angle_change = change[:, 0]
    before = _apply(system.stationary, angle_change)
    variance = jnp.sum(angle_change * before, axis=-1) + noise[:, 0, 0]
    after = before + _apply(change, before) + noise[:, :, 0]
    # Stationary: the angle after an increment covaries with it by half its variance.
    after = after.at[:, 0].set(variance / 2)
    tracker = system.tracker_noise_deg**2

    def law(lag: Array) -> Float[Array, "3"]:
        lag = jnp.abs(lag)
        between_s = jnp.maximum(lag - 1, 0).astype(dtype) * frame_time_s
        later = after + _apply(system.sampled(between_s)[0], after)
        ahead = jnp.sum(angle_change * later, axis=-1)
        covariance = system.angle_unit_deg**2 * jnp.where(lag == 0, variance, ahead)
        # Neighbours share one noise value, with opposite signs.
        return covariance + jnp.select([lag == 0, lag == 1], [2 * tracker, -tracker], 0)

    return _each(law)(lag)


@jax.jit
def _velocity_spectrum(head: HeadMotion, frequency_hz: Array) -> Array:
    system = _system(head, frequency_hz.dtype)
    a, b = -system.drift[:, 1, 1], -system.drift[:, 0, 0]

    def law(frequency_hz: Scalar) -> Float[Array, "3"]:
        w = 2 * jnp.pi * frequency_hz
        # 4 s^2 tau / (1 + (w tau)^2) of v, times w^2 / (w^2 + b^2) of the spring.
        density = 4 * system.angle_unit_deg**2 * a / (1 + (w / a) ** 2)
        return density * w**2 / (w**2 + b**2)

    return _each(law)(frequency_hz)


@jax.jit
def _sampled_velocity_spectrum(
    head: HeadMotion, frequency_hz: Array, rate_hz: Scalar
) -> Array:
    system = _system(head, frequency_hz.dtype)
    rate_hz = jnp.asarray(rate_hz, frequency_hz.dtype)
    change, noise = system.sampled(1 / rate_hz)
    spread = jnp.linalg.cholesky(noise)

    def law(frequency_hz: Scalar) -> Float[Array, "3"]:
        # The state is (z - transition)^-1 spread w of white w, z on the unit circle;
        # the increment is (z - 1) x. All in squares, by z - 1 = real + i imaginary.
        phase = 2 * jnp.pi * frequency_hz / rate_hz
        real, imaginary = -2 * jnp.sin(phase / 2) ** 2, jnp.sin(phase)
        squared = lambda shift: (real - shift) ** 2 + imaginary**2
        angle, from_speed, speed = change[:, 0, 0], change[:, 0, 1], change[:, 1, 1]
        first = (real - speed) * spread[:, 0, 0] + from_speed * spread[:, 1, 0]
        second = from_speed * spread[:, 1, 1]
        power = first**2 + (imaginary * spread[:, 0, 0]) ** 2 + second**2
        power = power * squared(0.0) / (squared(angle) * squared(speed))
        tracker = 8 * system.tracker_noise_deg**2 * rate_hz * jnp.sin(phase / 2) ** 2
        return 2 * rate_hz * system.angle_unit_deg**2 * power + tracker

    return _each(law)(frequency_hz)
