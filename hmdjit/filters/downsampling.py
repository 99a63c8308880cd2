"""Downsampling: one pixel of the texels of a larger picture.

The texels of a picture of `factor` times the size per axis come as planes by their
place in a pixel, row by row, as `sample_patterns.ordered_grid` lists it: `(factor^2,
3, height, width)`. Beyond the edge lies the outermost texel.
"""

import functools
import math
import operator
from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from .. import _checks
from .._types import Rgb, Samples

Taps = str | int


def lanczos2_weights(factor: int, taps: Taps = "exact") -> Mapping[int, float]:
    """Weights of the texels around a pixel, by number; texel 0 is the pixel's first.

    **Arguments:**

    - `factor`: texels per pixel and axis.
    - `taps`: `"exact"` weights the texels within two pixels of the pixel's centre; 11
      makes eleven linear reads between texels, 4/11 px apart.

    **Returns:** weights that sum to 1; those that are 0 are left out.

    **Source:** `L(x) = sinc(x) sinc(x / 2)` for `|x| < 2`, x in pixels of the result
    (Duchon 1979). That the odd kernel of Maruszczuk et al. is eleven linear reads is a
    choice: the paper gives its size alone.
    """
    _checks.whole("factor", factor, 1)
    check_taps(taps)
    lanczos = lambda x: np.sinc(x) * np.sinc(x / 2)
    middle = (factor - 1) / 2  # the pixel's centre, in texels
    weights: dict[int, float] = {}
    if taps == "exact":
        reach = np.arange(-2 * factor, 3 * factor)
        x = (reach - middle) / factor
        near = np.abs(x) < 2
        weights = dict(zip(reach[near].tolist(), lanczos(x[near]), strict=True))
    else:
        for x in 4 / 11 * np.arange(-5, 6):
            at = middle + factor * x
            left = math.floor(at)
            for texel, share in ((left, left + 1 - at), (left + 1, at - left)):
                weights[texel] = weights.get(texel, 0.0) + share * lanczos(x)
    total = sum(weights.values())
    found = {texel: float(weight / total) for texel, weight in weights.items()}
    return {texel: weight for texel, weight in found.items() if abs(weight) > 1e-12}


def check_taps(taps: Taps) -> None:
    """Raise unless there are such taps.

    **Errors:** `ValueError` naming those that there are.
    """
    if not isinstance(taps, str | int) or taps not in ("exact", 11):
        raise ValueError(f"taps must be 'exact' or 11, got {taps!r}.")


def lanczos2_radius_px(factor: int, taps: Taps = "exact") -> int:
    """How many pixels away `lanczos2` reads."""
    return max(abs(texel // factor) for texel in lanczos2_weights(factor, taps))


def lanczos2(texels: Samples, factor: int, taps: Taps = "exact") -> Rgb:
    """Lanczos filter of two lobes, horizontally, then vertically; clipped to [0, 1].

    **Arguments:** `texels`: `(factor^2, 3, height, width)`, in the space to filter in;
    `factor`, `taps`: as of `lanczos2_weights`.

    **Returns:** `(3, height, width)`.

    **Source:** Maruszczuk et al.'s kernel; see `lanczos2_weights`.
    """
    if len(texels) != factor**2:
        raise ValueError(
            f"texels must have factor^2 = {factor**2} planes per channel, "
            f"got {len(texels)}."
        )
    weights = lanczos2_weights(factor, taps)
    rows = texels.reshape(factor, factor, *texels.shape[1:])
    across = _filtered([rows[:, phase] for phase in range(factor)], weights, -1)
    filtered = _filtered(list(across), weights, -2)
    return jnp.clip(filtered, 0.0, 1.0)


def _filtered(
    phases: list[Float[Array, "*planes height width"]],
    weights: Mapping[int, float],
    axis: int,
) -> Float[Array, "*planes height width"]:
    """Weighted sum of texels along an axis, by their place in a pixel."""
    factor, size = len(phases), phases[0].shape[axis]
    rim = max(abs(texel // factor) for texel in weights)

    def around(plane: Array) -> Array:
        first = lax.slice_in_dim(phases[0], 0, 1, axis=axis)
        last = lax.slice_in_dim(phases[-1], size - 1, size, axis=axis)
        parts = [*[first] * rim, plane, *[last] * rim]
        return lax.concatenate(parts, axis % plane.ndim)

    rimmed = [around(plane) for plane in phases]

    def read(texel: int) -> Array:
        pixel, phase = divmod(texel, factor)
        start = rim + pixel
        return lax.slice_in_dim(rimmed[phase], start, start + size, axis=axis)

    terms = [weight * read(texel) for texel, weight in weights.items()]
    return functools.reduce(operator.add, terms)
