"""What is simulated and predicted of a scene, a chunk of sessions at a time."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ..picture_statistics import PictureStatistics
from ..session import Result
from ..sources import Texture
from ..techniques import Freeze
from ..techniques.base import AbstractTechnique
from .batches import fingerprint
from .controls import Controls, control_of
from .estimators import Estimate, control_variate
from .sessions import Batch, Sessions

PILOT_START, PATHS_START = 1 << 29, 1 << 30
"""Numbers of the first pilot session and of the first predicted path."""

CHUNK = 64
"""Sessions per dispatch and file: few enough to stop soon, enough to be worth it."""

PILOT_SESSIONS = 2 * CHUNK
PATH_CHUNK, PATH_TILES = 2048, 2

Simulate = Callable[[str, AbstractTechnique, Texture, Batch], Result]
"""Scene, technique, texture and batch to what is measured."""

Tell = Callable[[int, int, str, str], None]
"""Done, total, what is being done, and a line to print or ""."""


@dataclasses.dataclass
class Cell:
    """What was found in a scene: rows are runs (distinct techniques)."""

    simulated: np.ndarray  # MTCD (runs, sessions)
    detail_loss: np.ndarray
    predicted: np.ndarray  # of the same tiles
    paths: np.ndarray  # predicted elsewhere (runs, paths)
    slope: np.ndarray  # (runs,)
    own_share: np.ndarray  # of the sessions' variance, not the tiles' (runs,)

    @classmethod
    def empty(cls, runs: int) -> "Cell":
        """Nothing was found yet."""
        none = np.zeros((runs, 0))
        return cls(none, none, none, none, np.zeros(runs), np.full(runs, np.nan))

    def estimate(self, run: int) -> Estimate:
        """Mean MTCD of a run."""
        # A session that failed for one technique counts for none: they are paired.
        failed = ~np.isfinite(self.simulated).all(axis=0)
        paths = self.paths[run]
        return control_variate(
            np.where(failed, np.nan, self.simulated[run]),
            self.predicted[run],
            paths[np.isfinite(paths)],
            float(self.slope[run]),
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
        self._drawn: dict[tuple[int, int], Batch] = {}
        self._is_compiled = False
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
        if (start, size) not in self._drawn:
            self._drawn[start, size] = sessions.batch(start, size)
        return self._drawn[start, size]

    def simulated(
        self, scene: str, texture: Texture, batch: Batch
    ) -> tuple[np.ndarray, np.ndarray]:
        """MTCD and detail loss of each run, `(runs, sessions)`."""
        one = lambda run: self._simulate(scene, run, texture, batch)
        if self._is_compiled:
            results = [one(run) for run in self.runs]
        else:
            # Programs compile side by side, one per technique.
            with ThreadPoolExecutor(len(self.runs)) as pool:
                results = list(pool.map(one, self.runs))
            self._is_compiled = True
        mtcd = np.stack([np.asarray(r.mtcd, float) for r in results])
        return mtcd, np.stack([np.asarray(r.detail_loss, float) for r in results])

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

    def _simulated(self, batch: Batch) -> tuple[np.ndarray, np.ndarray]:
        return self._sampler.simulated(self._name, self._texture, batch)

    def _predicted(self, batch: Batch) -> np.ndarray:
        """Predictions of each run, mean over tiles, `(runs, sessions)`."""
        return self._sampler.predicted(self._statistics, batch).mean(axis=-1)

    def pilot(self) -> tuple[np.ndarray, np.ndarray, float]:
        """MTCD, simulated and predicted, `(runs, sessions)`; seconds per session."""
        sampler, found, seconds = self._sampler, [], 0.0
        for start in range(PILOT_START, PILOT_START + PILOT_SESSIONS, CHUNK):
            batch = sampler.batch(sampler.sessions, start, CHUNK)
            self._predicted(batch)  # compiled, before the clock starts
            begun = time.perf_counter()
            found.append((self._simulated(batch)[0], self._predicted(batch)))
            # The first chunk compiles: only the last one's time counts.
            seconds = (time.perf_counter() - begun) / CHUNK
        simulated, predicted = (
            np.concatenate(x, axis=1) for x in zip(*found, strict=True)
        )
        return simulated, predicted, seconds

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
            sampler.tell(start, count, self._name, "")
            batch = sampler.batch(sampler.sessions, start, CHUNK)
            mtcd, loss = self._simulated(batch)
            cell.simulated = np.concatenate([cell.simulated, mtcd], axis=1)
            cell.detail_loss = np.concatenate([cell.detail_loss, loss], axis=1)
            cell.predicted = np.concatenate(
                [cell.predicted, self._predicted(batch)], axis=1
            )
        sampler.tell(count, count, self._name, "")

    def add_paths(self, cell: Cell, count: int, until: float) -> None:
        """Predict paths up to a number of them, in whole chunks."""
        sampler = self._sampler
        while sampler.paths is not None and cell.paths.shape[1] < count:
            if cell.paths.shape[1] and time.perf_counter() > until:
                break
            start = PATHS_START + cell.paths.shape[1]
            found = self._predicted(sampler.batch(sampler.paths, start, PATH_CHUNK))
            cell.paths = np.concatenate([cell.paths, found], axis=1)
