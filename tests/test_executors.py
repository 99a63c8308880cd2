"""Batches elsewhere: the same bits, whoever runs them, and nothing lost."""

import contextlib
import json
import os
import pickle
import re
import signal
import subprocess
import sys
import time
from concurrent import futures
from pathlib import Path

import jax
import numpy as np
import pytest
import small
import xarray

import hmdjit as hj
from hmdjit.cli import main as cli
from hmdjit.studies import executors, runner
from hmdjit.studies.failures import LostWorkersError


def _study(**changes):
    techniques = [hj.techniques.NoAntialiasing()]
    return small.study(**{"techniques": techniques} | changes)


@pytest.fixture(scope="module")
def plain():
    return _study().run(seed=5)


class Mortal(futures.ThreadPoolExecutor):
    """Loses its worker at some of its calls; otherwise one that has one thread."""

    def __init__(self, deaths):
        super().__init__(1)
        self.deaths, self.calls, self.waiting, self.most = set(deaths), 0, 0, 0

    def submit(self, function, /, *arguments, **named):
        self.calls += 1
        # What real workers are sent, and send back.
        function, arguments = pickle.loads(pickle.dumps((function, arguments)))
        if self.calls in self.deaths:
            lost = futures.Future()
            lost.set_exception(futures.BrokenExecutor("gone"))
            return lost
        self.waiting += 1
        self.most = max(self.most, self.waiting)
        future = super().submit(lambda: pickle.dumps(function(*arguments)))
        found = futures.Future()

        def give(done):
            self.waiting -= 1
            if done.exception():
                found.set_exception(done.exception())
            else:
                found.set_result(pickle.loads(done.result()))

        future.add_done_callback(give)
        return found


def test_bits_do_not_depend_on_the_executor(tmp_path, plain):
    with Mortal({2, 4, 5}) as pool:
        found = _study().run(5, out=tmp_path, executor=pool, batch_size=3)
    xarray.testing.assert_identical(found.drop_attrs(), plain.drop_attrs())
    assert pool.calls == 4 + 3
    assert pool.most <= 2  # for each worker
    # This process has kept what was found: nothing is left to be run.
    with Mortal(()) as pool:
        again = _study().run(5, out=tmp_path, executor=pool, batch_size=5)
    assert pool.calls == 0
    xarray.testing.assert_identical(again, found)


def test_solids_heads_and_settings_are_sent(plain):
    scenes = {"solids": small.solids(), "noise": small.NOISE}
    study = _study(scenes=scenes, sessions=2, frames=2, warmup=1)
    with jax.enable_x64(False), Mortal(()) as pool:
        assert study.run(executor=pool).drop_attrs().identical(study.run().drop_attrs())


def test_workers_that_die_again_and_again_stop_the_study(tmp_path):
    with (
        Mortal(range(1, 99)) as pool,
        pytest.raises(LostWorkersError, match="again and again"),
    ):
        _study().run(out=tmp_path, executor=pool)
    assert pool.calls == executors.MOST_DEATHS + 1


def test_what_a_batch_raises_is_not_tried_again(monkeypatch):
    def fail(*_):
        raise RuntimeError("of a batch")

    monkeypatch.setattr(runner.Runner, "run", fail)
    with Mortal(()) as pool, pytest.raises(RuntimeError, match="of a batch"):
        _study().run(executor=pool, batch_size=3, in_flight=1)
    assert pool.calls == 1


def test_what_cannot_be_sent_is_refused():
    class Local(hj.techniques.NoAntialiasing):
        pass

    with (
        Mortal(()) as pool,
        pytest.raises(ValueError, match=r"executor must be None .*'.*Local'"),
    ):
        _study(techniques=[Local()]).run(executor=pool)


