"""A grid of studies that share programs, head paths and finished batches."""

import dataclasses
import itertools
import json
import math
import os
import re
import tempfile
from collections.abc import Callable, Sequence
from concurrent import futures
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import _checks
from ..head_motion.replay import Replay
from ..scenes.baking import check_baking
from ..studies.dataset import check_contains, write_dataset, write_manifest
from ..studies.definition import Shapes, check_seed
from ..studies.executors import in_flight
from ..studies.failures import FailedSessionsError
from ..studies.identity import definition
from ..studies.progress import Progress, Tell
from ..studies.run import Run
from ..studies.sequential import Goal
from ..studies.stage import stages
from ..studies.store import fingerprint
from ..studies.study import Study
from .dataset import Axes, Point, gathered, label, words

if TYPE_CHECKING:
    import xarray

FILE = "sweep.nc"
MOST_CELLS = 100_000
_TAKEN = ("technique", "scene", "session", "sessions", "subject", "identity")


class Sweep:
    """A grid of studies: one for each combination of the values of some axes.

    All cells have the same seed, so that session i is the same person, and what an axis
    does not change (a technique without the number that varies, say) is simulated once.
    An axis that changes numbers but no shapes, as heads, rates and fields of view do,
    is served by one compiled program: textures and halos are as large as the largest
    that a cell needs, which moves no number by more than `HALO_TOLERANCE`.

    - `study`: makes a cell's study of a value of each axis, by name. Scenes, techniques
      and metrics must be named alike in all cells.
    - `axes`: by name, their values: numbers, words, or anything that has a `str`.
    """

    def __init__(self, study: Callable[..., Study], axes: Axes):
        check_axes(axes)
        self.axes = {name: list(values) for name, values in axes.items()}
        self.studies: list[tuple[Point, Study]] = []
        for values in itertools.product(*self.axes.values()):
            point = dict(zip(self.axes, values, strict=True))
            try:
                cell = study(**point)
            except ValueError as error:
                raise ValueError(f"{words(point)}: {error}") from None
            self.studies.append((point, cell))
            first = self.studies[0][1]
            if _names(cell) != _names(first):
                raise ValueError(
                    "scenes, techniques, metrics, baseline and the kind of heads must "
                    f"be the same in all cells, got {_names(first)}, and at "
                    f"{words(point)} {_names(cell)}."
                )

    @property
    def simulations(self) -> int:
        """Sessions x scenes x techniques of all cells; a replay may have fewer."""
        return sum(
            cell.sessions * len(cell.scenes) * len(cell.techniques)
            for _, cell in self.studies
        )

    def run(
        self,
        seed: int = 0,
        *,
        out: str | os.PathLike | None = None,
        batch_size: int = 256,
        omit_failed: bool = False,
        overwrite: bool = False,
        progress: Tell = lambda event: None,
        executor: futures.Executor | None = None,
    ) -> "xarray.Dataset":
        """Run the grid, or go on with it.

        **Arguments:** those of `Study.run`; `out` is for `batches/` and `sweep.nc`.

        **Returns:** a study's dataset with one more dimension for each axis, before its
        own. `hmdjit.sweep.dataset.cells_of` takes it apart.

        **Errors:** those of `Study.run`, with the cell where they occurred.
        """
        check_seed(seed)
        _checks.whole("batch_size", batch_size, 1)
        if out is None:
            # Cells share batches, by way of a folder.
            with tempfile.TemporaryDirectory() as folder:
                return self.run(
                    seed,
                    out=folder,
                    batch_size=batch_size,
                    omit_failed=omit_failed,
                    progress=progress,
                    executor=executor,
                )
        of_cells = {
            words(point): fingerprint(definition(cell, seed, Goal()))[:16]
            for point, cell in self.studies
        }
        folder, most = Path(out), max(c.sessions for _, c in self.studies)
        if not overwrite:
            check_contains(folder, of_cells, most, FILE)
        write_manifest(folder, self.studies[0][1], of_cells, {"seed": seed})
        cells = self._sharing(batch_size, progress)
        grid, found = _Grid(progress, self.simulations), []
        for number, (point, cell) in enumerate(cells, start=1):
            grid.begin(f"cell {number:,} of {len(cells):,} ({words(point)})")
            try:
                run = Run(
                    cell,
                    seed,
                    out,
                    batch_size,
                    grid.tell,
                    Goal(),
                    omit_failed=omit_failed,
                    overwrite=True,
                    is_cell=True,
                    executor=executor,
                    in_flight=in_flight(executor),
                )
                found.append(run.dataset())
            except FailedSessionsError as error:
                raise FailedSessionsError(f"{words(point)}: {error}") from None
        dataset = gathered(found, self.axes)
        dataset.attrs["definition"] = json.dumps(of_cells)
        write_dataset(dataset, folder / FILE)
        return dataset

    def _sharing(self, batch_size: int, progress: Tell) -> list[tuple[Point, Study]]:
        """Return the studies with the largest shapes that one of them needs."""
        needed = [Shapes()]
        for number, (_, cell) in enumerate(self.studies, start=1):
            doing = f"preparing cell {number:,} of {len(self.studies):,}"
            progress(Progress(doing=doing))
            needed.append(_shapes(cell, min(batch_size, cell.sessions)))
        shapes = Shapes(*map(max, *needed))
        return [
            (point, dataclasses.replace(cell, shapes=shapes))
            for point, cell in self.studies
        ]


