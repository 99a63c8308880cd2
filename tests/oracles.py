"""Slow, obvious, independent float64 NumPy versions of what the package computes.

Nothing here imports the package. Pictures are `(height, width, channels)`, positions
are continuous pixels with the first pixel's centre at (0.5, 0.5), row 0 on top.
"""

import numpy as np
import scipy.linalg

# --- derivatives ---


def jacobian(function, x, step=1e-5):
    """Central differences: errs by about step^2 and by 1e-16 / step."""
    x = np.asarray(x, float)
    columns = []
    for index in np.ndindex(x.shape):
        change = np.zeros(x.shape)
        change[index] = step
        ahead, behind = (np.asarray(function(x + s * change)) for s in (1, -1))
        columns.append((ahead - behind) / (2 * step))
    return np.stack(columns, axis=-1).reshape(*columns[0].shape, *x.shape)


# --- rotations ---


def rotation_matrix(rotation):
    """Matrix of a rotation vector: the exponential of its cross-product matrix."""
    x, y, z = np.asarray(rotation, float)
    return scipy.linalg.expm(np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]))


# --- pinhole camera ---


def focal_px(width, fov_deg):
    return width / 2 / np.tan(np.radians(fov_deg) / 2)


def ray_of(width, height, fov_deg, x, y):
    """Ray of a pixel position in the head frame, `(3, ...)`."""
    f = focal_px(width, fov_deg)
    x, y = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
    return np.stack([(x - width / 2) / f, (height / 2 - y) / f, -np.ones_like(x)])


def project(width, height, fov_deg, ray):
    """Pixel position of a ray, `(2, ...)`; NaN where it is not in front."""
    depth = np.where(ray[2] < 0, -ray[2], np.nan)
    f = focal_px(width, fov_deg)
    return np.stack([width / 2 + f * ray[0] / depth, height / 2 - f * ray[1] / depth])


def source_position(width, height, fov_deg, rotation, x, y):
    """Where the turned rays of pixel positions meet the image plane, `(2, ...)`."""
    ray = ray_of(width, height, fov_deg, x, y)
    turned = np.tensordot(rotation_matrix(rotation), ray, axes=1)
    return project(width, height, fov_deg, turned)


# --- reading a picture between its pixels ---


def sample(picture, x, y, kernel, reach):
    """Sum of the pixels around (x, y), weighted by their distance; border clamps."""
    height, width = picture.shape[:2]
    column, row = int(np.floor(x - 0.5)), int(np.floor(y - 0.5))
    total = np.zeros(picture.shape[2])
    for j in range(row - reach + 1, row + reach + 1):
        for i in range(column - reach + 1, column + reach + 1):
            weight = kernel(x - 0.5 - i) * kernel(y - 0.5 - j)
            inside = picture[min(max(j, 0), height - 1), min(max(i, 0), width - 1)]
            total = total + weight * inside
    return total


def tent(distance):
    return max(0.0, 1.0 - abs(distance))


def keys_cubic(distance):
    """Keys 1981, equation 15, with a = -1/2: the Catmull-Rom kernel."""
    d = abs(distance)
    if d < 1:
        return 1.5 * d**3 - 2.5 * d**2 + 1
    if d < 2:
        return -0.5 * d**3 + 2.5 * d**2 - 4 * d + 2
    return 0.0


def bilinear(picture, x, y):
    return sample(picture, x, y, tent, 1)


def catmull_rom(picture, x, y):
    return sample(picture, x, y, keys_cubic, 2)


def nearest(picture, x, y):
    height, width = picture.shape[:2]
    column, row = int(np.floor(x)), int(np.floor(y))
    return picture[min(max(row, 0), height - 1), min(max(column, 0), width - 1)]


def sample_all(read, picture, positions):
    """Read a picture at `(h, w, 2)` positions: planes `(channels, h, w)`."""
    rows = [[read(picture, x, y) for x, y in row] for row in positions]
    return np.moveaxis(np.array(rows), -1, 0)


# --- colour ---


def srgb_encode(linear):
    """IEC 61966-2-1, one value at a time."""
    values = [
        12.92 * v if v <= 0.0031308 else 1.055 * v ** (1 / 2.4) - 0.055
        for v in np.ravel(np.asarray(linear, float))
    ]
    return np.reshape(values, np.shape(linear))


def srgb_decode(gamma):
    """IEC 61966-2-1, one value at a time."""
    values = [
        v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4
        for v in np.ravel(np.asarray(gamma, float))
    ]
    return np.reshape(values, np.shape(gamma))
