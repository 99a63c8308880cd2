"""Batches of a study on other processes and machines: through any `Executor`.

A task is a batch: the study with one scene, pickled, the session that it starts at, and
the techniques that it lacks. What comes back is a few numbers per session. It may run
twice, anywhere and in any order: the bits are the same, and one process alone writes.
"""

import contextlib
import dataclasses
import functools
import itertools
import multiprocessing
import os
import pickle
import signal
import threading
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent import futures
from multiprocessing import resource_tracker
from typing import Any, NamedTuple

import jax

from .. import _checks
from ..frames.sources import AbstractSource
from .definition import StudyDefinition
from .failures import LostWorkersError
from .identity import SETTINGS, numbers_key
from .runner import Result
from .sessions import Sessions
from .stage import Stage, Task, stages
from .store import fingerprint

MOST_DEATHS = 3
"""Of workers at one batch, before the study is stopped."""


Finished = Generator[tuple[Task, list[Result]], None, None]
"""Batches as they finish, each with its results by technique."""


class Definition(NamedTuple):
    """What a worker must know of a scene, beside the batch."""

    study: bytes
    seed: int
    batch_size: int
    key: str
    settings: tuple[Any, ...]


def defined(study: StudyDefinition, scene: str, seed: int, batch_size: int) -> Any:
    """Define a scene of a study for workers.

    **Errors:** `ValueError` for a class that cannot be pickled.
    """
    own = dataclasses.replace(study, scenes={scene: study.scenes[scene]})
    try:
        content = pickle.dumps(own)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ValueError(
            "executor must be None for a class that cannot be pickled, as one that a "
            f"function defines: {error}."
        ) from None
    key = fingerprint(numbers_key(own, seed), own)
    settings = tuple(getattr(jax.config, name) for name in SETTINGS)
    return Definition(content, seed, batch_size, key, settings)


_measuring = threading.Lock()  # one batch at a time uses all devices


def measure(definition: Definition, task: Task) -> list[Result]:
    """Measure a batch, in a worker; as NumPy arrays, by the task's techniques.

    **Errors:** `ValueError` in a worker whose numbers would be others.
    """
    is_double, precision = definition.settings
    doubled, precise = (
        jax.enable_x64(is_double),
        jax.default_matmul_precision(precision),
    )
    with _measuring, doubled, precise:
        stage, sessions, source = _opened(definition)
        lacking = [stage.techniques[key] for key in task.techniques]
        batch = sessions.batch(task.start, task.size)
        return stage.runner.run(lacking, source(), batch)


@functools.lru_cache(maxsize=2)  # scenes follow each other
def _opened(definition: Definition) -> tuple[Stage, Sessions, Callable]:
    try:
        study = pickle.loads(definition.study)
    except (AttributeError, ImportError) as error:
        raise ValueError(
            f"executor must be None for a class that a worker does not find: {error}."
        ) from None
    key = fingerprint(numbers_key(study, definition.seed), study)
    if key != definition.key:
        raise ValueError(
            "executor must have workers with this code, JAX and kind of device, "
            f"got one with JAX {jax.__version__} on {jax.devices()[0].device_kind}."
        )
    (stage,) = stages(study, definition.seed, definition.batch_size)
    return stage, stage.sessions(study.sessions), functools.cache(stage.source)


def in_process(
    stages: Sequence[Stage],
    count: int,
    tasks: Iterable[Task],
    tell: Callable[[Stage], None],
) -> Finished:
    """Run tasks in this process; yield each with its results.

    **Arguments:** `count`: of all sessions; `tell`: called before each batch.
    """

    @functools.lru_cache(maxsize=1)
    def ready(stage: int) -> tuple[Sessions, AbstractSource]:
        return stages[stage].sessions(count), stages[stage].source()

    for task in tasks:
        stage = stages[task.stage]
        tell(stage)
        sessions, source = ready(task.stage)
        techniques = [stage.techniques[key] for key in task.techniques]
        batch = sessions.batch(task.start, task.size)
        yield task, stage.runner.run(techniques, source, batch)


def in_flight(executor: futures.Executor | None) -> int:
    """Batches that an executor is given at a time: two for each worker, if it says."""
    return 2 * int(getattr(executor, "_max_workers", 32))


