"""Studies that run until they are sure enough, or until the time is up.

For each scene a pilot of a few sessions decides the estimator and how many sessions it
will need; these are run, then analysed. Should they not do, half as many again are
added until they do: see `planning.interim_level` for why interim analyses are allowed.
Pilot, simulated sessions and predicted paths are three ranges of session numbers, so
that the three samples are independent, and sessions are the same for all scenes.
"""

import dataclasses
import json
import math
import time
from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np

from ..estimates.cells import Cell
from ..estimates.estimate import MIN_BASELINE_MTCD, Estimate, ratio
from ..estimates.intervals import Z95
from ..estimates.planning import (
    FLOOR_MTCD,
    PATHS_PER_TILE,
    Need,
    interim_level,
    sessions_needed,
)
from ..frames.sources import AbstractSource
from ..frames.texture import Texture
from .failures import Failures
from .progress import Progress
from .sampler import LEAST_SESSIONS, PILOT_SESSIONS, PILOT_START, Sampler, SceneSampler

GROWTH = 1.5
MOST_SESSIONS = 1 << 20


@dataclasses.dataclass(frozen=True)
class ScenePlan:
    """What a pilot decided for a scene, and what came of it.

    - `estimator`: `"control variate"` or `"simulation"` alone; `why`: in words.
    - `sessions`, `paths`: planned; `seconds`: expected for them, in words only.
    - `interim_analyses`, `spent_s`: it took; with baking, statistics and pilot.
    """

    scene: str
    estimator: str
    why: str
    sessions: int
    paths: int
    seconds: float
    interim_analyses: int = 0
    spent_s: float = 0.0

    def __str__(self) -> str:
        paths = f" and {self.paths:,} predicted paths" if self.paths else ""
        return (
            f"{self.scene}: {self.estimator}, {self.sessions:,} sessions{paths}, "
            f"{self.seconds:.1f} s expected ({self.why})"
        )


@dataclasses.dataclass(frozen=True)
class Goal:
    """When to stop: one of the three; none is at a given number of sessions.

    - `tolerance`: half-width of the 95 % intervals of every mean and ratio, relative;
      never below `FLOOR_MTCD`.
    - `budget_s`: seconds for the whole study, baking and compiling included. Numbers
      of sessions then follow the clock.
    - `repeat`: sessions and predicted paths by scene, as a budget allowed once.
    """

    tolerance: float | None = None
    budget_s: float | None = None
    repeat: Mapping[str, Sequence[int]] | None = None

    def error(self, value: float, floor: float) -> float:
        """Half-width that is asked for; of a budget, where to put its effort."""
        return max((self.tolerance or 0.01) * abs(value), floor)


