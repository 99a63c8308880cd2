"""The Sobel technique of Oliveros' thesis: what it shows, and of what it is made."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hmdjit as hj
from hmdjit import rendering
from hmdjit.camera import Camera, Region
from hmdjit.filters import neighborhood, temporal
from hmdjit.frames.frame import Frame
from hmdjit.frames.motion import Motion
from hmdjit.techniques import SobelTAA, by_id

SIZE = 32
CAMERA = Camera(SIZE, SIZE, 40.0, 60.0)
REGION = Region.whole(CAMERA)
STILL = Motion(*jnp.zeros((2, 3)))


@pytest.mark.parametrize(
    ("options", "id"),
    [
        ({}, "sobel_taa"),
        ({"depth_range": "code"}, "sobel_taa_code"),
        ({"depth_history": "reprojected"}, "sobel_taa_reprojected"),
        (
            {"depth_range": "code", "off_screen": "reject", "jitter": False},
            "sobel_taa_code_reject_no_jitter",
        ),
    ],
)
def test_ids_say_what_is_no_default(options, id):
    assert SobelTAA(**options).id == id
    assert by_id(id) == SobelTAA(**options)


@pytest.mark.parametrize("name", ["depth_range", "depth_history", "off_screen"])
def test_wrong_options_are_refused(name):
    with pytest.raises(ValueError, match=f"{name} must be one of .* got 'none'"):
        dataclasses.replace(SobelTAA(), **{name: "none"})


@jax.jit
def step(state, frame, motion):
    """Return what is displayed, and of what it is made."""
    technique = SobelTAA()
    made_of = technique.intermediates(state, frame, motion)
    return *technique.step(state, frame, motion), made_of


def picture(color, **channels):
    """Frame of one static model, far away unless something else is said."""
    plane = (1, 1, SIZE, SIZE)
    usual = {
        "albedo": color[None],
        "depth": jnp.full(plane, jnp.inf),
        "object_id": jnp.zeros(plane, jnp.int32),
        "velocity": jnp.zeros((1, 2, SIZE, SIZE)),
    }
    aside = jnp.array([0.3, -0.4])
    return Frame(
        color[None], CAMERA, REGION, channels=usual | channels, jitter_px=aside
    )


def test_what_cannot_alias_is_shown_as_it_is_now():
    """Flat colours have no edge: the past, of another colour, is all but gone."""
    before, now = (picture(jnp.full((3, SIZE, SIZE), value)) for value in (0.2, 0.7))
    state = SobelTAA().init(before)
    _, shown, made_of = step(state, now, STILL)
    np.testing.assert_array_equal(made_of.aliased, 0.0)
    np.testing.assert_allclose(shown, 0.7, atol=1e-5)


def test_models_and_depth_count_where_they_differ(rng):
    right = jnp.broadcast_to(jnp.arange(SIZE) >= SIZE // 2, (1, 1, SIZE, SIZE))
    color = jnp.full((3, SIZE, SIZE), 0.5)
    frame = picture(
        color,
        object_id=right.astype(jnp.int32),
        depth=jnp.where(right, 100.0, 2000.0),
    )
    frame = dataclasses.replace(frame, jitter_px=None)
    _, shown, made_of = step(SobelTAA().init(frame), frame, STILL)
    at_edge, beside = made_of.model_average[5, SIZE // 2], made_of.model_average[5, 5]
    assert at_edge == pytest.approx(3 / 9)
    assert beside == 0
    np.testing.assert_array_equal(made_of.aliased[5, SIZE // 2 - 1 : SIZE // 2 + 1], 1)
    np.testing.assert_array_equal(made_of.aliased[:, :5], 0)
    np.testing.assert_allclose(shown, color, atol=1e-12)


def test_lost_pixels_of_the_past_are_gone_after_a_frame(rng):
    frame = picture(jnp.asarray(rng.random((3, SIZE, SIZE))))
    state = SobelTAA().init(frame)
    lost = jax.tree.map(lambda texels: texels.at[..., 9, 9].set(jnp.nan), state)
    kept, shown, _ = step(lost, frame, STILL)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((kept, shown)))


def test_nearest_reads_take_whole_pixels(rng):
    planes = jnp.asarray(rng.random((2, 5, 7)))
    found = neighborhood.shifted_nearest(planes, jnp.array([0.6, -1.4]), margin_px=1)
    rows, columns = np.clip(np.arange(-2, 5), 0, 4), np.clip(np.arange(0, 9), 0, 6)
    np.testing.assert_array_equal(found, planes[:, rows][:, :, columns])


def test_a_gradient_is_eight_times_a_ramps(rng):
    y, x = np.mgrid[:6, :8]
    inner = neighborhood.gradient_length(jnp.asarray(3.0 * x + 4.0 * y))[1:-1, 1:-1]
    np.testing.assert_allclose(inner, 8 * 5.0)


@pytest.mark.slow
def test_solids_are_shown_and_have_finite_derivatives():
    """A head that walks past things that circle; frame 0 is itself, sharpened."""
    technique, scene = SobelTAA(), hj.scenes.hut()
    turn, walk = jnp.array([1e-3, 2e-2, 0]), jnp.array([1e-2, 0, 2e-2])

    @jax.jit
    def rendered(motion, sample_px, k):
        channels = technique.needs
        look = (scene, CAMERA, REGION, motion, sample_px[None])
        frame = rendering.render(*look, frame=k, channels=channels)
        return dataclasses.replace(frame, jitter_px=sample_px)

    def slope(state, frame, motion):
        def total(color):
            changed = dataclasses.replace(frame, color=color)
            return (technique.step(state, changed, motion)[1] ** 2).mean()

        return jax.grad(total)(frame.color)

    slope, state, frame = jax.jit(slope), None, None
    for k in range(4):
        motion = Motion(turn * k, turn, walk * k, walk) if k else STILL
        motion = dataclasses.replace(motion, position_m=walk * k, translation_m=walk)
        frame = rendered(motion, jnp.asarray(technique.sample_offsets_px[k, 0]), k)
        state = technique.init(frame) if k == 0 else state
        assert np.isfinite(slope(state, frame, motion)).all()
        state, shown, made_of = step(state, frame, motion)
        assert np.isfinite(shown).all()
        assert 0.05 < float(made_of.aliased.mean()) < 0.95
    assert frame is not None
    assert np.isfinite(temporal.thesis_depth(frame.depth)).all()
