"""The envelope's rows of colours, blends, curves, resampling and metrics."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from .. import blending, color, curves, metrics, sample_patterns
from ..frames import resampling
from ..theory.picture_statistics import PictureStatistics
from . import arguments as of
from . import exact_pictures as exact
from .row import Bound, Row, eps, mp, one, own_size

_scaled = partial(Row, slope_unit=own_size)
_numpy = partial(Row, eager=True, quick=0)
_HDR, _SHOWN, _PAIR = [of.two_colours()], [of.two_colours(1.0)], [of.TWO_PICTURES]


def _pixel(name: str, function: Callable, *given: Any, **options: Any) -> Row:
    """Row of one pixel's colours, by what a function says of planes."""
    of_pixel = lambda *colours: function(*(c[..., None, None] for c in colours))
    return Row(of_pixel, *given, name=name, **options)


def _at_joint(value: np.ndarray) -> bool:
    return min(abs(float(value) / joint - 1) for joint in (0.0031308, 0.04045)) < 1e-6


def _equal(one: np.ndarray, other: np.ndarray) -> bool:
    return bool(np.max(np.abs(one - other)) < 1e-17)


def _black(now: np.ndarray, past: np.ndarray, weight: np.ndarray) -> bool:
    return not (now.any() or past.any())


def _past(samples: Any, weights: Any) -> Any:
    return blending.past_color(list(samples[:, :, None, None]), list(weights))


# What is smaller squares to 0 in float32.
_dark = partial(_pixel, floor=1e-17, kink=_equal)
_largest = partial(blending.color_difference, kind="max_channel")
_euclidean = partial(blending.color_difference, kind="euclidean")
_difference = "blending.color_difference"

COLOURS = [
    # A power by logarithms loses as many eps as the exponent is large.
    Row(color.encode, exact.encode, [of.COLOUR], eps(24, 24), kink=_at_joint),
    Row(color.decode, exact.decode, [of.COLOUR], eps(64, 64), kink=_at_joint),
    Row(color.luma, exact.luma, [of.ONE_COLOUR], eps(4, 2)),
    _pixel(
        "color.squared_distance",
        color.squared_distance,
        lambda one, other: [exact.distance(one, other)[0] ** 2],
        _HDR,
        eps(8, 4),
        floor=1e-34,
    ),
    _dark("color.distance", color.distance, exact.distance, _HDR, eps(6, 8)),
    _dark(
        f"{_difference} (euclidean)",
        _euclidean,
        lambda one, other: [min(exact.distance(one, other)[0] / mp.sqrt(3), mp.mpf(1))],
        _SHOWN,
        eps(8, 8),
    ),
    _dark(
        f"{_difference} (max_channel)",
        _largest,
        lambda one, other: [min(max(abs(one - other)), mp.mpf(1))],
        _SHOWN,
        eps(8, 8),
    ),
    _scaled(
        blending.ease,
        lambda speed, h_max: exact.cosine(min(speed, h_max) / h_max, mp.mpf(2)),
        [of.SPEED],
        eps(16, 32),
        floor=1e-30,
        count=66,
    ),
    Row(
        blending.localized_minimum,
        lambda w_min, w_lb, difference: [w_min - (w_min - w_lb) * difference],
        [of.WEIGHT] * 3,
        eps(4, 2),
        floor=1.0,
    ),
    Row(
        blending.current_weight,
        lambda minimum, easing: [minimum + (1 - minimum) * easing],
        [of.WEIGHT] * 2,
        eps(2, 2),
        floor=1.0,
    ),
    Row(_past, exact.past_color, [of.PAST], eps(16, 16), name="blending.past_color"),
    _pixel(
        "blending.blend",
        blending.blend,
        lambda now, past, weight: list(weight * now + (1 - weight) * past),
        [*_HDR, of.WEIGHT],
        eps(4, 4),
        slope_unit=own_size,
        kink=_black,
    ),
]

# --- curves and sample patterns ---


def _rises_both_ways(share: np.ndarray, exponent: np.ndarray) -> bool:
    return bool(share == 0 and exponent == 0.5)


# Curves rise from 0; what is smaller counts as this large.
_curve = partial(_scaled, floor=1e-30)

CURVES = [
    _curve(
        lambda share: curves.Kim()(share),
        lambda share: exact.cosine(share, mp.mpf(2)),
        [of.SHARE],
        eps(8, 16),
        name="curves.Kim",
    ),
    _curve(
        lambda share, exponent: curves.Cosine(exponent)(share),
        exact.cosine,
        [of.SHARE, of.EXPONENT],
        eps(128, 256),  # a power takes its base's rounding times its exponent
        name="curves.Cosine",
        kink=_rises_both_ways,
    ),
    _curve(
        lambda share, rises: curves.Spline(tuple(rises))(share),
        exact.spline,
        [of.SHARE, of.RISES],
        eps(16, 64),
        name="curves.Spline",
    ),
    _numpy(
        sample_patterns.radical_inverse,
        exact.radical_inverse,
        [of.BASE, of.INDEX],
        {"float64": Bound(4 * 2.0**-52)},
        "absolute",
    ),
]

