import dataclasses
import io
from typing import Any

import equinox as eqx
import numpy as np
import pytest
from matplotlib.image import imread
from matplotlib.text import Text
from rich.console import Console
from scipy.spatial.transform import Rotation

from hmdjit import HeadMotion, Trace, _toml
from hmdjit.figures import head as head_figure
from hmdjit.figures.drawing import save
from hmdjit.head_fitting import spectra, statistics
from hmdjit.head_fitting.fitting import Fit
from hmdjit.head_motion import Amplitude, Resonator, presets
from hmdjit.head_motion.parameters import AXES, FitError
from hmdjit.reports import head as head_report

RATE_HZ = 30.0
HEAD = HeadMotion(
    (0.905, 0.619, 0.632),
    (0.148, 0.235, 0.193),
    (0.0038, 0.0038, 0.0036),
    3.715,
    0.228,
    (
        Resonator((0.33, 0.52, 0.52), (2.76, 2.4, 3.02), (0.035, 0.13, 0.86)),
        Resonator((0.46, 0.35, 0.33), (3.92, 4.08, 11.4), (0.16, 0.071, 0.12)),
    ),
    Amplitude(0.48, 0.4),
)


def heads(subjects=3, seconds=12.0):
    rng = np.random.default_rng(3)
    rows = round(seconds * RATE_HZ) + 1
    for number in range(subjects):
        turns = rng.standard_normal((rows, 3)) * [0.04, 0.03, 0.02]
        poses = Rotation.from_rotvec(np.cumsum(turns, axis=0), degrees=True)
        quaternions = poses.as_quat(scalar_first=True)
        yield Trace(np.arange(rows) / RATE_HZ, quaternions, subject=f"p{number}")


@pytest.fixture(scope="module")
def segments():
    return list(heads())


@pytest.fixture(scope="module")
def recorded(segments):
    return statistics.describe(segments, RATE_HZ)


def scaled(table: Any, by: float) -> Any:
    if isinstance(table, dict):
        return {key: scaled(entry, by) for key, entry in table.items()}
    if isinstance(table, list):
        return [scaled(entry, by) for entry in table]
    return table * by


def fit(**others):
    numbers = _toml.table(HEAD)
    head, low, high, error = (
        presets.from_table(HeadMotion, scaled(numbers, by))
        for by in (1, 0.9, 1.1, 0.05)
    )
    scores = {0: 0.3, 1: 0.21, 2: 0.2}
    amounts = (11, 195, 454.0, 460.0, 90.0)
    head = dataclasses.replace(head, fit_error=FitError(0.0625, 11, "11 subjects"))
    made = Fit(head, error, low, high, "11 subjects", scores, *amounts)
    return made._replace(**others)


def printed(show, *arguments, encoding="utf-8", width=80, **options):
    file = io.TextIOWrapper(io.BytesIO(), encoding=encoding, newline="")
    show(Console(file=file, width=width, markup=False), *arguments, **options)
    file.seek(0)
    return file.read()


def test_a_fit_is_tabled_with_all_its_numbers_errors_and_intervals():
    lines = printed(head_report.print_fit, fit()).splitlines()
    assert max(map(len, lines)) <= 80
    assert not any("…" in line for line in lines)
    numbers = [line for line in lines if line.rstrip().endswith("]")]
    # Of three axes: 3 of the wander and 3 of each of 2 resonances; and 4 others.
    assert len(numbers) == 3 * (3 + 2 * 3) + 4
    assert numbers[0].split() == [
        "speed_rms_deg_s", "pitch", "0.905", "0.045", "[0.815,", "0.996]"
    ]  # fmt: skip
    assert numbers[1].split()[0] == "yaw"
    text = " ".join(" ".join(lines).split())
    assert "Errors and intervals are over 11 subjects." in text
    assert "RMS rotation per frame: ± 6.2 % (a standard error)" in text
    assert "Order 2: 2 resonances per axis" in text
    assert "held-out data by order: 0: 0.3000, 1: 0.2100, 2: 0.2000." in text


@pytest.mark.parametrize("width", [40, 80])
def test_no_number_of_a_fit_is_cut(width):
    wide = presets.from_table(HeadMotion, scaled(_toml.table(HEAD), 12345.6))
    lines = printed(head_report.print_fit, fit(high=wide), width=width).splitlines()
    assert max(map(len, lines)) <= width
    bounds = [line.rstrip() for line in lines if line.rstrip().endswith("]")]
    assert len(bounds) == 3 * (3 + 2 * 3) + 4
    assert bounds[0].endswith(f"[0.815, {0.905 * 12345.6:.3f}]")


def test_numbers_that_are_not_identifiable_say_so():
    error = fit().standard_error
    unknown = eqx.tree_at(lambda head: head.return_time_s, error, np.nan)
    text = printed(head_report.print_fit, fit(standard_error=unknown))
    line = next(line for line in text.splitlines() if "return_time_s" in line)
    assert line.split() == ["return_time_s", "3.715", "not", "identifiable"]


