"""Scenes of solids by their names: what papers on anti-aliasing in headsets test on.

Metres; the floor lies 1.6 m below the eye, and -z is ahead. What moves is where these
pages say at frame 0.
"""

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from .. import _checks
from . import rasters, shapes, surfaces
from .base import AbstractScene
from .objects import Movement, Object, Sun
from .patterns import checkerboard, honeycomb
from .shapes import Shape
from .solids import Solids

_FLOOR = -1.6
_AHEAD = (0.0, 0.0, -1.0)
_RIGHT, _UP = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)

WHITE = surfaces.uniform((0.92, 0.91, 0.88))
DARK = surfaces.uniform((0.16, 0.15, 0.16))
IRON = surfaces.uniform((0.25, 0.26, 0.29))
RED, BLUE = surfaces.uniform((0.78, 0.22, 0.18)), surfaces.uniform((0.22, 0.4, 0.72))
YELLOW, GREEN = surfaces.uniform((0.95, 0.76, 0.2)), surfaces.uniform((0.2, 0.42, 0.2))
STONE = surfaces.uniform((0.8, 0.74, 0.63))
PLANKS = surfaces.stripes((0.6, 0.43, 0.26), (0.3, 0.2, 0.12), 0.16, 0.02)
BRICKS = surfaces.stripes((0.66, 0.36, 0.28), (0.75, 0.7, 0.64), 0.13, 0.02)


def _meadow(floor_m: float = _FLOOR) -> Shape:
    """Ground with soft blotches, hills at the horizon, three trees."""
    noise = np.random.default_rng(0).standard_normal((64, 64))
    soft = ndimage.gaussian_filter(noise, 2.0, mode="wrap")
    grass = np.array([0.42, 0.58, 0.26]) + 0.035 * (soft / soft.std())[..., None]
    ground = surfaces.picture(np.clip(grass, 0, 1).astype(np.float32), 12.0)
    far, bark = (
        surfaces.uniform((0.42, 0.52, 0.46)),
        surfaces.uniform((0.38, 0.28, 0.2)),
    )
    found = shapes.plane((0, floor_m, 0), _RIGHT, _AHEAD, ground)
    for x, width, height in ((-55, 150, 26), (45, 190, 34), (130, 120, 22)):
        found += shapes.disc((x, floor_m, -100), (width, 0, 0), (0, height, 0), far)
    for x, z, size in ((-7.5, -13, 1.0), (6, -17, 1.15), (12.5, -14, 0.8)):
        top = floor_m + 3.2 * size
        found += shapes.capsule((x, floor_m, z), (x, top, z), 0.16 * size, bark)
        for dx, dy, radius in ((0, 0.5, 1.2), (-0.8, -0.1, 0.9), (0.8, 0, 0.95)):
            place = (x + dx * size, top + dy * size, z + 0.1 * dx)
            found += shapes.sphere(place, radius * size, GREEN)
    return found


def fence(
    *,
    gap_m: float = 0.2,
    bar_m: float = 0.014,
    distance_m: float = 2.5,
    speed_m_s: float = 1.0,
    name: str = "fence",
) -> Solids:
    """Wire fence before a meadow, which comes nearer.

    **Arguments:** `gap_m`: from wire to wire; `bar_m`: their thickness; `distance_m`:
    from the eye at frame 0, which the fence reaches after `distance_m / speed_m_s`.
    """
    _checks.in_range("gap_m", gap_m, 0.02)
    _checks.in_range("bar_m", bar_m, 0, gap_m, open_low=True, open_high=True)
    _checks.in_range("distance_m", distance_m, 0, open_low=True)
    _checks.in_range("speed_m_s", speed_m_s, 0)
    wide, high = 4.4, 2.6
    up = shapes.capsule((0, _FLOOR, 0), (0, _FLOOR + high, 0), bar_m / 2, IRON)
    across = shapes.capsule((-wide, _FLOOR, 0), (wide, _FLOOR, 0), bar_m / 2, IRON)
    post = shapes.capsule((0, _FLOOR, 0), (0, _FLOOR + high + 0.1, 0), 0.045, RED)
    place = lambda x, y: (x, y, -distance_m)
    wires = [place(x, 0) for x in np.arange(-wide, wide + 1e-9, gap_m)]
    rows = [place(0, y) for y in np.arange(gap_m, high + 1e-9, gap_m)]
    grid = shapes.copies(up, wires) + shapes.copies(across, rows)
    grid += shapes.copies(post, [place(x, 0) for x in (-3.3, -1.1, 1.1, 3.3)])
    nearer = Movement(velocity_m_s=(0, 0, speed_m_s))
    return Solids.of([Object(_meadow()), Object(grid, nearer)], name=name)


