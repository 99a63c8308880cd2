import dataclasses
import io
import re
import sys

import matplotlib
import numpy as np
import PIL.Image
import pytest
import xarray
from matplotlib.image import imread
from matplotlib.text import Text
from rich.console import Console

import hmdjit as hj
from hmdjit.cli import main as cli
from hmdjit.estimates.summary import MeanAndError, summarize
from hmdjit.figures import drawing
from hmdjit.figures import study as figures
from hmdjit.figures.ratios import draw_ratios
from hmdjit.figures.techniques import Compared
from hmdjit.reports import study as report
from hmdjit.studies.identity import made_by, metric_ids

TECHNIQUES = ["none", "msaa4", "head_movement", "freeze", "ssaa4"]
SCENES = ["astronaut", "checkerboard", "text", "almost_uniform"]
NAMES = ["distributions", "ratios", "figure3", "flicker_detail"]
FIGURES = [name + kind for name in NAMES for kind in (".png", ".svg")]
# Width and height in inches; the tight bounding box adds the footer, cuts margins.
SIZES = {"distributions.png": (8.5, 5.3), "flicker_detail.png": (8.0, 6.0)}


def study(count=60, techniques=TECHNIQUES, scenes=SCENES, subjects=None, **attrs):
    rng = np.random.default_rng(3)
    level = dict(zip(SCENES, [3.0, 9.0, 7.0, 0.02], strict=True))
    share = {"head_movement": 0.6, "freeze": 0.0, "ssaa4": 0.9}
    loss = {"head_movement": 12.0, "freeze": 90.0, "ssaa4": 0.0}
    shape = (len(techniques), len(scenes), count)
    spread = np.exp(0.5 * rng.standard_normal(count) + 0.1 * rng.standard_normal(shape))
    base = np.array([level.get(s, 5.0) for s in scenes])[None, :, None] * spread
    shares = np.array([share.get(t, 1.0) for t in techniques])[:, None, None]
    losses = np.array([loss.get(t, 8.0) for t in techniques])[:, None, None]
    dims = ("technique", "scene", "session")
    coords = {"technique": techniques, "scene": scenes, "session": np.arange(count)}
    if subjects is not None:
        names = [f"subject {i % subjects}" for i in range(count)]
        coords["subject"] = ("session", names)
    identity = {
        "baseline": "msaa4",
        "reference": "ssaa4",
        "frames": 10,
        "warmup": 12,
        "width_px": 1024,
        "height_px": 1024,
        "fov_deg": 96.0,
        "refresh_hz": 60.0,
        "px_per_deg_centre": 8.047,
        "px_per_deg_side": 17.97,
        "px_per_deg_mean": 11.75,
        "measure": "2 tiles of 64 x 64 px per session",
        "head": "seated",
        "seed": 4,
        "hmdjit_version": "0.1.0",
        "model_version": 1,
        "config_hash": "0123456789abcdef",
        "failed_sessions": "[]",
        "wide_halo_sessions": 0,
    }
    return xarray.Dataset(
        {"mtcd": (dims, base * shares), "detail_loss": (dims, base * losses)},
        coords=coords,
        attrs=identity | attrs,
    )


DATA = study()
ROWS = summarize(DATA)
MANY = study(techniques=[*TECHNIQUES, *(f"technique_{i}" for i in range(12))])
ROWS_OF_MANY = summarize(MANY)


def printed(data, width=80, encoding="utf-8", rows=None):
    file = io.TextIOWrapper(io.BytesIO(), encoding=encoding, newline="")
    report.print_table(data, rows, console=Console(file=file, width=width))
    file.seek(0)
    return file.read()


@pytest.mark.parametrize("width", [80, 120])
def test_tables_fit_and_keep_each_technique_on_one_line(width):
    text = printed(DATA, width, rows=ROWS)
    assert "\x1b" not in text  # plain where it is no terminal
    lines = text.splitlines()
    assert max(map(len, lines)) <= width
    pooled = lines[3 : 3 + len(TECHNIQUES)]
    assert [line.split()[0] for line in pooled] == TECHNIQUES
    rows = {(row.technique, row.scene): row for row in ROWS}
    row = rows["head_movement", "all"]
    interval = f"{row.ratio:.3f} [{row.ratio_low:.3f}, {row.ratio_high:.3f}]"
    assert interval in pooled[2]
    assert "1 (baseline)" in pooled[1]


