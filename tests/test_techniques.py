import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
from small import FRAMES, HEIGHT, SIZE, STILL, WIDTH, quickly

import hmdjit as hj
from hmdjit import curves, techniques
from hmdjit.frames.displacement import Reading
from hmdjit.frames.sources import History
from hmdjit.techniques import MSAA, SSAA, Freeze, HeadMovement, NoAntialiasing

HZ = 60.0
# 21 px per rad: what a head turns by in a frame moves the picture by parts of a pixel.
CAMERA = hj.Camera(width_px=WIDTH, height_px=HEIGHT, fov_deg=60.0, refresh_hz=HZ)


def yaw_increments(speed_deg_s, frames):
    """Of a head that turns left at a steady speed; the first is frame 1's."""
    return np.tile([0.0, np.radians(speed_deg_s) / HZ, 0.0], (frames - 1, 1))


def turning(speed_deg_s, frames=2):
    return oracles.poses_after(yaw_increments(speed_deg_s, frames))


def clip(rng, frames, dtype: Any = float, size=SIZE):
    return rng.random((frames, *size)).astype(dtype)


def applied(technique, frames, poses, camera=CAMERA, static_mask: Any = True):
    """What is displayed. Clips are made 8 frames long, so that few are compiled for.

    What is displayed does not depend on what comes later: a law below.
    """

    def padded(clip):
        clip = np.asarray(clip)
        more = max(0, FRAMES - len(clip))
        return jnp.asarray(np.concatenate([clip, np.repeat(clip[-1:], more, axis=0)]))

    mask = static_mask
    if not technique.reads_static_mask:
        mask = None
    elif static_mask is not None:
        mask = padded(np.broadcast_to(static_mask, (len(frames), *frames.shape[-3:-1])))
    shown = hj.apply(technique, camera, padded(frames), padded(poses), static_mask=mask)
    return np.asarray(shown)[: len(frames)]


def frame_of(samples, camera=CAMERA):
    """A block of the camera frame, by its samples `(samples, 3, h, w)`."""
    height, width = samples.shape[2:]
    return hj.Frame(jnp.asarray(samples), camera, hj.Region(0, 0, width, height))


# --- laws of every technique ---

TECHNIQUES = {
    "none": NoAntialiasing(),
    "freeze": Freeze(),
    "msaa4": MSAA(4),
    "ssaa2": SSAA(2),
    "head_movement": HeadMovement(),
    "several samples": HeadMovement(closeness=(0.2, 0.9, 0.4)),
    "linear": HeadMovement(space="linear"),
    "same_pixel": HeadMovement(difference="same_pixel"),
    "head_movement+ssaa2": HeadMovement(resolve=SSAA(2)),
}
SLOWLY = turning(6.0, FRAMES)  # less than a pixel in all; much of the past is kept


def sampled(technique, frames):
    """As frames to resolve: each sample of a pixel has its colour."""
    return np.repeat(frames[:, None], technique.sample_offsets_px.shape[1], axis=1)


def displayed(technique, frames, poses=SLOWLY, static: Any = True):
    return applied(technique, sampled(technique, frames), poses, static_mask=static)


def check_same_colors(technique, ours, expected):
    resolve = getattr(technique, "resolve", None)
    spaces = [getattr(part, "space", "gamma") for part in (technique, resolve)]
    atol = 1e-14 if "linear" in spaces else 0  # decoded, and encoded again
    np.testing.assert_allclose(ours, expected, rtol=0, atol=atol)


def frame_0_is_displayed(technique, rng):
    frames = clip(rng, FRAMES)
    check_same_colors(technique, displayed(technique, frames)[0], frames[0])


def a_still_head_sees_a_still_picture(technique, rng):
    frames = np.repeat(clip(rng, 1), FRAMES, axis=0)
    check_same_colors(technique, displayed(technique, frames, STILL), frames)


def one_color_stays_one_color(technique, rng):
    frames = np.broadcast_to(rng.random(3), (FRAMES, *SIZE))
    ours = displayed(technique, frames)
    np.testing.assert_allclose(ours, frames, rtol=0, atol=1e-14)


