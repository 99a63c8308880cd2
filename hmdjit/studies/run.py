"""Running a study: sessions x scenes x techniques, all on the same head paths.

Sessions run in batches; a batch is the sessions of one dispatch and one file. Finished
batches are kept, so an interrupted study goes on where it stopped.
"""

import functools
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jaxtyping import Bool, Float

from ..estimates.decibels import power_of
from ..frames.sources import AbstractSource
from ..technique_contract.check import forget_checks
from ..technique_contract.small_motion import Still
from ..theory.control_variates import Controls, control_of
from .dataset import check_contains, gathered, write_dataset
from .definition import StudyDefinition
from .failures import Failures
from .identity import MODEL_VERSION, attributes, definition
from .measured_blocks import Tiles
from .progress import Progress, Tell
from .sampler import CHUNK, PATH_TILES, PILOT_START, Measured, Sampler
from .sequential import Goal, Until, with_controls
from .sessions import Batch
from .stage import Stage, drawing, stages
from .store import Store, fingerprint, without_version

if TYPE_CHECKING:
    import xarray

# What moves numbers, but no draws; see `sessions`.
_SETTINGS = ("jax_enable_x64", "jax_default_matmul_precision")
_ENDLESS = 2**31 - 1  # sessions, for a study that stops when it is sure


class Run:
    """One call of `Study.run`, or a cell of a sweep, which has no `result` file."""

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
        result: str = "result.nc",
    ):
        self.study, self.seed, self.tell, self.goal = study, seed, progress, goal
        self.out = None if out is None else Path(out)
        self.file = self.out / result if self.out is not None and result else None
        self.sessions = drawing(study, seed)(study.sessions)
        self.batch_size = min(batch_size, self.sessions.count)
        self.definition = definition(study, seed, goal)
        if self.file is not None and not overwrite:
            most = self.sessions.count if goal == Goal() else _ENDLESS
            check_contains(self.file, self.definition, most)
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
        self.failures = Failures(omit_failed, float(study.margin_deg), kept)
        self.stages = stages(study, seed, self.batch_size)
        self.identity = fingerprint(
            [MODEL_VERSION, jax.__version__, jax.devices()[0].device_kind, seed],
            [str(getattr(jax.config, name)) for name in _SETTINGS],
            [study.display, study.head, study.frames, study.warmup, study.measure],
            [study.oversampling, float(study.margin_deg), study.metrics],
        )

    def dataset(self) -> "xarray.Dataset":
        """Run what is missing and gather everything."""
        study, count = self.study, self.sessions.count
        measured, ran = self._nothing(count)
        done = fresh = 0

        def tell(doing: str) -> None:
            self.tell(Progress(done, ran.size, doing, fresh, unit="simulations"))

        for s, stage in enumerate(self.stages):
            name, source = stage.name, functools.cache(stage.source)
            tell(name)
            sessions = stage.sessions(count)
            for start in range(0, count, self.batch_size):
                batch = sessions.batch(start, self.batch_size)
                here = slice(start, start + batch.size)
                found, new = self._measured(stage, source, batch)
                for k, places in enumerate(stage.places.values()):
                    measured[:, places, s, here] = found[:, k, None]
                ran[:, s, here] = True
                done += batch.size * len(study.techniques)
                fresh += batch.size * new
                tell(name)
                self._check(measured, ran)
        return self._gathered(measured, ran)

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
            measured, ran, with_controls(found, plans, goal, places, shape)
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
            return self._measured(named[name], lambda: source, batch)[0]

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

    def _measured(
        self, stage: Stage, source: Callable[[], AbstractSource], batch: Batch
    ) -> tuple[Measured, int]:
        """Measure a batch, or find it; and how many techniques were measured anew."""
        # The pilot is timed, so it is always run.
        is_timed = batch.start >= PILOT_START
        kept = not (is_timed or without_version(stage.scene))
        key = fingerprint(self.identity, stage.key, batch.start, batch.size)
        file = f"{stage.name}-{batch.start}"
        found = self.store.find(file, key) if kept else {}
        missing = [key for key in stage.techniques if key not in found]
        if missing:
            lacking = [stage.techniques[key] for key in missing]
            results = stage.runner.run(lacking, source(), batch)
            new = dict(zip(missing, results, strict=True))
            found |= new
            new = {
                k: new[k] for k in missing if not without_version(stage.techniques[k])
            }
            if kept and new:
                self.store.keep(file, key, new)
        values = []
        for metric in self.study.metrics:
            each = [found[key].metrics[metric.id] for key in stage.techniques]
            values.append(power_of(each) if metric.is_in_decibels else each)
        return np.asarray(values, float), sum(len(stage.places[k]) for k in missing)

    def _check(self, measured: np.ndarray, ran: np.ndarray) -> None:
        """Stop if too many sessions failed so far."""
        count, done = ran.shape[-1], int(ran.any(axis=(0, 1)).sum())
        words = "sessions" if done == count else f"sessions ({done} run so far)"
        self.failures.check(self._failed(measured, ran), count, words)

    def _failed(self, measured: np.ndarray, ran: np.ndarray) -> list[int]:
        """Sessions that were run and gave a number that is not finite anywhere."""
        is_bad = ran & ~np.isfinite(measured).all(axis=0)
        return [int(i) for i in np.flatnonzero(is_bad.any(axis=(0, 1)))]

    def _gathered(
        self, measured: np.ndarray, ran: np.ndarray, controls: Any = None
    ) -> "xarray.Dataset":
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
        known = attributes(
            self.study, self.seed, fingerprint(self.identity, self.study)
        )
        how = {
            "definition": json.dumps(self.definition),
            "failed_sessions": json.dumps(self._failed(measured, ran)),
            "omit_failed": int(self.failures.omit),
            "wide_halo_sessions": wide,
        }
        subjects = self.sessions.subjects
        dataset = gathered(self.study, measured, rotation_deg, subjects, known | how)
        if controls is not None:
            dataset = dataset.assign(controls["variables"])
            dataset = dataset.assign_attrs(controls["attributes"])
        if self.file is not None:
            write_dataset(dataset, self.file)
        return dataset
