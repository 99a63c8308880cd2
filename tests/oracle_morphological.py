"""MLAA and SMAA pixel by pixel, in plain Python: edges, walks, exact polygons, blend.

Pictures are `(3, height, width)` gamma colours, float64. What lies outside of a picture
has the colour at its edge, and no flags.
"""

import functools
import itertools

import numpy as np

TIE = 1e-5
PRESETS = {  # threshold, longest walk, diagonal steps, corner rounding
    "low": (0.15, 8, 0, 0.0),
    "medium": (0.1, 16, 0, 0.0),
    "high": (0.1, 32, 8, 0.25),
    "ultra": (0.05, 64, 16, 0.25),
}


# --- edges ---


def edge_flags(gamma, threshold, by, farther, tie):
    """Left and top flags as sets of (y, x); `farther`: left-left and top-top count."""
    seen = gamma
    if by == "luma":
        seen = np.array([0.2126 * gamma[0] + 0.7152 * gamma[1] + 0.0722 * gamma[2]])
    height, width = seen.shape[1:]

    def delta(y0, x0, y1, x1):
        clamp = lambda v, size: min(max(v, 0), size - 1)
        a = seen[:, clamp(y0, height), clamp(x0, width)]
        b = seen[:, clamp(y1, height), clamp(x1, width)]
        return np.abs(a - b).max()

    to_left = functools.cache(lambda y, x: delta(y, x, y, x - 1))
    to_top = functools.cache(lambda y, x: delta(y, x, y - 1, x))
    left, top = set(), set()
    for y in range(height):
        for x in range(width):
            around = [to_left(y, x), to_top(y, x), to_left(y, x + 1), to_top(y + 1, x)]
            if farther:
                around += [to_left(y, x - 1), to_top(y - 1, x)]
            for found, here in ((left, to_left(y, x)), (top, to_top(y, x))):
                if here >= threshold - tie and 2 * here >= max(around) - tie:
                    found.add((y, x))
    return left, top


# --- areas ---


@functools.cache
def line_area(before, after, at_left, at_right, softens):
    """(down, up) of a pixel between ends that each have (up, down) crossing edges."""
    d = before + after + 1
    if all(at_left) and all(at_right):
        return 0.0, 0.0
    h1, h2 = ((up - down) / 2 for up, down in (at_left, at_right))
    # An end that turns off to both sides is the opposite of the other.
    h1, h2 = (-h2 if all(at_left) else h1), (-h1 if all(at_right) else h2)
    if h1 * h2 < 0:  # Z
        return _under([(0, h1), (d, h2)], before)
    halves = []
    if h1 and (h2 or before <= after):
        halves.append(_under([(0, h1), (d / 2, 0)], before))
    if h2 and (h1 or before >= after):
        halves.append(_under([(d / 2, 0), (d, h2)], before))
    if h1 and h2 and softens:  # U
        soft = lambda a: lerp(np.sqrt(2 * a) / 2, a, min(d / 32, 1))
        halves = [(soft(down), soft(up)) for down, up in halves]
    return sum(h[0] for h in halves), sum(h[1] for h in halves)


def lerp(a, b, t):
    return a * (1 - t) + b * t


def _under(line, start):
    """Areas below and above y = 0 between x = start and start + 1."""
    (x0, y0), (x1, y1) = line
    slope = (y1 - y0) / (x1 - x0)
    y = lambda x: y0 + slope * (x - x0)
    low, high = max(start, x0), min(start + 1, x1)
    if low >= high:
        return 0.0, 0.0
    cuts = [low, high]
    if slope and low < x0 - y0 / slope < high:
        cuts.insert(1, x0 - y0 / slope)
    down = up = 0.0
    for a, b in itertools.pairwise(cuts):
        area = (y(a) + y(b)) / 2 * (b - a)
        down, up = down + max(-area, 0), up + max(area, 0)
    return down, up


