"""Stages of display: nothing of them enters a history."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from small import (
    CAMERA,
    FRAMES,
    HEIGHT,
    SIZE,
    STILL,
    WIDTH,
    path,
    quickly,
    study,
)

import hmdjit as hj
from hmdjit import techniques
from hmdjit.filters import neighborhood
from hmdjit.frames.displacement import Reading
from hmdjit.frames.sources import History
from hmdjit.simulation.halo import needed_halo_px
from hmdjit.studies.measured_blocks import Tiles, WholeFrame
from hmdjit.technique_contract.check import check_hints
from hmdjit.techniques import (
    FXAA,
    SSAA,
    Displayed,
    Freeze,
    HeadMovement,
    MotionBlur,
    NoAntialiasing,
    Sharpening,
)

STAGES = {
    "thesis": Sharpening(),
    "xu": Sharpening("xu"),
    "blur": MotionBlur(most_taps=8),
}
STEADY = hj.Motion(jnp.zeros(3), jnp.zeros(3))


def frame_of(planes, velocity=None, camera=CAMERA):
    """Frame of one sample, which moved by a velocity, px per frame."""
    channels = {}
    if velocity is not None:
        field = jnp.broadcast_to(jnp.asarray(velocity)[:, None, None], (2, *SIZE[:2]))
        channels = {"velocity": field[None]}
    region = hj.Region.whole(camera)
    return hj.Frame(jnp.asarray(planes)[None], camera, region, channels=channels)


@pytest.mark.parametrize("stage", STAGES.values(), ids=STAGES)
def test_what_a_technique_keeps_is_the_same_with_and_without_a_stage(rng, stage):
    plain = HeadMovement()
    staged = Displayed(plain, stage)
    frames = jnp.asarray(rng.random((FRAMES, 3, HEIGHT, WIDTH)))
    motion = hj.Motion.of(jnp.asarray(path(rng)))

    def run(technique):
        def step(state, now):
            state, shown = technique.step(state, frame_of(now[0]), now[1])
            return state, (state, shown)

        return jax.lax.scan(step, technique.init(frame_of(frames[0])), (frames, motion))

    # In one program, so that both are fused alike.
    (kept, pictures), (ours, shown) = quickly(
        lambda: [run(technique)[1] for technique in (plain, staged)]
    )()
    np.testing.assert_array_equal(ours.texels, kept.texels)
    assert (np.asarray(shown) != np.asarray(pictures)).mean() > 0.2
    # And it is the picture that passes through the stage.
    at = lambda leaf: leaf[3]
    now = jax.tree.map(at, motion)
    expected = stage.show(pictures[3], frame_of(frames[3]), now)
    np.testing.assert_allclose(shown[3], expected, rtol=0, atol=1e-12)
    assert shown.min() >= 0
    assert shown.max() <= 1


def test_sharpening_is_the_kernel_clipped(rng):
    picture = rng.random((3, HEIGHT, WIDTH))
    for kernel, (centre, side) in {"thesis": (2, -0.25), "xu": (5, -1)}.items():
        near = np.pad(picture, [(0, 0), (1, 1), (1, 1)], mode="edge")
        around = near[:, :-2, 1:-1] + near[:, 2:, 1:-1]
        around += near[:, 1:-1, :-2] + near[:, 1:-1, 2:]
        expected = np.clip(centre * picture + side * around, 0, 1)
        show = Sharpening(kernel).show
        ours = show(jnp.asarray(picture), frame_of(picture), STEADY)
        np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-14)


def blurred(picture, velocity, exposure, most_taps):
    """Mean of Chapman's taps, one by one."""
    _, height, width = picture.shape
    smear = np.array(velocity) * exposure
    length = np.hypot(*smear)
    smear *= min(1, most_taps / max(length, 1e-300))
    taps = int(np.clip(np.floor(length), 1, most_taps))
    total = picture.copy()

    def at(x, y):
        return picture[:, min(max(y, 0), height - 1), min(max(x, 0), width - 1)]

    for i in range(1, taps):
        dx, dy = smear * (i / (taps - 1) - 0.5)
        left, top = int(np.floor(dx)), int(np.floor(dy))
        u, v = dx - left, dy - top
        for y in range(height):
            for x in range(width):
                for j, weight in ((0, 1 - v), (1, v)):
                    pair = at(x + left, y + top + j), at(x + left + 1, y + top + j)
                    total[:, y, x] += weight * ((1 - u) * pair[0] + u * pair[1])
    return total / taps


@pytest.mark.parametrize(
    "velocity",
    [(0.0, 0.0), (0.3, -0.2), (1.1, 0.6), (-2.0, 1.5), (30.0, -20.0)],
)
def test_motion_blur_agrees_with_its_taps(rng, velocity):
    picture = rng.random((3, HEIGHT, WIDTH))
    stage = MotionBlur(target_fps=25, most_taps=8)
    show = quickly(lambda picture, v: stage.show(picture, frame_of(picture, v), STEADY))
    ours = show(jnp.asarray(picture), jnp.asarray(velocity))
    expected = blurred(picture, velocity, 60 / 25, 8)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-12)
    if velocity == (0.0, 0.0):
        np.testing.assert_array_equal(ours, picture)


