import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small

from hmdjit import metrics
from hmdjit.camera import Region
from hmdjit.metrics import ChangedPixels

THRESHOLDS = (1, 2, 5)


def share(threshold, clip):
    found = metrics.Streamed(ChangedPixels(threshold))
    for picture in clip:
        found.add(picture)
    return found.value


@pytest.mark.parametrize("threshold", THRESHOLDS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_it_is_what_numpy_counts(threshold, dtype, rng):
    steps = rng.normal(0, 0.01, (4, 6, 5, 3))
    clip = np.clip(0.5 + np.cumsum(steps, axis=0), 0, 1).astype(dtype)
    moved = 255 * np.linalg.norm(np.diff(clip.astype(float), axis=0), axis=-1)
    expected = 100 * np.mean(moved > threshold)
    assert 0 < expected < 100
    assert share(threshold, clip) == pytest.approx(expected, rel=1e-12)


def test_just_the_threshold_is_not_more_than_it():
    # Of codes: every step of one channel, wherever rounding puts its colour.
    codes = np.zeros((2, 16, 15, 3), np.uint8)
    codes[0, ..., 1] = np.arange(240).reshape(16, 15)
    for threshold in THRESHOLDS:
        for step, expected in ((threshold, 0.0), (threshold + 1, 100.0)):
            codes[1] = codes[0]
            codes[1, ..., 1] += np.uint8(step)
            assert share(threshold, codes) == expected
            assert share(threshold, (codes / 255).astype(np.float32)) == expected


def test_fewer_pixels_change_by_more_and_mtcd_bounds_them(rng):
    clip = np.clip(0.5 + rng.normal(0, 0.01, (3, *small.SIZE)), 0, 1)
    shares = [share(threshold, clip) for threshold in THRESHOLDS]
    assert 100 > shares[0] > shares[1] > shares[2] > 0
    mtcd = float(metrics.mtcd(clip))
    bounds = [100 * mtcd / threshold for threshold in THRESHOLDS]
    assert all(a <= b for a, b in zip(shares, bounds, strict=True))
    assert share(1, np.repeat(clip[:1], 3, axis=0)) == 0


def test_its_gradient_is_0():
    metric, shown = ChangedPixels(), jnp.full((3, 4, 5), 0.5)

    def value(shown, previous):
        state = metric.init(Region(0, 0, 5, 4), shown.dtype)
        return metric.value(metric.step(state, shown, previous, None))

    for previous in (shown, shown + 0.1):
        assert not jax.grad(value)(shown, previous).any()


def test_it_is_found_by_its_id_and_checked():
    assert metrics.by_id("changed_over_5") == ChangedPixels(5)
    with pytest.raises(
        ValueError, match="threshold must be a whole number >= 1, got 0"
    ):
        ChangedPixels(0)


@pytest.mark.slow
def test_a_study_reports_them():
    data = small.study(
        metrics=[metrics.MTCD(), *map(ChangedPixels, THRESHOLDS)], sessions=4
    ).run(0)
    shares = [data[f"changed_over_{n}"].mean(["session", "scene"]) for n in THRESHOLDS]
    none, blended = np.transpose([share.values for share in shares])
    assert (none > blended).all()
    assert (np.diff(none) < 0).all()
