"""Temporal techniques frame by frame, in plain NumPy, float64.

Each is a function of a clip (`temporal_clips.Clip`) that returns what is displayed,
`(frames, height, width, 3)`. Pictures are `(height, width)` or `(height, width, n)`,
positions continuous px with y down. A sample lies `s` from its pixel's centre, so that
what it shows lies `-s` from where it would be seen: un-jittered is read at `x - s`.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from temporal_clips import DEFORMING, STATIC, X_PX, Y_PX, projected, rays

EPSILON = 1e-6
PLUS, BLOCK = (1, 3, 4, 5, 7), range(9)

# --- reading ---


def pixel(picture, column, row):
    """Pixels at whole places; beyond the border is what is at the border."""
    height, width = picture.shape[:2]
    column = np.clip(column, 0, width - 1).astype(int)
    return picture[np.clip(row, 0, height - 1).astype(int), column]


def nearest(picture, x, y):
    return pixel(picture, np.floor(x), np.floor(y))


def weights_like(weight, picture):
    return weight[..., None] if picture.ndim == 3 else weight


def bilinear(picture, x, y):
    """Tent-weighted mean of the four pixels around; those of weight 0 are not read."""
    left, top = np.floor(x - 0.5), np.floor(y - 0.5)
    u, v = x - 0.5 - left, y - 0.5 - top
    total = 0.0
    for i, across in ((0, 1 - u), (1, u)):
        for j, down in ((0, 1 - v), (1, v)):
            weight = weights_like(across * down, picture)
            tap = pixel(picture, left + i, top + j)
            total = total + weight * np.where(weight == 0, 0, tap)
    return total


def is_inside(x, y):
    height, width = X_PX.shape
    return (x >= 0) & (x <= width) & (y >= 0) & (y <= height)


def past(history, x, y, clamps=False):
    """What the history shows, and where it is known."""
    found = bilinear(history, x, y)
    is_known = np.isfinite(found) if history.ndim == 2 else np.isfinite(found).all(-1)
    return found, is_known & (clamps | is_inside(x, y))


def unjittered(picture, s):
    return bilinear(picture, X_PX - s[0], Y_PX - s[1])


# --- neighbours ---

AROUND = [(dx, dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]


def nine(picture, read=nearest, s=(0.0, 0.0)):
    """The pixels of each 3 x 3 block, row by row, about where `s` puts its centre."""
    x, y = X_PX - s[0], Y_PX - s[1]
    return np.stack([read(picture, x + dx, y + dy) for dx, dy in AROUND])


def ends(around, which):
    chosen = around[list(which)]
    return chosen.min(axis=0), chosen.max(axis=0)


def rounded_box(around):
    (low5, high5), (low9, high9) = ends(around, PLUS), ends(around, BLOCK)
    return (low5 + low9) / 2, (high5 + high9) / 2


def nearest_of_block(distance, velocity, tie=0.0):
    """Velocity of the nearest of each 3 x 3 block, the centre being asked first."""
    around, moved = nine(distance), nine(velocity)
    best, found = around[4], moved[4]
    for each, its in zip(around, moved, strict=True):
        is_nearer = each < best - tie
        best = np.where(is_nearer, each, best)
        found = np.where(is_nearer[..., None], its, found)
    return found


def sharpened(picture, strength):
    around = nine(picture)
    beside = around[1] + around[3] + around[5] + around[7]
    return np.clip((1 + 4 * strength) * picture - strength * beside, 0, 1)


# --- colours ---


def mixed(a, b, share):
    return a * (1 - share) + b * share


def blended(current, before, share, is_known):
    """Mix in what was before where it is known; elsewhere the current colour."""
    share = np.where(is_known, share, 0)[..., None]
    return mixed(current, np.where(is_known[..., None], before, 0), share)


def saturated(value):
    return np.clip(value, 0, 1)


def luma_ycocg(rgb):
    return rgb[..., 0] / 4 + rgb[..., 1] / 2 + rgb[..., 2] / 4


def luma_709(rgb):
    return rgb @ np.array([0.2126, 0.7152, 0.0722])


def to_ycocg(rgb):
    r, g, b = np.moveaxis(rgb, -1, 0)
    return np.stack([luma_ycocg(rgb), (r - b) / 2, -r / 4 + g / 2 - b / 4], axis=-1)


def from_ycocg(ycocg):
    y, co, cg = np.moveaxis(ycocg, -1, 0)
    return np.stack([y + co - cg, y + cg, y - co - cg], axis=-1)


def clipped_to_centre(color, low, high):
    centre, extent = (low + high) / 2, (high - low) / 2 + EPSILON
    most = np.abs((color - centre) / extent).max(axis=-1, keepdims=True)
    return np.where(most <= 1, color, centre + (color - centre) / np.maximum(most, 1))


def clipped_towards(color, target, low, high):
    """Where the way from a colour to a target enters the box; the target if never."""
    way = target - color
    step = np.where(way == 0, 1, way)
    enters = np.minimum((low - color) / step, (high - color) / step)
    is_within = (low <= color) & (color <= high)
    enters = np.where(way == 0, np.where(is_within, -np.inf, np.inf), enters)
    share = saturated(enters.max(axis=-1, keepdims=True))
    return mixed(color, target, share)


def feedback(luma, luma_before, low, high):
    apart = np.abs(luma - luma_before)
    apart = apart / np.maximum(np.maximum(luma, luma_before), 0.2)
    return mixed(low, high, (1 - apart) ** 2)


# --- Halton sequences ---


def radical_inverse(base, index, permuted):
    value, unit = 0.0, 1.0 / base
    while index:
        digit = index % base
        digit = {0: 0, 1: 2, 2: 1}[digit] if permuted and base == 3 else digit
        value, unit, index = value + digit * unit, unit / base, index // base
    return value


def halton(count, first, permuted=False):
    return np.array(
        [
            [radical_inverse(base, first + n, permuted) for base in (2, 3)]
            for n in range(count)
        ]
    )


RGSS = np.array([(-2, -6), (2, 6), (6, -2), (-6, 2)]) / 16  # in TIDOAA's order
JITTER_PX = {  # places of samples; what the sequences say is the picture's shift, -s
    "two_frame": np.array([(-0.25, -0.25), (0.25, 0.25)]),
    "amortized": 0.5 - halton(16, 1),
    "inside": 0.5 - halton(16, 1),
    "karis": 0.5 - halton(8, 1),
    "uncharted4": 0.5 - halton(16, 1),
    "thesis_baseline": 1.7 * (halton(16, 0, permuted=True) - 0.5),
    "sobel_taa": 1.7 * (halton(16, 0, permuted=True) - 0.5),
    "tidoaa": RGSS,
}


# --- Yang et al. 2009 ---


def is_same_depth(clip, k, x, y):
    """Whether what lies at places of the last frame is as far as each pixel is now."""
    depth, before = clip.depth[k], nearest(clip.depth[k - 1], x, y)
    is_far = np.isinf(depth)
    apart = np.abs(np.where(is_far, 0, before) - np.where(is_far, 0, depth))
    return np.where(is_far, np.isinf(before), apart <= 0.01 * depth)


def sample_weight(age, vx, vy, least, limit_px2):
    fx, fy = vx - np.floor(vx), vy - np.floor(vy)
    blur = (fx * (1 - fx) + fy * (1 - fy)) / 2
    return np.maximum(1 / (age + 1), np.maximum(blur / (blur + limit_px2), least))


def amortized(clip, least=1 / 16, limit_px2=0.5):
    shown, age = clip.color[0], np.ones(X_PX.shape)
    displayed = [shown]
    for k in range(1, len(clip.color)):
        vx, vy = np.moveaxis(clip.velocity_px[k], -1, 0)
        x, y = X_PX - vx, Y_PX - vy
        before, is_known = past(shown, x, y)
        is_known &= is_same_depth(clip, k, x, y)
        age = np.where(is_known, bilinear(age, x, y), 0)
        weight = sample_weight(age, vx, vy, least, limit_px2)
        shown = blended(clip.color[k], before, 1 - weight, is_known)
        age = np.minimum(age + 1, 1 / least if least else np.inf)
        displayed.append(shown)
    return np.stack(displayed)


CELLS = [(0, 0), (1, 1), (1, 0), (0, 1)]  # right, lower


def amortized_subpixel(clip, least=1 / 16, limit_px2=0.5, jitters=True):
    """The same of 2 x 2 sub-pixels, one of which takes each frame's sample."""
    twice = lambda picture: picture.repeat(2, axis=0).repeat(2, axis=1)
    fine, ages = twice(clip.color[0]), twice(np.zeros(X_PX.shape))
    displayed = []
    for k, s in enumerate(clip.jitter_px):
        vx, vy = np.moveaxis(clip.velocity_px[k], -1, 0)
        taking = (int(s[0] >= 0), int(s[1] >= 0)) if jitters else CELLS[k % 4]
        new, new_ages = np.empty_like(fine), np.empty_like(ages)
        for right, lower in CELLS:
            # Places in sub-pixels, whose centres lie at (0.5, 0.5) and so on.
            x, y = X_PX - vx + (right - 0.5) / 2, Y_PX - vy + (lower - 0.5) / 2
            before, age = bilinear(fine, 2 * x, 2 * y), bilinear(ages, 2 * x, 2 * y)
            is_known = np.full(X_PX.shape, False)
            if k > 0:
                is_known = is_inside(X_PX - vx, Y_PX - vy)
                is_known &= is_same_depth(clip, k, X_PX - vx, Y_PX - vy)
            age = np.where(is_known, age, 0)
            before = np.where(is_known[..., None], before, clip.color[k])
            if (right, lower) == taking:
                weight = sample_weight(age, 2 * vx, 2 * vy, least, limit_px2)
                before = mixed(before, clip.color[k], weight[..., None])
                age = np.minimum(age + 1, 1 / least)
            new[lower::2, right::2], new_ages[lower::2, right::2] = before, age
        fine, ages = new, new_ages
        four = [fine[lower::2, right::2] for right, lower in CELLS]
        displayed.append(np.mean(four, axis=0))
    return np.stack(displayed)