def test_a_still_head_sees_no_blur_and_a_turning_one_sees_it_by_its_speed(rng):
    frames = rng.random((FRAMES, *SIZE))
    technique = Displayed(NoAntialiasing(), MotionBlur(most_taps=8))
    show = lambda poses: np.asarray(
        hj.apply(technique, CAMERA, jnp.asarray(frames), jnp.asarray(poses))
    )
    np.testing.assert_array_equal(show(STILL), frames)
    # 1.7 px per frame to the right, which hardly differs within so small a view.
    yaw = np.arctan(1.7 / float(CAMERA.focal_px)) * np.arange(FRAMES)
    turning = np.stack([np.cos(yaw / 2), 0 * yaw, np.sin(yaw / 2), 0 * yaw], axis=1)
    ours = show(turning)
    np.testing.assert_array_equal(ours[0], frames[0])
    planes = np.moveaxis(frames[3], -1, 0)
    expected = np.moveaxis(blurred(planes, (1.7, 0.0), 60 / 25, 8), 0, -1)
    np.testing.assert_allclose(ours[3], expected, rtol=0, atol=5e-3)


def test_motion_blur_is_differentiable_at_rest_and_in_motion(rng):
    picture = jnp.asarray(rng.random((3, HEIGHT, WIDTH)))
    plain = Reading("plain")

    def total(picture, velocity):
        frame = dataclasses.replace(frame_of(picture, velocity), reading=plain)
        return jnp.sum(MotionBlur(most_taps=8).show(picture, frame, STEADY) ** 2)

    moving = jnp.asarray([1.13, 0.61])
    check_grads(jax.jit(total), (picture, moving), order=1, modes=["rev"], eps=1e-6)
    still = quickly(jax.grad(total, 1))(picture, 0 * moving)
    np.testing.assert_array_equal(still, 0)


def test_what_lies_beyond_the_halo_does_not_reach_the_tile(rng):
    technique = Displayed(HeadMovement(resolve=FXAA("10")), MotionBlur(most_taps=8))
    camera = hj.Camera(64, 64, fov_deg=4.0, refresh_hz=60.0)
    poses = jnp.asarray(path(rng, camera=camera))
    motion = jax.tree.map(lambda leaf: leaf[None], hj.Motion.of(poses))
    origin = np.array([[(24, 24)]], np.int32)
    (halo,) = needed_halo_px(technique, camera, motion, origin, (16, 16))
    # 5 px of FXAA, 5 of the blur, and what comes in with the history, once.
    assert 10 < halo <= 23
    frames = rng.random((FRAMES, 64, 64, 3))
    changed = 1 - frames
    inside = slice(24 - halo, 40 + halo)
    changed[:, inside, inside] = frames[:, inside, inside]
    shown, other = (
        np.asarray(hj.apply(technique, camera, jnp.asarray(f), poses))
        for f in (frames, changed)
    )
    difference = np.abs(shown - other)
    assert difference[:, 24:40, 24:40].max() < 1e-5
    assert difference[:, inside, inside].max() > 1e-5


class Spreading(Freeze):
    """Blurs what it keeps, and says that it does not."""

    @property
    def stencil_radius_px(self):
        return 1

    @property
    def history_radius_px(self):
        return 0

    def step(self, state, frame, motion):
        kept = neighborhood.box_mean(state.under(frame.region))
        return History.of(kept), kept


@pytest.mark.parametrize(
    "technique", [Spreading(), Displayed(Spreading(), MotionBlur())], ids=["", "staged"]
)
def test_a_wrong_radius_of_the_history_is_an_error(technique):
    with pytest.raises(ValueError, match="history_radius_px of freeze must be at leas"):
        check_hints(technique)


@pytest.mark.slow
def test_a_study_by_tiles_is_that_of_the_whole_frame():
    techniques = (
        NoAntialiasing(),
        Displayed(FXAA("10"), Sharpening("xu")),
        Displayed(HeadMovement(), MotionBlur(most_taps=8)),
    )
    # All 16 tiles: their mean is that of the frame.
    tiles, whole = (
        study(techniques=techniques, measure=measure, sessions=2).run(0)["mtcd"]
        for measure in (Tiles(16, 16), WholeFrame())
    )
    np.testing.assert_allclose(tiles, whole, rtol=2e-5)


def test_ids_stack():
    for id in (
        "none+sharpen",
        "none+sharpen_xu",
        "none+motion_blur30_taps8",
        "head_movement+ssaa2+motion_blur",
        "head_movement+fxaa39_linear+sharpen",
        "msaa4+motion_blur+sharpen",
    ):
        assert hj.techniques.by_id(id).id == id
    staged = hj.techniques.by_id("head_movement+ssaa2+motion_blur")
    assert staged == Displayed(HeadMovement(resolve=SSAA(2)), MotionBlur())
    assert staged.needs == {"color", "velocity"}
    assert staged.stencil_radius_px == 33
    assert Displayed(FXAA(), Sharpening()).stencil_radius_px == 33
    with pytest.raises(ValueError, match=r"technique must be one of .*, got 'nonne'"):
        hj.techniques.by_id("nonne+sharpen")


def test_numbers_and_choices_are_checked():
    with pytest.raises(ValueError, match="kernel must be one of thesis, xu"):
        Sharpening("strong")
    with pytest.raises(ValueError, match=r"target_fps must lie in \(0, inf\), got 0"):
        MotionBlur(target_fps=0)
    with pytest.raises(ValueError, match="most_taps must be a whole number >= 1"):
        MotionBlur(most_taps=0)


def test_what_is_said_of_a_technique_is_said_of_it_behind_a_stage():
    # Of what moves with a stage nothing is known; all else is passed on.
    own = {"small_motion"}
    said = {
        name
        for name, value in vars(techniques.AbstractTechnique).items()
        if not name.startswith("_") and (callable(value) or isinstance(value, property))
    }
    assert said - set(vars(Displayed)) <= own
    assert Displayed(techniques.TIDOAA(), Sharpening()).reads_steps
