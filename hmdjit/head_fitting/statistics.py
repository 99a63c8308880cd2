"""What recorded heads do, in numbers, and whether a model's heads do the same.

Speeds, spectra, wander, turns within a time and tails, all of still segments, so that
a model drawn at the same frames can be measured in the same way.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Float64, Key
from scipy.spatial.transform import Rotation

from .. import _checks
from .._types import RandomKey, Scalar
from ..head_motion import laws
from ..head_motion.process import HeadMotion
from ..head_motion.trace import Trace
from . import spectra
from .spectra import Periodograms, Turns

WANDER_S = (2.0, 10.0, 20.0)
SPECTRUM_BINS = 24
_SHARES = np.linspace(0.0, 1.0, 201)
_LAGS = 40


class Description(NamedTuple):
    """What heads do within their still segments; per axis pitch, yaw, roll.

    Velocities are raw frame differences, the tracker's noise included.

    - `rate_hz`, `subjects`, `still_s`: frame rate, subjects, total duration.
    - `speed_rms_deg_s`: of the angular speed.
    - `speed_quantile_deg_s`: quantiles of the angular speed at 201 even shares.
    - `kurtosis`: excess kurtosis of the velocity, pooled over subjects; NaN on axes
      that never move.
    - `wander_deg`: RMS angle about the mean of blocks of `WANDER_S`; NaN where no
      segment is that long.
    - `frequency_hz`, `spectrum`: mean one-sided density of the velocity,
      (deg/s)^2/Hz, in those of 24 logarithmic bins that hold a frequency.
    - `lag_s`, `structure_deg2`: mean squared turn within a time.
    """

    rate_hz: float
    subjects: int
    still_s: float
    speed_rms_deg_s: float
    speed_quantile_deg_s: Float64[np.ndarray, " shares"]
    kurtosis: Float64[np.ndarray, "3"]
    wander_deg: Float64[np.ndarray, "durations 3"]
    frequency_hz: Float64[np.ndarray, " bins"]
    spectrum: Float64[np.ndarray, "bins 3"]
    lag_s: Float64[np.ndarray, " lags"]
    structure_deg2: Float64[np.ndarray, "lags 3"]

    def speed_quantile(self, share: float) -> float:
        """Angular speed that is not exceeded in this share of the frames, deg/s."""
        return float(np.interp(share, _SHARES, self.speed_quantile_deg_s))


class Goodness(NamedTuple):
    """A model beside recordings: what it does at the frames that were recorded.

    - `recorded`, `model`: what each does.
    - `spectrum_error_db`: per axis, RMS over the spectrum's bins of
      `10 log10(recorded / expected)`, dB; NaN on axes where either never moves.
    - `expected`: the spectrum that the model's population is expected to give.
    """

    recorded: Description
    model: Description
    expected: Float64[np.ndarray, "bins 3"]
    spectrum_error_db: Float64[np.ndarray, "3"]


def describe(segments: Sequence[Trace], rate_hz: float) -> Description:
    """Measure still segments that share a frame rate.

    **Errors:** `ValueError` when no segment is as long as a window of 4 s.
    """
    if not segments:
        raise ValueError("segments must hold at least one still segment, got none.")
    turns = [Turns.of(segment) for segment in segments]
    velocity = np.concatenate([turn.velocity_deg_s for turn in turns])
    speed = np.linalg.norm(velocity, axis=1)
    squared = velocity**2
    angles = [turn.path_deg for turn in turns]
    periodograms = Periodograms.of(segments, rate_hz)
    if not len(periodograms.power):
        longest_s = max(segment.duration_s for segment in segments)
        raise ValueError(
            f"segments must last at least {spectra.WINDOW_S:g} s for a spectrum, the "
            f"longest lasts {_checks.apart(longest_s, spectra.WINDOW_S, spec='2f')} s."
        )
    frequency_hz, spectrum = _binned(
        periodograms.frequency_hz, periodograms.power.mean(axis=0)
    )
    lags = _lags(max(map(len, angles)))
    return Description(
        rate_hz,
        len({segment.subject for segment in segments}),
        sum(segment.duration_s for segment in segments),
        float(np.sqrt(np.mean(speed**2))),
        np.quantile(speed, _SHARES),
        _over(np.mean(squared**2, axis=0), np.mean(squared, axis=0) ** 2) - 3,
        np.stack([_rms(block_variances(angles, time * rate_hz)) for time in WANDER_S]),
        frequency_hz,
        spectrum,
        lags / rate_hz,
        np.stack([_structure(angles, lag) for lag in lags.tolist()]),
    )


def _over(part: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """Quotient; NaN where there is nothing to divide by."""
    return part / np.where(whole > 0, whole, np.nan)


def block_variances(
    paths: Sequence[Float64[np.ndarray, "_ 3"]], frames: float
) -> Float64[np.ndarray, "blocks 3"]:
    """Variance about the mean of each block of so many frames, deg^2."""
    length = round(frames)
    blocks = [
        path[start : start + length].var(axis=0)
        for path in paths
        for start in range(0, len(path) - length + 1, length)
    ]
    return np.array(blocks).reshape(-1, 3)


def _rms(variances: Float64[np.ndarray, "blocks 3"]) -> Float64[np.ndarray, "3"]:
    return np.sqrt(variances.mean(axis=0)) if len(variances) else np.full(3, np.nan)


def expected_block_variance(
    head: HeadMotion, frames: float, rate_hz: float
) -> Float64[np.ndarray, "3"]:
    """Mean of `block_variances` over the model's population, deg^2."""
    length = round(frames)
    lags = np.arange(1, length)
    return (length - lags) @ expected_structure(head, lags / rate_hz) / length**2


