"""What a sweep found, as one `xarray.Dataset`: a study's, with a dimension per axis."""

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..estimates.rows import SummaryRow
from ..estimates.summary import summarize

if TYPE_CHECKING:
    import xarray

Axes = Mapping[str, Sequence[Any]]
"""Values by the names of their axes."""
Point = Mapping[str, Any]
"""A value of each axis."""

_UNITS = {"deg_s": "deg/s", "hz": "Hz", "deg": "deg", "px": "px", "s": "s", "m": "m"}


def axis_words(name: str) -> str:
    """Spell an axis: refresh, Hz."""
    for ending, unit in _UNITS.items():
        if name.endswith(f"_{ending}"):
            return f"{name.removesuffix(f'_{ending}').replace('_', ' ')}, {unit}"
    return name.replace("_", " ")


def words(point: Point) -> str:
    """Say where in its sweep a cell lies: head = seated, refresh_hz = 90."""
    return ", ".join(f"{name} = {label(value)}" for name, value in point.items())


def label(value: Any) -> Any:
    """Name a value of an axis: itself, or what it holds in words."""
    if isinstance(value, bool | int | float | str | np.generic):
        return value
    return " ".join(map(str, value)) if isinstance(value, Sequence) else str(value)


def gathered(cells: Sequence["xarray.Dataset"], axes: Axes) -> "xarray.Dataset":
    """Put the results of all cells together, those of the last axis side by side.

    Sessions that a cell has fewer of are NaN there; `sessions` has their numbers, and
    `identity` each cell's own attributes, as JSON.
    """
    import xarray

    first, shape = cells[0], [len(values) for values in axes.values()]
    most = max(cell.sizes["session"] for cell in cells)
    coordinates = {name: list(map(label, values)) for name, values in axes.items()}

    def stacked(name: str) -> tuple[tuple[str, ...], np.ndarray, dict[str, Any]]:
        dims, each = first[name].dims, []
        for cell in cells:
            values = cell[name].values
            # All end with sessions, the only dimension that cells may differ in.
            missing = [(0, 0)] * (values.ndim - 1) + [(0, most - values.shape[-1])]
            fill = "" if values.dtype.kind in "UO" else np.nan
            each.append(np.pad(values, missing, constant_values=fill))
        whole = np.stack(each)
        whole = whole.reshape(*shape, *whole.shape[1:])
        return (*axes, *map(str, dims)), whole, first[name].attrs

    names = [str(name) for name in first.data_vars]
    names += ["subject"] * ("subject" in first.coords)
    variables: dict[str, Any] = {name: stacked(name) for name in names}
    of_cells = {
        "identity": [json.dumps(cell.attrs) for cell in cells],
        "sessions": [cell.sizes["session"] for cell in cells],
    }
    for name, values in of_cells.items():
        variables[name] = tuple(axes), np.reshape(np.array(values), shape)
    alike = {
        name: value
        for name, value in first.attrs.items()
        if len({json.dumps(cell.attrs.get(name)) for cell in cells}) == 1
    }
    alike |= {"title": "What a sweep of studies measured", "axes": list(axes)}
    places = {name: first[name].values for name in ("technique", "scene")}
    found = xarray.Dataset(variables, {**coordinates, **places}, alike)
    found = found.assign_coords(session=np.arange(most))
    return found.set_coords("subject") if "subject" in found else found


def axes_of(dataset: "xarray.Dataset") -> list[str]:
    """Name the axes of a sweep's result."""
    return [str(name) for name in np.atleast_1d(dataset.attrs["axes"])]


def cells_of(dataset: "xarray.Dataset") -> Iterator[tuple[dict[str, Any], Any]]:
    """Take a sweep apart: where each cell lies, and the result of its study."""
    axes = axes_of(dataset)
    for index in np.ndindex(*(dataset.sizes[name] for name in axes)):
        cell = dataset.isel(dict(zip(axes, index, strict=True)))
        point = {name: cell[name].item() for name in axes}
        cell = cell.isel(session=slice(0, int(cell["sessions"])))
        known = json.loads(str(cell["identity"].item()))
        yield point, cell.drop_vars([*axes, "identity", "sessions"]).assign_attrs(known)


def summarized(dataset: "xarray.Dataset") -> list[tuple[dict[str, Any], SummaryRow]]:
    """Reduce each cell to the rows of `summarize`, with where it lies."""
    return [
        (point, row) for point, cell in cells_of(dataset) for row in summarize(cell)
    ]
