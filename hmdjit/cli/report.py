"""The command line's `hmdjit report`: a page to forward, of a finished study."""

import dataclasses
from pathlib import Path
from typing import Annotated

import rich.console
import tyro

from .._files import check_can_write
from ..pages import study as pages
from ..studies.identity import metric_ids
from .kept import kept, repeated
from .options import OK, shown


@dataclasses.dataclass(frozen=True)
class ReportCommand:
    """Write a study's report.html: one file to forward, that loads nothing.

    Answer, tables, figures with their numbers, flicker maps, a viewer of techniques
    side by side, spectra and heads. What is displayed is of one session, simulated
    anew.

    For example: hmdjit report hmdjit-study
    """

    folder: Annotated[
        tyro.conf.Positional[Path], shown("DIR", "Folder of a study, with result.nc.")
    ]
    scene: Annotated[
        str | None,
        shown("NAME", "Scene that is shown (default: the one of median flicker)."),
    ] = None

    def run(self, console: rich.console.Console) -> int:
        """Write the page, and the figures in it as PNG and SVG."""
        import xarray

        result = self.folder / "result.nc"
        if not result.is_file():
            raise ValueError(
                f"{self.folder}: must be a study's folder, with result.nc."
            )
        check_can_write(self.folder)
        try:
            with xarray.open_dataset(result, engine="h5netcdf") as file:
                dataset = file.load()
            dataset.attrs["baseline"]
            dataset[metric_ids(dataset)].transpose("technique", "scene", "session")
        except (OSError, KeyError, ValueError) as error:
            raise ValueError(f"{result}: must be a study's result ({error}).") from None
        study, reason = None, pages.UNKNOWN
        try:
            study = kept(self.folder)
        except (ValueError, OSError) as error:
            reason = str(error).rstrip(".")
        command = "" if study is None else repeated(self.folder)
        paths = pages.write_page(
            dataset,
            self.folder,
            study,
            scene=self.scene,
            command=command,
            reason=reason,
        )
        console.out(f"Wrote {', '.join(map(str, paths))}.")
        return OK
