import dataclasses
import functools
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
import small
from scipy.spatial.transform import Rotation
from small import CAMERA, FRAMES, HEIGHT, STILL, WARMUP, WIDTH, path, quickly

import hmdjit as hj
from hmdjit import rendering
from hmdjit.curves import Cosine, Spline
from hmdjit.frames.displacement import GATHER
from hmdjit.simulation import session
from hmdjit.simulation.halo import HALO_TOLERANCE, needed_halo_px
from hmdjit.technique_contract.base import AbstractTechnique
from hmdjit.techniques import MSAA, SSAA, Freeze, HeadMovement, NoAntialiasing


@jax.jit
def rendered(texture, offsets, samples):
    """Frames `(frames, samples, h, w, 3)`, and their references."""

    def at(offset):
        region = hj.Region.whole(CAMERA)
        now = hj.Motion(offset, offset)
        frame = rendering.render(texture, CAMERA, region, now, samples)
        reference = rendering.reference(texture, CAMERA, region, now)
        return jnp.moveaxis(frame.color, 1, -1), jnp.moveaxis(reference, 0, -1)

    return jax.lax.map(at, offsets)


def offsets_of(poses):
    rotations = Rotation.from_quat(poses, scalar_first=True)
    return jnp.asarray((rotations[0].inv() * rotations).as_rotvec())


def simulated(technique, texture, poses, **options):
    return hj.simulate(texture, CAMERA, technique, jnp.asarray(poses), **options)


# --- what a session measures ---


@pytest.mark.parametrize(
    ("technique", "warmup"),
    [
        pytest.param(SSAA(2), 3, marks=pytest.mark.slow),
        pytest.param(HeadMovement(w_min=0.2), 0, marks=pytest.mark.slow),
        (HeadMovement(w_min=0.2), WARMUP),
    ],
    ids=["ssaa2, warm", "head_movement", "head_movement, warm"],
)
def test_a_session_measures_what_apply_displays(rng, technique, warmup):
    texture, poses = small.texture(rng), path(rng)
    samples = jnp.asarray(technique.sample_offsets_px[0])
    frames, references = rendered(texture, offsets_of(poses), samples)
    shown = np.asarray(hj.apply(technique, CAMERA, frames, poses))
    ours = simulated(technique, texture, poses, warmup=warmup)
    # Warm-up frames are displayed, but not measured, nor is the step out of them.
    mtcd = oracles.mtcd(shown[warmup:])
    loss = oracles.mse(255 * shown[warmup:], 255 * np.asarray(references)[warmup:])
    assert mtcd > 1
    np.testing.assert_allclose(ours.mtcd, mtcd, rtol=1e-10)
    np.testing.assert_allclose(ours.detail_loss, loss, rtol=1e-10)


class Counting(AbstractTechnique):
    """Shows uniform pictures of given levels, one after the other."""

    levels: jax.Array

    @property
    def id(self):
        return "counting"

    def init(self, frame):
        return jnp.zeros((), jnp.int32)

    def step(self, state, frame, motion):
        TRACED.append(frame)
        picture = jnp.ones_like(frame.color[0]) * self.levels[state]
        return state + 1, picture


TRACED = []  # the frames that `Counting` was handed, one per trace


@pytest.mark.slow
def test_every_frame_is_stepped_once_and_frames_minus_one_pairs_are_measured(rng):
    levels = rng.random(FRAMES)
    technique = Counting(jnp.asarray(levels))
    grey = np.repeat(levels[:, None], 3, axis=1)[:, None, None]
    for warmup in (0, FRAMES - 3):
        ours = simulated(technique, small.texture(rng), path(rng), warmup=warmup)
        expected = oracles.mtcd(grey[warmup:])
        np.testing.assert_allclose(ours.mtcd, expected, rtol=1e-12)


@pytest.mark.slow
def test_one_compilation_serves_all_numbers(rng):
    def traced():  # but for a small frame at the door
        return sum(frame.color.shape[-2:] == (HEIGHT, WIDTH) for frame in TRACED)

    # Camera, poses, texture, region and the technique's numbers are leaves.
    simulated(Counting(jnp.asarray(rng.random(FRAMES))), small.texture(rng), path(rng))
    traces = traced()
    assert traces >= 1
    technique = Counting(jnp.asarray(rng.random(FRAMES)))
    camera = hj.Camera(WIDTH, HEIGHT, fov_deg=2.0, refresh_hz=90.0)
    poses = jnp.asarray(path(rng))
    whole = hj.Region(0, 0, WIDTH, HEIGHT)
    hj.simulate(small.texture(rng), camera, technique, poses)
    hj.simulate(small.texture(rng), camera, technique, poses, region=whole)
    assert traced() == traces