# --- resampling ---


def _reader(
    name: str, read: Callable, *given: Any, stored: Any = None, **options: Any
) -> Row:
    two = jnp.full((1, 1), 2, jnp.int32)

    def at(picture: Any, dx: Any, dy: Any) -> Any:
        kept = resampling.texels(picture[..., None])
        kept = kept if stored is None else kept.astype(stored)
        return read(kept, two, two, dx[None, None], dy[None, None])

    # The position's fraction has eps of 1, of however dark a pixel.
    arguments = [of.picture(stored), of.OFFSET, of.OFFSET]
    options = {"floor": 1.0, "slope_unit": one, **options}
    exact_read, bounds = given
    name = f"frames.resampling.{name}"
    return Row(at, exact_read, arguments, bounds, name=name, **options)


def _by_slices(texels: Any, column: Any, row: Any, dx: Any, dy: Any) -> Any:
    span = jnp.stack([jnp.stack([dx[0, 0], dy[0, 0]])] * 2)
    place = jnp.int32(2), jnp.int32(2)
    return resampling.bilinear_by_slices(texels, *place, (1, 1), span, lambda: (dx, dy))


def _on_a_texel(picture: np.ndarray, dx: np.ndarray, dy: np.ndarray) -> bool:
    return any(abs(float(d) - round(float(d))) < 1e-20 for d in (dx, dy))


_linear = partial(_reader, kink=_on_a_texel)
_gathers, _SINGLE = resampling.bilinear, {"float32": Bound(4, 8)}
_by_place: Any = {"wrt": (1, 2)}

READERS = [
    _reader(
        "nearest",
        resampling.nearest,
        exact.nearest,
        eps(0, 0),
        wrt=(0,),
        slope_unit=own_size,
    ),
    _reader(
        "catmull_rom",
        resampling.catmull_rom,
        exact.catmull_rom,
        eps(8, 16),
        quick=0,
        **_by_place,
    ),
    _linear("bilinear", _gathers, exact.bilinear, eps(4, 8)),
    _linear("bilinear_by_slices", _by_slices, exact.bilinear, eps(4, 8), quick=0),
    *(
        _linear(
            f"bilinear, {stored.__name__} texels",
            _gathers,
            exact.bilinear,
            _SINGLE,
            stored=stored,
            **_by_place,
        )
        for stored in (jnp.bfloat16, jnp.float16)
    ),
]

# --- metrics ---


def _same(test: np.ndarray, reference: np.ndarray) -> bool:
    return bool(np.array_equal(test, reference))


def _no_ratio(test: np.ndarray, reference: np.ndarray) -> bool:
    return _same(test, reference) or not reference.any()


def _streamed(clip: np.ndarray) -> list:
    streamed = metrics.Streamed(metrics.MTCD())
    for frame in clip:
        streamed.add(frame)
    return [streamed.value]


def _moved(slope_squared: Any, finest_px: Any, displacement: Any) -> Any:
    statistics = PictureStatistics(slope_squared[None], finest_px, 64, False)
    return statistics.difference(displacement[None])[0]


def _at_rest(slope_squared: Any, finest_px: Any, displacement: np.ndarray) -> bool:
    return not displacement.any()


# dB: a logarithm of up to 32 and its factor of 10 are rounded, and their sum.
_DECIBELS = {"float32": Bound(1e-4, 8), "float64": Bound(2e-13, 8)}
_error = partial(Row, kink=_same, count=72)

METRICS = [
    Row(metrics.mtcd, exact.mtcd, [of.CLIP], eps(8, 16)),
    Row(metrics.mse, exact.mse, _PAIR, eps(8, 16), count=72),
    _error(metrics.rmsd, exact.rmsd, _PAIR, eps(8, 16)),
    _error(metrics.psnr, exact.psnr, _PAIR, _DECIBELS, "dB"),
    _error(metrics.snr, exact.snr, _PAIR, _DECIBELS, "dB", kink=_no_ratio),
    _numpy(
        _streamed,
        exact.mtcd,
        [of.LONG_CLIP],
        {"float64": Bound(10_000 * 2.0**-53)},  # a rounding for each frame
        "relative",
        "metrics.mtcd.StreamedMtcd",
        count=6,
    ),
    _scaled(
        _moved,
        exact.difference,
        [of.DISPLACED],
        eps(16, 32),
        name="theory.picture_statistics.PictureStatistics.difference",
        kink=_at_rest,
    ),
]
