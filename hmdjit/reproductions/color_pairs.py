"""Pairs of colours whose anti-aliasing differs most between linear light and gamma."""

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import _checks, color
from ..metrics import ciede2000, lab

Code = tuple[int, int, int]
"""Red, green, blue; gamma, 8 bits."""

LEVELS, APART = 9, 20.0
_DIGITS = 2  # of differences: pairs that differ less are equally good


class ColorPair(NamedTuple):
    """Two colours, and what the edge between them looks like where it covers half.

    - `first`, `second`: colours; `linear_mix`, `gamma_mix`: their means, all in codes.
    - `difference`: CIEDE2000 between the two means.
    """

    first: Code
    second: Code
    linear_mix: Code
    gamma_mix: Code
    difference: float


def grid(levels: int) -> Float[np.ndarray, "colors 3"]:
    """Return gamma colours at so many evenly spaced codes of each channel."""
    axis = np.round(np.linspace(0, color.CODE_VALUES, levels)) / color.CODE_VALUES
    return np.array(list(itertools.product(axis, repeat=3)))


@jax.jit
def differences(colors: Float[Array, "colors 3"]) -> Float[Array, "colors colors"]:
    """CIEDE2000 between the linear and the gamma mean of any two of some colours."""
    light = color.decode(colors)

    def to_all(one: tuple[Array, Array]) -> Array:
        in_gamma, in_light = one
        linear = lab((in_light[None] + light) / 2, space="linear")
        return ciede2000(linear, lab((in_gamma[None] + colors) / 2))

    return jax.lax.map(to_all, (colors, light))


def most_different(
    count: int = 4, *, levels: int = LEVELS, apart: float = APART
) -> list[ColorPair]:
    """Choose the pairs whose linear and gamma anti-aliasing differ most.

    The largest difference first; each further pair is the one of the largest difference
    whose colours both lie at least `apart` from all colours of those before it, so that
    the pairs are not shades of one (their mixes may be alike). Of equal ones, to 0.01,
    the darker comes first (red before green before blue). Grid and distance are choices
    of ours.

    **Arguments:**

    - `count`: how many; at least 1.
    - `levels`: of each channel, of the colours that are searched; at least 2.
    - `apart`: CIEDE2000 between colours of different pairs; at least 0.

    **Errors:** `ValueError` where there are not so many pairs.
    """
    _checks.whole("count", count, 1)
    _checks.whole("levels", levels, 2)
    _checks.in_range("apart", apart, 0)
    colors = grid(levels)
    found = np.asarray(differences(jnp.asarray(colors, float)), float)
    first, second = np.triu_indices(len(colors), 1)
    order = np.argsort(-np.round(found[first, second], _DIGITS), kind="stable")
    labs = np.asarray(lab(jnp.asarray(colors, float)))
    is_free = np.ones(len(colors), bool)
    chosen: list[ColorPair] = []
    for i, j in zip(first[order], second[order], strict=True):
        if is_free[i] and is_free[j]:
            chosen.append(_pair(colors[i], colors[j], float(found[i, j])))
            if len(chosen) == count:
                return chosen
            for mine in (i, j):
                away = ciede2000(labs, np.broadcast_to(labs[mine], labs.shape))
                is_free &= np.asarray(away) >= apart
    raise ValueError(
        f"count must lie in [1, {len(chosen)}] for {levels} levels and {apart:g} "
        f"apart, got {count}."
    )


def _pair(
    first: Float[np.ndarray, "3"], second: Float[np.ndarray, "3"], difference: float
) -> ColorPair:
    light = color.decode(jnp.asarray(np.stack([first, second]), float))
    linear = np.asarray(color.encode(jnp.mean(light, axis=0)), float)
    gamma = (first + second) / 2
    return ColorPair(
        _code(first), _code(second), _code(linear), _code(gamma), difference
    )


def _code(gamma: Float[np.ndarray, "3"]) -> Code:
    red, green, blue = (int(c) for c in np.floor(color.CODE_VALUES * gamma + 0.5))
    return red, green, blue
