"""Parameters of head models: numbers per axis, damped modes, bursts."""

import dataclasses

import equinox as eqx

from .. import _checks
from .._types import Scalar

AXES = ("pitch", "yaw", "roll")
PerAxis = tuple[Scalar, Scalar, Scalar]
"""One number each for pitch, yaw and roll."""


def check_per_axis(config: eqx.Module, name: str, *, open_low: bool) -> None:
    """Raise unless a field holds three numbers from 0 (or above 0) to infinity."""
    values = getattr(config, name)
    if len(values) != len(AXES):
        raise ValueError(
            f"{name} must have 3 numbers (pitch, yaw, roll), got {len(values)}."
        )
    for axis, value in zip(AXES, values, strict=True):
        _checks.in_range(f"{name} ({axis})", value, 0, open_low=open_low)


class Resonator(eqx.Module):
    """A damped mode of the head, driven by white noise.

    Per axis (pitch, yaw, roll):

    - `speed_rms_deg_s`: RMS of its angular velocity, deg/s, at least 0.
    - `frequency_hz`: its undamped frequency, Hz, above 0.
    - `damping`: damping ratio, dimensionless, above 0; 1 is critical.

    **Errors:** `ValueError` naming the field, the range and the value.
    """

    speed_rms_deg_s: PerAxis = eqx.field(converter=_checks.numbers)
    frequency_hz: PerAxis = eqx.field(converter=_checks.numbers)
    damping: PerAxis = eqx.field(converter=_checks.numbers)

    def __check_init__(self):
        check_per_axis(self, "speed_rms_deg_s", open_low=False)
        check_per_axis(self, "frequency_hz", open_low=True)
        check_per_axis(self, "damping", open_low=True)


class Amplitude(eqx.Module):
    """How strongly a head moves just now: bursts and lulls, the same in all axes.

    The noise that drives the head is multiplied by `a = exp(sd m - sd^2)`, held within
    a frame, where `m` is a standard normal Ornstein-Uhlenbeck process: `a^2` is 1 on
    average.

    - `sd`: standard deviation of its logarithm, at least 0.
    - `correlation_time_s`: correlation time of the logarithm, s, above 0.

    **Errors:** `ValueError` naming the field, the range and the value.
    """

    sd: Scalar = eqx.field(converter=_checks.number)
    correlation_time_s: Scalar = eqx.field(converter=_checks.number)

    def __check_init__(self):
        _checks.in_range("sd", self.sd, 0)
        _checks.in_range(
            "correlation_time_s", self.correlation_time_s, 0, open_low=True
        )


@dataclasses.dataclass(frozen=True)
class FitError:
    """How sure a fitted head is of how much it moves.

    - `rotation`: relative standard error of its RMS rotation per frame, at the rate of
      the recordings; from 0 to 1, above which nothing is known.
    - `clusters`: how many it is over, at least 2.
    - `over`: what they are, in words.

    **Errors:** `ValueError` naming the field, the range and the value.
    """

    rotation: float
    clusters: int
    over: str

    def __post_init__(self):
        _checks.in_range("rotation", self.rotation, 0, 1)
        _checks.whole("clusters", self.clusters, 2)
