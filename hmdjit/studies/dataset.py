"""What a study found, as an `xarray.Dataset` and a file."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from .._files import written_atomically
from .definition import StudyDefinition

if TYPE_CHECKING:
    import xarray


def gathered(
    study: StudyDefinition,
    measured: Float[np.ndarray, "metric technique scene session"],
    rotation_deg: Float[np.ndarray, " session"],
    subjects: Sequence[str] | None,
    attributes: Mapping[str, Any],
) -> "xarray.Dataset":
    """Gather what was measured: a variable for each metric.

    **Arguments:** `rotation_deg`: RMS rotation per frame of each session; `subjects`:
    of each, of a replay.
    """
    import xarray

    dims = ("technique", "scene", "session")
    variables: dict[str, Any] = {
        metric.id: (
            dims,
            values,
            {
                "units": metric.unit,
                "better": "less" if metric.less_is_better else "more",
            },
        )
        for metric, values in zip(study.metrics, measured, strict=True)
    }
    about = {"units": "deg", "long_name": "RMS rotation per frame"}
    variables["rotation_deg"] = ("session", rotation_deg, about)
    places = {
        "technique": [technique.id for technique in study.techniques],
        "scene": list(study.scenes),
        "session": np.arange(measured.shape[-1]),
    }
    metrics = {"metrics": [metric.id for metric in study.metrics]}
    dataset = xarray.Dataset(variables, places, dict(attributes) | metrics)
    if subjects is not None:
        dataset = dataset.assign_coords(subject=("session", list(subjects)))
    return dataset


def write_dataset(dataset: "xarray.Dataset", path: Path) -> None:
    """Write a dataset as NetCDF 4, whole or not at all."""
    with written_atomically(path) as unfinished:
        dataset.to_netcdf(unfinished, engine="h5netcdf")
