"""Gradients of whole sessions at the ends of all numbers, and long runs.

Every technique's numbers at the ends of their ranges, pictures that are black, equal,
one pixel wide or far brighter than white, and heads at rest, at the fastest blended
speed up to rounding, and turned so far that nothing seen before is in view: all
gradients must be numbers. What is out of range must not spread, and roundings of a
hundred thousand frames must not add up.
"""

import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from extremes import bad_leaves, cast, poses_of_turn, techniques, wandering_poses

import hmdjit as hj
from hmdjit import camera_bounds, curves, metrics, quaternion, scenes
from hmdjit.camera import Camera, Region
from hmdjit.envelope.arguments import ANGLES, RATES_HZ, TIMES_S, unit
from hmdjit.frames.displacement import GATHER
from hmdjit.frames.frame import Frame
from hmdjit.frames.motion import Motion
from hmdjit.frames.sources import History
from hmdjit.head_motion import HeadMotion
from hmdjit.head_motion.parameters import Amplitude, Resonator
from hmdjit.techniques import HeadMovement, NoAntialiasing
from hmdjit.theory.picture_statistics import PictureStatistics
from hmdjit.theory.prediction import predict

SINGLE, BOTH = ["float32"], ["float32", "float64"]
DISPLAY = Camera(48, 48, 6.0, 60.0)
REGION = Region(16, 16, 12, 12)
TURNS_RAD = (0.0, 1e-30, 1e-12, 1e-7, 1e-4, 1e-2, 1.0, np.pi / 2, np.pi - 1e-6, np.pi)


@functools.cache
def texture_of_noise():
    scene = scenes.power_law_noise(size=64)
    return scenes.bake(scene, DISPLAY, oversampling=1, margin_deg=6.0)


# --- gradients ---


def pictures(rng, size):
    shape = (3, *size, 3)
    for level in (0.0, 1e-30, 1e-8, 0.5, 1.0, 1e6):
        yield np.full(shape, level)
        yield level * rng.random(shape)


@jax.jit
@jax.value_and_grad
def clip_flicker(arguments):
    technique, camera, frames, turn_rad = arguments
    samples = technique.sample_offsets_px.shape[1]
    if samples > 1:
        frames = jnp.broadcast_to(frames[:, None], (3, samples, *frames.shape[1:]))
    return metrics.mtcd(hj.apply(technique, camera, frames, poses_of_turn(turn_rad)))


def cases_of_clips():
    for name in techniques():
        sizes = (
            [(4, 5), (1, 1), (1, 6), (6, 1)] if name == "one past sample" else [(4, 5)]
        )
        for size in sizes:
            is_quick = name == "one past sample" and size == (4, 5)
            yield pytest.param(name, size, marks=() if is_quick else pytest.mark.slow)


@pytest.mark.parametrize(("name", "size"), list(cases_of_clips()))
def test_gradients_of_a_clips_flicker_are_numbers(name, size, rng):
    for n, technique in enumerate(techniques()[name]):
        for k, turn in enumerate(TURNS_RAD):
            frames = list(pictures(rng, size))[(7 * n + 5 * k) % 12]
            fov = (0.1, 16.0, 96.0, 179.9)[(n + k) % 4]
            speed = float(technique.h_max_deg_s)
            if k % 3 == 2 and 1e-6 < speed < 1e6:  # at h_max, up to rounding
                turn = np.deg2rad(speed / 60.0) / np.hypot(0.1, 1.0)
            camera = Camera(size[1], size[0], fov, 60.0)
            given = cast((technique, camera, frames, turn), "float32")
            assert bad_leaves(clip_flicker(given)) == 0, f"{n}: {fov} deg, {turn!r} rad"


@pytest.mark.slow
@pytest.mark.parametrize("frames", [2, 3])
def test_gradients_of_sessions_are_numbers(frames):
    display = Camera(24, 20, 12.0, 60.0)
    scene = scenes.power_law_noise(size=32)
    texture = scenes.bake(scene, display, oversampling=1, dtype=jnp.dtype("float32"))

    @jax.jit
    @jax.value_and_grad
    def loss(arguments):
        technique, camera, turn_rad = arguments
        poses, region = poses_of_turn(turn_rad)[:frames], Region(4, 4, 8, 8)
        result = hj.simulate(
            texture, camera, technique, poses, region=region, reading=GATHER
        )
        return result.mtcd + result.detail_loss

    for n, technique in enumerate(techniques()["one past sample"]):
        for turn in (0.0, 1e-30, 1e-12, 1e-7, 1e-4, 1e-2):
            given = cast((technique, display, turn), "float32")
            assert bad_leaves(loss(given)) == 0, f"numbers {n}, {turn!r} rad"


