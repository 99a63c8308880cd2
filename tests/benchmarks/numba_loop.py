"""Rival: everything in one Numba loop, parallel over sessions."""

import numba
import numpy as np
from machine import cpus
from serving import Run, serve
from task import W_LB, W_MIN, Task


@numba.njit(fastmath=True, inline="always")
def read(picture, h, column, row):
    """Colour where a homography sends a pixel, edges repeated."""
    last = picture.shape[0] - 1
    x, y = np.float32(column), np.float32(row)
    scale = np.float32(1) / (h[2, 0] * x + h[2, 1] * y + np.float32(1))
    x_source = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) * scale
    y_source = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) * scale
    left, top = np.floor(x_source), np.floor(y_source)
    u, v = x_source - left, y_source - top
    i, j = np.int32(left), np.int32(top)
    x0, x1 = min(max(i, 0), last), min(max(i + 1, 0), last)
    y0, y1 = min(max(j, 0), last), min(max(j + 1, 0), last)
    r = picture[y0, x0, 0] + u * (picture[y0, x1, 0] - picture[y0, x0, 0])
    g = picture[y0, x0, 1] + u * (picture[y0, x1, 1] - picture[y0, x0, 1])
    b = picture[y0, x0, 2] + u * (picture[y0, x1, 2] - picture[y0, x0, 2])
    r += v * (picture[y1, x0, 0] + u * (picture[y1, x1, 0] - picture[y1, x0, 0]) - r)
    g += v * (picture[y1, x0, 1] + u * (picture[y1, x1, 1] - picture[y1, x0, 1]) - g)
    b += v * (picture[y1, x0, 2] + u * (picture[y1, x1, 2] - picture[y1, x0, 2]) - b)
    return r, g, b


@numba.njit(fastmath=True, parallel=True)
def measure(texture, current, past, ease, w_min, per_difference):
    """MTCD of all sessions, code values."""
    side = texture.shape[0]
    sessions, frames = ease.shape
    mtcd = np.zeros(sessions)
    for s in numba.prange(sessions):
        displayed = np.empty_like(texture)
        shown = np.empty_like(texture)
        for y in range(side):
            for x in range(side):
                r, g, b = read(texture, current[s, 0], x, y)
                displayed[y, x, 0] = r
                displayed[y, x, 1] = g
                displayed[y, x, 2] = b
        total = 0.0
        for k in range(1, frames):
            for y in range(side):
                row = np.float32(0)
                for x in range(side):
                    r, g, b = read(texture, current[s, k], x, y)
                    red, green, blue = read(displayed, past[s, k], x, y)
                    r, g, b = r - red, g - green, b - blue
                    minimum = w_min - per_difference * np.sqrt(r * r + g * g + b * b)
                    weight = minimum + (np.float32(1) - minimum) * ease[s, k]
                    red, green, blue = (
                        red + weight * r,
                        green + weight * g,
                        blue + weight * b,
                    )
                    shown[y, x, 0] = red
                    shown[y, x, 1] = green
                    shown[y, x, 2] = blue
                    r = red - displayed[y, x, 0]
                    g = green - displayed[y, x, 1]
                    b = blue - displayed[y, x, 2]
                    row += np.sqrt(r * r + g * g + b * b)
                total += row
            displayed, shown = shown, displayed
        mtcd[s] = 255 * total / ((frames - 1) * side**2)
    return mtcd


def build(task: Task) -> Run:
    """As many threads as cores."""
    numba.set_num_threads(len(cpus()))
    current, past, ease = (
        array.astype(np.float32) for array in (task.current, task.past, task.ease)
    )
    w_min, per_difference = np.float32(W_MIN), np.float32((W_MIN - W_LB) / 3**0.5)
    return lambda: measure(task.texture, current, past, ease, w_min, per_difference)


if __name__ == "__main__":
    serve(build)
