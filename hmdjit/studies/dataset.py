"""What a study found, as an `xarray.Dataset` and a file."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from .._files import written_atomically
from ..estimates.decibels import AVERAGED, decibels_of
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

    **Arguments:** `measured`: of decibels, the power of the error; `rotation_deg`: RMS
    rotation per frame of each session; `subjects`: of each, of a replay.
    """
    import xarray

    dims = ("technique", "scene", "session")
    variables: dict[str, Any] = {}
    for metric, values in zip(study.metrics, measured, strict=True):
        how = {"units": metric.unit, "better": "more"}
        if metric.less_is_better:
            how["better"] = "less"
        if metric.about:
            how["long_name"] = metric.about
        if metric.is_in_decibels:
            how, values = how | AVERAGED, decibels_of(values)
        variables[metric.id] = (dims, values, how)
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


MANIFEST = "batches/manifest.json"
"""Of which study the batches in a folder are."""


def check_contains(
    folder: Path,
    definition: Mapping[str, str],
    sessions: int,
    result: str = "result.nc",
) -> None:
    """Raise unless a study contains the one that a folder has a result or batches of.

    **Arguments:** `definition`: of `identity.definition`; `sessions`: it runs;
    `result`: the file's name.

    **Errors:** `ValueError` naming the file, and what differs.
    """
    for what, path in ("result", folder / result), ("batches", folder / MANIFEST):
        known, count = _known(path) if path.exists() else ({}, 0)
        others = [k for k, value in known.items() if definition.get(k) != value]
        others += ["sessions"] * (count > sessions)
        if others:
            raise ValueError(
                f"out has the {what} of another study, {path} (other "
                f"{', '.join(others)}): name another folder, or replace it with "
                "overwrite=True (--overwrite)."
            )


def _known(path: Path) -> tuple[Mapping[str, str], int]:
    """Read the definition of a study, and how many sessions would be lost with it."""
    import xarray

    try:
        if path.suffix == ".json":
            return json.loads(path.read_bytes())["definition"], 0
        with xarray.open_dataset(path, engine="h5netcdf") as old:
            return json.loads(old.attrs["definition"]), old.sizes["session"]
    except (OSError, KeyError, ValueError, TypeError):
        return {"what wrote it": ""}, 0


def write_manifest(
    folder: Path,
    study: StudyDefinition,
    definition: Mapping[str, str],
    attributes: Mapping[str, Any],
) -> None:
    """Say of which study the batches in a folder are, in hashes and in words."""
    content = dict(attributes) | {
        "sessions": study.sessions,
        "scenes": {name: str(scene) for name, scene in study.scenes.items()},
        "techniques": {one.id: str(one) for one in study.techniques},
        "metrics": [metric.id for metric in study.metrics],
        "definition": dict(definition),
    }
    with written_atomically(folder / MANIFEST) as unfinished:
        unfinished.write_text(json.dumps(content, indent=1), encoding="utf-8")


def write_dataset(dataset: "xarray.Dataset", path: Path) -> None:
    """Write a dataset as NetCDF 4, whole or not at all."""
    # By way of memory: HDF5 itself does not survive a full disk.
    content = dataset.to_netcdf(engine="h5netcdf")
    with written_atomically(path) as unfinished:
        unfinished.write_bytes(content)