def hut(*, rate_rad_s: float = 0.8, shadows: bool = True, name: str = "hut") -> Solids:
    """Wooden hut that stands still, with balls, a box and a capsule circling it.

    **Arguments:** `rate_rad_s`: at which the first circles; others do so more slowly,
    or the other way round.
    """
    _checks.in_range("rate_rad_s", rate_rad_s)
    tiles = surfaces.stripes((0.62, 0.25, 0.2), (0.4, 0.15, 0.13), 0.2, 0.03)
    side, eighth = 3.6 / 2**0.5, np.pi / 4
    house = shapes.box((0, 1, 0), (3.6, 2, 3.2), PLANKS)
    # The lower half of a box on its edge lies in the walls, the upper one is the gable.
    house += shapes.box((0, 2, 0), (side, side, 3.18), PLANKS, (0, 0, eighth))
    for way in (-1, 1):
        middle = np.array([way, -1, 0]) * 1.05 + np.array([way, 1, 0]) * 0.05
        # Its stripes run along the ridge.
        slab = shapes.box((0, 0, 0), (0.12, 2.97, 3.9), tiles)
        turn = (0, 0, way * eighth)
        house += shapes.moved(slab, middle + np.array([0, 3.8, 0]), turn)
    house += shapes.box((0.95, 3.5, -0.7), (0.45, 1.5, 0.45), BRICKS)
    house += shapes.box((-0.75, 0.9, 1.6), (0.95, 1.8, 0.1), GREEN)
    house += shapes.sphere((-0.42, 0.9, 1.68), 0.05, YELLOW)
    pane = shapes.box((0, 0, 0), (1, 0.9, 0.08), WHITE)
    for x in (-0.23, 0.23):
        for y in (-0.2, 0.2):
            pane += shapes.rectangle((x, y, 0.05), (0.38, 0, 0), (0, 0.34, 0), BLUE)
    house += shapes.copies(pane, [(0.8, 1.2, 1.6)])
    house += shapes.moved(pane, (1.8, 1.2, 0), (0, np.pi / 2, 0))
    middle = (0, _FLOOR, -5.6)
    things = [
        shapes.sphere((-3.0, 0.9, 1.2), 0.45, _ball(RED)),
        shapes.box((2.6, 1.9, 1.9), (0.6, 0.6, 0.6), BLUE, (0.4, 0.5, 0.2)),
        shapes.capsule((0.5, 2.6, 2.9), (1.2, 2.9, 3.0), 0.16, YELLOW),
        shapes.sphere((-1.7, 2.9, 2.6), 0.32, _ball(BLUE)),
        shapes.sphere((3.2, 0.5, 2.0), 0.5, _ball(YELLOW)),
    ]
    objects = [Object(_meadow() + shapes.moved(house, middle, (0, -0.55, 0)))]
    for thing, share in zip(things, (1, -0.7, 0.5, -1.2, 0.8), strict=True):
        circling = Movement((0, 0, 0), (0, share * rate_rad_s, 0), middle)
        objects.append(Object(shapes.moved(thing, middle), circling))
    sun = Sun((-0.5, 0.8, 0.6), has_shadows=shadows)
    return Solids.of(objects, sun=sun, name=name)


def _ball(color: surfaces.Surface) -> surfaces.Surface:
    return surfaces.checkerboard(color.first, (0.93, 0.92, 0.9), 0.2)


