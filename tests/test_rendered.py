"""What techniques see of frames rendered elsewhere, beside their colour."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
from scipy.spatial.transform import Rotation
from small import CAMERA, FRAMES, HEIGHT, SIZE, WIDTH, path

import hmdjit as hj
from hmdjit.simulation import apply as clips
from hmdjit.techniques import NoAntialiasing

PLANE = (FRAMES, HEIGHT, WIDTH)
JITTER_PX = np.array([[[0.25, -0.125]], [[-0.5, 0.375]]])


class Shows(hj.techniques.AbstractTechnique):
    """Displays a channel instead of colour: what it is, or where the past lies."""

    channel: str = eqx.field(static=True)
    jitters: bool = eqx.field(static=True, default=False)

    @property
    def id(self):
        return "mine"

    @property
    def needs(self):
        return frozenset({"color"} | {self.channel})

    @property
    def sample_offsets_px(self):
        return JITTER_PX if self.jitters else np.zeros((1, 1, 2))

    def init(self, frame):
        return None

    def step(self, state, frame, motion):
        if self.channel == "velocity":
            shown = jnp.stack(frame.reprojection(motion).px())
        elif self.channel == "color":
            shown = frame.color[0]
            if frame.jitter_px is not None:
                shown = jnp.ones_like(frame.color[0]) * frame.jitter_px[0]
        else:
            shown = frame.channels[self.channel][0].astype(frame.color.dtype)
        return None, jnp.resize(shown, frame.color[0].shape)


def still(frames=FRAMES):
    return np.tile([1.0, 0, 0, 0, 0, 0, 0], (frames, 1))


def walking(rng):
    """Poses of a head that turns and moves, far from the world's origin."""
    place = [100.0, 1.6, -50.0] + 0.05 * rng.normal(size=(FRAMES, 3))
    turns = Rotation.from_quat(path(rng), scalar_first=True) * Rotation.random(rng=rng)
    return np.hstack([turns.as_quat(scalar_first=True), place])


def channels(rng):
    """All that can be given, as keywords."""
    return {
        "depth": 1 + 9 * rng.random(PLANE),
        "object_id": rng.integers(0, 3, PLANE),
        "motion_class": rng.integers(0, 3, PLANE),
        "albedo": rng.random((FRAMES, *SIZE)),
        "velocity_px": rng.normal(size=(*PLANE, 2)),
        "object_poses": np.tile(still()[:, None], (1, 3, 1)),
        "jitter_px": rng.uniform(-0.5, 0.5, (FRAMES, 2)),
    }


def shown(technique, poses, **given: Any):
    """What is displayed of black frames."""
    frames = np.zeros((FRAMES, *SIZE))
    return np.asarray(hj.apply(technique, CAMERA, frames, poses, **given))


@pytest.mark.parametrize(
    ("channel", "dtype"),
    [
        ("depth", np.float32),
        ("object_id", np.uint16),
        ("object_id", float),
        ("motion_class", np.uint8),
        ("albedo", np.float32),
    ],
)
def test_a_channel_arrives_as_it_was_given(rng, channel, dtype):
    given = channels(rng)[channel].astype(dtype)
    if channel == "depth":
        given[2, 3, 4] = np.inf
    found = shown(Shows(channel), still(), **{channel: given})
    expected = given if channel == "albedo" else given[..., None]
    np.testing.assert_array_equal(found[..., : expected.shape[-1]], expected)


def test_a_velocity_that_is_given_points_back_to_the_past(rng):
    velocity_px = channels(rng)["velocity_px"]
    found = shown(Shows("velocity"), walking(rng), velocity_px=velocity_px)
    np.testing.assert_array_equal(found[..., :2], -velocity_px)


@pytest.mark.parametrize("columns", [4, 7])
def test_where_the_head_only_turns_velocity_is_its_formula(rng, columns):
    poses = walking(rng)
    poses[:, 4:] = poses[0, 4:]
    technique = Shows("velocity")
    found = shown(technique, poses[:, :columns])
    place = oracles.source_position(
        WIDTH, HEIGHT, CAMERA.fov_deg, np.zeros(3), *centres()
    )
    turns = Rotation.from_quat(poses[:, :4], scalar_first=True)
    for k in range(1, FRAMES):
        turn = (turns[k - 1].inv() * turns[k]).as_rotvec()
        past = oracles.source_position(WIDTH, HEIGHT, CAMERA.fov_deg, turn, *centres())
        expected = np.moveaxis(past - place, 0, -1)
        np.testing.assert_allclose(found[k, ..., :2], expected, rtol=0, atol=1e-9)