def what_comes_later_does_not_matter(technique, rng):
    frames, later = clip(rng, FRAMES), clip(rng, FRAMES)
    later[:5] = frames[:5]
    poses = np.concatenate([SLOWLY[:5], turning(20.0, FRAMES)[5:]])
    ours, expected = displayed(technique, later, poses), displayed(technique, frames)
    np.testing.assert_array_equal(ours[:5], expected[:5])


def a_run_split_in_two_is_the_run(technique, rng):
    frames, motion = clip(rng, FRAMES), hj.Motion.of(jnp.asarray(SLOWLY))
    planes = np.moveaxis(sampled(technique, frames), -1, 2)
    step = quickly(technique.step)
    state, shown = technique.init(frame_of(planes[0])), []
    for k in range(FRAMES):
        if k == FRAMES // 2:  # the state is all that the second part has of the first
            state = jax.tree.map(lambda leaf: jnp.asarray(np.array(leaf)), state)
        now = jax.tree.map(lambda leaf, k=k: leaf[k], motion)
        state, picture = step(state, frame_of(planes[k]), now)
        shown.append(np.moveaxis(np.asarray(picture), 0, -1))
    expected = displayed(technique, frames)
    # Two programs may fuse differently: an ulp per step, which fades.
    np.testing.assert_allclose(shown, expected, rtol=0, atol=1e-13)


def a_bad_pixel_stays_near_and_is_gone_where_all_moves(technique, rng):
    frames = clip(rng, FRAMES)
    bad = frames.copy()
    bad[2, 6, 9] = np.nan
    rows, columns = np.mgrid[:HEIGHT, :WIDTH] - np.array([6, 9])[:, None, None]
    is_bad = np.asarray(np.any(~np.isfinite(displayed(technique, bad)), axis=-1))
    for k in range(FRAMES):  # a read has neighbours on one side
        is_near = np.maximum(np.abs(rows), np.abs(columns)) <= k - 2
        assert not (is_bad[k] & ~is_near).any()
    static = np.ones(frames.shape[:3], bool)
    static[5:] = False
    ours, expected = (displayed(technique, f, static=static) for f in (bad, frames))
    np.testing.assert_array_equal(ours[5:], expected[5:])


def floats_follow_the_frames(technique, rng):
    frames = jnp.asarray(sampled(technique, clip(rng, 2)), jnp.float32)
    run = lambda frames: hj.apply(technique, CAMERA, frames, SLOWLY[:2])
    assert jax.eval_shape(run, frames).dtype == jnp.float32


LAWS = [
    frame_0_is_displayed,
    a_still_head_sees_a_still_picture,
    one_color_stays_one_color,
    what_comes_later_does_not_matter,
    a_run_split_in_two_is_the_run,
    a_bad_pixel_stays_near_and_is_gone_where_all_moves,
    floats_follow_the_frames,
]


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
@pytest.mark.parametrize("technique", TECHNIQUES.values(), ids=TECHNIQUES)
def test_every_technique_keeps(technique, law, rng):
    law(technique, rng)


# --- Kim's step against the equations ---

# Static choices are compiled, numbers are drawn: size, past samples, whether they have
# weights, space, difference, whether there is a mask. Three are compiled above.
FORMS = {
    "paper": ((128, 96), 1, False, "gamma", "euclidean", False),
    "several": ((WIDTH, HEIGHT), 3, False, "gamma", "euclidean", True),
    "max-channel": ((24, 31), 2, True, "gamma", "max_channel", False),
    "linear": ((WIDTH, HEIGHT), 1, False, "linear", "euclidean", True),
    "same-pixel": ((WIDTH, HEIGHT), 1, False, "gamma", "same_pixel", True),
}


