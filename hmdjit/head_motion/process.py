"""How a head that tries to hold still moves: a stochastic process.

Per axis the head's angle is the sum of a wander (an Ornstein-Uhlenbeck velocity,
integrated against a very weak spring) and of damped resonances (head on neck near 3 Hz,
tremor near 8 to 12 Hz, heartbeat near 1.2 Hz), seen by a tracker with white angle noise
per sampled frame. The linear core is in `components`; persons differ by a scale, and a
slow log-normal amplitude makes movement come in bursts.

Arrays per axis are ordered pitch (x), yaw (y), roll (z).
"""

import os
from collections.abc import Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, DTypeLike, Float

from .. import _checks, quaternion
from .._types import Path, Poses, RandomKey, Scalar
from . import components, sampling
from .components import Parts
from .parameters import AXES, Amplitude, PerAxis, Resonator, check_per_axis, per_axis
from .sampling import Bursts
from .trace import Trace


class HeadMotion(eqx.Module):
    """Head motion of people who try to hold still, as one stochastic process.

    Per axis (pitch, yaw, roll):

    - `speed_rms_deg_s`: RMS of the wander's angular velocity, deg/s, at least 0.
    - `correlation_time_s`: its correlation time, s, above 0.
    - `tracker_noise_deg`: RMS of the white angle noise per sampled frame, deg, at
      least 0; the same at every rate.

    For all axes:

    - `return_time_s`: time constant of the wander's return to the hold pose, s,
      above 0.
    - `person_sd`: a session's person moves `exp(person_sd z)` times as much as the
      median one, z standard normal, in all axes; the tracker's noise does not scale.
    - `resonators`: damped modes, none or more; a heartbeat is one near 1.2 Hz with a
      damping near 0.05.
    - `amplitude`: bursts and lulls; None is a Gaussian process.

    The laws below (`covariance`, spectra, ...) are those of the median person; over the
    population everything but the tracker's noise is multiplied by `person_power`. They
    are averaged over the amplitude, which does not change them; given that it stays
    at `a` for longer than the head remembers, all but the tracker's noise is `a^2`
    times as large. They have the precision of this model's numbers and are right to
    1e-5 in float32; covariances, which cross 0, to 1e-5 of their variance.

    **Errors:** `ValueError` naming the field, the range and the value.
    """

    speed_rms_deg_s: PerAxis = eqx.field(converter=per_axis)
    correlation_time_s: PerAxis = eqx.field(converter=per_axis)
    tracker_noise_deg: PerAxis = eqx.field(converter=per_axis)
    return_time_s: Scalar = eqx.field(converter=_checks.number, default=15.0)
    person_sd: Scalar = eqx.field(converter=_checks.number, default=0.17)
    resonators: tuple[Resonator, ...] = eqx.field(converter=tuple, default=())
    amplitude: Amplitude | None = None

    def __check_init__(self):
        check_per_axis(self, "speed_rms_deg_s", open_low=False)
        check_per_axis(self, "correlation_time_s", open_low=True)
        check_per_axis(self, "tracker_noise_deg", open_low=False)
        _checks.in_range("return_time_s", self.return_time_s, 0, open_low=True)
        _checks.in_range("person_sd", self.person_sd, 0)

    @classmethod
    def seated(cls) -> "HeadMotion":
        """People seated with a supported back, waiting in a neutral pose.

        **Source:** recordings of Santos-Paz et al., PeerJ 2022, doi
        10.7717/peerj.14031, HTC Vive Pro Eye, 90 Hz; numbers in `presets.toml`.
        """
        return cls.preset("seated")

    @classmethod
    def fixating(cls) -> "HeadMotion":
        """People who hold their gaze on a marker for 3 s each.

        **Source:** recordings of Uramune et al., arXiv 2311.00391, HTC Vive Pro Eye,
        90 Hz; numbers in `presets.toml`.
        """
        return cls.preset("fixating")

    @classmethod
    def free_viewing(cls) -> "HeadMotion":
        """People who watch 360-degree videos, while they hold still.

        **Source:** recordings of Nasrabadi et al., MMSys 2019, arXiv 1905.03823, Oculus
        Go, 60 Hz; numbers in `presets.toml`.
        """
        return cls.preset("free_viewing")

    @classmethod
    def tracker_noise(cls) -> "HeadMotion":
        """Take a headset that nobody wears: the tracker's noise alone.

        **Source:** idle parts of recordings of Banaszczyk et al., arXiv 2412.06116,
        Quest 2, 72 Hz; numbers in `presets.toml`.
        """
        return cls.preset("tracker_noise")

    @classmethod
    def preset(cls, name: str) -> "HeadMotion":
        """Head of a name in `presets.toml`: `seated`, `fixating`, ...

        **Errors:** `ValueError` for an unknown name, with the nearest known one.
        """
        from . import presets

        return presets.preset(name)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> "HeadMotion":
        """Read a head from a TOML file, as `presets.write` writes it.

        **Errors:** `ValueError`, one line, naming the file and the key.
        """
        from . import presets

        return presets.read(path)

    @classmethod
    def fit(cls, traces: Sequence[Trace], *, order: int | None = None) -> "HeadMotion":
        """Fit a head to recorded ones; `fitting.fit` also says how sure it is.

        **Errors:** `ValueError`, see `fitting.fit`.
        """
        from ..head_fitting import fitting

        return fitting.fit(traces, order=order).head

    def __str__(self) -> str:
        def listed(values: tuple[Scalar, ...]) -> str:
            return "/".join(f"{float(value):.3g}" for value in values)

        return (
            f"model {'B' if self.resonators else 'A'}, "
            f"speed {listed(self.speed_rms_deg_s)} deg/s, "
            f"correlation time {listed(self.correlation_time_s)} s, "
            f"tracker noise {listed(self.tracker_noise_deg)} deg (pitch/yaw/roll)"
            + "".join(
                f", resonance of {listed(mode.speed_rms_deg_s)} deg/s at "
                f"{listed(mode.frequency_hz)} Hz"
                for mode in self.resonators
            )
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
        (but for the tracker's noise, which is per frame). Of a model with an amplitude,
        which is held within a frame, that is true of all covariances; its tails are
        right as far as the amplitude changes little within a frame. In float32
        increments are right to 2e-9 rad RMS.
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

    def structure_function(self, lag_s: ArrayLike) -> Float[Array, "*lags 3"]:
        """Mean squared turn of the head within `lag_s`, without the tracker, deg^2."""
        return _structure_function(self, jnp.asarray(lag_s, _dtype(self)))

    def increment_covariance(
        self, lag_frames: ArrayLike, rate_hz: Scalar
    ) -> Float[Array, "*lags 3"]:
        """Covariance of frame-to-frame rotations `lag_frames` apart, deg^2.

        The tracker's noise is included.
        """
        _checks.in_range("rate_hz", rate_hz, 0, open_low=True)
        return _increment_covariance(self, jnp.asarray(lag_frames, int), rate_hz)

    def increment_rms_deg(self, rate_hz: Scalar) -> Float[Array, ""]:
        """RMS rotation per frame, all axes together, tracker's noise included, deg.

        Its gradient at rest is chosen as exactly 0.
        """
        variance = jnp.sum(self.increment_covariance(0, rate_hz))
        # The root has an infinite slope at rest: keep 0 out of it.
        moves = variance > 0
        return jnp.where(moves, jnp.sqrt(jnp.where(moves, variance, 1.0)), 0.0)

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

    def increment_kurtosis(
        self, rate_hz: float, *, memory_s: float = 4.0
    ) -> Float[Array, "3"]:
        """Excess kurtosis of one person's frame-to-frame rotations per axis.

        0 without an amplitude, and on axes that never move. The tracker's noise, which
        is Gaussian, is included; what the head remembers for longer than `memory_s` is
        left out.
        """
        _checks.in_range("rate_hz", rate_hz, 0, open_low=True)
        if self.amplitude is None:
            return jnp.zeros(len(AXES), _dtype(self))
        frames = max(2, round(memory_s * rate_hz))
        return _increment_kurtosis(self, self.amplitude, rate_hz, frames)


def _dtype(head: HeadMotion) -> Any:
    return jnp.result_type(*jax.tree.leaves(head))


def _stacked(values: PerAxis, dtype: Any) -> Float[Array, "3"]:
    return jnp.stack([jnp.asarray(value, dtype) for value in values])


def _parts(head: HeadMotion, dtype: Any) -> Parts:
    per_axis = partial(_stacked, dtype=dtype)
    wander = components.wander(
        per_axis(head.speed_rms_deg_s),
        per_axis(head.correlation_time_s),
        jnp.asarray(head.return_time_s, dtype),
    )
    modes = [
        components.resonance(
            per_axis(mode.speed_rms_deg_s),
            per_axis(mode.frequency_hz),
            per_axis(mode.damping),
        )
        for mode in head.resonators
    ]
    return components.joined(wander, *modes)


@partial(jax.jit, static_argnames=("frames", "dtype"))
def _rotation_vectors(
    key: RandomKey, head: HeadMotion, rate_hz: Scalar, frames: int, dtype: Any
) -> Path:
    as_array = partial(jnp.asarray, dtype=dtype)
    bursts = None
    if head.amplitude is not None:
        times = head.amplitude.sd, head.amplitude.correlation_time_s
        bursts = Bursts(*map(as_array, times))
    path_deg = sampling.draw(
        key,
        _parts(head, dtype),
        _stacked(head.tracker_noise_deg, dtype),
        as_array(head.person_sd),
        bursts,
        1 / as_array(rate_hz),
        frames,
    )
    return jnp.deg2rad(path_deg)


@jax.jit
def _covariance(head: HeadMotion, lag_s: Array) -> Array:
    return components.covariance(_parts(head, lag_s.dtype), lag_s)


@jax.jit
def _structure_function(head: HeadMotion, lag_s: Array) -> Array:
    return components.structure_function(_parts(head, lag_s.dtype), lag_s)


@jax.jit
def _increment_covariance(head: HeadMotion, lag: Array, rate_hz: Scalar) -> Array:
    dtype = _dtype(head)
    law = components.increment_covariance(_parts(head, dtype), lag, rate_hz)
    # Neighbours share one noise value, with opposite signs.
    shared = jnp.select([lag == 0, abs(lag) == 1], [2, -1], 0).astype(dtype)
    noise = _stacked(head.tracker_noise_deg, dtype) ** 2
    return law + jnp.multiply.outer(shared, noise)


@jax.jit
def _velocity_spectrum(head: HeadMotion, frequency_hz: Array) -> Array:
    parts = _parts(head, frequency_hz.dtype)
    return components.velocity_spectrum(parts, frequency_hz)


@jax.jit
def _sampled_velocity_spectrum(
    head: HeadMotion, frequency_hz: Array, rate_hz: Scalar
) -> Array:
    dtype = frequency_hz.dtype
    parts = _parts(head, dtype)
    law = components.sampled_velocity_spectrum(parts, frequency_hz, rate_hz)
    rate_hz = jnp.asarray(rate_hz, dtype)
    filtered = 8 * rate_hz * jnp.sin(jnp.pi * frequency_hz / rate_hz) ** 2
    noise = _stacked(head.tracker_noise_deg, dtype) ** 2
    return law + jnp.multiply.outer(filtered, noise)


@partial(jax.jit, static_argnames="frames")
def _increment_kurtosis(
    head: HeadMotion, amplitude: Amplitude, rate_hz: Scalar, frames: int
) -> Float[Array, "3"]:
    # Given the amplitude an increment is normal: its kurtosis is 3 times the relative
    # variance of its variance, the sum of what each frame's noise gives times a^2, with
    # cov(a^2, a'^2) = exp(4 sd^2 correlation) - 1.
    dtype = _dtype(head)
    # It has no unit: in units of the largest part no square is too small for float32.
    parts, tracker = _parts(head, dtype), _stacked(head.tracker_noise_deg, dtype)
    unit = jnp.maximum(jnp.max(parts.angle_unit_deg, axis=0), tracker)
    unit = jax.lax.stop_gradient(jnp.where(unit > 0, unit, 1.0))
    parts = parts._replace(angle_unit_deg=parts.angle_unit_deg / unit[None])
    given = components.turn_memory(parts, rate_hz, frames)
    total = jnp.sum(given, axis=0) + 2 * (tracker / unit) ** 2
    # Over its own size first: a quotient's slope divides by the square of its divisor,
    # which here is too small for float32.
    size = jax.lax.stop_gradient(jnp.where(total > 0, total, 1.0))
    given, total = given / size[None], total / size
    given = given / jnp.where(total > 0, total, 1.0)[None]
    pairs = jax.vmap(partial(jax.scipy.signal.correlate, method="fft"), 1, 1)
    pairs = pairs(given, given)  # by lag, from 1 - frames to frames - 1
    lag_s = jnp.abs(jnp.arange(1 - frames, frames)).astype(dtype) / rate_hz
    correlation = jnp.exp(-lag_s / jnp.asarray(amplitude.correlation_time_s, dtype))
    shared = jnp.expm1(4 * jnp.asarray(amplitude.sd, dtype) ** 2 * correlation)
    return 3 * jnp.sum(pairs * shared[:, None], axis=0)
