"""Small pictures that spatial anti-aliasing is held against: 33 of 40 x 40 px.

Gamma colours in `[0, 1]`, float64, `(3, 40, 40)`. Edges, glyphs and combs have one
sample per pixel, at its centre.
"""

import functools

import numpy as np

SIZE_PX = 40
WHITE, BLACK = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
_Y, _X = np.mgrid[:SIZE_PX, :SIZE_PX] + 0.5

GLYPHS = {
    "A": ["..##..", ".#..#.", "#....#", "######", "#....#", "#....#"],
    "R": ["#####.", "#....#", "#####.", "#..#..", "#...#.", "#....#"],
    "S": [".#####", "#.....", ".####.", ".....#", ".....#", "#####."],
    "X": ["#....#", ".#..#.", "..##..", "..##..", ".#..#.", "#....#"],
    "8": [".####.", "#....#", ".####.", "#....#", "#....#", ".####."],
}


def of_two(mask, one=WHITE, other=BLACK):
    """Show one colour where a mask is True, the other elsewhere."""
    one, other = (np.reshape(color, (3, 1, 1)) for color in (one, other))
    return np.where(mask, one, other)


def half_plane(angle_deg, offset_px=0.0):
    """Whether pixel centres lie beyond a line through the middle."""
    angle = np.radians(angle_deg)
    away = np.sin(angle) * (_X - 20) - np.cos(angle) * (_Y - 20)
    return away > offset_px


def glyphs(scale):
    mask = np.zeros((SIZE_PX, SIZE_PX), bool)
    places = [
        (1 + 8 * scale * i, 1 + 8 * scale * j) for j in range(5) for i in range(5)
    ]
    rows = list(GLYPHS.values())
    for k, (left, top) in enumerate(places):
        glyph = np.array([list(row) for row in rows[k % len(rows)]]) == "#"
        large = np.kron(glyph, np.ones((scale, scale))).astype(bool)
        part = mask[top : top + 6 * scale, left : left + 6 * scale]
        part |= large[: part.shape[0], : part.shape[1]]
    return mask


def photograph(name, top, left, step=1):
    import skimage.data

    color = getattr(skimage.data, name)()
    rows = slice(top, top + SIZE_PX * step, step)
    crop = color[rows, left : left + SIZE_PX * step : step].astype(float) / 255
    if crop.ndim == 2:
        crop = np.repeat(crop[..., None], 3, axis=-1)
    return np.moveaxis(crop, -1, 0)


@functools.cache
def images():
    """Return the pictures by name; without scikit-image, without photographs."""
    rng = np.random.default_rng(15)
    some = [tuple(rng.random(3)) for _ in range(24)]
    found = {}
    angles = (0, 2.5, 5, 12, 26.565, 38, 45, 52, 71, 87, 90, 103, 135, 151, 177)
    for k, angle in enumerate(angles):
        colors = (WHITE, BLACK) if k % 2 == 0 else (some[k], some[k - 1])
        found[f"edge {angle}"] = of_two(half_plane(angle, 0.3), *colors)
    radius = np.hypot(_X - 18.3, _Y - 21.6)
    found["disc"] = of_two(radius < 13.7, some[20], some[21])
    found["rings"] = of_two(np.sin(radius**2 / 9) > 0)
    found["glyphs"] = of_two(glyphs(1))
    found["large glyphs"] = of_two(glyphs(2), some[22], WHITE)
    found["upright comb"] = of_two(_X.astype(int) % 3 == 0)
    found["level comb"] = of_two(_Y.astype(int) % 4 < 2, some[18], some[19])
    found["growing comb"] = of_two(np.sin(_X**1.5 / 2 + _Y / 9) > 0)
    checks = (_X.astype(int) // 2 + _Y.astype(int) // 2) % 2 == 0
    found["checkerboard"] = of_two(checks, (0.9, 0.2, 0.1), (0.1, 0.6, 0.9))
    wires = np.abs(np.sin(0.3) * _X - np.cos(0.3) * _Y + 8) % 7 < 0.8
    found["wires"] = of_two(wires, (0.2, 0.2, 0.2), (0.8, 0.9, 1.0))
    found["noise"] = rng.random((3, SIZE_PX, SIZE_PX))
    coarse = rng.random((3, 10, 10))
    found["coarse noise"] = np.kron(coarse, np.ones((1, 4, 4)))
    ramp = np.clip((_X + 2 * _Y) / 120, 0, 1)
    found["ramp under an edge"] = np.where(half_plane(17), ramp, 0.8 * (1 - ramp))
    found["ramp under an edge"] = np.stack([found["ramp under an edge"]] * 3)
    try:
        found["astronaut"] = photograph("astronaut", 90, 200)
        found["chelsea"] = photograph("chelsea", 90, 100)
        found["coffee"] = photograph("coffee", 20, 250, 2)
        found["camera"] = photograph("camera", 60, 200, 3)
        found["page"] = photograph("page", 20, 60)
        found["rocket"] = photograph("rocket", 100, 300)
    except ImportError:
        pass
    return found


def stack():
    """All pictures, `(pictures, 3, 40, 40)`."""
    return np.stack(list(images().values()))
