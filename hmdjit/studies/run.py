"""Running a study: sessions x scenes x techniques, all on the same head paths.

Sessions run in batches; a batch is the sessions of one dispatch and one file. Finished
batches are kept, so an interrupted study goes on where it stopped.
"""

import json
import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import jax
import numpy as np

from .._files import written_atomically
from ..frames.sources import Texture
from ..scenes.baking import bake
from ..scenes.base import AbstractScene
from ..simulation.session import Result
from ..simulation.sharding import placed
from ..techniques.base import AbstractTechnique
from ..theory.control_variates import Controls, control_of
from .failures import Failures
from .identity import MODEL_VERSION, attributes
from .measured_blocks import Tiles
from .progress import Progress
from .runner import Runner
from .sampler import CHUNK, PATH_TILES, PILOT_START, Sampler
from .sequential import Goal, Until, with_controls
from .sessions import Batch, Sessions
from .store import Store, fingerprint
from .study import Study

if TYPE_CHECKING:
    import xarray

_PILOT_SESSIONS = 256
_ENDLESS = 2**31 - 1  # sessions, for a study that stops when it is sure


def _sessions(study: Study, seed: int, count: int) -> Sessions:
    length = study.warmup + study.frames
    return Sessions(seed, study.head, study.display, study.measure, count, length)


def _runner(study: Study, batch_size: int) -> Runner:
    # The pilot's sessions are always the same ones, so that no session's result depends
    # on which others are run with it.
    pilot = _sessions(study, 0, _PILOT_SESSIONS)
    return Runner(
        study.display,
        study.measure,
        study.techniques,
        study.warmup,
        batch_size,
        pilot.batch(0, pilot.count),
    )


