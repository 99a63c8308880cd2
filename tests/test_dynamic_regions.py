"""Regions that move by themselves: by class, and as frames alone tell."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small

import hmdjit as hj
from hmdjit import techniques
from hmdjit.filters import dynamic_regions
from hmdjit.frames.frame import Frame
from hmdjit.frames.motion import Motion
from hmdjit.frames.sources import History
from hmdjit.technique_contract.stencil import found_stencil_px
from hmdjit.techniques import SSAA, HeadMovement, curve_file

WIDTH, HEIGHT, FRAMES = small.WIDTH, small.HEIGHT, 6
FROM_FRAMES = HeadMovement(dynamic="frames")
unexplained = small.quickly(dynamic_regions.unexplained)


def oracle(current, past):
    """The mask, pixel by pixel; pictures are `(3, h, w)`."""
    _, height, width = current.shape

    def block(row, column, reach):
        rows = np.clip(np.arange(row - reach, row + reach + 1), 0, height - 1)
        columns = np.clip(np.arange(column - reach, column + reach + 1), 0, width - 1)
        return np.ix_(rows, columns)

    def everywhere(value):
        return np.array([[value(y, x) for x in range(width)] for y in range(height)])

    def is_beyond(y, x):
        colors = [plane[block(y, x, 1)] for plane in current]
        return any(
            not colors[c].min() - 0.03 <= past[c, y, x] <= colors[c].max() + 0.03
            for c in range(3)
        )

    beyond = everywhere(is_beyond)
    found = everywhere(lambda y, x: beyond[block(y, x, 1)].sum() >= 4)
    return everywhere(lambda y, x: found[block(y, x, 2)].any())


def pictures(rng):
    """Two pictures that differ in a few places, by various amounts."""
    current = 0.5 + 0.02 * rng.normal(size=(3, HEIGHT, WIDTH))
    past = current + 0.02 * rng.normal(size=current.shape)
    past[:, 4:8, 5:9] += 0.08
    past[1, 12:, 15:] += 0.06 * rng.random((HEIGHT - 12, WIDTH - 15))
    past[:, 2, 15:20] += 0.3
    return current, past


def test_the_mask_is_that_of_loops_over_pixels(rng):
    current, past = pictures(rng)
    found = unexplained(*map(jnp.asarray, (current, past)))
    expected = oracle(current, past)
    assert 0.1 < expected.mean() < 0.6
    np.testing.assert_array_equal(found, expected)


def test_what_flickers_by_aliasing_is_explained(rng):
    current = jnp.zeros((3, HEIGHT, WIDTH)).at[:, :, 7].set(1.0)
    # A line one pixel wide that was elsewhere, or was not seen at all.
    for past in (jnp.roll(current, 1, axis=2), jnp.zeros_like(current)):
        assert not unexplained(current, past).any()
    thick = current.at[:, :, 7:11].set(1.0)
    assert unexplained(thick, jnp.roll(thick, 5, axis=2)).any()
    assert not unexplained(thick, thick).any()


def test_a_past_that_is_no_number_is_not_blended():
    current = jnp.full((3, HEIGHT, WIDTH), 0.5)
    past = current.at[1, 5:9, 5:9].set(jnp.nan)
    assert unexplained(current, past)[5:9, 5:9].all()


def test_reaches_are_as_they_say():
    found = found_stencil_px(FROM_FRAMES)
    assert found <= dynamic_regions.REACH_PX == FROM_FRAMES.stencil_radius_px
    assert FROM_FRAMES.history_radius_px == dynamic_regions.PAST_REACH_PX
    with_lanczos = HeadMovement(dynamic="frames", resolve=SSAA(2, filter="lanczos2"))
    radius_px = SSAA(2, filter="lanczos2").stencil_radius_px
    assert with_lanczos.stencil_radius_px == radius_px + dynamic_regions.REACH_PX


@pytest.mark.slow
def test_it_obeys_the_laws_of_techniques():
    techniques.check(FROM_FRAMES)


# --- a plate that flies over a still wall ---


def flight(rng):
    """Clip, and the classes of its pixels: the plate covers 6 x 6 px."""
    wall = 0.45 + 0.1 * rng.random((HEIGHT, WIDTH, 3))
    clip = np.repeat(wall[None], FRAMES, axis=0)
    classes = np.zeros((FRAMES, HEIGHT, WIDTH), int)
    for k in range(FRAMES):
        where = (k, slice(6, 12), slice(1 + 3 * k, 7 + 3 * k))
        clip[where] = [0.9, 0.1, 0.1]
        classes[where] = 1
    return clip, classes


def shown(technique, clip, **options):
    poses = np.tile([1.0, 0.0, 0.0, 0.0], (len(clip), 1))
    return np.asarray(hj.apply(technique, small.CAMERA, clip, poses, **options))


def test_classes_are_a_static_mask(rng):
    clip, classes = flight(rng)
    of_classes = HeadMovement(dynamic="classes")
    found = shown(of_classes, clip, motion_class=classes)
    by_hand = shown(HeadMovement(), clip, static_mask=classes == 0)
    np.testing.assert_array_equal(found, by_hand)
    np.testing.assert_array_equal(found[classes > 0], clip[classes > 0])
    deforming = shown(of_classes, clip, motion_class=2 * classes)
    np.testing.assert_array_equal(deforming, found)
    # Both masks count.
    neither = np.zeros_like(classes, bool)
    masked = shown(of_classes, clip, motion_class=classes, static_mask=neither)
    np.testing.assert_array_equal(masked, clip)
    message = "^head_movement_classes needs the frames' motion_class"
    with pytest.raises(ValueError, match=message):
        shown(of_classes, clip)


def test_frames_tell_what_a_plate_uncovers(rng):
    clip, _ = flight(rng)
    error = {}
    for dynamic in ("none", "frames"):
        found = shown(HeadMovement(dynamic=dynamic), clip)
        error[dynamic] = np.abs(found - clip)[-1]
    # Behind the plate's middle, which is where its trail would be.
    assert error["none"][6:12, 7:16].max() > 0.1
    assert error["frames"][6:12, 7:16].max() == 0.0
    # Where nothing moves all is blended as ever.
    np.testing.assert_array_equal(error["none"][16:], error["frames"][16:])


def test_gradients_are_finite(rng):
    clip, _ = flight(rng)
    current, past = (jnp.moveaxis(jnp.asarray(clip[k]), -1, 0) for k in (3, 2))
    still = jnp.zeros(3)

    @jax.jit
    @jax.grad
    def gradient(planes):
        current, past = planes
        camera, motion = small.CAMERA, Motion(still, still)
        frame = Frame(current[None], camera, hj.Region.whole(camera))
        _, displayed = FROM_FRAMES.step(History.of(past), frame, motion)
        return jnp.sum(displayed**2)

    for of_current, of_past in (gradient((current, past)), gradient((past, past))):
        assert jnp.isfinite(of_current).all()
        assert jnp.isfinite(of_past).all()


# --- choices ---


def test_choices_are_said_in_ids(tmp_path):
    for reprojects in ("rotation", "rigid"):
        for dynamic in ("none", "classes", "frames"):
            one = HeadMovement(reprojects=reprojects, dynamic=dynamic)
            assert techniques.by_id(one.id) == one
    curve_file.write(tmp_path / "mine.toml", HeadMovement(w_min=0.4))
    id = f"head_movement_rigid_frames:{tmp_path}/mine.toml+ssaa2"
    found = techniques.by_id(id)
    assert found.id == "head_movement_rigid_frames:mine+ssaa2"
    assert isinstance(found, HeadMovement)
    assert found.w_min == 0.4
    message = "^dynamic must be none in a file, got frames.$"
    with pytest.raises(ValueError, match=message):
        curve_file.write(tmp_path / "frames.toml", FROM_FRAMES)
    for unknown in ("", "none", "frames_rigid"):
        with pytest.raises(ValueError, match="technique must be"):
            techniques.by_id(f"head_movement_{unknown}")


@pytest.mark.parametrize("options", [{"reprojects": "all"}, {"dynamic": "all"}])
def test_unknown_choices_are_refused(options):
    message = f"^{next(iter(options))} must be one of .*, got 'all'"
    with pytest.raises(ValueError, match=message):
        HeadMovement(**options)


def test_on_pictures_only_what_frames_tell_moves():
    for dynamic in ("none", "classes"):
        assert HeadMovement(dynamic=dynamic).on_pictures() == HeadMovement()
    assert FROM_FRAMES.on_pictures() == FROM_FRAMES
    assert FROM_FRAMES.small_motion().approximation
    np.testing.assert_array_equal(
        FROM_FRAMES.history_gain(np.array([[0.0, 24.0, 25.0]])), [[1e5, 1e5, 0.0]]
    )
