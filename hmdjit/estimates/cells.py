"""What was found in each scene of a study, and its means."""

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Integer, Shaped

from .estimate import Estimate, NanPolicy, control_variate, mean_of

if TYPE_CHECKING:
    import xarray


@dataclasses.dataclass
class Cell:
    """What was found in a scene: rows are runs (distinct techniques).

    - `measured`: by the study's metrics, the first of which is predicted.
    - `predicted`: of the same sessions; `paths`: of others, in number as well.
    - `slope`: of the control variate; 0 where there is none.
    - `own_share`: of the sessions' variance, not the tiles'.
    - `count`: sessions that were simulated; beyond them `measured` is NaN.
    - `clusters`: subject of each session, or None if every session is a new person.
    """

    measured: Float[np.ndarray, "metric run session"]
    predicted: Float[np.ndarray, "run session"]
    paths: Float[np.ndarray, "run path"]
    slope: Float[np.ndarray, " run"]
    own_share: Float[np.ndarray, " run"]
    count: Integer[np.ndarray, " run"]
    clusters: Shaped[np.ndarray, " session"] | None = None

    @classmethod
    def plain(
        cls,
        measured: Float[np.ndarray, "metric run session"],
        clusters: Shaped[np.ndarray, " session"] | None = None,
    ) -> "Cell":
        """Whole sessions without control variates; none yet where there are none."""
        _, runs, count = measured.shape
        zero, one = np.zeros(runs), np.ones(runs)
        none, paths = np.zeros((runs, count)), np.zeros((runs, 0))
        every = np.full(runs, count)
        return cls(measured, none, paths, zero, one, every, clusters)

    def was_run(self) -> Bool[np.ndarray, "run session"]:
        """Which sessions were simulated."""
        return np.arange(self.measured.shape[-1]) < self.count[:, None]

    def has_failed(self) -> Bool[np.ndarray, " session"]:
        """Which sessions gave some run no finite number."""
        is_good = np.isfinite(self.measured).all(axis=0)
        return np.any(self.was_run() & ~is_good, axis=0)

    def estimate(
        self,
        run: int,
        nan_policy: NanPolicy,
        *,
        metric: int = 0,
        left_out: Bool[np.ndarray, " session"] | None = None,
    ) -> Estimate:
        """Mean of a run's metric over the sessions that were simulated.

        **Arguments:**

        - `nan_policy`: of the sessions that failed.
        - `left_out`: these count as failed. By default, where such are left out, those
          that failed for one technique: they are then left out of all, being paired.
        """
        if left_out is None:
            left_out = self.has_failed() & (nan_policy == "omit")
        was_run = slice(self.count[run])
        values = np.where(left_out, np.nan, self.measured[metric, run])[was_run]
        slope, paths = float(self.slope[run]), self.paths[run]
        if metric or slope == 0:
            clusters = None if self.clusters is None else self.clusters[was_run]
            return mean_of(values, clusters, nan_policy=nan_policy)
        predicted, paths = self.predicted[run, was_run], paths[np.isfinite(paths)]
        return control_variate(values, predicted, paths, slope, nan_policy=nan_policy)


def cells_of(dataset: "xarray.Dataset", metrics: Sequence[str]) -> list[Cell]:
    """Cells of a study's scenes."""

    def of(name: str) -> np.ndarray:
        return dataset[name].transpose("technique", "scene", ...).values

    measured = np.stack([of(metric).astype(float) for metric in metrics])
    clusters = None
    if "subject" in dataset.coords:
        clusters = dataset["subject"].values.astype(str)
    if "slope" not in dataset:
        scenes = range(measured.shape[2])
        return [Cell.plain(measured[:, :, s], clusters) for s in scenes]
    names = ("predicted", "predicted_extra_paths", "slope", "own_share")
    columns = [of(name).astype(float) for name in names]
    return [
        Cell(measured[:, :, s], *(x[:, s] for x in (*columns, of("count"))))
        for s in range(measured.shape[2])
    ]
