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


def test_mtcd_of_codes_is_that_of_their_colours():
    # In uint8 the square of a step of 16 is 256, and wraps around to 0.
    steps = 16 * np.mgrid[0:4, 0:6, 0:5, 0:3][0]
    for kind, scale in ((np.uint8, 1), (np.uint16, 257)):
        clip = (scale * steps).astype(kind)
        streamed = metrics.Streamed(metrics.MTCD())
        for picture in clip:
            streamed.add(picture)
        for value in (metrics.mtcd(clip), jax.jit(metrics.mtcd)(clip), streamed.value):
            assert value == pytest.approx(16 * np.sqrt(3), rel=1e-12)


@pytest.mark.parametrize("kind", [jnp.float16, jnp.bfloat16])
def test_mtcd_of_half_floats_is_summed_in_single(kind):
    # 900 pixels are more than a bfloat16 counts.
    clip = jnp.zeros((2, 30, 30, 3), kind).at[1].set(0.5)
    value = metrics.mtcd(clip)
    assert value.dtype == jnp.float32
    assert value == pytest.approx(127.5 * np.sqrt(3), rel=1e-5)


@pytest.mark.parametrize(
    ("scale", "message"),
    [
        (lambda x: 255 * x, r"lie in \[0, 1\], got float64 from 0 to 255"),
        (lambda x: 2 * x - 1, r"lie in \[0, 1\], got float64 from -1 to 1"),
        (lambda x: (255 * x).astype(np.int64), r"uint8, uint16 or .*, got int64"),
        (lambda x: x > 0.5, r"uint8, uint16 or .*, got bool"),
        (lambda x: x[..., :2], r"shape \(.*3\), got \(.*2\)"),
        (lambda x: np.concatenate([x, x[..., :1]], -1), r"shape .*, got \(.*4\)"),
    ],
)
def test_what_are_no_colours_is_refused_by_mtcd(scale, message):
    clip = scale(np.linspace(0, 1, 2 * 6 * 5 * 3).reshape(2, 6, 5, 3))
    with pytest.raises(ValueError, match=f"^clip must .*{message}"):
        metrics.mtcd(clip)
    with pytest.raises(ValueError, match=r"^picture must "):
        metrics.Streamed(metrics.MTCD()).add(np.concatenate(clip))


def test_a_streamed_clip_keeps_its_size_and_has_its_references(rng):
    picture = rng.random((6, 5, 3))
    streamed = metrics.Streamed(metrics.MTCD())
    streamed.add(picture)
    with pytest.raises(ValueError, match=r"shape \(6, 5, 3\), got \(1, 5, 3\)"):
        streamed.add(picture[:1])  # would have been repeated for each row
    streamed = metrics.Streamed(metrics.DetailLoss())
    with pytest.raises(ValueError, match="detail_loss needs a reference"):
        streamed.add(picture)
    codes = np.uint8(np.round(255 * picture))
    streamed.add(codes, codes / 255)
    assert streamed.value == pytest.approx(0, abs=1e-20)


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
    assert metrics.psnr(black + tiny, black, peak=255.0) == pytest.approx(
        expected, rel=1e-6
    )


MEASURES = ["mse", "rmsd", "psnr", "snr"]


@pytest.mark.parametrize("kind", [np.uint8, np.int16, np.int64, jnp.float16])
@pytest.mark.parametrize("name", MEASURES)
def test_codes_do_not_wrap_around_or_overflow(name, kind):
    # 16^2 = 256 is 0 in uint8, and so is 240^2; 255^2 is beyond float16's 65,504.
    test = np.resize([16, 0, 255], (2, 3, 3))
    reference = np.resize([0, 240, 0], (2, 3, 3))
    measure = getattr(metrics, name)
    found = measure(test.astype(kind), reference.astype(kind))
    expected = measure(test.astype(float), reference.astype(float))
    assert found == pytest.approx(float(expected), rel=1e-5)
    assert metrics.mse(test, reference) == pytest.approx((16**2 + 240**2 + 255**2) / 3)


@pytest.mark.parametrize("name", MEASURES)
def test_two_scales_or_shapes_are_refused(name, rng):
    measure, picture = getattr(metrics, name), rng.random((6, 5, 3))
    codes = np.uint8(255 * picture)
    for test, reference in [(codes, picture), (codes.astype(np.uint16), codes)]:
        with pytest.raises(ValueError, match=r"both be floating, .* scales differ"):
            measure(test, reference)
    with pytest.raises(ValueError, match=r"both be floating, .* Got bool and bool"):
        measure(picture > 0.5, picture > 0.5)
    with pytest.raises(ValueError, match=r"one shape, got \(6, 5, 3\) and \(5, 3\)"):
        measure(picture, picture[0])


def test_the_peak_of_psnr_is_that_of_the_scale(rng):
    codes = rng.integers(0, 256, (2, 6, 5, 3), dtype=np.uint8)
    expected = metrics.psnr(*codes)
    assert expected == pytest.approx(
        10 * np.log10(255**2 / oracles.mse(*codes.astype(float)))
    )
    deep = 257 * codes.astype(np.uint16)
    assert metrics.psnr(*deep) == pytest.approx(float(expected))
    assert metrics.psnr(*(codes / 255), peak=1.0) == pytest.approx(float(expected))
    for scale in (1 / 255, 2.0):
        with pytest.raises(ValueError, match="peak must be named for values up to"):
            metrics.psnr(*(scale * codes))
    with pytest.raises(ValueError, match=r"peak must lie in \(0, inf\), got 0"):
        metrics.psnr(*codes, peak=0.0)


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
