"""Every metric as a study's: streamed, by its id, in decibels, of neighbours."""

import dataclasses
import io
import json
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small
from rich.console import Console

import hmdjit as hj
from hmdjit import metrics
from hmdjit.camera import Region
from hmdjit.cli import definition
from hmdjit.cli.definition import Options
from hmdjit.estimates.summary import POOLED, summarize, write_csv
from hmdjit.figures import study as figures
from hmdjit.frames.displacement import GATHER, SLICES
from hmdjit.reports import study as report
from hmdjit.studies.measured_blocks import Tiles

MEASURES = ["mse", "rmsd", "psnr", "snr", "ssim", "ssim_volume", "mean_ciede2000"]


@pytest.fixture(scope="module")
def clip():
    """Three frames, and what they are held against, in [0, 1]."""
    rng = np.random.default_rng(5)
    reference = rng.random((3, 13, 15, 3))
    return np.clip(reference + rng.normal(0, 0.1, reference.shape), 0, 1), reference


def streamed(id, frames, references):
    found = metrics.Streamed(metrics.by_id(id))
    for frame, reference in zip(frames, references, strict=True):
        found.add(frame, reference if found.metric.needs_reference else None)
    return found.value


@pytest.mark.parametrize("name", MEASURES)
def test_a_clip_is_measured_as_its_pictures_are(name, clip):
    id = name.removeprefix("mean_")
    frames, references = (255 * pictures for pictures in clip)
    measure = getattr(metrics, name)
    if name in ("mse", "rmsd", "psnr", "snr"):  # of all frames at once
        expected = measure(frames, references)
    else:
        expected = np.mean([measure(*p) for p in zip(frames, references, strict=True)])
    assert streamed(id, *clip) == pytest.approx(float(expected), rel=1e-12)


def test_detail_loss_is_the_mean_squared_error(clip):
    assert streamed("detail_loss", *clip) == streamed("mse", *clip)


def test_metrics_are_found_by_their_ids():
    assert [metrics.by_id(id).id for id in metrics.IDS] == list(metrics.IDS)
    for id in metrics.IDS:
        is_flicker = id == "mtcd" or id.startswith("changed_over_")
        assert metrics.by_id(id).needs_reference != is_flicker
    more = [id for id in metrics.IDS if not metrics.by_id(id).less_is_better]
    assert more == ["psnr", "snr", "ssim", "ssim_volume"]
    with pytest.raises(ValueError, match=r"got 'sim'. Did you mean 'ssim'\?"):
        metrics.by_id("sim")


@pytest.mark.parametrize("id", ["psnr", "snr"])
def test_decibels_are_infinite_without_an_error_and_averaged_as_powers(id, clip):
    _, references = clip
    assert streamed(id, references, references) == math.inf
    metric = metrics.by_id(id)
    mean = lambda *values: float(metric.mean(jnp.asarray(values)))
    assert mean(math.inf, math.inf) == math.inf
    assert mean(20.0, 20.0) == pytest.approx(20, rel=1e-14)
    half = 20 + 10 * math.log10(2)  # half the error
    assert mean(math.inf, 20.0) == pytest.approx(half, rel=1e-14)
    assert mean(math.nan, 20.0) != mean(math.nan, 20.0)


def test_masked_pixels_do_not_count_for_snr(clip):
    frame, reference = (np.moveaxis(pictures[0], -1, 0) for pictures in clip)
    is_measured = np.arange(13)[:, None] < np.full(15, 6)
    metric = metrics.SNR()
    state = metric.init(Region(0, 0, 15, 6), jnp.float64)
    state = metric.step(
        state,
        jnp.asarray(frame),
        None,
        jnp.asarray(reference),
        jnp.asarray(is_measured),
    )
    expected = metrics.snr(frame[:, :6], reference[:, :6])
    np.testing.assert_allclose(metric.value(state), expected, rtol=1e-13)


class Seen(metrics.PixelMean):
    """Counts the pixels that it is given at once."""

    id, unit = "seen", "px"

    def per_pixel(self, shown, previous, reference):
        SEEN.append(shown.shape)
        return shown[0]


class SeenWhole(Seen):
    """The same, not local."""

    is_local = False


SEEN = []
# A region this large is cut into blocks, of which SSIM would lose the rims.
LARGE = hj.Camera(width_px=256, height_px=128, fov_deg=16.0, refresh_hz=60.0)


def simulated(rng, reading, *chosen):
    return hj.simulate(
        small.texture(rng, LARGE),
        LARGE,
        hj.techniques.NoAntialiasing(),
        small.path(rng, 3, camera=LARGE),
        reading=reading,
        metrics=chosen,
    )