LINES = {  # of the ends' crossing edges, where a diagonal starts and ends
    0: ("11 11", "10 10"),
    1: ("10 00", "10 10"),
    2: ("00 10", "10 10"),
    3: ("10 10",),
    4: ("11 00", "11 10"),
    5: ("11 00", "10 10"),
    6: ("11 10",),
    7: ("11 10", "10 10"),
    8: ("00 11", "10 11"),
    9: ("10 11",),
    10: ("00 11", "10 10"),
    11: ("10 11", "10 10"),
    12: ("11 11",),
    13: ("11 11", "10 11"),
    14: ("11 11", "11 10"),
    15: ("11 11", "10 10"),
}


def diagonal_lines(before, after, pattern):
    """Pairs of points that the lines of a diagonal go through, and the signs' sides."""
    d = before + after + 1
    for pair in LINES[pattern]:
        p, q = (tuple(map(int, point)) for point in pair.split())
        yield p, (q[0] + d, q[1] + d)


def is_beyond(line, x, y):
    """Whether a place lies on a line's positive side (> 0)."""
    (px, py), (qx, qy) = line
    return (qy - py) * (x - (px + qx) / 2) + (px - qx) * (y - (py + qy) / 2)


@functools.cache
def diagonal_area(before, after, pattern):
    """Weights of a pixel on a diagonal, by clipping its unit squares to the lines."""
    parts = []
    for line in diagonal_lines(before, after, pattern):
        parts.append([_clipped(line, 1 + before, y) for y in (before, 1 + before)])
    a1, a2 = np.mean(parts, axis=0)
    return 1 - a1, a2


def _clipped(line, x, y):
    """Area of the unit square from (x, y) on that is beyond a line."""
    corners = [(x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1)]
    kept = []
    for one, other in zip(corners, corners[1:] + corners[:1], strict=True):
        f, g = is_beyond(line, *one), is_beyond(line, *other)
        if f >= 0:
            kept.append(one)
        if f * g < 0:
            t = f / (f - g)
            kept.append((lerp(one[0], other[0], t), lerp(one[1], other[1], t)))
    turned = kept[1:] + kept[:1]
    pairs = zip(kept, turned, strict=True)
    return abs(sum(a[0] * b[1] - b[0] * a[1] for a, b in pairs)) / 2


# --- walks ---


def line_shares(edge, crossing, y, x, longest, softens, rounding):
    """(down, up) of one pixel with an edge at its top."""

    def joined(x):  # a line goes on from x - 1 to x
        is_on = (y, x) in edge and (y, x - 1) in edge
        return is_on and (y, x) not in crossing and (y - 1, x) not in crossing

    before = after = 0
    while before < longest and joined(x - before):
        before += 1
    while after < longest and joined(x + after + 1):
        after += 1
    ends = (x - before, x + after + 1)
    codes = [((y - 1, end) in crossing, (y, end) in crossing) for end in ends]
    down, up = line_area(before, after, *codes, softens)
    if rounding:
        near = (before <= after, after <= before)
        part = [(1 - rounding) * n / sum(near) for n in near]
        left_over = lambda row: min(
            1,
            max(
                0,
                1
                - sum(
                    p * ((row, end) in crossing)
                    for p, end in zip(part, ends, strict=True)
                ),
            ),
        )
        down, up = down * left_over(y + 1), up * left_over(y - 2)
    return down, up


def _search(is_full, y, x, dy, dx, most):
    """Visit pixels; how many are full, and whether one was met that is not."""
    for n in range(most):
        if not is_full(y + (n + 1) * dy, x + (n + 1) * dx):
            return n, True
    return most, False


