"""Slow, obvious, independent float64 NumPy versions of what the package computes.

Nothing here imports the package. Pictures are `(height, width, channels)`, positions
are continuous pixels with the first pixel's centre at (0.5, 0.5), row 0 on top.
"""

import itertools

import numpy as np
import scipy.linalg
import scipy.ndimage
from scipy.spatial.transform import Rotation, Slerp

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


# --- head motion ---


def poses_after(increments):
    """Poses `wxyz` that start at the identity and turn by rotation vectors."""
    poses = [Rotation.identity()]
    for increment in increments:
        poses.append(poses[-1] * Rotation.from_rotvec(increment))
    return Rotation.concatenate(poses).as_quat(scalar_first=True)


# --- pictures ---


def smooth_noise(rng, height, width, blur_px):
    """Gamma noise, `(height, width, 3)`, full range, detail of about `blur_px`."""
    noise = rng.normal(size=(height, width, 3))
    noise = scipy.ndimage.gaussian_filter(noise, (blur_px, blur_px, 0), mode="wrap")
    low, high = noise.min(), noise.max()
    return (noise - low) / (high - low)


# --- Kim et al.: head-movement based temporal anti-aliasing ---


def kim_past_position(width, height, fov_deg, before, now, closeness):
    """Equation (1), `P slerp(V_{n-1}, V_n, d) V_n^-1 P^-1 v`, as `(2, h, w)` px.

    `before` and `now` are poses `world_from_head`; V is head from world.
    """
    views = Rotation.from_quat([before, now], scalar_first=True).inv()
    turn = Slerp([0.0, 1.0], views)(closeness) * views[1].inv()
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    ray = ray_of(width, height, fov_deg, x, y)
    seen = np.tensordot(turn.as_matrix(), ray, axes=1)
    return project(width, height, fov_deg, seen)


def head_speed_deg_s(before, now, refresh_hz):
    views = Rotation.from_quat([before, now], scalar_first=True)
    return np.degrees((views[0].inv() * views[1]).magnitude()) * refresh_hz


def bilinear_at(picture, x, y):
    """`bilinear` at many positions `(h, w)`: `(h, w, channels)`."""
    height, width = picture.shape[:2]
    left, top = np.floor(x - 0.5), np.floor(y - 0.5)
    total = np.zeros((*x.shape, picture.shape[2]))
    for column, row in [
        (left, top),
        (left + 1, top),
        (left, top + 1),
        (left + 1, top + 1),
    ]:
        weight = (1 - abs(x - 0.5 - column)) * (1 - abs(y - 0.5 - row))
        i = np.clip(column, 0, width - 1).astype(int)
        j = np.clip(row, 0, height - 1).astype(int)
        total += weight[..., None] * picture[j, i]
    return total


def kim_ease(speed_deg_s, h_max_deg_s):
    """The speed's part of equation (4)."""
    share = min(speed_deg_s, h_max_deg_s) / h_max_deg_s
    return ((1 - np.cos(np.pi * share)) / 2) ** 2


def kim_step(
    current,
    displayed_before,
    before,
    now,
    *,
    fov_deg,
    refresh_hz,
    w_min=0.3,
    w_lb=0.1,
    h_max_deg_s=25.0,
    closeness=(2 / 3,),
    weights=None,
    difference="euclidean",
    static=True,
):
    """Equations (1) to (5): the picture displayed next, in the space of its inputs."""
    height, width = current.shape[:2]
    weights = np.array(closeness if weights is None else weights, float)
    history = np.zeros_like(current)
    blended = np.broadcast_to(static, (height, width)).copy()
    for d, weight in zip(closeness, weights / weights.sum(), strict=True):
        x, y = kim_past_position(width, height, fov_deg, before, now, d)
        blended &= (x >= 0) & (x <= width) & (y >= 0) & (y <= height)
        x, y = np.nan_to_num(x), np.nan_to_num(y)  # behind the head: not blended
        history += weight * bilinear_at(displayed_before, x, y)
    other = displayed_before if difference == "same_pixel" else history
    if difference == "max_channel":
        disagreement = np.abs(current - other).max(axis=-1)
    else:
        disagreement = np.sqrt(((current - other) ** 2).sum(axis=-1)) / np.sqrt(3)
    disagreement = np.clip(disagreement, 0, 1)[..., None]
    minimum = w_min - (w_min - w_lb) * disagreement
    ease = kim_ease(head_speed_deg_s(before, now, refresh_hz), h_max_deg_s)
    share = minimum + (1 - minimum) * ease
    shown = share * current + (1 - share) * history
    return np.where(blended[..., None], shown, current)


def kim(frames, poses, *, space="gamma", static=None, **options):
    """Displayed gamma frames of a clip of gamma frames `(frames, h, w, 3)`."""
    decode, encode = (
        (srgb_decode, srgb_encode) if space == "linear" else (lambda c: c,) * 2
    )
    shown = [decode(np.asarray(frames[0], float))]
    for k in range(1, len(frames)):
        mask = True if static is None else static[k]
        current = decode(np.asarray(frames[k], float))
        shown.append(
            kim_step(current, shown[-1], poses[k - 1], poses[k], static=mask, **options)
        )
    return np.stack([encode(picture) for picture in shown])


# --- metrics ---


def mtcd(clip):
    """Kim et al., equation (6), pixel by pixel, in code values."""
    clip = 255 * np.asarray(clip, float)
    pairs = itertools.pairwise(clip)
    return np.mean([np.linalg.norm(b - a, axis=-1).mean() for a, b in pairs])


def mse(test, reference):
    test, reference = np.asarray(test, float), np.asarray(reference, float)
    return np.mean((test - reference) ** 2)
