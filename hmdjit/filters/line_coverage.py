"""How much of a pixel lies beyond the line that its edge is a step of.

An edge of whole pixels stands for a straight line that was sampled: where the line
ends, the edge turns off to one side. What the line cuts off of a pixel is the share
that the pixel takes from the one at the other side of the edge.

Edges are above pixels here: `down` is what a pixel takes from the one above it, `up`
what that one takes from it.
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, DTypeLike

from .._types import Mask, Plane
from .edges import Ends, Steps, walk
from .neighborhood import Reader, reader

MARGIN_PX = 4
Padded = Bool[Array, "rows columns"]
"""A mask with a margin of `MARGIN_PX`, in which it is False."""


class Shares(NamedTuple):
    """What two pixels at an edge take from each other, in `[0, 1]`."""

    down: Plane
    up: Plane


_UP, _DOWN, _FAR_UP, _FAR_DOWN = 1, 2, 4, 8  # marks: rows with an edge across the end


def of_lines(
    edge: Padded,
    across: Padded,
    longest: int,
    dtype: DTypeLike,
    *,
    upright: bool = False,
    softens: bool = True,
    rounding: float = 0.0,
) -> Shares:
    """Shares that lines cut off of pixels with an edge along them.

    **Arguments:**

    - `edge`: whether a pixel has an edge at its top; padded.
    - `across`: whether it has one at its left, where lines end.
    - `longest`: how far ends are looked for to each side, px; a power of two.
    - `upright`: for lines along columns instead; *top* is then read as left, *up* as to
      the left.
    - `softens`: as in `line_areas`.
    - `rounding`: how much less is cut off at corners, in `[0, 1)`; 0 is nothing.

    **Returns:** shares, with one row and column more than the picture.
    """
    edge_at, across_at = (reader(p, MARGIN_PX, 1) for p in (edge, across))

    def along(at: Reader, dx: int, dy: int) -> Mask:
        return at(dy, dx) if upright else at(dx, dy)

    def is_joined(x: int) -> Mask:
        """Whether a line goes on from the pixel before."""
        is_crossed = along(across_at, x, 0) | along(across_at, x, -1)
        return along(edge_at, x - 1, 0) & along(edge_at, x, 0) & ~is_crossed

    def noted(x: int) -> Steps:
        rows = {_UP: -1, _DOWN: 0, _FAR_UP: -2, _FAR_DOWN: 1}
        return _noted(*((mark, along(across_at, x, dy)) for mark, dy in rows.items()))

    dx, dy = (0, 1) if upright else (1, 0)
    left = walk(is_joined(0), noted(0), noted(-1), -dx, -dy, longest)
    # The right end of a line is the left edge of the pixel after it.
    right = walk(is_joined(1), noted(1), noted(2), dx, dy, longest)
    left, right = lax.optimization_barrier((left, right))
    down, up = line_areas(left, right, dtype, softens=softens)
    if rounding:
        is_near = left.steps <= right.steps, right.steps <= left.steps
        share = (1 - rounding) / (is_near[0].astype(dtype) + is_near[1].astype(dtype))

        def kept(mark: int) -> Plane:
            lost = jnp.zeros_like(down)
            for near, end in zip(is_near, (left, right), strict=True):
                lost += jnp.where(near & ((end.marks & mark) > 0), share, 0)
            return jnp.clip(1 - lost, 0, 1)

        down, up = down * kept(_FAR_DOWN), up * kept(_FAR_UP)
    is_edge = along(edge_at, 0, 0)
    return Shares(jnp.where(is_edge, down, 0), jnp.where(is_edge, up, 0))


def line_areas(left: Ends, right: Ends, dtype: DTypeLike, *, softens: bool) -> Shares:
    """Shares that a line cuts off of a pixel so far from its ends.

    From half a pixel at an end, up or down as the edge turns off there, the line goes
    straight to 0 in its middle.

    **Arguments:** `softens`: whether the two halves of a line that turns off to the
    same side at both ends, as short ones of round outlines do, cut off more:
    `sqrt(2 area) / 2` of the shortest, nothing more from 32 px on.

    **Source:** Jimenez et al., "SMAA", the published code's `AreaOrtho`.
    """
    turns_left, turns_right = _turn(left), _turn(right)
    # An end that turns off to both sides is taken as the other one's opposite.
    both_left, both_right = ((end.marks & 3) == 3 for end in (left, right))
    turns_left, turns_right = (
        jnp.where(both_left, -turns_right, turns_left),
        jnp.where(both_right, -turns_left, turns_right),
    )
    length = (left.steps + right.steps + 1).astype(dtype)
    off_middle = jnp.abs(left.steps - right.steps).astype(dtype)
    # Mostly one half of the line is above the pixel; the middle one has both ends.
    area = jnp.where(off_middle == 0, 0.25, off_middle) * (0.5 / length)
    if softens:
        soft = jnp.sqrt(2 * area) / 2
        soft += (area - soft) * jnp.minimum(length / 32, 1)
        is_round = turns_left == turns_right
        area = jnp.where(is_round, soft, area)
    turns_left = jnp.where(left.steps <= right.steps, turns_left, 0)
    turns_right = jnp.where(right.steps <= left.steps, turns_right, 0)

    def part(sign: int) -> Plane:
        ends = (turns_left == sign).astype(dtype) + (turns_right == sign).astype(dtype)
        return area * ends

    return Shares(part(-1), part(1))


def _turn(end: Ends) -> Steps:
    """1 where the line turns off upwards, -1 downwards, 0 neither or both."""
    return (end.marks & _UP) - (end.marks & _DOWN) // _DOWN


def _noted(*marks: tuple[int, Mask]) -> Steps:
    noted = [jnp.where(is_set, jnp.int16(mark), jnp.int16(0)) for mark, is_set in marks]
    return functools.reduce(jnp.bitwise_or, noted)


_LINES = (
    "11 11 10 10",
    "10 00 10 10",
    "00 10 10 10",
    "10 10 10 10",
    "11 00 11 10",
    "11 00 10 10",
    "11 10 11 10",
    "11 10 10 10",
    "00 11 10 11",
    "10 11 10 11",
    "00 11 10 10",
    "10 11 10 10",
    "11 11 11 11",
    "11 11 10 11",
    "11 11 11 10",
    "11 11 10 10",
)
"""Two lines for each pattern of edges across a diagonal's ends: points P, Q, P, Q. With
the diagonal along x = y and d pixels long, a line goes from P to Q + (d, d)."""

_BITS = [
    sum((row.replace(" ", "")[k] == "1") << n for n, row in enumerate(_LINES))
    for k in range(8)
]
# Marks of a diagonal's ends: a level and an upright edge across it, as bits of the
# pattern, and whether the walk takes in the pixel that it stopped at.
_START, _END = (4, 1, 2), (2, 8, 1)


def of_diagonals(left: Padded, top: Padded, longest: int, dtype: DTypeLike) -> Shares:
    """Shares that diagonals cut off of pixels with an edge at their top; else 0.

    **Arguments:** `longest`: pixels that are visited to each side; a power of two.
    """
    left_at, top_at = (reader(p, MARGIN_PX, 1) for p in (left, top))

    def side(dx: int, x: int, y: int) -> Mask:
        """Whether a pixel has an edge at its left or right side."""
        return left_at(x + (dx > 0), y)

    def upwards(dx: int, full: int, marks: tuple[int, int, int]) -> Ends:
        """Walk up over pixels with edges at their top and their full side."""

        def noted(x: int, y: int) -> Steps:
            level, upright = top_at(x + dx, y), side(dx, x, y - 1)
            return _noted((marks[0], level), (marks[1], upright))

        goes_on = top_at(dx, -1) & side(full, dx, -1)
        return walk(goes_on, noted(0, 0), noted(dx, -1), dx, -1, longest)

    def downwards(dx: int, marks: tuple[int, int, int]) -> Ends:
        """Walk down, from pixels with an edge at the side that one walks to."""

        def noted(x: int, y: int) -> Steps:
            takes_in = top_at(x + dx, y + 1) & side(dx, x, y)
            level = jnp.where(takes_in, top_at(x + 2 * dx, y + 1), top_at(x + dx, y))
            upright = side(dx, x, y) & ~takes_in
            return _noted(*zip(marks, (level, upright, takes_in), strict=True))

        goes_on = top_at(dx, 1) & side(dx, dx, 1) & side(dx, 0, 0)
        return walk(goes_on, noted(0, 0), noted(dx, 1), dx, 1, longest)

    def reached(end: Ends, marks: tuple) -> tuple[Steps, Steps]:
        """How far an end is, and its bits of the pattern; none if it was not met."""
        level, upright, takes_in = marks
        noted = jnp.where(end.steps < longest, end.marks, 0)
        taken = (noted & takes_in) // takes_in
        return end.steps + taken, noted & (level | upright)

    def cut(start: Ends, end: Ends) -> Shares:
        before, start_marks = reached(start, _START)
        after, end_marks = reached(end, _END)
        down, up = diagonal_areas(before, after, start_marks | end_marks, dtype)
        is_diagonal = top_at(0, 0) & (before + after > 2)
        return Shares(jnp.where(is_diagonal, down, 0), jnp.where(is_diagonal, up, 0))

    rising = cut(downwards(-1, _START), upwards(1, -1, _END))
    falling = cut(upwards(-1, 1, _START), downwards(1, _END))
    return Shares(rising.down + falling.up, rising.up + falling.down)


def diagonal_areas(
    before: Steps, after: Steps, pattern: Steps, dtype: DTypeLike
) -> Shares:
    """Shares that a diagonal cuts off of a pixel so far from its ends.

    In places (x, y) along a row and up, from the diagonal's start: `down` is the part
    of the unit square from (1 + before, before) on that lies above a line, `up` the
    part of that from (1 + before, 1 + before) on that lies below; means of two lines.

    **Source:** Jimenez et al., "SMAA", the published code's `AreaDiag`.
    """
    length, place = before + after + 1, before + 1
    x_start, y_start, x_end, y_end, *others = [
        (jnp.int32(bits).astype(jnp.int16) >> pattern) & 1 for bits in _BITS
    ]
    down = up = 0
    for px, py, qx, qy in ((x_start, y_start, x_end, y_end), others):
        run, rise = length + (qx - px), length + (qy - py)
        beyond = rise * (place - px) - run * (place - py)
        scale = 0.5 / jnp.maximum(2 * run * rise, 1).astype(dtype)
        down += _triangle(-beyond, run, rise).astype(dtype) * scale
        up += _triangle(beyond + rise, run, rise).astype(dtype) * scale
    return Shares(down, up)


def _triangle(at_corner: Steps, run: Steps, rise: Steps) -> Steps:
    """Twice the area, times slopes, of what a line cuts off of a corner of a square."""
    inside = lambda value: jnp.square(jnp.maximum(value, 0))
    return inside(at_corner) - inside(at_corner - run) - inside(at_corner - rise)
