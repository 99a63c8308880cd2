"""Studies that run until they are sure enough, or until the time is up.

For each scene a pilot of a few sessions decides the estimator and how many sessions it
will need; these are run, then looked at. Should they not do, half as many again are
added until they do: see `estimators.level_of_look` for why looking again is allowed.
Pilot, simulated sessions and predicted paths are three ranges of session numbers, so
that the three samples are independent, and sessions are the same for all scenes.
"""

import dataclasses
import json
import math
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np

from ..frame import Texture
from ..picture_statistics import PictureStatistics
from ..techniques import Freeze
from .batches import fingerprint
from .controls import Controls, control_of
from .estimators import (
    FLOOR_MTCD,
    Estimate,
    Need,
    control_variate,
    level_of_look,
    ratio,
    sessions_needed,
)
from .intervals import MIN_BASELINE_MTCD, Z95
from .measuring import MOST_FAILED, FailedSessionsError, placed
from .sessions import Batch, Sessions

if TYPE_CHECKING:
    from ..techniques.base import AbstractTechnique

PILOT_START, PATHS_START = 1 << 29, 1 << 30
"""Numbers of the first pilot session and of the first predicted path."""

CHUNK = 64
"""Sessions per dispatch and file: few enough to stop soon, enough to be worth it."""

PILOT_SESSIONS = 2 * CHUNK
PATH_CHUNK, PATH_TILES = 2048, 2
LEAST_SESSIONS = 2 * CHUNK
"""From here on means of what the control leaves over are as good as normal."""

GROWTH = 1.5
MOST_SESSIONS = 1 << 20


@dataclasses.dataclass(frozen=True)
class ScenePlan:
    """What a pilot decided for a scene, and what came of it.

    - `estimator`: `"control variate"` or `"simulation"` alone; `why`: in words.
    - `sessions`, `paths`: planned; `seconds`: expected for them.
    - `looks`, `spent_s`: it took; with baking, statistics and pilot.
    """

    scene: str
    estimator: str
    why: str
    sessions: int
    paths: int
    seconds: float
    looks: int = 0
    spent_s: float = 0.0

    def __str__(self) -> str:
        paths = f" and {self.paths:,} predicted paths" if self.paths else ""
        return (
            f"{self.scene}: {self.estimator}, {self.sessions:,} sessions{paths}, "
            f"{self.seconds:.1f} s expected ({self.why})"
        )


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
        return control_variate(
            np.where(failed, np.nan, self.simulated[run]),
            self.predicted[run],
            self.paths[run],
            float(self.slope[run]),
        )


@dataclasses.dataclass(frozen=True)
class Goal:
    """When to stop: one of the two; neither is at a given number of sessions.

    - `tolerance`: half-width of the 95 % intervals of every mean and ratio, relative;
      never below `FLOOR_MTCD`.
    - `budget_s`: seconds for the whole study, baking and compiling included.
    """

    tolerance: float | None = None
    budget_s: float | None = None

    def error(self, value: float, floor: float) -> float:
        """Half-width that is asked for; of a budget, where to put its effort."""
        return max((self.tolerance or 0.01) * abs(value), floor)


