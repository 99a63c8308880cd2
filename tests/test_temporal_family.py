"""The techniques that keep a past: names, choices, and that each runs on all scenes."""

import functools
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small

import hmdjit as hj
from hmdjit.techniques import (
    Amortized,
    Inside,
    Karis,
    ThesisBaseline,
    TwoFrame,
    Uncharted4,
    by_id,
)

CAMERA = hj.Camera(32, 32, 48.0, 60.0)
ALL = [
    *(Amortized(), Amortized(subpixel=True), TwoFrame(), Inside(motion_blur=True)),
    *(Inside(ycocg=True), ThesisBaseline(), Uncharted4(), Karis()),
]
SAID = {
    "amortized_subpixel_no_jitter": Amortized(subpixel=True, jitter=False),
    "two_frame_no_jitter": TwoFrame(jitter=False),
    "inside": Inside(),
    "inside_ycocg_motion_blur_reject": Inside(
        ycocg=True, motion_blur=True, off_screen="reject"
    ),
    "thesis_baseline_reject_no_jitter": ThesisBaseline(
        off_screen="reject", jitter=False
    ),
    "uncharted4_no_jitter": Uncharted4(jitter=False),
    "karis_no_jitter": Karis(jitter=False),
}


@pytest.mark.parametrize("id", SAID)
def test_ids_say_what_is_no_default(id):
    assert SAID[id].id == id
    assert by_id(id) == SAID[id]


def test_all_choices_have_ids():
    choices = product((False, True), (False, True), ("clamp", "reject"), (False, True))
    every = [
        Inside(ycocg=y, motion_blur=m, off_screen=o, jitter=j) for y, m, o, j in choices
    ]
    assert len({technique.id for technique in every}) == 16
    assert [by_id(technique.id) for technique in every] == every


@pytest.mark.parametrize(
    ("kind", "wrong", "said"),
    [
        (Inside, {"ycocg": "no"}, "ycocg must be True or False, got 'no'"),
        (Karis, {"jitter": None}, "jitter must be True or False, got None"),
        (ThesisBaseline, {"off_screen": "crop"}, "off_screen must be one of clamp, re"),
        (Amortized, {"blur_limit_px2": 0}, r"blur_limit_px2 must lie in \(0"),
        (Amortized, {"min_weight": 1.1}, r"min_weight must lie in \[0, 1\], got 1.1"),
    ],
)
def test_wrong_choices_are_refused(untyped, kind, wrong, said):
    with pytest.raises(ValueError, match=said):
        kind(**wrong)


def runs(techniques, quick):
    """All, most of them in the slow tests: each is a program of its own."""
    mark = lambda each: [] if each in quick else [pytest.mark.slow]
    return [pytest.param(each, id=each.id, marks=mark(each)) for each in techniques]


@pytest.mark.parametrize("technique", runs(ALL, [Karis()]))
def test_all_run_on_pictures(rng, technique):
    texture, poses = small.texture(rng), small.path(rng, 4)
    found = hj.simulate(texture, small.CAMERA, technique, poses)
    assert found.mtcd > 0
    assert jnp.isfinite(found.detail_loss)


@functools.cache
def sphere():
    return hj.scenes.moving_sphere()


@pytest.mark.parametrize("technique", runs(ALL, []))
def test_all_run_on_solids(rng, technique):
    poses = hj.HeadMotion.fixating().sample(jax.random.key(0), 60.0, 4)
    found = hj.simulate(sphere(), CAMERA, technique, poses)
    assert found.mtcd > 0
    assert jnp.isfinite(found.detail_loss)


def test_an_average_without_a_limit_is_the_mean_of_all_frames(rng):
    frames = rng.random((5, small.HEIGHT, small.WIDTH, 3))
    depth = np.ones(frames.shape[:3])
    technique = Amortized(min_weight=0.0)
    shown = hj.apply(technique, small.CAMERA, frames, small.STILL[:5], depth=depth)
    mean = np.cumsum(frames, axis=0) / np.arange(1, 6)[:, None, None, None]
    np.testing.assert_allclose(shown, mean, atol=1e-14)


def test_speed_blurs_what_is_shown_and_not_what_is_kept(rng):
    frames = rng.random((3, small.HEIGHT, small.WIDTH, 3))
    depth, velocity = np.ones(frames.shape[:3]), np.zeros((*frames.shape[:3], 2))
    velocity[1, ..., 0] = 20.0  # px, above all trust

    def shown(technique):
        given = {"depth": depth, "velocity_px": velocity}
        return np.asarray(
            hj.apply(technique, small.CAMERA, frames, small.STILL[:3], **given)
        )

    sharp, blurred = shown(Inside()), shown(Inside(motion_blur=True))
    np.testing.assert_array_equal(blurred[[0, 2]], sharp[[0, 2]])
    assert blurred[1].var() < 0.5 * sharp[1].var()

    # A smear is cut to 64 px: half of it is as far as a stencil says.
    far = np.zeros((3, 1, 256, 3))
    far[:, :, 200] = 1
    camera = hj.Camera(256, 1, 40.0, 60.0)
    wide = {
        "depth": np.ones((3, 1, 256)),
        "velocity_px": np.broadcast_to([200.0, 0], (3, 1, 256, 2)),
    }
    technique = Inside(motion_blur=True, jitter=False)
    found = np.asarray(hj.apply(technique, camera, far, small.STILL[:3], **wide))[1]
    (lit,) = np.nonzero(found[0, :, 0] > 1e-6)
    assert np.abs(lit - 200).max() <= technique.stencil_radius_px
