"""The command line's `hmdjit reproduce`: a paper's claims, each with a verdict."""

import dataclasses
import math
from pathlib import Path
from typing import Annotated, Any

import rich.console
import tyro

from .. import _checks
from ..figures import reproduce as figure
from ..figures.drawing import save
from ..reports import reproduce as report
from ..reproductions import color_space
from ..studies.identity import counted
from ..studies.study import check_seed
from .options import OK, Seed, check_can_write, shown
from .progress import Display

_TILES_PX = range(11, 65)  # what SSIM and tiles want
PAPERS: dict[str, Any] = {"colour-space": color_space}


@dataclasses.dataclass(frozen=True)
class ReproduceCommand:
    """Run a paper's experiment again, and say of each of its claims whether it holds.

    Writes each claim with what was measured, its interval, a verdict (holds, does not
    hold, cannot be told) and the reason, as CSV and as a figure. An interrupted run
    goes on where it stopped when the same command is run again.
    """

    paper: Annotated[
        tyro.conf.Positional[str],
        shown(
            "PAPER",
            "colour-space: anti-aliasing in linear light against gamma, box against "
            "Lanczos filter (Maruszczuk et al.).",
        ),
    ]
    quick: Annotated[bool, shown("", "Fewer sessions: a minute on two cores.")] = False
    sessions: Annotated[
        int | None,
        shown(
            "N",
            f"Viewing sessions (default: {color_space.SESSIONS}, of --quick "
            f"{color_space.QUICK_SESSIONS}).",
        ),
    ] = None
    width: Annotated[
        int | None, shown("PX", "Width of the frame (default: the paper's).")
    ] = None
    height: Annotated[
        int | None, shown("PX", "Height of the frame (default: the paper's).")
    ] = None
    fov: Annotated[
        float | None, shown("DEG", "Horizontal field of view (default: the paper's).")
    ] = None
    seed: Seed = 0
    out: Annotated[
        Path | None,
        shown("DIR", "Folder for what is written (default: hmdjit-PAPER)."),
    ] = None
    overwrite: Annotated[
        bool, shown("", "Replace what another run wrote into that folder.")
    ] = False

    def run(self, console: rich.console.Console) -> int:
        """Run, judge, print, write and draw."""
        _checks.one_of("paper", self.paper, PAPERS)
        check_seed(self.seed)
        if self.quick and self.sessions is not None:
            raise ValueError("--quick and --sessions exclude each other: name one.")
        paper = PAPERS[self.paper]
        sessions = paper.QUICK_SESSIONS if self.quick else self.sessions
        sessions = paper.SESSIONS if sessions is None else sessions
        _checks.whole("sessions", sessions, 2)
        sizes = {"width_px": self.width, "height_px": self.height, "fov_deg": self.fov}
        camera = dataclasses.replace(
            paper.CAMERA, **{k: v for k, v in sizes.items() if v is not None}
        )
        width, height = camera.width_px, camera.height_px
        tiles = [px for px in _TILES_PX if math.gcd(width, height) % px == 0]
        if not tiles or width * height < 2 * tiles[0] ** 2:
            raise ValueError(
                "--width and --height must be multiples of one size of "
                f"{_TILES_PX[0]} to {_TILES_PX[-1]} px, and hold two such tiles, got "
                f"{width} x {height}."
            )
        out = self.out or Path(f"hmdjit-{self.paper}")
        check_can_write(out)
        console.out(
            f"{paper.TITLE}.\n{counted(sessions, 'session')}, {camera.width_px} x "
            f"{camera.height_px} px, {camera.fov_deg:g} deg, {camera.refresh_hz:g} Hz. "
            f"Finished batches are kept in {out}."
        )
        try:
            with Display(console) as display:
                found = paper.run(
                    camera,
                    sessions,
                    seed=self.seed,
                    out=out,
                    overwrite=self.overwrite,
                    progress=display,
                )
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                "stopped; finished batches are kept: run the same command to go on."
            ) from None
        console.print(report.verdicts(found))
        console.print(report.by_measure(found))
        console.out(report.explanation(found))
        files = report.write_csv(found, out)
        files.append(save(figure.draw(found), out / "claims.png"))
        console.out(f"Wrote {', '.join(map(str, files))}.")
        return OK
