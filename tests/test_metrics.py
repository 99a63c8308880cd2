import csv
import os
import re

import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest

from hmdjit import metrics

SIZE = (4, 6, 5, 3)  # frames, height, width, channels
RESULTS = [
    "pipe_sobel",
    "acc_128_d",
    "acc_16_d",
    "sponza_sobel_normalized",
    "sponza_temporal_normalized",
]


# --- MTCD ---


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_mtcd_agrees_with_the_oracle(rng, dtype):
    clip = rng.random(SIZE).astype(dtype)
    ours = metrics.mtcd(jnp.asarray(clip))
    assert ours.dtype == dtype
    # A mean of 90 distances, each a few roundings.
    tolerance = 16 * float(np.finfo(dtype).eps)
    assert ours == pytest.approx(oracles.mtcd(clip), rel=tolerance)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_streamed_mtcd_agrees_with_that_of_the_whole_clip(rng, dtype):
    clip = rng.random(SIZE).astype(dtype)
    streamed = metrics.Streamed(metrics.MTCD())
    assert np.isnan(streamed.value)
    for picture in clip:
        streamed.add(picture)
    # In JAX's own precision, which here is float64, whatever comes in.
    assert streamed.value == pytest.approx(oracles.mtcd(clip), rel=1e-14)


def test_streamed_mtcd_keeps_no_hold_on_its_input(rng):
    # A reader that fills one buffer again and again must not see MTCD 0.
    clip = rng.random(SIZE)
    streamed, buffer = metrics.Streamed(metrics.MTCD()), np.empty(SIZE[1:])
    for picture in clip:
        buffer[:] = picture
        streamed.add(buffer)
    assert streamed.value == pytest.approx(oracles.mtcd(clip), rel=1e-14)


@pytest.mark.parametrize("step", [0.0, 1e-12, -0.01, 0.1])
def test_mtcd_of_a_grey_step_per_frame_is_its_length(step):
    clip = jnp.asarray(0.5 + step * np.mgrid[0:4, 0:6, 0:5, 0:3][0])
    expected = 255 * np.sqrt(3) * abs(step)
    # Colours near 0.5 are rounded to 1e-16, of code values 3e-14.
    assert metrics.mtcd(clip) == pytest.approx(expected, rel=1e-12, abs=1e-13)


def test_largest_mtcd_is_black_to_white():
    clip = jnp.stack([jnp.zeros(SIZE[1:]), jnp.ones(SIZE[1:])])
    assert metrics.mtcd(clip) == pytest.approx(441.67295593, abs=1e-8)


def test_mtcd_is_a_mean_over_pixels_and_pairs():
    # One of 30 pixels changes its red by 0.1, in one of three pairs.
    clip = np.zeros(SIZE)
    clip[2:, 3, 1, 0] = 0.1
    expected = 255 * 0.1 / 30 / 3
    assert metrics.mtcd(jnp.asarray(clip)) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_still_clip_has_mtcd_and_gradient_exactly_0(rng, dtype):
    picture = jnp.asarray(rng.random(SIZE[1:]).astype(dtype))
    value, gradient = jax.value_and_grad(metrics.mtcd)(jnp.stack([picture] * 3))
    assert value == 0
    np.testing.assert_array_equal(gradient, np.zeros((3, *SIZE[1:])))


def test_gradient_of_mtcd_agrees_with_differences_beside_still_pixels(rng):
    # Half of the pixels do not change: their terms must not spoil the others'.
    clip = rng.random((2, 2, 3, 3))
    clip[1, 0] = clip[0, 0]
    ours = jax.grad(metrics.mtcd)(jnp.asarray(clip))
    expected = oracles.jacobian(oracles.mtcd, clip)
    moving = np.s_[:, 1]
    # Third derivatives of a length of 0.1 or more, times 1e-10.
    np.testing.assert_allclose(ours[moving], expected[moving], rtol=1e-6)
    np.testing.assert_array_equal(ours[:, 0], np.zeros((2, 3, 3)))


def test_mtcd_of_a_pair_is_a_distance(rng):
    a, b, c = (jnp.asarray(rng.random((6, 5, 3))) for _ in range(3))
    distance = lambda one, other: metrics.mtcd(jnp.stack([one, other]))
    assert distance(a, a) == 0
    assert distance(a, b) == distance(b, a)
    assert distance(a, c) <= distance(a, b) + distance(b, c)


def test_mtcd_of_one_picture_is_refused(rng):
    with pytest.raises(ValueError, match=r"^clip must have at least 2 frames, got 1"):
        metrics.mtcd(jnp.asarray(rng.random((1, *SIZE[1:]))))


# --- errors of pictures ---


