"""Rival: OpenCV warps, NumPy blends."""

import cv2
import numpy as np
from numpy_blend import session
from serving import Run, each_session, serve
from task import Task


def warp(picture: np.ndarray, homography: np.ndarray) -> np.ndarray:
    """Read a picture where a homography says, its edges repeated."""
    return cv2.warpPerspective(
        picture,
        homography,
        picture.shape[:2],
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )


def build(task: Task) -> Run:
    """One thread per session: OpenCV's own threads gain less."""
    cv2.setNumThreads(1)
    return each_session(lambda s: session(task, s, warp), task.shape[0])


if __name__ == "__main__":
    serve(build)