def pipe(
    inclinations_deg: Sequence[float] = (6.0, -28.0),
    *,
    radius_m: float = 0.04,
    name: str = "pipe",
) -> Solids:
    """Long thin pipes before a wall, with flanges and their shadows.

    **Arguments:** `inclinations_deg`: of each, up to the right.
    """
    _checks.in_range("radius_m", radius_m, 0, 0.2, open_low=True)
    if not len(inclinations_deg):
        raise ValueError("inclinations_deg must have at least one angle, got none.")
    for angle in inclinations_deg:
        _checks.in_range("inclinations_deg", angle, -90, 90)
    wall = surfaces.uniform((0.82, 0.8, 0.74))
    objects = [
        Object(
            shapes.rectangle((0, 0, -3), (16, 0, 0), (0, 12, 0), wall)
            + shapes.rectangle((0, _FLOOR, -1), (16, 0, 0), (0, 0, -4), PLANKS)
            + shapes.box((0, _FLOOR + 0.08, -2.98), (16, 0.16, 0.04), WHITE)
        )
    ]
    metals = [surfaces.uniform((0.75, 0.43, 0.27)), surfaces.uniform((0.5, 0.56, 0.62))]
    heights = np.linspace(0.6, 0.1, len(inclinations_deg))
    for number, (angle, y) in enumerate(zip(inclinations_deg, heights, strict=True)):
        metal = metals[number % 2]
        flange = shapes.cylinder((-0.04, 0, 0), (0.04, 0, 0), 1.6 * radius_m, metal)
        clamp = shapes.box((0, 0, -0.12), (0.05, 3 * radius_m, 0.3), IRON)
        line = shapes.cylinder((-7, 0, 0), (7, 0, 0), radius_m, metal)
        line += shapes.copies(flange, [(x, 0, 0) for x in (-2.4, -0.8, 0.8, 2.4)])
        line += shapes.copies(clamp, [(x, 0, 0) for x in (-1.6, 1.6)])
        place = (0, y, -2.75 + 0.25 * number)
        objects.append(Object(shapes.moved(line, place, (0, 0, np.radians(angle)))))
    return Solids.of(objects, sun=Sun((0.3, 0.7, 0.6), has_shadows=True), name=name)


def _window(half_m: float, sill_m: float, top_m: float, z: float) -> Shape:
    """Room with a window in its wall, seen against the light, and what is outside."""
    plaster = surfaces.uniform((0.62, 0.57, 0.5))
    rest = 6 - half_m
    found = [
        *_meadow(_FLOOR - 0.6),
        *shapes.rectangle((0, _FLOOR, z / 2), (12, 0, 0), (0, 0, z), PLANKS),
        *shapes.rectangle((0, 2.4, z / 2), (12, 0, 0), (0, 0, z), WHITE),
    ]
    for x in (-1, 1):
        side = (x * (half_m + rest / 2), 0.4, z)
        found += shapes.rectangle(side, (rest, 0, 0), (0, 4, 0), plaster)
    for low, high in ((_FLOOR, sill_m), (top_m, 2.4)):
        middle, size = (0, (low + high) / 2, z), (0, high - low, 0)
        found += shapes.rectangle(middle, (2 * half_m, 0, 0), size, plaster)
    found += shapes.box((0, sill_m, z + 0.08), (2 * half_m + 0.3, 0.06, 0.3), WHITE)
    return found


_FROM_OUTSIDE = Sun((0.35, 0.75, -0.6), ambient=0.3)
_BRIGHT = (0.86, 0.93, 1.0)


def blinds(
    *,
    slats: int = 36,
    tilt_deg: float = 20.0,
    slat_m: float = 0.045,
    name: str = "blinds",
) -> Solids:
    """Window of a dark room with many thin slats before a bright sky.

    **Arguments:** `slats`: how many, over 1.9 m; `tilt_deg`: by which their far edges
    hang down; `slat_m`: their depth.
    """
    _checks.whole("slats", slats, 1)
    _checks.in_range("tilt_deg", tilt_deg, -90, 90)
    _checks.in_range("slat_m", slat_m, 0, 0.2, open_low=True)
    half, low, high, z = 1.25, -0.85, 1.05, -1.9
    room = _window(half, low, high, z)
    for x in (-half, 0, half):
        room += shapes.box(
            (x, (low + high) / 2, z - 0.1), (0.08, high - low, 0.08), WHITE
        )
    for x in (-0.8, 0.8):
        room += shapes.capsule((x, low, z + 0.05), (x, high, z + 0.05), 0.004, DARK)
    room += shapes.box((0, high, z + 0.05), (2 * half + 0.1, 0.09, 0.09), WHITE)
    angle = np.radians(tilt_deg)
    across = slat_m * np.array([0, -np.sin(angle), -np.cos(angle)])
    slat = shapes.rectangle((0, 0, 0), (2 * half, 0, 0), across, WHITE)
    places = np.linspace(low + 0.06, high - 0.07, slats)
    room += shapes.copies(slat, [(0, y, z + 0.05) for y in places])
    return Solids.of([Object(room)], sun=_FROM_OUTSIDE, background=_BRIGHT, name=name)


