"""TIDOAA's experiment: verdicts on made-up values, paths, what is kept, the command."""

import csv

import jax.numpy as jnp
import numpy as np
import pytest

import hmdjit as hj
from hmdjit.cli import main
from hmdjit.figures import tidoaa as figures
from hmdjit.reproductions import kept, played, tidoaa, tidoaa_claims
from hmdjit.reproductions.claims import FAILS, HOLDS, UNTOLD, Found
from hmdjit.scenes.solids import Solids
from hmdjit.techniques import Freeze, NoAntialiasing


def errors(ours, spread=0.01, none=100.0, msaa=0.0):
    """Twelve sessions of each technique and reference, all by the same heads."""
    noise = 1 + spread * np.random.default_rng(0).standard_normal(12)
    each = (none, 0.8 * none, ours, ours, msaa, 0.0)
    return np.stack([mean * noise for mean in each])


def by_speed(**ours):
    each = {float(name[1:]): errors(value) for name, value in ours.items()}
    return [claim.verdict for claim in tidoaa_claims.by_speed(each, 0)]


def test_a_technique_that_does_as_the_paper_says_holds():
    assert by_speed(_1=20.0, _5=40.0, _12=99.0) == [HOLDS] * 4
    assert by_speed(_1=20.0, _5=80.0, _12=99.0) == [HOLDS, HOLDS, HOLDS, FAILS]


def test_one_that_is_worse_at_a_speed_fails_there():
    better, tends, never, comparable = by_speed(_1=20.0, _5=40.0, _12=150.0)
    assert (better, tends, never, comparable) == (FAILS, FAILS, FAILS, HOLDS)
    (worst, *_) = tidoaa_claims.by_speed({1.0: errors(20.0), 12.0: errors(150.0)}, 0)
    assert "not at 12;" in worst.reason
    assert worst.low <= worst.value <= worst.high < 0


def test_comparable_with_msaa_is_what_removes_half_as_much():
    for ours, verdict in ((75.0, HOLDS), (85.0, FAILS)):
        each = {s: errors(ours, msaa=60.0) for s in (1.0, 3.0, 12.0)}
        assert tidoaa_claims.by_speed(each, 1)[3].verdict == verdict
    itself = {1.0: errors(60.0, msaa=60.0)}
    assert tidoaa_claims.by_speed(itself, 1)[3].verdict == HOLDS


def test_a_speed_at_which_little_is_to_be_seen_has_a_small_interval():
    seen = np.where(np.arange(12) < 2, 1.0, 0.0)  # by two sessions
    empty = errors(1.5, none=1.0) * seen
    found = tidoaa_claims.by_speed({1.0: errors(20.0), 12.0: empty}, 0)
    assert [claim.verdict for claim in found] == [UNTOLD, HOLDS, HOLDS, HOLDS]
    for claim in found:
        assert -0.01 < claim.low <= claim.value <= claim.high < 1
        assert claim.source


def test_few_sessions_that_differ_tell_nothing():
    rng = np.random.default_rng(1)
    loose = {1.0: 50 + 45 * rng.standard_normal((6, 4))}
    assert tidoaa_claims.by_speed(loose, 0)[0].verdict == UNTOLD


def test_the_figure_says_what_was_found():
    each = {speed: errors(60.0 + speed, msaa=50.0) for speed in (0.0, 1.0, 12.0)}
    found = Found(
        "made up",
        "made up.",
        claims=[],
        measured=[r for n in (0, 1) for r in tidoaa_claims.measured(each, n)],
        cases=[],
        lines=[],
        tables={},
    )
    figure = figures.draw(found)["error_by_speed"]
    left, right = figure.axes
    said = "60 to 72 % of no AA's error, MSAA 50 %"
    assert said in right.get_title(loc="left")
    assert "MSAA 50 %" not in left.get_title(loc="left")
    names = right.get_legend_handles_labels()[1]
    assert names == ["no AA", "INSIDE's TAA", "TIDOAA", "MSAA"]


