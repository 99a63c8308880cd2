"""The thesis' experiment: verdicts on made-up values, scenes, scores, the command."""

import csv

import jax
import numpy as np
import pytest

import hmdjit as hj
from hmdjit.cli import main
from hmdjit.reproductions import sobel, sobel_claims
from hmdjit.reproductions.claims import FAILS, HOLDS, UNTOLD

COUNT = len(sobel_claims.NAMES)


def errors(mse, spread=0.01):
    """Twelve sessions of all conditions: five that are named, and alike ones."""
    noise = 1 + spread * np.random.default_rng(0).standard_normal(12)
    others = (mse[-2] / 10, mse[-1] * 10, mse[-2] / 12, mse[-1])
    found = np.outer([*(mse if len(mse) == 5 else (1, 1, 1, *mse)), *others], noise)
    return sobel_claims.Errors(found, 1 - found / 1e5, 1.02 * found, found)


def of_thesis(**changed):
    """Return what each table of the thesis itself has, but what is changed."""
    return {
        name: errors(changed.get(name.replace(" ", "_"), table.mse))
        for name, table in sobel_claims.ALL.items()
    }


def verdicts(found, start):
    return [c.verdict for c in found if c.claim.startswith(start)]


def test_the_thesis_own_numbers_hold():
    found = sobel_claims.judge(of_thesis())
    sources = {claim.source for claim in found}
    assert sources == {"table 4.1", *(f"table 5.{k}" for k in range(1, 14))}
    still = [c for c in found if not c.claim.startswith("with one sharpening")]
    assert {claim.verdict for claim in still} == {HOLDS}
    assert len(found) == 2 * 12 + 2 * 9 + 3


def test_another_order_fails_where_it_is_another():
    swapped = of_thesis(pipe=(1.278, 3.573, 8.608, 14.602, 20.0))
    found = sobel_claims.judge(swapped)
    assert verdicts(found, "Master TAA is nearer") == [
        FAILS if "(pipe)" in claim.measure else HOLDS
        for claim in found
        if claim.claim.startswith("Master TAA is nearer")
    ]
    assert verdicts(found, "the thesis' best") == [FAILS] + 8 * [HOLDS]
    assert verdicts(found, "all five") == [FAILS] + 8 * [HOLDS]


def test_sessions_that_differ_tell_nothing():
    rng = np.random.default_rng(1)
    loose = np.exp(2 * rng.standard_normal((COUNT, 4)))
    every = {name: sobel_claims.Errors(*[loose] * 4) for name in sobel_claims.ALL}
    assert UNTOLD in verdicts(sobel_claims.judge(every), "Master TAA is nearer")


def test_cost_is_relative():
    seconds = np.array([[1.0, 1.05], [1.1, 1.15], [1.0, 1.05]])
    assert sobel_claims.on_cost(seconds).verdict == HOLDS
    assert sobel_claims.on_cost(seconds * [1, 4]).verdict == FAILS


def test_scores_are_those_of_eight_bits():
    rng = np.random.default_rng(0)
    truth = rng.integers(40, 200, (24, 24, 3)).astype(np.uint8)
    pictures = np.stack([*[truth + np.uint8(3)] * COUNT, truth + np.uint8(1), truth])
    mse, ssim, mse_16, signal = sobel_claims.scored(pictures)
    outside = pictures.copy()
    outside[:, :4] += 9
    np.testing.assert_array_equal(
        sobel_claims.scored(outside), (mse, ssim, mse_16, signal)
    )
    np.testing.assert_allclose(mse, 9.0)
    np.testing.assert_allclose(mse_16, 4.0)
    np.testing.assert_allclose(signal, np.mean(truth[4:-4, 4:-4].astype(float) ** 2))
    assert (ssim < 1).all()


def test_each_table_has_a_scene_and_hairballs_turn():
    made = sobel.experiments()
    assert set(made) == set(sobel_claims.ALL)
    still, turns = made["hairball"](), made["turning hairball"]()
    assert jax.tree.structure(still) == jax.tree.structure(turns)  # one program
    assert (still.paths.rotation[1, 1], turns.paths.rotation[1, 1]) == (0, 1)


@pytest.mark.slow
def test_the_command_writes_its_claims(tmp_path, monkeypatch):
    sphere = hj.scenes.moving_sphere(shadows=False)
    makers = {name: lambda: sphere for name in sobel_claims.ALL}
    monkeypatch.setattr(sobel, "experiments", lambda: makers)
    monkeypatch.setattr(sobel, "times", lambda *given: np.ones((3, 2)) * [1, 1.5])
    options = ["--sessions", "2", "--width", "24", "--height", "24"]
    assert main.run(["reproduce", "sobel", *options, "--out", str(tmp_path)]) == 0
    with open(tmp_path / "claims.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 12 + 2 * 9 + 4
    assert {row["verdict"] for row in rows} <= {HOLDS, FAILS, UNTOLD}
    for name in ("claims", "ssim_maps", "errors"):
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000
    assert len(list((tmp_path / "batches").glob("*.npy"))) == 2 * 12