# --- CryENGINE, two frames ---


def two_frame(clip):
    height, width = X_PX.shape
    speeds = np.hypot(
        clip.velocity_px[..., 0] / width, clip.velocity_px[..., 1] / height
    )
    displayed = [clip.color[0]]
    for k in range(1, len(clip.color)):
        vx, vy = np.moveaxis(clip.velocity_px[k], -1, 0)
        before, is_known = past(clip.color[k - 1], X_PX - vx, Y_PX - vy)
        change = np.abs(speeds[k] - bilinear(speeds[k - 1], X_PX - vx, Y_PX - vy))
        share = 0.5 * saturated(1 - 30 * np.sqrt(change))
        displayed.append(blended(clip.color[k], before, share, is_known))
    return np.stack(displayed)


# --- INSIDE, and the filter that the thesis made of it ---


def motion_blurred(result, picture, s, velocity):
    """Mix in the mean of 7 reads along half of the velocity to each side."""
    vx, vy = np.moveaxis(velocity, -1, 0)
    x, y = X_PX - s[0], Y_PX - s[1]
    reads = [bilinear(picture, x + i * vx / 6, y + i * vy / 6) for i in range(-3, 4)]
    trust = 1 - saturated((np.hypot(vx, vy) - 2) / 13)
    return mixed(np.mean(reads, axis=0), result, trust[..., None])