def test_halos_and_trails_are_errors_beyond_those_without():
    assert tidoaa_claims.beside(errors(60.0), 1).verdict == HOLDS
    assert tidoaa_claims.behind(errors(160.0), 1).verdict == FAILS
    assert tidoaa_claims.on_bars(errors(0.7, none=0.5)[:4]).verdict == HOLDS
    seconds = np.array([[1.0, 3.0, 2.0], [1.1, 3.1, 2.1], [1.0, 3.0, 2.0]])
    assert tidoaa_claims.on_cost(seconds).verdict == HOLDS


def test_a_path_turns_evenly_and_its_first_step_is_none():
    motion = played.turning(jnp.float32(0.1), jnp.float32(0.02), 4)
    np.testing.assert_allclose(motion.offset[:, 1], [0.1, 0.12, 0.14, 0.16], rtol=1e-6)
    np.testing.assert_allclose(motion.increment[:, 1], [0, 0.02, 0.02, 0.02])
    assert not np.asarray(motion.offset[:, [0, 2]]).any()


@pytest.mark.slow
def test_what_is_played_is_what_techniques_show():
    camera, scene = hj.Camera(16, 12, 40.0, 60.0), hj.scenes.moving_sphere()
    motion = played.turning(jnp.float32(0.0), jnp.float32(0.0), 3)
    measure = lambda carry, moment: (carry + 1, (moment.shown, carry))
    both = NoAntialiasing(), Freeze()
    shown, count = played.play(
        scene, camera, both, motion, jnp.int32(48), measure, jnp.int32(0)
    )
    assert shown.shape == (3, 2, 3, 12, 16)
    np.testing.assert_array_equal(count, [0, 1, 2])
    np.testing.assert_array_equal(shown[:, 1], np.stack([shown[0, 0]] * 3))
    np.testing.assert_array_equal(
        played.squared_error(shown[0], shown[0, 0]), np.zeros((2, 12, 16))
    )


def test_what_is_finished_is_not_computed_again(tmp_path):
    ran = []

    def compute():
        ran.append(1)
        return np.arange(3.0)

    for parts in ((1, "a"), (1, "a"), (2, "a")):
        found = kept.kept(tmp_path, "name", parts, compute)
        np.testing.assert_array_equal(found, [0, 1, 2])
    assert len(ran) == 2
    assert len(list(tmp_path.glob("name-*.npy"))) == 2


def test_a_scene_that_deforms_shows_the_same_in_another_class():
    rigid = hj.scenes.moving_sphere()
    assert isinstance(rigid, Solids)
    other = tidoaa.deforming(rigid)
    assert set(np.unique(rigid.classes)) == {0, 1}
    np.testing.assert_array_equal(other.classes, 2 * rigid.classes)


@pytest.mark.slow
def test_the_command_writes_its_claims(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(tidoaa, "_QUICK_SPEEDS_DEG", (1.0, 8.0))
    monkeypatch.setattr(tidoaa, "_FRAMES", 2)
    monkeypatch.setattr(tidoaa, "_WARMUP", 2)
    took = np.array([[1.0, 3.0, 2.0]] * 3)
    monkeypatch.setattr(tidoaa, "times", lambda *arguments: took)
    options = ["--sessions", "2", "--width", "32", "--height", "32"]
    assert main.run(["reproduce", "tidoaa", *options, "--out", str(tmp_path)]) == 0
    assert "comparable with MSAA" in capsys.readouterr().out
    with open(tmp_path / "claims.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 8 + 6
    assert {row["verdict"] for row in rows} <= {HOLDS, FAILS, UNTOLD}
    assert all(row["source"] for row in rows)
    assert len(list((tmp_path / "batches").glob("*.npy"))) == 2 + 2
    page = (tmp_path / "claims.md").read_text()
    assert "](error_by_speed.png)" in page
    assert (tmp_path / "error_by_speed.png").stat().st_size > 10_000