class Until:
    """Runs the scenes of a study, each until its goal is reached.

    - `runs`: distinct techniques; `baseline`: which of them ratios refer to.
    - `simulate`: a technique, a texture and a batch to a `Result`, kept for a resume.
    - `tell`: done, total, what is being done, and a line to print or "".
    """

    def __init__(
        self,
        goal: Goal,
        runs: "list[AbstractTechnique]",
        baseline: int,
        sessions: Sessions,
        paths: Sessions | None,
        controls: Controls | None,
        simulate: Callable,
        tell: Callable[[int, int, str, str], None],
    ):
        self._goal, self._runs, self._baseline = goal, runs, baseline
        self._sessions, self._paths, self._controls = sessions, paths, controls
        self._simulate, self._tell = simulate, tell
        # Scenes share their sessions: each is drawn once.
        self._drawn: dict[tuple[int, int], Batch] = {}
        self._is_compiled = False
        # Which control predicts a run; a frozen picture needs none.
        self._control = [
            None
            if controls is None or isinstance(run, Freeze)
            else _place(run, controls)
            for run in runs
        ]

    def scene(
        self, name: str, texture: Texture, begun: float, deadline: float
    ) -> tuple[Cell, ScenePlan]:
        """Run a scene.

        **Arguments:** `begun`: when work on it did; `deadline`: when a budget for it is
        spent; both as of `time.perf_counter`.
        """
        statistics = None
        if self._controls is not None:
            self._tell(0, 1, f"{name}: statistics", "")
            statistics = self._controls.statistics(texture)
        measure = _Measure(self, name, placed(texture), statistics)
        plan, slope, own_share = self._plan(name, measure)
        if plan.sessions > MOST_SESSIONS:
            raise ValueError(
                f"tolerance {self._goal.tolerance:g} would take {plan.sessions:,} "
                f"sessions of {name}; at most {MOST_SESSIONS:,} are run."
            )
        if self._goal.budget_s is not None:
            left = max(deadline - time.perf_counter(), 0.0)
            scale = left / max(plan.seconds, 1e-9)
            plan = dataclasses.replace(
                plan,
                sessions=max(LEAST_SESSIONS, int(plan.sessions * scale)),
                paths=int(plan.paths * scale),
                seconds=left,
            )
        self._tell(0, plan.sessions, name, str(plan))
        cell = Cell.empty(len(self._runs))
        cell.slope, cell.own_share = slope, own_share
        sessions, paths, look = plan.sessions, plan.paths, 0
        while True:
            until = deadline if self._goal.budget_s is not None else math.inf
            # However short a budget is, so much is run: less would say nothing.
            measure.add_sessions(cell, LEAST_SESSIONS, math.inf)
            measure.add_paths(cell, paths, until)
            measure.add_sessions(cell, sessions, until)
            _refuse_failures(name, cell.simulated)
            look += 1
            if self._goal.budget_s is not None or self._is_reached(cell, look):
                break
            sessions, paths = math.ceil(GROWTH * sessions), math.ceil(GROWTH * paths)
            if sessions > MOST_SESSIONS:
                break
        spent = time.perf_counter() - begun
        return cell, dataclasses.replace(plan, looks=look, spent_s=spent)

    def _batch(self, sessions: Sessions, start: int, size: int) -> Batch:
        if (start, size) not in self._drawn:
            self._drawn[start, size] = sessions.batch(start, size)
        return self._drawn[start, size]

    def estimates(self, cell: Cell) -> list[tuple[Estimate, float]]:
        """Means and ratios of a scene, each with the smallest error asked of it."""
        means = [cell.estimate(run) for run in range(len(self._runs))]
        base = means[self._baseline]
        found = [(mean, FLOOR_MTCD) for mean in means]
        for run, mean in enumerate(means):
            paired = ratio(mean, base)
            if run != self._baseline and paired is not None:
                found.append((paired, FLOOR_MTCD / base.value))
        return found

    def _is_reached(self, cell: Cell, look: int) -> bool:
        z = level_of_look(look)
        return all(
            z * estimate.standard_error <= self._goal.error(estimate.value, floor)
            for estimate, floor in self.estimates(cell)
        )

    def _plan(
        self, name: str, measure: "_Measure"
    ) -> tuple[ScenePlan, np.ndarray, np.ndarray]:
        """Let a pilot choose the estimator and the numbers of sessions and paths."""
        self._tell(0, PILOT_SESSIONS, f"{name}: pilot", "")
        simulated, predicted, session_seconds = measure.pilot()
        _refuse_failures(name, simulated)
        good = np.isfinite(simulated).all(axis=0)
        simulated, predicted = simulated[:, good], predicted[:, good]
        slope = np.zeros(len(self._runs))
        for run, (y, t) in enumerate(zip(simulated, predicted, strict=True)):
            if t.var() > 0:
                slope[run] = np.cov(y, t)[0, 1] / t.var(ddof=1)
        tiles, path_seconds = measure.pilot_paths()
        paths = tiles.mean(axis=-1)
        # The tiles of a path are drawn apart: what they have in common is its own.
        common = [np.cov(t[:, 0], t[:, -1])[0, 1] for t in tiles]
        spread = predicted.var(axis=1, ddof=1)
        own_share = np.where(
            spread > 0, common / np.where(spread > 0, spread, 1), np.nan
        )
        z = Z95 if self._goal.budget_s is not None else level_of_look(1)
        choices = []
        for kind, b in (
            ("simulation", np.zeros_like(slope)),
            ("control variate", slope),
        ):
            rest = simulated - b[:, None] * predicted
            needs = self._needs(z, simulated.mean(axis=1), rest, b[:, None] * paths)
            n, m = sessions_needed(needs, session_seconds, path_seconds)
            # What a pilot of this size says of variances is right within a tenth or so.
            n, m = max(math.ceil(1.15 * n), LEAST_SESSIONS), math.ceil(1.15 * m)
            seconds = n * session_seconds + m * path_seconds
            choices.append((seconds, kind, n, m, b))
            if self._controls is None:
                break
        seconds, kind, n, m, b = min(choices, key=lambda choice: choice[0])
        others = [f"{c[1]} {c[0]:.1f} s" for c in choices if c[1] != kind]
        why = f"one session takes {1e3 * session_seconds:.1f} ms" + (
            f"; {others[0]}" if others else ""
        )
        return ScenePlan(name, kind, why, n, m, seconds), b, np.clip(own_share, 0, 1)

    def _needs(
        self, z: float, means: np.ndarray, rest: np.ndarray, paths: np.ndarray
    ) -> list[Need]:
        base = self._baseline
        needs = []
        for run in range(len(self._runs)):
            error = self._goal.error(means[run], FLOOR_MTCD) / z
            needs.append(Need(error, rest[run].var(ddof=1), paths[run].var(ddof=1)))
            if run == base or means[base] <= MIN_BASELINE_MTCD:
                continue
            r = means[run] / means[base]
            error = self._goal.error(r, FLOOR_MTCD / means[base]) / z
            spread = [
                ((x[run] - r * x[base]) / means[base]).var(ddof=1)
                for x in (rest, paths)
            ]
            needs.append(Need(error, *spread))
        return needs


