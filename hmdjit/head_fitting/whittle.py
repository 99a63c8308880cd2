"""Whittle deviance of a head model and its minimum.

Given the periodograms of recorded heads, the deviance of a model is
`sum 2 n (r - 1 - log r)` over subjects, frequencies and axes, with `r` the recorded
over the expected power, averaged over the subject's `n` windows. It is a sum of squares
of deviance residuals, so Levenberg-Marquardt finds its minimum. Subjects differ by a
scale of all their movement.

**Source:** Whittle's likelihood, debiased: Sykulski et al., Biometrika 106(2), 2019.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array, Bool, Float, Float64, Int

from .. import _checks
from .._types import Scalar
from ..head_motion import laws
from ..head_motion.parameters import Amplitude, Resonator
from ..head_motion.process import HeadMotion, parts_of
from .spectra import Periodograms

ORDERS = (0, 1, 2)
_MAX_STEPS = 100
_AT_BOUND = 0.005  # of the range of its logarithm: nearer a search may stop anywhere

# Bounds of the search; frequencies also lie below a share of the rate. Windows of 4 s
# cannot tell dampings below 0.02 apart.
_BOUNDS = {
    "speed_rms_deg_s": (1e-3, 30.0),
    "correlation_time_s": (5e-3, 5.0),
    "tracker_noise_deg": (1e-5, 0.3),
    "frequency_hz": (0.7, 20.0),
    "damping": (0.02, 2.0),
}
_HIGHEST_SHARE = 0.45
# Where the search starts: resonances at these frequencies, as many as the order.
_STARTS_HZ = {
    0: [()],
    1: [(2.0,), (3.0,), (5.0,), (8.0,), (11.0,)],
    2: [(3.0, 9.0), (2.0, 4.5), (4.0, 11.0), (1.5, 3.0), (3.0, 6.0)],
}

Values = Float[Array, "parameters 3"]
"""Rows: the wander's speed and time, the tracker's noise; then speed, frequency and
damping of each resonator. Columns: axes."""


class Search(eqx.Module):
    """A point of the search.

    - `logits`: of the logarithms of the values, between their bounds.
    - `log_scale`: of each subject; only differences from their mean count.
    """

    logits: Values
    log_scale: Float[Array, " subjects"]


class Data(eqx.Module):
    """What the deviance needs; `weight` is the number of windows, 0 to leave out."""

    power: Float[Array, "subjects freqs 3"]
    weight: Float[Array, " subjects"]
    leakage: Float[Array, "leaks freqs grid"]
    leak_of: Int[Array, " subjects"]
    grid_hz: Float[Array, " grid"]
    rate_hz: Float[Array, ""]
    log_bounds: Float[Array, "2 parameters"]
    return_time_s: Float[Array, ""]


def log_bounds(order: int, rate_hz: float) -> Float64[np.ndarray, "2 parameters"]:
    """Logarithms of the least and largest values.

    **Errors:** `ValueError` for a rate that leaves resonances no frequency.
    """
    lowest_hz = _BOUNDS["frequency_hz"][0] / _HIGHEST_SHARE
    if order and not rate_hz > lowest_hz:
        raise ValueError(
            f"rate_hz must be above {lowest_hz:.3g} Hz to fit resonances, got "
            f"{_checks.apart(rate_hz, lowest_hz, spec='3g')}; order 0 has none."
        )
    names = ["speed_rms_deg_s", "correlation_time_s", "tracker_noise_deg"]
    names += ["speed_rms_deg_s", "frequency_hz", "damping"] * order
    bounds = np.array([_BOUNDS[name] for name in names]).T
    bounds[1, 4::3] = np.minimum(bounds[1, 4::3], _HIGHEST_SHARE * rate_hz)
    return np.log(bounds)


def data_of(
    periodograms: Periodograms, order: int, return_time_s: float = 15.0
) -> Data:
    """Gather what a model with `order` resonances per axis is fitted to."""
    as_float = lambda values: jnp.asarray(values, float)
    leakage, leak_of = np.unique(periodograms.leakage(), axis=0, return_inverse=True)
    return Data(
        as_float(periodograms.by_subject()),
        as_float(periodograms.windows),
        as_float(leakage),
        jnp.asarray(leak_of),
        as_float(periodograms.grid_hz),
        as_float(periodograms.rate_hz),
        as_float(log_bounds(order, periodograms.rate_hz)),
        as_float(return_time_s),
    )


def log_values(search: Search, data: Data) -> Values:
    """Logarithms of the model's numbers, within their bounds; any logit is one."""
    low, high = data.log_bounds[..., None]
    inside = low + (high - low) * jax.nn.sigmoid(search.logits)
    return jnp.clip(inside, low, high)


def at_bound(
    log_values: Float64[np.ndarray, "parameters 3"], data: Data
) -> Bool[np.ndarray, "parameters 3"]:
    """Which numbers ended at a bound of their search: the truth may lie beyond."""
    low, high = np.asarray(data.log_bounds, float)[..., None]
    return np.minimum(log_values - low, high - log_values) < _AT_BOUND * (high - low)


def head_of(
    values: Any,
    return_time_s: Scalar,
    person_sd: Scalar = 0.0,
    amplitude: Amplitude | None = None,
) -> HeadMotion:
    """Make a head from the rows of `Values`, not from their logarithms."""
    modes = [Resonator(*values[i : i + 3]) for i in range(3, len(values), 3)]
    speed, time, noise = values[:3]
    return HeadMotion(
        speed, time, noise, return_time_s, person_sd, tuple(modes), amplitude
    )


