import functools
import time

import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
import scipy.ndimage
from jax.flatten_util import ravel_pytree
from small import quickly

import hmdjit as hj
from hmdjit import curves
from hmdjit.simulation.session import session
from hmdjit.studies.measured_blocks import Tiles
from hmdjit.studies.runner import Runner
from hmdjit.studies.sessions import Sessions
from hmdjit.techniques import MSAA, SSAA, Freeze, HeadMovement, NoAntialiasing
from hmdjit.theory import prediction as theory
from hmdjit.theory.picture_statistics import PictureStatistics, cell_numbers

SIZE, CELL, MARGIN_PX = 64, 8, 24
CAMERA = hj.Camera(SIZE, SIZE, fov_deg=4.0)
FOCAL_PX = float(CAMERA.focal_px)
WARMUP, FRAMES = 3, 8
OFF_CENTRE = 3 * (SIZE // CELL) + 5  # a cell above the centre and right of it
INNER = np.arange(64).reshape(8, 8)[2:6, 2:6].ravel()  # far from the frame's edge

# Weights that do not depend on the picture: what is left is the recursion.
Plain = functools.partial(HeadMovement, w_min=0.3, w_lb=0.3, h_max_deg_s=1e9)
VARIANTS = {
    "none": NoAntialiasing(),
    "head_movement": Plain(),
    "not reprojected": Plain(closeness=(1.0,)),
    "tracked": Plain(closeness=(0.0,)),
    "two samples": Plain(closeness=(1 / 3, 0.9), weights=(1.0, 3.0)),
}


def texture_of(color, reference=None):
    color = jnp.asarray(color)
    reference = color if reference is None else jnp.asarray(reference)
    return hj.Texture.of(color, reference, 2, MARGIN_PX)


def ramp(gradient):
    """A picture with one gradient `(3, 2)`, per px: bilinear reads of it are exact."""
    side = 2 * (SIZE + 2 * MARGIN_PX)
    y, x = np.mgrid[:side, :side] / 2 - side / 4
    return texture_of(0.5 + np.stack([x, y], axis=-1) @ np.asarray(gradient).T)


def noise(rng, blur_px):
    side = 2 * (SIZE + 2 * MARGIN_PX)
    return texture_of(
        *(oracles.smooth_noise(rng, side, side, 2 * blur_px) for _ in "cr")
    )


GREY = ramp(np.outer([1.0, 1.0, 1.0], [0.003, -0.002]))  # parallel gradients
COLORED = ramp([[0.003, 0.001], [-0.001, 0.002], [0.0, -0.002]])


def turns_of(rng, frames=FRAMES):
    """Increments of a head, of about 1 px and axis, `(frames, 3)`; the first is 0."""
    turns = rng.normal(size=(frames, 3)) / FOCAL_PX
    return np.concatenate([np.zeros((1, 3)), turns[1:]])


def motion_of(turns):
    return hj.Motion.of(jnp.asarray(oracles.poses_after(np.asarray(turns)[1:])))


@functools.partial(quickly, static_argnames="cells")
def simulated(texture, technique, motion, cells=1):
    """Simulated MTCD in the cell off the centre, or in all of `INNER`."""
    columns, width = SIZE // CELL, CELL * cells
    row, column = (2, 2) if cells > 1 else divmod(OFF_CENTRE, columns)
    block = hj.Region(CELL * column, CELL * row, width, width)
    whole = hj.Region.whole(CAMERA)

    (result,) = session(
        texture, CAMERA, (technique,), motion, whole, block, warmup=WARMUP
    )
    return result.mtcd


def statistics_of(texture, **options):
    return PictureStatistics.of(texture, CAMERA, cell_px=CELL, **options)


def predicted(statistics, technique, motion, warmup=WARMUP, **options):
    return theory.predict(
        statistics, CAMERA, technique, motion, warmup=warmup, **options
    )


# --- what pictures differ ---


@pytest.mark.slow
def test_a_ramp_differs_by_its_gradient_times_the_displacement(rng):
    displacement = rng.normal(size=(64, 2)) * 10.0 ** rng.uniform(-3, 1.5, (64, 1))
    slope = np.asarray([0.003, -0.002]) * 3**0.5
    exact = np.abs(displacement @ slope)
    ours = statistics_of(GREY).difference(jnp.asarray(displacement))
    # The length of few displacements is near 0: relative to what it could be.
    largest = np.linalg.norm(displacement, axis=1) * np.linalg.norm(slope)
    np.testing.assert_allclose((ours / largest) ** 2, (exact / largest) ** 2, atol=1e-7)
    assert (
        statistics_of(texture_of(jnp.full((224, 224, 3), 0.3))).slope_squared == 0
    ).all()


@pytest.mark.slow
def test_differences_agree_with_another_read_of_the_picture(rng):
    texture = noise(rng, 2.0)
    cell_px, picture = SIZE // 2, np.asarray(texture.color)
    statistics = PictureStatistics.of(texture, CAMERA, cell_px=cell_px)
    # Everywhere in the upper right cell, at quarters of texels.
    texels = 2 * cell_px
    row, column = np.mgrid[: 4 * texels, : 4 * texels] / 4 + 2 * MARGIN_PX
    column = column + texels

    def read(dx, dy):
        at = [row + 2 * dy, column + 2 * dx]
        channels = np.moveaxis(picture, -1, 0)
        return np.stack(
            [scipy.ndimage.map_coordinates(c, at, order=1) for c in channels]
        )

    for length in (0.1, 0.25, 0.7, 2.0, 4.5):
        for direction in np.radians([0, 45, 80, 200]):
            u = length * np.array([np.cos(direction), np.sin(direction)])
            exact = np.mean(np.linalg.norm(read(*u) - read(0, 0), axis=0))
            ours = statistics.difference(jnp.asarray(np.tile(u, (4, 1))))[1]
            # Interpolated between lengths and directions, and from one place per pixel
            # instead of 64: 1024 places leave about 1 %.
            assert ours == pytest.approx(exact, rel=0.03)


# --- what techniques do ---


@functools.cache
def impulse_response(w_min, d, memory):
    """Displayed displacement in a frame per scene displacement n frames before."""
    frames = 70
    turns = jnp.asarray(np.eye(frames)[::-1, :, None] * [0.0, 1e-6, 0.0])
    turns = turns[: frames - 1]  # nothing moves before the second frame
    motion = hj.Motion(jnp.zeros_like(turns), turns)
    cells = jnp.asarray([OFF_CENTRE])
    technique = Plain(w_min=w_min, w_lb=w_min, closeness=(d,))
    statistics = statistics_of(GREY)

    def mtcd(technique):
        predict = functools.partial(
            predicted, statistics, technique, warmup=frames - 2, cells=cells
        )
        return jax.vmap(lambda m: predict(m, memory=memory)[0])(motion)

    return np.asarray(mtcd(technique) / mtcd(NoAntialiasing())[0])


@pytest.mark.parametrize("memory", [0, 4])
@pytest.mark.parametrize(
    ("w_min", "d"),
    [
        (0.3, 2 / 3),
        pytest.param(0.2, 1.0, marks=pytest.mark.slow),
        pytest.param(0.15, 0.0, marks=pytest.mark.slow),
    ],
)
def test_the_impulse_response_is_that_of_the_transfer_function(w_min, d, memory):
    n = np.arange(69)
    expected = d * w_min * (1 - w_min) ** n + np.where(n == 0, 1 - d, 0)
    ours = impulse_response(w_min, d, memory)
    np.testing.assert_allclose(ours, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("w_min", "white", "ou_03", "ou_05", "ou_08", "noise"),
    [
        (0.3, 0.568, 0.632, 0.692, 0.832, 0.470),
        (0.2, 0.499, 0.556, 0.612, 0.764, 0.418),
    ],
)
def test_ratios_of_stationary_heads(w_min, white, ou_03, ou_05, ou_08, noise):
    # Kim's d; velocities with a correlation from frame to frame, and position noise.
    response = impulse_response(w_min, 2 / 3, 0)
    apart = np.abs(np.subtract.outer(np.arange(69), np.arange(69)))
    for rho, expected in ((0.0, white), (0.3, ou_03), (0.5, ou_05), (0.8, ou_08)):
        ratio = np.sqrt(response @ rho**apart @ response)
        assert ratio == pytest.approx(expected, abs=6e-4)
    of_noise = np.sqrt(np.sum(np.diff(response, prepend=0, append=0) ** 2) / 2)
    assert of_noise == pytest.approx(noise, abs=6e-4)


@pytest.mark.parametrize(
    "name",
    [*list(VARIANTS)[:-1], pytest.param("two samples", marks=pytest.mark.slow)],
)
def test_simulation_tends_to_theory_as_motion_shrinks(rng, name):
    statistics, turns = statistics_of(COLORED), turns_of(rng)
    departures = []
    for amplitude_px in (1.0, 0.1, 0.01):
        motion = motion_of(amplitude_px * turns)
        mtcd = predicted(statistics, VARIANTS[name], motion, memory=0)[OFF_CENTRE]
        departures.append(float(simulated(COLORED, VARIANTS[name], motion) / mtcd - 1))
    print(f"\n{name}: departs by", *(f"{d:.1e}" for d in departures))
    # What is left at 0.01 px: how the displacement varies over 8 px, 0.5 deg. Above
    # that, the departure is proportional to the amplitude.
    at_1_px, at_01_px, left = departures
    assert abs(left) < 1e-4
    assert abs(at_1_px - left) < 1e-3
    assert abs(at_01_px - left) < 0.15 * abs(at_1_px - left)


def test_weights_that_follow_head_speed(rng):
    turns = turns_of(rng)
    fastest = np.degrees(np.linalg.norm(turns, axis=1).max()) * 60
    statistics = statistics_of(COLORED)
    for amplitude_px, bound in ((1.0, 1e-2), (0.01, 2e-4)):
        technique = Plain(h_max_deg_s=1.3 * amplitude_px * fastest)
        motion = motion_of(amplitude_px * turns)
        ours = simulated(COLORED, technique, motion)
        mtcd = predicted(statistics, technique, motion, memory=0)[OFF_CENTRE]
        assert ours == pytest.approx(float(mtcd), rel=bound)
        slow = predicted(statistics, Plain(), motion, memory=0)[OFF_CENTRE]
        assert mtcd > 1.05 * slow


@pytest.mark.slow
@pytest.mark.parametrize(
    "curve",
    [
        {"ease": curves.Cosine(0.5)},
        # Rises in the first 31st, where all differences lie.
        {"w_lb": 0.0, "localization": curves.Spline((1.0, *[0.0] * 31))},
    ],
    ids=["ease", "localization"],
)
def test_weights_of_other_curves(rng, curve):
    turns = turns_of(rng)
    fastest_deg_s = 0.03 * np.degrees(np.linalg.norm(turns, axis=1).max()) * 60
    motion, statistics = motion_of(0.03 * turns), statistics_of(COLORED)
    speeds = {"h_max_deg_s": 2 * fastest_deg_s} if "ease" in curve else {}

    def change(mtcd):  # by the curve alone
        kims = {name: value for name, value in curve.items() if name == "w_lb"}
        return float(mtcd(Plain(**speeds, **curve)) / mtcd(Plain(**speeds, **kims)) - 1)

    ours = change(lambda t: simulated(COLORED, t, motion))
    theirs = change(lambda t: predicted(statistics, t, motion, memory=0)[OFF_CENTRE])
    print(f"\nchanges by {ours:.2e}, in theory {theirs:.2e}")
    assert ours == pytest.approx(theirs, rel=0.05)
    assert abs(ours) > 1e-3


@pytest.mark.parametrize(
    ("blur_px", "left", "difference"),
    [
        (None, 0.05, "euclidean"),
        (4.0, 0.6, "euclidean"),
        pytest.param(None, 0.05, "same_pixel", marks=pytest.mark.slow),
    ],
)
def test_localised_weights_to_first_order(rng, blur_px, left, difference):
    # Where gradients differ over a cell, the mean weight takes a part of the effect.
    texture, turns = noise(rng, blur_px) if blur_px else COLORED, turns_of(rng)
    statistics, local = statistics_of(texture), Plain(w_lb=0.0, difference=difference)
    slopes = []
    for amplitude_px in (0.3, 0.03):
        motion = motion_of(amplitude_px * turns)

        def change(mtcd):  # by localisation alone
            return float(np.mean(mtcd(local)) / np.mean(mtcd(Plain())) - 1)

        ours = change(lambda t, m=motion: simulated(texture, t, m, cells=4))
        theirs = change(
            lambda t, m=motion: predicted(statistics, t, m, memory=0)[INNER]
        )
        assert ours < 0
        assert abs(ours - theirs) < left * abs(ours)
        slopes.append(ours / amplitude_px)
        print(f"\n{amplitude_px} px: changes by {ours:.2e}, in theory {theirs:.2e}")
    assert slopes[0] == pytest.approx(slopes[1], rel=0.2)


@pytest.mark.slow
def test_pictures_are_predicted_from_their_statistics(rng):
    # The bilinear history changes detail of b px by about 1 / b^2.
    motion = motion_of(0.01 * turns_of(rng))
    departures = {"none": [], "head_movement": []}
    for blur_px in (1.0, 2.0, 4.0):
        texture = noise(rng, blur_px)
        statistics = statistics_of(texture, finest_px=1 / 64, octaves=1)
        for name, listed in departures.items():
            mtcd = predicted(statistics, VARIANTS[name], motion, memory=0)[INNER]
            ours = simulated(texture, VARIANTS[name], motion, cells=4)
            listed.append(float(ours / np.mean(mtcd) - 1))
    print("\n1, 2, 4 px of blur:", departures)
    # The statistics are from 1024 places: 0.3 %.
    assert abs(departures["none"][-1]) < 0.005
    first, second, third = np.abs(departures["head_movement"])
    assert third < 0.5 * second < 0.25 * first
    assert third < 0.01


@pytest.mark.parametrize("axis", [0, 1, 2], ids=["pitch", "yaw", "roll"])
@pytest.mark.parametrize("fov_deg", [4.0, 96.0])
def test_one_axis_in_a_cell_off_the_centre(axis, fov_deg):
    camera = hj.Camera(SIZE, SIZE, fov_deg)
    statistics = PictureStatistics.of(GREY, camera, cell_px=CELL)
    turn = 1e-7 * np.eye(3)[axis]
    motion = hj.Motion(jnp.zeros((2, 3)), jnp.asarray(np.stack([0 * turn, turn])))
    cells = cell_numbers(camera, CELL, jnp.asarray([[48, 8], [0, 63]]))
    assert cells.tolist() == [8 + 6, 56]
    ours = theory.predict(statistics, camera, NoAntialiasing(), motion, cells=cells)
    for mtcd, (x, y) in zip(ours, [(52.0, 12.0), (4.0, 60.0)], strict=True):
        ahead = oracles.source_position(SIZE, SIZE, fov_deg, turn, x, y)
        moved = np.asarray(ahead) - [x, y]
        exact = 255 * 3**0.5 * abs(moved @ [0.003, -0.002])
        assert mtcd == pytest.approx(exact, rel=1e-6, abs=1e-12)


def test_blends_of_pictures_and_displacements_agree_in_small_motion(rng):
    motion = motion_of(1e-3 * turns_of(rng))
    # Not exactly: the mean of a distance is no root mean square.
    for texture, rtol in ((GREY, 1e-6), (noise(rng, 3.0), 0.02)):
        statistics = statistics_of(texture)
        first_order = predicted(statistics, Plain(), motion, memory=0)
        blend = predicted(statistics, Plain(), motion, memory=4)
        np.testing.assert_allclose(np.mean(blend), np.mean(first_order), rtol)


def test_at_larger_motion_blends_of_pictures_are_nearer_to_simulation(rng):
    texture = noise(rng, 1.0)
    statistics = statistics_of(texture)
    ratios = {0: [], 4: []}
    for _ in range(8):
        motion = motion_of(turns_of(rng))
        ours = simulated(texture, Plain(), motion, cells=4)
        for memory, listed in ratios.items():
            mtcd = predicted(statistics, Plain(), motion, memory=memory)[INNER]
            listed.append(ours / np.mean(mtcd))
    print("\nsimulation / theory", {m: np.round(r, 3) for m, r in ratios.items()})
    assert np.std(ratios[4]) < 0.7 * np.std(ratios[0])
    assert abs(np.mean(ratios[4]) - 1) < 0.5 * abs(np.mean(ratios[0]) - 1)


# --- laws ---


@pytest.mark.parametrize("memory", [0, 4])
def test_reversal_of_all_increments_changes_nothing(rng, memory):
    statistics, turns = statistics_of(noise(rng, 2.0)), jnp.asarray(turns_of(rng))
    for technique in (NoAntialiasing(), HeadMovement()):
        there, back = (
            predicted(statistics, technique, hj.Motion(t, t), memory=memory)
            for t in (turns, -turns)
        )
        np.testing.assert_allclose(there, back, rtol=1e-12)


def test_cells_are_those_of_the_frame_for_one_session_or_many(rng):
    statistics = statistics_of(noise(rng, 2.0))
    paths = [motion_of(turns_of(rng)) for _ in range(3)]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *paths)
    cells = jnp.asarray([[5, 60], [0, 0], [63, 5]])
    chosen = jax.vmap(lambda m, c: predicted(statistics, HeadMovement(), m, cells=c))
    each = chosen(batch, cells)
    for k in range(3):
        whole = predicted(statistics, HeadMovement(), paths[k])
        assert whole.shape == (64,)
        np.testing.assert_allclose(each[k], whole[cells[k]], rtol=1e-10)


