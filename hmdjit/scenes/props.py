"""What named scenes of solids are put together from, on a floor 1.6 m below the eye."""

import numpy as np

from . import shapes, surfaces
from .shapes import Place, Shape
from .surfaces import Surface

FLOOR_M = -1.6
RIGHT, AHEAD = (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)

WHITE = surfaces.uniform((0.92, 0.91, 0.88))
DARK = surfaces.uniform((0.16, 0.15, 0.16))
IRON = surfaces.uniform((0.25, 0.26, 0.29))
RED, BLUE = surfaces.uniform((0.78, 0.22, 0.18)), surfaces.uniform((0.22, 0.4, 0.72))
YELLOW, GREEN = surfaces.uniform((0.95, 0.76, 0.2)), surfaces.uniform((0.2, 0.42, 0.2))
STONE = surfaces.uniform((0.8, 0.74, 0.63))
PLASTER = surfaces.uniform((0.62, 0.57, 0.5))
PLANKS = surfaces.stripes((0.6, 0.43, 0.26), (0.3, 0.2, 0.12), 0.16, 0.02)
BRICKS = surfaces.stripes((0.66, 0.36, 0.28), (0.75, 0.7, 0.64), 0.13, 0.02)


def meadow(floor_m: float = FLOOR_M) -> Shape:
    """Ground with soft blotches, hills at the horizon, three trees."""
    x, y = np.meshgrid(*2 * [np.arange(64) * 2 * np.pi / 64])
    soft = np.cos(3 * x + 2 * y) + np.cos(5 * y - 2 * x) + np.cos(7 * x - 4 * y + 1)
    soft += np.cos(9 * x + 8 * y) + np.cos(8 * x - 11 * y + 2)
    grass = np.array([0.42, 0.58, 0.26]) + 0.022 * soft[..., None]
    ground = surfaces.picture(grass.astype(np.float32), 12.0)
    far, bark = (
        surfaces.uniform((0.42, 0.52, 0.46)),
        surfaces.uniform((0.38, 0.28, 0.2)),
    )
    found = shapes.plane((0, floor_m, 0), RIGHT, AHEAD, ground)
    for x, width, height in ((-55, 150, 26), (45, 190, 34), (130, 120, 22)):
        found += shapes.disc((x, floor_m, -100), (width, 0, 0), (0, height, 0), far)
    for x, z, size in ((-7.5, -13, 1.0), (6, -17, 1.15), (12.5, -14, 0.8)):
        top = floor_m + 3.2 * size
        found += shapes.capsule((x, floor_m, z), (x, top, z), 0.16 * size, bark)
        for dx, dy, radius in ((0, 0.5, 1.2), (-0.8, -0.1, 0.9), (0.8, 0, 0.95)):
            place = (x + dx * size, top + dy * size, z + 0.1 * dx)
            found += shapes.sphere(place, radius * size, GREEN)
    return found


def house() -> Shape:
    """Wooden hut with a door, windows and a chimney, on the origin, 3.6 m wide."""
    tiles = surfaces.stripes((0.62, 0.25, 0.2), (0.4, 0.15, 0.13), 0.2, 0.03)
    side, eighth = 3.6 / 2**0.5, np.pi / 4
    found = shapes.box((0, 1, 0), (3.6, 2, 3.2), PLANKS)
    # The lower half of a box on its edge lies in the walls, the upper one is the gable.
    found += shapes.box((0, 2, 0), (side, side, 3.18), PLANKS, (0, 0, eighth))
    slab = shapes.box((0, 0, 0), (0.12, 2.97, 3.9), tiles)  # stripes along the ridge
    for way in (-1, 1):
        middle = (1.1 * way, 2.8, 0)
        found += shapes.moved(slab, middle, (0, 0, way * eighth))
    found += shapes.box((0.95, 3.5, -0.7), (0.45, 1.5, 0.45), BRICKS)
    found += shapes.box((-0.75, 0.9, 1.6), (0.95, 1.8, 0.1), GREEN)
    found += shapes.sphere((-0.42, 0.9, 1.68), 0.05, YELLOW)
    pane = shapes.box((0, 0, 0), (1, 0.9, 0.08), WHITE)
    for x in (-0.23, 0.23):
        for y in (-0.2, 0.2):
            pane += shapes.rectangle((x, y, 0.05), (0.38, 0, 0), (0, 0.34, 0), BLUE)
    found += shapes.moved(pane, (0.8, 1.2, 1.6))
    return found + shapes.moved(pane, (1.8, 1.2, 0), (0, np.pi / 2, 0))


