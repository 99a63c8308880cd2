"""Do poses fit frames? Reprojection by them must bring each frame onto the last."""

import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy import ndimage
from scipy.spatial.transform import Rotation

from .. import camera as pinhole
from .. import color
from ..camera import Camera

_MOST_PAIRS, _MOST_POINTS = 32, 4096
_SMOOTHING_PX = 1.5  # else reprojection by any poses helps, because it blurs
_FOCAL_SCALES = [1.4, 1.7, 2, 2.4, 2.8, 4, 8, 16]
_LEAST_CHANGE, _LEAST_MOTION_PX = 0.03, 0.02  # to tell; code values

GIVEN, WITHOUT, INVERTED = "given", "without", "inverted"
_OTHERS = {  # what turns a wrong reading of quaternions `wxyz` into the right one
    INVERTED: lambda q: q * [1, -1, -1, -1],
    "axes": lambda q: q * [1, -1, -1, 1],
    "xyzw read as wxyz": lambda q: np.roll(q, 1, axis=1),
    "wxyz read as xyzw": lambda q: np.roll(q, -1, axis=1),
    "one frame late": lambda q: np.concatenate([q[1:], q[-1:]]),
    "one frame early": lambda q: np.concatenate([q[:1], q[:-1]]),
}


class PoseFit:
    """How far each frame is from the one before, reprojected by readings of poses.

    Over up to 4096 points of up to 32 pairs of frames. A point whose source lies
    outside the frame is compared unmoved.

    **Arguments:** `poses`: `world_from_head` of each frame, `(frames, 4)`, unit length.
    """

    def __init__(self, camera: Camera, poses: Float[np.ndarray, "frames 4"]):
        width, height = camera.width_px, camera.height_px
        self._every = math.ceil(max(len(poses) - 1, 1) / _MOST_PAIRS)
        step = math.ceil(math.sqrt(width * height / _MOST_POINTS))
        self._points = tuple(n.ravel() for n in np.mgrid[:height:step, :width:step])
        self._readings = {GIVEN: (camera, _turns(poses))}
        for name, other in _OTHERS.items():
            self._readings[name] = camera, _turns(other(poses))
        self._views = {}
        for scale in [*_FOCAL_SCALES, *(1 / scale for scale in _FOCAL_SCALES)]:
            tangent = math.tan(math.radians(camera.fov_deg) / 2) / scale
            fov_deg = math.degrees(2 * math.atan(tangent))
            other = Camera(width, height, fov_deg, camera.refresh_hz)
            name = f"a field of view of about {fov_deg:.3g} deg"
            self._views[name] = other, self._readings[GIVEN][1]
        self._readings |= self._views
        self._squares = dict.fromkeys([WITHOUT, *self._readings], 0.0)
        self._moved_px2, self._pairs, self._frame = 0.0, 0, 0
        self._last: np.ndarray | None = None

    def add(self, picture: Float[np.ndarray, "height width 3"]) -> None:
        """Take in the next picture; gamma colours in `[0, 1]`."""
        last, self._last = self._last, picture
        pair, self._frame = self._frame - 1, self._frame + 1
        if last is None or pair % self._every:
            return
        now, before = _smoothed(picture), _smoothed(last)
        rows, columns = self._points
        here = now[rows, columns]
        unmoved = (here - before[rows, columns]) ** 2
        self._squares[WITHOUT] += float(np.mean(unmoved))
        x, y = jnp.asarray(columns + 0.5), jnp.asarray(rows + 0.5)
        for name, (camera, turns) in self._readings.items():
            found = pinhole.displacement(camera, jnp.asarray(turns[pair]), x, y)
            dx, dy, is_inside = map(np.asarray, found)
            column, row = columns + dx, rows + dy
            is_inside = is_inside & (column >= 0) & (column <= before.shape[1] - 1)
            is_inside = is_inside & (row >= 0) & (row <= before.shape[0] - 1)
            there = ndimage.map_coordinates(before, [row, column], order=1)
            squares = np.where(is_inside, (here - there) ** 2, unmoved)
            self._squares[name] += float(np.mean(squares))
            if name == GIVEN:
                self._moved_px2 += float(np.mean(dx**2 + dy**2))
        self._pairs += 1

    def error(self, reading: str = GIVEN) -> float:
        """RMS error, code values of luma smoothed by 1.5 px."""
        return math.sqrt(self._squares[reading] / self._pairs)

    @property
    def tells(self) -> bool:
        """Whether head and frames move enough to tell."""
        moved_px = math.sqrt(self._moved_px2 / max(self._pairs, 1))
        return moved_px >= _LEAST_MOTION_PX and self.error(WITHOUT) >= _LEAST_CHANGE

    def likely_causes(self) -> list[str] | None:
        """Name readings by which poses fit, if any; None where they fit as given."""
        given, without = self._squares[GIVEN], self._squares[WITHOUT]
        least = min(self._squares.values())
        # Blur lowers errors too, but as much by inverted poses.
        helps = given < 0.99 * without and given < 0.95 * self._squares[INVERTED]
        if helps and 0.8 * given <= least:
            return None
        enough = least + 0.2 * (without - least)

        def is_likely(name: str) -> bool:
            most = 0.95 * given if name in (INVERTED, "axes") else 0.7 * without
            return self._squares[name] < min(enough, most) and name != GIVEN

        found = sorted(self._readings, key=lambda name: self._squares[name])
        found = [name for name in found if is_likely(name)]
        views = [name for name in found if name in self._views]
        return [name for name in found if name not in views[1:]]


def _turns(poses: Float[np.ndarray, "frames 4"]) -> Float[np.ndarray, "pairs 3"]:
    """Rotation vectors from each pose to the next, rad."""
    heads = Rotation.from_quat(poses, scalar_first=True)
    return (heads[:-1].inv() * heads[1:]).as_rotvec()


def _smoothed(
    picture: Float[np.ndarray, "height width 3"],
) -> Float[np.ndarray, "height width"]:
    luma = np.asarray(color.luma(jnp.asarray(np.moveaxis(picture, -1, 0))))
    return ndimage.gaussian_filter(color.CODE_VALUES * luma, _SMOOTHING_PX)
