"""Small clips with all channels, cast ray by ray in NumPy: what temporal oracles see.

Flat things stand in a world of x right, y up, z back, metres: a sky at no distance, a
slanted plane, a rectangle that moves and turns, a disc that stretches. Pictures are
`(height, width, channels)`, positions continuous px with y down, as in `oracles.py`.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

WIDTH_PX, HEIGHT_PX, FRAMES, FOV_DEG = 24, 20, 8, 40.0
FOCAL_PX = WIDTH_PX / 2 / np.tan(np.radians(FOV_DEG) / 2)
X_PX, Y_PX = np.meshgrid(np.arange(WIDTH_PX) + 0.5, np.arange(HEIGHT_PX) + 0.5)
STATIC, RIGID, DEFORMING = 0, 1, 2
SKY, PLANE, CARD, DISC = range(4)
CLASS_OF = np.array([STATIC, STATIC, RIGID, DEFORMING])
SCALE = 10.0  # pictures stay the same, depths are such that the thesis' thresholds act


class Clip(NamedTuple):
    """Frames and channels, `(frames, height, width, ...)`, and who saw them."""

    color: np.ndarray
    depth: np.ndarray
    object_id: np.ndarray
    motion_class: np.ndarray
    albedo: np.ndarray
    velocity_px: np.ndarray
    jitter_px: np.ndarray
    poses: np.ndarray
    object_poses: np.ndarray

    def channels(self):
        """Return what `apply` is given beside colour, poses and camera."""
        others = self._asdict()
        return {name: others[name] for name in others if name not in ("color", "poses")}


# --- movement ---


def _poses(turns_rad, places_m):
    turns = Rotation.from_rotvec(turns_rad).as_quat(scalar_first=True)
    return np.concatenate([turns, places_m], axis=1)


def head_poses(frames=FRAMES, is_moving=True):
    """Where a head is that turns about all axes, and moves along all."""
    k = np.arange(frames) * is_moving
    turns = [0.004 + 0.011 * k, 0.02 - 0.017 * k, 0.01 * np.sin(k)]
    places = [0.05 * k, 0.3 + 0.04 * np.sin(k), -0.06 * k]
    return _poses(np.stack(turns, axis=1), np.stack(places, axis=1))


def object_poses(frames=FRAMES, is_moving=True):
    """World from each thing, `(frames, 4, 7)`: only the card's changes."""
    k = np.arange(frames) * is_moving
    one = np.ones(frames)
    sky = _poses(0 * one[:, None] * np.ones(3), 0 * one[:, None] * np.ones(3))
    plane = _poses(np.outer(one, [-1.25, 0.1, 0]), np.outer(one, [0, -2.5, -14.0]))
    turns = np.stack([0.1 * one, 0.35 - 0.06 * k, 0.09 * k], axis=1)
    places = np.stack([-1.5 + 0.5 * k, 0.35 + 0.08 * k, -6 + 0.1 * k], axis=1)
    disc = _poses(np.outer(one, [0.1, -0.2, 0.3]), np.outer(one, [1.7, 1.0, -9.0]))
    return np.stack([sky, plane, _poses(turns, places), disc], axis=1)


def stretch(k, is_moving=True):
    """How much wider than tall the disc is in frame k."""
    return 1 + 0.12 * k * is_moving


# --- surfaces ---


def _texture(u, v, phase):
    """Smooth waves, and squares with hard edges; `(..., 3)` in [0.04, 0.96]."""
    waves = [np.sin(1.9 * u + 0.7 * v + phase + c) for c in (0.0, 1.3, 2.9)]
    squares = np.sign(np.sin(2.3 * u + phase) * np.sin(2.9 * v - phase))
    tints = (0.21, 0.13, -0.17)
    return np.stack(
        [0.5 + 0.25 * w + t * squares for w, t in zip(waves, tints, strict=True)], -1
    )


def _matrices(pose):
    turn = Rotation.from_quat(pose[:4], scalar_first=True).as_matrix()
    return turn, pose[4:]


def rays(x_px, y_px):
    """Rays of pixel positions in the head's axes, with z = -1."""
    ray_x, ray_y = (x_px - WIDTH_PX / 2) / FOCAL_PX, (HEIGHT_PX / 2 - y_px) / FOCAL_PX
    return np.stack([ray_x, ray_y, -np.ones_like(ray_x)], axis=-1)


def projected(points):
    """Pixel positions of points of the head's axes, all of them in front."""
    across, up, depth = points[..., 0], points[..., 1], -points[..., 2]
    x = WIDTH_PX / 2 + FOCAL_PX * across / depth
    return np.stack([x, HEIGHT_PX / 2 - FOCAL_PX * up / depth], axis=-1)


