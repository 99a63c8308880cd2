"""Scenes of solids by their names: what papers on anti-aliasing in headsets test on.

Lengths in metres; arguments say where things are at frame 0. Each function raises
`ValueError` for a number out of its range.
"""

from collections.abc import Sequence

import numpy as np

from .. import _checks
from . import props, rasters, shapes, surfaces
from .base import AbstractScene
from .patterns import checkerboard, honeycomb
from .props import FLOOR_M
from .shapes import Movement, Object, Shape, Sun
from .solids import Solids


def _against_the_light(found: Shape, name: str) -> Solids:
    sun = Sun((0.35, 0.75, -0.6), ambient=0.3)
    return Solids.of([Object(found)], sun=sun, background=(0.86, 0.93, 1.0), name=name)


def _check_sizes(high: float = 1.0, **sizes_m: float) -> None:
    for name, size in sizes_m.items():
        _checks.in_range(name, size, 0, high, open_low=True)


def fence(
    *,
    gap_m: float = 0.2,
    bar_m: float = 0.014,
    distance_m: float = 2.5,
    speed_m_s: float = 1.0,
    name: str = "fence",
) -> Solids:
    """Wire fence before a meadow, which comes nearer.

    **Arguments:** `gap_m`: from wire to wire, in [0.05, 1]; `bar_m`: their thickness,
    below it; `distance_m`: in (0, 100], passed after `distance_m / speed_m_s`.
    """
    _checks.in_range("gap_m", gap_m, 0.05, 1)
    _checks.in_range("bar_m", bar_m, 0, gap_m, open_low=True, open_high=True)
    _check_sizes(100.0, distance_m=distance_m)
    _checks.in_range("speed_m_s", speed_m_s, 0)
    wires = shapes.moved(props.grid(gap_m, bar_m), (0, FLOOR_M, -distance_m))
    nearer = Movement((0.0, 0.0, speed_m_s))
    return Solids.of([Object(props.meadow()), Object(wires, nearer)], name=name)


def hut(*, rate_rad_s: float = 0.8, shadows: bool = True, name: str = "hut") -> Solids:
    """Wooden hut that stands still, with balls, a box and a capsule circling it.

    **Arguments:** `rate_rad_s`: at which the first circles; others do so more slowly,
    or the other way round.
    """
    _checks.in_range("rate_rad_s", rate_rad_s)
    middle = (0.0, FLOOR_M, -5.6)
    things = {
        1.0: props.ball((-3.0, 0.9, 1.2), 0.45, props.RED),
        -0.7: shapes.box((2.6, 1.9, 1.9), (0.6, 0.6, 0.6), props.BLUE, (0.4, 0.5, 0.2)),
        0.5: shapes.capsule((0.5, 2.6, 2.9), (1.2, 2.9, 3.0), 0.16, props.YELLOW),
        -1.2: props.ball((-1.7, 2.9, 2.6), 0.32, props.BLUE),
        0.8: props.ball((3.2, 0.5, 2.0), 0.5, props.YELLOW),
    }
    house = shapes.moved(props.house(), middle, (0, -0.55, 0))
    objects = [Object(props.meadow()), Object(house)]
    for share, thing in things.items():
        turning = (0.0, share * rate_rad_s, 0.0)
        circling = Movement(rotation_rad_s=turning, pivot_m=middle)
        objects.append(Object(shapes.moved(thing, middle), circling))
    return Solids.of(objects, sun=Sun((-0.5, 0.8, 0.6), has_shadows=shadows), name=name)


def pipe(
    inclinations_deg: Sequence[float] = (6.0, -28.0),
    *,
    radius_m: float = 0.04,
    name: str = "pipe",
) -> Solids:
    """Long thin pipes before a wall, with flanges and their shadows.

    **Arguments:** `inclinations_deg`: of each, up to the right, in [-90, 90];
    `radius_m`: in (0, 0.1].
    """
    _check_sizes(0.1, radius_m=radius_m)
    if not len(inclinations_deg):
        raise ValueError("inclinations_deg must have at least one angle, got none.")
    for angle in inclinations_deg:
        _checks.in_range("inclinations_deg", angle, -90, 90)
    wall = surfaces.uniform((0.82, 0.8, 0.74))
    found = shapes.rectangle((0, 0, -3), (16, 0, 0), (0, 12, 0), wall)
    found += shapes.rectangle((0, FLOOR_M, -1), (16, 0, 0), (0, 0, -4), props.PLANKS)
    found += shapes.box((0, FLOOR_M + 0.08, -2.98), (16, 0.16, 0.04), props.WHITE)
    metals = [surfaces.uniform(c) for c in ((0.75, 0.43, 0.27), (0.5, 0.56, 0.62))]
    objects = [Object(found)]
    heights = np.linspace(0.6, 0.1, len(inclinations_deg))
    for number, (angle, y) in enumerate(zip(inclinations_deg, heights, strict=True)):
        line = props.tube(radius_m, metals[number % 2])
        place = (0, y, -2.75 + 0.25 * (number % 4))
        objects.append(Object(shapes.moved(line, place, (0, 0, np.radians(angle)))))
    return Solids.of(objects, sun=Sun((0.3, 0.7, 0.6), has_shadows=True), name=name)