def expected_structure(
    head: HeadMotion, lag_s: Float64[np.ndarray, " lags"]
) -> Float64[np.ndarray, "lags 3"]:
    """Mean squared turn within a time, over the model's population, deg^2."""
    turned = float(head.person_power) * np.asarray(head.structure_function(lag_s))
    return turned + 2 * np.square(np.array(head.tracker_noise_deg, float))


def _lags(frames: int) -> np.ndarray:
    # Beyond a third of the longest segment few pairs are left.
    return np.unique(np.geomspace(1, max(frames / 3, 2), _LAGS).astype(int))


def _structure(
    angles: Sequence[Float64[np.ndarray, "_ 3"]], lag: int
) -> Float64[np.ndarray, "3"]:
    turned = [angle[lag:] - angle[:-lag] for angle in angles if len(angle) > lag]
    return np.mean(np.concatenate(turned) ** 2, axis=0)


def _binned(
    frequency_hz: Float64[np.ndarray, " freqs"],
    density: Float64[np.ndarray, "freqs 3"],
) -> tuple[Float64[np.ndarray, " bins"], Float64[np.ndarray, "bins 3"]]:
    edges = np.geomspace(frequency_hz[0], frequency_hz[-1], SPECTRUM_BINS + 1)
    place = np.digitize(frequency_hz, edges[1:-1])
    held = [place == i for i in range(SPECTRUM_BINS) if np.any(place == i)]
    middle = [np.exp(np.mean(np.log(frequency_hz[bin_]))) for bin_ in held]
    return np.array(middle), np.stack([density[bin_].mean(axis=0) for bin_ in held])


def as_recorded(
    key: RandomKey, head: HeadMotion, segments: Sequence[Trace], rate_hz: float
) -> list[Trace]:
    """Draw a session of a new person at the frames of each recorded segment."""
    frames = [segment.frame_numbers for segment in segments]
    keys = jax.random.split(key, len(segments))
    longest = max(int(number[-1]) for number in frames) + 1
    paths = np.asarray(_paths(keys, head, rate_hz, longest), float)
    drawn = []
    for segment, path, number in zip(segments, paths, frames, strict=True):
        poses = Rotation.from_rotvec(path[number]).as_quat(scalar_first=True)
        drawn.append(
            Trace(number / rate_hz, poses, subject=segment.subject, name="model")
        )
    return drawn


@partial(jax.jit, static_argnames="frames")
def _paths(
    keys: Key[Array, " segments"], head: HeadMotion, rate_hz: Scalar, frames: int
) -> Float[Array, "segments {frames} 3"]:
    draw = lambda key: head.rotation_vectors(key, rate_hz, frames)
    return jax.lax.map(draw, keys)


def expected_spectrum(
    head: HeadMotion, periodograms: Periodograms, power: float | None = None
) -> Float64[np.ndarray, "freqs 3"]:
    """Mean periodogram that heads like the model's are expected to give.

    **Arguments:** `power`: a person's squared scale; None averages over persons.
    """
    power = float(head.person_power) if power is None else power
    places = jnp.asarray(periodograms.grid_hz), periodograms.rate_hz
    tracker_deg = jnp.asarray(head.tracker_noise_deg, float)
    tracker = np.asarray(laws.tracker_spectrum(tracker_deg, *places), float)
    whole = np.asarray(head.sampled_velocity_spectrum(*places), float)
    density = power * (whole - tracker) + tracker
    share = periodograms.windows / np.sum(periodograms.windows)
    return np.tensordot(share, periodograms.leakage(), 1) @ density


def goodness(
    key: RandomKey,
    head: HeadMotion,
    segments: Sequence[Trace],
    rate_hz: float,
    *,
    draws: int = 16,
) -> Goodness:
    """Hold a model against still segments, drawing each segment `draws` times."""
    recorded = describe(segments, rate_hz)
    drawn = [
        trace
        for one in jax.random.split(key, draws)
        for trace in as_recorded(one, head, segments, rate_hz)
    ]
    periodograms = Periodograms.of(segments, rate_hz)
    expected = expected_spectrum(head, periodograms)
    _, expected = _binned(periodograms.frequency_hz, expected)
    ratio = _over(recorded.spectrum, expected)
    error_db = 10 * np.log10(np.where(ratio > 0, ratio, np.nan))
    return Goodness(
        recorded,
        describe(drawn, rate_hz),
        expected,
        np.sqrt(np.mean(error_db**2, axis=0)),
    )
