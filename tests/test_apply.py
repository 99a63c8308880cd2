import re

import jax.numpy as jnp
import numpy as np
import pytest
from small import CAMERA, FRAMES, SIZE, STILL, path

import hmdjit as hj
from hmdjit.simulation import apply as clips
from hmdjit.techniques import SSAA, Freeze, HeadMovement, NoAntialiasing, by_id


@pytest.mark.parametrize(
    ("shape", "poses", "technique", "message"),
    [
        (
            (8, 9, 9, 3),
            STILL,
            "none",
            r"^frames must have the camera's size \(18, 24, 3\)",
        ),
        (
            (8, 18, 24, 4),
            STILL,
            "none",
            r"^frames must .*, got shape \(8, 18, 24, 4\).$",
        ),
        ((18, 24, 3), STILL, "none", r"^frames must .*, got shape \(18, 24, 3\).$"),
        (
            (7, 18, 24, 3),
            STILL,
            "none",
            r"^poses must have one row per frame \(7\), got 8",
        ),
        (
            (8, 18, 24, 3),
            STILL,
            "ssaa2",
            r"^frames must have 4 samples per pixel for ssaa2",
        ),
        ((8, 2, 18, 24, 3), STILL, "none", r"^frames must have 1 samples .* got 2.$"),
        (
            (8, 18, 24, 3),
            3 * STILL,
            "none",
            r"^poses\[0\] must have a length in .* got 3.$",
        ),
        ((0, 18, 24, 3), STILL[:0], "none", r"^poses must have at least 1 row, got 0"),
        (
            (8, 18, 24, 3),
            STILL[:, 1:],
            "none",
            r"^poses must have the shape \(frames, 4\)",
        ),
    ],
)
def test_frames_that_do_not_fit_are_refused(untyped, shape, poses, technique, message):
    technique = hj.techniques.by_id(technique)
    with pytest.raises(ValueError, match=message) as error:
        hj.apply(technique, CAMERA, np.zeros(shape), poses)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        (np.full((FRAMES, *SIZE), 2.0), r"float64 from 2 to 2"),
        (255 * np.eye(3)[[[[0] * 24] * 18] * 8], r"float64 from 0 to 255"),
        (np.full((FRAMES, *SIZE), -0.5, np.float16), r"float16 from -0.5 to -0.5"),
        (
            np.array([np.nan, 255.0] * 9)[:, None, None, None],
            r"float64 from 255 to 255",
        ),
        (np.zeros((FRAMES, *SIZE), np.int32), r"int32"),
    ],
    ids=["2", "0..255", "-1..1", "NaN and 255", "int32"],
)
def test_frames_of_another_range_or_dtype_are_refused(untyped, frames, message):
    message = rf"^frames must .*in \[0, 1\], got {message}"
    with pytest.raises(ValueError, match=message):
        hj.apply(NoAntialiasing(), CAMERA, frames, STILL)


def _shown(frames, rng):
    return hj.apply(HeadMovement(), CAMERA, frames, path(rng))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_codes_are_taken_by_their_largest(rng, dtype):
    codes = rng.integers(0, 256, (FRAMES, *SIZE)).astype(dtype)
    ours, theirs = (
        _shown(f, np.random.default_rng(3))
        for f in (codes, codes / float(np.iinfo(dtype).max))
    )
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12)


@pytest.mark.parametrize("dtype", [jnp.float16, jnp.bfloat16])
def test_short_floats_have_a_history_in_single_precision(rng, dtype):
    frames = jnp.asarray(rng.random((FRAMES, *SIZE)), dtype)
    ours, theirs = (
        _shown(f, np.random.default_rng(3))
        for f in (frames, frames.astype(jnp.float32))
    )
    assert ours.dtype == jnp.float32
    np.testing.assert_array_equal(ours, theirs)


def test_a_stream_without_poses_knows_what_needs_them(rng):
    frames = rng.random((FRAMES, *SIZE)).astype(np.float32)
    shown = list(clips.stream(Freeze(), CAMERA, iter(frames), None))
    np.testing.assert_array_equal(np.stack(shown), np.stack([frames[0]] * FRAMES))
    with pytest.raises(ValueError, match=r"^head_movement needs poses, got none\.$"):
        next(clips.stream(HeadMovement(), CAMERA, iter(frames), None))


def test_a_mask_that_is_not_read_is_refused():
    frames, mask = np.zeros((FRAMES, *SIZE)), np.ones((FRAMES, *SIZE[:2]), bool)
    for technique in (Freeze(), by_id("freeze+sharpen"), by_id("inside")):
        message = f"^{re.escape(technique.id)} reads no static_mask: leave it out.$"
        with pytest.raises(ValueError, match=message):
            hj.apply(technique, CAMERA, frames, STILL, static_mask=mask)
    sharpened = by_id("head_movement+sharpen")
    assert sharpened.reads_static_mask


@pytest.mark.parametrize("shape", [(18, 24), (7, 18, 24), (8, 24, 18), (8, 18, 24, 1)])
def test_a_mask_that_does_not_fit_is_refused(untyped, shape):
    frames = np.zeros((FRAMES, *SIZE))
    mask = np.ones(shape, bool)
    message = r"^static_mask must have the shape \(8, 18, 24\), got \("
    with pytest.raises(ValueError, match=message):
        hj.apply(HeadMovement(), CAMERA, frames, STILL, static_mask=mask)


@pytest.mark.parametrize("technique", [HeadMovement(), Freeze()], ids=lambda t: t.id)
def test_a_stream_shows_what_a_clip_shows(rng, technique):
    frames = rng.random((FRAMES, *SIZE)).astype(np.float32)
    poses = path(rng)
    expected = hj.apply(technique, CAMERA, jnp.asarray(frames), poses)
    ours = list(clips.stream(technique, CAMERA, iter(frames), poses))
    assert len(ours) == FRAMES
    # One program and another may fuse differently: an ulp per step, which fades.
    np.testing.assert_allclose(np.stack(ours), expected, rtol=0, atol=3e-7)


def test_a_stream_takes_codes_and_refuses_other_scales(untyped, rng):
    codes = rng.integers(0, 256, (FRAMES, *SIZE), dtype=np.uint8)
    (first,) = list(clips.stream(Freeze(), CAMERA, iter(codes[:1]), None))
    np.testing.assert_allclose(255 * first, codes[0], atol=1e-4)
    with pytest.raises(ValueError, match=r"^frames must lie in \[0, 1\], got float64"):
        next(clips.stream(Freeze(), CAMERA, iter(codes.astype(float)), None))


def test_a_stream_of_one_sample_per_pixel_cannot_be_resolved(rng):
    message = "^frames must have 4 samples per pixel for ssaa2, got 1.$"
    with pytest.raises(ValueError, match=message):
        next(clips.stream(SSAA(2), CAMERA, iter([]), STILL))