def arched_window(
    *, bars: int = 5, bar_m: float = 0.02, name: str = "arched_window"
) -> Solids:
    """Wall with an arched opening, stones along the arch and bars before the light.

    **Arguments:** `bars`: upright ones; `bar_m`: their thickness.
    """
    _checks.whole("bars", bars, 1)
    _checks.in_range("bar_m", bar_m, 0, 0.2, open_low=True)
    radius, thick, low, spring, z = 0.85, 0.26, -0.95, 0.4, -1.8
    top = spring + radius + thick / 2
    room = _window(radius, low, top, z)
    wall = room[-7].surface
    # Courses of the wall between its top and the arch end under the stones.
    step = (radius + thick / 2) / 6
    for number in range(6):
        y = number * step
        inner = (max(radius**2 - y**2, 0) ** 0.5) + 0.02
        for way in (-1, 1):
            side = (way * (inner + radius) / 2, spring + y + step / 2, z)
            wide = max(radius + 0.001 - inner, 1e-3)
            room += shapes.rectangle(side, (wide, 0, 0), (0, step, 0), wall)
    stones = 15
    for number in range(stones):
        angle = np.pi * (number + 0.5) / stones
        out = np.array([np.cos(angle), np.sin(angle), 0]) * (radius + thick / 2)
        size = (thick, np.pi * radius / stones * 1.12, 0.3 + 0.02 * (number % 2))
        place = out + np.array([0, spring, z - 0.1])
        room += shapes.box(place, size, STONE, (0, 0, angle))
    for way in (-1, 1):
        for number in range(4):
            y = low + (number + 0.5) * (spring - low) / 4
            size = (0.2, (spring - low) / 4 - 0.015, 0.3)
            room += shapes.box((way * (radius + 0.1), y, z - 0.1), size, STONE)
    for x in np.linspace(-radius, radius, bars + 2)[1:-1]:
        end = spring + (radius**2 - x**2) ** 0.5
        room += shapes.capsule((x, low, z - 0.1), (x, end, z - 0.1), bar_m / 2, IRON)
    for y in np.linspace(low, spring, 4)[1:]:
        ends = [(x, y, z - 0.1) for x in (-radius, radius)]
        room += shapes.capsule(*ends, bar_m / 2, IRON)
    return Solids.of([Object(room)], sun=_FROM_OUTSIDE, background=_BRIGHT, name=name)


def wall_text(
    *, line_m: float = 0.16, angle_deg: float = 38.0, name: str = "wall_text"
) -> Solids:
    """Wall with printed text, seen at an angle.

    **Arguments:** `line_m`: from line to line of the poster, 3 m wide; `angle_deg`: by
    which the wall is turned, its right end away.

    **Errors:** `ImportError` without Pillow.
    """
    _checks.in_range("line_m", line_m, 0.02, 0.3)
    _checks.in_range("angle_deg", angle_deg, -80, 80)
    text = surfaces.picture(rasters.drawn_text(line_m, 3.0, 340), 3.0)
    wall = shapes.rectangle((0, 1, 0), (14, 0, 0), (0, 6, 0), BRICKS)
    wall += shapes.box((0, 0.15, 0.01), (3.16, 3.16, 0.06), DARK)
    wall += shapes.rectangle((0, 0.15, 0.05), (3, 0, 0), (0, 3, 0), text)
    turned = shapes.moved(wall, (0.1, 0, -2.4), (0, np.radians(angle_deg), 0))
    slabs = surfaces.checkerboard((0.6, 0.58, 0.55), (0.5, 0.48, 0.46), 0.5)
    floor = shapes.plane((0, _FLOOR, 0), _RIGHT, _AHEAD, slabs)
    return Solids.of([Object(floor + turned)], name=name)


