"""Sub-pixel sample patterns: where in a pixel its samples lie.

Each table is `(samples, 2)`: position `(x, y)` from the pixel centre, px, x to the
right and y down. All are NumPy constants: patterns are part of a program's shape.
"""

import numpy as np
from jaxtyping import Float

from . import _checks

Pattern = Float[np.ndarray, "samples 2"]

# Standard multisample patterns, 1/16 px; the 4x pattern is the rotated grid (RGSS).
# Source: Direct3D 11.3 functional specification, section 19.2.4.1.
_MULTISAMPLE = {
    1: [(0, 0)],
    2: [(4, 4), (-4, -4)],
    4: [(-2, -6), (6, -2), (-6, 2), (2, 6)],
    8: [(1, -3), (-1, 3), (5, 1), (-3, -5), (-5, 5), (-7, -1), (3, 7), (7, -7)],
    16: [
        *[(1, 1), (-1, -3), (-3, 2), (4, -1), (-5, -2), (2, 5), (5, 3), (3, -5)],
        *[(-2, 6), (0, -7), (-4, -6), (-6, 4), (-8, 0), (7, -4), (6, 7), (-7, -8)],
    ],
}
MULTISAMPLE_COUNTS = tuple(_MULTISAMPLE)


def centre() -> Pattern:
    """Return the one sample at the pixel centre, shape `(1, 2)`."""
    return np.zeros((1, 2))


def multisample(samples: int) -> Pattern:
    """Return the standard MSAA pattern of 1, 2, 4, 8 or 16 samples.

    **Errors:** `ValueError` for any other count.
    """
    if type(samples) is not int or samples not in _MULTISAMPLE:
        raise ValueError(f"samples must be 1, 2, 4, 8 or 16, got {samples!r}.")
    return np.array(_MULTISAMPLE[samples], dtype=float) / 16


def ordered_grid(factor: int) -> Pattern:
    """Return the `factor` x `factor` grid `(a + 0.5) / factor - 0.5`, row by row.

    `factor = 2` is the 2 x 2 ordered grid (OGSS) at +-4/16 px.
    """
    _checks.whole("factor", factor, 1)
    axis = (np.arange(factor) + 0.5) / factor - 0.5
    y, x = np.meshgrid(axis, axis, indexing="ij")
    return np.stack([x.ravel(), y.ravel()], axis=1)


def radical_inverse(base: int, index: int, *, scrambled: bool = False) -> float:
    """Mirror the digits of `index` at the point.

    `scrambled` permutes the non-zero digits to `base - d` (reverse radix): base 2 is
    unchanged, base 3 swaps 1 and 2.

    **Source:** Halton 1960; the permutation is Kocis and Whiten 1997 (RR2) for the
    bases 2 and 3.
    """
    value, scale = 0.0, 1.0
    while index > 0:
        index, digit = divmod(index, base)
        scale /= base
        value += scale * ((base - digit) % base if scrambled else digit)
    return value


def halton(count: int, *, first: int = 1, scrambled: bool = False) -> Pattern:
    """Return Halton points of bases (2, 3), from index `first`, shape `(count, 2)`.

    The points lie in [0, 1)^2: subtract 1/2 to get offsets from the pixel centre.
    """
    _checks.whole("count", count, 1)
    _checks.whole("first", first, 0)
    return np.array(
        [
            [radical_inverse(base, first + n, scrambled=scrambled) for base in (2, 3)]
            for n in range(count)
        ]
    )


def accumulation(samples: int) -> Pattern:
    """Return where the renders of an accumulation buffer lie, shape `(samples, 2)`.

    A scrambled Halton sequence from index 0 on. It begins in the pixel's upper left
    corner, so that 128 samples have their mean at (-0.0039, -0.0056) px.

    **Source:** code of Oliveros' thesis, where the picture moves the other way.
    """
    return halton(samples, first=0, scrambled=True) - 0.5


def jitter(period: int) -> Pattern:
    """Return where a jittered camera samples, frame by frame, shape `(period, 2)`.

    Halton points of bases (2, 3), mirrored at the pixel centre: published sequences say
    where the picture goes, which is the other way.
    """
    return 0.5 - halton(period)


def thesis_jitter() -> Pattern:
    """Return where the camera of Oliveros' thesis samples, frame by frame, `(16, 2)`.

    Those of the accumulation buffer, over 1.7 px.
    """
    return 1.7 * accumulation(16)
