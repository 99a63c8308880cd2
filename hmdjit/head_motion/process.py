"""How a head that tries to hold still moves: a stochastic process.

Per axis the head's angle is the sum of a wander (an Ornstein-Uhlenbeck velocity,
integrated against a very weak spring) and of damped resonances (head on neck near 3 Hz,
tremor near 8 to 12 Hz, heartbeat near 1.2 Hz), seen by a tracker with white angle noise
per sampled frame. The linear core is in `components` and `laws`; persons differ by a
scale, and a slow log-normal amplitude makes movement come in bursts.

Arrays per axis are ordered pitch (x), yaw (y), roll (z).
"""

import contextlib
import os
from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, DTypeLike, Float

from .. import _checks, quaternion
from .._types import Path, Poses, RandomKey, Scalar
from . import components, laws, presets, sampling
from .components import Parts
from .parameters import AXES, Amplitude, FitError, PerAxis, Resonator, check_per_axis


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
    - `fit_error`: of the fit that these numbers come from; it moves no head, but widens
      the intervals of a study. None takes the numbers, as a preset's, for known:
      results are then given this head.

    The laws below (`covariance`, spectra, ...) are those of the median person; over the
    population everything but the tracker's noise is multiplied by `person_power`. They
    are averaged over the amplitude, which does not change them; given that it stays
    at `a` for longer than the head remembers, all but the tracker's noise is `a^2`
    times as large. They have the precision of this model's numbers and are right to
    1e-5 in float32; covariances, which cross 0, to 1e-5 of their variance.

    **Errors:** `ValueError` naming the field, the range and the value.
    """

    speed_rms_deg_s: PerAxis = eqx.field(converter=_checks.numbers)
    correlation_time_s: PerAxis = eqx.field(converter=_checks.numbers)
    tracker_noise_deg: PerAxis = eqx.field(converter=_checks.numbers)
    return_time_s: Scalar = eqx.field(converter=_checks.number, default=15.0)
    person_sd: Scalar = eqx.field(converter=_checks.number, default=0.17)
    resonators: tuple[Resonator, ...] = eqx.field(converter=tuple, default=())
    amplitude: Amplitude | None = None
    fit_error: FitError | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        check_per_axis(self, "speed_rms_deg_s", open_low=False)
        check_per_axis(self, "correlation_time_s", open_low=True)
        check_per_axis(self, "tracker_noise_deg", open_low=False)
        _checks.in_range("return_time_s", self.return_time_s, 0, open_low=True)
        _checks.in_range("person_sd", self.person_sd, 0)

    @classmethod
    def seated(cls) -> "HeadMotion":
        """People seated with a supported back, waiting (Santos-Paz et al., 2022)."""
        return cls.preset("seated")

    @classmethod
    def fixating(cls) -> "HeadMotion":
        """People who hold their gaze on markers for 3 s (Uramune et al., 2023)."""
        return cls.preset("fixating")

    @classmethod
    def free_viewing(cls) -> "HeadMotion":
        """People watching 360-degree videos, held still (Nasrabadi et al., 2019)."""
        return cls.preset("free_viewing")

    @classmethod
    def tracker_noise(cls) -> "HeadMotion":
        """Noise of a headset's tracker alone, unworn (Banaszczyk et al., 2024)."""
        return cls.preset("tracker_noise")

    @classmethod
    def preset(cls, name: str) -> "HeadMotion":
        """Head of a name in `presets.toml`, which gives sources and standard errors.

        **Errors:** `ValueError` for an unknown name, with the nearest known one.
        """
        known = presets.tables()
        _checks.one_of("head", name, known)
        return presets.from_table(cls, known[name])

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> "HeadMotion":
        """Read a head from a TOML file, as `presets.write` writes it.

        **Errors:** `ValueError`, one line, naming the file and the key.
        """
        return presets.read(cls, path)

    def __str__(self) -> str:
        """Say in words what head this is; of other numbers, name their fields.

        A gradient is made like a head, of arrays, and means something else.
        """
        if all(isinstance(leaf, float) for leaf in jax.tree.leaves(self)):
            with contextlib.suppress(ValueError):
                for part in (self, *self.resonators, *filter(None, (self.amplitude,))):
                    part.__check_init__()
                return presets.words(self)
        is_number = lambda leaf: jnp.ndim(leaf) == 0 and not _checks.is_traced(leaf)
        short = lambda leaf: float(f"{leaf:.3g}") if is_number(leaf) else leaf
        return repr(jax.tree.map(short, self))

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

        **Errors:** `ValueError` for a `key` that is none, and for `rate_hz` and
        `frames` out of range.

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
        _checks.random_key(key)
        _checks.in_range("rate_hz", rate_hz, 0, open_low=True)
        _checks.whole("frames", frames, 1)
        dtype = jnp.dtype(_dtype(self) if dtype is None else dtype)
        return _rotation_vectors(key, self, rate_hz, frames, dtype)

    def covariance(self, lag_s: ArrayLike) -> Float[Array, "*lags 3"]:
        """Covariance of the head's angle with itself `lag_s` later, deg^2."""
        return _law(laws.covariance, self, jnp.asarray(lag_s, _dtype(self)))

    def structure_function(self, lag_s: ArrayLike) -> Float[Array, "*lags 3"]:
        """Mean squared turn of the head within `lag_s`, without the tracker, deg^2."""
        return _law(laws.structure_function, self, jnp.asarray(lag_s, _dtype(self)))

    def increment_covariance(
        self, lag_frames: ArrayLike, rate_hz: Scalar
    ) -> Float[Array, "*lags 3"]:
        """Covariance of frame-to-frame rotations `lag_frames` apart, deg^2.

        The tracker's noise is included.
        """
        _checks.in_range("rate_hz", rate_hz, 0, open_low=True)
        lags = jnp.asarray(lag_frames, int)
        return _law(laws.increment_covariance, self, _tracker(self), lags, rate_hz)

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
        frequency_hz = jnp.asarray(frequency_hz, _dtype(self))
        return _law(laws.velocity_spectrum, self, frequency_hz)

    def sampled_velocity_spectrum(
        self, frequency_hz: ArrayLike, rate_hz: Scalar
    ) -> Float[Array, "*frequencies 3"]:
        """One-sided density of the frame-difference velocity, (deg/s)^2/Hz.

        The velocity is `(x_k + n_k - x_{k-1} - n_{k-1}) rate_hz`, with the tracker's
        noise `n`: frequencies lie in `[0, rate_hz / 2]`, and all aliases are included.
        """
        _checks.in_range("rate_hz", rate_hz, 0, open_low=True)
        places = _tracker(self), jnp.asarray(frequency_hz, _dtype(self)), rate_hz
        return _law(laws.sampled_velocity_spectrum, self, *places)

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
        given = _tracker(self), self.amplitude, rate_hz
        return _law(laws.increment_kurtosis, self, *given, frames=frames)


