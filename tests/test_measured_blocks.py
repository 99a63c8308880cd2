import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small
from scipy import stats

import hmdjit as hj
from hmdjit import blending
from hmdjit.cli import definition
from hmdjit.cli.definition import Options
from hmdjit.simulation.halo import needed_halo_px, required_halo_px
from hmdjit.studies.measured_blocks import CentralCrop, Tiles, WholeFrame


def _draw_many(tiles, camera, key, draws):
    keys = jax.random.split(key, draws)
    return np.asarray(jax.vmap(lambda k: tiles.draw(k, camera))(keys))


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_every_cell_is_drawn_equally_often(key, count):
    camera = hj.Camera(48, 32)
    origins = _draw_many(Tiles(count, 8), camera, key, 6000).reshape(-1, 2)
    cells, seen = np.unique(origins, axis=0, return_counts=True)
    assert len(cells) == 24  # the grid covers the frame exactly
    assert (origins % 8 == 0).all()
    # Chi-squared over 24 cells; false alarm 1e-4 a case. Strata make it conservative.
    assert stats.chisquare(seen).pvalue > 1e-4


def test_tiles_of_a_session_lie_in_different_strata(key):
    camera = hj.Camera(64, 64)
    origins = _draw_many(Tiles(4, 8), camera, key, 500)
    quadrant = origins // 32
    # Along a Z-curve, a quarter of the cells is a quadrant.
    assert all(len(np.unique(session, axis=0)) == 4 for session in quadrant)


def test_tile_means_are_unbiased_for_any_picture(key, rng):
    camera = hj.Camera(48, 32)
    picture = rng.random((32, 48))
    tiles = Tiles(3, 8)
    cell_mean = picture.reshape(4, 8, 6, 8).mean(axis=(1, 3))
    origins = _draw_many(tiles, camera, key, 4000) // 8
    estimates = cell_mean[origins[..., 1], origins[..., 0]].mean(axis=1)
    error = estimates.std() / np.sqrt(len(estimates))
    # |z| < 4: false alarm 6e-5.
    assert abs(estimates.mean() - picture.mean()) < 4 * error


@pytest.mark.parametrize(
    ("measure", "message"),
    [
        (lambda: Tiles(0), r"tiles count must be a whole number >= 1, got 0"),
        (lambda: Tiles(2, 0), r"tiles size_px must be a whole number >= 1, got 0"),
        (lambda: CentralCrop(0), r"crop size_px must be a whole number >= 1, got 0"),
        (
            lambda: Tiles().block_size(hj.Camera(1000, 1024)),
            r"must divide the camera frame 1000 x 1024, got 64; 8 does",
        ),
        (
            lambda: CentralCrop(2000).block_size(hj.Camera()),
            r"crop size_px must lie in \[1, 1024\], got 2000",
        ),
    ],
)
def test_wrong_blocks_are_refused(measure, message):
    with pytest.raises(ValueError, match=message):
        measure()


@pytest.mark.parametrize(
    ("width_px", "height_px", "size_px"),
    [
        (1024, 1024, 64),
        (2064, 2208, 48),
        (1920, 1080, 60),
        (1832, 1920, 8),
        (24, 18, 6),
        (64, 64, 32),
    ],
)
def test_the_default_tile_divides_the_frame(width_px, height_px, size_px):
    camera = hj.Camera(width_px, height_px)
    study = hj.Study(
        {"noise": small.NOISE},
        [hj.techniques.by_id("none")],
        hj.HeadMotion.seated(),
        camera,
        baseline="none",
    )
    assert study.measure == Tiles(2, size_px)
    told = Options(width=width_px, height=height_px, scenes=("noise",))
    assert definition.build(told).measure == Tiles(2, size_px)


def test_a_frame_that_no_tile_divides_is_refused():
    with pytest.raises(ValueError, match=r"size of 4 to 64 px.*got 1000 x 1001"):
        Tiles.fitting(hj.Camera(1000, 1001))


