"""What is simulated and predicted of a scene, a chunk of sessions at a time."""

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from jaxtyping import Bool, Float

from ..estimates.cells import Cell
from ..frames.sources import AbstractSource
from ..technique_contract.base import AbstractTechnique
from ..technique_contract.small_motion import Still
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
not expected to vary, and has not, counts no further sessions."""

PATH_CHUNK, PATH_TILES = 2048, 2

Measured = Float[np.ndarray, "metric technique session"]

Simulate = Callable[[str, AbstractSource, Batch], Measured]
"""Scene, source and batch to what is measured of all techniques."""


class Sampler:
    """Draws the sessions of a study: the same ones for all scenes that share it.

    - `techniques`: those that show something distinct.
    - `sessions`, `paths`: to simulate, and only to predict.
    - `controls`: what predicts; None simulates only.
    - `simulate`: kept for a resume; `tell`: how far it is.
    """

    def __init__(
        self,
        techniques: Sequence[AbstractTechnique],
        sessions: Sessions,
        paths: Sessions | None,
        controls: Controls | None,
        simulate: Simulate,
        tell: Tell,
    ):
        self.techniques = tuple(techniques)
        self.sessions, self.paths = sessions, paths
        self.controls, self.simulate, self.tell = controls, simulate, tell
        self._drawn: dict[tuple[bool, int, int], Batch] = {}
        self.is_compiled = False
        # Which control predicts a technique; what never changes needs none.
        self._control: list[int | None] = [None] * len(self.techniques)
        if controls is not None:
            known = [fingerprint(model) for model in controls.models]
            models = [control_of(technique) for technique in self.techniques]
            self._control = [
                None if isinstance(model, Still) else known.index(fingerprint(model))
                for model in models
            ]

    @property
    def tiles(self) -> int:
        """Blocks that are measured in each session."""
        return self.batch(self.sessions, PILOT_START, CHUNK).origins.shape[1]

    def batch(self, sessions: Sessions, start: int, size: int) -> Batch:
        """Sessions from a number on; each is drawn once."""
        name = (sessions is self.paths, start, size)
        if name not in self._drawn:
            self._drawn[name] = sessions.batch(start, size)
        return self._drawn[name]

    def predicted(
        self, statistics: PictureStatistics | None, batch: Batch
    ) -> Float[np.ndarray, "technique session tile"]:
        """Predictions of each technique."""
        none = np.zeros(batch.origins.shape[:2])
        if self.controls is None or statistics is None:
            return np.stack([none] * len(self.techniques))
        found = self.controls.predict(statistics, batch.motion, batch.origins)
        return np.stack([none if c is None else found[c] for c in self._control])


class SceneSampler:
    """Simulates and predicts sessions of one scene."""

    def __init__(
        self,
        sampler: Sampler,
        name: str,
        source: AbstractSource,
        statistics: PictureStatistics | None,
    ):
        self._sampler, self._name = sampler, name
        self._source, self._statistics = source, statistics
        # Techniques that may still show something new.
        self._is_open = np.ones(len(sampler.techniques), bool)

    def close(self, techniques: Bool[np.ndarray, " technique"]) -> None:
        """Simulate the least sessions only of some techniques, unless these vary."""
        self._is_open = ~techniques

    def _simulated(self, batch: Batch) -> Measured:
        return self._sampler.simulate(self._name, self._source, batch)

    def _predicted(self, batch: Batch) -> Float[np.ndarray, "technique session"]:
        """Predictions of each technique, mean over tiles."""
        return self._sampler.predicted(self._statistics, batch).mean(axis=-1)

    def pilot(
        self,
    ) -> tuple[Measured, Float[np.ndarray, "technique session"], float]:
        """Simulate and predict a few sessions; seconds per session."""
        sampler, found, seconds = self._sampler, [], 0.0
        for start in range(PILOT_START, PILOT_START + PILOT_SESSIONS, CHUNK):
            batch = sampler.batch(sampler.sessions, start, CHUNK)
            # The first chunk may compile: only the last one's time counts.
            if not sampler.is_compiled:
                self._compile(batch)
            begun = time.perf_counter()
            found.append((self._simulated(batch), self._predicted(batch)))
            seconds = (time.perf_counter() - begun) / CHUNK
        simulated, predicted = (
            np.concatenate(x, axis=-1) for x in zip(*found, strict=True)
        )
        return simulated, predicted, seconds

    def _compile(self, batch: Batch) -> None:
        """Run all programs once, side by side."""
        with ThreadPoolExecutor() as pool:
            begun = [
                pool.submit(self._simulated, batch),
                pool.submit(self._predicted, batch),
                pool.submit(self.pilot_paths),
            ]
            for one in begun:
                one.result()
        self._sampler.is_compiled = True

    def pilot_paths(self) -> tuple[Float[np.ndarray, "technique path tile"], float]:
        """Predictions for some paths; seconds per path."""
        sampler = self._sampler
        if sampler.paths is None:
            return np.zeros((len(sampler.techniques), 2, 1)), 0.0
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
        while cell.measured.shape[-1] < count and time.perf_counter() < until:
            start = cell.measured.shape[-1]
            sampler.tell(Progress(start, count, self._name))
            if start == LEAST_SESSIONS:
                headline = cell.measured[0]
                self._is_open |= headline.min(axis=1) != headline.max(axis=1)
            if start >= LEAST_SESSIONS and not self._is_open.any():
                break
            batch = sampler.batch(sampler.sessions, start, CHUNK)
            counts = self._is_open | (start < LEAST_SESSIONS)
            new = np.where(counts[:, None], self._simulated(batch), np.nan)
            cell.measured = np.concatenate([cell.measured, new], axis=-1)
            cell.count = np.where(counts, cell.measured.shape[-1], cell.count)
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
