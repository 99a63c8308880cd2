"""Means that go on with each frame, as long as resampling allows."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._types import Plane, Rgb, Scalar
from ..frames.displacement import AnyDisplacement


def resampling_variance(dx: Plane, dy: Plane) -> Plane:
    """Variance that a bilinear read spreads a pixel by, mean of both axes, texels^2.

    **Arguments:** displacement, texels, of which the fractions count.
    """
    x, y = dx - jnp.floor(dx), dy - jnp.floor(dy)
    return (x * (1 - x) + y * (1 - y)) / 2


def with_sample(
    past: Float[Array, "4 height width"],
    sample: Rgb,
    displacement: AnyDisplacement,
    blur_limit: Scalar,
    min_weight: Scalar,
) -> Float[Array, "4 height width"]:
    """Take a sample into a mean of colours, and count it; colour and age.

    **Arguments:** `displacement`: by which the past was read; `blur_limit`: largest
    variance that such reads may add, of its unit squared; `min_weight`: of a sample.

    **Source:** Yang et al., "Amortized supersampling", SIGGRAPH Asia 2009.
    """
    color, age = past[:3], past[3] + 1
    blur = resampling_variance(*displacement.px())
    least = jnp.maximum(blur / (blur + blur_limit), min_weight)
    color = color + jnp.maximum(1 / age, least)[None] * (sample - color)
    age = age / jnp.maximum(age * min_weight, 1)  # min(age, 1 / min_weight), also of 0
    return jnp.concatenate([color, age[None]])
