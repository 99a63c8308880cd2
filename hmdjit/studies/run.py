"""Running a study: sessions x scenes x techniques, all on the same head paths.

Sessions run in batches; a batch is the sessions of one dispatch and one file. Finished
batches are kept, so an interrupted study goes on where it stopped.
"""

import contextlib
import functools
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent import futures
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jaxtyping import Bool, Float

from ..estimates.decibels import power_of
from ..frames.sources import AbstractSource
from ..simulation.session import Result
from ..technique_contract.check import forget_checks
from ..technique_contract.small_motion import Still
from ..theory.control_variates import Controls, control_of
from .dataset import check_contains, gathered, write_dataset, write_manifest
from .definition import StudyDefinition
from .executors import Definition, Finished, defined, elsewhere, in_process
from .failures import Failures
from .identity import attributes, definition, numbers_key
from .measured_blocks import Tiles
from .progress import Progress, Tell
from .sampler import CHUNK, PATH_TILES, PILOT_START, Measured, Sampler
from .sequential import Goal, Until, with_controls
from .sessions import Batch
from .stage import Stage, Task, drawing, missing, stages
from .store import Store, batch_words, fingerprint, without_version

if TYPE_CHECKING:
    import xarray

Found = Mapping[str, Result]  # by techniques' fingerprints

_ENDLESS = 2**31 - 1  # sessions, for a study that stops when it is sure


