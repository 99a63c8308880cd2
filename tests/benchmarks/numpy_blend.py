"""Blending and MTCD in NumPy, for rivals that warp with something else."""

from collections.abc import Callable

import numpy as np
from task import W_LB, W_MIN, Task

Warp = Callable[[np.ndarray, np.ndarray], np.ndarray]

_PER_DIFFERENCE = np.float32((W_MIN - W_LB) / 3**0.5)


def session(task: Task, s: int, warp: Warp) -> float:
    """MTCD of a session, pictures `(height, width, 3)`, float32.

    **Arguments:** `warp`: picture and homography to the warped picture.
    """
    displayed = warp(task.texture, task.current[s, 0])
    total = 0.0
    for k in range(1, task.shape[1]):
        change = warp(task.texture, task.current[s, k])
        shown = warp(displayed, task.past[s, k])
        change -= shown
        # A = w + (1 - w) E with w = w_min - (w_min - w_lb) |C - H| / sqrt(3)
        weight = _length(change)
        weight *= -_PER_DIFFERENCE * np.float32(1 - task.ease[s, k])
        weight += np.float32(W_MIN + (1 - W_MIN) * task.ease[s, k])
        change *= weight[..., None]
        shown += change
        displayed -= shown
        total += float(np.mean(_length(displayed)))
        displayed = shown
    return 255 * total / (task.shape[1] - 1)


def _length(colors: np.ndarray) -> np.ndarray:
    squared = np.einsum("yxc,yxc->yx", colors, colors)
    return np.sqrt(squared, out=squared)