@pytest.mark.slow
def test_float32_is_enough(rng):
    texture = noise(rng, 2.0)
    motion = motion_of(0.01 * turns_of(rng))
    narrow = lambda tree: jax.tree.map(lambda leaf: leaf.astype(np.float32), tree)
    for technique in (NoAntialiasing(), HeadMovement()):
        wide = predicted(statistics_of(texture), technique, motion)
        ours = predicted(statistics_of(narrow(texture)), technique, narrow(motion))
        assert ours.dtype == np.float32
        np.testing.assert_allclose(ours, wide, rtol=1e-3)


def test_techniques_that_show_the_same_are_predicted_alike(rng):
    texture, motion = noise(rng, 2.0), motion_of(turns_of(rng))
    picture = statistics_of(texture)
    reference = statistics_of(texture, supersampled=True)
    none = predicted(picture, NoAntialiasing(), motion)
    np.testing.assert_array_equal(predicted(picture, MSAA(4), motion), none)
    np.testing.assert_array_equal(predicted(picture, Freeze(), motion), 0 * none)
    ssaa4 = predicted(reference, SSAA(4), motion)
    assert (ssaa4 != none).all()
    current = functools.partial(HeadMovement, w_min=1.0, w_lb=1.0)
    for statistics, technique, same in (
        (picture, current(), none),
        (reference, current(resolve=SSAA(4)), ssaa4),
        # All samples at the previous pose: no ratio of d, and no lag.
        (picture, HeadMovement(closeness=(0.0, 0.0)), none),
    ):
        mtcd = predicted(statistics, technique, motion, memory=0)
        np.testing.assert_allclose(mtcd, same, rtol=1e-9)


