"""Kim et al.'s experiment: verdicts on made-up values, the map, and the command."""

import csv

import numpy as np
import pytest

import hmdjit as hj
from hmdjit.cli import main
from hmdjit.estimates.intervals import Interval
from hmdjit.reproductions import kim, kim_claims, kim_map
from hmdjit.reproductions.claims import FAILS, HOLDS, UNTOLD

PLACE = kim_map.Place("made up", 0.3, 0.5, 60.0, 12, 0.56, 0.55, 0.57)


def verdicts(found):
    return [claim.verdict for claim in found]


def on_pictures(ours, msaa=4.0, none=4.0, spread=0.001, least=0.02):
    """Two pictures, one of them calm, in ten sessions."""
    noise = 1 + spread * np.random.default_rng(0).standard_normal(10)
    two = lambda mean: np.stack([2 * mean * noise, least * noise])
    values = {"none": two(none), "msaa4": two(msaa), "head_movement": two(ours)}
    return kim_claims.claims_on_pictures(values, ["busy", "calm"], [PLACE])


def test_the_ratio_must_be_the_papers_as_far_as_it_is_printed():
    assert verdicts(on_pictures(ours=0.56 * 4)) == [HOLDS, HOLDS, HOLDS]
    assert on_pictures(ours=0.60 * 4)[0].verdict == FAILS
    wide = on_pictures(ours=0.60 * 4)[0]
    assert wide.low > 0.565
    assert "0.3 at 0.5 px" in wide.reason
    assert on_pictures(ours=0.56 * 4, none=4.5)[1].verdict == FAILS


def test_no_aa_and_msaa_are_alike_within_a_margin_and_a_wide_interval_tells_nothing():
    rng = np.random.default_rng(1)
    noisy = {id: 1 + rng.random((1, 6)) for id in (*kim_claims.NAMES, "x")}
    noisy[kim_claims.COMBINED] = noisy.pop("x")
    assert verdicts(kim_claims.claims_on_solids(noisy)) == [UNTOLD, UNTOLD]
    sure = {
        id: value + 0.01 * rng.random((1, 6))
        for id, value in zip(noisy, (1.2, 1.0, 0.6, 0.5), strict=True)
    }
    alike, best = kim_claims.claims_on_solids(sure)
    assert (alike.verdict, best.verdict) == (FAILS, HOLDS)
    assert "head_movement" in best.quantity


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [(0.01, 0.05, HOLDS), (0.2, 0.4, FAILS), (0.05, 0.2, UNTOLD)],
)
def test_the_cost_is_held_against_a_tenth(low, high, verdict):
    share = Interval((low + high) / 2, low, high, 0.01, "made up")
    assert kim_claims.claim_on_cost(share).verdict == verdict


def test_a_head_of_the_map_moves_as_far_and_as_evenly_as_it_says():
    for correlation in (0.0, 0.8):
        head = kim_map.head_of(correlation, 0.05, 60.0)
        now, later = np.asarray(head.increment_covariance(np.arange(2), 60.0))[:, 0]
        assert np.sqrt(now) == pytest.approx(0.05, rel=1e-4)
        # An Ornstein-Uhlenbeck velocity's mean over a frame, with that over the next.
        x = -np.log(max(correlation, 1e-99))
        mean = (1 - np.exp(-x)) ** 2 / (2 * (x - 1 + np.exp(-x)))
        assert later / now == pytest.approx(mean, abs=0.01)
        camera = hj.Camera(90, 90, 90.0, 60.0)  # 45 px per unit of tangent
        found = kim_map.motion_of(head, camera, 60.0)
        px = 45 * np.radians(0.05)
        assert found == pytest.approx((later / now, px), rel=1e-3)


@pytest.fixture
def tiny(monkeypatch):
    """One picture and one solid, a small map and short timings."""
    coffee = hj.scenes.checkerboard(1.0, name="coffee")
    pictures = {"text": coffee, "coffee": coffee}
    monkeypatch.setattr(kim.known, "study_set", lambda: pictures)
    monkeypatch.setattr(kim, "_QUICK_SOLIDS", ("wall_text",))
    monkeypatch.setattr(kim, "_SHOWN_PX", 48)
    monkeypatch.setattr(kim_map, "_CROP_PX", 16)
    monkeypatch.setattr(kim_map, "WARMUPS", (0,))
    share = Interval(0.02, 0.01, 0.03, 0.01, "made up")
    monkeypatch.setattr(kim, "cost_share", lambda: share)
    ratios = kim_map.ratios

    def few(scenes, camera, sessions, seed, **options):
        options |= {"px_per_frame": (0.2, 1.0), "correlations": (0.0, 0.9)}
        return ratios(scenes, camera, 3, seed, **options)

    monkeypatch.setattr(kim_map, "ratios", few)


@pytest.mark.slow
@pytest.mark.usefixtures("tiny")
def test_the_command_writes_claims_figures_and_a_page(tmp_path, capsys):
    sizes = ["--width", "96", "--height", "96", "--fov", "12", "--sessions", "3"]
    assert main.run(["reproduce", "kim", *sizes, "--out", str(tmp_path)]) == 0
    assert "cannot be told" in capsys.readouterr().out
    with open(tmp_path / "claims.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 6
    assert {row["verdict"] for row in rows} <= {HOLDS, FAILS, UNTOLD}
    assert all(row["source"] for row in rows)
    assert len(list((tmp_path / "map").glob("*.npy"))) == 4
    page = (tmp_path / "claims.md").read_text()
    for name in ("claims", "figure_4", "map"):
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000
        assert f"]({name}.png)" in page
    assert all(row["claim"] in page for row in rows)


@pytest.mark.slow
def test_time_that_is_added_is_a_share_of_the_frame():
    share = kim.cost_share(repeats=2)
    assert np.isfinite([share.value, share.low, share.high]).all()
    assert -0.9 < share.value < 3


@pytest.mark.slow
def test_figure_4_shows_all_of_a_small_frame(monkeypatch):
    monkeypatch.setattr(kim, "_SHOWN_PX", 40)
    camera = hj.Camera(24, 24, fov_deg=3.0, refresh_hz=60.0)
    pair = kim.two_frames(camera, 0)
    assert {frames.shape for frames in pair.values()} == {(2, 24, 24, 3)}