def test_errors_agree_with_numpy(rng):
    test, reference = 255 * rng.random((2, 6, 5, 3))
    mse = oracles.mse(test, reference)
    ours = {
        name: getattr(metrics, name)(jnp.asarray(test), jnp.asarray(reference))
        for name in ("mse", "rmsd", "psnr", "snr")
    }
    expected = {
        "mse": mse,
        "rmsd": np.sqrt(mse),
        "psnr": 10 * np.log10(255**2 / mse),
        "snr": 10 * np.log10(np.mean(reference**2) / mse),
    }
    assert ours == pytest.approx(expected, rel=1e-13)


def test_identical_pictures_have_no_error_and_infinite_ratios(rng):
    picture = jnp.asarray(rng.random((6, 5, 3)))
    assert metrics.mse(picture, picture) == 0
    assert metrics.rmsd(picture, picture) == 0
    assert metrics.psnr(picture, picture) == np.inf
    assert metrics.snr(picture, picture) == np.inf


def test_mse_has_a_gradient_everywhere(rng):
    picture = jnp.asarray(rng.random((6, 5, 3)))
    gradient = jax.grad(metrics.mse)(picture, picture)
    np.testing.assert_array_equal(gradient, np.zeros((6, 5, 3)))


@pytest.mark.parametrize("name", ["rmsd", "psnr", "snr"])
@pytest.mark.parametrize("level", [0.0, 0.5])
def test_errors_of_identical_pictures_have_a_gradient_of_0(name, level):
    # A root or a logarithm of 0 made it NaN.
    picture = jnp.full((2, 2, 3), level)
    gradients = jax.grad(getattr(metrics, name), (0, 1))(picture, picture)
    np.testing.assert_array_equal(gradients, np.zeros((2, 2, 2, 3)))


def test_ratios_of_black_and_of_the_smallest_errors_are_right():
    black = jnp.zeros((2, 2, 3), jnp.float32)
    assert metrics.snr(black, black) == np.inf
    assert metrics.snr(black + 1, black) == -np.inf
    gradient = jax.grad(metrics.snr, 1)(black + 1, black)
    assert np.isfinite(gradient).all()
    # 255^2 over an error of 1e-34 is more than float32 holds.
    tiny = np.float32(1e-17)
    expected = 20 * np.log10(255 / 1e-17)
    assert metrics.psnr(black + tiny, black) == pytest.approx(expected, rel=1e-6)


# --- published values ---


@pytest.mark.parametrize("name", RESULTS)
def test_relations_between_the_metrics_hold_for_published_values(shared, name):
    with open(os.path.join(shared, "thesis", f"{name}_results.txt")) as file:
        text = file.read()
    found = re.findall(r"The (\S+) value of (.+) is ([\d.]+)", text)
    values = {(metric, technique): float(v) for metric, technique, v in found}
    mse = {technique: v for (metric, technique), v in values.items() if metric == "MSE"}
    assert len(mse) >= 2
    peak_less_power = []
    for technique, value in mse.items():
        # Two flat pictures with just this error between them.
        test, reference = (
            jnp.full((2, 2, 3), 100.0 + value**0.5),
            jnp.full((2, 2, 3), 100.0),
        )
        rmsd = values.get(("RMSD", technique), values.get(("RMSE", technique)))
        # Six printed digits after the point, of values of up to 50.
        assert metrics.rmsd(test, reference) == pytest.approx(rmsd, abs=2e-6)
        psnr = values["Peak-SNR", technique]
        assert metrics.psnr(test, reference) == pytest.approx(psnr, abs=2e-6)
        # PSNR - SNR = 10 log10(255^2 / mean(ref^2)) depends on the reference alone.
        peak_less_power.append(psnr - values["SNR", technique])
    power = 255**2 / 10 ** (peak_less_power[0] / 10)
    np.testing.assert_allclose(peak_less_power, peak_less_power[0], atol=2e-6)
    reference = jnp.full((2, 2, 3), power**0.5)
    for technique, value in mse.items():
        snr = metrics.snr(reference + value**0.5, reference)
        assert snr == pytest.approx(values["SNR", technique], abs=4e-6)


def test_errors_of_a_blurred_photograph_are_the_recorded_ones(shared):
    image = pytest.importorskip("PIL.Image")
    folder = os.path.join(shared, "thesis")
    test, reference = (
        jnp.asarray(
            np.asarray(image.open(os.path.join(folder, f"astro_box3_{n}.png"))), float
        )
        for n in ("test", "ref")
    )
    with open(os.path.join(folder, "image_pair_metrics.csv")) as file:
        (row,) = csv.DictReader(file)
    columns = {"mse": "mse", "rmsd": "rmsd", "psnr": "psnr_db", "snr": "snr_db"}
    for name, column in columns.items():
        ours = getattr(metrics, name)(test, reference)
        assert ours == pytest.approx(float(row[column]), abs=1e-6)