def inside(clip, ycocg=False, motion_blur=False, clamps=True):
    convert, back = (to_ycocg, from_ycocg) if ycocg else (lambda c: c,) * 2
    luma = (lambda c: c[..., 0]) if ycocg else luma_709
    history, displayed = convert(unjittered(clip.color[0], clip.jitter_px[0])), []
    for k in range(len(clip.color)):
        s, velocity = clip.jitter_px[k], clip.velocity_px[k]
        velocity = nearest_of_block(clip.depth[k], velocity)
        if k > 0:
            picture = convert(clip.color[k])
            current = unjittered(picture, s)
            x, y = X_PX - velocity[..., 0], Y_PX - velocity[..., 1]
            before, is_known = past(history, x, y, clamps)
            low, high = rounded_box(nine(picture))
            if ycocg:
                extent = 0.125 * (high - low)[..., :1]
                low[..., 1:] = current[..., 1:] - extent
                high[..., 1:] = current[..., 1:] + extent
            before = clipped_to_centre(before, low, high)
            share = feedback(luma(current), luma(before), 0.88, 0.97)
            history = blended(current, before, share, is_known)
        shown = back(history)
        if motion_blur:
            shown = motion_blurred(shown, clip.color[k], s, velocity)
        displayed.append(shown)
    return np.stack(displayed)


