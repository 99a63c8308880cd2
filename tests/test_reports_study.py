import io
import subprocess
import sys

import numpy as np
import pytest
import xarray
from matplotlib.image import imread
from matplotlib.text import Text
from rich.console import Console

from hmdjit.estimates.summary import summarize
from hmdjit.figures import drawing
from hmdjit.figures import study as figures
from hmdjit.reports import study as report

TECHNIQUES = ["none", "msaa4", "head_movement", "freeze", "ssaa4"]
SCENES = ["astronaut", "checkerboard", "text", "almost_uniform"]
FIGURES = ["distributions.png", "ratios.png", "figure3.png", "flicker_detail.png"]
# Width and height in inches; the tight bounding box adds the footer, cuts margins.
SIZES = {"distributions.png": (8.5, 5.3), "flicker_detail.png": (8.0, 6.0)}


def study(count=60, techniques=TECHNIQUES, scenes=SCENES, subjects=None, **attrs):
    rng = np.random.default_rng(3)
    level = dict(zip(SCENES, [3.0, 9.0, 7.0, 0.02], strict=True))
    share = {"head_movement": 0.6, "freeze": 0.0, "ssaa4": 0.9}
    loss = {"head_movement": 12.0, "freeze": 90.0, "ssaa4": 0.0}
    shape = (len(techniques), len(scenes), count)
    spread = np.exp(0.5 * rng.standard_normal(count) + 0.1 * rng.standard_normal(shape))
    base = np.array([level[s] for s in scenes])[None, :, None] * spread
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


def printed(data, width=80, encoding="utf-8"):
    file = io.TextIOWrapper(io.BytesIO(), encoding=encoding, newline="")
    report.print_table(data, console=Console(file=file, width=width))
    file.seek(0)
    return file.read()


@pytest.mark.parametrize("width", [80, 120])
def test_tables_fit_and_keep_each_technique_on_one_line(width):
    lines = printed(study(), width).splitlines()
    assert max(map(len, lines)) <= width
    pooled = lines[3 : 3 + len(TECHNIQUES)]
    assert [line.split()[0] for line in pooled] == TECHNIQUES
    rows = {(row.technique, row.scene): row for row in summarize(study())}
    row = rows["head_movement", "all"]
    interval = f"{row.ratio:.3f} [{row.ratio_low:.3f}, {row.ratio_high:.3f}]"
    assert interval in pooled[2]
    assert "1 (baseline)" in pooled[1]


def test_tables_are_plain_text_when_not_on_a_terminal():
    assert "\x1b" not in printed(study())


def test_tables_survive_an_encoding_without_symbols():
    text = printed(study(), encoding="ascii")
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
    many = [*TECHNIQUES, *(f"technique_{i}" for i in range(6))]
    text = printed(study(techniques=many))
    assert max(map(len, text.splitlines())) <= 80
    assert all(text.count(technique) >= 2 for technique in many)
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
    paths = report.write_report(study(), tmp_path / "out")
    assert [path.name for path in paths] == ["summary.csv", *FIGURES]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(
        ["summary.csv", *FIGURES]
    )
    for path in paths[1:]:
        picture = imread(path)
        ink = (picture[..., :3].min(axis=-1) < 0.9).mean()
        assert 0.005 < ink < 0.5
        if path.name in SIZES:
            inches = np.array(picture.shape[1::-1]) / 150
            np.testing.assert_allclose(inches, SIZES[path.name], rtol=0.08)

    again = report.write_report(study(), tmp_path / "again")
    for one, other in zip(paths, again, strict=True):
        assert one.read_bytes() == other.read_bytes()


def test_names_of_points_do_not_overlap():
    many = [*TECHNIQUES, *(f"technique_{i}" for i in range(6))]
    data = study(techniques=many)
    figure = figures._flicker_detail(drawing.Drawing(data, summarize(data)))
    names = [
        text for text in figure.axes[0].texts if text.get_text().split(" ")[0] in many
    ]
    assert len(names) == len(many)
    # Of the words alone: an annotation's own extent holds its leader too.
    boxes = [Text.get_window_extent(name) for name in names]
    for index, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:index])


def test_every_technique_keeps_its_look():
    data = study(techniques=[*TECHNIQUES, *(f"technique_{i}" for i in range(12))])
    study_drawing = drawing.Drawing(data, summarize(data))
    looks = {
        (
            study_drawing.colour[technique],
            study_drawing.dashes[technique],
            study_drawing.marker[technique],
        )
        for technique in study_drawing.techniques
    }
    assert len(looks) == 17
    assert study_drawing.colour["msaa4"] == "black"


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


def test_importing_hmdjit_needs_no_drawing_and_drawing_no_global_state():
    code = """
import sys
import hmdjit
assert not {"matplotlib", "rich"} & set(sys.modules)
import hmdjit.studies.report
assert "matplotlib.pyplot" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True)