class Run:
    """One call of `Study.run`."""

    def __init__(
        self,
        study: Study,
        seed: int,
        out: str | os.PathLike | None,
        batch_size: int,
        progress: Callable[[Progress], None],
        *,
        omit_failed: bool,
    ):
        self.study, self.seed, self.tell = study, seed, progress
        self.out = None if out is None else Path(out)
        self.failures = Failures(omit_failed, float(study.margin_deg), self.out)
        self.sessions = _sessions(study, seed, study.sessions)
        self.batch_size = min(batch_size, self.sessions.count)
        self.runner = _runner(study, self.batch_size)
        self.store = Store(self.out)
        self.scene_key = ""  # of the scene that is being run
        # Techniques that show the same on pictures share a run: their places, by run.
        self.runs: dict[str, tuple[AbstractTechnique, list[int]]] = {}
        for place, technique in enumerate(study.techniques):
            run = technique.on_pictures()
            self.runs.setdefault(fingerprint(run), (run, []))[1].append(place)
        shape = (len(study.techniques), len(study.scenes), self.sessions.count)
        self.mtcd, self.detail_loss = np.full((2, *shape), np.nan)
        self.ran = np.zeros(shape, bool)
        self.wide = np.zeros(self.sessions.count, bool)
        self.rotation_deg = np.zeros(self.sessions.count)
        self.identity = fingerprint(
            [MODEL_VERSION, jax.__version__, jax.devices()[0].device_kind, seed],
            [study.display, study.head, study.frames, study.warmup, study.measure],
            [study.oversampling, float(study.margin_deg)],
        )

    def dataset(self) -> "xarray.Dataset":
        """Run what is missing and gather everything."""
        starts = range(0, self.sessions.count, self.batch_size)
        done = fresh = 0
        for s, (name, scene) in enumerate(self.study.scenes.items()):
            scene_key = fingerprint(scene)
            texture = None
            for start in starts:
                batch = self.sessions.batch(start, self.batch_size)
                here = slice(start, start + batch.size)
                for technique, places in self.runs.values():
                    file = f"{technique.id}-{name}-{start}"
                    key = fingerprint(
                        self.identity, scene_key, technique, start, batch.size
                    )
                    result = self.store.find(file, key)
                    if result is None:
                        if texture is None:
                            self._say(f"baking {name}", done, fresh)
                            texture = placed(self._bake(scene))
                        self._say(f"{name}: {technique.id}", done, fresh)
                        result = self.runner.run(technique, texture, batch)
                        self.store.keep(file, key, result)
                        fresh += batch.size * len(places)
                    self.mtcd[places, s, here] = result.mtcd
                    self.detail_loss[places, s, here] = result.detail_loss
                    self.ran[places, s, here] = True
                    done += batch.size * len(places)
                    self._say(f"{name}: {technique.id}", done, fresh)
                count, ran = self.sessions.count, int(self.ran.any(axis=(0, 1)).sum())
                words = "sessions" if ran == count else f"sessions ({ran} run so far)"
                self.failures.check(self._failed(), count, words)
                if s == 0:
                    self._describe(batch, here)
        return self._gather()

    def until(self, goal: Goal) -> "xarray.Dataset":
        """Run each scene until its goal is reached."""
        study, camera = self.study, self.study.display
        begun = time.perf_counter()
        runs = [technique for technique, _ in self.runs.values()]
        places = [places for _, places in self.runs.values()]
        baseline = [t.id for t in study.techniques].index(study.baseline)
        length = study.warmup + study.frames
        paths = controls = None
        if isinstance(study.measure, Tiles):
            side = study.measure.size_px
            known = {fingerprint(c): c for c in map(control_of, runs)}
            controls = Controls(
                list(known.values()), camera, study.warmup, side, self.runner.mesh
            )
            cells = (camera.width_px // side) * (camera.height_px // side)
            several = Tiles(min(PATH_TILES, cells), side)
            paths = Sessions(self.seed, study.head, camera, several, _ENDLESS, length)
        sampler = Sampler(
            runs,
            _sessions(study, self.seed, _ENDLESS),
            paths,
            controls,
            self._simulated,
            lambda done, total, doing, line: self.tell(
                Progress(done, total, doing, 0, line)
            ),
        )
        base = next(run for run, mine in enumerate(places) if baseline in mine)
        until = Until(goal, sampler, base, self.failures)
        found, plans = [], []
        for s, (name, scene) in enumerate(study.scenes.items()):
            start = time.perf_counter()
            left = begun + (goal.budget_s or 0.0) - start
            self.scene_key = fingerprint(scene)
            self.tell(Progress(0, 1, f"baking {name}", 0))
            texture = placed(self._bake(scene))
            share = start + left / (len(study.scenes) - s)
            cell, plan = until.scene(name, texture, start, share)
            found.append(cell)
            plans.append(plan)
        count = max(cell.simulated.shape[1] for cell in found)
        self.sessions = _sessions(study, self.seed, count)
        shape = (len(study.techniques), len(study.scenes), count)
        self.mtcd, self.detail_loss = np.full((2, *shape), np.nan)
        self.ran = np.zeros(shape, bool)
        self.wide, self.rotation_deg = np.zeros(count, bool), np.zeros(count)
        for s, cell in enumerate(found):
            size = cell.simulated.shape[1]
            for run, mine in enumerate(places):
                self.mtcd[mine, s, :size] = cell.simulated[run]
                self.detail_loss[mine, s, :size] = cell.detail_loss[run]
                self.ran[mine, s, :size] = cell.was_run()[run]
        for start in range(0, count, CHUNK):
            batch = self.sessions.batch(start, CHUNK)
            self._describe(batch, slice(start, start + batch.size))
        self.failures.check(self._failed(), count)
        return self._gather(with_controls(found, plans, goal, places, shape))

    def _simulated(
        self, name: str, run: AbstractTechnique, texture: Texture, batch: Batch
    ) -> Result:
        key = fingerprint(self.identity, self.scene_key, run, batch.start, batch.size)
        file = f"{run.id}-{name}-{batch.start}"
        result = self.store.find(file, key)
        if result is None:
            result = self.runner.run(run, texture, batch)
            if batch.start < PILOT_START:  # the pilot is timed, so it is always run
                self.store.keep(file, key, result)
        return result

    def _say(self, doing: str, done: int, fresh: int) -> None:
        self.tell(Progress(done, self.mtcd.size, doing, fresh))

    def _bake(self, scene: AbstractScene) -> Texture:
        return bake(
            scene,
            self.study.display,
            oversampling=self.study.oversampling,
            margin_deg=self.study.margin_deg,
        )

    def _describe(self, batch: Batch, here: slice) -> None:
        for technique, _ in self.runs.values():
            self.wide[here] |= self.runner.is_wide(technique, batch)
        turn = np.degrees(np.asarray(batch.motion.increment))[:, 1:]
        self.rotation_deg[here] = np.sqrt(np.mean(np.sum(turn**2, axis=-1), axis=-1))

    def _failed(self) -> list[int]:
        """Sessions that were run and gave a non-finite number anywhere."""
        is_bad = self.ran & ~np.isfinite(self.mtcd + self.detail_loss)
        return [int(i) for i in np.flatnonzero(is_bad.any(axis=(0, 1)))]

    def _gather(self, controls: Mapping | None = None) -> "xarray.Dataset":
        import xarray

        study = self.study
        dims = ("technique", "scene", "session")
        code = {"units": "code values of 255"}
        dataset = xarray.Dataset(
            {
                "mtcd": (dims, self.mtcd, code),
                "detail_loss": (dims, self.detail_loss, {"units": "code values^2"}),
                "rotation_deg": (
                    "session",
                    self.rotation_deg,
                    {"units": "deg", "long_name": "RMS rotation per frame"},
                ),
            },
            {
                "technique": [technique.id for technique in study.techniques],
                "scene": list(study.scenes),
                "session": np.arange(self.sessions.count),
            },
            attributes(study, self.seed, fingerprint(self.identity, study))
            | {
                "failed_sessions": json.dumps(self._failed()),
                "omit_failed": int(self.failures.omit),
                "wide_halo_sessions": int(self.wide.sum()),
            },
        )
        if self.sessions.subjects is not None:
            dataset = dataset.assign_coords(subject=("session", self.sessions.subjects))
        if controls is not None:
            dataset = dataset.assign(controls["variables"]).assign_attrs(
                controls["attributes"]
            )
        if self.out is not None:
            write_dataset(dataset, self.out / "result.nc")
        return dataset


def write_dataset(dataset: "xarray.Dataset", path: Path) -> None:
    """Write a dataset as NetCDF 4, whole or not at all."""
    with written_atomically(path) as unfinished:
        dataset.to_netcdf(unfinished, engine="h5netcdf")
