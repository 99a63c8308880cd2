"""How wide a halo keeps what a region's edge does out of the measured pixels."""

import numpy as np
from jaxtyping import Int

from ..techniques.base import HistoryReach

HALO_TOLERANCE = 1e-5
"""What a halo's outer edge does may reach measured pixels with less than this."""


_WIDEST_PX = 4096  # a halo as wide as this reaches the edges of the camera frame


def required_halo_px(
    reach: HistoryReach, *, tolerance: float = HALO_TOLERANCE
) -> Int[np.ndarray, "*sessions"]:
    """Halo that keeps what its outer edge does out of the measured pixels.

    Let `e_j` bound the error at depth j pixels from an edge. Pixels beyond the edge are
    wrong by up to 1. A history read from up to `s = n + f` px nearer to the edge mixes
    depths `j - n` and `j - n - 1` with weights `1 - f` and `f` (bilinear), and of that
    mix at most the technique's gain g remains:
    `e_j <- g ((1 - f) e_{j-n} + f e_{j-n-1})`. A negative s, a read from farther
    inside, takes error away from the edge.

    **Arguments:** `reach`: of the frames of each session.

    **Returns:** per session, the smallest whole halo, px, whose error after any frame,
    horizontal plus vertical, is below `tolerance` (of the colour range).
    """
    *sessions, frames, _ = reach.inwards_px.shape
    tolerance /= reach.display_slope
    # The four edges are four cases of one recursion. No frame is wider than the limit.
    inwards_px = np.clip(reach.inwards_px, -_WIDEST_PX, _WIDEST_PX)
    step = np.moveaxis(inwards_px, -1, 0).reshape(-1, frames)
    gain = np.broadcast_to(reach.gain, (4, *reach.gain.shape)).reshape(-1, frames)
    whole = np.floor(step).astype(int)
    fraction = step - whole
    deepest = int(np.max(np.sum(np.maximum(whole + 1, 0), axis=1), initial=0))
    deepest = min(deepest, _WIDEST_PX)
    depth = np.arange(1, deepest + 1)
    error = np.zeros((len(step), deepest + 1))  # depth 0 is beyond the edge
    error[:, 0] = 1.0
    halo = np.zeros(len(step), int)
    for k in range(frames):
        near_depth = np.clip(depth - whole[:, k, None], 0, deepest)
        far_depth = np.clip(depth - whole[:, k, None] - 1, 0, deepest)
        near = np.take_along_axis(error, near_depth, axis=1)
        far = np.take_along_axis(error, far_depth, axis=1)
        mixed = near + fraction[:, k, None] * (far - near)
        # An error cannot exceed the colour range.
        error[:, 1:] = np.minimum(gain[:, k, None] * mixed, 1.0)
        # Errors fall with depth, so those above the tolerance are the first ones; at
        # each of two edges (left or right, top or bottom) half of it is allowed.
        halo = np.maximum(halo, np.sum(error >= tolerance / 2, axis=1) - 1)
    return np.max(halo.reshape(4, *sessions), axis=0)