def centres(shift=(0.0, 0.0)):
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    return x + 0.5 + shift[0], y + 0.5 + shift[1]


@pytest.mark.parametrize("are_moving", [False, True])
@pytest.mark.parametrize("jitters", [False, True])
def test_velocity_is_derived_from_depth_and_poses(rng, are_moving, jitters):
    poses, given = walking(rng), channels(rng)
    depth, ids = given["depth"], given["object_id"]
    objects = np.zeros((FRAMES, 3, 7))
    objects[..., 4:] = poses[0, 4:] + rng.normal(size=(FRAMES, 3, 3))
    objects[..., :4] = (
        Rotation.from_rotvec(0.1 * rng.normal(size=(24, 3)))
        .as_quat(scalar_first=True)
        .reshape(FRAMES, 3, 4)
    )
    objects[:, 0] = objects[0, 0]  # the background is at rest
    options = {"depth": depth}
    if are_moving:
        options |= {"object_id": ids, "object_poses": objects}
    found = shown(Shows("velocity", jitters), poses, **options)
    heads = Rotation.from_quat(poses[:, :4], scalar_first=True)
    view = WIDTH, HEIGHT, CAMERA.fov_deg
    for k in range(1, FRAMES):
        x, y = centres(JITTER_PX[k % 2, 0] if jitters else (0, 0))
        points = (depth[k] * oracles.ray_of(*view, x, y)).reshape(3, -1).T
        world = heads[k].apply(points) + poses[k, 4:]
        for i in range(3 * are_moving):
            last, now = Rotation.from_quat(
                objects[k - 1 : k + 1, i, :4], scalar_first=True
            )
            own = now.inv().apply(world - objects[k, i, 4:])
            is_own = ids[k].ravel()[:, None] == i
            world = np.where(is_own, last.apply(own) + objects[k - 1, i, 4:], world)
        seen = heads[k - 1].inv().apply(world - poses[k - 1, 4:])
        expected = oracles.project(*view, seen.T).T.reshape(HEIGHT, WIDTH, 2)
        expected = expected - np.stack([x, y], axis=-1)
        is_near = np.abs(expected).max(axis=-1) < 3 * WIDTH
        assert is_near.sum() > 20
        error = np.abs(found[k, ..., :2] - expected)[is_near]
        assert error.max() < 1e-8


def test_jitter_is_that_of_the_frames_or_the_techniques_own(rng):
    technique, jitter_px = Shows("color", jitters=True), channels(rng)["jitter_px"]
    found = shown(technique, still(), jitter_px=jitter_px)[:, 0, 0, 0]
    np.testing.assert_array_equal(found, jitter_px[:, 0])
    own = shown(technique, still())[:, 0, 0, 0]
    np.testing.assert_array_equal(own, np.resize(JITTER_PX[:, 0, 0], FRAMES))


def test_what_is_not_needed_is_not_in_the_program(rng, monkeypatch):
    programs = []

    def traced(*arguments):
        programs.append(str(jax.make_jaxpr(displayed)(*arguments)))
        return displayed(*arguments)

    displayed = clips._displayed
    monkeypatch.setattr(clips, "_displayed", traced)
    poses = walking(rng)
    alone = shown(NoAntialiasing(), poses)
    everything = shown(NoAntialiasing(), poses, **channels(rng))
    np.testing.assert_array_equal(alone, everything)
    shown(Shows("depth"), poses, depth=channels(rng)["depth"])
    assert programs[0] == programs[1]
    assert programs[0] != programs[2]


@pytest.mark.parametrize("channel", ["velocity", "depth", "albedo", "color"])
def test_a_stream_shows_what_a_clip_shows(rng, channel):
    technique, poses = Shows(channel, jitters=channel == "color"), walking(rng)
    given = channels(rng)
    names = {"velocity": ["depth", "object_id", "object_poses"], "color": ["jitter_px"]}
    given: Any = {
        name: np.float32(given[name]) for name in names.get(channel, [channel])
    }
    frames = np.zeros((FRAMES, *SIZE), np.float32)
    expected = hj.apply(technique, CAMERA, frames, poses, **given)
    each = list(clips.stream(technique, CAMERA, iter(frames), poses, **given))
    np.testing.assert_allclose(np.stack(each), expected, rtol=1e-6, atol=1e-4)


def test_a_stream_tells_a_channel_that_ends_early(rng):
    frames, depth = np.zeros((FRAMES, *SIZE), np.float32), channels(rng)["depth"][:3]
    each = clips.stream(Shows("depth"), CAMERA, frames, None, depth=depth)
    with pytest.raises(ValueError, match=r"^depth must have one per frame, got 3\.$"):
        list(each)