@functools.partial(jax.jit, static_argnames="memory")
def total(turns, technique, statistics, memory):
    motion, cells = hj.Motion(turns, turns), jnp.asarray([OFF_CENTRE, 3])
    options = {"cells": cells, "memory": memory}
    return jnp.sum(predicted(statistics, technique, motion, **options))


gradient = quickly(jax.grad(total, argnums=(0, 1)), static_argnames="memory")
TWO_SAMPLES = jax.tree.map(
    jnp.asarray, HeadMovement(closeness=(0.6, 0.8), h_max_deg_s=40.0)
)


@pytest.mark.slow
def test_gradients(rng):
    statistics, turns = statistics_of(noise(rng, 2.0)), jnp.asarray(turns_of(rng))
    ours = gradient(turns, TWO_SAMPLES, statistics, memory=4)

    along_turns = lambda t: total(jnp.asarray(t), TWO_SAMPLES, statistics, memory=4)
    exact = oracles.jacobian(
        lambda t: along_turns(t.reshape(FRAMES, 3)), turns.ravel(), 1e-8
    )
    scale = np.abs(exact).max()
    np.testing.assert_allclose(ours[0].ravel(), exact, atol=1e-5 * scale)

    numbers, technique_of = ravel_pytree(TWO_SAMPLES)
    along_numbers = lambda n: total(
        turns, technique_of(jnp.asarray(n)), statistics, memory=4
    )
    exact = oracles.jacobian(along_numbers, numbers, 1e-6)
    assert (exact != 0).all()  # w_min, w_lb, h_max and both d
    np.testing.assert_allclose(ravel_pytree(ours[1])[0], exact, rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize(
    ("technique", "memory"),
    [
        (NoAntialiasing(), 0),
        (Freeze(), 0),
        pytest.param(TWO_SAMPLES, 4, marks=pytest.mark.slow),
        pytest.param(TWO_SAMPLES, 0, marks=pytest.mark.slow),
    ],
    ids=["none", "freeze", "head_movement", "head_movement, first order"],
)
def test_at_rest_mtcd_and_its_gradient_are_exactly_0(rng, technique, memory):
    statistics, still = statistics_of(noise(rng, 2.0)), jnp.zeros((FRAMES, 3))
    assert total(still, technique, statistics, memory=memory) == 0
    for slope in jax.tree.leaves(gradient(still, technique, statistics, memory=memory)):
        np.testing.assert_array_equal(slope, 0)


def test_slopes_of_hardly_moved_pictures_are_numbers_in_float32():
    # Squared once more, as a quotient's divisor is, 1e-12 px are 0.
    cells = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), statistics_of(GREY))
    direction = jnp.asarray([0.6, -0.8], jnp.float32)
    of_length = lambda length: cells.difference(jnp.tile(length * direction, (64, 1)))
    slope = quickly(jax.vmap(jax.jacfwd(of_length)))
    slopes = [slope(jnp.asarray([length], jnp.float32)) for length in (1e-12, 1e-3)]
    np.testing.assert_allclose(*slopes, rtol=1e-5)