def test_one_compilation_serves_all_numbers_of_head_movement(rng):
    texture, poses = small.texture(rng), jnp.asarray(path(rng))

    @quickly
    @eqx.debug.assert_max_traces(max_traces=1)
    def mtcd(technique):
        return hj.simulate(texture, CAMERA, technique, poses, reading=GATHER).mtcd

    values = [
        mtcd(HeadMovement(w_min=w_min, h_max_deg_s=h_max, closeness=(d,)))
        for w_min, h_max, d in [(0.3, 25.0, 0.5), (0.2, 25.0, 0.5), (0.2, 40.0, 0.9)]
    ]
    assert len({float(value) for value in values}) == 3


def test_a_technique_is_handed_colour_and_nothing_else(rng):
    technique, texture = Counting(jnp.zeros(FRAMES)), small.texture(rng)
    jax.eval_shape(lambda poses: simulated(technique, texture, poses), path(rng))
    assert TRACED
    for frame in TRACED:
        # At the door also a small one.
        assert frame.color.shape in ((1, 3, HEIGHT, WIDTH), (1, 3, 31, 33))
        assert frame.static_mask is None
        others = jax.tree.leaves(eqx.tree_at(lambda f: f.color, frame, None))
        assert all(jnp.ndim(number) == 0 for number in others)  # camera and region


def program(technique, texture):
    """The arguments that a compiled session keeps, and the shapes it carries."""
    region = hj.Region.whole(CAMERA)

    def run(offset, increment):
        motion = hj.Motion(offset, increment)
        return session.session(
            texture, CAMERA, (technique,), motion, region, region, warmup=0
        )

    zeros = jnp.zeros((FRAMES, 3))
    text = jax.jit(run).lower(zeros, zeros).as_text()
    (signature,) = re.findall(r"@main\((.*?)\) ->", text)
    jaxpr = jax.make_jaxpr(run)(zeros, zeros)
    (scan,) = (e for e in jaxpr.eqns if e.primitive.name == "scan")
    first = scan.params["num_consts"]
    carried = scan.invars[first : first + scan.params["num_carry"]]
    return signature.count("%arg"), [v.aval.shape for v in carried if v.aval.ndim]


def test_a_program_holds_only_what_its_technique_needs(rng):
    texture = small.texture(rng)
    displayed, history = (3, HEIGHT, WIDTH), (1, 1, 3, HEIGHT, WIDTH)
    sums = [(2, 2), (2, 2)]  # of a metric each, and what rounding took from them
    # Spatial techniques carry the displayed picture, for MTCD, and no history; how the
    # head turned since the last frame is not even an argument. What a history displays
    # is not carried twice.
    assert program(NoAntialiasing(), texture) == (1, [displayed, *sums])
    assert program(SSAA(2), texture) == (1, [displayed, *sums])
    assert program(HeadMovement(), texture) == (2, [history, *sums])
    linear = HeadMovement(space="linear")
    assert program(linear, texture) == (2, [history, displayed, *sums])


@pytest.mark.slow
def test_what_does_not_remember_does_not_run_its_warm_up(rng):
    texture, poses = small.texture(rng), path(rng)
    others = poses.copy()
    others[1:3] = path(rng)[1:3]  # the first pose stays: the hold pose
    for technique, is_same in [(NoAntialiasing(), True), (HeadMovement(), False)]:
        results = [simulated(technique, texture, p, warmup=3) for p in (poses, others)]
        assert (results[0].mtcd == results[1].mtcd) == is_same


# --- exact relations between techniques ---


@pytest.mark.slow
def test_on_a_picture_multisampling_changes_nothing(rng):
    texture, poses = small.texture(rng, dtype=jnp.float32), path(rng).astype(np.float32)
    for plain, multisampled in [
        (NoAntialiasing(), MSAA(4)),
        (HeadMovement(), HeadMovement(resolve=MSAA(8))),
    ]:
        ours, expected = (simulated(t, texture, poses) for t in (multisampled, plain))
        assert ours.mtcd.dtype == jnp.float32
        assert (ours.mtcd, ours.detail_loss) == (expected.mtcd, expected.detail_loss)


