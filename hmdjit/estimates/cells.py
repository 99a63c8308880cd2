"""What was found in each scene of a study, and its means."""

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Integer, Shaped

from .columns import centred, labels, numbers
from .decibels import AVERAGED, power_of
from .estimate import Estimate, NanPolicy, control_variate, mean_of

if TYPE_CHECKING:
    import xarray


@dataclasses.dataclass
class Cell:
    """What was found in a scene: rows are its distinct techniques.

    - `measured`: by the study's metrics, the first of which is predicted. Of decibels
      it is the power of the error.
    - `predicted`: of the same sessions; `paths`: of others, in number as well.
    - `slope`: of the control variate; 0 where there is none.
    - `between_session_share`: of the variance; the rest is the tiles'.
    - `count`: sessions that were simulated; beyond them `measured` is NaN.
    - `clusters`: subject of each session, or None if every session is a new person.
    - `rotation`: RMS rotation per frame of each session, in any unit; None is unknown.
    - `head_error`: relative standard error of it, of the head's fit.
    """

    measured: Float[np.ndarray, "metric technique session"]
    predicted: Float[np.ndarray, "technique session"]
    paths: Float[np.ndarray, "technique path"]
    slope: Float[np.ndarray, " technique"]
    between_session_share: Float[np.ndarray, " technique"]
    count: Integer[np.ndarray, " technique"]
    clusters: Shaped[np.ndarray, " session"] | None = None
    _: dataclasses.KW_ONLY
    rotation: Float[np.ndarray, " session"] | None = None
    head_error: float = 0.0

    @classmethod
    def plain(
        cls,
        measured: Float[np.ndarray, "metric technique session"],
        clusters: Shaped[np.ndarray, " session"] | None = None,
        **head: Any,
    ) -> "Cell":
        """Whole sessions without control variates; none yet where there are none.

        **Arguments:** `head`: `rotation` and `head_error`.
        """
        axes = ("metric", "technique", "session")
        measured = numbers("measured", measured, axes)
        _, techniques, count = measured.shape
        zero, one = np.zeros(techniques), np.ones(techniques)
        none, paths = np.zeros((techniques, count)), np.zeros((techniques, 0))
        every = np.full(techniques, count)
        return cls(measured, none, paths, zero, one, every, clusters, **head)

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
            found = mean_of(values, clusters, nan_policy=nan_policy)
        else:
            y, t = values, self.predicted[technique, simulated]
            paths = paths[np.isfinite(paths)]
            found = control_variate(y, t, paths, slope, nan_policy=nan_policy)
        return dataclasses.replace(found, by_head=self._by_head(values))

    def _by_head(self, values: Float[np.ndarray, " session"]) -> float:
        """Return what a standard error of the head's fit moves a mean by.

        Sessions flicker in proportion to how much their heads turn, and some constant:
        a head that turns more by a share of its mean is further along that line.
        """
        if not self.head_error or self.rotation is None:
            return 0.0
        rotation = self.rotation[: len(values)]
        known = np.isfinite(values)
        mean, rest = centred(rotation[known])
        variance = float(rest @ rest)
        slope = float(rest @ values[known]) / variance if variance else 0.0
        return slope * float(mean) * self.head_error


def cells_of(dataset: "xarray.Dataset", metrics: Sequence[str]) -> list[Cell]:
    """Cells of a study's scenes.

    **Errors:** `ValueError` for metrics over other axes.
    """

    def of(name: str, *axis: str) -> np.ndarray:
        axes = ("technique", "scene", *axis)
        if set(dataset[name].dims) != set(axes):
            dims = ", ".join(map(str, dataset[name].dims))
            raise ValueError(f"{name} must be over {', '.join(axes)}, got {dims}.")
        return dataset[name].transpose(*axes).values.astype(float)

    measured = np.stack(
        [
            power_of(of(metric, "session"))
            if AVERAGED.items() <= dataset[metric].attrs.items()
            else of(metric, "session")
            for metric in metrics
        ]
    )
    clusters = None
    if "subject" in dataset.coords:
        clusters = labels("subject", dataset["subject"].values, measured.shape[-1])
        clusters = clusters.astype(str)
    known = dataset.get("rotation_deg")
    head = {
        "rotation": None if known is None else known.values.astype(float),
        "head_error": float(np.nan_to_num(dataset.attrs.get("head_fit_error", 0.0))),
    }
    scenes = range(measured.shape[2])
    if "control_slope" in dataset:
        columns = [
            of("predicted", "session"),
            of("predicted_extra_paths", "extra_path"),
            of("control_slope"),
            of("between_session_share"),
            of("simulated_sessions").astype(int),
        ]
        of_scene = lambda s: (measured[:, :, s], *(x[:, s] for x in columns))
        return [Cell(*of_scene(s), **head) for s in scenes]
    return [Cell.plain(measured[:, :, s], clusters, **head) for s in scenes]
