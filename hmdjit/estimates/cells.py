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
    """What was found in a scene: rows are its distinct techniques.

    - `measured`: by the study's metrics, the first of which is predicted.
    - `predicted`: of the same sessions; `paths`: of others, in number as well.
    - `slope`: of the control variate; 0 where there is none.
    - `between_session_share`: of the variance; the rest is the tiles'.
    - `count`: sessions that were simulated; beyond them `measured` is NaN.
    - `clusters`: subject of each session, or None if every session is a new person.
    """

    measured: Float[np.ndarray, "metric technique session"]
    predicted: Float[np.ndarray, "technique session"]
    paths: Float[np.ndarray, "technique path"]
    slope: Float[np.ndarray, " technique"]
    between_session_share: Float[np.ndarray, " technique"]
    count: Integer[np.ndarray, " technique"]
    clusters: Shaped[np.ndarray, " session"] | None = None

    @classmethod
    def plain(
        cls,
        measured: Float[np.ndarray, "metric technique session"],
        clusters: Shaped[np.ndarray, " session"] | None = None,
    ) -> "Cell":
        """Whole sessions without control variates; none yet where there are none."""
        _, techniques, count = measured.shape
        zero, one = np.zeros(techniques), np.ones(techniques)
        none, paths = np.zeros((techniques, count)), np.zeros((techniques, 0))
        every = np.full(techniques, count)
        return cls(measured, none, paths, zero, one, every, clusters)

    def was_simulated(self) -> Bool[np.ndarray, "technique session"]:
        """Which sessions were simulated."""
        return np.arange(self.measured.shape[-1]) < self.count[:, None]

    def has_failed(self) -> Bool[np.ndarray, " session"]:
        """Which sessions gave some technique no finite number."""
        is_good = np.isfinite(self.measured).all(axis=0)
        return np.any(self.was_simulated() & ~is_good, axis=0)

    def estimate(
        self,
        technique: int,
        nan_policy: NanPolicy,
        *,
        metric: int = 0,
        left_out: Bool[np.ndarray, " session"] | None = None,
    ) -> Estimate:
        """Mean of a technique's metric over the sessions that were simulated.

        **Arguments:**

        - `nan_policy`: of the sessions that failed.
        - `left_out`: these count as failed. By default, where such are left out, those
          that failed for one technique: they are then left out of all, being paired.
        """
        if left_out is None:
            left_out = self.has_failed() & (nan_policy == "omit")
        simulated = slice(self.count[technique])
        values = np.where(left_out, np.nan, self.measured[metric, technique])[simulated]
        slope, paths = float(self.slope[technique]), self.paths[technique]
        if metric or slope == 0:
            clusters = None if self.clusters is None else self.clusters[simulated]
            return mean_of(values, clusters, nan_policy=nan_policy)
        predicted, paths = (
            self.predicted[technique, simulated],
            paths[np.isfinite(paths)],
        )
        return control_variate(values, predicted, paths, slope, nan_policy=nan_policy)


def cells_of(dataset: "xarray.Dataset", metrics: Sequence[str]) -> list[Cell]:
    """Cells of a study's scenes."""

    def of(name: str) -> np.ndarray:
        return dataset[name].transpose("technique", "scene", ...).values

    measured = np.stack([of(metric).astype(float) for metric in metrics])
    clusters = None
    if "subject" in dataset.coords:
        clusters = dataset["subject"].values.astype(str)
    if "control_slope" not in dataset:
        scenes = range(measured.shape[2])
        return [Cell.plain(measured[:, :, s], clusters) for s in scenes]
    names = (
        "predicted",
        "predicted_extra_paths",
        "control_slope",
        "between_session_share",
    )
    columns = [of(name).astype(float) for name in names]
    return [
        Cell(
            measured[:, :, s], *(x[:, s] for x in (*columns, of("simulated_sessions")))
        )
        for s in range(measured.shape[2])
    ]
