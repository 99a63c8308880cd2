"""What rays meet in a scene of solids, in float64 NumPy: slow, and by other formulas.

The ray is taken to each object's own place instead of the object to the eye; planes are
met by solving for three unknowns, balls and tubes by their quadratics, ends apart.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from hmdjit.scenes.primitives import NEAR_M, Capsules, Quads, Spheres


def rows(scene):
    """Each primitive as a dict of its numbers, in the order of its surface numbers."""
    for table in scene.tables:
        for i in range(len(table.object)):
            named = {k: np.asarray(v)[i] for k, v in vars(table.rows).items()}
            named["object"] = np.asarray(table.object)[i]
            named["mask"] = np.asarray(table.paint.mask)[i]
            yield type(table.rows), named


def _quad(row, origin, direction, masks):
    # centre + a right + b up = origin + t direction
    columns = np.stack(
        [np.broadcast_to(v, direction.shape) for v in (-row["right"], -row["up"])]
        + [direction],
        axis=-1,
    )
    flat = np.abs(np.linalg.det(columns)) < 1e-12
    columns[flat] = np.eye(3)
    gap = np.broadcast_to(row["centre"] - origin, direction.shape)
    a, b, t = np.moveaxis(np.linalg.solve(columns, gap[..., None])[..., 0], -1, 0)
    width, height = row["half_m"]
    if row["is_round"]:
        is_in = (a / width) ** 2 + (b / height) ** 2 <= 1
    else:
        is_in = (np.abs(a) <= width) & (np.abs(b) <= height)
    if row["is_one_sided"]:
        normal = np.cross(row["right"], row["up"])
        is_in &= direction @ normal < 0
    if row["mask"] >= 0:
        holes = masks[row["mask"]]
        k = np.clip((a / width + 1) / 2 * holes.shape[1], 0, holes.shape[1] - 1)
        j = np.clip((1 - b / height) / 2 * holes.shape[0], 0, holes.shape[0] - 1)
        is_in &= holes[j.astype(int), k.astype(int)]
    return np.where(is_in & ~flat, t, np.inf)


def _roots(a, b, c):
    """Smaller root of a t^2 + 2 b t + c; inf where there is none."""
    room = b * b - a * c
    return np.where(
        (room >= 0) & (a > 0), (-b - np.sqrt(np.maximum(room, 0))) / a, np.inf
    )


def _ball(centre, radius, origin, direction):
    away = origin - centre
    squared = np.sum(direction**2, axis=-1)
    return _roots(squared, direction @ away, away @ away - radius**2)


def _capsule(row, origin, direction):
    axis, away = row["up"], origin - row["centre"]
    across = direction - (direction @ axis)[..., None] * axis
    off = away - (away @ axis) * axis
    with np.errstate(invalid="ignore", divide="ignore"):
        t = _roots(
            np.sum(across**2, axis=-1), across @ off, off @ off - row["radius_m"] ** 2
        )
        place = away @ axis + np.where(np.isfinite(t), t, 0) * (direction @ axis)
    tube = np.where(np.abs(place) <= row["half_m"], t, np.inf)
    if row["is_open"]:
        return tube
    for end in (-1, 1):
        centre = row["centre"] + end * row["half_m"] * axis
        ball = _ball(centre, row["radius_m"], origin, direction)
        point = away @ axis + np.where(np.isfinite(ball), ball, 0) * (direction @ axis)
        tube = np.minimum(tube, np.where(end * point >= row["half_m"], ball, np.inf))
    return tube


def lengths(scene, origin, direction, time_s=0.0):
    """Length at which each primitive is met, `(primitives, *rays)`; inf is never."""
    found = []
    for kind, row in rows(scene):
        number = row["object"]
        turn, pivot, velocity = (
            np.asarray(getattr(scene.paths, name))[number]
            for name in ("rotation", "pivot", "velocity")
        )
        back = Rotation.from_rotvec(turn * time_s).inv()
        own = back.apply(origin - pivot - velocity * time_s) + pivot
        ray = back.apply(direction.reshape(-1, 3)).reshape(direction.shape)
        if kind is Quads:
            length = _quad(row, own, ray, scene.masks)
        elif kind is Spheres:
            length = _ball(row["centre"], row["radius_m"], own, ray)
        else:
            assert kind is Capsules
            length = _capsule(row, own, ray)
        found.append(np.where(length > 0, length, np.inf))
    return np.stack(found)


def directions(camera, rotation, x_px, y_px):
    """World directions of pixel positions; one metre of each is one of depth."""
    focal = float(camera.focal_px)
    x, y = np.broadcast_arrays(x_px, y_px)
    rays = [(x - camera.width_px / 2) / focal, (camera.height_px / 2 - y) / focal]
    head = np.stack([*rays, -np.ones_like(x)], axis=-1)
    turned = Rotation.from_rotvec(np.array(rotation)).apply(head.reshape(-1, 3))
    return turned.reshape(head.shape)


def seen(scene, camera, rotation, x_px, y_px, position=(0, 0, 0), time_s=0.0):
    """Depth and surface number (-1 is the background) at pixel positions."""
    rays = directions(camera, np.array(rotation, float), x_px, y_px)
    found = lengths(scene, np.array(position, float), rays, time_s)
    found = np.where(found >= NEAR_M, found, np.inf)
    surface = np.where(np.isfinite(found.min(axis=0)), found.argmin(axis=0), -1)
    return found.min(axis=0), surface


def pixels(camera):
    """Positions of all pixels' centres."""
    return np.arange(camera.width_px) + 0.5, (np.arange(camera.height_px) + 0.5)[
        :, None
    ]
