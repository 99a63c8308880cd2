"""Rival: OpenCV warps, one Numba loop blends and measures."""

import cv2
import numba
import numpy as np
from opencv_numpy import warp
from serving import Run, each_session, serve
from task import W_LB, W_MIN, Task


@numba.njit(fastmath=True, nogil=True)
def blend(current, past, displayed, ease, w_min, per_difference):
    """Blend into `past`, and return the mean distance to what was displayed."""
    height, width, _ = current.shape
    total = 0.0
    for y in range(height):
        row = np.float32(0)
        for x in range(width):
            r = current[y, x, 0] - past[y, x, 0]
            g = current[y, x, 1] - past[y, x, 1]
            b = current[y, x, 2] - past[y, x, 2]
            minimum = w_min - per_difference * np.sqrt(r * r + g * g + b * b)
            weight = minimum + (np.float32(1) - minimum) * ease
            past[y, x, 0] += weight * r
            past[y, x, 1] += weight * g
            past[y, x, 2] += weight * b
            r = past[y, x, 0] - displayed[y, x, 0]
            g = past[y, x, 1] - displayed[y, x, 1]
            b = past[y, x, 2] - displayed[y, x, 2]
            row += np.sqrt(r * r + g * g + b * b)
        total += row
    return total / (height * width)


def build(task: Task) -> Run:
    """One thread per session."""
    cv2.setNumThreads(1)
    ease = task.ease.astype(np.float32)
    w_min, per_difference = np.float32(W_MIN), np.float32((W_MIN - W_LB) / 3**0.5)
    sessions, frames, _ = task.shape

    def one(s: int) -> float:
        displayed = warp(task.texture, task.current[s, 0])
        total = 0.0
        for k in range(1, frames):
            current = warp(task.texture, task.current[s, k])
            shown = warp(displayed, task.past[s, k])
            total += blend(current, shown, displayed, ease[s, k], w_min, per_difference)
            displayed = shown
        return 255 * total / (frames - 1)

    return each_session(one, sessions)


if __name__ == "__main__":
    serve(build)