def parts_of(head: HeadMotion, dtype: DTypeLike) -> Parts:
    """Parts of the head's angle, wander first, as linear systems in a precision."""
    stacked = partial(_stacked, dtype=dtype)
    wander = components.wander(
        stacked(head.speed_rms_deg_s),
        stacked(head.correlation_time_s),
        jnp.asarray(head.return_time_s, dtype),
    )
    modes = [
        components.resonance(*map(stacked, vars(mode).values()))
        for mode in head.resonators
    ]
    return components.joined(wander, *modes)


def _dtype(head: HeadMotion) -> Any:
    return jnp.result_type(*jax.tree.leaves(head))


def _stacked(values: PerAxis, dtype: DTypeLike) -> Float[Array, "3"]:
    return jnp.stack([jnp.asarray(value, dtype) for value in values])


def _tracker(head: HeadMotion) -> Float[Array, "3"]:
    return _stacked(head.tracker_noise_deg, _dtype(head))


@partial(jax.jit, static_argnames=("frames", "dtype"))
def _rotation_vectors(
    key: RandomKey, head: HeadMotion, rate_hz: Scalar, frames: int, dtype: Any
) -> Path:
    as_array = partial(jnp.asarray, dtype=dtype)
    path_deg = sampling.draw(
        key,
        parts_of(head, dtype),
        _stacked(head.tracker_noise_deg, dtype),
        as_array(head.person_sd),
        jax.tree.map(as_array, head.amplitude),
        1 / as_array(rate_hz),
        frames,
    )
    return jnp.deg2rad(path_deg)


@partial(jax.jit, static_argnums=0, static_argnames="frames")
def _law(law: Callable, head: HeadMotion, *arguments: Any, **static: int) -> Array:
    return law(parts_of(head, _dtype(head)), *arguments, **static)