def test_workers_with_other_code_are_refused(monkeypatch):
    versions = iter(["5", "5", "6"])
    monkeypatch.setattr(
        executors, "numbers_key", lambda *_: next(versions), raising=True
    )
    study = _study(frames=3)
    definition = executors.defined(study, "noise", 0, 3)
    assert definition.key == executors.defined(study, "noise", 0, 3).key
    with pytest.raises(ValueError, match="workers with this code, JAX and kind of"):
        executors._opened(definition)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--workers", "0"], "--workers must be a whole number >= 1, got 0."),
        (["--workers", "2", "--dask", "x"], "--workers and --dask exclude each other"),
        (
            ["--workers", "1", "--tolerance", "0.1"],
            "--workers need a number of sessions",
        ),
    ],
)
def test_wrong_executors_are_refused(options, message, tmp_path, capsys):
    assert cli.run(["study", *options, "--out", str(tmp_path)]) == cli.WRONG_INPUT
    assert message in capsys.readouterr().err


# --- real processes ---

TINY = [
    *("study", "--scenes", "noise", "--techniques", "none", "freeze"),
    *("--baseline", "none", "--width", "64", "--height", "64", "--fov", "8"),
    *("--tiles", "1", "--tile-size", "16", "--frames", "3", "--warmup", "2"),
]
BATCHES = 16
SESSIONS = ["--sessions", str(256 * BATCHES - 100)]
RNG = np.random.default_rng()  # moments are random, whatever is drawn