def elsewhere(
    executor: futures.Executor,
    in_flight: int,
    tasks: Iterable[Task],
    definition: Callable[[int], Definition],
) -> Finished:
    """Run tasks, a few at a time; yield each with its results, as they finish.

    A task whose worker died is given to another one.

    **Arguments:** `definition`: of a stage.

    **Errors:** `LostWorkersError`, and what the code of a batch raises.
    """
    waiting: dict[futures.Future, Task] = {}
    deaths: Counter[Task] = Counter()
    ahead = iter(tasks)
    try:
        while True:
            for task in itertools.islice(ahead, in_flight - len(waiting)):
                future = executor.submit(measure, definition(task.stage), task)
                waiting[future] = task
            if not waiting:
                return
            done, _ = futures.wait(waiting, return_when=futures.FIRST_COMPLETED)
            for future in done:
                task = waiting.pop(future)
                try:
                    found = future.result()
                except futures.BrokenExecutor:
                    deaths[task] += 1
                    if deaths[task] > MOST_DEATHS:
                        raise
                    ahead = itertools.chain([task], ahead)
                    continue
                yield task, found
    except (futures.BrokenExecutor, futures.CancelledError) as error:
        raise LostWorkersError(f"workers died again and again: {error}") from None
    except Exception as error:
        if type(error).__name__ != "KilledWorker":  # of Dask, which need not be there
            raise
        raise LostWorkersError(f"workers died again and again: {error}") from None
    finally:
        for future in waiting:
            future.cancel()


_CACHE = (
    "jax_compilation_cache_dir",
    "jax_persistent_cache_min_compile_time_secs",
    "jax_persistent_cache_min_entry_size_bytes",
)


class Processes(futures.Executor):
    """Worker processes of one device each; dead ones are replaced.

    Use it in a `with` statement: leaving it, by whatever way, ends them at once, as the
    end of this process does.
    """

    def __init__(self, count: int):
        _checks.whole("workers", count, 1)
        self._max_workers = count  # as the standard library's executors call it
        self._context = multiprocessing.get_context("spawn")
        self._pool: futures.ProcessPoolExecutor | None = None
        self._reader, self._writer = self._context.Pipe(duplex=False)

    def submit(self, function: Callable, /, *args: Any, **kwargs: Any) -> Any:
        """Give a call to a worker."""
        with _blocked_interruptions():
            try:
                if self._pool is not None:
                    return self._pool.submit(function, *args, **kwargs)
            except futures.BrokenExecutor:
                self._pool = None
            cache = {name: getattr(jax.config, name) for name in _CACHE}
            self._pool = futures.ProcessPoolExecutor(
                self._max_workers, self._context, _begin, (self._reader, cache)
            )
            return self._pool.submit(function, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the workers at once."""
        self._writer.close()
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
        self._pool = None
        self._reader.close()


@contextlib.contextmanager
def _blocked_interruptions() -> Iterator[None]:
    """Have processes that start within it never see Ctrl-C; this one sees it later."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # lets Ctrl-C through again when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin(reader: Any, cache: dict[str, Any]) -> None:
    """Set a worker process up, before JAX looks for devices."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(reader,), daemon=True).start()
    os.environ["NPROC"] = "1"  # threads of XLA
    for name, value in cache.items():
        jax.config.update(name, value)
    jax.config.update("jax_num_cpu_devices", 1)


def _end_with(reader: Any) -> None:
    """End this process when the one that started it closes the pipe, or dies."""
    with contextlib.suppress(EOFError, OSError):
        reader.recv_bytes()
    os._exit(0)


@contextlib.contextmanager
def opened(
    workers: int | None = None, dask: str | None = None
) -> Iterator[futures.Executor | None]:
    """Open what `--workers` and `--dask` name: None for the process itself.

    **Errors:** `ImportError` without Dask, `OSError` where no scheduler answers.
    """
    if workers is not None:
        with Processes(workers) as pool:
            yield pool
    elif dask is not None:
        try:
            from distributed import Client
        except ImportError:
            raise ImportError(
                "--dask needs Dask: pip install 'hmdjit[cluster]'."
            ) from None
        try:
            client = Client(dask, set_as_default=False)
        except (OSError, ValueError) as error:
            words = " ".join(str(error).split())
            raise ValueError(
                f"dask must be a scheduler's address, got {dask}: {words}."
            ) from None
        with client:
            yield client.get_executor(pure=False)
    else:
        yield None
