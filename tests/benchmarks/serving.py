"""Both ends of a rival: each runs in its own process, and times itself when told to.

One JSON line per answer. `prepare FILE` loads a task, compiles and runs it once, `time`
runs it again; both answer seconds and processor seconds. `values` answers the last
run's MTCD per session.
"""

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from machine import cpus
from task import Task

Run = Callable[[], np.ndarray]

HERE = Path(__file__).resolve().parent
_REPOSITORY = HERE.parents[1]


def serve(build: Callable[[Task], Run]) -> None:
    """Answer a driver until it hangs up.

    **Arguments:** `build`: makes a task's run, which returns its MTCD per session.
    """
    run: Run | None = None
    mtcd = np.zeros(0)
    for line in sys.stdin:
        word, _, argument = line.strip().partition(" ")
        begun, processor = time.perf_counter(), time.process_time()
        if word == "prepare":
            run = build(Task.load(Path(argument)))
        if word != "values":
            assert run is not None, "prepare comes first"
            mtcd = run()
        seconds = [time.perf_counter() - begun, time.process_time() - processor]
        values = np.asarray(mtcd, float).tolist()
        print(json.dumps(values if word == "values" else seconds), flush=True)


def each_session(one: Callable[[int], float], sessions: int) -> Run:
    """Run sessions one after the other, or on a pool with a thread per core."""
    cores = len(cpus())
    if cores == 1:
        return lambda: np.array([one(s) for s in range(sessions)])
    pool = ThreadPoolExecutor(cores)
    return lambda: np.array(list(pool.map(one, range(sessions))))


def start(command: list[str], cores: int) -> subprocess.Popen[str]:
    """Start a script of this folder, held to as many cores, its pools no larger."""
    threads = ("OMP", "OPENBLAS", "MKL", "NUMBA")
    environment = os.environ | {f"{name}_NUM_THREADS": str(cores) for name in threads}
    environment["OMP_WAIT_POLICY"] = "passive"  # idle rivals do not spin
    path = [str(_REPOSITORY), os.environ.get("PYTHONPATH", "")]
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, path))
    command = [sys.executable, str(HERE / command[0]), *command[1:]]
    with _held_to(cpus()[:cores]):
        return subprocess.Popen(
            command,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )


@contextlib.contextmanager
def _held_to(chosen: list[int]) -> Iterator[None]:
    """Start processes on these processors only: they inherit it from this thread."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, chosen)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


class Rival:
    """The driver's end of a rival's process."""

    def __init__(self, command: Sequence[str], cores: int):
        self._script = " ".join(command)
        self._process = start(list(command), cores)

    def ask(self, request: str) -> Any:
        """Send a line and wait for the answer.

        **Errors:** `RuntimeError` if the process has ended.
        """
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            process.stdin.write(request + "\n")
            process.stdin.flush()
        answer = process.stdout.readline()
        if not answer:
            self.end()
            raise RuntimeError(f"{self._script} ended with {process.returncode}.")
        return json.loads(answer)

    def end(self) -> None:
        """Hang up and wait for the process."""
        self._process.communicate()