@contextlib.contextmanager
def _begun(*command):
    """Begin a command in a group of its own, which Ctrl-C reaches as on a terminal."""
    process = subprocess.Popen(
        [sys.executable, *map(str, command)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def _study_of(out, *more):
    return _begun("-m", "hmdjit", *TINY, *SESSIONS, "--out", out, *more)


def _finished(out, *more):
    """Run a study to its end; return its result's bytes."""
    with _study_of(out, *more) as process:
        _, error = process.communicate(timeout=600)
    assert process.returncode == 0, error
    assert not error
    return (out / "result.nc").read_bytes()


def _kept(out):
    """Batches of a folder, and which time each was written."""
    return {path: path.stat().st_ino for path in out.glob("batches/*.npz")}


def _wait_for(out, count, process):
    """Wait until so many batches are there, and a random moment more."""
    while len(_kept(out)) < count and process.poll() is None:
        time.sleep(0.002)
    time.sleep(RNG.uniform(0, 0.2))


def _children(process):
    tasks = Path(f"/proc/{process.pid}/task").glob("*/children")
    return [int(pid) for file in tasks for pid in file.read_text().split()]


def _workers(process):
    """Processes of a pool: not the one that looks after their semaphores."""
    lines = {
        pid: Path(f"/proc/{pid}/cmdline").read_bytes() for pid in _children(process)
    }
    return [pid for pid, line in lines.items() if b"spawn_main" in line]


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    if not Path("/proc/self/task").exists():
        pytest.skip("this system does not tell which processes there are")
    return _finished(tmp_path_factory.mktemp("uninterrupted"))


MOMENTS = [
    pytest.param(3, marks=pytest.mark.slow),
    pytest.param(20, marks=pytest.mark.exhaustive),
]


@pytest.mark.parametrize("moments", MOMENTS)
@pytest.mark.parametrize("more", [(), ("--workers", 2)], ids=["here", "workers"])
def test_a_killed_study_goes_on_where_it_was(more, moments, tmp_path, uninterrupted):
    kept = {}
    for count in np.sort(RNG.integers(0, BATCHES, moments)):
        with _study_of(tmp_path, *more) as process:
            _wait_for(tmp_path, count, process)
            workers = _workers(process)
            process.kill()
            process.communicate()
        for pid in workers:  # they do not outlive it
            assert _is_gone(pid)
        assert kept.items() <= _kept(tmp_path).items()
        kept = _kept(tmp_path)
    assert _finished(tmp_path, *more) == uninterrupted
    assert kept.items() <= _kept(tmp_path).items()
    assert len(_kept(tmp_path)) == BATCHES


def _is_gone(pid):
    for _ in range(1000):
        if not Path(f"/proc/{pid}").exists():
            return True
        time.sleep(0.02)
    return False


@pytest.mark.parametrize("moments", MOMENTS)
def test_a_killed_worker_is_replaced(moments, tmp_path, uninterrupted):
    died = 0
    with _study_of(tmp_path, "--workers", 2) as process:
        for count in np.sort(RNG.integers(1, BATCHES - 2, moments)):
            _wait_for(tmp_path, count, process)
            if workers := _workers(process):
                died += 1
                os.kill(RNG.choice(workers), signal.SIGKILL)
        _, error = process.communicate(timeout=600)
    assert (process.returncode, error) == (0, "")
    assert died
    assert (tmp_path / "result.nc").read_bytes() == uninterrupted
    assert len(_kept(tmp_path)) == BATCHES


@contextlib.contextmanager
def _cluster(folder):
    """A Dask scheduler; yields its address and what begins a worker."""
    pytest.importorskip("distributed")
    file = folder / "scheduler.json"
    at = ["--scheduler-file", file, "--no-dashboard"]
    scheduler = ["-m", "distributed.cli.dask_scheduler", *at, "--host", "127.0.0.1"]
    worker = ["-m", "distributed.cli.dask_worker", *at, "--no-nanny", "--nthreads", 1]
    with contextlib.ExitStack() as stack:
        stack.enter_context(_begun(*scheduler, "--port", 0))
        while not file.exists():
            time.sleep(0.1)
        address = json.loads(file.read_text())["address"]
        yield address, lambda: stack.enter_context(_begun(*worker))


@pytest.mark.parametrize("moments", MOMENTS)
def test_killed_dask_workers_and_studies_lose_nothing(moments, tmp_path, uninterrupted):
    out = tmp_path / "out"
    with _cluster(tmp_path) as (address, worker):
        workers = [worker(), worker()]
        for k, count in enumerate(np.sort(RNG.integers(1, BATCHES - 2, moments))):
            kept = _kept(out)
            with _study_of(out, "--dask", address) as process:
                _wait_for(out, count, process)
                workers.pop(0).kill()
                if k % 2 == 0:  # both at once
                    process.kill()
                    process.communicate()
                else:
                    _, error = process.communicate(timeout=600)
                    assert process.returncode == 0, error
                    assert "Traceback" not in error  # Dask logs that a worker is gone
                    assert (out / "result.nc").read_bytes() == uninterrupted
                    (out / "result.nc").unlink()
                assert kept.items() <= _kept(out).items()
                if k % 2:
                    for path in RNG.choice(list(_kept(out)), BATCHES - 4, False):
                        path.unlink()
            workers.append(worker())
        kept = _kept(out)
        assert _finished(out, "--dask", address) == uninterrupted
        assert kept.items() <= _kept(out).items()


@pytest.mark.parametrize("moments", MOMENTS)
@pytest.mark.parametrize("more", [(), ("--workers", 2)], ids=["here", "workers"])
def test_an_interruption_stops_at_once_and_says_so(more, moments, tmp_path):
    for after_s in RNG.uniform(0, 25, moments):
        with _study_of(tmp_path, "--sessions", 10**6, *more) as process:
            maps = Path(f"/proc/{process.pid}/maps")
            while "numpy" not in maps.read_text(encoding="utf-8"):
                time.sleep(0.002)
            time.sleep(after_s)
            workers = _workers(process)
            os.killpg(process.pid, signal.SIGINT)
            begun = time.monotonic()
            _, error = process.communicate(timeout=60)
        took = time.monotonic() - begun
        assert process.returncode == 130, (after_s, error)
        assert re.fullmatch(r"hmdjit: stopped[^\n]*\.\n", error), (after_s, error)
        assert all(_is_gone(pid) for pid in workers)
        assert took < 30


def test_a_scheduler_that_is_not_there_is_told(tmp_path, capsys):
    pytest.importorskip("distributed")
    command = [*TINY, "--out", str(tmp_path), "--dask", "tcp://127.0.0.1:9"]
    assert cli.run(command) == cli.WRONG_INPUT
    error = capsys.readouterr().err
    assert re.fullmatch(r"hmdjit: error: --dask [^\n]*127\.0\.0\.1:9[^\n]*\n", error)