def _atrium(columns: int) -> list[Object]:
    """Two storeys of columns around a court, arcades, banners, a floor of stone."""
    bay, x, deep = 2.4, 2.6, 0.4
    spring, radius, upper, roof = 0.9, 1.0, 2.4, 4.7
    ends = -1.2 - bay * np.arange(columns)
    back, middle = ends[-1] - 1.2, (ends[-1] - 1.2) / 2
    marble = surfaces.checkerboard((0.82, 0.78, 0.7), (0.42, 0.3, 0.27), 0.6)
    plaster = surfaces.uniform((0.84, 0.72, 0.55))
    x_mask, y_mask = np.meshgrid(
        *(np.linspace(*ends) for ends in ((-1.2, 1.2, 288), (1.3, 0, 156)))
    )
    arch = plaster.cut_out(np.hypot(x_mask, y_mask) > radius)
    found = shapes.rectangle((0, _FLOOR, middle), (10, 0, 0), (0, 0, back - 2), marble)
    found += shapes.rectangle((0, 1.8, back), (10, 0, 0), (0, 7, 0), plaster)
    found += shapes.rectangle((0, -0.3, back + 0.02), (1.4, 0, 0), (0, 2.6, 0), DARK)
    found += shapes.disc((0, 1.0, back + 0.01), (1.4, 0, 0), (0, 1.4, 0), DARK)
    found += shapes.disc((0, 3.2, back + 0.01), (1.5, 0, 0), (0, 1.5, 0), BLUE)

    def column(low: float, high: float, thick: float) -> Shape:
        made = shapes.capsule((0, low + 0.2, 0), (0, high - 0.2, 0), thick, STONE)
        made += shapes.box((0, low + 0.1, 0), (0.56, 0.2, 0.56), STONE)
        made += shapes.box((0, high - 0.07, 0), (0.6, 0.14, 0.6), STONE)
        lip = shapes.cylinder((0, high - 0.24, 0), (0, high - 0.14, 0), 0.25, STONE)
        return made + lip

    lower = column(_FLOOR, spring, 0.2)
    high = column(upper + 0.1, roof, 0.15)
    for way in (-1, 1):
        found += shapes.copies(lower + high, [(way * x, 0, z) for z in ends])
        wall = (way * 5, 1.8, middle)
        found += shapes.rectangle(wall, (0, 0, back), (0, 7, 0), plaster)
        for y, thick in ((upper, 0.4), (roof + 0.2, 0.4)):
            slab = (way * (x + 1.1), y, middle), (2.7, thick, -back)
            found += shapes.box(*slab, STONE)
        rail = (way * (x - 0.1), upper + 1.0, middle), (0.12, 0.08, -back)
        found += shapes.box(*rail, STONE)
        for z in ends[:-1] - bay / 2:
            for face in (-deep / 2, deep / 2):
                place = (way * x + face, spring + 0.65, z)
                found += shapes.rectangle(place, (0, 0, bay), (0, 1.3, 0), arch)
            for angle in np.pi * (np.arange(10) + 0.5) / 10:
                c, s = np.cos(angle), np.sin(angle)
                place = (way * x, spring + radius * s, z + radius * c)
                along = 0.32 * np.array([0, c, -s])
                found += shapes.rectangle(place, (deep, 0, 0), along, STONE)
        balusters = ends[0] + (back - ends[0]) * np.arange(0.01, 1, 0.02)
        rod = shapes.capsule((0, upper + 0.2, 0), (0, upper + 1, 0), 0.03, STONE)
        found += shapes.copies(rod, [(way * (x - 0.1), 0, z) for z in balusters])
        for number, z in enumerate(ends[1:-1:2]):
            banner = (way * (x - 0.25), upper + 0.1, z - bay / 2)
            color = (RED, GREEN, BLUE)[number % 3]
            found += shapes.rectangle(banner, (0, 0, 0.8), (0, 1.8, 0), color)
    return [Object(found)]


_FROM_ABOVE = Sun((0.36, 1.0, 0.12), ambient=0.4)