def blinds(
    *,
    slats: int = 40,
    tilt_deg: float = 35.0,
    slat_m: float = 0.04,
    name: str = "blinds",
) -> Solids:
    """Window of a dark room with many thin slats before a bright sky.

    **Arguments:** `slats`: how many, over 1.9 m; `tilt_deg`: by which their far edges
    hang down, in [-90, 90]; `slat_m`: their depth, in (0, 0.2].
    """
    _checks.whole("slats", slats, 1)
    _checks.in_range("tilt_deg", tilt_deg, -90, 90)
    _check_sizes(0.2, slat_m=slat_m)
    half, low, high, z = 1.2, -0.85, 1.05, -1.5
    found, middle = props.room(half, low, high, z), (low + high) / 2
    for x in (-half, 0, half):
        found += shapes.box((x, middle, z - 0.1), (0.08, high - low, 0.08), props.WHITE)
    cord = shapes.capsule((0, low, z + 0.05), (0, high, z + 0.05), 0.004, props.DARK)
    found += shapes.copies(cord, [(x, 0, 0) for x in (-0.75, 0.75)])
    found += shapes.box((0, high, z + 0.05), (2 * half + 0.1, 0.09, 0.09), props.WHITE)
    # 3 mm thick: a thinner one would vanish where it is seen edge-on.
    size, turn = (2 * half, 0.003, slat_m), (-np.radians(tilt_deg), 0, 0)
    slat = shapes.box((0, 0, z + 0.05), size, props.WHITE, turn)
    heights = np.linspace(low + 0.06, high - 0.07, slats)
    found += shapes.copies(slat, [(0, y, 0) for y in heights])
    return _against_the_light(found, name)


def arched_window(
    *, bars: int = 5, bar_m: float = 0.02, name: str = "arched_window"
) -> Solids:
    """Wall with an arched opening, stones along the arch and bars before the light.

    **Arguments:** `bars`: upright ones; `bar_m`: their thickness, in (0, 0.2].
    """
    _checks.whole("bars", bars, 1)
    _check_sizes(0.2, bar_m=bar_m)
    radius, thick, low, spring, z = 0.85, 0.26, -0.95, 0.4, -1.5
    found = props.room(radius, low, spring + radius + thick / 2, z)
    found += shapes.moved(props.arch(radius, thick, spring - low), (0, spring, z))
    behind = z - 0.1
    for x in np.linspace(-radius, radius, bars + 2)[1:-1]:
        end = spring + (radius**2 - x**2) ** 0.5
        found += shapes.capsule(
            (x, low, behind), (x, end, behind), bar_m / 2, props.IRON
        )
    for y in np.linspace(low, spring, 4)[1:]:
        start, end = ((x, y, behind) for x in (-radius, radius))
        found += shapes.capsule(start, end, bar_m / 2, props.IRON)
    return _against_the_light(found, name)


def wall_text(
    *, line_m: float = 0.16, angle_deg: float = 38.0, name: str = "wall_text"
) -> Solids:
    """Wall with printed text, seen at an angle.

    **Arguments:** `line_m`: from line to line of the poster, 3 m wide, in [0.02, 0.3];
    `angle_deg`: by which the wall is turned, its right end away, in [-80, 80].

    **Errors:** `ImportError` without Pillow.
    """
    _checks.in_range("line_m", line_m, 0.02, 0.3)
    _checks.in_range("angle_deg", angle_deg, -80, 80)
    text = surfaces.picture(rasters.drawn_text(line_m, 3.0, 340), 3.0)
    wall = shapes.rectangle((0, 1, 0), (14, 0, 0), (0, 6, 0), props.BRICKS)
    wall += shapes.box((0, 0.15, 0.01), (3.16, 3.16, 0.06), props.DARK)
    wall += shapes.rectangle((0, 0.15, 0.05), (3, 0, 0), (0, 3, 0), text)
    slabs = surfaces.checkerboard((0.6, 0.58, 0.55), (0.5, 0.48, 0.46), 0.5)
    found = shapes.plane((0, FLOOR_M, 0), props.RIGHT, props.AHEAD, slabs)
    found += shapes.moved(wall, (0.1, 0, -2.4), (0, np.radians(angle_deg), 0))
    return Solids.of([Object(found)], name=name)


def _from_above(shadows: bool) -> Sun:
    return Sun((0.45, 1.0, 0.25), ambient=0.32, has_shadows=shadows)


def atrium(*, columns: int = 7, shadows: bool = True, name: str = "atrium") -> Solids:
    """Court with two storeys of columns and arcades, in light from above.

    **Arguments:** `columns`: of a row, of which there are four.
    """
    _checks.whole("columns", columns, 2)
    return Solids.of(
        [Object(props.court(columns))], sun=_from_above(shadows), name=name
    )


