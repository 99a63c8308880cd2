"""The accumulation buffer: what it converges to, and how fast; how it is rendered."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small
from small import quickly

import hmdjit as hj
from hmdjit import color, rendering, sample_patterns, techniques
from hmdjit.frames.displacement import GATHER, Reading
from hmdjit.technique_contract.base import mean_of_samples
from hmdjit.techniques import AccumulationBuffer, HeadMovement, NoAntialiasing


def errors(count, picture, exact):
    """Of the mean of renders, by pixel."""
    x, y = sample_patterns.accumulation(count).T
    return np.mean(picture(x[:, None], y[:, None]), axis=0) - exact


# --- what it converges to ---


def star_discrepancy(points):
    """Largest error of the share of points in a box from the corner; brute force."""
    edges = [np.append(np.sort(axis), 1.0) for axis in points.T]
    x, y = (axis[:, None] for axis in points.T)
    area = edges[0][:, None] * edges[1][None]
    below = lambda less: less(x, edges[0]).T.astype(float) @ less(y, edges[1])
    open_, closed = below(np.less), below(np.less_equal)
    return max((area - open_ / len(x)).max(), (closed / len(x) - area).max())


COUNTS = (16, 32, 64, 128, 256, 512, 1024)


def test_smooth_pictures_converge_like_log_n_over_n(rng):
    # Waves of up to 2 rad per px, whose mean over a pixel is known.
    wx, wy = rng.uniform(-2, 2, (2, 500))
    phase = rng.uniform(0, 2 * np.pi, 500)
    mean = lambda w: np.sinc(w / (2 * np.pi))
    exact = np.cos(phase) * mean(wx) * mean(wy)
    wave = lambda x, y: np.cos(phase + wx * x + wy * y)
    # Koksma and Hlawka: at most the variation times the discrepancy.
    variation = np.abs(wx) + np.abs(wy) + np.abs(wx * wy)
    scaled = []
    for count in COUNTS:
        found = errors(count, wave, exact)
        points = sample_patterns.accumulation(count) + 0.5
        assert (np.abs(found) <= variation * star_discrepancy(points)).all()
        scaled.append(np.sqrt(np.mean(found**2)) * count / np.log(count))
    assert max(scaled) < 2 * scaled[0]


@pytest.mark.parametrize(
    ("count", "grid"), [(6, (2, 3)), (72, (8, 9)), (864, (32, 27))]
)
def test_edges_converge_to_their_coverage(rng, count, grid):
    # Each box of the grid has one sample, and a line crosses at most as many boxes as
    # there are lines between them, and one: only these can be miscounted.
    angle, away = rng.uniform(0, 2 * np.pi, 400), rng.uniform(-0.5, 0.5, 400)
    c, s = np.cos(angle), np.sin(angle)
    edge = lambda x, y: c * x + s * y < away
    fine = (np.arange(2000) + 0.5) / 2000 - 0.5
    # Coverage: over x the edge's height is known, over y it is clipped to the pixel.
    height = np.clip((away - c * fine[:, None]) / s, -0.5, 0.5)
    exact = np.mean(np.where(s > 0, 0.5 + height, 0.5 - height), axis=0)
    found = np.abs(errors(count, edge, exact))
    crossed = sum(grid) - 1
    assert found.max() <= crossed / count
    # The miscounts are of both signs: the typical error is their root, and less.
    assert np.sqrt(np.mean(found**2)) < np.sqrt(crossed) / count


# --- the mean ---


@pytest.mark.parametrize("space", ["gamma", "linear"])
@pytest.mark.parametrize("count", [3, 40])  # without a loop, and with one
def test_the_mean_is_of_all_samples(rng, count, space):
    samples = jnp.asarray(rng.random((count, 3, 4, 5)))
    light = color.decode(samples) if space == "linear" else samples
    mean = jnp.asarray(np.mean(light, axis=0))
    expected = color.encode(mean) if space == "linear" else mean
    ours = quickly(mean_of_samples, static_argnums=1)(samples, space)
    np.testing.assert_allclose(ours, expected, rtol=1e-13)


def test_half_floats_are_summed_in_single_precision():
    # 1/3 a thousand times in bfloat16 would stop growing at 256 thirds of its ulp.
    samples = jnp.full((1024, 3, 2, 2), 1 / 3, jnp.bfloat16)
    mean = mean_of_samples(samples, "gamma")
    assert mean.dtype == jnp.bfloat16
    np.testing.assert_array_equal(mean, samples[0])


# --- as a technique ---


@pytest.mark.parametrize("count", [1, 16, 128, 1024])
@pytest.mark.parametrize("space", ["linear", "gamma"])
def test_ids_name_the_samples(count, space):
    technique = AccumulationBuffer(count, space)
    assert technique.id == f"accumulation{count}" + "_gamma" * (space == "gamma")
    assert techniques.by_id(technique.id) == technique
    assert techniques.by_id(HeadMovement(resolve=technique).id).id.endswith(
        technique.id
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"samples": 0}, "^samples must be a whole number >= 1, got 0.$"),
        ({"samples": 1025}, r"^samples must lie in \[1, 1024\], got 1025.$"),
        ({"space": "srgb"}, "^space must be one of gamma, linear, got 'srgb'"),
    ],
)
def test_what_is_out_of_range_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        AccumulationBuffer(**options)


def resolved(technique, source, reading=GATHER):
    region = hj.Region.whole(small.CAMERA)
    offsets = technique.sample_offsets_px[0]

    def shown(turn):
        motion = hj.Motion(turn, turn)
        see = (source, small.CAMERA, region, motion)
        frame = rendering.render(*see, offsets, reading=reading)
        return technique.resolve(frame), rendering.reference(*see, reading)

    return quickly(shown)(jnp.array([1e-3, -2e-3, 1e-3]))


def test_pictures_of_many_samples_are_those_of_a_few_at_a_time(rng):
    texture, technique = small.texture(rng), AccumulationBuffer(32, "gamma")
    region = hj.Region.whole(small.CAMERA)
    turn = jnp.array([1e-3, -2e-3, 1e-3])

    @quickly
    def halves(turn):
        offsets = jnp.asarray(technique.sample_offsets_px[0].reshape(2, 16, 2))
        render = lambda some: rendering.render(
            texture, small.CAMERA, region, hj.Motion(turn, turn), some
        )
        return jax.lax.map(lambda some: jnp.mean(render(some).color, axis=0), offsets)

    shown, _ = resolved(technique, texture)
    np.testing.assert_allclose(shown, np.mean(halves(turn), axis=0), rtol=1e-12)


def test_on_solids_it_is_their_reference():
    reading = Reading(reference_samples=24)
    shown, reference = resolved(AccumulationBuffer(24), small.solids(), reading)
    assert np.ptp(shown) > 0.5
    np.testing.assert_allclose(shown, reference, rtol=1e-12)


def test_laws_and_hints_hold():
    techniques.check(AccumulationBuffer(20))


def test_it_flickers_less_than_one_sample(rng):
    chosen = [NoAntialiasing(), AccumulationBuffer(32)]
    texture, poses = small.texture(rng), jnp.asarray(small.path(rng))
    none, ours = (hj.simulate(texture, small.CAMERA, t, poses) for t in chosen)
    assert 0 < ours.mtcd < none.mtcd
