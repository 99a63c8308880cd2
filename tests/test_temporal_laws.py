"""What all temporal techniques obey, or what is known exactly of some."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import oracle_temporal as oracle
import pytest
import temporal_clips as clips
from small import quickly
from test_temporal_oracles import CAMERA, clip_of, frames_of, name_of, shown

import hmdjit as hj
from hmdjit.techniques import (
    TIDOAA,
    Amortized,
    Inside,
    Karis,
    SobelTAA,
    ThesisBaseline,
    TwoFrame,
    Uncharted4,
)

UNJITTERING = [Inside(), ThesisBaseline(), SobelTAA()]
ALL = [Amortized(), TwoFrame(), Uncharted4(), Karis(), TIDOAA(), *UNJITTERING]
named = lambda technique: technique.id


def of(quick, slow):
    marked = [pytest.param(each, marks=pytest.mark.slow) for each in slow]
    return pytest.mark.parametrize("technique", [*quick, *marked], ids=named)


INSIDE = Inside(ycocg=True, motion_blur=True)
MANY = [Uncharted4(), ThesisBaseline(), INSIDE]
of_all = of(ALL, [])
SUBPIXEL = Amortized(subpixel=True)
PAPERS = [TIDOAA(), TIDOAA(subcell=True)]
of_readers = of(
    [Karis()], [TwoFrame(), Amortized(), SUBPIXEL, *MANY, SobelTAA(), *PAPERS]
)
of_some = of([TwoFrame()], [Karis(), Amortized(), *MANY, SobelTAA(), TIDOAA()])


def pattern(technique):
    return oracle.JITTER_PX[name_of(technique)]


def all_static(clip):
    return clip._replace(motion_class=0 * clip.motion_class)


# --- pictures that are known ---


@of_all
def test_a_constant_scene_stays_constant(technique):
    clip = clip_of(name_of(technique))
    grey = np.full_like(clip.color, 0.25)
    ours = shown(technique, clip._replace(color=grey, albedo=grey))
    np.testing.assert_allclose(ours, grey, rtol=0, atol=1e-12)


@of_all
def test_what_does_not_jitter_at_rest_does_not_change(technique):
    clip = clips.solid_clip(np.zeros((1, 2)), is_moving=False)
    ours = shown(technique, clip)
    np.testing.assert_allclose(ours, np.broadcast_to(ours[:1], ours.shape), atol=1e-12)


def inner(pictures, margin_px):
    return pictures[..., margin_px:-margin_px, margin_px:-margin_px, :]


@pytest.mark.parametrize("technique", UNJITTERING, ids=named)
def test_a_ramp_is_unjittered_exactly(technique):
    still = shown(technique, clips.ramp_clip(pattern(technique)))
    truth = clips.ramp(clips.X_PX, clips.Y_PX)
    wide = np.broadcast_to(inner(truth, 3), inner(still, 3).shape)
    np.testing.assert_allclose(inner(still, 3), wide, atol=1e-12)

    moving = shown(technique, clips.ramp_clip(pattern(technique), (0.7, -0.4)))
    for k in range(6):
        truth = clips.ramp(clips.X_PX - 0.7 * k, clips.Y_PX + 0.4 * k)
        ours = inner(moving[k], 4 + k)
        np.testing.assert_allclose(ours, inner(truth, 4 + k), atol=1e-12)


@pytest.mark.parametrize(
    ("technique", "first", "off_px"),
    [(TwoFrame(), 1, 0), (TIDOAA(), 3, 0), (Karis(), 0, 0.04)],
    ids=lambda value: getattr(value, "id", None),
)
def test_a_ramp_that_is_not_unjittered_is_nearly_so(technique, first, off_px):
    ours = shown(technique, clips.ramp_clip(pattern(technique)))
    truth = clips.ramp(clips.X_PX, clips.Y_PX)
    steepest = 0.03  # per px, of all colours
    off = np.abs(inner(ours[first:] - truth, 3)).max()
    assert off <= off_px * steepest + 1e-12


@pytest.mark.parametrize(
    "depth_range", ["paper", pytest.param("code", marks=pytest.mark.slow)]
)
def test_sobel_shows_the_current_frame_where_nothing_is_aliased(depth_range):
    rng = np.random.default_rng(1)
    colors = rng.uniform(size=(clips.FRAMES, 3))
    technique = SobelTAA(depth_range=depth_range)
    one = np.ones((clips.HEIGHT_PX, clips.WIDTH_PX, 3))
    clip = clips.flat_clip(lambda k, x, y: colors[k] * one, pattern(technique))
    # A box of no size still has its epsilon on each side.
    np.testing.assert_allclose(shown(technique, clip), clip.color, atol=2e-6)


def test_tidoaa_at_rest_is_four_samples_of_each_pixel():
    still = all_static(clips.solid_clip(oracle.RGSS, is_moving=False))
    ours = shown(TIDOAA(), still)
    mean = still.color[:4].mean(axis=0)
    wide = np.broadcast_to(mean, ours[3:].shape)
    np.testing.assert_allclose(ours[3:], wide, atol=1e-12)
    assert np.abs(ours[2] - mean).max() > 0.05


def test_amortized_at_rest_is_the_mean_of_its_renders():
    technique = Amortized(min_weight=0.0)
    still = clips.solid_clip(pattern(technique), is_moving=False)
    # Where a sample's surface is another one than the last, history is refused.
    flat = still._replace(depth=np.full_like(still.depth, 5.0))
    number = np.arange(1, clips.FRAMES + 1)[:, None, None, None]
    mean = np.cumsum(flat.color, axis=0) / number
    np.testing.assert_allclose(shown(technique, flat), mean, atol=1e-12)


@pytest.mark.slow
def test_sub_pixels_at_rest_are_four_samples_of_each_pixel():
    still = clips.solid_clip(oracle.RGSS, is_moving=False)
    flat = still._replace(depth=np.full_like(still.depth, 5.0))
    ours, mean = shown(Amortized(subpixel=True), flat), flat.color[:4].mean(axis=0)
    np.testing.assert_allclose(ours[3], mean, atol=1e-12)


# --- states ---


@functools.cache
def stepping(technique):
    return quickly(technique.step)


@of_readers
def test_a_run_is_its_steps_and_a_lost_pixel_of_the_past_is_not_seen(technique):
    clip = clip_of(name_of(technique))
    frames = list(frames_of(technique, clip))
    state = quickly(technique.init)(frames[0][0])
    alone, before = [], state
    for frame, motion in frames:
        before = jax.tree.map(np.asarray, state)
        state, picture = stepping(technique)(before, frame, motion)
        alone.append(jnp.moveaxis(picture, 0, -1))
    np.testing.assert_allclose(shown(technique, clip), np.stack(alone), atol=1e-12)

    lost = jax.tree.map(lambda leaf: _without_a_pixel(leaf), before)
    after, picture = stepping(technique)(lost, *frames[-1])
    assert np.isfinite(picture).all()
    # Depth that is kept is infinite where nothing is seen.
    assert not any(np.isnan(leaf).any() for leaf in jax.tree.leaves(after))


def _without_a_pixel(leaf):
    is_plane = leaf.ndim >= 2 and leaf.shape[-1] > 1 and leaf.dtype.kind == "f"
    if not is_plane:
        return leaf
    lost = leaf.copy()
    lost[..., 9, 12] = np.nan
    return lost


# --- derivatives, and programs ---


def slopes_of(technique):
    """Derivatives of what a step displays and keeps, in all that is no whole number."""

    def loss(floats, others):
        state, frame, motion = eqx.combine(floats, others)
        found = jax.tree.leaves(technique.step(state, frame, motion))
        return sum(jnp.mean(x**2) for x in found if jnp.issubdtype(x.dtype, float))

    @quickly
    def slopes(*given):
        return jax.grad(loss)(*eqx.partition(given, eqx.is_inexact_array))

    return slopes


@of_some
def test_slopes_are_finite_at_rest_too(technique):
    name, slopes = name_of(technique), slopes_of(technique)
    moving, still = (clip_of(name, is_moving) for is_moving in (True, False))
    # What does not move, and one colour everywhere, are the corners of most formulas.
    grey = np.full_like(still.color, 0.5)
    flat = still._replace(color=grey, albedo=grey, depth=np.full_like(grey[..., 0], 5))
    for clip in (moving, still, flat):
        (first, _), second, *_ = frames_of(technique, clip)
        found = slopes(quickly(technique.init)(first), *second)
        for path, slope in jax.tree_util.tree_leaves_with_path(found):
            assert np.isfinite(slope).all(), jax.tree_util.keystr(path)
        assert np.abs(found[1].color).max() > 0


@of_some
def test_techniques_batch(technique):
    clip = clip_of(name_of(technique))
    given = clip.channels()
    run = lambda color: hj.apply(technique, CAMERA, color, clip.poses, **given)
    color = jnp.asarray(clip.color)
    both = quickly(jax.vmap(run))(jnp.stack([1 - color, color]))
    np.testing.assert_allclose(both[1], run(color), atol=1e-12)
