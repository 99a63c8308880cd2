"""The envelope's cases of pictures: colour, blending, resampling."""

from collections.abc import Callable, Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np

from .. import blending, color
from ..frames import resampling
from . import oracles as exact
from .cases import eps
from .measuring import Bound, Case, Inputs

_Rng = np.random.Generator

# --- colour and blending ---


COLOURS = (
    *(0.0, 5e-310, 1e-40, 1e-30, 1e-8, 1e-3, 0.0031308, 0.04045, 0.04, 0.05, 0.5),
    *(1 - 1e-6, 1.0, 2.0, 1e3, 1e6, -1e-3),
)
"""Black, far below a code value, the curve's joints, white, and high dynamic range."""


def _colours(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    for value in (*COLOURS, *10 ** rng.uniform(-12, 6, 40)):
        yield (np.asarray(value, dtype),)


def _at_joint(value: np.ndarray) -> bool:
    return min(abs(float(value) / joint - 1) for joint in (0.0031308, 0.04045)) < 1e-6


def _colour_pairs(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    for n, size in enumerate((*COLOURS, *10 ** rng.uniform(-8, 6, 40))):
        one = size * rng.uniform(0, 1, 3)
        # Equal, nearly equal, unrelated.
        other = (one, one * (1 + 1e-5 * rng.normal(size=3)), size * rng.random(3))[
            n % 3
        ]
        yield np.asarray(one, dtype), np.asarray(other, dtype)


def _display_pairs(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    for one, other in _colour_pairs(rng, dtype):
        if max(one.max(), other.max()) <= 1:
            yield one, other


def _equal(one: np.ndarray, other: np.ndarray) -> bool:
    return bool(np.max(np.abs(one - other)) < 1e-17)


def _pixel(function: Callable) -> Callable:
    """Of one pixel's colours, what the function says of planes."""

    def of(*colours: Any) -> Any:
        return function(*(c[:, None, None] if c.ndim else c for c in colours))

    return of


def _shares(count: int) -> Callable:
    def inputs(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
        ends = (0.0, 1.0, 1e-30, 1e-8, 1 - 1e-6)
        for n in range(50):
            drawn = rng.random(count)
            drawn[n % count] = ends[n % 5] if n < 25 else drawn[n % count]
            yield tuple(np.asarray(x, dtype) for x in drawn)

    return inputs


def _speeds(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    number = dtype.type
    for h_max in (1e-25, 1e-6, 25.0, 25.0, 1e9, 1e25):
        top = number(h_max)
        shares = [0.0, 1e-9, 1e-3, 0.5, *rng.random(3)]
        below, above = np.nextafter(top, number(0)), np.nextafter(top, number(np.inf))
        for speed in (*(number(s) * top for s in shares), below, top, above, 2 * top):
            yield np.asarray(speed, dtype), np.asarray(top, dtype)


def _blends(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    for n, (one, other) in enumerate(_colour_pairs(rng, dtype)):
        weight = (0.0, 1.0, 1e-8, rng.random())[n % 4]
        yield one, other, np.asarray(weight, dtype)


def _pasts(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    for count in (1, 2, 4, 16) * 6:
        weights = rng.random(count) + 1e-3
        samples = rng.random((count, 3)) * 10 ** rng.uniform(-8, 6)
        yield (
            np.asarray(np.resize(samples, (16, 3)), dtype),
            np.asarray(
                np.concatenate([np.zeros(16 - count), weights / weights.sum()]), dtype
            ),
        )


def colours() -> list[Case]:
    """Colours from 1e-30 to 1e6 (HDR), weights from 0 to 1, speeds to 1e25 deg/s."""
    hdr, shown = "0, denormals, 1e-30 to 1e6", "0 to 1"
    # What is smaller squares to 0 in float32.
    dark = {"floor": 1e-17, "has_kink": _equal}
    same = {"euclidean": exact.euclidean_difference}
    same["max_channel"] = exact.max_channel_difference
    found = [
        # A power by logarithms loses as many eps as the exponent is large.
        Case(
            "color.encode",
            hdr,
            color.encode,
            exact.encode,
            _colours,
            eps(24, 24),
            has_kink=_at_joint,
        ),
        Case(
            "color.decode",
            hdr,
            color.decode,
            exact.decode,
            _colours,
            eps(64, 64),
            has_kink=_at_joint,
        ),
        Case(
            "color.luma",
            hdr,
            color.luma,
            exact.luma,
            lambda rng, dtype: (pair[:1] for pair in _display_pairs(rng, dtype)),
            eps(4, 2),
        ),
        Case(
            "color.squared_distance",
            hdr,
            _pixel(color.squared_distance),
            exact.squared_distance,
            _colour_pairs,
            eps(8, 4),
            floor=1e-34,
        ),
        Case(
            "color.distance",
            hdr,
            _pixel(color.distance),
            exact.distance,
            _colour_pairs,
            eps(6, 8),
            **dark,
        ),
    ]
    for kind, oracle in same.items():
        found.append(
            Case(
                f"blending.color_difference ({kind})",
                shown,
                _pixel(
                    lambda a, b, kind=kind: blending.color_difference(a, b, kind=kind)
                ),
                oracle,
                _display_pairs,
                eps(8, 8),
                **dark,
            )
        )
    return [
        *found,
        Case(
            "blending.ease",
            "h 0 to 2 h_max, one ulp around h_max, h_max 1e-25 to 1e25 deg/s",
            blending.ease,
            exact.ease,
            _speeds,
            eps(16, 32),
            floor=1e-30,
            slope_floor=1.0,
        ),
        Case(
            "blending.localized_minimum",
            shown,
            blending.localized_minimum,
            exact.localized_minimum,
            _shares(3),
            eps(4, 2),
            floor=1.0,
        ),
        Case(
            "blending.current_weight",
            shown,
            blending.current_weight,
            exact.current_weight,
            _shares(2),
            eps(2, 2),
            floor=1.0,
        ),
        Case(
            "blending.past_color",
            "1 to 16 past samples, 1e-8 to 1e6",
            lambda samples, weights: blending.past_color(
                list(samples[:, :, None, None]), list(weights)
            ),
            exact.past_color,
            _pasts,
            eps(16, 16),
        ),
        Case(
            "blending.blend",
            hdr,
            lambda c, h, w: blending.blend(
                c[:, None, None], h[:, None, None], w[None, None]
            ),
            exact.blend,
            _blends,
            eps(4, 4),
            slope_floor=1.0,
        ),
    ]


# --- resampling ---


def _reads(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    whole = (0.0, 1.0, -2.0, 3.0, 1e6, -1e6)
    tiny = (1e-30, -1e-30, 1e-6, -1e-6, 0.5 - 1e-3)
    for dx in (*whole, *tiny, *rng.uniform(-5, 6, 30)):
        dy = rng.choice([*whole, *tiny, *rng.uniform(-5, 6, 8)])
        picture = rng.random((4, 5))
        yield tuple(np.asarray(v, dtype) for v in (picture, dx, dy))


def _on_a_texel(picture: np.ndarray, dx: np.ndarray, dy: np.ndarray) -> bool:
    return any(abs(float(d) - round(float(d))) < 1e-20 for d in (dx, dy))


def _reader(read: Callable, stored: Any = None) -> Callable:
    two = jnp.full((1, 1), 2, jnp.int32)

    def at(picture: Any, dx: Any, dy: Any) -> Any:
        kept = resampling.texels(picture[..., None])
        kept = kept if stored is None else kept.astype(stored)
        return read(kept, two, two, dx[None, None], dy[None, None])

    return at


def _by_slices(texels: Any, column: Any, row: Any, dx: Any, dy: Any) -> Any:
    span = jnp.stack([jnp.stack([dx[0, 0], dy[0, 0]])] * 2)
    place = jnp.int32(2), jnp.int32(2)
    return resampling.bilinear_by_slices(texels, *place, (1, 1), span, lambda: (dx, dy))


def _rounded(dtype: Any) -> Callable:
    def inputs(rng: _Rng, number: np.dtype) -> Iterator[Inputs]:
        for picture, dx, dy in _reads(rng, number):
            yield np.asarray(jnp.asarray(picture, dtype), number), dx, dy

    return inputs


def readers() -> list[Case]:
    """Positions from 1e-30 to 1e6 texels off a texel."""
    far = "0, 1e-30 to 1e6 texels, beyond edges"
    kinked = {"has_kink": _on_a_texel, "slope_floor": 1.0, "slope_unit": 1.0}
    bilinear = ("resampling.bilinear", far, exact.bilinear)
    found = [
        Case(
            "resampling.nearest",
            far,
            _reader(resampling.nearest),
            exact.nearest,
            _reads,
            eps(0, 0),
            wrt=(0,),
        ),
        Case(
            "resampling.catmull_rom",
            far,
            _reader(resampling.catmull_rom),
            exact.catmull_rom,
            _reads,
            eps(8, 16),
            floor=1.0,
            slope_floor=1.0,
            slope_unit=1.0,
            wrt=(1, 2),
            is_slow=True,
        ),
    ]
    for name, read in (("", resampling.bilinear), ("_by_slices", _by_slices)):
        found.append(
            Case(
                f"{bilinear[0]}{name}",
                far,
                _reader(read),
                bilinear[2],
                _reads,
                # The position's fraction has eps of 1, of however dark a pixel.
                eps(4, 8),
                floor=1.0,
                is_slow=name != "",
                **kinked,
            )
        )
    for stored in (jnp.bfloat16, jnp.float16):
        found.append(
            Case(
                f"resampling.bilinear, {jnp.dtype(stored).name} texels",
                far,
                _reader(resampling.bilinear, stored),
                bilinear[2],
                _rounded(stored),
                {"float32": Bound(4, 8)},
                floor=1.0,
                wrt=(1, 2),
                **kinked,
            )
        )
    return found


def cases() -> list[Case]:
    """All of them."""
    return [*colours(), *readers()]