@pytest.mark.parametrize(
    ("kind", "size"), [(Seen, (3, 64, 128)), (SeenWhole, (3, 128, 256))]
)
def test_what_is_not_local_is_given_its_block_in_one_piece(rng, kind, size):
    SEEN.clear()
    jax.eval_shape(lambda: simulated(rng, SLICES, kind()))
    assert set(SEEN) == {size}


@pytest.mark.slow
def test_ssim_of_a_large_region_is_that_of_the_whole(rng):
    state = rng.bit_generator.state
    found = []
    for reading in (SLICES, GATHER):
        rng.bit_generator.state = state
        found.append(simulated(rng, reading, metrics.MSE(), metrics.SSIM()))
    np.testing.assert_allclose(found[0].ssim, found[1].ssim, rtol=1e-5)
    np.testing.assert_allclose(found[0].mse, found[1].mse, rtol=1e-5)
    assert 0 < 1 - found[0].ssim < 1


NAMES = ("mtcd", "detail_loss", "psnr", "rmsd", "ssim")
STUDY = small.study(
    metrics=[metrics.by_id(id) for id in NAMES],
    techniques=[hj.techniques.by_id(id) for id in ("none", "ssaa4")],
    measure=Tiles(2, 16),
)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    out = tmp_path_factory.mktemp("study")
    return STUDY.run(out=out)


def test_a_study_has_all_metrics_and_decibels_of_mean_errors(data):
    assert list(data.attrs["metrics"]) == list(NAMES)
    assert json.loads(data.attrs["failed_sessions"]) == []
    assert (data["psnr"].attrs["units"], data["psnr"].attrs["better"]) == ("dB", "more")
    none, reference = data.sel(technique="none"), data.sel(technique="ssaa4")
    expected = 10 * np.log10(255**2 / none["detail_loss"].values)
    # Tiles and frames are averaged before the logarithm.
    np.testing.assert_allclose(none["psnr"].values, expected, rtol=1e-5)
    assert (reference["psnr"] == np.inf).all()
    np.testing.assert_allclose(none["rmsd"] ** 2, none["detail_loss"], rtol=1e-5)
    np.testing.assert_allclose(reference["ssim"].values, 1, atol=1e-6)
    assert (none["ssim"] < 1).all()


def printed(dataset):
    file = io.StringIO()
    report.print_table(dataset, console=Console(file=file, width=200))
    return file.getvalue()


@pytest.mark.filterwarnings("error")
def test_a_report_tells_all_metrics_with_their_intervals(data, tmp_path):
    rows = {(row.technique, row.scene): row for row in summarize(data)}
    none, reference = rows["none", POOLED], rows["ssaa4", POOLED]
    for name in NAMES[1:]:
        mean, error, low, high = none.others[name]
        assert low < mean < high
        assert error > 0
    mean, *bounds = reference.others["psnr"]
    assert mean == math.inf
    assert np.isnan(bounds).all()
    assert not reference.note
    text = " ".join(printed(data).split())
    for words in ("PSNR", "SSIM", "inf", "more is better, and inf"):
        assert words in text
    header = write_csv([none], tmp_path / "summary.csv").read_text().splitlines()[0]
    assert "psnr,psnr_standard_error,psnr_low,psnr_high" in header


def test_another_headline_is_called_by_its_name(data):
    other = data.assign_attrs(metrics=["ssim", "psnr", "mtcd", "detail_loss"])
    assert "SSIM and detail, mean over scenes" in printed(other)
    drawn = figures.draw(other, summarize(other))
    assert "flicker_detail" not in drawn
    (axes,) = drawn["distributions"].axes
    assert axes.get_xlabel() == "SSIM of a session, more is better (logarithmic)"


def test_metrics_of_a_study_are_named(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(
        "scenes = ['noise']\ntechniques = ['none']\nmetrics = ['mtcd', 'ssim']"
    )
    options, tables = definition.read_toml(path)
    assert [m.id for m in definition.build(options, tables).metrics] == ["mtcd", "ssim"]
    said = definition.merged(options, Options(metrics=("mse",)))
    assert [m.id for m in definition.build(said, tables).metrics] == ["mse"]
    with pytest.raises(ValueError, match=r"metrics must be one of mtcd, .* got 'loss'"):
        definition.build(dataclasses.replace(options, metrics=("loss",)))


@pytest.mark.parametrize(
    ("names", "side_px", "message"),
    [
        (("psnr", "mtcd"), 16, "metrics must begin with one that has ratios"),
        (("mtcd", "snr"), 16, "metrics must not have snr on tiles, of which it is no"),
        (("mtcd", "mtcd"), 16, "metrics must be one or more, all distinct"),
        (("mtcd", "ssim"), 8, "ssim must have blocks of at least 11 px each way"),
    ],
)
def test_what_a_study_cannot_measure_is_refused(names, side_px, message):
    chosen = [metrics.by_id(id) for id in names]
    with pytest.raises(ValueError, match=message):
        small.study(metrics=chosen, measure=Tiles(1, side_px))
