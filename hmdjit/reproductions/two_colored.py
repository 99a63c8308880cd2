"""Two colours: which pairs tell most, and a pattern in a pair, seen exactly.

Pairs are those whose anti-aliasing differs most between linear light and gamma. No
texture lies between a pattern and its samples: it would smooth the very edges whose
anti-aliasing is compared.
"""

import itertools
from collections.abc import Collection
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped
from scipy import stats

from .. import _checks, color, quaternion, sample_patterns
from .._types import Numbers, Plane, Rgb, Scalar, WholeNumber
from ..camera import Camera, Region
from ..frames.motion import Motion
from ..frames.sources import AbstractSource, Places, View
from ..metrics import ciede2000, lab
from ..scenes.base import AbstractScene

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


class TwoColored(AbstractSource):
    """A black and white pattern, infinitely far away, in two colours instead.

    - `patterns`, `chosen`: the pattern is one of these, from 0 (`first`) to 1
      (`second`); those that share a list share a program.
    - `first`, `second`: gamma colours, `(3,)`, in `[0, 1]`.
    - `tilt_deg`: by which the pattern is turned clockwise about the view's centre.
    - `blur_px`: of the reference, standard deviation of a Gaussian; 0 is the mean over
      a pixel's square.
    """

    patterns: tuple[AbstractScene, ...]
    chosen: WholeNumber
    first: Float[Array | np.ndarray, "3"]
    second: Float[Array | np.ndarray, "3"]
    tilt_deg: Scalar = 0.0
    blur_px: float = eqx.field(static=True, default=0.0)

    @property
    def gives(self) -> frozenset[str]:
        """Colour alone."""
        return frozenset({"color"})

    def seen(
        self, view: View, samples_px: Places, channels: Collection[str]
    ) -> dict[str, Shaped[Array, "samples channels height width"]]:
        """Colour at each sample's own point."""
        share = self._share(view, jnp.asarray(samples_px, view.motion.offset.dtype))
        return {"color": _mixed(self.first, self.second, share[:, None])}

    def reference(self, view: View) -> Rgb:
        """Mix both in linear light, by their shares of a pixel's square, or of a blur.

        **Accuracy:** that of as many samples of a scrambled Halton sequence as the
        view's reading says.
        """
        dtype = view.motion.offset.dtype
        count = view.reading.reference_samples
        offsets = sample_patterns.halton(count, first=1, scrambled=True)
        if self.blur_px:
            offsets = self.blur_px * stats.norm.ppf(offsets)
        else:
            offsets = offsets - 0.5

        def add(total: Plane, offset: Array) -> tuple[Plane, None]:
            return total + self._share(view, offset[None])[0], None

        start = jnp.zeros((view.region.height, view.region.width), dtype)
        total, _ = jax.lax.scan(add, start, jnp.asarray(offsets, dtype))
        first, second = (jnp.asarray(c, dtype) for c in (self.first, self.second))
        light = _mixed(color.decode(first), color.decode(second), total[None] / count)
        return color.encode(light)

    def covers(self, camera: Camera, region: Region, motion: Motion) -> Bool[Array, ""]:
        """Whether the pose is known: the pattern has no end."""
        return jnp.isfinite(motion.offset).all()

    def _share(
        self, view: View, offsets_px: Float[Array, "samples 2"]
    ) -> Float[Array, "samples height width"]:
        """Share of the second colour at points of each pixel: 0 or 1."""
        camera, dtype = view.camera, offsets_px.dtype
        focal = jnp.asarray(camera.focal_px, dtype)
        dx, dy = (part[:, None, None] for part in offsets_px.T)
        x = view.region.columns().astype(dtype)[None] + 0.5 + dx
        y = view.region.rows().astype(dtype)[None] + 0.5 + dy
        x, y = (x - camera.width_px / 2) / focal, (camera.height_px / 2 - y) / focal
        ray = jnp.stack([*jnp.broadcast_arrays(x, y), -jnp.ones_like(x + y)])
        turn = quaternion.matrix_minus_identity(view.motion.offset)
        # In full precision: some devices shorten the numbers of products.
        moved = jnp.tensordot(turn, ray, 1, precision="highest")
        x, y, z = ray + moved
        tilt = jnp.deg2rad(jnp.asarray(self.tilt_deg, dtype))
        cos, sin = jnp.cos(tilt), jnp.sin(tilt)
        tilted = jnp.stack([cos * x - sin * y, sin * x + cos * y, z])
        each = [lambda ray, p=p: p.color(camera, ray)[0] for p in self.patterns]
        return jax.lax.switch(jnp.asarray(self.chosen, jnp.int32), each, tilted)


def _mixed(
    first: Array | np.ndarray, second: Array | np.ndarray, share: Numbers
) -> Numbers:
    """Mix two colours, `(3,)`, by planes of shares, `(..., 1, height, width)`."""
    shape = (*(1,) * (share.ndim - 3), 3, 1, 1)
    first, second = (
        jnp.asarray(c, share.dtype).reshape(shape) for c in (first, second)
    )
    return first + (second - first) * share