# --- what is refused ---


@pytest.mark.parametrize(
    ("technique", "reason"),
    [
        (SSAA(2), "ssaa2 has no small-motion theory"),
        (SSAA(4, space="gamma"), "ssaa4_gamma has no"),
        (HeadMovement(resolve=SSAA(2)), r"head_movement\+ssaa2 has no"),
        (HeadMovement(space="linear"), "only RGB distances of gamma"),
        (HeadMovement(difference="max_channel"), "only RGB distances of gamma"),
    ],
)
def test_techniques_without_a_theory(technique, reason):
    assert not theory.has_theory(technique)
    with pytest.raises(ValueError, match=reason):
        predicted(statistics_of(GREY), technique, motion_of(np.zeros((8, 3))))


def test_wrong_arguments_are_named():
    still = motion_of(np.zeros((FRAMES, 3)))
    for technique in (NoAntialiasing(), MSAA(4), Freeze(), SSAA(4), HeadMovement()):
        assert theory.has_theory(technique)
    grey = statistics_of(GREY)
    with pytest.raises(ValueError, match="supersampled=True for ssaa4, got False"):
        predicted(grey, SSAA(4), still)
    with pytest.raises(ValueError, match="at least 2 frames after warmup = 7, got 8"):
        predicted(grey, NoAntialiasing(), still, warmup=7)
    with pytest.raises(ValueError, match="memory must be a whole number >= 0"):
        predicted(grey, NoAntialiasing(), still, memory=-1)
    with pytest.raises(ValueError, match="cell_px must divide the camera frame 64 x"):
        PictureStatistics.of(GREY, CAMERA, cell_px=7)
    with pytest.raises(ValueError, match="octaves must be a whole number >= 1"):
        statistics_of(GREY, octaves=0)
    with pytest.raises(ValueError, match=r"finest_px must lie in \(0, inf\), got 0"):
        statistics_of(GREY, finest_px=0.0)