def log_expected(
    log_values: Values, log_scale: Float[Array, " subjects"], data: Data
) -> Float[Array, "subjects freqs 3"]:
    """Logarithm of the periodogram that each subject is expected to have."""
    head = head_of(jnp.exp(log_values), data.return_time_s)
    places = data.grid_hz, data.rate_hz
    parts = parts_of(head, log_values.dtype)
    moved = laws.sampled_velocity_spectrum(parts, jnp.zeros(3), *places)
    tracker = laws.tracker_spectrum(jnp.exp(log_values[2]), *places)
    leaked = lambda spectrum: (data.leakage @ spectrum)[data.leak_of]
    scale = jnp.exp(2 * log_scale)[:, None, None]
    return jnp.log(scale * leaked(moved) + leaked(tracker))


def centred(search: Search, data: Data) -> Float[Array, " subjects"]:
    """Logarithms of the subjects' scales about their mean: the median person is 1."""
    share = jnp.where(data.weight > 0, 1.0, 0.0)
    return search.log_scale - jnp.sum(share * search.log_scale) / jnp.sum(share)


def deviance_residuals(
    log_expected: Float[Array, "subjects freqs 3"], data: Data
) -> Float[Array, "subjects freqs 3"]:
    """Signed roots of the deviance `2 n (r - 1 - log r)`, smooth at r = 1."""
    excess = jnp.log(data.power) - log_expected  # log r
    is_small = jnp.abs(excess) < 0.03
    safe = jnp.where(is_small, 1.0, excess)
    root = jnp.sign(safe) * jnp.sqrt(2 * (jnp.expm1(safe) - safe))
    series = excess * (1 + excess / 6 * (1 + excess / 6))
    weight = jnp.sqrt(data.weight)[:, None, None]
    return weight * jnp.where(is_small, series, root)


def _minimise(residuals: Any, start: Any, data: Data) -> Any:
    solver = optimistix.LevenbergMarquardt(rtol=1e-4, atol=1e-4)
    solution = optimistix.least_squares(
        residuals, solver, start, data, max_steps=_MAX_STEPS, throw=False
    )
    return solution.value, jnp.sum(residuals(solution.value, data) ** 2, axis=(0, 1))


@eqx.filter_jit
def _from_starts(
    logits: Float[Array, "starts parameters 3"], data: Data
) -> tuple[Float[Array, "starts parameters 3"], Float[Array, "starts 3"]]:
    """Fit the pooled data from each start; deviances of each axis by itself."""
    share = data.weight / jnp.sum(data.weight)
    pooled = jnp.sum(share[:, None, None] * data.power, axis=0, keepdims=True)
    leakage = jnp.tensordot(share, data.leakage[data.leak_of], 1)[None]
    pooled = eqx.tree_at(
        lambda d: (d.power, d.weight, d.leakage, d.leak_of),
        data,
        (pooled, jnp.sum(data.weight)[None], leakage, jnp.zeros(1, int)),
    )
    no_scale = jnp.zeros(1, logits.dtype)

    def residuals(logits, data):
        values = log_values(Search(logits, no_scale), data)
        return deviance_residuals(log_expected(values, no_scale, data), data)

    return jax.vmap(lambda start: _minimise(residuals, start, pooled))(logits)


@eqx.filter_jit
def refine(search: Search, data: Data) -> Search:
    """Fit the parameters and the subjects' scales together."""

    def residuals(search, data):
        values = log_values(search, data)
        return deviance_residuals(
            log_expected(values, centred(search, data), data), data
        )

    return _minimise(residuals, search, data)[0]


@eqx.filter_jit
def held_out_deviances(
    search: Search, data: Data, held_out: Float[Array, " subjects"]
) -> Float[Array, " subjects"]:
    """Deviance of each held-out subject per window, at its own best scale."""
    values = log_values(search, data)
    data = eqx.tree_at(lambda d: d.weight, data, held_out)

    def residuals(log_scale, data):
        return deviance_residuals(log_expected(values, log_scale, data), data)

    log_scale, _ = _minimise(residuals, jnp.zeros_like(held_out), data)
    return jnp.sum(residuals(log_scale, data) ** 2, axis=(1, 2))


def best_search(data: Data, order: int) -> Search:
    """Minimise the deviance from several starts; resonances come by frequency."""
    starts = jnp.asarray(start_logits(np.asarray(data.log_bounds, float), order), float)
    logits, deviances = _from_starts(starts, data)
    # Without scales the axes are fitted independently: each takes its best start.
    best = jnp.nanargmin(deviances, axis=0)
    logits = jnp.stack([logits[best[axis], :, axis] for axis in range(3)], axis=1)
    found = refine(Search(logits, jnp.zeros(len(data.weight))), data)
    return eqx.tree_at(lambda s: s.logits, found, _by_frequency(found.logits))


def start_logits(
    log_bounds: Float64[np.ndarray, "2 parameters"], order: int
) -> Float64[np.ndarray, "starts parameters 3"]:
    """Where the search starts: within its bounds by a fiftieth of their range."""
    starts = []
    for frequencies_hz in _STARTS_HZ[order]:
        values = [0.8, 0.12, 0.004]
        for frequency_hz in frequencies_hz:
            values += [0.4, frequency_hz, 0.2]
        low, high = log_bounds
        share = np.clip((np.log(values) - low) / (high - low), 0.02, 0.98)
        starts.append(np.repeat(np.log(share / (1 - share))[:, None], 3, axis=1))
    return np.stack(starts)


def _by_frequency(logits: Values) -> Values:
    """Order the resonances of each axis by frequency."""
    modes = logits[3:].reshape(-1, 3, 3)
    ranks = jnp.argsort(modes[:, 1], axis=0)
    modes = jnp.take_along_axis(modes, ranks[:, None], axis=0)
    return jnp.concatenate([logits[:3], modes.reshape(-1, 3)])
