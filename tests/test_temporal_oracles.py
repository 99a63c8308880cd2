import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import oracle_temporal as oracle
import pytest
import temporal_clips as clips
from small import quickly

import hmdjit as hj
from hmdjit.frames.motion import Motion
from hmdjit.frames.velocity import past_displacement
from hmdjit.simulation.rendered import Views
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
    (SobelTAA(off_screen="reject"), sobel(clamps=False)),
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


def frames_of(technique, clip):
    """The clip's frames as a technique sees them, and how the head moved."""
    planes = lambda channel: jnp.moveaxis(jnp.asarray(channel), -1, 1)[:, None]
    whole = lambda channel: jnp.asarray(channel, jnp.int32)[:, None, None]
    channels = {
        "depth": jnp.asarray(clip.depth)[:, None, None],
        "object_id": whole(clip.object_id),
        "motion_class": whole(clip.motion_class),
        "albedo": planes(clip.albedo),
        "velocity": planes(clip.velocity_px),
    }
    motion = Motion.of(jnp.asarray(clip.poses))
    known = clip.poses, clip.object_poses, clip.jitter_px
    steps = Views.of(technique, channels, jnp.dtype(float), *known).steps
    region, color = hj.Region.whole(CAMERA), planes(clip.color)
    for k in range(clips.FRAMES):
        row = lambda leaf, k=k: leaf[k]
        needed = {n: c[k] for n, c in channels.items() if n in technique.needs}
        jitter_px = jnp.asarray(clip.jitter_px[k])
        given = {"jitter_px": jitter_px, "steps": jax.tree.map(row, steps)}
        frame = hj.Frame(color[k], CAMERA, region, channels=needed, **given)
        yield frame, jax.tree.map(row, motion)


@pytest.mark.slow
@pytest.mark.parametrize("technique", [Amortized(subpixel=True, jitter=False)])
def test_without_jitter_cells_take_turns_however_velocity_is_known(technique):
    clip = clip_of("inside")
    flat, poses = np.full_like(clip.depth, 2.0), clip.poses[:, :4]
    motion = Motion.of(jnp.asarray(poses))

    @jax.vmap
    def velocity(increment):
        still = jnp.zeros(3)
        x, y = jnp.asarray(clips.X_PX, float), jnp.asarray(clips.Y_PX, float)
        past = past_displacement(CAMERA, x, y, jnp.asarray(flat[0]), increment, still)
        return -jnp.stack(past, axis=-1)

    given = np.asarray(velocity(motion.increment))
    shown = lambda **more: np.asarray(
        hj.apply(technique, CAMERA, clip.color, poses, depth=flat, **more)
    )
    np.testing.assert_allclose(shown(), shown(velocity_px=given), atol=1e-9)
    still = clip._replace(velocity_px=given, depth=flat)
    by_turns = oracle.amortized_subpixel(still, jitters=False)
    np.testing.assert_allclose(shown(), by_turns, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_where_samples_lie_is_taken_as_it_is_given():
    clip = clip_of("inside")
    still = dataclasses.replace(Inside(), jitter=False)
    np.testing.assert_array_equal(shown(still, clip), shown(Inside(), clip))


# --- the world that they are held on ---


def test_velocity_says_where_the_same_surface_was():
    clip = clip_of("inside")
    for k in range(1, clips.FRAMES):
        s = clip.jitter_px[k]
        ray = clips.rays(clips.X_PX + s[0], clips.Y_PX + s[1])
        for thing in (clips.PLANE, clips.CARD):
            poses = clip.poses[k - 1], clip.poses[k]
            now, before = clip.object_poses[k, thing], clip.object_poses[k - 1, thing]
            turn, shift = oracle.onto_the_next(poses[1], poses[0], now, before)
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


@slow
@pytest.mark.parametrize(
    ("depth_range", "depth_history"), [("paper", "same_pixel"), ("code", "reprojected")]
)
def test_sobel_shows_its_stages(depth_range, depth_history):
    technique = SobelTAA(depth_range=depth_range, depth_history=depth_history)
    clip = clip_of("sobel_taa")
    expected = oracle.sobel_taa(clip, depth_range, depth_history)
    step = lambda *now: (technique.intermediates(*now), technique.step(*now))
    both, state = quickly(step), None
    for k, (frame, motion) in enumerate(frames_of(technique, clip)):
        state = quickly(technique.init)(frame) if state is None else state
        found, (state, _) = both(state, frame, motion)
        for ours, theirs in (
            (found.sobel, expected.sobel),
            (found.temporal_sobel, expected.temporal_sobel),
            (found.model_average, expected.model_average),
            (found.depth_variation, expected.depth_variation),
            (found.past_depth_variation, expected.past_depth_variation),
            (found.aliased, expected.aliased),
        ):
            np.testing.assert_allclose(ours, theirs[k], rtol=1e-9, atol=1e-9)
