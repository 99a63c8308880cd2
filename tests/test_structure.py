import csv
import os
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from hmdjit import metrics

SIZE = (36, 28, 3)
STRUCTURES = [metrics.ssim, metrics.ssim_volume]


def pairs(rng, count=3):
    """Photographs, noise and ramps beside what blur and noise make of them."""
    from skimage import data

    photograph = data.astronaut()[100:136, 200:228].astype(float)
    noise = rng.uniform(0, 255, SIZE)
    ramp = np.broadcast_to(np.linspace(0, 255, 28)[None, :, None], SIZE)
    pictures = [photograph, noise, ramp]
    blurred = [ndimage.gaussian_filter(p, (1, 1, 0)) for p in pictures]
    noisy = [np.clip(p + rng.normal(0, 20, SIZE), 0, 255) for p in pictures]
    return [*zip(blurred, pictures, strict=True), *zip(noisy, pictures, strict=True)]


def oracle_map(test, reference, axes, peak=255.0):
    """SSIM's equation 13 by SciPy's Gaussian, edges repeated; full size."""
    bell = np.exp(-(np.arange(-5, 6) ** 2) / (2 * 1.5**2))

    def mean(x):
        for axis in axes:
            x = ndimage.correlate1d(x, bell / bell.sum(), axis, mode="nearest")
        return x

    x, y = mean(test), mean(reference)
    xx, yy = mean(test**2) - x**2, mean(reference**2) - y**2
    xy = mean(test * reference) - x * y
    c1, c2 = (0.01 * peak) ** 2, (0.03 * peak) ** 2
    return (2 * x * y + c1) * (2 * xy + c2) / ((x**2 + y**2 + c1) * (xx + yy + c2))


def oracle_luma(picture):
    return picture @ np.array([0.299, 0.587, 0.114])


def test_ssim_agrees_with_scikit_image(rng):
    from skimage.metrics import structural_similarity

    for test, reference in pairs(rng):
        similarity: Any = structural_similarity  # returns what it is asked for
        expected, whole = similarity(
            oracle_luma(test),
            oracle_luma(reference),
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
            data_range=255.0,
            full=True,
        )
        found = metrics.ssim(test, reference)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)
        plane = metrics.ssim_map(test, reference)
        assert plane.shape == (26, 18)
        np.testing.assert_allclose(plane, whole[5:-5, 5:-5], rtol=0, atol=1e-10)
        single = metrics.ssim(test.astype(np.float32), reference.astype(np.float32))
        assert jnp.asarray(single).dtype == jnp.float32
        np.testing.assert_allclose(single, expected, rtol=0, atol=1e-5)


def test_both_agree_with_the_oracle(rng):
    for test, reference in pairs(rng):
        volume = oracle_map(test, reference, (0, 1, 2))
        found = metrics.ssim_volume_map(test, reference)
        assert found.shape == SIZE
        np.testing.assert_allclose(found, volume, rtol=0, atol=1e-10)
        value = metrics.ssim_volume(test, reference)
        np.testing.assert_allclose(value, volume.mean(), rtol=0, atol=1e-10)
        single = metrics.ssim_volume(*np.array([test, reference], np.float32))
        np.testing.assert_allclose(single, volume.mean(), rtol=0, atol=1e-5)
        luma = oracle_map(oracle_luma(test), oracle_luma(reference), (0, 1))
        plane = metrics.ssim_map(test, reference)
        np.testing.assert_allclose(plane, luma[5:-5, 5:-5], rtol=0, atol=1e-10)


@pytest.mark.parametrize("structure", STRUCTURES)
def test_equal_pictures_are_1_and_both_are_alike(structure, rng):
    for test, reference in pairs(rng):
        assert structure(test, test) == pytest.approx(1, abs=1e-14)
        there, back = structure(test, reference), structure(reference, test)
        assert there == pytest.approx(float(back), abs=1e-14)
        assert there < 1
    black = np.zeros(SIZE)
    assert structure(black, black) == pytest.approx(1, abs=1e-14)
    # Noise beside its negative.
    grey = np.repeat(rng.uniform(100, 155, (*SIZE[:2], 1)), 3, axis=2)
    assert structure(255 - grey, grey) < -0.5


@pytest.mark.parametrize("structure", STRUCTURES)
def test_gradients_are_those_of_differences(structure, rng):
    test, reference = (jnp.asarray(0.9 * x) for x in pairs(rng)[3])
    gradient = jax.jit(jax.grad(structure, (0, 1)))
    slopes = gradient(test, reference)
    for place, slope in enumerate(slopes):
        pair, along = [test, reference], rng.normal(size=SIZE)
        ends = []
        for step in (-1e-3, 1e-3):
            moved = [x + step * along if i == place else x for i, x in enumerate(pair)]
            ends.append(structure(*moved))
        difference = (ends[1] - ends[0]) / 2e-3
        assert np.sum(slope * along) == pytest.approx(float(difference), rel=1e-6)
    # At equal pictures it is largest.
    np.testing.assert_allclose(gradient(reference, reference), 0, atol=1e-12)


@pytest.mark.parametrize("structure", STRUCTURES)
def test_scales_are_told_apart_or_named(structure, rng):
    test, reference = (np.round(picture) for picture in pairs(rng)[0])
    expected = structure(test, reference)
    close = lambda value: np.testing.assert_allclose(value, expected, atol=1e-12)
    close(structure(test.astype(np.uint8), reference.astype(np.uint8)))
    deep = [(257 * picture).astype(np.uint16) for picture in (test, reference)]
    close(structure(*deep))
    close(structure(test / 255, reference / 255, peak=1.0))
    with pytest.raises(ValueError, match="peak must be named for values up to"):
        structure(test / 255, reference / 255)
    with pytest.raises(ValueError, match="both be floating, or whole numbers"):
        structure(test.astype(np.uint8), reference)
    with pytest.raises(ValueError, match=r"peak must lie in \(0, inf\)"):
        structure(test, reference, peak=0.0)
    for wrong in (test[:10], test[:, :10], test[..., :2], test[..., 0]):
        with pytest.raises(ValueError, match=r"of at least 11 px each way, got \("):
            structure(wrong, wrong)


def test_the_volume_of_matlabs_peppers_is_the_published_value(shared):
    image = pytest.importorskip("PIL.Image")
    path = os.path.join(shared, "thesis", "matlab_peppers.png")
    reference = np.asarray(image.open(path).convert("RGB"), float)
    bell = np.exp(-(np.arange(-5, 6) ** 2) / (2 * 1.5**2))
    blurred = reference
    for axis in (0, 1):
        blurred = ndimage.correlate1d(blurred, bell / bell.sum(), axis, mode="nearest")
    blurred = np.floor(blurred + 0.5)
    # Printed: 0.9845 (MathWorks Answers 2142916).
    value = metrics.ssim_volume(blurred.astype(np.uint8), reference.astype(np.uint8))
    assert value == pytest.approx(0.984505, abs=1e-6)


def test_the_volume_of_a_blurred_photograph_is_the_recorded_one(shared):
    image = pytest.importorskip("PIL.Image")
    folder = os.path.join(shared, "thesis")
    path = os.path.join(folder, "astro_box3_{}.png")
    pair = [np.asarray(image.open(path.format(name))) for name in ("test", "ref")]
    with open(os.path.join(folder, "image_pair_metrics.csv")) as file:
        (row,) = csv.DictReader(file)
    recorded = float(row["ssim_matlab_rgb_volume"])
    assert metrics.ssim_volume(*pair) == pytest.approx(recorded, abs=1e-6)