@dataclasses.dataclass
class Drawn:
    """One random case: what the technique is told, and the oracle alike."""

    frames: np.ndarray
    poses: np.ndarray
    camera: hj.Camera
    technique: HeadMovement
    static: np.ndarray | None
    options: dict

    @classmethod
    def of(cls, rng, form, count, dtype: type = float):
        (width, height), samples, is_weighted, space, difference, has_mask = form
        # Up to 6 degrees per frame, where pixels leave the frame; speeds around h_max.
        lengths = 10 ** rng.uniform(-3.5, -1, (count - 1, 1))
        directions = rng.normal(size=(count - 1, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        w_lb, w_min = np.sort(rng.uniform(0, 1, 2))
        options = {
            "w_min": w_min,
            "w_lb": w_lb,
            "h_max_deg_s": 10 ** rng.uniform(1.5, 3.5),
            "closeness": tuple(rng.uniform(0.05, 1, samples)),
            "weights": tuple(rng.uniform(0.1, 2, samples)) if is_weighted else None,
            "difference": difference,
        }
        static = rng.random((count, height, width)) < 0.8 if has_mask else None
        camera = hj.Camera(
            width_px=width,
            height_px=height,
            fov_deg=rng.uniform(5, 130),
            refresh_hz=rng.uniform(30, 200),
        )
        return cls(
            frames=clip(rng, count, dtype, (height, width, 3)),
            poses=oracles.poses_after(lengths * directions),
            camera=camera,
            technique=HeadMovement(space=space, **options),
            static=static,
            options={
                "space": space,
                "static": static,
                "fov_deg": camera.fov_deg,
                "refresh_hz": camera.refresh_hz,
                **options,
            },
        )

    def ours(self):
        frames = sampled(self.technique, self.frames)
        return applied(self.technique, frames, self.poses, self.camera, self.static)

    def expected(self):
        return oracles.kim(self.frames, self.poses, **self.options)

    def share_of_history(self, shown):
        """In how many pixels of frame 1 the past matters."""
        return (np.abs(shown - self.frames)[1].max(axis=-1) > 0.01).mean()

    def near_border(self, px):
        """Pixels of frame 1 whose past lies on the edge of "inside"."""
        width, height = self.camera.width_px, self.camera.height_px
        near = np.zeros((height, width), bool)
        for d in self.options["closeness"]:
            before, now = self.poses[:2]
            x, y = oracles.kim_past_position(
                width, height, self.camera.fov_deg, before, now, d
            )
            for gap in (x, width - x, y, height - y):
                near |= np.abs(gap) < px
        return near


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
def test_displayed_frames_agree_with_the_equations(rng, form):
    shares = []
    for _ in range(4):
        drawn = Drawn.of(rng, form, 5)
        ours, expected = drawn.ours(), drawn.expected()
        # One step: positions of 100 px, rounded a few times. Then the recursion.
        np.testing.assert_allclose(ours[:2], expected[:2], rtol=0, atol=1e-10)
        np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-9)
        if drawn.technique.space == "gamma":
            np.testing.assert_array_equal(ours[0], drawn.frames[0])
        shares.append(drawn.share_of_history(ours))
    assert np.mean(shares) > 0.4  # else little would be shown


@pytest.mark.parametrize("name", ["several", "linear"])
def test_a_float32_step_agrees_with_the_equations(rng, name):
    left_out, pixels = 0, 0
    for _ in range(4):
        drawn = Drawn.of(rng, FORMS[name], 2, np.float32)
        # The oracle starts from the same rounded poses.
        rounded = drawn.poses.astype(np.float32)
        drawn.poses = rounded
        ours = drawn.ours()
        assert ours.dtype == np.float32
        drawn.poses = rounded.astype(float)
        error = np.abs(ours - drawn.expected())[1].max(axis=-1)
        on_border = drawn.near_border(1e-4)
        left_out, pixels = left_out + on_border.sum(), pixels + error.size
        # Positions err by 1e-7 of displacements of up to 50 px, on noise whose slope
        # is up to 1 per px; gamma of dark linear colours steepens it by up to 13.
        assert np.quantile(error[~on_border], 0.999) < 2e-5
    assert left_out <= 0.002 * pixels


# --- Kim's step: exact laws ---


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_fast_head_sees_the_present_exactly(rng, dtype):
    frames = clip(rng, 4, dtype)
    poses = turning(25.1, 4).astype(dtype)
    np.testing.assert_array_equal(applied(HeadMovement(), frames, poses), frames)


def test_a_still_head_sees_a_still_picture_exactly_in_float32(rng):
    frames = np.repeat(clip(rng, 1, np.float32), 5, axis=0)
    poses = STILL[:5].astype(np.float32)
    np.testing.assert_array_equal(applied(HeadMovement(), frames, poses), frames)


def test_a_still_head_forgets_geometrically(rng):
    before, after = clip(rng, 2)
    frames = np.stack([before] + [after] * 5)
    technique = HeadMovement(w_min=0.3, w_lb=0.3)
    shown = applied(technique, frames, STILL[:6])
    left = 0.7 ** np.arange(6)[:, None, None, None]
    np.testing.assert_allclose(shown, after + left * (before - after), atol=1e-14)


def test_curves_of_speed_and_difference_are_the_techniques_own():
    ease, localization = curves.Cosine(0.5), curves.Spline((3.0, 1.0, 1.0))
    technique = HeadMovement(ease=ease, localization=localization)
    # Two greys, 1/2 apart, so that displacement does not matter.
    frames = np.stack([np.full(SIZE, 0.25), np.full(SIZE, 0.75)])
    shown = applied(technique, frames, turning(25 / 3))
    weight = (shown[1] - 0.25)[3:-3, 3:-3] / 0.5
    # The spline's slope falls from 12/5 to 2/5 at the middle; sin(pi / 6) = 1/2.
    minimum = 0.3 - 0.2 * (12 / 5 + 2 / 5) / 4
    np.testing.assert_allclose(weight, minimum + (1 - minimum) / 2, rtol=1e-12)


def test_flickering_pixels_are_held_back_more():
    # Black to white at rest: the difference is 1, so the weight is w_lb.
    frames = np.stack([np.zeros(SIZE), np.ones(SIZE)])
    shown = applied(HeadMovement(w_min=0.3, w_lb=0.1), frames, STILL[:2])
    np.testing.assert_allclose(shown[1], 0.1, rtol=1e-14)


@pytest.mark.parametrize(
    ("speed", "expected"),
    [(0, 0.3), (5, 0.306), (10, 0.384), (12.5, 0.475), (15, 0.6), (20, 0.873), (25, 1)],
)
def test_weight_of_the_present_rises_with_head_speed_in_degrees(speed, expected):
    # Two grey pictures: displacement does not matter.
    frames = np.stack([np.full(SIZE, 0.25), np.full(SIZE, 0.75)])
    shown = applied(HeadMovement(w_lb=0.3), frames, turning(speed))
    weight = (shown[1] - 0.25) / 0.5
    interior = weight[3:-3, 3:-3]
    np.testing.assert_allclose(interior, expected, rtol=0, atol=5e-4)


def test_a_slow_drift_passes_unchanged_but_for_a_constant_lag():
    # H(1) = 1: in the long run the displayed picture moves as far as the scene; it
    # trails it by d (1 - A) / A steps, the first moment of the impulse response.
    step_px, frequency, d, weight = 0.15, 0.1, 2 / 3, 0.3
    camera = hj.Camera(width_px=128, height_px=1, fov_deg=2.0, refresh_hz=HZ)
    angle = float(np.arctan(step_px / camera.focal_px))
    steps = 60
    poses = oracles.poses_after(np.tile([0.0, angle, 0.0], (steps - 1, 1)))
    x = np.arange(128) + 0.5
    moved = x - step_px * np.arange(steps)[:, None]  # a head turning left: to the right
    wave = 0.5 + 0.4 * np.sin(frequency * moved)
    frames = np.repeat(wave[:, None, :, None], 3, axis=-1)
    technique = HeadMovement(w_min=weight, w_lb=weight, h_max_deg_s=1e9, closeness=(d,))
    shown = applied(technique, frames, poses, camera)[:, 0, :, 0] - 0.5
    # Least squares of sin and cos gives the phase of what is displayed.
    inner = slice(32, 96)
    waves = np.stack([np.sin(frequency * x), np.cos(frequency * x)], 1)[inner]
    fit = np.linalg.lstsq(waves, shown[:, inner].T, rcond=None)[0]
    displayed_px = -np.unwrap(np.arctan2(fit[1], fit[0])) / frequency
    lag = step_px * np.arange(steps) - displayed_px
    np.testing.assert_allclose(np.diff(displayed_px)[40:], step_px, rtol=1e-3)
    # A linear read shifts a wave's phase by its cube, 1e-3; the lag is 0.23 px.
    assert lag[-1] == pytest.approx(d * (1 - weight) / weight * step_px, rel=5e-3)


def test_the_current_pose_needs_no_reprojection(rng):
    # d = 1: every pixel blends with itself, borders included, however the head turns.
    frames = clip(rng, 2)
    technique = HeadMovement(w_min=0.4, w_lb=0.4, h_max_deg_s=1e9, closeness=(1.0,))
    shown = applied(technique, frames, turning(300.0))
    expected = 0.4 * frames[1] + 0.6 * frames[0]
    np.testing.assert_allclose(shown[1], expected, rtol=0, atol=1e-15)


def test_dynamic_pixels_show_the_present(rng):
    frames = clip(rng, 3)
    static = rng.random((3, *SIZE[:2])) < 0.5
    shown = applied(HeadMovement(), frames, turning(5.0, 3), static_mask=static)
    np.testing.assert_array_equal(shown[1][~static[1]], frames[1][~static[1]])
    assert (shown[1][static[1]] != frames[1][static[1]]).mean() > 0.9


def test_weights_are_scaled_to_one_and_default_to_the_closeness(rng):
    frames, poses = clip(rng, 2), turning(9.0)
    at = lambda weights: applied(
        HeadMovement(closeness=(0.3, 0.6, 0.9), weights=weights), frames, poses
    )
    once = at((1.0, 2.0, 3.0))
    np.testing.assert_allclose(at((5.0, 10.0, 15.0)), once, rtol=0, atol=1e-15)
    np.testing.assert_allclose(at(None), once, rtol=0, atol=1e-15)


def test_samples_that_are_all_fully_past_count_alike(rng):
    frames = clip(rng, 4)
    once, twice = (
        applied(HeadMovement(closeness=closeness), frames, SLOWLY[:4])
        for closeness in ((0.0,), (0.0, 0.0, 0.0))
    )
    np.testing.assert_allclose(twice, once, rtol=0, atol=1e-14)


def test_full_inversion_alone_has_weight_1_also_in_gradients(rng):
    # The default weights d / sum d would be 0 / 0.
    past, present = (frame_of(rng.random((1, 3, 6, 8))) for _ in range(2))
    increment = jnp.asarray([0.0, 0.002, 0.0])
    motion = hj.Motion(increment, increment)

    def total(d):
        technique = HeadMovement(closeness=(d,))
        _, shown = technique.step(technique.init(past), present, motion)
        return shown.sum()

    derivative = quickly(jax.value_and_grad(total))
    value, slope = derivative(0.0)
    assert np.isfinite(slope)
    # To the right of 0 the weight is d / d.
    beside, slope_beside = derivative(1e-7)
    assert beside == pytest.approx(float(value), rel=1e-6)
    assert slope_beside == pytest.approx(float(slope), rel=1e-3)


# --- not a number ---


@pytest.mark.parametrize("poison", [np.nan, np.inf])
def test_a_bad_pixel_stays_within_its_footprint(rng, poison):
    # A bilinear read has four taps, and 0 x NaN is NaN.
    frames = clip(rng, 3)
    frames[1, 6, 9] = poison
    poses = turning(6.0, 3)
    shown = applied(HeadMovement(), frames, poses)
    bad = np.asarray(np.any(~np.isfinite(shown), axis=-1))
    assert not bad[0].any()
    assert np.argwhere(bad[1]).tolist() == [[6, 9]]
    past = oracles.kim_past_position(WIDTH, HEIGHT, 60.0, poses[1], poses[2], 2 / 3)
    column, row = np.floor(past - 0.5)
    reads = ((column == 9) | (column == 8)) & ((row == 6) | (row == 5))
    assert reads.sum() == 4
    np.testing.assert_array_equal(bad[2], reads)


@pytest.mark.parametrize("difference", ["euclidean", "same_pixel"])
def test_a_bad_past_does_not_enter_where_the_mask_says_dynamic(rng, difference):
    frames = clip(rng, 3)
    clean = frames.copy()
    frames[0, 6:9] = np.nan
    static = np.ones((3, *SIZE[:2]), bool)
    static[:, 4:11] = False  # pixels that read rows 6 to 8, and a few more
    poses = turning(6.0, 3)
    technique = HeadMovement(difference=difference)
    shown, expected = (
        applied(technique, f, poses, CAMERA, static) for f in (frames, clean)
    )
    np.testing.assert_array_equal(shown[1:], expected[1:])


def test_a_bad_border_does_not_enter_where_the_past_was_not_seen(rng):
    # d = 0 and a turn by 3 px: the left columns would read column 0, clamped.
    frames = clip(rng, 3)
    frames[1, :, 0] = np.nan
    turn = np.arctan(3 / CAMERA.focal_px)
    poses = oracles.poses_after([[0.0, 0.0, 0.0], [0.0, turn, 0.0]])
    technique = HeadMovement(closeness=(0.0,), h_max_deg_s=1e9)
    shown = applied(technique, frames, poses)[2]
    past_x = oracles.kim_past_position(WIDTH, HEIGHT, 60.0, poses[1], poses[2], 0.0)[0]
    unseen = past_x < 0
    assert unseen[:, :3].all()
    np.testing.assert_array_equal(shown[unseen], frames[2][unseen])
    assert np.isfinite(shown[past_x > 1.5]).all()


# --- spatial techniques and controls ---


def test_no_antialiasing_shows_the_frame(rng):
    frames = clip(rng, 3)
    np.testing.assert_array_equal(
        applied(NoAntialiasing(), frames, turning(5.0, 3)), frames
    )


def test_freeze_shows_the_first_frame_for_ever(rng):
    frames = clip(rng, 3)
    shown = applied(Freeze(), frames, turning(5.0, 3))
    np.testing.assert_array_equal(shown, np.repeat(frames[:1], 3, axis=0))


@pytest.mark.parametrize("technique", [SSAA(2), SSAA(3), MSAA(4)], ids=lambda t: t.id)
@pytest.mark.parametrize("space", ["linear", "gamma"])
def test_resolving_is_the_mean_over_samples_in_its_space(rng, technique, space):
    technique = dataclasses.replace(technique, space=space)
    samples = rng.random((technique.sample_offsets_px.shape[1], 3, *SIZE[:2]))
    shown = technique.resolve(frame_of(samples))
    if space == "linear":
        expected = oracles.srgb_encode(oracles.srgb_decode(samples).mean(axis=0))
    else:
        expected = samples.mean(axis=0)
    np.testing.assert_allclose(shown, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("space", ["linear", "gamma"])
def test_resolving_a_colour_that_all_samples_share_gives_it_back(rng, space):
    # Inside a surface multisampling shows what no anti-aliasing shows.
    picture = rng.random((3, *SIZE[:2]))
    shown = MSAA(4, space=space).resolve(frame_of(np.stack([picture] * 4)))
    np.testing.assert_allclose(shown, picture, rtol=0, atol=1e-15)


@pytest.mark.slow
def test_head_movement_resolves_before_it_blends(rng):
    frames = rng.random((4, 4, *SIZE))
    poses = turning(7.0, 4)
    resolved = applied(SSAA(2), frames, poses)
    expected = applied(HeadMovement(), resolved, poses)
    shown = applied(HeadMovement(resolve=SSAA(2)), frames, poses)
    np.testing.assert_allclose(shown, expected, rtol=0, atol=1e-14)


def test_ssaa_samples_lie_on_a_centred_grid():
    for factor in (1, 2, 3, 4):
        offsets = SSAA(factor).sample_offsets_px
        assert offsets.shape == (1, factor**2, 2)
        axis = (np.arange(factor) + 0.5) / factor - 0.5
        grid = {(x, y) for x in axis for y in axis}
        assert {tuple(offset) for offset in offsets[0]} == grid


def test_only_ssaa4_in_linear_light_is_the_reference():
    assert SSAA(4).reads_supersampled
    assert HeadMovement(resolve=SSAA(4)).reads_supersampled
    for technique in (SSAA(2), SSAA(4, space="gamma"), MSAA(16), HeadMovement()):
        assert not technique.reads_supersampled


def test_multisampling_a_picture_is_no_antialiasing():
    for samples in (1, 2, 4, 8, 16):
        assert isinstance(MSAA(samples).on_pictures(), NoAntialiasing)
    assert HeadMovement(w_min=0.4, resolve=MSAA(4)).on_pictures().resolve is None
    assert HeadMovement(w_min=0.4, resolve=MSAA(4)).on_pictures().w_min == 0.4
    for technique in (SSAA(2), HeadMovement(), HeadMovement(resolve=SSAA(2)), Freeze()):
        assert technique.on_pictures() == technique


# --- ids ---


@pytest.mark.parametrize(
    "id", [*techniques.IDS, "ssaa5", "head_movement+ssaa2", "head_movement+msaa4"]
)
def test_ids_round_trip(id):
    assert techniques.by_id(id).id == id


def test_a_label_is_part_of_the_id():
    assert HeadMovement(label="a").id == "head_movement:a"
    resolving = HeadMovement(label="a", resolve=SSAA(2))
    assert resolving.id == resolving.on_pictures().id == "head_movement:a+ssaa2"
    multisampled = HeadMovement(label="a", resolve=MSAA(4)).on_pictures()
    assert multisampled == HeadMovement(label="a")


@pytest.mark.parametrize(
    ("id", "suggestion"),
    [("head_movment", "head_movement"), ("msa4", "msaa4"), ("noone", "none")],
)
def test_an_unknown_id_is_refused_with_the_nearest_one(id, suggestion):
    with pytest.raises(ValueError, match=f"got '{id}'. Did you mean '{suggestion}'?"):
        techniques.by_id(id)


@pytest.mark.parametrize(
    "id",
    [
        "",
        "kim",
        "ssaa0",
        "msaa3",
        "none+ssaa2",
        "head_movement+freeze",
        "ssaa2+",
        "head_movement+",
        "head_movement:",
        "msaa4:curve.toml",
    ],
)
def test_what_is_no_id_is_refused(id):
    with pytest.raises(ValueError, match="must be"):
        techniques.by_id(id)


# --- values that are refused ---


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"w_min": 1.5}, r"^w_min must lie in \[0, 1\], got 1.5.$"),
        ({"w_min": np.nan}, r"^w_min must lie in \[0, 1\], got nan.$"),
        ({"w_lb": 0.4}, r"^w_lb must lie in \[0, w_min = 0.3\], got 0.4.$"),
        ({"h_max_deg_s": 0}, r"^h_max_deg_s must lie in \(0, inf\), got 0.$"),
        ({"closeness": ()}, r"^closeness must name at least one past sample"),
        ({"closeness": (0.5, 1.2)}, r"^closeness\[1\] must lie in \[0, 1\], got 1.2.$"),
        ({"weights": (1, 2)}, r"^weights must have one entry per past sample \(1\)"),
        ({"weights": (-1,)}, r"^weights\[0\] must lie in \[0, inf\), got -1.$"),
        ({"weights": (0,)}, r"^weights must have a positive sum, got 0.$"),
        ({"difference": "euclid"}, r"^difference must be one of .*'euclidean'\?$"),
        ({"space": "srgb"}, r"^space must be one of gamma, linear, got 'srgb'.$"),
    ],
)
def test_head_movement_refuses_what_is_out_of_range(options, message):
    with pytest.raises(ValueError, match=message):
        HeadMovement(**options)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SSAA(0), "^factor must be a whole number >= 1, got 0.$"),
        (lambda: SSAA(2, space="srgb"), "^space must be one of gamma, linear"),
        (lambda: MSAA(3), "^samples must be 1, 2, 4, 8 or 16, got 3.$"),
        (lambda: MSAA(4, space="srgb"), "^space must be one of gamma, linear"),
    ],
)
def test_spatial_techniques_refuse_what_they_do_not_know(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    "closeness",
    [
        (2 / 3,),
        *(pytest.param(d, marks=pytest.mark.slow) for d in ((0.2, 0.9), (0.5,) * 16)),
    ],
)
def test_masked_history_that_is_no_number_stays_out_of_gradients(rng, closeness):
    # Through the weights of equation (2), and through where the samples are read.
    color = jnp.asarray(rng.random((1, 3, 4, 5)))
    turn = jnp.array([0.001, 0.01, 0.0])
    camera, mask = hj.Camera(5, 4, 60.0, HZ), jnp.zeros((4, 5), bool)

    def shown(closeness, turn):
        reading = Reading("plain")
        frame = hj.Frame(color, camera, hj.Region.whole(camera), mask, reading)
        history = History.of(jnp.full((3, 4, 5), jnp.nan))
        motion = hj.Motion(turn, turn)
        technique = HeadMovement(closeness=closeness)
        return technique.step(history, frame, motion)[1].sum()

    value, slopes = quickly(jax.value_and_grad(shown, (0, 1)))(
        tuple(map(jnp.asarray, closeness)), turn
    )
    np.testing.assert_allclose(value, color.sum(), rtol=1e-14)
    assert all((slope == 0).all() for slope in jax.tree.leaves(slopes))