@pytest.mark.parametrize("width", [30, 40])
def test_narrow_tables_keep_every_number(width):
    wide, narrow = (printed(DATA, w, rows=ROWS) for w in (200, width))
    numbers = [
        re.findall(r"\d+\.\d+", text.split("MTCD in")[0]) for text in (wide, narrow)
    ]
    assert len(numbers[0]) > 50
    assert sorted(numbers[0]) == sorted(numbers[1])
    assert "…" not in narrow
    assert max(map(len, narrow.split("MTCD in")[0].splitlines())) <= 40


def test_a_finished_study_is_told_whatever_the_terminal_can_show(tmp_path, monkeypatch):
    data = study(techniques=["msaa4", "none"], scenes=["図", "cost$1_$2"])
    monkeypatch.setattr(hj.Study, "run", lambda *_, **__: data)
    terminal = io.TextIOWrapper(io.BytesIO(), encoding="cp1252")
    monkeypatch.setattr(sys, "stdout", terminal)
    small = ["--scenes", "noise", "--techniques", "none", "--sessions", "1"]
    assert cli.run(["study", *small, "--out", str(tmp_path / "図")]) == 0
    terminal.seek(0)
    text = terminal.read()
    assert "1 scene x 1 technique x 1 session of" in text
    assert re.search(r"^\\u56f3 .*\d", text, re.M)
    assert "Wrote " in text
    assert {file.name for file in (tmp_path / "図").iterdir()} >= set(FIGURES)


def test_tables_survive_an_encoding_without_symbols():
    text = printed(DATA, encoding="ascii", rows=ROWS)
    assert "+-" in text
    assert "code values^2" in text
    assert max(map(len, text.splitlines())) <= 80


def test_the_caption_says_what_the_numbers_rest_on():
    data = study(failed_sessions="[3, 9]", omit_failed=1, wide_halo_sessions=5)
    text = " ".join(printed(data).split())
    for part in (
        "8.047 px/deg in the centre, 17.97 at the side, 11.75 on average",
        "1024 × 1024 px, 96° wide, 60 Hz",
        "Head: seated.",
        "60 sessions of 10 frames after 12 of warm-up, seed 4",
        "95 % interval over sessions (normal, 60 sessions); scenes are fixed",
        "MTCD alone is won by a frozen picture",
        "at most 0.05: no flicker to remove",
        "Failed sessions, left out: 2.",
        "wider halo: 5.",
    ):
        assert part in text


def test_many_techniques_continue_in_a_further_table():
    text = printed(MANY, rows=ROWS_OF_MANY)
    assert max(map(len, text.splitlines())) <= 80
    techniques = map(str, MANY["technique"].values)
    assert all(text.count(technique) >= 2 for technique in techniques)
    assert text.count("geometric mean ") >= 3


@pytest.mark.parametrize(
    ("data", "part"),
    [
        (study(count=1), "no interval, 1 session"),
        (study(scenes=["text"]), "1 (baseline)"),
        (study(scenes=["almost_uniform"]), "no flicker to remove"),
        (study(techniques=["msaa4"]), "1 (baseline)"),
        (study(subjects=3), "between these windows only"),
    ],
    ids=["one session", "one scene", "no flicker", "one technique", "3 subjects"],
)
def test_corner_cases_are_tabled(data, part):
    assert part in " ".join(printed(data).split())


@pytest.mark.parametrize(
    "data",
    [
        study(count=1, techniques=["msaa4"], scenes=["text"], subjects=1),
        study(count=2, techniques=["msaa4", "freeze"], scenes=["almost_uniform"]),
    ],
    ids=["one of each", "no flicker"],
)
def test_corner_cases_are_drawn(data, tmp_path):
    paths = report.write_report(data, tmp_path)
    assert all(path.stat().st_size > 5000 for path in paths[1:])


def test_cells_where_all_failed_are_reported(tmp_path):
    data = study(techniques=["msaa4", "head_movement", "ssaa4"], omit_failed=1)
    data["mtcd"][1, 1] = np.nan
    data["mtcd"][2] = np.nan
    data["detail_loss"][2] = np.nan
    text = " ".join(printed(data).split())
    assert "head_movement: no session of checkerboard." in text
    report.write_report(data, tmp_path)