def room(half_m: float, sill_m: float, top_m: float, wall_z_m: float) -> Shape:
    """Room whose wall ahead has an opening, with its sill; outside is a meadow."""
    half_room, ceiling = 6.0, 2.4
    middle = wall_z_m / 2
    found = meadow(FLOOR_M - 0.6)
    for y, surface in ((FLOOR_M, PLANKS), (ceiling, WHITE)):
        sides = (2 * half_room, 0, 0), (0, 0, wall_z_m)
        found += shapes.rectangle((0, y, middle), *sides, surface)
    rest = half_room - half_m
    for way in (-1, 1):
        beside = (way * (half_m + rest / 2), 0.4, wall_z_m)
        found += shapes.rectangle(beside, (rest, 0, 0), (0, 4, 0), PLASTER)
    for low, high in ((FLOOR_M, sill_m), (top_m, ceiling)):
        place, up = (0, (low + high) / 2, wall_z_m), (0, high - low, 0)
        found += shapes.rectangle(place, (2 * half_m, 0, 0), up, PLASTER)
    sill = (2 * half_m + 0.3, 0.06, 0.3)
    return found + shapes.box((0, sill_m, wall_z_m + 0.08), sill, WHITE)


def _column(low: float, high: float, thick: float) -> Shape:
    found = shapes.capsule((0, low + 0.2, 0), (0, high - 0.2, 0), thick, STONE)
    found += shapes.box((0, low + 0.1, 0), (0.56, 0.2, 0.56), STONE)
    found += shapes.box((0, high - 0.07, 0), (0.6, 0.14, 0.6), STONE)
    lip = (0, high - 0.24, 0), (0, high - 0.14, 0)
    return found + shapes.cylinder(*lip, 0.25, STONE)