def thesis_depth(depth, far=1e4):
    """Window depth as the thesis makes it linear; 2 where there is nothing."""
    return 2 / (1 + far / depth)


def thesis_baseline(clip, clamps=True):
    history, displayed = unjittered(clip.color[0], clip.jitter_px[0]), []
    for k in range(len(clip.color)):
        if k > 0:
            s, picture = clip.jitter_px[k], clip.color[k]
            distance = thesis_depth(clip.depth[k])
            velocity = nearest_of_block(distance, clip.velocity_px[k], 1e-5)
            current = unjittered(picture, s)
            x, y = X_PX - velocity[..., 0], Y_PX - velocity[..., 1]
            before, is_known = past(history, x, y, clamps)
            before = clipped_to_centre(before, *rounded_box(nine(picture, bilinear, s)))
            share = feedback(luma_ycocg(current), luma_ycocg(before), 0.925, 0.979)
            history = blended(current, before, share, is_known)
        displayed.append(sharpened(history, 1.0))
    return np.stack(displayed)


# --- Uncharted 4 ---


def uncharted4(clip):
    history, displayed = unjittered(clip.color[0], clip.jitter_px[0]), []
    stencils = [nine(each).max(axis=0) for each in clip.object_id]
    for k in range(len(clip.color)):
        if k > 0:
            s, picture = clip.jitter_px[k], clip.color[k]
            velocity = nearest_of_block(clip.depth[k], clip.velocity_px[k])
            current = unjittered(picture, s)
            x, y = X_PX - velocity[..., 0], Y_PX - velocity[..., 1]
            before, is_known = past(history, x, y)
            before = np.clip(before, *ends(nine(picture, bilinear, s), BLOCK))
            is_known &= stencils[k] == nearest(stencils[k - 1], x, y)
            history = blended(current, before, 0.95, is_known)
        displayed.append(sharpened(history, 1.0))
    return np.stack(displayed)


# --- Karis 2014 ---


def karis_filtered(picture, s):
    """Gaussian mean of the samples of each 3 x 3 block about the pixel's centre."""
    weights = np.array(
        [np.exp(-2.29 * ((dx + s[0]) ** 2 + (dy + s[1]) ** 2)) for dx, dy in AROUND]
    )
    return np.tensordot(weights / weights.sum(), nine(picture), axes=1)


def karis(clip):
    history = karis_filtered(to_ycocg(clip.color[0]), clip.jitter_px[0])
    displayed = [from_ycocg(history)]
    for k in range(1, len(clip.color)):
        picture = to_ycocg(clip.color[k])
        velocity = nearest_of_block(clip.depth[k], clip.velocity_px[k])
        target = karis_filtered(picture, clip.jitter_px[k])
        x, y = X_PX - velocity[..., 0], Y_PX - velocity[..., 1]
        before, is_known = past(history, x, y)
        before = np.where(is_known[..., None], before, target)
        before = clipped_towards(before, target, *rounded_box(nine(picture)))
        old = 0.9 / (1 + before[..., :1])
        new = 0.1 / (1 + target[..., :1])
        history = (old * before + new * target) / (old + new)
        displayed.append(from_ycocg(history))
    return np.stack(displayed)