def _shape(thing, u, v):
    """Whether places of a thing's own plane belong to it."""
    if thing == PLANE:
        return (np.abs(u) < 9) & (np.abs(v) < 16)
    if thing == CARD:
        return (np.abs(u) < 0.8) & (np.abs(v) < 0.6)
    return u**2 + v**2 < 1.1


def _cast(k, jitter_px, heads, things, is_moving):
    """All that frame k shows; a rest of the world before it, for the velocity."""
    x, y = X_PX + jitter_px[0], Y_PX + jitter_px[1]
    turn, eye = _matrices(heads[k])
    last_turn, last_eye = _matrices(heads[max(k - 1, 0)])
    ray = rays(x, y)
    ahead = ray @ turn.T

    depth = np.full(x.shape, np.inf)
    ids = np.zeros(x.shape, int)
    albedo = _texture(9 * ahead[..., 0], 9 * ahead[..., 1], 0.4)
    light = np.ones(x.shape)
    past = projected(ahead @ last_turn)
    shown = depth, ids, albedo, light, past

    for thing in (PLANE, CARD, DISC):
        own, place = _matrices(things[k, thing])
        start, along = (eye - place) @ own, ahead @ own
        reach = -start[2] / np.where(along[..., 2] == 0, np.nan, along[..., 2])
        met = start + reach[..., None] * along
        width, width_before = 1.0, 1.0
        if thing == DISC:
            width, width_before = stretch(k, is_moving), stretch(max(k - 1, 0))
            width_before = width_before if is_moving else 1.0
        u, v = met[..., 0] / width, met[..., 1]
        is_seen = (reach > 0.1) & (reach < depth) & _shape(thing, u, v)
        own, place = _matrices(things[max(k - 1, 0), thing])
        before = np.stack([width_before * u, v, 0 * u], axis=-1) @ own.T + place
        seen_before = projected((before - last_eye) @ last_turn)
        lit = 0.75 + 0.25 * np.cos(1.3 * u - 0.8 * v)
        one = np.full(x.shape, thing)
        now = reach, one, _texture(u, v, 1.1 * thing), lit, seen_before
        for value, new in zip(shown, now, strict=True):
            value[is_seen] = new[is_seen]
    moved = np.stack([x, y], axis=-1) - past
    return albedo * light[..., None], depth, ids, CLASS_OF[ids], albedo, moved


def solid_clip(jitter_px, is_moving=True, frames=FRAMES):
    """Clip of the four things; all stand still if `is_moving` is False.

    **Arguments:** `jitter_px`: samples' places from the pixel centre, `(period, 2)`.
    """
    heads, things = head_poses(frames, is_moving), object_poses(frames, is_moving)
    jitter = np.resize(jitter_px, (frames, 2))
    cast = lambda k: _cast(k, jitter[k], heads, things, is_moving)
    color, depth, *others = map(np.stack, zip(*map(cast, range(frames)), strict=True))
    heads[:, 4:] *= SCALE
    things[..., 4:] *= SCALE
    planes = (color, SCALE * depth, *others, jitter, heads, things)
    return Clip._make(planes)


def flat_clip(color, jitter_px, velocity_px=(0.0, 0.0)):
    """Clip without edges in depth, of colours given by `color(k, x, y)`; one id."""
    jitter = np.resize(jitter_px, (FRAMES, 2))
    shown = [color(k, X_PX + s[0], Y_PX + s[1]) for k, s in enumerate(jitter)]
    one = np.ones((FRAMES, HEIGHT_PX, WIDTH_PX))
    velocity = one[..., None] * np.asarray(velocity_px, float)
    velocity[0] = 0
    none, things = (0 * one).astype(int), object_poses(FRAMES, False)
    heads = head_poses(FRAMES, False)
    color = np.stack(shown)
    return Clip(color, 5 * one, none, none, color, velocity, jitter, heads, things)


def ramp(x, y):
    """Affine colours, `(..., 3)` in [0.02, 0.98] where pictures show them."""
    slopes = [(0.016, 0.013), (-0.011, 0.02), (0.02, -0.012)]
    planes = [0.5 + a * (x - WIDTH_PX / 2) + b * (y - HEIGHT_PX / 2) for a, b in slopes]
    return np.stack(planes, axis=-1)


def ramp_clip(jitter_px, velocity_px=(0.0, 0.0)):
    """Affine ramp that moves by some px from frame to frame."""
    dx, dy = velocity_px
    return flat_clip(
        lambda k, x, y: ramp(x - dx * k, y - dy * k), jitter_px, velocity_px
    )