@pytest.mark.slow
def test_a_frozen_picture_does_not_flicker_and_the_reference_loses_nothing(rng):
    texture, poses = small.texture(rng, dtype=jnp.float32), path(rng).astype(np.float32)
    frozen = simulated(Freeze(), texture, poses)
    assert frozen.mtcd == 0
    assert frozen.detail_loss > 0
    reference = simulated(SSAA(4), texture, poses)
    assert reference.detail_loss == 0
    assert reference.mtcd > 0


@pytest.mark.slow
def test_a_fast_head_sees_no_antialiasing(rng):
    texture, poses = small.texture(rng), path(rng)
    kim = HeadMovement(h_max_deg_s=0.05)  # the head turns by some 3 deg/s
    ours, expected = (simulated(t, texture, poses) for t in (kim, NoAntialiasing()))
    # Two programs may sum in another order.
    np.testing.assert_allclose(ours.mtcd, expected.mtcd, rtol=1e-13)
    np.testing.assert_allclose(ours.detail_loss, expected.detail_loss, rtol=1e-13)


@pytest.mark.slow
def test_float32_agrees_with_float64(rng):
    texture, poses = small.texture(rng), path(rng)
    exact = simulated(HeadMovement(), texture, poses)
    narrow = jax.tree.map(lambda x: x.astype(jnp.float32), texture)
    # NumPy poses, float64 or not, are simulated in float32.
    ours = hj.simulate(narrow, CAMERA, HeadMovement(), poses)
    assert ours.mtcd.dtype == jnp.float32
    # Displacements of 1 px err by 1e-6 px, colours by 1e-6 of code values of some 10.
    np.testing.assert_allclose(ours.mtcd, exact.mtcd, rtol=1e-5)
    np.testing.assert_allclose(ours.detail_loss, exact.detail_loss, rtol=1e-5)


@pytest.mark.parametrize(
    ("poses_dtype", "texture_dtype", "expected"),
    [
        (jnp.float64, jnp.float32, jnp.float64),
        (jnp.float32, jnp.bfloat16, jnp.float32),
    ],
)
def test_the_longer_float_of_poses_and_texture_is_simulated(
    rng, poses_dtype, texture_dtype, expected
):
    texture = small.texture(rng, dtype=texture_dtype)
    poses = jnp.asarray(path(rng), poses_dtype)
    simulate = lambda poses: hj.simulate(texture, CAMERA, NoAntialiasing(), poses)
    assert jax.eval_shape(simulate, poses).mtcd.dtype == expected


def test_the_world_has_no_direction(rng):
    # Turned as a whole, a path is the same session.
    texture, poses = small.texture(rng), path(rng)
    rotations = Rotation.random(rng=rng) * Rotation.from_quat(poses, scalar_first=True)
    turned = rotations.as_quat(scalar_first=True)
    turned[2] *= -1  # the same rotation
    ours, expected = (
        simulated(HeadMovement(), texture, p, warmup=WARMUP) for p in (turned, poses)
    )
    np.testing.assert_allclose(ours.mtcd, expected.mtcd, rtol=1e-11)


@pytest.mark.slow
def test_a_scene_is_baked_at_the_door():
    scene = hj.scenes.zone_plate()
    camera = hj.Camera(width_px=16, height_px=12, fov_deg=20.0)
    poses = jnp.asarray(path(np.random.default_rng(3), 3, camera=camera))
    ours = hj.simulate(scene, camera, NoAntialiasing(), poses)
    texture = hj.scenes.bake(scene, camera, dtype=jnp.float64)
    expected = hj.simulate(texture, camera, NoAntialiasing(), poses)
    assert (ours.mtcd, ours.detail_loss) == (expected.mtcd, expected.detail_loss)
    assert ours.mtcd > 0


# --- tiles ---

WIDE = hj.Camera(width_px=160, height_px=120, fov_deg=50.0, refresh_hz=60.0)
BLOCK = hj.Region(64, 56, 16, 16)
FAR = HeadMovement(w_min=0.2, w_lb=0.15, closeness=(0.1,))  # a long memory, moved far