# --- the thesis' own: Sobel and model index ---


class SobelStages(NamedTuple):
    """Pictures on the way, each `(frames, height, width)`, and what is displayed."""

    displayed: np.ndarray
    sobel: np.ndarray
    temporal_sobel: np.ndarray
    model_average: np.ndarray
    depth_variation: np.ndarray
    past_depth_variation: np.ndarray
    aliased: np.ndarray


def gradient(picture):
    p = nine(picture)
    gx = (p[2] + 2 * p[5] + p[8]) - (p[0] + 2 * p[3] + p[6])
    gy = (p[6] + 2 * p[7] + p[8]) - (p[0] + 2 * p[1] + p[2])
    return np.sqrt(gx**2 + gy**2)


def sobel_of(albedo, color, depth):
    unlit, lit = gradient(luma_ycocg(albedo)), gradient(luma_ycocg(color))
    g = saturated(0.3 * unlit + 0.7 * lit + gradient(depth))
    return np.sqrt(g**2 * (3 - 2 * g))


def depth_terms(around, history, depth_range):
    """How far a pixel's depth, and its last one, lie from the mean of its block."""
    mean, low, high = around.mean(axis=0), around.min(axis=0), around.max(axis=0)
    spread = mean - low
    if depth_range == "paper":
        spread = np.minimum(spread, high - mean)
    counts = spread >= 0.002
    spread = np.where(counts, spread, 1)
    now = np.where(counts, np.abs(around[4] - mean) / spread, 0) ** 2
    return now, np.where(counts, np.abs(history - mean) / spread, 0) ** 4


def sobel_taa(clip, depth_range="paper", depth_history="same_pixel", clamps=True):
    kept, stages = None, []
    for k in range(len(clip.color)):
        s, depth = clip.jitter_px[k], thesis_depth(clip.depth[k])
        x, y = X_PX - s[0], Y_PX - s[1]
        sobel = sobel_of(clip.albedo[k], clip.color[k], depth)
        depths = nine(depth, nearest, s)
        ids = nine(clip.object_id[k], nearest, s)
        colors, sobels = nine(clip.color[k], bilinear, s), nine(sobel, bilinear, s)
        if kept is None:
            kept = colors[4], sobels[4], depths[4]
        before, edge, depth_before = kept
        velocity = bilinear(clip.velocity_px[k], x, y) * (k > 0)
        at = X_PX - velocity[..., 0], Y_PX - velocity[..., 1]

        edge, is_known = past(edge, *at, clamps)
        share = feedback(sobels[4], edge, 0.925, 0.979) * is_known
        edge = np.where(is_known, edge, 0)
        edge = mixed(sobels[4], np.clip(edge, *rounded_box(sobels)), share)
        edge = sobels[4] if k == 0 else edge

        model = (ids != ids[4]).sum(axis=0) / 9
        edges = nine(edge)
        share = saturated(model + edge)
        average = mixed(edges[list(PLUS)].mean(axis=0), edges.mean(axis=0), share)
        if depth_history == "reprojected":
            depth_before = nearest(depth_before, *at)
        now, then = depth_terms(depths, depth_before, depth_range)
        aliased = saturated(average + now + then + model)

        a = aliased[..., None]
        (low5, high5), (low9, high9) = ends(colors, PLUS), ends(colors, BLOCK)
        low = mixed(colors[4], mixed(low5, low9, a), a)
        high = mixed(colors[4], mixed(high5, high9, a), a)
        before, is_known = past(before, *at, clamps)
        before = clipped_to_centre(before, low, high)
        share = feedback(luma_ycocg(colors[4]), luma_ycocg(before), 0.925, 0.979)
        result = blended(colors[4], before, share, is_known)
        result = colors[4] if k == 0 else result
        kept = result, edge, depths[4]
        shown = sharpened(result, 0.25)
        stages.append((shown, sobel, edge, model, now, then, aliased))
    return SobelStages(*map(np.stack, zip(*stages, strict=True)))