# --- as a control variate ---


@pytest.mark.exhaustive
def test_how_well_sessions_are_predicted_and_how_fast():
    pytest.importorskip("skimage")
    camera, count, warmup = hj.Camera(), 200, 12
    sessions = Sessions(0, hj.HeadMotion.fixating(), camera, Tiles(1, 64), count, 22)
    batch = sessions.batch(0, count)
    techniques = (NoAntialiasing(), HeadMovement())
    runner = Runner(camera, Tiles(1, 64), techniques, warmup, count, batch)
    cells = jax.vmap(lambda o: cell_numbers(camera, 64, o))(batch.origins)
    at_least = {"none": 0.99, "head_movement": 0.98}

    @functools.partial(jax.jit, static_argnames="memory")
    def predict(statistics, technique, motion, cells, memory):
        one = lambda both: theory.predict(
            statistics,
            camera,
            technique,
            both[0],
            warmup=warmup,
            cells=both[1],
            memory=memory,
        )[0]
        return jax.lax.map(one, (motion, cells))

    def timed(function, *arguments):
        result, seconds = np.asarray(function(*arguments)), []  # compiles
        for _ in range(5):
            start = time.perf_counter()
            np.asarray(function(*arguments))
            seconds.append(time.perf_counter() - start)
        return result, min(seconds) / count

    scenes = hj.scenes.study_set()
    for name in ("coffee", "text", "noise"):
        texture = hj.scenes.bake(scenes[name], camera)
        start = time.perf_counter()
        statistics = PictureStatistics.of(texture, camera)
        jax.block_until_ready(statistics.slope_squared)
        print(f"\n{name}: tabled in {time.perf_counter() - start:.1f} s")
        for technique in techniques:
            run = lambda t, texture: runner.run([t], texture, batch)[0].mtcd
            ours, slow_s = timed(run, technique, texture)
            for memory in (0, 4):
                theirs, fast_s = timed(
                    functools.partial(predict, memory=memory),
                    statistics,
                    technique,
                    batch.motion,
                    cells,
                )
                correlation = np.corrcoef(ours, theirs)[0, 1]
                print(
                    f"  {technique.id:14s} memory {memory}: correlation "
                    f"{correlation:.4f}, simulation / theory "
                    f"{ours.mean() / theirs.mean():.3f}, {1e6 * fast_s:.0f} us instead "
                    f"of {1e6 * slow_s:.0f} us ({slow_s / fast_s:.0f} x)"
                )
            assert correlation > at_least[technique.id]
            assert slow_s > 50 * fast_s  # 200 to 530 on an idle machine