class Run:
    """One call of `Study.run`, or a cell of a sweep, whose result is not written."""

    def __init__(
        self,
        study: StudyDefinition,
        seed: int,
        out: str | os.PathLike | None,
        batch_size: int,
        progress: Tell,
        goal: Goal,
        *,
        omit_failed: bool,
        overwrite: bool,
        executor: futures.Executor | None = None,
        in_flight: int = 1,
        is_cell: bool = False,
    ):
        self.executor, self.in_flight, self.is_cell = executor, in_flight, is_cell
        self.study, self.seed, self.tell, self.goal = study, seed, progress, goal
        self.out = None if out is None else Path(out)
        self.sessions = drawing(study, seed)(study.sessions)
        self.batch_size = min(batch_size, self.sessions.count)
        self.definition = definition(study, seed, goal)
        if not (self.out is None or is_cell or overwrite):
            most = self.sessions.count if goal == Goal() else _ENDLESS
            check_contains(self.out, self.definition, most)
        if unknown := sorted(set(without_version(study))):
            # What such a class computes with may have changed since it was compiled.
            forget_checks()
            jax.clear_caches()
            if self.out is not None:
                words = f"name no version: {', '.join(unknown)}."
                self.tell(Progress(line=f"Not kept for another run, for they {words}"))
        common = [study.display, study.head, study.metrics]
        kept = None if without_version(common) else self.out
        self.store = Store(kept)
        self.failed: set[int] = set()
        self.failures = Failures(omit_failed, float(study.margin_deg), kept)
        self.stages = stages(study, seed, self.batch_size)
        self.identity = numbers_key(study, seed)
        self.known = attributes(study, seed, fingerprint(self.identity, study))
        if not (kept is None or is_cell):
            write_manifest(kept, study, self.definition, self.known)

    def dataset(self) -> "xarray.Dataset":
        """Run what is missing and gather everything."""
        measured, ran = self._nothing(self.sessions.count)
        for s, stage in enumerate(self.stages):
            if self._is_kept(stage):
                for start, found in self.store.found(stage.name, self._key(stage)):
                    self._fill(measured, ran, s, start, found)
        for path in self.store.damaged:
            self.tell(Progress(line=f"Damaged, and run again: {path}"))
        self._check(measured, ran)
        before = done = int(ran.sum())

        def tell(stage: Stage) -> None:
            at = done, ran.size, stage.name, done - before
            self.tell(Progress(*at, unit="simulations"))

        tell(self.stages[0])
        tasks = missing(self.stages, ran, self.batch_size)
        with contextlib.closing(self._results(tasks, tell)) as finished:
            for task, values in finished:
                stage = self.stages[task.stage]
                found = dict(zip(task.techniques, values, strict=True))
                self._keep(stage, task.start, found)
                self._fill(measured, ran, task.stage, task.start, found)
                rows = sum(len(stage.places[key]) for key in task.techniques)
                done += rows * task.size
                tell(stage)
                here = slice(task.start, task.start + task.size)
                self._check(measured, ran, here)
        return self._gathered(measured)

    def _results(
        self, tasks: Iterator[Task], tell: Callable[[Stage], None]
    ) -> Finished:
        """Run batches; yield each with its results by technique."""
        if self.executor is None:
            return in_process(self.stages, self.sessions.count, tasks, tell)

        @functools.lru_cache(maxsize=1)
        def definition(stage: int) -> Definition:
            name = self.stages[stage].name
            return defined(self.study, name, self.seed, self.batch_size)

        return elsewhere(self.executor, self.in_flight, tasks, definition)

    def _fill(
        self, measured: np.ndarray, ran: np.ndarray, s: int, start: int, found: Found
    ) -> None:
        """Put results from a session on where they belong; there may be too many."""
        for key in found.keys() & self.stages[s].places.keys():
            values = self._values([found[key]])[..., : max(ran.shape[-1] - start, 0)]
            here = slice(start, start + values.shape[-1])
            for place in self.stages[s].places[key]:
                measured[:, place, s, here] = values[:, 0]
                ran[place, s, here] = True

    def until(self) -> "xarray.Dataset":
        """Run each scene until its goal is reached."""
        study, goal = self.study, self.goal
        begun = time.perf_counter()
        found, plans, pictures = [], [], None
        for s, stage in enumerate(self.stages):
            start = time.perf_counter()
            left = begun + (goal.budget_s or 0.0) - start
            share = start + left / (len(self.stages) - s)
            # Solids are compiled each on its own, and have nothing to share.
            until = None if stage.is_solid else pictures
            if until is None:
                until = self._until(stage)
            if not stage.is_solid:
                pictures = until
                self.tell(Progress(doing=f"baking {stage.name}"))
            cell, plan = until.scene(stage.name, stage.source(), start, share)
            found.append(cell)
            plans.append(plan)
        count = max(cell.measured.shape[-1] for cell in found)
        self.sessions = drawing(study, self.seed)(count)
        measured, ran = self._nothing(count)
        places = [list(stage.places.values()) for stage in self.stages]
        for s, cell in enumerate(found):
            size = cell.measured.shape[-1]
            for k, mine in enumerate(places[s]):
                measured[:, mine, s, :size] = cell.measured[:, k, None]
                ran[mine, s, :size] = cell.was_simulated()[k]
        self._check(measured, ran)
        shape = measured.shape[1:]
        return self._gathered(
            measured, with_controls(found, plans, goal, places, shape)
        )

    def _until(self, stage: Stage) -> Until:
        """Return what runs a scene, or all pictures, until the goal."""
        study, camera = self.study, self.study.display
        techniques = list(stage.techniques.values())
        baseline = [t.id for t in study.techniques].index(study.baseline)
        paths = controls = None
        if isinstance(study.measure, Tiles) and not stage.is_solid:
            side = study.measure.size_px
            models = {
                fingerprint(m): m
                for m in map(control_of, techniques)
                if not isinstance(m, Still)
            }
            controls = Controls(list(models.values()), camera, study.warmup, side)
            cells = (camera.width_px // side) * (camera.height_px // side)
            paths = stage.sessions(_ENDLESS, Tiles(min(PATH_TILES, cells), side))
        named = {one.name: one for one in self.stages}

        def simulate(name: str, source: AbstractSource, batch: Batch) -> Measured:
            return self._measured(named[name], source, batch)

        endless = stage.sessions(_ENDLESS)
        sampler = Sampler(techniques, endless, paths, controls, simulate, self.tell)
        base = next(k for k, p in enumerate(stage.places.values()) if baseline in p)
        return Until(self.goal, sampler, base, len(study.metrics), self.failures)

    def _nothing(
        self, count: int
    ) -> tuple[
        Float[np.ndarray, "metric technique scene session"],
        Bool[np.ndarray, "technique scene session"],
    ]:
        """No value yet of any metric, and no session that was run."""
        shape = (len(self.study.techniques), len(self.study.scenes), count)
        return np.full((len(self.study.metrics), *shape), np.nan), np.zeros(shape, bool)

    def _measured(self, stage: Stage, source: AbstractSource, batch: Batch) -> Measured:
        """Measure a batch, or find it."""
        found: dict[str, Result] = {}
        # The pilot is timed, so it is always run.
        is_kept = self._is_kept(stage) and batch.start < PILOT_START
        if is_kept:
            words = batch_words(batch.start, batch.size)
            for _, some in self.store.found(stage.name, self._key(stage), words):
                found |= some
        lacking = [key for key in stage.techniques if key not in found]
        if lacking:
            techniques = [stage.techniques[key] for key in lacking]
            measured = stage.runner.run(techniques, source, batch)
            new = dict(zip(lacking, measured, strict=True))
            if is_kept:
                self._keep(stage, batch.start, new)
            found |= new
        return self._values([found[key] for key in stage.techniques])

    def _values(self, found: Sequence[Result]) -> Measured:
        """Return what is averaged of each metric, of techniques: no decibels."""
        values = []
        for metric in self.study.metrics:
            each = [result.metrics[metric.id] for result in found]
            values.append(power_of(each) if metric.is_in_decibels else each)
        return np.asarray(values, float)

    def _key(self, stage: Stage) -> str:
        return fingerprint(self.identity, stage.key)

    def _is_kept(self, stage: Stage) -> bool:
        return not without_version(stage.scene)

    def _keep(self, stage: Stage, start: int, found: Found) -> None:
        """Write what a later run may find."""
        known = stage.techniques
        kept = {k: v for k, v in found.items() if not without_version(known[k])}
        if kept and self._is_kept(stage):
            self.store.keep(stage.name, self._key(stage), start, kept)

    def _check(
        self, measured: np.ndarray, ran: np.ndarray, here: slice = slice(None)
    ) -> None:
        """Stop if too many sessions failed so far; only some of them are new."""
        is_bad = ran[..., here] & ~np.isfinite(measured[..., here]).all(axis=0)
        new = (here.start or 0) + np.flatnonzero(is_bad.any(axis=(0, 1)))
        self.failed.update(new.tolist())
        if self.failed:
            count, done = ran.shape[-1], int(ran.any(axis=(0, 1)).sum())
            words = "sessions" if done == count else f"sessions ({done} run so far)"
            self.failures.check(sorted(self.failed), count, words)

    def _gathered(self, measured: np.ndarray, controls: Any = None) -> "xarray.Dataset":
        count = self.sessions.count
        rotation_deg, wide = np.zeros(count), 0
        runners = {stage.runner: stage for stage in self.stages}
        drawn = {runner: stage.sessions(count) for runner, stage in runners.items()}
        for start in range(0, count, CHUNK):
            batch = self.sessions.batch(start, CHUNK)
            is_wide = np.zeros(batch.size, bool)
            for runner, stage in runners.items():
                techniques = list(stage.techniques.values())
                is_wide |= runner.is_wide(techniques, drawn[runner].batch(start, CHUNK))
            wide += int(is_wide.sum())
            turn = np.degrees(np.asarray(batch.motion.increment))[:, 1:]
            square = np.mean(np.sum(turn**2, axis=-1), axis=-1)
            rotation_deg[start : start + batch.size] = np.sqrt(square)
        how = {
            "definition": json.dumps(self.definition),
            "failed_sessions": json.dumps(sorted(self.failed)),
            "omit_failed": int(self.failures.omit),
            "wide_halo_sessions": wide,
        }
        subjects = self.sessions.subjects
        how |= self.known
        dataset = gathered(self.study, measured, rotation_deg, subjects, how)
        if controls is not None:
            dataset = dataset.assign(controls["variables"])
            dataset = dataset.assign_attrs(controls["attributes"])
        if not (self.out is None or self.is_cell):
            write_dataset(dataset, self.out / "result.nc")
        return dataset
