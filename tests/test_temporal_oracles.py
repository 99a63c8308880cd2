import functools

import numpy as np
import oracle_temporal as oracle
import pytest
import temporal_clips as clips

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

CAMERA = hj.Camera(clips.WIDTH_PX, clips.HEIGHT_PX, clips.FOV_DEG, 60.0)


def sobel(*choices, **others):
    return lambda clip: oracle.sobel_taa(clip, *choices, **others).displayed


of = functools.partial

YCOCG_REJECT = {"ycocg": True, "clamps": False}
DEFAULTS = [
    (Amortized(), oracle.amortized),
    (TwoFrame(), oracle.two_frame),
    (Inside(), oracle.inside),
    (ThesisBaseline(), oracle.thesis_baseline),
    (Uncharted4(), oracle.uncharted4),
    (Karis(), oracle.karis),
    (SobelTAA(), sobel()),
    (TIDOAA(), oracle.tidoaa),
]
OTHERS = [
    (Amortized(subpixel=True), oracle.amortized_subpixel),
    (Inside(ycocg=True, off_screen="reject"), of(oracle.inside, **YCOCG_REJECT)),
    (Inside(motion_blur=True), of(oracle.inside, motion_blur=True)),
    (ThesisBaseline(off_screen="reject"), of(oracle.thesis_baseline, clamps=False)),
    (SobelTAA(depth_range="code"), sobel("code")),
    (SobelTAA(depth_history="reprojected"), sobel("paper", "reprojected")),
    (
        SobelTAA(depth_range="code", depth_history="reprojected"),
        sobel("code", "reprojected"),
    ),
    (TIDOAA(subcell=True), of(oracle.tidoaa, subcell=True)),
]
slow = pytest.mark.slow
CASES = [pytest.param(*case, id=case[0].id) for case in DEFAULTS]
CASES += [pytest.param(*case, id=case[0].id, marks=slow) for case in OTHERS]
of_all = pytest.mark.parametrize(("technique", "expected"), CASES)


@functools.cache
def clip_of(name, is_moving=True):
    """Clip that is sampled as a technique of that name asks for."""
    return clips.solid_clip(oracle.JITTER_PX[name], is_moving)


def name_of(technique):
    return next(name for name in oracle.JITTER_PX if technique.id.startswith(name))


def shown(technique, clip, dtype: type = float):
    """What `apply` displays; counts and classes stay whole numbers."""
    color, *others = (np.asarray(each, dtype) for each in (clip.color, clip.depth))
    velocity, albedo = clip.velocity_px.astype(dtype), clip.albedo.astype(dtype)
    given = clip.channels() | {"depth": others[0], "velocity_px": velocity}
    given |= {"albedo": albedo}
    return np.asarray(hj.apply(technique, CAMERA, color, clip.poses, **given))


# --- the world that they are held on ---


def test_velocity_says_where_the_same_surface_was():
    clip = clip_of("inside")
    for k in range(1, clips.FRAMES):
        s = clip.jitter_px[k]
        ray = clips.rays(clips.X_PX + s[0], clips.Y_PX + s[1])
        for thing in (clips.PLANE, clips.CARD):
            poses = clip.poses[k - 1], clip.poses[k]
            things = clip.object_poses[k, thing], clip.object_poses[k - 1, thing]
            turn, shift = oracle.onto_the_next(*poses[::-1], *things)
            is_seen = clip.object_id[k] == thing
            point = clip.depth[k][is_seen][:, None] * ray[is_seen]
            before = clips.projected(point @ turn.T + shift)
            now = clips.projected(ray[is_seen])
            np.testing.assert_allclose(
                now - before, clip.velocity_px[k][is_seen], atol=1e-9
            )


# --- techniques ---


@of_all
def test_techniques_agree_with_their_oracles(technique, expected):
    clip = clip_of(name_of(technique))
    ours, theirs = shown(technique, clip), expected(clip)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)
    assert np.abs(theirs - clip.color).mean() > 0.003  # else little would be shown


@slow
@pytest.mark.parametrize(("technique", "expected"), DEFAULTS)
def test_single_precision_is_as_good(technique, expected):
    clip = clip_of(name_of(technique))
    ours = shown(technique, clip, np.float32)
    assert ours.dtype == np.float32
    # A dozen roundings of 6e-8, ninefold after sharpening; two frames' square root of
    # a difference of speeds has another ten.
    np.testing.assert_allclose(ours, expected(clip), rtol=0, atol=1e-5)


@pytest.mark.parametrize("technique", [case[0] for case in DEFAULTS])
def test_cameras_jitter_as_published(technique):
    ours, theirs = technique.sample_offsets_px, oracle.JITTER_PX[name_of(technique)]
    np.testing.assert_allclose(ours, theirs[:, None], atol=1e-12)
    still = type(technique)(jitter=False)
    assert still.id == technique.id + "_no_jitter"
    assert not still.sample_offsets_px.any()


def test_sobel_shows_its_stages():
    pytest.skip("to be written against the technique's own names")
