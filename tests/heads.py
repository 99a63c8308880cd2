"""Head models that tests share, recordings of them, and what fits must keep to."""

import functools

import jax
import numpy as np
from jax.random import clone
from scipy.spatial.transform import Rotation

from hmdjit.head_fitting import whittle
from hmdjit.head_motion import Amplitude, HeadMotion, Resonator, Trace

_TRACKER = (0.0037, 0.0036, 0.0034)


def models(*, person_sd, scale=1.0, wander_s=15.0):
    """Model A, model B with two resonances, and the latter with bursts, by name.

    Speeds are about 1 deg/s times `scale`; `wander_s` is model A's return time.
    """

    def speeds(*values):
        return tuple(scale * value for value in values)

    model_a = HeadMotion(
        speeds(1.12, 0.91, 0.93), (0.10, 0.124, 0.029), _TRACKER, wander_s, person_sd
    )
    model_b = HeadMotion(
        speeds(0.9, 0.6, 0.65),
        (0.15, 0.23, 0.05),
        _TRACKER,
        return_time_s=4.0,
        person_sd=person_sd,
        resonators=(
            Resonator(speeds(0.4, 0.5, 0.5), (2.8, 2.4, 3.0), (0.12, 0.05, 1.2)),
            Resonator(speeds(0.45, 0.35, 0.3), (8.0, 4.1, 11.4), (0.15, 0.07, 0.1)),
        ),
    )
    bursts = HeadMotion(**{**vars(model_b), "amplitude": Amplitude(0.3, 0.4)})
    return {"A": model_a, "B": model_b, "bursts": bursts}


@functools.partial(jax.jit, static_argnames="frames")
def paths_of(head, keys, rate_hz, frames):
    """Rotation vectors of one new person per key."""
    return jax.lax.map(lambda key: head.rotation_vectors(key, rate_hz, frames), keys)


def traces_of(head, key, subjects, seconds, rate_hz=30.0):
    """One trace for each new person."""
    frames = round(seconds * rate_hz)
    keys = jax.random.split(clone(key), subjects)
    paths = np.asarray(paths_of(head, keys, rate_hz, frames))
    return [
        Trace(
            np.arange(frames) / rate_hz,
            Rotation.from_rotvec(path).as_quat(scalar_first=True),
            subject=f"subject {i}",
        )
        for i, path in enumerate(paths.astype(float))
    ]


def identifiable_within_bounds(found):
    """Assert that a fit is finite and in range; return what is identifiable."""
    value, error, low, high = (np.array(jax.tree.leaves(x), float) for x in found[:4])
    assert np.isfinite(value).all()
    known = np.isfinite(error)
    for of in (error, low, high):
        np.testing.assert_array_equal(np.isnan(of), ~known)
        assert np.isfinite(of[known]).all()
    assert np.all((low <= value) & (value <= high) | ~known)
    order = len(found.head.resonators)
    bounds = np.exp(whittle.log_bounds(order, found.rate_hz))
    wander = (
        *(found.head.speed_rms_deg_s, found.head.correlation_time_s),
        found.head.tracker_noise_deg,
    )
    modes = [m for mode in found.head.resonators for m in vars(mode).values()]
    least, most = bounds[..., None] * np.array([[[1 - 1e-12]], [[1 + 1e-12]]])
    numbers = np.array([*wander, *modes], float)
    assert np.all((least <= numbers) & (numbers <= most))
    return known