def changed(name, value, at=(3, 2, 1)):
    """Change one number of a keyword."""

    def change(given):
        array = np.array(given[name], float if name != "albedo" else None)
        array[at] = value
        return {name: array}

    return change


@pytest.mark.parametrize(
    ("channel", "change", "message"),
    [
        ("depth", lambda g: {}, r"mine needs the frames' depth: give .* \(--depth\)"),
        ("object_id", lambda g: {}, r"mine needs .* object_id= \(--id\)"),
        ("motion_class", lambda g: {}, r"mine needs .* motion_class= \(--class\)"),
        ("albedo", lambda g: {}, r"mine needs .* albedo= \(--albedo\)"),
        ("coverage", lambda g: {}, r"mine needs the frames' coverage, which none has"),
        ("velocity", lambda g: {}, r"mine needs velocity, and the eye moves: give "
         r"velocity_px= \(--velocity\), or depth= \(--depth\)"),
        ("velocity", lambda g: {"object_poses": g["object_poses"], "depth": g["depth"]},
         r"mine needs velocity, and objects move: give .*, or object_id= \(--id\)"),
        ("velocity", lambda g: {"depth": g["depth"], "motion_class": g["motion_class"]},
         "mine needs velocity, and motion_class says that objects move: give .*poses="),
        ("velocity", lambda g: {"depth": g["depth"], "object_id": 1 + g["object_id"],
         "object_poses": g["object_poses"]},
         r"object_id, a row of object_poses, must lie in \[0, 2\], got 3"),
        ("color", changed("depth", 0.0), r"depth must be above 0 .* m along -z, got 0"),
        ("color", changed("depth", -1.0), r"depth must be above 0 .* got -1.0"),
        ("color", changed("depth", np.nan), r"depth must be above 0 .* got nan"),
        ("color", lambda g: {"depth": np.ones(PLANE, int)}, "depth must be floating"),
        ("color", lambda g: {"depth": g["depth"][1:]},
         r"depth must have the shape \(8, 18, 24\), got \(7, 18, 24\)"),
        ("color", changed("object_id", -1), r"object_id must lie in \[0, 16777215\]"),
        ("color", changed("object_id", 1.5), "object_id must be whole .*, got 1.5"),
        ("color", changed("object_id", np.nan), "object_id must lie in .* got nan"),
        ("color", changed("motion_class", 3), r"motion_class must lie in \[0, 2\]"),
        ("color", changed("albedo", 1.5), r"albedo must lie in \[0, 1\]"),
        ("color", changed("velocity_px", np.inf), r"velocity_px must .* got inf"),
        ("color", lambda g: {"velocity_px": g["velocity_px"][..., 0]},
         r"velocity_px must have the shape \(8, 18, 24, 2\), got \(8, 18, 24\)"),
        ("color", changed("jitter_px", 1.6, (2, 1)),
         r"jitter_px must lie in \[-1.5, 1.5\], got 1.6"),
        ("color", lambda g: {"jitter_px": np.zeros((7, 2))},
         r"jitter_px must have the shape \(8, 2\), got \(7, 2\)"),
        ("color", changed("object_poses", 2.0, (1, 2, 0)), "lengths of quaternions in "
         r"object_poses must lie in \[0.99, 1.01\], got 2"),
        ("color", changed("object_poses", np.nan, (1, 2, 5)), "object_poses must"),
        ("color", lambda g: {"object_poses": g["object_poses"][:, :, :4]},
         r"object_poses must have the shape \(8, 3, 7\), got \(8, 3, 4\)"),
    ],
)  # fmt: skip
def test_what_lacks_or_cannot_be_is_told_in_one_line(
    untyped, rng, channel, change, message
):
    with pytest.raises(ValueError, match=f"^{message}") as error:
        shown(Shows(channel), walking(rng), **change(channels(rng)))
    assert "\n" not in str(error.value)


def test_objects_need_to_know_where_the_eye_is(rng):
    given = channels(rng)["object_poses"]
    with pytest.raises(ValueError, match=r"^poses must say where the eye is, \(fram"):
        shown(NoAntialiasing(), walking(rng)[:, :4], object_poses=given)


def test_what_is_being_traced_is_derived_alike(rng):
    poses, depth = walking(rng), channels(rng)["depth"]
    poses[:, 4:] -= poses[0, 4:]
    derived = lambda poses, depth: hj.apply(
        Shows("velocity"), CAMERA, np.zeros((FRAMES, *SIZE)), poses, depth=depth
    )
    traced = jax.jit(derived)(jnp.asarray(poses), jnp.asarray(depth))
    np.testing.assert_allclose(traced, derived(poses, depth), rtol=0, atol=1e-9)