class Until:
    """Runs the scenes of a study, each until its goal is reached.

    - `baseline`: which of the sampler's techniques ratios refer to.
    - `metrics`: how many the study has; goals are of the first.
    - `failures`: what to do about sessions that fail.
    """

    def __init__(
        self,
        goal: Goal,
        sampler: Sampler,
        baseline: int,
        metrics: int,
        failures: Failures,
    ):
        self._goal, self._sampler, self._baseline = goal, sampler, baseline
        self._metrics, self._failures = metrics, failures

    def scene(
        self, name: str, source: AbstractSource, begun: float, deadline: float
    ) -> tuple[Cell, ScenePlan]:
        """Run a scene.

        **Arguments:** `begun`: when work on it did; `deadline`: when a budget for it is
        spent; both as of `time.perf_counter`.
        """
        sampler, statistics = self._sampler, None
        if sampler.controls is not None:  # there are such of pictures only
            sampler.tell(Progress(doing=f"{name}: statistics"))
            statistics = sampler.controls.statistics(cast(Texture, source))
        measure = SceneSampler(sampler, name, source, statistics)
        plan, slope, share = self._plan(name, measure)
        if self._goal.tolerance is not None and plan.sessions > MOST_SESSIONS:
            raise ValueError(
                f"tolerance {self._goal.tolerance:g} would take {plan.sessions:,} "
                f"sessions of {name}; at most {MOST_SESSIONS:,} are run."
            )
        if self._goal.repeat is not None:
            sessions, paths = self._goal.repeat[name]
            plan = dataclasses.replace(plan, sessions=sessions, paths=paths)
        if self._goal.budget_s is not None:
            left = max(deadline - time.perf_counter(), 0.0)
            scale = left / plan.seconds if plan.seconds else 1.0  # nothing varies
            plan = dataclasses.replace(
                plan,
                sessions=max(LEAST_SESSIONS, int(plan.sessions * scale)),
                paths=int(plan.paths * scale),
                seconds=left,
            )
        sampler.tell(Progress(0, plan.sessions, name, line=str(plan)))
        cell = Cell.plain(np.zeros((self._metrics, len(sampler.techniques), 0)))
        cell.slope, cell.between_session_share = slope, share
        sessions, paths, analysis = plan.sessions, plan.paths, 0
        while True:
            until = deadline if self._goal.budget_s is not None else math.inf
            # However short a budget is, so much is run: less would say nothing.
            measure.add_sessions(cell, LEAST_SESSIONS, math.inf)
            measure.add_paths(cell, paths, until)
            measure.add_sessions(cell, sessions, until)
            failed = cell.has_failed()
            words = f"sessions of {name}"
            self._failures.check(np.flatnonzero(failed).tolist(), failed.size, words)
            analysis += 1
            if self._goal.tolerance is None or self._is_reached(cell, analysis):
                break
            sessions, paths = math.ceil(GROWTH * sessions), math.ceil(GROWTH * paths)
            if sessions > MOST_SESSIONS:
                break
        spent = time.perf_counter() - begun
        return cell, dataclasses.replace(plan, interim_analyses=analysis, spent_s=spent)

    def estimates(self, cell: Cell) -> list[tuple[Estimate, float]]:
        """Means and ratios of a scene, each with the smallest error asked of it."""
        # The check has let few sessions that failed pass, or none.
        means = [cell.estimate(k, "omit") for k in range(len(self._sampler.techniques))]
        base = means[self._baseline]
        found = [(mean, FLOOR_MTCD) for mean in means]
        for k, mean in enumerate(means):
            paired = ratio(mean, base)
            if k != self._baseline and not paired.reason:
                found.append((paired, FLOOR_MTCD / base.value))
        return found

    def _is_reached(self, cell: Cell, analysis: int) -> bool:
        z = interim_level(analysis)
        return all(
            z * estimate.standard_error <= self._goal.error(estimate.value, floor)
            for estimate, floor in self.estimates(cell)
        )

    def _plan(
        self, name: str, measure: SceneSampler
    ) -> tuple[ScenePlan, np.ndarray, np.ndarray]:
        """Let a pilot choose the estimator and the numbers of sessions and paths."""
        self._sampler.tell(Progress(0, PILOT_SESSIONS, f"{name}: pilot"))
        (simulated, *_), predicted, session_seconds = measure.pilot()
        good = np.isfinite(simulated).all(axis=0)
        words = f"sessions of {name}'s pilot"
        # It enters no mean: where failures may be left out, the analyses judge them.
        if not self._failures.omit or np.sum(good) < 2:
            # Of the pilot no batch is kept.
            failures = dataclasses.replace(self._failures, kept_in=None)
            numbers = (PILOT_START + np.flatnonzero(~good)).tolist()
            failures.check(numbers, good.size, words)
        simulated, predicted = simulated[:, good], predicted[:, good]
        slope = np.zeros(len(self._sampler.techniques))
        for k, (y, t) in enumerate(zip(simulated, predicted, strict=True)):
            if t.var() > 0:
                slope[k] = np.cov(y, t)[0, 1] / t.var(ddof=1)
        tiles, path_seconds = measure.pilot_paths()
        paths = tiles.mean(axis=-1)
        # What neither varies nor should has shown all, as a frozen picture.
        is_still = (np.ptp(simulated, axis=1) == 0) & (np.ptp(tiles, axis=(1, 2)) == 0)
        measure.close(is_still)
        # The tiles of a path are drawn apart: what they have in common is its own.
        common = [np.cov(t[:, 0], t[:, -1])[0, 1] for t in tiles]
        spread = predicted.var(axis=1, ddof=1)
        share = np.where(spread > 0, common / np.where(spread > 0, spread, 1), np.nan)
        z = Z95 if self._goal.tolerance is None else interim_level(1)
        # No clock decides a plan, or it could not be repeated.
        session_cost = PATHS_PER_TILE * self._sampler.tiles
        choices = []
        for kind, b in (
            ("simulation", np.zeros_like(slope)),
            ("control variate", slope),
        ):
            rest = simulated - b[:, None] * predicted
            needs = self._needs(z, simulated.mean(axis=1), rest, b[:, None] * paths)
            n, m = sessions_needed(needs, session_cost, 1.0)
            # What a pilot of this size says of variances is right within a tenth or so.
            n, m = max(math.ceil(1.15 * n), LEAST_SESSIONS), math.ceil(1.15 * m)
            seconds = n * session_seconds + m * path_seconds
            choices.append((n * session_cost + m, kind, n, m, b, seconds))
            if self._sampler.controls is None:
                break
        _, kind, n, m, b, seconds = min(choices, key=lambda choice: choice[0])
        others = [f"{c[1]} {c[-1]:.1f} s" for c in choices if c[1] != kind]
        other = others[0] if others else "paired, without a control variate"
        why = f"one session takes {1e3 * session_seconds:.1f} ms; {other}"
        known = [technique.on_pictures() for technique in self._sampler.techniques]
        unknown = [t.id for t in known if t.small_motion() is None]
        if kind == "control variate" and unknown:
            why += f"; no theory of {', '.join(unknown)}: predicted as rendered"
        return ScenePlan(name, kind, why, n, m, seconds), b, np.clip(share, 0, 1)

    def _needs(
        self, z: float, means: np.ndarray, rest: np.ndarray, paths: np.ndarray
    ) -> list[Need]:
        base = self._baseline
        needs = []
        for k in range(len(self._sampler.techniques)):
            error = self._goal.error(means[k], FLOOR_MTCD) / z
            needs.append(Need(error, rest[k].var(ddof=1), paths[k].var(ddof=1)))
            if k == base or means[base] <= MIN_BASELINE_MTCD:
                continue
            r = means[k] / means[base]
            error = self._goal.error(r, FLOOR_MTCD / means[base]) / z
            spread = [
                ((x[k] - r * x[base]) / means[base]).var(ddof=1) for x in (rest, paths)
            ]
            needs.append(Need(error, *spread))
        return needs