def test_crop_and_whole_frame_lie_where_they_say(key):
    camera = hj.Camera(100, 60)
    assert CentralCrop(20).draw(key, camera).tolist() == [[40, 20]]
    assert WholeFrame().draw(key, camera).tolist() == [[0, 0]]
    assert WholeFrame().block_size(camera) == (100, 60)


def _halo_by_brute_force(steps, gains, tolerance):
    """Grow the halo until a worst-case line of pixels stays below the tolerance."""
    for halo in range(1000):
        # line[0] is the first measured pixel, beyond the halo's end all is wrong.
        line, worst = np.zeros(halo + 1 + 60), 0.0
        line[halo + 1 :] = 1.0
        for step, gain in zip(steps, gains, strict=True):
            n, f = int(np.floor(step)), step - np.floor(step)
            inner = [
                (1 - f) * line[max(i + n, 0)] + f * line[max(i + n + 1, 0)]
                for i in range(halo + 1)
            ]
            line[: halo + 1] = np.minimum(gain * np.array(inner), 1.0)
            worst = max(worst, line[0])
        if worst < tolerance / 2:
            return halo
    raise AssertionError


def halo_of(technique, camera, motion, origin, size):
    """Halo of one session with one square block, px."""
    motion = jax.tree.map(lambda leaf: leaf[None], motion)
    origins = np.array([[origin]], np.int32)
    (halo,) = needed_halo_px(technique, camera, motion, origins, (size, size))
    return int(halo)


@pytest.mark.parametrize("mean", [0.0, 0.4])
def test_halo_agrees_with_growing_it(rng, mean):
    steps = rng.normal(mean, 0.4, (12, 15, 4))
    gains = rng.uniform(0.5, 1.1, (12, 15))
    halos = required_halo_px(steps, gains)
    for step, gain, halo in zip(steps, gains, halos, strict=True):
        each = [_halo_by_brute_force(step[:, edge], gain, 1e-5) for edge in range(4)]
        # The line ends at the measured pixel, which is nearer to the edge than what
        # is really read from farther inside: it never asks for less.
        assert halo <= max(each) <= halo + 1


@pytest.mark.parametrize("difference", ["euclidean", "max_channel", "same_pixel"])
@pytest.mark.parametrize(
    "curve", [hj.curves.Linear(), hj.curves.Cosine(4.0), hj.curves.Spline((0, 1, 9))]
)
def test_what_remains_of_an_error_in_the_history_is_within_the_gain(
    rng, curve, difference
):
    kim = hj.techniques.HeadMovement(
        0.6, 0.1, localization=curve, ease=curve, difference=difference
    )
    speed = 11.0
    (gain,) = kim.history_gain(np.array([speed]))
    easing = float(blending.ease(speed, 25.0, curve))
    if isinstance(curve, hj.curves.Linear):
        assert gain == pytest.approx((1 - 0.6 + 2 * 0.5) * (1 - easing), rel=1e-14)

    def shown(current, history, same):
        compared = same if difference == "same_pixel" else history
        kind = "euclidean" if difference == "same_pixel" else difference
        apart = blending.color_difference(current, compared, kind=kind)
        minimum = blending.localized_minimum(0.6, 0.1, apart, curve)
        weight = blending.current_weight(minimum, jnp.asarray(easing)[None, None])
        return blending.blend(current, history, weight)

    # Also black against white, where most remains.
    current, history, same = (
        jnp.asarray(np.round(rng.random((3, 3, 200, 200)) * 4) / 4)[i] for i in range(3)
    )
    error = jnp.asarray(rng.choice([-1, 1], (3, 200, 200)) * 10.0 ** rng.uniform(-6, 0))
    left = shown(current, history + error, same + error) - shown(current, history, same)
    # Distances of all channels together: an error of colours, not of a channel.
    size = lambda planes: np.linalg.norm(planes, axis=0)
    if difference == "max_channel":
        size = lambda planes: np.abs(planes).max(axis=0)
    share = (size(left) / size(error)).max()
    assert share <= gain
    assert share > 0.2 * gain