@pytest.mark.slow
@pytest.mark.parametrize("dtype", BOTH)
@pytest.mark.parametrize("memory", [0, 4])
def test_gradients_of_predictions_are_numbers(memory, dtype):
    statistics = PictureStatistics.of(texture_of_noise(), DISPLAY, cell_px=48)

    @jax.jit
    @jax.value_and_grad
    def flicker(arguments):
        statistics, technique, turn_rad = arguments
        motion = Motion.of(poses_of_turn(turn_rad))
        found = predict(statistics, DISPLAY, technique, motion, memory=memory)
        return jnp.mean(found)

    for technique in (NoAntialiasing(), *techniques()["one past sample"]):
        for turn in TURNS_RAD:
            given = cast((statistics, technique, turn), dtype)
            assert bad_leaves(flicker(given)) == 0, f"{technique!r}, {turn!r} rad"


def heads():
    """Heads at rest, slow, stiff, resonant, in bursts, and a rate each, Hz."""
    for n, (time, back) in enumerate((a, b) for a in TIMES_S for b in TIMES_S):
        rate = RATES_HZ[n % 5]
        frequency = (3.0, rate / 2, rate, 1e-2)[n % 4]
        damping = (1.0, 1e-3, 2.0)[n % 3]
        for speed, noise in ((0.0, 0.0), (1.0, 0.0), (0.0, 0.01), (1e-30, 0.0)):
            swing = speed * (n // 4 % 2)  # half of the heads have no moving mode
            mode = Resonator((swing,) * 3, (frequency,) * 3, (damping,) * 3)
            bursts = Amplitude((0.0, 0.5)[n // 8 % 2], time)
            per_axis = (speed,) * 3, (time,) * 3, (noise,) * 3
            person_sd = (0.2, 0.0)[n // 8 % 2]
            yield HeadMotion(*per_axis, back, person_sd, (mode,), bursts), rate


def laws(head, rate, key):
    del key
    return (
        head.increment_rms_deg(rate)
        + jnp.sum(head.increment_covariance(1, rate))
        + jnp.sum(head.velocity_spectrum(rate / 3))
        + jnp.sum(head.sampled_velocity_spectrum(0 * rate, rate))
        + jnp.sum(head.structure_function(1e3 / rate))
        + jnp.sum(head.covariance(1e6 / rate))
    )


def kurtosis(head, rate, key):
    del rate, key
    return jnp.sum(head.increment_kurtosis(60.0, memory_s=0.5))


def drawn(head, rate, key):
    return jnp.sum(quaternion.increments(head.sample(key, rate, 6)) ** 2)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", BOTH)
@pytest.mark.parametrize("score", [laws, kurtosis, drawn])
def test_gradients_of_heads_are_numbers(score, dtype):
    slopes = jax.jit(jax.value_and_grad(score, (0, 1)))
    for n, (head, rate) in enumerate(heads()):
        given = cast((head, rate), dtype)
        bad = bad_leaves(slopes(*given, jax.random.key(n)))
        assert bad == 0, f"{head!r} at {rate:g} Hz"


# --- what is out of range ---


@pytest.mark.parametrize("dtype", BOTH)
def test_in_a_batch_only_wrong_sessions_are_nan(dtype, rng):
    texture = cast(texture_of_noise(), dtype)
    poses = jnp.asarray(np.stack([wandering_poses(rng, 4, 1e-3)] * 8), dtype)
    poses = poses.at[1, 2].set(jnp.nan).at[2, 1].multiply(1.5).at[3, 3].set(0.0)
    w_min = jnp.asarray([0.3, 0.3, 0.3, 0.3, 1.5, 0.3, 0.3, 0.3], dtype)
    h_max = jnp.asarray([25, 25, 25, 25, 25, -1, 25, 25], dtype)
    fov = jnp.asarray([6.0, 6, 6, 6, 6, 6, 180, 6], dtype)

    @jax.jit
    @jax.vmap
    def flicker(poses, w_min, h_max, fov):
        technique = HeadMovement(w_min=w_min, h_max_deg_s=h_max)
        camera = eqx.tree_at(lambda c: c.fov_deg, DISPLAY, fov)
        found = hj.simulate(
            texture, camera, technique, poses, region=REGION, reading=GATHER
        )
        return found.mtcd

    is_nan = np.isnan(np.asarray(flicker(poses, w_min, h_max, fov)))
    assert is_nan.tolist() == [False, True, True, True, True, True, True, False]


@pytest.mark.parametrize("dtype", BOTH)
def test_displacements_lie_within_their_range(dtype, rng):
    region = Region(100, 0, 64, 48)
    corners = np.stack([[100.0, 164.0, 132.0, 100.5], [0.0, 48.0, 24.0, 47.5]])

    @jax.jit
    def both(fov, rotation):
        display = Camera(640, 480, fov, 60.0)
        span = camera_bounds.displacement_range(display, region, rotation)
        moved = hj.camera.displacement(display, rotation, *jnp.asarray(corners, dtype))
        return span, jnp.stack(moved[:2]), moved[2]

    for n, angle in enumerate([*ANGLES, *10 ** rng.uniform(-9, 0, 20)]):
        fov = (0.1, 16.0, 96.0, 170.0)[n % 4]
        given = cast((fov, angle * unit(rng.normal(size=3))), dtype)
        span, moved, in_front = map(np.asarray, both(*given))
        is_within = (span[0][:, None] <= moved) & (moved <= span[1][:, None])
        assert (is_within | ~in_front).all(), f"{angle!r} rad at {fov} deg"


def test_curves_are_nowhere_steeper_than_the_bound_that_sizes_halos(rng):
    share = jnp.linspace(0, 1, 1001)
    exponents = (0.5, 1.0, *10 ** rng.uniform(-0.3, 2, 20))
    every = [curves.Linear(), curves.Kim(), *map(curves.Cosine, exponents)]
    every += [curves.Spline(tuple(r)) for r in rng.exponential(size=(20, 5)) ** 4]
    for curve in every:
        slopes = jax.vmap(jax.grad(curve))(share)
        assert float(jnp.max(slopes)) <= float(curve.steepest) * (1 + 1e-12), curve


# --- long runs ---


@pytest.mark.slow
# Roundings add up, at most one eps each; poses are taken to 1 % of their length.
@pytest.mark.parametrize(
    ("dtype", "bound"), [("float32", 0.01), ("float64", 1e6 * 2**-52)]
)
def test_a_million_composed_poses_keep_their_length(dtype, bound, rng):
    turns = jax.vmap(quaternion.exp)(jnp.asarray(1e-3 * rng.normal(size=(10**6, 3))))
    turns = turns.astype(dtype)

    @jax.jit
    def composed(turns):
        advance = lambda q, turn: (quaternion.multiply(q, turn), None)
        start = jnp.asarray([1.0, 0, 0, 0], turns.dtype)
        return jax.lax.scan(advance, start, turns)[0]

    def log_size(q):
        return np.log1p(np.sum(np.square(np.asarray(q, np.float64)), -1) - 1) / 2

    # The turns' own lengths are off 1 by rounding: what they make of it is no drift.
    assert abs(log_size(composed(turns)) - math.fsum(log_size(turns))) <= bound


@pytest.mark.slow
def test_a_still_scene_keeps_its_mean_over_a_hundred_thousand_blends(rng):
    display, technique = Camera(32, 24, 4.0, 60.0), HeadMovement(w_min=0.05, w_lb=0.05)
    technique = cast(technique, "float32")
    grey = jnp.full((1, 3, 24, 32), 0.3, "float32")
    turns = jnp.asarray(1e-4 * rng.normal(size=(100_000, 3)), "float32")

    @jax.jit
    def shown(grey, turns):
        frame = Frame(grey, display, Region.whole(display))
        start = History.of(technique.init(frame).texels[0, 0] * 1.01)
        step = lambda state, r: (technique.step(state, frame, Motion(r, r))[0], None)
        return jax.lax.scan(step, start, turns)[0].texels

    found = np.asarray(shown(grey, turns), np.float64)
    # A step of w times the rest is lost below half an ulp: eps / 2 w, twice.
    assert np.max(np.abs(found / float(grey[0, 0, 0, 0]) - 1)) <= 2.0**-23 / 0.05


@pytest.mark.slow
def test_sessions_keep_a_few_vectors_per_frame_and_no_picture():
    texture = cast(texture_of_noise(), "float32")

    def working_bytes(frames):
        given = jax.ShapeDtypeStruct((frames, 4), jnp.float32)
        session = jax.jit(
            lambda poses: hj.simulate(
                texture, DISPLAY, HeadMovement(), poses, region=REGION, reading=GATHER
            )
        )
        used = session.lower(given).compile().memory_analysis()
        assert used is not None
        return used.temp_size_in_bytes

    # A picture that were kept would have 1,728 bytes per frame.
    assert (working_bytes(100_000) - working_bytes(1_000)) / 99_000 <= 256


@pytest.mark.slow
@pytest.mark.parametrize("dtype", BOTH)
@pytest.mark.parametrize("frames", [1, 2, 50, 100_000])
def test_drawn_poses_are_unit_quaternions_at_all_rates_and_times(frames, dtype, rng):
    draw = jax.jit(lambda key, head, rate: head.sample(key, rate, frames, dtype=dtype))
    for n, (time, back) in enumerate((a, b) for a in TIMES_S for b in TIMES_S):
        key = jax.random.key(int(rng.integers(2**31)))
        numbers = cast((time, back, RATES_HZ[n % 5]), dtype)
        head = HeadMotion((1.0,) * 3, (numbers[0],) * 3, (0.01,) * 3, numbers[1])
        poses = np.asarray(draw(key, head, numbers[2]), float)
        assert (np.abs(np.linalg.norm(poses, axis=1) - 1) < 1e-5).all(), (time, back)
        if n > 10 and frames > 50:
            break