# --- TIDOAA ---


class Cell(NamedTuple):
    """One cell of TIDOAA's store: where it lies exactly, px, and what it holds."""

    place: tuple
    color: np.ndarray
    validity: float
    depth: float
    thing: int
    kind: int


def onto_the_next(pose_before, pose, thing_before, thing):
    """Turn and shift of points from the last head's axes to the head's axes now."""
    (q0, q1, o0, o1), (p0, p1, t0, t1) = zip(
        *[
            (Rotation.from_quat(each[:4], scalar_first=True), each[4:])
            for each in (pose_before, pose, thing_before, thing)
        ],
        strict=True,
    )
    turn = q1.inv() * o1 * o0.inv() * q0
    shift = (q1.inv() * o1 * o0.inv()).apply(p0 - t0) + q1.inv().apply(t1 - p1)
    return turn.as_matrix(), shift


def reprojected(store, onto, subcell):
    """Cells where they are seen now: `onto[thing]` is a turn and a shift."""
    rows, columns = 2 * X_PX.shape[0], 2 * X_PX.shape[1]
    moved = {}
    for (row, column), cell in sorted(store.items()):
        block = [
            store.get((row // 2 * 2 + j, column // 2 * 2 + i))
            for j in (0, 1)
            for i in (0, 1)
        ]
        block = [each for each in block if each is not None and each.validity > 0.1]
        if cell.validity <= 0.1 or cell.kind == DEFORMING:
            continue
        is_mixed = len({each.thing for each in block}) > 1
        if is_mixed and cell.validity < max(each.validity for each in block):
            continue
        place = cell.place if subcell else ((column + 0.5) / 2, (row + 0.5) / 2)
        turn, shift = onto[cell.thing]
        point = turn @ rays(*map(np.asarray, place))
        depth = cell.depth
        if np.isfinite(depth):
            point = depth * point + shift
            depth = -point[2]
        if point[2] >= 0:
            continue
        x, y = projected(point)
        to = int(np.floor(2 * y)), int(np.floor(2 * x))
        if not (0 <= to[0] < rows and 0 <= to[1] < columns):
            continue
        new = cell._replace(place=(x, y), validity=cell.validity / 2, depth=depth)
        there = moved.get(to)
        if there is None or (new.validity, -new.depth) > (there.validity, -there.depth):
            moved[to] = new
    return moved


def tidoaa(clip, subcell=False, jitters=True):
    store, displayed = {}, []
    height, width = X_PX.shape
    for k in range(len(clip.color)):
        if k > 0:
            poses, things = clip.poses, clip.object_poses
            onto = [
                onto_the_next(poses[k - 1], poses[k], things[k - 1, i], things[k, i])
                for i in range(things.shape[1])
            ]
            store = reprojected(store, onto, subcell)
        s, shown = clip.jitter_px[k], np.zeros((height, width, 3))
        right, lower = (s[0] > 0, s[1] > 0) if jitters else CELLS[k % 4]
        for j in range(height):
            for i in range(width):
                kind = clip.motion_class[k, j, i]
                thing = 0 if kind == STATIC else clip.object_id[k, j, i]
                store[2 * j + lower, 2 * i + right] = Cell(
                    (i + 0.5 + s[0], j + 0.5 + s[1]),
                    clip.color[k, j, i],
                    1.0,
                    clip.depth[k, j, i],
                    thing,
                    kind,
                )
                four = [
                    store.get((2 * j + b, 2 * i + a)) for b in (0, 1) for a in (0, 1)
                ]
                shown[j, i] = np.mean(
                    [c.color for c in four if c is not None and c.validity >= 0.1],
                    axis=0,
                )
        displayed.append(shown)
    return np.stack(displayed)
