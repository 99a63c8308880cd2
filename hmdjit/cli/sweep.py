"""The command line's `hmdjit sweep`: a grid of studies."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import rich.console
import tyro

from .. import _checks, _toml, techniques
from .._files import check_can_write
from ..reports import sweep as report
from ..studies.executors import opened
from ..studies.identity import counted
from ..studies.sequential import Goal
from ..studies.study import Study
from ..sweep.dataset import Axes, axis_words
from ..sweep.sweep import FILE, MOST_CELLS, Sweep, check_axes
from . import definition
from .options import OK, Options, shown, spoken
from .progress import Display, resumable

_TABLE, _RANGE = "sweep", ("from", "to", "steps")
_NAMED = "head trace frames warmup tiles oversampling reference_samples reference_every"
_AXES = {name: name for name in _NAMED.split()} | {
    "refresh": "refresh_hz",
    "fov": "fov_deg",
    "width": "width_px",
    "height": "height_px",
    "tile_size": "tile_size_px",
    "crop": "crop_px",
    "margin": "margin_deg",
}
"""Options that may vary, and what results call them."""
_LISTED = ("scenes", "images", "panorama", "techniques", "metrics")


@dataclasses.dataclass(frozen=True)
class SweepCommand(Options):
    """Run a grid of studies: heads, rates, fields of view, numbers of techniques.

    SWEEP.toml is a STUDY.toml with a table [sweep] of what varies: a list of values, as
    `head = ["seated", "fixating"]` or `head_movement.w_min = [0.1, 0.2]`, or a range,
    as `fov = { from = 80, to = 110, steps = 4 }`: four values, both ends included. What
    only changes numbers is compiled once for the whole grid. An interrupted sweep goes
    on where it stopped when the same command is run again.

    For example: hmdjit sweep SWEEP.toml
    """

    definition: tyro.conf.Positional[
        Annotated[Path, shown("SWEEP.toml", "What to run.")]
    ] = dataclasses.field(kw_only=True)

    def run(self, console: rich.console.Console) -> int:
        """Run the grid; write, draw and print what it found."""
        sweep, options = read(self.definition, self)
        out = options.out or Path("hmdjit-sweep")
        check_can_write(out)
        for line in described(sweep):
            console.out(line)
        console.out(f"Finished batches are kept in {out}.")
        with (
            resumable(),
            opened(options.workers, options.dask) as executor,
            Display(console) as display,
        ):
            dataset = sweep.run(
                options.seed or 0,
                out=out,
                progress=display,
                omit_failed=options.omit_failed,
                overwrite=options.overwrite,
                executor=executor,
            )
        written = report.write_report(dataset, out)
        report.print_table(dataset, console)
        console.out(f"Wrote {', '.join(map(str, (out / FILE, *written)))}.")
        return OK


def read(path: Path, high: Options) -> tuple[Sweep, Options]:
    """Read a SWEEP.toml, overridden by options, and make all its studies.

    **Errors:** `ValueError` naming the file, the key, what is allowed and the value.
    """
    content = _toml.read(path)
    try:
        axes, keys = _axes(content.pop(_TABLE, None))
        check_axes(axes)
        for name, *numbers in keys.values():
            place = content.get(name, {}) if numbers else content
            key = numbers[0] if numbers else name
            if isinstance(place, Mapping) and key in place:
                raise ValueError(f"{key} is said twice, once in [{_TABLE}].")
            for said in definition.rivals(name) & high.said().keys():
                raise ValueError(
                    f"{spoken(said)} must not replace {name}, an axis of [{_TABLE}]."
                )
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    scenes: Any = None

    def study(**point: Any) -> Study:
        nonlocal scenes
        table = dict(content)
        for name, value in point.items():
            family, *number = keys[name]
            if number:
                value = {**table.get(family, {}), number[0]: value}
            table[family] = value
        low, numbers = definition.from_table(table, path)
        options = definition.merged(low, high)
        found = definition.build(options, numbers, scenes)
        if definition.goal(options, found) != Goal():
            raise ValueError("a sweep has sessions: no tolerance, budget or repeat.")
        scenes = found.scenes  # no axis changes them
        return found

    low, _ = definition.from_table(content, path)
    return Sweep(study, axes), definition.merged(low, high)


def described(sweep: Sweep) -> list[str]:
    """Say how many studies a sweep is, and how much there is to do and to keep."""
    _, first = sweep.studies[0]
    cells = [
        f"{axis_words(name)}: {len(values)}" for name, values in sweep.axes.items()
    ]
    simulations, variables = sweep.simulations, len(first.metrics)
    megabytes = 8 * variables * simulations / 1e6
    pixels = 0
    for _, cell in sweep.studies:
        width, height = cell.measure.block_size(cell.camera)
        each = width * height * cell.measure.count * (cell.warmup + cell.frames)
        pixels += each * cell.sessions * len(cell.scenes) * len(cell.techniques)
    return [
        f"{counted(len(sweep.studies), 'cell')} ({'; '.join(cells)}) x "
        f"{counted(len(first.scenes), 'scene')} x "
        f"{counted(len(first.techniques), 'technique')}: at most "
        f"{counted(simulations, 'simulation')}.",
        f"About {_time(pixels * _NS * 1e-9)} at {_NS:g} ns per pixel, frame and "
        f"technique, as two cores take for pictures, apart from compiling; {FILE} of "
        f"about {megabytes:.2g} MB.",
    ]


_NS = 20.0  # of block and halo alike; `examples/speed.md`


def _time(seconds: float) -> str:
    for unit, length in (("days", 86400), ("h", 3600), ("min", 60)):
        if seconds >= 2 * length:
            return f"{seconds / length:.3g} {unit}"
    return f"{seconds:.2g} s"


def _axes(table: Any) -> tuple[Axes, dict[str, tuple[str, ...]]]:
    """Values of each axis, and the keys of a STUDY.toml that they are values of."""
    if not isinstance(table, Mapping) or not table:
        raise ValueError(f"[{_TABLE}] must be a table of what varies, got {table!r}.")
    found, keys = {}, {}
    for name, values in table.items():
        if name in _LISTED:
            raise ValueError(
                f"{_TABLE} must not have {name}: a study compares all that it lists; "
                f"list them above [{_TABLE}]."
            )
        _checks.known_keys([name], [*_AXES, *techniques.IDS], f"{_TABLE}.")
        if name in techniques.IDS:
            if not isinstance(values, Mapping):
                raise ValueError(f"{_TABLE}.{name} must be a table, got {values!r}.")
            for number, several in values.items():
                keys[f"{name}.{number}"] = name, number
                found[f"{name}.{number}"] = _values(f"{name}.{number}", several)
        else:
            keys[_AXES[name]] = (name,)
            found[_AXES[name]] = _values(name, values)
    return found, keys


def _values(name: str, found: Any) -> list[Any]:
    """List what an axis goes through: a list, or a range of numbers."""
    if isinstance(found, list):
        return found
    place = f"{_TABLE}.{name}"
    if not isinstance(found, Mapping):
        raise ValueError(f"{place} must be a list or a range, got {found!r}.")
    _checks.known_keys(found, _RANGE, f"{place}.")
    for key in _RANGE:
        if type(found.get(key)) not in (int, float):
            raise ValueError(f"{place}.{key} must be a number, got {found.get(key)!r}.")
    low, high, steps = (found[key] for key in _RANGE)
    _checks.whole(f"{place}.steps", steps, 2)
    _checks.in_range(f"{place}.steps", steps, 2, MOST_CELLS)
    for key in ("from", "to"):
        _checks.in_range(f"{place}.{key}", found[key], -1e300, 1e300)
    values = np.linspace(low, high, steps).tolist()
    is_whole = type(low) is type(high) is int and all(map(float.is_integer, values))
    return [int(value) for value in values] if is_whole else values