def test_halo_is_zero_at_rest_and_grows_with_motion():
    gains = np.full((1, 22), 0.9)
    halos = [
        required_halo_px(np.full((1, 22, 4), s), gains)[0]
        for s in (0.0, 0.01, 0.1, 1.0, 3.0)
    ]
    assert halos[0] == 0
    assert halos == sorted(halos)
    assert halos[-1] > 22


def test_motion_away_from_an_edge_needs_no_halo():
    inwards_px, gain = np.full((1, 9, 4), -0.7), np.full((1, 9), 0.9)
    assert required_halo_px(inwards_px, gain)[0] == 0


STEEP = hj.curves.Cosine(4.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kim", "widest_px"),
    [
        (hj.techniques.HeadMovement(), 30),
        (hj.techniques.HeadMovement(0.5, 0.1, ease=STEEP, localization=STEEP), 40),
    ],
    ids=["kim", "steep"],
)
def test_what_lies_beyond_the_halo_does_not_reach_the_tile(rng, kim, widest_px):
    """Change everything beyond the derived halo: the measured block does not see it."""
    camera = hj.Camera(96, 96, fov_deg=20.0)
    turns = np.cumsum(rng.normal(0, 4e-4, (16, 3)), axis=0)
    poses = jax.vmap(hj.quaternion.exp)(jnp.asarray(turns))
    motion = hj.Motion.of(poses)
    halo = halo_of(kim, camera, motion, (40, 40), 16)
    assert 4 < halo < widest_px

    frames = rng.random((16, 96, 96, 3))
    changed = 1 - frames
    low, high = 48 - 8 - halo, 48 + 8 + halo
    changed[:, low:high, low:high] = frames[:, low:high, low:high]
    shown, other = (hj.apply(kim, camera, f, poses) for f in (frames, changed))
    difference = np.abs(shown - other)[:, 40:56, 40:56].max()
    assert difference < 1e-5
    # The bound is not empty: half the halo would let more through.
    inner = np.abs(shown - other)[:, low + 1 : high - 1, low + 1 : high - 1].max()
    assert inner > 1e-5


def test_a_span_without_bound_asks_for_the_whole_frame():
    inwards_px, gain = np.full((1, 3, 4), np.inf), np.full((1, 3), 0.9)
    assert required_halo_px(inwards_px, gain)[0] >= 4096


def test_more_tiles_than_cells_are_refused():
    with pytest.raises(ValueError, match=r"tiles count must lie in \[1, 4\], got 5"):
        Tiles(5, 8).block_size(hj.Camera(16, 16))


@pytest.mark.parametrize(("count", "size"), [(1, 64), (4, 32), (10, 16), (4096, 1)])
def test_default_tiles_are_small_enough_for_their_number(count, size):
    camera = hj.Camera(64, 64)
    tiles = Tiles.fitting(camera, count)
    assert tiles.block_size(camera) == (size, size)


def test_unmoved_and_linear_histories_ask_for_wider_halos():
    camera = hj.Camera(96, 96, fov_deg=0.8)
    swing = np.where(np.arange(20) % 2, 4e-4, -4e-4)[:, None] * np.array([1.0, 1.0, 0])
    motion = hj.Motion(jnp.cumsum(jnp.asarray(swing), axis=0), jnp.asarray(swing))
    kim = hj.techniques.HeadMovement
    halos = [
        halo_of(technique, camera, motion, (40, 40), 16)
        for technique in (kim(), kim(difference="same_pixel"), kim(space="linear"))
    ]
    # The last displayed pixel does not move away from an edge with its history; and
    # near black a linear history shows 12.92 times as much.
    assert halos[1] > halos[0]
    assert halos[2] >= halos[0]