def _refuse_failures(name: str, simulated: np.ndarray) -> None:
    failed = 1 - np.isfinite(simulated).all(axis=0).mean()
    if failed > MOST_FAILED:
        raise FailedSessionsError(
            f"{failed:.1%} of {simulated.shape[1]} sessions of {name} gave no finite "
            f"number; at most {MOST_FAILED:.1%} may. A head that turns farther than "
            "the margin from where it started is one cause."
        )


def _place(run: "AbstractTechnique", controls: Controls) -> int:
    known = [fingerprint(control) for control in controls.controls]
    return known.index(fingerprint(control_of(run)))


class _Measure:
    """Simulates and predicts sessions of one scene."""

    def __init__(
        self,
        owner: Until,
        name: str,
        texture: Texture,
        statistics: PictureStatistics | None,
    ):
        self._owner, self._name = owner, name
        self._texture, self._statistics = texture, statistics

    def _predicted(self, batch: Batch) -> np.ndarray:
        """Predictions of each run, mean over tiles, `(runs, sessions)`."""
        return self._predicted_tiles(batch).mean(axis=-1)

    def _predicted_tiles(self, batch: Batch) -> np.ndarray:
        owner = self._owner
        none = np.zeros(batch.origins.shape[:2])
        if owner._controls is None or self._statistics is None:
            return np.stack([none] * len(owner._runs))
        found = owner._controls.predict(self._statistics, batch)
        return np.stack([none if c is None else found[c] for c in owner._control])

    def _simulated(self, batch: Batch) -> tuple[np.ndarray, np.ndarray]:
        one = lambda run: self._owner._simulate(self._name, run, self._texture, batch)
        if self._owner._is_compiled:
            results = [one(run) for run in self._owner._runs]
        else:
            # Programs compile side by side, one per technique.
            with ThreadPoolExecutor(len(self._owner._runs)) as pool:
                results = list(pool.map(one, self._owner._runs))
            self._owner._is_compiled = True
        mtcd = np.stack([np.asarray(r.mtcd, float) for r in results])
        return mtcd, np.stack([np.asarray(r.detail_loss, float) for r in results])

    def pilot(self) -> tuple[np.ndarray, np.ndarray, float]:
        """MTCD, simulated and predicted, `(runs, sessions)`; seconds per session."""
        found, seconds = [], 0.0
        for start in range(PILOT_START, PILOT_START + PILOT_SESSIONS, CHUNK):
            batch = self._owner._batch(self._owner._sessions, start, CHUNK)
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
        owner = self._owner
        if owner._paths is None:
            return np.zeros((len(owner._runs), 2, 1)), 0.0
        found, seconds = np.zeros(0), 0.0
        for start in (PILOT_START, PILOT_START + PATH_CHUNK):
            begun = time.perf_counter()
            batch = owner._batch(owner._paths, start, PATH_CHUNK)
            found = self._predicted_tiles(batch)
            seconds = (time.perf_counter() - begun) / PATH_CHUNK
        return found, seconds

    def add_sessions(self, cell: Cell, count: int, until: float) -> None:
        """Simulate sessions up to a number of them, in whole chunks."""
        owner = self._owner
        while cell.simulated.shape[1] < count and time.perf_counter() < until:
            start = cell.simulated.shape[1]
            owner._tell(start, count, self._name, "")
            batch = owner._batch(owner._sessions, start, CHUNK)
            mtcd, loss = self._simulated(batch)
            cell.simulated = np.concatenate([cell.simulated, mtcd], axis=1)
            cell.detail_loss = np.concatenate([cell.detail_loss, loss], axis=1)
            cell.predicted = np.concatenate(
                [cell.predicted, self._predicted(batch)], axis=1
            )
        owner._tell(count, count, self._name, "")

    def add_paths(self, cell: Cell, count: int, until: float) -> None:
        """Predict paths up to a number of them, in whole chunks."""
        owner = self._owner
        while owner._paths is not None and cell.paths.shape[1] < count:
            if cell.paths.shape[1] and time.perf_counter() > until:
                break
            start = PATHS_START + cell.paths.shape[1]
            found = self._predicted(owner._batch(owner._paths, start, PATH_CHUNK))
            cell.paths = np.concatenate([cell.paths, found], axis=1)


