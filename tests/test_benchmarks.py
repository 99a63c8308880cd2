"""What the benchmarks rest on: their task, their rivals' oracle, their arithmetic."""

import json

import jax
import machine
import numpy as np
import numpy_blend
import opencv_numpy
import ours
import pytest
import run
import scaling
import serving
import summaries
import task


@pytest.fixture(scope="module")
def tiny():
    return task.make(16, 2, steps=4)


@pytest.mark.slow
@pytest.mark.parametrize("count", range(len(ours.ADDITIONS) + 1))
def test_ours_does_the_task(tiny, count):
    added = ours.ADDITIONS[:count]
    exact = task.oracle(tiny, 2, masked="mask" in added)
    # float32: colours are right to 1e-6, that is 3e-4 code values.
    np.testing.assert_allclose(ours.build(tiny, added)(), exact, atol=1e-3)
    assert exact.min() > 1


def test_a_rival_does_the_task(tiny):
    exact = task.oracle(tiny, 2, masked=False)
    mtcd = [numpy_blend.session(tiny, s, opencv_numpy.warp) for s in range(2)]
    np.testing.assert_allclose(mtcd, exact, atol=1e-3)


def test_the_mask_matters(tiny):
    masked, unmasked = (task.oracle(tiny, 2, masked=flag) for flag in (True, False))
    assert not np.allclose(masked, unmasked, atol=1e-2)


def test_a_task_is_the_same_for_everyone(tiny, tmp_path):
    tiny.save(tmp_path / "task.npz")
    loaded = task.Task.load(tmp_path / "task.npz")
    again = task.make(16, 2, steps=4)
    for array, read, drawn in zip(tiny, loaded, again, strict=True):
        np.testing.assert_array_equal(array, read)
        np.testing.assert_array_equal(array, drawn)
    assert tiny.pixel_frames == 2 * 4 * 16**2
    assert abs(np.degrees(tiny.poses)).max() <= task.LARGEST_DEG


def test_the_task_stays_within_our_margin():
    for size in task.SIZES.values():
        side = size.side
        turn = np.radians(np.full(3, task.LARGEST_DEG)) * [[1, 1, 1], [1, -1, -1]]
        for rotation in turn:
            x, y = task._source(side, rotation)
            column, row = np.meshgrid(np.arange(side), np.arange(side))
            assert max(abs(x - column).max(), abs(y - row).max()) < ours.MARGIN_PX


def test_spread_and_slope():
    assert summaries.spread([3.0, 1.0, 2.0, 5.0, 4.0]) == (3.0, 2.0, 4.0)
    sizes = [1.0, 10.0, 100.0]
    seconds = [3 * size**1.5 for size in sizes]
    np.testing.assert_allclose(summaries.slope(sizes, seconds), 1.5)
    np.testing.assert_allclose(summaries.nanoseconds(2.0, 1_000_000), 2000)


def test_ratios_pair_the_runs(rng):
    pace = rng.uniform(1, 3, 9)  # of a machine that others use too
    theirs = list(2 * pace)
    assert summaries.times_as_fast(list(pace), theirs) == (2.0, 2.0, 2.0)
    noisy = list(pace * rng.uniform(0.9, 1.1, 9))
    value, low, high = summaries.times_as_fast(noisy, theirs)
    assert low < value < high


def test_every_rival_has_a_script():
    commands = (run.RIVALS | run.ADDED).values()
    assert all((serving.HERE / script).is_file() for script, *_ in commands)
    assert not task.SIZES.keys() & scaling.POINTS.keys()


def test_tables_are_aligned():
    text = summaries.table(("name", "ns"), [("a", "10.5"), ("longer", "1")])
    assert text.splitlines() == ["name      ns", "a       10.5", "longer     1"]


def test_a_rival_runs_in_its_own_process(tmp_path, tiny):
    tiny.save(tmp_path / "task.npz")
    rival = serving.Rival(["opencv_numpy.py"], 1)
    rival.ask(f"prepare {tmp_path / 'task.npz'}")
    seconds, processor_s = rival.ask("time")
    assert min(seconds, processor_s) > 0
    exact = task.oracle(tiny, 2, masked=False)
    np.testing.assert_allclose(rival.ask("values"), exact, atol=1e-3)
    rival.end()


def test_a_rival_that_fails_is_named(tmp_path):
    rival = serving.Rival(["opencv_numpy.py"], 1)
    with pytest.raises(RuntimeError, match=r"opencv_numpy\.py ended with 1"):
        rival.ask(f"prepare {tmp_path / 'nothing.npz'}")


def test_results_say_where_they_come_from():
    described = json.loads(json.dumps(machine.description()))
    assert described["versions"]["jax"] == jax.__version__
    assert described["cores"] >= 1
    assert machine.peak_mib() > 50  # Python with JAX
