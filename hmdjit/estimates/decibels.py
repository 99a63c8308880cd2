"""Decibels, whose means are those of the powers: of errors, 10^(-x/10).

An error of 0 has infinitely many decibels: its power is a number like any other.
"""

import dataclasses
import math
from typing import Any

import numpy as np
from jaxtyping import Float

from .intervals import Interval

AVERAGED = {"averaged_as": "error power"}
"""Attribute of a dataset's variables that are averaged so."""


def power_of(decibels: Any) -> Float[np.ndarray, "*shape"]:
    """Power of an error, as a share of what decibels are of."""
    return 10.0 ** (-np.asarray(decibels, float) / 10)


def decibels_of(power: Any) -> Float[np.ndarray, "*shape"]:
    """Decibels of an error's power; infinite of 0, and of less."""
    power = np.asarray(power, float)
    with np.errstate(divide="ignore"):
        return -10 * np.log10(np.where(power < 0, 0, power))


def in_decibels(found: Interval) -> Interval:
    """Interval of a mean power, in decibels; of no error at all it has no bounds."""
    value, low, high = map(float, decibels_of([found.value, found.high, found.low]))
    if found.value == 0:
        return Interval(value, math.nan, math.nan, math.nan, "no error at all")
    error = 10 / math.log(10) * found.standard_error / found.value
    return dataclasses.replace(
        found, value=value, low=low, high=high, standard_error=error
    )