def court(columns: int) -> Shape:
    """Two storeys of columns and arcades on both sides, banners, a floor of stone."""
    bay, x, spring, upper, roof = 2.4, 2.6, 0.9, 2.4, 4.7
    ends = -1.2 - bay * np.arange(columns)
    back = ends[-1] - bay / 2
    marble = surfaces.checkerboard((0.82, 0.78, 0.7), (0.42, 0.3, 0.27), 0.6)
    wall = surfaces.uniform((0.86, 0.74, 0.57))
    across, up = np.meshgrid(np.linspace(-1.2, 1.2, 288), np.linspace(1.3, 0, 156))
    arch = wall.cut_out(np.hypot(across, up) > 1)
    middle = back / 2
    found = shapes.rectangle((0, FLOOR_M, middle), (10, 0, 0), (0, 0, back), marble)
    found += shapes.rectangle((0, 1.8, back), (10, 0, 0), (0, 7, 0), wall)
    found += shapes.rectangle((0, -0.3, back + 0.02), (1.4, 0, 0), (0, 2.6, 0), DARK)
    for y, wide, surface in ((1.0, 1.4, DARK), (3.2, 1.5, BLUE)):
        sides = (wide, 0, 0), (0, wide, 0)
        found += shapes.disc((0, y, back + 0.01), *sides, surface)
    # Of a bay's arcade: two faces with an arch cut out, and the ring between them.
    bays = [(0, spring, z - bay / 2) for z in ends[:-1]]
    arcade: Shape = []
    for face in (-0.2, 0.2):
        sides = (0, 0, bay), (0, 1.3, 0)
        arcade += shapes.rectangle((face, 0.65, 0), *sides, arch)
    for angle in np.pi * (np.arange(10) + 0.5) / 10:
        c, s = np.cos(angle), np.sin(angle)
        ring = (0, s, c), (0.4, 0, 0), (0, 0.32 * c, -0.32 * s)
        arcade += shapes.rectangle(*ring, STONE)
    columns_of_a_row = _column(FLOOR_M, spring, 0.2) + _column(upper, roof, 0.15)
    rod = shapes.capsule((0, upper + 0.2, 0), (0, upper + 1, 0), 0.03, STONE)
    rods = [(0, 0, z) for z in np.arange(ends[0], back, -bay / 7)]
    for way in (-1, 1):
        row = shapes.copies(columns_of_a_row, [(0, 0, z) for z in ends])
        row += shapes.copies(arcade, bays) + shapes.copies(rod, rods)
        row += shapes.box((0, upper + 1, middle), (0.12, 0.08, -back), STONE)
        for y in (upper, roof + 0.2):
            slab = (way * 1.1, y, middle), (2.7, 0.4, -back)
            row += shapes.box(*slab, STONE)
        for number, z in enumerate(ends[1:-1:2]):
            banner = (-way * 0.3, upper + 0.15, z)
            color = (RED, BLUE, YELLOW)[number % 3]
            row += shapes.rectangle(banner, (0, 0, 0.7), (0, 1.8, 0), color)
        found += shapes.moved(row, (way * x, 0, 0))
        outer = (way * 5, 1.8, middle), (0, 0, back), (0, 7, 0)
        found += shapes.rectangle(*outer, wall)
    return found


def arch(radius_m: float, thick_m: float, below_m: float) -> Shape:
    """Stones along half a circle about the origin and down from it, in a wall."""
    found: Shape = []
    # Courses of the wall end under the stones of the arch.
    step = (radius_m + thick_m / 2) / 6
    for y in step * np.arange(6):
        inner = 0.02 + max(radius_m**2 - y**2, 0) ** 0.5
        wide = max(radius_m - inner, 0.001)
        for way in (-1, 1):
            place = (way * (inner + wide / 2), y + step / 2, 0)
            found += shapes.rectangle(place, (wide, 0, 0), (0, step, 0), PLASTER)
    for number in range(15):
        # Every other one stands out.
        size = (thick_m, np.pi * radius_m / 15 * 1.12, 0.3 + 0.02 * (number % 2))
        stone = shapes.box((radius_m + thick_m / 2, 0, -0.1), size, STONE)
        found += shapes.moved(stone, (0, 0, 0), (0, 0, np.pi * (number + 0.5) / 15))
    high = below_m / 4
    stone = shapes.box((0, 0, -0.1), (thick_m, high - 0.015, 0.3), STONE)
    beside = radius_m + thick_m / 2
    sides = [(way * beside, -high * (n + 0.5), 0) for n in range(4) for way in (-1, 1)]
    return found + shapes.copies(stone, sides)


def _petals(count: int) -> np.ndarray:
    x, y = np.meshgrid(*2 * [np.linspace(-1, 1, 96)])
    lobes = np.abs(np.cos(count / 2 * np.arctan2(y, x)))
    return np.hypot(x, y) < 0.5 + 0.48 * lobes