class _Grid:
    """Tells how far a sweep is, by how far its cells are."""

    def __init__(self, progress: Tell, total: int):
        self._progress, self._total = progress, total
        self._place, self._before, self._here = "", Progress(), Progress()

    def begin(self, place: str) -> None:
        """Begin a cell, which is named."""
        done = self._before.done + self._here.total
        fresh = self._before.fresh + self._here.fresh
        self._before, self._here = Progress(done, fresh=fresh), Progress()
        self._place = place

    def tell(self, event: Progress) -> None:
        """Tell an event of the cell as one of the sweep."""
        self._here = event if event.total else self._here
        event = event._replace(
            done=self._before.done + event.done,
            total=self._total,
            fresh=self._before.fresh + event.fresh,
            doing=f"{self._place}: {event.doing}",
        )
        self._progress(event)


def check_axes(axes: Axes) -> None:
    """Raise unless axes have values, each but once, and not too many cells.

    **Errors:** `ValueError` naming the axis.
    """
    if not axes:
        raise ValueError("axes must name at least one axis, got none.")
    for name, values in axes.items():
        if not re.fullmatch(r"[A-Za-z_][\w.]*", name) or name in _TAKEN:
            raise ValueError(
                "axes must have names of letters, digits, _ and ., and none of "
                f"{', '.join(_TAKEN)}, got {name!r}."
            )
        if isinstance(values, str) or not isinstance(values, Sequence) or not values:
            raise ValueError(f"axis {name} must be a list of values, got {values!r}.")
    count = math.prod(len(values) for values in axes.values())
    if count > MOST_CELLS:
        raise ValueError(
            f"a sweep must have at most {MOST_CELLS:,} cells, got {count:,}."
        )
    for name, values in axes.items():
        labels: list[Any] = list(map(label, values))
        if len(set(map(str, labels))) < len(labels):
            raise ValueError(f"axis {name} must have each value once, got {labels}.")
        if len({isinstance(one, str) for one in labels}) > 1:
            raise ValueError(f"axis {name} must be all numbers or words, got {labels}.")


def _names(study: Study) -> list[Any]:
    techniques = [technique.id for technique in study.techniques]
    metrics = [metric.id for metric in study.metrics]
    head = "recorded heads" if isinstance(study.head, Replay) else "drawn heads"
    return [list(study.scenes), techniques, metrics, study.baseline, head]


def _shapes(study: Study, batch_size: int) -> Shapes:
    """Find the sizes that a study would have by itself."""
    margin = check_baking(study.display, study.oversampling, study.margin_deg)
    halos = [0, 0]
    for stage in stages(study, 0, batch_size):
        halo = stage.runner.usual_halo(list(stage.techniques.values()))
        halos[stage.is_solid] = max(halos[stage.is_solid], halo)
    return Shapes(margin, *halos)