def test_a_given_order_says_so():
    text = printed(head_report.print_fit, fit(held_out_deviance={}))
    assert "Order 2, as given: 2 resonances per axis." in text


def test_recordings_are_tabled(segments):
    text = printed(head_report.print_recordings, segments, segments[:2], RATE_HZ)
    rows = dict(line.split("  ", 1) for line in text.splitlines() if "  " in line)
    rows = {name.strip(): value.strip() for name, value in rows.items()}
    assert rows["recordings"] == "3"
    assert rows["subjects"] == "3 (2 with still segments)"
    assert rows["held still"] == "24.0 s (66.7%)"
    assert rows["gaps"] == "0 (0.0 s)"
    assert rows["lost frames, bridged"] == "0 of 1083 (0.00%)"


def test_recorded_and_modelled_stand_side_by_side(recorded):
    twice = recorded._replace(speed_rms_deg_s=2 * recorded.speed_rms_deg_s)
    error_db = np.array([0.5, 1.25, np.nan])
    goodness = statistics.Goodness(recorded, twice, recorded.spectrum, error_db)
    text = " ".join(printed(head_report.print_goodness, goodness).split())
    assert "+100.0%" in text
    assert text.count("+0.0%") == 2 + 2 * 3 + 3  # all else, but no wander in 20 s
    assert "pitch 0.500 dB, yaw 1.25 dB, roll - dB" in text
    assert f"over the {len(recorded.frequency_hz)} of 24 bins" in text


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_tables_are_plain_text_in_any_encoding(encoding, recorded):
    text = printed(head_report.print_description, recorded, encoding=encoding)
    assert "\x1b" not in text
    assert "wander in 20 s, deg" in text


def test_figures_show_data_alone_or_a_model_beside_them(segments, recorded, tmp_path):
    alone = head_figure.draw("someone", segments, recorded)
    head = HeadMotion((0.7, 0.5, 0.3), (0.05,) * 3, (0.001,) * 3)
    both = head_figure.draw("someone$1_$2", segments, recorded, head, recorded)
    for figure, curves, entries in ((alone, 4, 2), (both, 5, 4)):
        assert len(figure.axes) == 5
        assert len(figure.axes[0].lines) == curves
        assert len(figure.legends[0].get_texts()) == entries
    texts = [text for text in both.findobj(Text) if isinstance(text, Text)]
    words = " ".join(text.get_text() for text in texts)
    for part in (
        "someone$1_$2",
        "3 subjects, 30 Hz, 36 s held still",
        "median: ",
        *AXES,
    ):
        assert part in words

    save(both, tmp_path / "both.png", tight=False)
    picture = imread(tmp_path / "both.png")
    assert picture.shape[:2] == (1170, 1650)
    assert 0.005 < (picture[..., :3].min(axis=-1) < 0.9).mean() < 0.5


def test_no_legend_covers_a_line(segments, recorded):
    figure = head_figure.draw("someone", segments, recorded)
    figure.draw_without_rendering()
    turns = figure.axes[3]
    legend = turns.get_legend()
    assert legend is not None
    box = legend.get_window_extent()
    for line in turns.lines:
        points = turns.transData.transform(line.get_xydata())
        assert not box.count_contains(points)
    below = figure.legends[0].get_window_extent()
    boxes = [axes.get_tightbbox() for axes in figure.axes]
    assert not any(box is None or below.overlaps(box) for box in boxes)


def test_spectra_are_averaged_over_bins_and_persons(segments, recorded):
    periodograms = spectra.Periodograms.of(segments, RATE_HZ)
    head = HeadMotion((1.0, 0.7, 0.5), (0.1,) * 3, (0.004,) * 3, person_sd=0.3)
    axes = head_figure.draw("me", segments, recorded, head, recorded).axes[0]
    *_, shown, model = axes.lines
    frequency_hz, power = np.asarray(shown.get_data(), float)
    assert np.all(np.diff(frequency_hz) > 0)
    # Low bins hold one frequency each.
    np.testing.assert_allclose(frequency_hz[:3], periodograms.frequency_hz[:3])
    np.testing.assert_allclose(power[:3], periodograms.power.mean(axis=0)[:3, 0])
    mean = statistics.expected_spectrum(head, periodograms)[:3, 0]
    np.testing.assert_allclose(np.asarray(model.get_ydata())[:3], mean)
    (band,) = axes.collections
    low, high = (
        statistics.expected_spectrum(head, periodograms, np.exp(2 * 1.645 * sd))[0, 0]
        for sd in (-0.3, 0.3)
    )
    corners = np.asarray(band.get_paths()[0].vertices)
    at_start = corners[corners[:, 0] == frequency_hz[0], 1]
    np.testing.assert_allclose((at_start.min(), at_start.max()), (low, high))


def test_heads_that_never_move_are_refused(segments, recorded):
    still = recorded._replace(speed_rms_deg_s=0.0)
    with pytest.raises(ValueError, match="heads must move to be drawn"):
        head_figure.draw("stone", segments, still)