def blooms(size_m: float) -> list[Shape]:
    """Cut-out flowers of four kinds, on the origin, which face the eye."""
    colors = [(0.9, 0.3, 0.4), (0.95, 0.75, 0.2), (0.93, 0.9, 0.95), (0.62, 0.4, 0.8)]
    hearts = [YELLOW, surfaces.uniform((0.5, 0.3, 0.1)), YELLOW, YELLOW]
    found, wide = [], 0.3 * size_m
    for color, heart, count in zip(colors, hearts, (5, 8, 6, 5), strict=True):
        paint = surfaces.uniform(color).cut_out(_petals(count))
        bloom = shapes.rectangle((0, 0, 0), (size_m, 0, 0), (0, size_m, 0), paint)
        bloom += shapes.disc((0, 0, 0.01), (wide, 0, 0), (0, wide, 0), heart)
        found.append(bloom)
    return found


def leaves(size_m: float) -> list[Shape]:
    """Cut-out leaves of two kinds, on the origin, which face the eye."""
    x, y = np.meshgrid(*2 * [np.linspace(-1, 1, 96)])
    place = (1 - y) / 2  # from the stalk on
    jags = 0.06 * np.abs(np.sin(9 * np.pi * place))
    mask = np.abs(x) < (1.5 * place**0.5 * (1 - place) + jags) * (place > 0)
    sides = (0.6 * size_m, 0, 0), (0, 1.1 * size_m, 0)
    greens = ((0.22, 0.45, 0.18), (0.35, 0.55, 0.2))
    paints = [surfaces.uniform(green).cut_out(mask) for green in greens]
    return [shapes.rectangle((0, 0, 0), *sides, paint) for paint in paints]


def hairs(
    middle: Place,
    strands: int,
    thick_m: float,
    rng: np.random.Generator,
    paints: list[Surface],
) -> Shape:
    """Curved hairs of three capsules each, from a small core on."""
    unit = lambda vectors: vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    way = unit(rng.standard_normal((strands, 3)))
    place = np.asarray(middle) + 0.12 * way
    found: Shape = []
    for thick in thick_m / 2 * np.array([1, 0.8, 0.6]):
        way = unit(way + 0.45 * rng.standard_normal((strands, 3)))
        end = place + way * rng.uniform(0.3, 0.45, (strands, 1))
        for number, ends in enumerate(zip(place, end, strict=True)):
            found += shapes.capsule(*ends, thick, paints[number % len(paints)])
        place = end
    return found


def grid(gap_m: float, bar_m: float) -> Shape:
    """Upright and level wires between posts, on the origin, 8.8 m wide."""
    wide, high = 4.4, 2.6
    upright = shapes.capsule((0, 0, 0), (0, high, 0), bar_m / 2, IRON)
    level = shapes.capsule((-wide, 0, 0), (wide, 0, 0), bar_m / 2, IRON)
    post = shapes.capsule((0, 0, 0), (0, high + 0.1, 0), 0.045, RED)
    found = shapes.copies(upright, [(x, 0, 0) for x in np.arange(-wide, wide, gap_m)])
    found += shapes.copies(level, [(0, y, 0) for y in np.arange(gap_m, high, gap_m)])
    return found + shapes.copies(post, [(x, 0, 0) for x in (-3.3, -1.1, 1.1, 3.3)])


def ball(place: Place, radius_m: float, color: Surface) -> Shape:
    """Ball with squares of a colour and of white, which show how it turns."""
    squares = surfaces.checkerboard(color.first, WHITE.first, 0.2)
    return shapes.sphere(place, radius_m, squares)


def tube(radius_m: float, metal: Surface) -> Shape:
    """Pipe through the origin, 14 m from left to right, with flanges and clamps."""
    flange = shapes.cylinder((-0.04, 0, 0), (0.04, 0, 0), 1.6 * radius_m, metal)
    clamp = shapes.box((0, 0, -0.12), (0.05, 3 * radius_m, 0.3), IRON)
    found = shapes.cylinder((-7, 0, 0), (7, 0, 0), radius_m, metal)
    found += shapes.copies(flange, [(x, 0, 0) for x in (-2.4, -0.8, 0.8, 2.4)])
    return found + shapes.copies(clamp, [(x, 0, 0) for x in (-1.6, 1.6)])