def with_controls(
    cells: list[Cell],
    plans: list[ScenePlan],
    goal: Goal,
    places: list[list[int]],
    shape: tuple[int, int, int],
) -> dict[str, dict]:
    """Return what a dataset holds of a study that ran until its goal.

    **Arguments:** `places`: the techniques of each run; `shape`: of the dataset.

    **Returns:** `variables` and `attributes`; estimates can be made again from them.
    """
    techniques, scenes, _ = shape
    most = max(cell.paths.shape[1] for cell in cells)
    predicted = np.full(shape, np.nan)
    paths = np.full((techniques, scenes, most), np.nan)
    slope, own_share = np.zeros((2, techniques, scenes))
    for s, cell in enumerate(cells):
        for run, mine in enumerate(places):
            predicted[mine, s, : cell.predicted.shape[1]] = cell.predicted[run]
            paths[mine, s, : cell.paths.shape[1]] = cell.paths[run]
            slope[mine, s] = cell.slope[run]
            own_share[mine, s] = cell.own_share[run]
    cell_dims = ("technique", "scene")
    code = {"units": "code values of 255"}
    variables = {
        "predicted": ((*cell_dims, "session"), predicted, code),
        "predicted_elsewhere": ((*cell_dims, "path"), paths, code),
        "slope": (cell_dims, slope),
        "own_share": (cell_dims, own_share),
        "look": ("scene", [plan.looks for plan in plans]),
        "seconds": ("scene", [plan.spent_s for plan in plans], {"units": "s"}),
    }
    wanted = dataclasses.asdict(goal).items()
    attributes: dict[str, float | str] = {k: v for k, v in wanted if v is not None}
    attributes["plan"] = json.dumps([dataclasses.asdict(plan) for plan in plans])
    return {"variables": variables, "attributes": attributes}
