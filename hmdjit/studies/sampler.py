"""What is simulated and predicted of a scene, a chunk of sessions at a time."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from ..estimates.estimate import Estimate, control_variate
from ..estimates.intervals import NanPolicy
from ..frames.sources import Texture
from ..simulation.session import Result
from ..techniques import Freeze
from ..techniques.base import AbstractTechnique
from ..theory.control_variates import Controls, control_of
from ..theory.picture_statistics import PictureStatistics
from .progress import Progress, Tell
from .sessions import Batch, Sessions
from .store import fingerprint

PILOT_START, PATHS_START = 1 << 29, 1 << 30
"""Numbers of the first pilot session and of the first predicted path."""

CHUNK = 64
"""Sessions per dispatch and file: few enough to stop soon, enough to be worth it."""

PILOT_SESSIONS = 2 * CHUNK
LEAST_SESSIONS = 2 * CHUNK
"""From here on means of what the control leaves over are as good as normal; what is
not expected to vary, and has not, is not simulated further."""

PATH_CHUNK, PATH_TILES = 2048, 2

Simulate = Callable[[str, AbstractTechnique, Texture, Batch], Result]
"""Scene, technique, texture and batch to what is measured."""


class Simulated(NamedTuple):
    """MTCD and detail loss, `(runs, sessions)`, and the seconds that each run took."""

    mtcd: np.ndarray
    detail_loss: np.ndarray
    seconds: np.ndarray


@dataclasses.dataclass
class Cell:
    """What was found in a scene: rows are runs (distinct techniques)."""

    simulated: np.ndarray  # MTCD (runs, sessions)
    detail_loss: np.ndarray
    predicted: np.ndarray  # of the same tiles
    paths: np.ndarray  # predicted elsewhere (runs, paths)
    slope: np.ndarray  # (runs,)
    own_share: np.ndarray  # of the sessions' variance, not the tiles' (runs,)
    count: np.ndarray  # sessions that were simulated (runs,); NaN beyond them

    @classmethod
    def empty(cls, runs: int) -> "Cell":
        """Nothing was found yet."""
        none = np.zeros((runs, 0))
        zero, unknown = np.zeros(runs), np.full(runs, np.nan)
        return cls(none, none, none, none, zero, unknown, np.zeros(runs, int))

    def was_run(self) -> np.ndarray:
        """Which sessions were simulated, `(runs, sessions)`."""
        return np.arange(self.simulated.shape[1]) < self.count[:, None]

    def has_failed(self) -> np.ndarray:
        """Which sessions gave some run no finite number, `(sessions,)`."""
        is_good = np.isfinite(self.simulated + self.detail_loss)
        return np.any(self.was_run() & ~is_good, axis=0)

    def estimate(self, run: int, nan_policy: NanPolicy) -> Estimate:
        """Mean MTCD of a run over the sessions that were simulated.

        **Arguments:** `nan_policy`: of the sessions that failed. One that failed for
        one technique is left out of all: they are paired.
        """
        was_run = slice(self.count[run])
        simulated, paths = self.simulated[run, was_run], self.paths[run]
        if nan_policy == "omit":
            simulated = np.where(self.has_failed()[was_run], np.nan, simulated)
        return control_variate(
            simulated,
            self.predicted[run, was_run],
            paths[np.isfinite(paths)],
            float(self.slope[run]),
            nan_policy=nan_policy,
        )


class Sampler:
    """Draws the sessions of a study: the same ones for all scenes.

    - `runs`: distinct techniques.
    - `sessions`, `paths`: to simulate, and only to predict.
    - `controls`: what predicts; None simulates only.
    - `simulate`: kept for a resume; `tell`: how far it is.
    """

    def __init__(
        self,
        runs: Sequence[AbstractTechnique],
        sessions: Sessions,
        paths: Sessions | None,
        controls: Controls | None,
        simulate: Simulate,
        tell: Tell,
    ):
        self.runs, self.sessions, self.paths = tuple(runs), sessions, paths
        self.controls, self.tell = controls, tell
        self._simulate = simulate
        self._drawn: dict[tuple[bool, int, int], Batch] = {}
        self.is_compiled = False
        # Which control predicts a run; a frozen picture needs none.
        self._control: list[int | None] = [None] * len(self.runs)
        if controls is not None:
            known = [fingerprint(control) for control in controls.controls]
            self._control = [
                None
                if isinstance(run, Freeze)
                else known.index(fingerprint(control_of(run)))
                for run in runs
            ]

    def batch(self, sessions: Sessions, start: int, size: int) -> Batch:
        """Sessions from a number on; each is drawn once."""
        name = (sessions is self.paths, start, size)
        if name not in self._drawn:
            self._drawn[name] = sessions.batch(start, size)
        return self._drawn[name]

    def simulated(
        self, scene: str, texture: Texture, batch: Batch, wanted: np.ndarray
    ) -> Simulated:
        """Simulate the wanted runs, `(runs,)` of bool; the others are NaN."""
        found = np.full((2, len(self.runs), batch.size), np.nan)
        seconds = np.zeros(len(self.runs))

        def one(place: int) -> None:
            begun = time.perf_counter()
            result = self._simulate(scene, self.runs[place], texture, batch)
            found[:, place] = result.mtcd, result.detail_loss
            seconds[place] = time.perf_counter() - begun

        places = np.flatnonzero(wanted).tolist()
        if self.is_compiled:
            for place in places:
                one(place)
        else:  # programs compile side by side, one per technique
            with ThreadPoolExecutor(len(self.runs)) as pool:
                list(pool.map(one, places))
        return Simulated(found[0], found[1], seconds)

    def predicted(
        self, statistics: PictureStatistics | None, batch: Batch
    ) -> np.ndarray:
        """Predictions of each run, `(runs, sessions, tiles)`."""
        none = np.zeros(batch.origins.shape[:2])
        if self.controls is None or statistics is None:
            return np.stack([none] * len(self.runs))
        found = self.controls.predict(statistics, batch)
        return np.stack([none if c is None else found[c] for c in self._control])


class SceneSampler:
    """Simulates and predicts sessions of one scene."""

    def __init__(
        self,
        sampler: Sampler,
        name: str,
        texture: Texture,
        statistics: PictureStatistics | None,
    ):
        self._sampler, self._name = sampler, name
        self._texture, self._statistics = texture, statistics
        # Runs that may still show something new.
        self._is_open = np.ones(len(sampler.runs), bool)

    def close(self, runs: np.ndarray) -> None:
        """Simulate some runs, `(runs,)` of bool, in the least sessions only.

        Should these vary after all, the runs go on.
        """
        self._is_open = ~runs

    def _simulated(self, batch: Batch, runs: np.ndarray | None = None) -> Simulated:
        every = np.ones_like(self._is_open)
        wanted = every if runs is None else runs
        return self._sampler.simulated(self._name, self._texture, batch, wanted)

    def _predicted(self, batch: Batch) -> np.ndarray:
        """Predictions of each run, mean over tiles, `(runs, sessions)`."""
        return self._sampler.predicted(self._statistics, batch).mean(axis=-1)

    def pilot(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """MTCD, simulated and predicted, `(runs, sessions)`; seconds per session.

        Seconds are of each run, `(runs,)`, predictions shared out evenly.
        """
        sampler, found, seconds = self._sampler, [], np.zeros(0)
        for start in range(PILOT_START, PILOT_START + PILOT_SESSIONS, CHUNK):
            batch = sampler.batch(sampler.sessions, start, CHUNK)
            # The first chunk may compile: only the last one's time counts.
            simulated = self._compiled(batch)
            begun = time.perf_counter()
            found.append((simulated.mtcd, self._predicted(batch)))
            shared = (time.perf_counter() - begun) / len(simulated.seconds)
            seconds = (simulated.seconds + shared) / CHUNK
        simulated, predicted = (
            np.concatenate(x, axis=1) for x in zip(*found, strict=True)
        )
        return simulated, predicted, seconds

    def _compiled(self, batch: Batch) -> Simulated:
        """Simulate a batch; the first time all programs compile side by side."""
        if self._sampler.is_compiled:
            return self._simulated(batch)
        with ThreadPoolExecutor() as pool:
            simulated = pool.submit(self._simulated, batch)
            others = [
                pool.submit(self._predicted, batch),
                pool.submit(self.pilot_paths),
            ]
            for other in others:
                other.result()
            found = simulated.result()
        self._sampler.is_compiled = True
        return found

    def pilot_paths(self) -> tuple[np.ndarray, float]:
        """Predictions for some paths, `(runs, paths, tiles)`; seconds per path."""
        sampler = self._sampler
        if sampler.paths is None:
            return np.zeros((len(sampler.runs), 2, 1)), 0.0
        found, seconds = np.zeros(0), 0.0
        for start in (PILOT_START, PILOT_START + PATH_CHUNK):
            begun = time.perf_counter()
            batch = sampler.batch(sampler.paths, start, PATH_CHUNK)
            found = sampler.predicted(self._statistics, batch)
            seconds = (time.perf_counter() - begun) / PATH_CHUNK
        return found, seconds

    def add_sessions(self, cell: Cell, count: int, until: float) -> None:
        """Simulate sessions up to a number of them, in whole chunks."""
        sampler = self._sampler
        while cell.simulated.shape[1] < count and time.perf_counter() < until:
            start = cell.simulated.shape[1]
            sampler.tell(Progress(start, count, self._name))
            batch = sampler.batch(sampler.sessions, start, CHUNK)
            if start == LEAST_SESSIONS:
                least, most = cell.simulated.min(axis=1), cell.simulated.max(axis=1)
                self._is_open |= least != most
            if start >= LEAST_SESSIONS and not self._is_open.any():
                break
            wanted = self._is_open | (start < LEAST_SESSIONS)
            new = self._simulated(batch, wanted)
            cell.simulated = np.concatenate([cell.simulated, new.mtcd], axis=1)
            cell.count = np.where(wanted, cell.simulated.shape[1], cell.count)
            cell.detail_loss = np.concatenate([cell.detail_loss, new.detail_loss], 1)
            cell.predicted = np.concatenate(
                [cell.predicted, self._predicted(batch)], axis=1
            )
        sampler.tell(Progress(count, count, self._name))

    def add_paths(self, cell: Cell, count: int, until: float) -> None:
        """Predict paths up to a number of them, in whole chunks."""
        sampler = self._sampler
        while sampler.paths is not None and cell.paths.shape[1] < count:
            if cell.paths.shape[1] and time.perf_counter() > until:
                break
            start = PATHS_START + cell.paths.shape[1]
            found = self._predicted(sampler.batch(sampler.paths, start, PATH_CHUNK))
            cell.paths = np.concatenate([cell.paths, found], axis=1)