def drift(frames=10, speed_deg_s=6.0):
    """A head that keeps turning left, up and over."""
    axis = np.array([0.4, 0.9, 0.1])
    axis /= np.linalg.norm(axis)
    turn = np.radians(speed_deg_s) / WIDE.refresh_hz * axis
    return oracles.poses_after(np.tile(turn, (frames - 1, 1)))


@pytest.fixture(scope="module")
def halo():
    motion = hj.Motion.of(jnp.asarray(drift()))
    motion = jax.tree.map(lambda leaf: leaf[None], motion)
    origins = np.array([[[BLOCK.x0, BLOCK.y0]]], np.int32)
    (needed,) = needed_halo_px(FAR, WIDE, motion, origins, (16, 16))
    assert 4 <= needed <= 32
    return int(needed)


def within(clip, block):
    rows, columns = (slice(a, a + 16) for a in (block.y0, block.x0))
    return np.asarray(clip)[:, rows, columns]


def test_nothing_beyond_the_halo_reaches_the_block(rng, halo):
    frames = rng.random((10, 120, 160, 3))
    poses = drift()
    expected = within(hj.apply(FAR, WIDE, jnp.asarray(frames), poses), BLOCK)

    def effect(halo):
        rows, columns = (slice(a - halo, a + 16 + halo) for a in (BLOCK.y0, BLOCK.x0))
        worst = np.round(1 - frames)  # as far away as colours can be
        worst[:, rows, columns] = frames[:, rows, columns]
        shown = within(hj.apply(FAR, WIDE, jnp.asarray(worst), poses), BLOCK)
        return np.abs(shown - expected).max()

    assert effect(halo) < HALO_TOLERANCE
    # It is the halo that keeps it out, and it is not far too wide.
    assert effect(halo // 3) > HALO_TOLERANCE


@pytest.mark.slow
def test_a_tile_measures_the_same_as_its_block_of_the_whole_frame(rng, halo):
    texture, poses = small.texture(rng, WIDE, 24, blur_px=0.6), jnp.asarray(drift())
    whole = hj.Region.whole(WIDE)
    side = 16 + 2 * halo
    tile = hj.Region(BLOCK.x0 - halo, BLOCK.y0 - halo, side, side)

    @jax.jit
    def measured(region):
        motion = hj.Motion.of(poses)
        return session.session(texture, WIDE, (FAR,), motion, region, BLOCK, warmup=2)[
            0
        ]

    ours, expected = measured(tile), measured(whole)
    # Each pixel of each frame errs by less than the tolerance, all in one direction.
    colour = 255 * HALO_TOLERANCE
    assert expected.mtcd > 1
    np.testing.assert_allclose(
        ours.mtcd, expected.mtcd, rtol=0, atol=2 * np.sqrt(3) * colour
    )
    rms = np.sqrt(expected.detail_loss)
    np.testing.assert_allclose(
        ours.detail_loss,
        expected.detail_loss,
        rtol=0,
        atol=2 * rms * colour + colour**2,
    )


@pytest.mark.slow
def test_a_region_may_be_simulated_alone(rng):
    texture, poses = small.texture(rng), jnp.asarray(path(rng))
    part = hj.Region(4, 6, 8, 8)
    ours = hj.simulate(texture, CAMERA, NoAntialiasing(), poses, region=part)
    frames, _ = rendered(texture, offsets_of(poses), jnp.zeros((1, 2)))
    expected = oracles.mtcd(np.asarray(frames)[:, 0, 6:14, 4:12])
    np.testing.assert_allclose(ours.mtcd, expected, rtol=1e-10)


# --- where a session ends ---


def test_a_head_that_leaves_the_margin_is_refused(rng):
    texture = small.texture(rng)
    turns = np.tile([0.0, 3.0 / float(CAMERA.focal_px), 0.0], (FRAMES - 1, 1))
    poses = oracles.poses_after(turns)
    message = (
        r"^poses must stay within the texture's margin of 16 px, got up to 21.\d px"
    )
    with pytest.raises(ValueError, match=message):
        simulated(NoAntialiasing(), texture, poses)

    @jax.jit
    def traced(poses):
        return hj.simulate(texture, CAMERA, NoAntialiasing(), poses)

    result = traced(jnp.asarray(poses))
    assert jnp.isnan(result.mtcd)
    assert jnp.isnan(result.detail_loss)
    result = traced(jnp.asarray(poses[::-1][:4].repeat(2, axis=0)))
    assert jnp.isfinite(result.mtcd)


def test_numbers_out_of_range_inside_compiled_code_are_nan(rng):
    camera = hj.Camera(4, 3, 1.5, 60.0)
    texture = small.texture(rng, camera, 4)
    still = jnp.asarray(STILL[:2])
    good = (60.0, 25.0, 1.0, 2.0, (0.2, 0.3, 0.5))

    def flicker(refresh_hz, h_max, weight, exponent, increments):
        technique = HeadMovement(
            h_max_deg_s=h_max,
            closeness=(0.2, 0.7),
            weights=(weight, 1.0),
            ease=Cosine(exponent),
            localization=Spline(increments),
        )
        seen_by = dataclasses.replace(camera, refresh_hz=refresh_hz)
        return hj.simulate(texture, seen_by, technique, still, reading=GATHER).mtcd

    compiled = quickly(flicker)
    assert jnp.isfinite(compiled(*good))
    bad = (np.inf, np.inf, np.inf, 0.4, (0.2, -0.3, 0.5))
    for n, number in enumerate(bad):
        assert jnp.isnan(compiled(*good[:n], number, *good[n + 1 :])), number
    for increments in ((0.0, 0.0, 0.0), (0.2, np.nan, 0.5)):
        assert jnp.isnan(compiled(*good[:4], increments))


def test_a_long_sum_keeps_what_rounding_takes_from_it():
    camera, frames = hj.Camera(4, 3, 1.5, 60.0), 10_000
    levels = jnp.tile(jnp.asarray([0.0, 0.1], jnp.float32), frames // 2)
    texture = small.texture(np.random.default_rng(1), camera, 4, dtype=jnp.float32)
    still = np.tile(STILL[:1], (frames, 1))
    ours = hj.simulate(texture, camera, Counting(levels), still, reading=GATHER).mtcd
    # Rounded a few times; of equal terms a plain sum loses the same over and over.
    exact = 3**0.5 * 0.1
    assert float(ours) == pytest.approx(255 * exact, rel=4e-7)
    plain = np.cumsum(np.full(frames, exact, np.float32))[-1]
    assert plain != pytest.approx(frames * exact, rel=1e-5)


@pytest.mark.parametrize(
    ("poses", "warmup", "message"),
    [
        (
            STILL,
            FRAMES - 1,
            r"^poses must hold at least 2 frames after warmup = 7, got 8",
        ),
        (STILL, -1, r"^warmup must be a whole number >= 0, got -1.$"),
        (
            STILL[:, :3],
            0,
            r"^poses must have the shape \(frames, 4\), or .*, got \(8, 3\).$",
        ),
        (STILL[0], 0, r"^poses must have the shape \(frames, 4\), or .*, got \(4,\).$"),
        (STILL[:0], 0, r"^poses must have at least 1 row, got 0.$"),
        (2 * STILL, 0, r"^poses\[0\] must have a length in \[0.99, 1.01\], got 2.$"),
        (np.nan * STILL, 0, r"^poses\[0\] must have a length in .*, got nan.$"),
    ],
)
def test_what_is_no_session_is_refused(rng, untyped, poses, warmup, message):
    texture = small.texture(rng)
    with pytest.raises(ValueError, match=message):
        hj.simulate(texture, CAMERA, NoAntialiasing(), poses, warmup=warmup)


def test_whole_numbers_are_fine_as_poses(rng, untyped):
    # JAX's made the motion whole numbers too, which have no eps.
    measured = functools.partial(
        hj.simulate, small.texture(rng), CAMERA, NoAntialiasing()
    )
    still = jnp.asarray(STILL, jnp.float32)
    whole = jax.eval_shape(measured, still.astype(int))
    assert whole == jax.eval_shape(measured, still)


def test_a_texture_of_another_camera_is_refused(rng):
    other = hj.Camera(CAMERA.width_px + 8, CAMERA.height_px, CAMERA.fov_deg, 60.0)
    with pytest.raises(ValueError, match="scene must be a texture baked for this"):
        hj.simulate(small.texture(rng), other, HeadMovement(), path(rng))
