import itertools

import jax.numpy as jnp
import numpy as np
import oracle_morphological as oracle
import pytest
from small import quickly

from hmdjit.filters import edges, line_coverage

CODES = list(itertools.product((False, True), repeat=2))  # up, down


# --- walks ---


def walked(goes_on, marks, dx, dy, longest):
    """From each pixel, a step at a time."""
    steps, noted = np.zeros_like(marks), marks.copy()
    for y, x in np.ndindex(marks.shape):
        n = 0
        while n < longest and goes_on[y + n * dy, x + n * dx]:
            n += 1
        steps[y, x], noted[y, x] = n, marks[y + n * dy, x + n * dx]
    return steps, noted


@pytest.mark.parametrize(
    ("dx", "dy", "longest"),
    [
        (1, 0, 8),
        (-1, 0, 64),
        (0, 1, 16),
        (0, -1, 8),
        (1, 1, 4),
        (-1, 1, 8),
        (1, -1, 16),
    ],
)
def test_a_walk_by_doubling_is_the_walk_step_by_step(rng, dx, dy, longest):
    goes_on = rng.random((40, 40)) < 0.93
    rows, columns = np.mgrid[:40, :40]
    is_inside = (columns + dx >= 0) & (columns + dx < 40)
    goes_on &= is_inside & (rows + dy >= 0) & (rows + dy < 40)
    marks = rng.integers(0, 16, (40, 40)).astype(np.int16)
    ahead = np.roll(marks, (-dy, -dx), (0, 1))
    planes = jnp.asarray(goes_on), jnp.asarray(marks), jnp.asarray(ahead)
    ours = edges.walk(*planes, dx, dy, longest)
    expected = walked(goes_on, marks, dx, dy, longest)
    assert expected[0].max() >= min(longest, 16)  # else little would be shown
    np.testing.assert_array_equal(ours, expected)


# --- areas ---


def sampled_area(before, after, at_left, at_right, samples=2000):
    """Areas (down, up) of one pixel, by heights of the line at many places."""
    d = before + after + 1
    x = before + (np.arange(samples) + 0.5) / samples
    up, down = (np.array([codes[k] for codes in (at_left, at_right)]) for k in (0, 1))
    h1, h2 = (up.astype(float) - down) / 2
    is_both = up & down
    h1, h2 = (-h2 if is_both[0] else h1), (-h1 if is_both[1] else h2)
    y = np.where(x < d / 2, h1 * (1 - 2 * x / d), h2 * (2 * x / d - 1))
    return np.maximum(-y, 0).mean(), np.maximum(y, 0).mean()


def ends(steps, codes):
    marks = [up + 2 * down for up, down in codes]
    return edges.Ends(*(jnp.asarray(v, jnp.int16)[None] for v in (steps, marks)))


@pytest.mark.parametrize("softens", [False, True])
def test_areas_of_lines_are_those_of_polygons(softens):
    cases = list(itertools.product(range(20), range(20), CODES, CODES))
    before, after, at_left, at_right = zip(*cases, strict=True)
    cut = quickly(line_coverage.line_areas, static_argnames=("dtype", "softens"))
    ours = cut(
        ends(before, at_left), ends(after, at_right), dtype="float64", softens=softens
    )
    expected = np.transpose([oracle.line_area(*case, softens) for case in cases])
    np.testing.assert_allclose(np.stack(ours)[:, 0], expected, rtol=0, atol=1e-14)


def test_polygons_of_lines_are_what_one_samples():
    for case in itertools.product((0, 1, 4, 7), (0, 2, 4, 9), CODES, CODES):
        exact, sampled = oracle.line_area(*case, False), sampled_area(*case)
        # The slope is at most 1, so that midpoints err by less than their spacing.
        np.testing.assert_allclose(exact, sampled, rtol=0, atol=1e-6)


DIAGONALS = [(b, a) for b in range(17) for a in range(17) if b + a > 2]


@pytest.mark.parametrize("pattern", range(16))
def test_areas_of_diagonals_are_those_of_polygons(pattern):
    before, after = (
        jnp.asarray(v, jnp.int16)[None] for v in zip(*DIAGONALS, strict=True)
    )
    cut = quickly(line_coverage.diagonal_areas, static_argnames="dtype")
    ours = cut(before, after, jnp.full_like(before, pattern), dtype="float64")
    expected = [oracle.diagonal_area(b, a, pattern) for b, a in DIAGONALS]
    np.testing.assert_allclose(np.stack(ours)[:, 0].T, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("pattern", range(16))
def test_polygons_of_diagonals_are_what_one_samples(pattern):
    side = (np.arange(300) + 0.5) / 300
    x, y = np.meshgrid(side, side)
    for before, after in ((0, 3), (1, 2), (3, 0), (5, 4), (16, 16)):
        parts = []
        for line in oracle.diagonal_lines(before, after, pattern):
            one = oracle.is_beyond(line, x + 1 + before, y + before) < 0
            other = oracle.is_beyond(line, x + 1 + before, y + 1 + before) > 0
            parts.append((one.mean(), other.mean()))
        exact = oracle.diagonal_area(before, after, pattern)
        # A border that is no longer than the diagonal goes through few of the places.
        np.testing.assert_allclose(exact, np.mean(parts, axis=0), rtol=0, atol=2.5e-3)
