"""Rival: SciPy's `map_coordinates` reads, NumPy blends."""

import numpy as np
from numpy_blend import session
from scipy.ndimage import map_coordinates
from serving import Run, each_session, serve
from task import Task


def build(task: Task) -> Run:
    """One thread per session."""
    sessions, _, side = task.shape
    row, column = np.mgrid[:side, :side].astype(np.float32)

    def warp(picture: np.ndarray, homography: np.ndarray) -> np.ndarray:
        (a, b, c), (d, e, f), (g, h, _) = homography.astype(np.float32)
        depth = g * column + h * row + 1
        x = (a * column + b * row + c) / depth
        y = (d * column + e * row + f) / depth
        warped = np.empty_like(picture)
        for channel in range(3):
            warped[..., channel] = map_coordinates(
                picture[..., channel], (y, x), order=1, mode="nearest"
            )
        return warped

    return each_session(lambda s: session(task, s, warp), sessions)


if __name__ == "__main__":
    serve(build)