def moving_sphere(
    *,
    speed_m_s: float = 3.0,
    radius_m: float = 0.35,
    shadows: bool = True,
    name: str = "moving_sphere",
) -> Solids:
    """Sphere that flies across the atrium, to the right.

    **Arguments:** `speed_m_s`: it starts 1 m to the left, 3.2 m ahead; `radius_m`: in
    (0, 1].
    """
    _checks.in_range("speed_m_s", speed_m_s)
    _check_sizes(radius_m=radius_m)
    ball = props.ball((-1, -0.2, -3.2), radius_m, props.RED)
    objects = [Object(props.court(7)), Object(ball, Movement((speed_m_s, 0.0, 0.0)))]
    return Solids.of(objects, sun=_from_above(shadows), name=name)


def flowers(
    *, count: int = 90, size_m: float = 0.28, seed: int = 0, name: str = "flowers"
) -> Solids:
    """Cut-out flowers and leaves that wind around a column, and stand before it.

    **Arguments:** `count`: of flowers around the column; `size_m`: of one, in (0, 1].
    """
    _checks.whole("count", count, 1)
    _checks.whole("seed", seed, 0)
    _check_sizes(size_m=size_m)
    rng = np.random.default_rng(seed)
    radius, z = 0.5, -2.1
    column = shapes.cylinder((0, FLOOR_M, z), (0, 2.6, z), radius, props.STONE)
    column += shapes.box((0, FLOOR_M + 0.15, z), (1.3, 0.3, 1.3), props.STONE)
    column += shapes.box((0, 2.5, z), (1.4, 0.35, 1.4), props.STONE)
    kinds, greens = props.blooms(size_m), props.leaves(size_m)

    def hung(shape: Shape, angle: float, y: float, out_m: float) -> Shape:
        turned = shapes.moved(shape, (0, 0, 0), (0, 0, rng.uniform(-np.pi, np.pi)))
        tilt = (rng.uniform(-0.5, 0.2), 0, 0)
        tilted = shapes.moved(turned, (0, 0, radius + out_m), tilt)
        return shapes.moved(tilted, (0, y, z), (0, angle, 0))

    found: Shape = []
    for number, share in enumerate(np.linspace(0, 1, count)):
        y, angle = -1.1 + 3.2 * share, 14 * np.pi * share + rng.normal(0, 0.15)
        found += hung(kinds[number % 4], angle, y, 0.07 + rng.uniform(0, 0.04))
        for kind in rng.integers(2, size=2):
            nudge, drop = rng.normal(0, (0.25, 0.08))
            found += hung(greens[kind], angle + nudge, y + drop, 0.03)
    for number in range(24):
        x, deep = rng.uniform((-3.2, -3.4), (3.2, -1.5))
        top = FLOOR_M + rng.uniform(0.5, 0.9)
        found += shapes.capsule((x, FLOOR_M, deep), (x, top, deep), 0.012, props.GREEN)
        found += shapes.moved(kinds[number % 4], (x, top, deep + 0.02), (-0.3, 0, 0))
    return Solids.of([Object(props.meadow()), Object(column), Object(found)], name=name)


def _hairs(
    hairs: int, hair_m: float, seed: int, paints: list[surfaces.Surface]
) -> list[Object]:
    _checks.whole("hairs", hairs, 1)
    _check_sizes(0.1, hair_m=hair_m)
    _checks.whole("seed", seed, 0)
    rng, middle = np.random.default_rng(seed), (0.0, 0.0, -1.9)
    return [Object(props.hairs(middle, hairs, hair_m, rng, paints))]


def hairball(
    *, hairs: int = 800, hair_m: float = 0.01, seed: int = 0, name: str = "hairball"
) -> Solids:
    """Ball of thin curved hairs that grow from a small core, in the light.

    **Arguments:** `hairs`: three straight pieces each; `hair_m`: their thickness at the
    core, in (0, 0.1].
    """
    shades = ((0.78, 0.55, 0.3), (0.62, 0.4, 0.2), (0.88, 0.7, 0.45))
    ball = _hairs(hairs, hair_m, seed, [surfaces.uniform(shade) for shade in shades])
    sun = Sun((-0.5, 0.8, 0.7), ambient=0.25)
    return Solids.of(ball, sun=sun, background=(0.2, 0.24, 0.3), name=name)


def hairball_shadow(
    *,
    hairs: int = 800,
    hair_m: float = 0.01,
    seed: int = 0,
    name: str = "hairball_shadow",
) -> Solids:
    """Dark silhouette of the hairball on a bright ground; see `hairball`."""
    ball = _hairs(hairs, hair_m, seed, [surfaces.uniform((0.08, 0.08, 0.1))])
    return Solids.of(ball, sun=None, background=(0.93, 0.92, 0.88), name=name)


_MADE = (fence, hut, pipe, blinds, arched_window, wall_text, atrium, flowers)
_MADE += (hairball, hairball_shadow, moving_sphere, honeycomb, checkerboard)
SOLIDS = {make.__name__: make for make in _MADE}
"""What makes each scene of `solid_set`, by name."""


def solid_set() -> dict[str, AbstractScene]:
    """Eleven scenes of solids, two patterns; `ImportError` without Pillow, for text."""
    return {name: make() for name, make in SOLIDS.items()}
