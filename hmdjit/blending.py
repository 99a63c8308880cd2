"""How the past is blended in: Kim et al., equations (2) to (5).

`A` is the weight of the current picture. It is small while the head is nearly still,
smaller yet where past and present disagree (the picture flickers there), and rises to 1
with head speed, so that a moving head sees no lag.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from . import color, curves
from ._types import Mask, Numbers, Plane, Rgb, Scalar
from .curves import AbstractCurve

_KIM, _LINEAR = curves.Kim(), curves.Linear()


def past_color(samples: Sequence[Rgb], weights: Sequence[Scalar]) -> Rgb:
    """Weighted sum of the past samples; the weights sum to 1.

    Written as differences from the last sample, which is exact where all are equal.

    **Source:** Kim et al., equation (2), on displayed pictures: the text and equation
    (3) accumulate recursively, the printed C_k is a slip.
    """
    last = samples[-1]
    total = last
    for weight, sample in zip(weights[:-1], samples[:-1], strict=True):
        total = total + weight * (sample - last)
    return total


def ease(
    head_speed_deg_s: Numbers | Scalar,
    h_max_deg_s: Scalar,
    curve: AbstractCurve = _KIM,
) -> Numbers:
    """Ease curve of head speed: 0 at rest, 1 from `h_max` on.

    `curve(h / h_max)`; the default is `((1 - cos(pi h / h_max)) / 2)^2`.

    **Source:** Kim et al., equation (4).
    """
    return curve(_share(head_speed_deg_s, h_max_deg_s))


@jax.custom_jvp
def _share(speed: Numbers | Scalar, h_max: Scalar) -> Numbers:
    """Speed over `h_max`, at most 1: there it is flat.

    Its slope is written in the share: JAX's own has `h_max^-2`, which overflows.
    """
    is_full = speed >= h_max
    return jnp.where(is_full, 1.0, speed / jnp.where(is_full, 1.0, h_max))


@_share.defjvp
def _share_jvp(primals: tuple, tangents: tuple) -> tuple[Numbers, Numbers]:
    (speed, h_max), (speed_dot, h_max_dot) = primals, tangents
    share, is_full = _share(speed, h_max), speed >= h_max
    change = (speed_dot - share * h_max_dot) / jnp.where(is_full, 1.0, h_max)
    return share, jnp.where(is_full, 0.0, change)


def color_difference(current: Rgb, history: Rgb, *, kind: str = "euclidean") -> Plane:
    """How much two pictures differ, in `[0, 1]` per pixel.

    **Arguments:** `kind`: `"euclidean"`, the RGB distance over its maximum sqrt(3), or
    `"max_channel"`, the largest channel difference.

    **Returns:** shape `(height, width)`; the gradient where they are equal is 0.

    **Source:** Kim et al., section on localisation; the normalisation makes the largest
    difference map to w_lb, as the text demands.
    """
    if kind == "max_channel":
        red, green, blue = jnp.abs(current - history)
        return jnp.clip(jnp.maximum(jnp.maximum(red, green), blue), 0.0, 1.0)
    return jnp.clip(color.distance(current, history) / 3**0.5, 0.0, 1.0)


def localized_minimum(
    w_min: Scalar,
    w_lb: Scalar,
    difference: Numbers,
    curve: AbstractCurve = _LINEAR,
) -> Numbers:
    """Return the smallest weight of the current picture, lower where it flickers.

    `w_min - (w_min - w_lb) curve(difference)`.

    **Source:** Kim et al., equation (5), where the curve is linear.
    """
    return w_min - (w_min - w_lb) * curve(difference)


def current_weight(minimum: Numbers, ease_of_speed: Numbers) -> Numbers:
    """Weight A of the current picture: `w + (1 - w) E`.

    Written as `1 - (1 - w) (1 - E)`, which is exactly 1 at `h >= h_max`.

    **Source:** Kim et al., equation (4), with equation (5) in the place of w_min.
    """
    return 1 - (1 - minimum) * (1 - ease_of_speed)


def usable(history: Rgb, current: Rgb, is_blended: Mask) -> Rgb:
    """Return the history where it is blended, elsewhere the current picture.

    Outside the past frame, and on dynamic objects, the current picture is shown. A NaN
    that lies there then enters neither weights nor gradients, as 0 x NaN would.
    """
    return jnp.where(is_blended[None], history, current)


def blend(current: Rgb, history: Rgb, weight: Plane) -> Rgb:
    """Return the displayed picture `A C + (1 - A) H`.

    Written as `C + (1 - A) (H - C)`, which is exactly C at A = 1 and at H = C.

    **Source:** Kim et al., equation (3).
    """
    return current + (1 - weight)[None] * (history - current)