def diagonal_shares(left, top, y, x, most):
    """(down, up) of one pixel with an edge at its top, both diagonals summed."""
    down = up = 0.0
    # From lower left to upper right.
    is_full = lambda y, x: (y, x) in left and (y, x) in top
    before, is_start = 0, True
    if (y, x) in left:
        before, is_start = _search(is_full, y, x, 1, -1, most)
        before += is_start and (y + before + 1, x - before - 1) in top
    after, is_end = _search(is_full, y, x, -1, 1, most)
    if before + after > 2:
        v1, h1 = (y + before, x - before) in left, (y + before, x - before - 1) in top
        h2, v2 = (
            (y - after, x + after + 1) in top,
            (y - after - 1, x + after + 1) in left,
        )
        n = is_start * (v1 + 4 * h1) + is_end * (2 * h2 + 8 * v2)
        own, other = diagonal_area(before, after, n)
        down, up = down + own, up + other
    # From upper left to lower right.
    is_full = lambda y, x: (y, x + 1) in left and (y, x) in top
    before, is_start = _search(is_full, y, x, -1, -1, most)
    after, is_end = 0, True
    if (y, x + 1) in left:
        after, is_end = _search(is_full, y, x, 1, 1, most)
        after += is_end and (y + after + 1, x + after + 1) in top
    if before + after > 2:
        v1, h1 = (
            (y - before - 1, x - before) in left,
            (y - before, x - before - 1) in top,
        )
        h2, v2 = (y + after, x + after + 1) in top, (y + after, x + after + 1) in left
        n = is_start * (v1 + 4 * h1) + is_end * (2 * h2 + 8 * v2)
        own, other = diagonal_area(before, after, n)
        down, up = down + other, up + own
    return down, up


def shares(gamma, *options):
    """What is taken from above, below, the left and the right, `(4, height, width)`."""
    return _shares(gamma.tobytes(), gamma.shape, *options)


@functools.cache  # spaces share them
def _shares(data, shape, threshold, longest, diagonal, rounding, softens, by, tie):
    gamma = np.frombuffer(data).reshape(shape)
    left, top = edge_flags(gamma, threshold, by, softens, tie)
    found = np.zeros((4, *gamma.shape[1:]))
    flipped = lambda flags: {(x, y) for y, x in flags}
    left_t, top_t = flipped(left), flipped(top)
    taken = set()
    for y, x in top:
        down, up = (0.0, 0.0)
        if diagonal:
            down, up = diagonal_shares(left, top, y, x, diagonal)
        if down + up > 0:
            taken.add((y, x))
        else:
            down, up = line_shares(top, left, y, x, longest, softens, rounding)
        found[0, y, x] = down
        found[1, y - 1, x] = up
    for y, x in left - taken:
        own, other = line_shares(left_t, top_t, x, y, longest, softens, rounding)
        found[2, y, x] = own
        found[3, y, x - 1] = other
    return found


# --- blends ---

NEIGHBORS = ((-1, 0), (1, 0), (0, -1), (0, 1))


def decoded(gamma):
    return np.where(gamma <= 0.04045, gamma / 12.92, ((gamma + 0.055) / 1.055) ** 2.4)


def encoded(linear):
    high = 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, high)


def _blended(gamma, found, space, blend):
    colors = decoded(gamma) if space == "linear" else gamma
    height, width = gamma.shape[1:]
    shown = gamma.copy()
    for y in range(height):
        for x in range(width):
            near = [
                colors[
                    :, min(max(y + dy, 0), height - 1), min(max(x + dx, 0), width - 1)
                ]
                for dy, dx in NEIGHBORS
            ]
            new = blend(colors[:, y, x], near, found[:, y, x])
            if new is not None:
                shown[:, y, x] = encoded(new) if space == "linear" else new
    return shown


def smaa(gamma, preset="high", edges="luma", space="gamma", tie=TIE):
    found = shares(gamma, *PRESETS[preset], True, edges, tie)

    def blend(color, near, share):
        t, b, w, e = share
        if sum(share) < tie:
            return None
        pair = (2, 3) if max(e, w) > max(b, t) + tie else (0, 1)
        p, q = (share[i] for i in pair)
        ours = [lerp(color, near[i], share[i]) for i in pair]
        return (p * ours[0] + q * ours[1]) / (p + q)

    return _blended(gamma, found, space, blend)


def mlaa(gamma, space="gamma", tie=TIE):
    found = shares(gamma, 0.1, 32, 0, 0.0, False, "luma", tie)

    def blend(color, near, share):
        cubes = share**3
        if cubes.sum() < tie:
            return None
        mixed = [
            c * lerp(color, n, a) for c, n, a in zip(cubes, near, share, strict=True)
        ]
        return sum(mixed) / cubes.sum()

    return _blended(gamma, found, space, blend)