def _shining(shadows: bool) -> Sun:
    return Sun(_FROM_ABOVE.direction, _FROM_ABOVE.ambient, shadows)


def atrium(*, columns: int = 7, shadows: bool = True, name: str = "atrium") -> Solids:
    """Court with two storeys of columns and arcades, in light from above.

    **Arguments:** `columns`: of a row, of which there are four.
    """
    _checks.whole("columns", columns, 2)
    return Solids.of(_atrium(columns), sun=_shining(shadows), name=name)


def moving_sphere(
    *,
    speed_m_s: float = 3.0,
    radius_m: float = 0.35,
    shadows: bool = True,
    name: str = "moving_sphere",
) -> Solids:
    """Sphere that flies across the atrium, to the right.

    **Arguments:** `speed_m_s`: it starts 1 m to the left, 3.2 m ahead.
    """
    _checks.in_range("speed_m_s", speed_m_s)
    _checks.in_range("radius_m", radius_m, 0, 1, open_low=True)
    ball = shapes.sphere((-1, -0.2, -3.2), radius_m, _ball(RED))
    flying = Object(ball, Movement((speed_m_s, 0, 0)))
    return Solids.of([*_atrium(7), flying], sun=_shining(shadows), name=name)


def _petals(count: int, size: int = 96) -> np.ndarray:
    """Mask of a flower."""
    x, y = np.meshgrid(*2 * [np.linspace(-1, 1, size)])
    angle = np.arctan2(y, x)
    return np.hypot(x, y) < 0.5 + 0.48 * np.abs(np.cos(count / 2 * angle))


def _leaf(size: int = 96) -> np.ndarray:
    """Mask of a leaf with its tip up."""
    x, up = np.meshgrid(*2 * [np.linspace(-1, 1, size)])
    place = np.clip((1 - up) / 2, 0, 1)
    jags = 0.06 * np.abs(np.sin(9 * np.pi * place))
    return np.abs(x) < (1.5 * place**0.5 * (1 - place) + jags) * (place > 0)


def flowers(
    *, count: int = 60, size_m: float = 0.24, seed: int = 0, name: str = "flowers"
) -> Solids:
    """Cut-out flowers and leaves that wind around a column, and stand before it.

    **Arguments:** `count`: of flowers around the column; `size_m`: of a flower.
    """
    _checks.whole("count", count, 1)
    _checks.in_range("size_m", size_m, 0, 1, open_low=True)
    _checks.whole("seed", seed, 0)
    rng = np.random.default_rng(seed)
    colors = [(0.9, 0.3, 0.4), (0.95, 0.75, 0.2), (0.93, 0.9, 0.95), (0.62, 0.4, 0.8)]
    kinds = [
        surfaces.uniform(color).cut_out(_petals(petals))
        for color, petals in zip(colors, (5, 8, 6, 5), strict=True)
    ]
    greens = [(0.22, 0.45, 0.18), (0.35, 0.55, 0.2)]
    blade = _leaf()
    leaves = [surfaces.uniform(green).cut_out(blade) for green in greens]
    radius, z = 0.5, -2.1
    column = shapes.cylinder((0, _FLOOR, z), (0, 2.6, z), radius, STONE)
    column += shapes.box((0, _FLOOR + 0.15, z), (1.3, 0.3, 1.3), STONE)
    column += shapes.box((0, 2.5, z), (1.4, 0.35, 1.4), STONE)
    heart = surfaces.uniform((0.55, 0.33, 0.12))

    def bloom(number: int) -> Shape:
        kind = kinds[number % len(kinds)]
        heart_of = YELLOW if number % len(kinds) != 1 else heart
        flat = shapes.rectangle((0, 0, 0), (size_m, 0, 0), (0, size_m, 0), kind)
        wide = 0.3 * size_m
        return flat + shapes.disc((0, 0, 0.01), (wide, 0, 0), (0, wide, 0), heart_of)

    def around(angle: float, y: float, out: float, shape: Shape) -> Shape:
        flat = shapes.moved(shape, (0, 0, 0), (0, 0, rng.uniform(-np.pi, np.pi)))
        tilted = shapes.moved(
            flat, (0, 0, radius + out), (rng.uniform(-0.5, 0.2), 0, 0)
        )
        return shapes.moved(tilted, (0, y, z), (0, angle, 0))

    found: Shape = []
    for number in range(count):
        height = (number + 0.5) / count
        y = -1.1 + 3.2 * height
        angle = 12.0 * np.pi * height + rng.normal(0, 0.15)
        found += around(angle, y, 0.07 + rng.uniform(0, 0.04), bloom(number))
        for _ in range(3):
            leaf = shapes.rectangle(
                (0, 0, 0),
                (0.6 * size_m, 0, 0),
                (0, 1.1 * size_m, 0),
                leaves[rng.integers(2)],
            )
            nudge = rng.normal(0, 0.25), rng.normal(0, 0.08)
            found += around(angle + nudge[0], y + nudge[1], 0.03, leaf)
    for number in range(24):
        x, deep = rng.uniform(-3.2, 3.2), rng.uniform(-3.4, -1.5)
        tall = _FLOOR + rng.uniform(0.5, 0.9)
        found += shapes.capsule((x, _FLOOR, deep), (x, tall, deep), 0.012, GREEN)
        found += shapes.moved(bloom(number), (x, tall, deep + 0.02), (-0.3, 0, 0))
    return Solids.of([Object(_meadow()), Object(column), Object(found)], name=name)