def with_controls(
    cells: list[Cell],
    plans: list[ScenePlan],
    goal: Goal,
    places: Sequence[Sequence[Sequence[int]]],
    shape: tuple[int, int, int],
) -> dict[str, dict]:
    """Return what a dataset holds of a study that ran until its goal.

    **Arguments:** `places`: where each distinct technique of a scene stands among the
    study's; `shape`: of the dataset.

    **Returns:** `variables` and `attributes`; estimates can be made again from them.
    """
    techniques, scenes, _ = shape
    most = max(cell.paths.shape[1] for cell in cells)
    predicted = np.full(shape, np.nan)
    paths = np.full((techniques, scenes, most), np.nan)
    slope, share = np.zeros((2, techniques, scenes))
    count = np.zeros((techniques, scenes), int)
    for s, cell in enumerate(cells):
        for k, mine in enumerate(places[s]):
            predicted[mine, s, : cell.predicted.shape[1]] = cell.predicted[k]
            paths[mine, s, : cell.paths.shape[1]] = cell.paths[k]
            slope[mine, s] = cell.slope[k]
            share[mine, s] = cell.between_session_share[k]
            count[mine, s] = cell.count[k]
    cell_dims = ("technique", "scene")
    code = {"units": "code values of 255"}
    variables = {
        "predicted": ((*cell_dims, "session"), predicted, code),
        "predicted_extra_paths": ((*cell_dims, "extra_path"), paths, code),
        "control_slope": (cell_dims, slope, {"long_name": "control variate's slope"}),
        "between_session_share": (
            cell_dims,
            share,
            {"long_name": "share of the variance that is between sessions"},
        ),
        "simulated_sessions": (cell_dims, count),
        "interim_analyses": ("scene", [plan.interim_analyses for plan in plans]),
        "seconds": ("scene", [plan.spent_s for plan in plans], {"units": "s"}),
    }
    wanted = dataclasses.asdict(goal).items()
    attributes = {k: v for k, v in wanted if v is not None and k != "repeat"}
    if goal.tolerance is None:  # what repeats it
        names = (plan.scene for plan in plans)
        ran = ([c.measured.shape[-1], c.paths.shape[1]] for c in cells)
        attributes["ran"] = json.dumps(dict(zip(names, ran, strict=True)))
    attributes["plan"] = json.dumps([dataclasses.asdict(plan) for plan in plans])
    return {"variables": variables, "attributes": attributes}