def test_a_report_is_a_summary_and_four_figures_always_the_same(tmp_path):
    settings = dict(matplotlib.rcParams)
    paths = report.write_report(DATA, tmp_path / "out")
    assert [path.name for path in paths] == ["summary.csv", *FIGURES]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(
        ["summary.csv", *FIGURES]
    )
    for path in paths[1::2]:
        picture = imread(path)
        with PIL.Image.open(path) as file:
            assert file.info["Source"] == made_by()
        ink = (picture[..., :3].min(axis=-1) < 0.9).mean()
        assert 0.005 < ink < 0.5
        if path.name in SIZES:
            inches = np.array(picture.shape[1::-1]) / 150
            np.testing.assert_allclose(inches, SIZES[path.name], rtol=0.08)

    again = figures.draw(DATA, ROWS)["flicker_detail"]
    files = drawing.save_both(again, tmp_path / "again.png")
    for file, path in zip(files, paths[-2:], strict=True):
        assert file.read_bytes() == path.read_bytes()
    assert dict(matplotlib.rcParams) == settings


def test_names_of_points_do_not_overlap():
    figure, ((axes,),) = drawing.panels(8.0, 5.6, "")
    places = np.random.default_rng(0).normal(size=(12, 2))
    points = [(x, y, f"technique_{i}", "black") for i, (x, y) in enumerate(places)]
    axes.plot(*places.T, "o")
    drawing.label_points(figure, axes, points)
    assert len(axes.texts) == len(points)
    figure.draw_without_rendering()
    # Of the words alone: an annotation's own extent holds its leader too.
    boxes = [Text.get_window_extent(name) for name in axes.texts]
    for index, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:index])


def test_names_of_points_cover_no_point_and_no_bar():
    figure = figures.draw(DATA, ROWS)["flicker_detail"]
    figure.draw_without_rendering()
    (axes,) = figure.axes
    names = [text for text in axes.texts if text.get_fontweight() == "bold"]
    assert len(names) == len(TECHNIQUES)
    marks = list(drawing._drawn(axes))
    assert len(marks) > len(TECHNIQUES) * len(SCENES)
    for name in names:
        box = Text.get_window_extent(name)
        assert not any(box.overlaps(mark) for mark in marks)


@pytest.mark.parametrize(("width_px", "is_there"), [(1024, True), (2048, False)])
def test_kims_number_stands_beside_ratios_of_their_camera_alone(width_px, is_there):
    figure = draw_ratios(Compared(DATA.assign_attrs(width_px=width_px), ROWS))
    words = [text.get_text() for text in figure.axes[0].texts]
    assert ("Kim et al.: 0.56" in words) == is_there


def test_every_technique_keeps_its_style():
    style = Compared(MANY, ROWS_OF_MANY).style
    assert len(set(style.values())) == MANY.sizes["technique"] == 17
    assert style["msaa4"][0] == "black"


def test_each_metric_that_a_study_has_is_told(tmp_path):
    others = {"jod": MeanAndError(9.25, 0.01, 9.23, 9.27)}
    rows = [dataclasses.replace(row, others=others) for row in ROWS]
    jod = DATA["mtcd"].copy().assign_attrs(units="just-objectionable differences")
    data = DATA.assign(jod=jod).assign_attrs(metrics=["mtcd", "jod"])
    file = tmp_path / "result.nc"
    data.to_netcdf(file, engine="h5netcdf")
    text = printed(xarray.load_dataset(file), 120, rows=rows)
    assert "9.250 ±0.020" in text
    assert "Jod in just-objectionable differences." in " ".join(text.split())
    assert "detail" not in text.lower()
    assert "flicker_detail" not in figures.draw(data, rows)
    data.assign_attrs(metrics=["mtcd"]).to_netcdf(file, engine="h5netcdf")
    assert metric_ids(xarray.load_dataset(file)) == ["mtcd"]
    assert metric_ids(DATA) == ["mtcd", "detail_loss"]


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0.5, 30.0, [0.5, 1, 2, 5, 10, 20]),
        (0.001, 100.0, [0.001, 0.01, 0.1, 1, 10, 100]),
        (2.1, 9.0, [3, 4, 5, 6, 8]),
    ],
)
def test_ticks_are_round_and_few(low, high, expected):
    np.testing.assert_allclose(drawing.ticks(low, high), expected, rtol=1e-12)
