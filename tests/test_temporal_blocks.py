"""Blocks that temporal techniques share, by hand, by loops, and at their corners."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

import hmdjit as hj
from hmdjit.filters import neighborhood, temporal
from hmdjit.filters.neighborhood import Box
from hmdjit.frames.displacement import DisplacementField
from hmdjit.frames.sources import History

CAMERA = hj.Camera(6, 5, 60.0, 60.0)
STILL = hj.Motion(jnp.zeros(3, float), jnp.zeros(3, float))


def unit_box(colors):
    return Box(jnp.zeros_like(colors), jnp.ones_like(colors))


def pixel(*values):
    return jnp.asarray(values, float).reshape(3, 1, 1)


def dilated(depth, velocity, **options) -> DisplacementField:
    found = temporal.dilated(frame_of(depth, velocity), STILL, **options)
    assert isinstance(found, DisplacementField)
    return found


def frame_of(depth, velocity):
    """A frame of depths `(h, w)` and velocities `(2, h, w)`."""
    channels = {"depth": depth[None, None], "velocity": velocity[None]}
    color = jnp.zeros((1, 3, *depth.shape))
    region = hj.Region.whole(CAMERA)
    return hj.Frame(
        color, CAMERA, region, channels={k: jnp.asarray(v) for k, v in channels.items()}
    )


# --- boxes and shifts ---


def test_boxes_hold_the_extremes_of_their_pixels(rng):
    planes = rng.random((3, 5, 7))
    padded = np.pad(planes, ((0, 0), (1, 1), (1, 1)), mode="edge")
    read = {
        (dx, dy): padded[:, 1 + dy : 6 + dy, 1 + dx : 8 + dx]
        for dx in (-1, 0, 1)
        for dy in (-1, 0, 1)
    }
    beside = [read[place] for place in read if 0 in place]
    plus, block = neighborhood.plus_and_block(jnp.asarray(planes))
    for box, values in ((plus, beside), (block, list(read.values()))):
        np.testing.assert_array_equal(box.low, np.min(values, axis=0))
        np.testing.assert_array_equal(box.high, np.max(values, axis=0))
    rounded = neighborhood.rounded_box(jnp.asarray(planes))
    np.testing.assert_array_equal(rounded.high, (plus.high + block.high) / 2)
    mean = neighborhood.plus_mean(jnp.asarray(planes))
    np.testing.assert_allclose(mean, np.mean(beside, axis=0), rtol=1e-14)


@pytest.mark.parametrize("by", [(0.3, -0.7), (-1.5, 1.5), (0, 0), (1.5, -1.2), (-1, 1)])
def test_a_shift_reads_bilinearly_and_clamps(rng, by):
    planes = rng.random((3, 5, 6))
    expected = np.zeros_like(planes)
    for j, i in np.ndindex(5, 6):
        x, y = np.clip(i + by[0], 0, 5), np.clip(j + by[1], 0, 4)
        left, top = int(min(x, 4)), int(min(y, 3))
        u, v = x - left, y - top
        for row, share_y in ((top, 1 - v), (top + 1, v)):
            for column, share_x in ((left, 1 - u), (left + 1, u)):
                expected[:, j, i] += share_y * share_x * planes[:, row, column]
    ours = neighborhood.shifted(jnp.asarray(planes), jnp.asarray(by, float))
    np.testing.assert_allclose(ours, expected, rtol=1e-13)


def test_a_ramp_is_unjittered_exactly_away_from_the_edge(rng):
    y, x = np.mgrid[:8, :9].astype(float)
    jitter = np.array([0.85, -0.6])
    seen = 0.1 + 0.03 * (x + jitter[0]) + 0.05 * (y + jitter[1])
    ours = temporal.unjittered(jnp.asarray(seen), jnp.asarray(jitter))
    inner = (slice(2, -2),) * 2
    np.testing.assert_allclose(
        ours[inner], (0.1 + 0.03 * x + 0.05 * y)[inner], rtol=1e-14
    )
    seen = jnp.asarray(seen)
    np.testing.assert_array_equal(temporal.unjittered(seen, None), seen)
    noise = jnp.asarray(rng.random((5, 6)))
    shifted = jax.jit(neighborhood.shifted)
    check_grads(shifted, (noise, jnp.array([0.3, -0.4])), 1, modes=["rev"])


# --- clips ---


def test_clips_leave_what_is_inside_alone(rng):
    inside = jnp.asarray(rng.random((3, 5, 6)))
    target = jnp.asarray(rng.random((3, 5, 6)))
    np.testing.assert_array_equal(
        temporal.clip_to_center(inside, unit_box(inside)), inside
    )
    np.testing.assert_array_equal(
        temporal.clip_towards(inside, target, unit_box(inside)), inside
    )


def test_clips_end_on_the_box_on_the_way_to_their_target(rng):
    outside = jnp.asarray(rng.uniform(-2, 3, (3, 20, 20)))
    outside = outside.at[0].set(jnp.where(outside[0] > 0.5, 1.5, -0.5))
    clipped = temporal.clip_to_center(outside, unit_box(outside))
    way, moved = outside - 0.5, clipped - 0.5
    np.testing.assert_allclose(np.abs(moved).max(axis=0), 0.5, atol=1e-6)
    np.testing.assert_allclose(np.cross(way, moved, axis=0), 0, atol=1e-12)

    target = jnp.asarray(rng.random((3, 20, 20)))
    clipped = temporal.clip_towards(outside, target, unit_box(outside))
    # The first point of the way that lies in the box, by many steps along it.
    along = np.linspace(0, 1, 20_001)[:, None, None, None]
    place = (
        np.asarray(outside)[:, 7, :5]
        + along[..., 0] * np.asarray(target - outside)[:, 7, :5]
    )
    first = np.argmax(((place >= 0) & (place <= 1)).all(axis=1), axis=0)
    expected = place[first, :, np.arange(5)].T
    np.testing.assert_allclose(clipped[:, 7, :5], expected, atol=2e-4)


@pytest.mark.parametrize("towards", [None, pixel(0.5, 0.2, 0.9)])
def test_clips_are_continuous_through_the_box(towards):
    line = np.linspace(0.9, 1.1, 2001)
    colors = jnp.stack([jnp.asarray(line), jnp.full(2001, 0.4), jnp.full(2001, 0.7)])
    colors = colors[:, None]
    clip = (
        temporal.clip_to_center(colors, unit_box(colors))
        if towards is None
        else temporal.clip_towards(
            colors, jnp.broadcast_to(towards, colors.shape), unit_box(colors)
        )
    )
    assert np.abs(np.diff(clip, axis=-1)).max() < 3e-4


def test_a_box_of_one_color_leaves_only_that():
    point = Box(pixel(0.2, 0.3, 0.4), pixel(0.2, 0.3, 0.4))
    far = pixel(0.9, 0.1, 0.4)
    center = temporal.clip_to_center(far, point)
    np.testing.assert_allclose(center, point.low, atol=2e-6)
    # The way to a target within reaches it; to one beside, too.
    for target in (point.low, pixel(0.2, 0.3, 0.5)):
        np.testing.assert_allclose(
            temporal.clip_towards(far, target, point), target, atol=1e-12
        )


@pytest.mark.parametrize("value", [0.5, 0.2, 1.0, 1.7])
def test_clips_have_finite_slopes_everywhere(value):
    box = Box(pixel(0.2, 0.2, 0.2), pixel(0.2, 1, 1))
    target = pixel(0.5, 0.2, 0.3)
    color = pixel(value, value, 0.3)
    for clip in (
        lambda color, low: temporal.clip_to_center(color, Box(low, box.high)),
        lambda color, low: temporal.clip_towards(color, target, Box(low, box.high)),
    ):
        slopes = jax.grad(lambda c, low, clip=clip: clip(c, low).sum(), (0, 1))(
            color, box.low
        )
        assert np.isfinite(slopes).all()


# --- feedback ---


def test_the_past_counts_less_where_it_differs():
    weight = temporal.feedback_weight
    luma = jnp.array([0.0, 0.1, 0.5, 1.0])
    np.testing.assert_array_equal(weight(luma, luma, 0.88, 0.97), 0.97)
    one, none = jnp.array(1.0), jnp.array(0.0)
    assert weight(one, none, 0.88, 0.97) == pytest.approx(0.88)
    # Differences in the dark are held against 0.2: u = 0.1 / 0.2.
    found = weight(none, jnp.array(0.1), 0.0, 1.0)
    assert found == pytest.approx(0.25)
    for past in (0.0, 0.2, 0.5):
        slope = jax.grad(weight, (0, 1))(jnp.array(0.2), jnp.array(past), 0.88, 0.97)
        assert np.isfinite(slope).all()


# --- where the past lies, and what it shows ---


def test_the_nearest_neighbor_says_how_an_edge_moves():
    depth, velocity = np.full((5, 6), 9.0), np.zeros((2, 5, 6))
    depth[2, 3], velocity[:, 2, 3] = 1.0, (0.5, -0.25)
    moved = dilated(depth, velocity)

    near = np.zeros((5, 6), bool)
    near[1:4, 2:5] = True
    np.testing.assert_array_equal(moved.dx, np.where(near, -0.5, 0))
    np.testing.assert_array_equal(moved.dy, np.where(near, 0.25, 0))


def test_among_equals_the_center_moves_then_the_first():
    velocity = np.stack([np.arange(30.0).reshape(5, 6), np.zeros((5, 6))])
    flat = dilated(np.full((5, 6), 2.0), velocity)
    np.testing.assert_array_equal(flat.dx, -velocity[0])
    two = np.full((5, 6), 2.0)
    two[1, 2] = two[1, 4] = 1.0
    assert dilated(two, velocity).dx[2, 3] == -velocity[0, 1, 2]
    # Nearer by less than a tie is not nearer.
    level = dilated(two, velocity, tie=1.5)
    np.testing.assert_array_equal(level.dx, -velocity[0])


@pytest.mark.parametrize("clamps", [False, True])
def test_the_past_is_replaced_where_it_is_lost(clamps, rng):
    shown = rng.random((3, 5, 6))
    shown[1, 2, 2] = np.nan
    velocity = np.zeros((2, 5, 6))
    velocity[0, :, 0] = 3.0  # came in from the left
    frame = frame_of(np.full((5, 6), 2.0), velocity)
    instead = jnp.asarray(rng.random((3, 5, 6)))
    found = temporal.past(
        History.of(jnp.asarray(shown)),
        frame.reprojection(STILL),
        instead,
        clamps=clamps,
    )
    expected = shown.copy()
    expected[:, 1:3, 1:3] = instead[:, 1:3, 1:3]  # those that have a tap on it
    expected[:, :, 0] = shown[:, :, 0] if clamps else instead[:, :, 0]
    np.testing.assert_array_equal(found, expected)