def _hairs(
    count: int, hair_m: float, seed: int, paints: Sequence[surfaces.Surface]
) -> Shape:
    """Strands of three capsules each, from a small core on."""
    rng = np.random.default_rng(seed)
    strands, middle = -(-count // 3), np.array([0.0, 0.0, -2.4])
    way = rng.standard_normal((strands, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    place = middle + 0.12 * way
    found: Shape = []
    for part in range(3):
        way = way + 0.45 * rng.standard_normal((strands, 3))
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        end = place + way * rng.uniform(0.3, 0.45, (strands, 1))
        for number, (a, b) in enumerate(zip(place, end, strict=True)):
            paint = paints[number % len(paints)]
            found += shapes.capsule(a, b, hair_m / 2 * (1 - 0.2 * part), paint)
        place = end
    return found


def hairball(
    *,
    hairs: int = 2400,
    hair_m: float = 0.01,
    seed: int = 0,
    name: str = "hairball",
) -> Solids:
    """Ball of thin curved hairs that grow from a small core, in the light.

    **Arguments:** `hairs`: straight pieces of them, three to a hair; `hair_m`: their
    thickness at the core.
    """
    _check_hairs(hairs, hair_m, seed)
    shades = ((0.78, 0.55, 0.3), (0.62, 0.4, 0.2), (0.88, 0.7, 0.45))
    paints = [surfaces.uniform(shade) for shade in shades]
    ball = _hairs(hairs, hair_m, seed, paints)
    sun = Sun((-0.5, 0.8, 0.7), ambient=0.25)
    return Solids.of([Object(ball)], sun=sun, background=(0.2, 0.24, 0.3), name=name)


def hairball_shadow(
    *,
    hairs: int = 2400,
    hair_m: float = 0.01,
    seed: int = 0,
    name: str = "hairball_shadow",
) -> Solids:
    """Dark silhouette of the hairball on a bright ground; see `hairball`."""
    _check_hairs(hairs, hair_m, seed)
    ball = _hairs(hairs, hair_m, seed, [surfaces.uniform((0.08, 0.08, 0.1))])
    light = (0.93, 0.92, 0.88)
    return Solids.of([Object(ball)], sun=None, background=light, name=name)


def _check_hairs(hairs: int, hair_m: float, seed: int) -> None:
    _checks.whole("hairs", hairs, 3)
    _checks.in_range("hair_m", hair_m, 0, 0.1, open_low=True)
    _checks.whole("seed", seed, 0)


def solid_set() -> dict[str, AbstractScene]:
    """Scenes that a study takes by name: eleven of solids, and two patterns.

    **Errors:** `ImportError` without Pillow, which draws text.
    """
    made = (fence, hut, pipe, blinds, arched_window, wall_text, atrium, flowers)
    made += (hairball, hairball_shadow, moving_sphere, honeycomb, checkerboard)
    scenes: list[AbstractScene] = [make() for make in made]
    return {scene.name: scene for scene in scenes}
