"""The task that hmdjit and its rivals are timed on: its numbers and its oracle.

Sessions of `STEPS + 1` white-noise poses around a hold pose, a texture of one texel per
pixel, bilinear reads that clamp at edges, float32. Each step renders a frame, finds the
past (Kim et al., equation (1) with d = 0.5), blends (equations (2) to (5)) and adds the
colour distance to the frame before (equation (6)).
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

W_MIN, W_LB, H_MAX_DEG_S = 0.3, 0.1, 25.0
CLOSENESS = 0.5
FOCAL_PX = 512.0
REFRESH_HZ = 60.0
STEPS = 10
NOISE_DEG, LARGEST_DEG = 0.12, 0.25  # per axis, white from frame to frame


class Size(NamedTuple):
    """Frames of `side x side` px; how many of the sessions the oracle repeats."""

    side: int
    sessions: int
    checked: int


SIZES = {
    "small": Size(64, 256, 8),
    "mid": Size(256, 32, 2),
    "big": Size(1024, 2, 1),
}
QUICK = {"small": Size(64, 16, 2), "mid": Size(256, 2, 1), "big": Size(1024, 2, 1)}


class Task(NamedTuple):
    """What every rival is given; pixel i has its centre at i.

    - `texture`: gamma colours, `(side, side, 3)`, float32.
    - `poses`: rotation vectors from the hold pose, rad, `(sessions, frames, 3)`; the
      first is 0.
    - `current`: homographies from a frame's pixels to the texture's,
      `(sessions, frames, 3, 3)`, float64.
    - `past`: from a frame's pixels to those of the frame before it; same shape.
    - `ease`: share of the current picture that head speed alone asks for,
      `(sessions, frames)`.
    """

    texture: np.ndarray
    poses: np.ndarray
    current: np.ndarray
    past: np.ndarray
    ease: np.ndarray

    @property
    def shape(self) -> tuple[int, int, int]:
        """Sessions, frames, side."""
        return (*self.poses.shape[:2], len(self.texture))

    @property
    def pixel_frames(self) -> int:
        """Pixels that are rendered, blended and measured in all."""
        sessions, frames, side = self.shape
        return sessions * (frames - 1) * side**2

    def save(self, path: Path) -> None:
        """Write all arrays to one file."""
        np.savez(path, **self._asdict())

    @classmethod
    def load(cls, path: Path) -> "Task":
        """Read what `save` wrote."""
        with np.load(path) as arrays:
            return cls(**arrays)


def make(side: int, sessions: int, steps: int = STEPS, seed: int = 0) -> Task:
    """Draw a task; the same one for the same arguments."""
    rng = np.random.default_rng(seed)
    degrees = rng.normal(scale=NOISE_DEG, size=(sessions, steps + 1, 3))
    poses = np.radians(np.clip(degrees, -LARGEST_DEG, LARGEST_DEG))
    poses[:, 0] = 0
    angle, turned_back = past_of(poses)
    return Task(
        _texture(rng, side),
        poses,
        _homographies(side, poses),
        _homographies(side, turned_back),
        ease(np.degrees(angle) * REFRESH_HZ),
    )


def past_of(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far each pose is from the last one, rad, and equation (1)'s rotation."""
    rotation = Rotation.from_rotvec(poses.reshape(-1, 3))
    before = Rotation.from_rotvec(np.roll(poses, 1, axis=1).reshape(-1, 3))
    increment = (before.inv() * rotation).as_rotvec().reshape(poses.shape)
    increment[:, 0] = 0
    return np.linalg.norm(increment, axis=-1), (1 - CLOSENESS) * increment


def ease(speed_deg_s: np.ndarray) -> np.ndarray:
    """The speed's part of equation (4)."""
    share = np.minimum(speed_deg_s / H_MAX_DEG_S, 1)
    return ((1 - np.cos(np.pi * share)) / 2) ** 2


def _texture(rng: np.random.Generator, side: int) -> np.ndarray:
    """Coloured noise with detail of a pixel, over a checkerboard of 8 px."""
    noise = gaussian_filter(rng.normal(size=(side, side, 3)), (0.7, 0.7, 0))
    noise = 0.5 + 0.2 * noise / noise.std()
    square = np.arange(side) // 8 % 2
    board = (square[:, None] ^ square[None, :])[..., None]
    return np.clip(0.7 * noise + 0.3 * board, 0, 1).astype(np.float32)


def _homographies(side: int, rotations: np.ndarray) -> np.ndarray:
    matrix = Rotation.from_rotvec(rotations.reshape(-1, 3)).as_matrix()
    centre = (side - 1) / 2
    to_ray = np.array([[1, 0, -centre], [0, -1, centre], [0, 0, -FOCAL_PX]]) / FOCAL_PX
    to_pixel = np.array([[-FOCAL_PX, 0, centre], [0, FOCAL_PX, centre], [0, 0, 1]])
    maps = to_pixel @ matrix @ to_ray
    maps /= maps[:, 2:, 2:]
    return maps.reshape(*rotations.shape[:-1], 3, 3)


def oracle(task: Task, sessions: int, *, masked: bool) -> np.ndarray:
    """MTCD of the first sessions, code values: float64, from rays, step by step.

    **Arguments:** `masked`: show the current picture where the past one lies outside
    the camera frame, as hmdjit does; else its edge is repeated.
    """
    _, frames, side = task.shape
    texture = task.texture.astype(np.float64)
    angle, turned_back = past_of(task.poses[:sessions])
    values = []
    for s in range(sessions):
        displayed = _read(texture, *_source(side, task.poses[s, 0]))
        distances = []
        for k in range(1, frames):
            current = _read(texture, *_source(side, task.poses[s, k]))
            x, y = _source(side, turned_back[s, k])
            past = _read(displayed, x, y)
            if masked:
                inside = (abs(x - (side - 1) / 2) <= side / 2) & (
                    abs(y - (side - 1) / 2) <= side / 2
                )
                past = np.where(inside[..., None], past, current)
            difference = np.sqrt(((current - past) ** 2).sum(axis=-1) / 3)[..., None]
            minimum = W_MIN - (W_MIN - W_LB) * difference
            share = minimum + (1 - minimum) * ease(np.degrees(angle[s, k]) * REFRESH_HZ)
            shown = share * current + (1 - share) * past
            distances.append(np.sqrt(((shown - displayed) ** 2).sum(axis=-1)).mean())
            displayed = shown
        values.append(255 * np.mean(distances))
    return np.array(values)


def _source(side: int, rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the turned rays of all pixels meet the image plane; centres at i."""
    centre = (side - 1) / 2
    column, row = np.meshgrid(np.arange(side), np.arange(side))
    ray = np.stack([column - centre, centre - row, np.full(row.shape, -FOCAL_PX)])
    a, b, c = np.tensordot(Rotation.from_rotvec(rotation).as_matrix(), ray, axes=1)
    return centre - FOCAL_PX * a / c, centre + FOCAL_PX * b / c


def _read(picture: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    side = len(picture)
    left, top = np.floor(x), np.floor(y)
    u, v = (x - left)[..., None], (y - top)[..., None]
    x0, x1 = (np.clip(left + i, 0, side - 1).astype(int) for i in (0, 1))
    y0, y1 = (np.clip(top + j, 0, side - 1).astype(int) for j in (0, 1))
    upper = (1 - u) * picture[y0, x0] + u * picture[y0, x1]
    lower = (1 - u) * picture[y1, x0] + u * picture[y1, x1]
    return (1 - v) * upper + v * lower
