"""The command line's `hmdjit reproduce`: a paper's claims, each with a verdict."""

import dataclasses
import math
from pathlib import Path
from typing import Annotated, Any

import rich.console
import tyro

from .. import _checks
from .._files import check_can_write, written_atomically
from ..camera import Camera
from ..figures import kim as kim_figures
from ..figures import reproduce as figure
from ..figures import sobel as sobel_figures
from ..figures import tidoaa as tidoaa_figures
from ..figures.drawing import save
from ..reports import reproduce as report
from ..reproductions import color_space, kim, sobel, tidoaa
from ..reproductions.claims import Found
from ..studies.identity import counted
from ..studies.study import check_seed
from .options import OK, Seed, shown
from .progress import Display, resumable

_TILES_PX = range(11, 65)  # what SSIM and tiles want
PAPERS: dict[str, Any] = {
    "kim": kim,
    "tidoaa": tidoaa,
    "sobel": sobel,
    "colour-space": color_space,
}
_FIGURES: dict[str, Any] = {  # beside that of the claims
    "kim": kim_figures.draw,
    "tidoaa": tidoaa_figures.draw,
    "sobel": sobel_figures.draw,
}
ALL = "all"


@dataclasses.dataclass(frozen=True)
class ReproduceCommand:
    """Run a paper's experiment again, and say of each of its claims whether it holds.

    Writes each claim with what was measured, its interval, a verdict (holds, does not
    hold, cannot be told) and the reason, as CSV and as a figure. An interrupted run
    goes on where it stopped when the same command is run again.

    For example: hmdjit reproduce kim --quick
    """

    paper: Annotated[
        tyro.conf.Positional[str],
        shown(
            "PAPER",
            "kim: head-movement based anti-aliasing against MSAA (Kim et al.); "
            "tidoaa: samples at twice the resolution, by rotation speed; "
            "sobel: temporal anti-aliasing improved with Sobel (Oliveros); "
            "colour-space: anti-aliasing in linear light against gamma, box against "
            "Lanczos filter (Maruszczuk et al.); all of them.",
        ),
    ]
    quick: Annotated[
        bool, shown("", "Fewer sessions: up to two minutes on two cores, each.")
    ] = False
    sessions: Annotated[
        int | None,
        shown(
            "N",
            "Viewing sessions (default: "
            + ", ".join(
                f"{paper.SESSIONS} of {name}, --quick {paper.QUICK_SESSIONS}"
                for name, paper in PAPERS.items()
            )
            + ").",
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
        _checks.one_of("paper", self.paper, [*PAPERS, ALL])
        check_seed(self.seed)
        if self.quick and self.sessions is not None:
            raise ValueError("--quick and --sessions exclude each other: name one.")
        if self.sessions is not None:
            _checks.whole("sessions", self.sessions, 2)
        out = self.out or Path(f"hmdjit-{self.paper}")
        check_can_write(out)
        if self.paper != ALL:
            self._run(console, self.paper, out)
            return OK
        cameras = {name: self._camera(name) for name in PAPERS}  # all checked at first
        ran = {name: self._run(console, name, out / name) for name in cameras}
        pages = [report.overview({name: found for name, (found, _) in ran.items()})]
        pages += [
            report.page(found, [f"{name}/{file}" for file in files])
            for name, (found, files) in ran.items()
        ]
        whole = out / "claims.md"
        with written_atomically(whole) as unfinished:
            unfinished.write_text("\n".join(pages), encoding="utf-8")
        console.out(f"Wrote {whole}.")
        return OK

    def _camera(self, name: str) -> Camera:
        """Return the paper's, in the sizes that are named."""
        sizes = {"width_px": self.width, "height_px": self.height, "fov_deg": self.fov}
        camera = dataclasses.replace(
            PAPERS[name].CAMERA, **{k: v for k, v in sizes.items() if v is not None}
        )
        width, height = camera.width_px, camera.height_px
        tiles = [px for px in _TILES_PX if math.gcd(width, height) % px == 0]
        if not tiles or width * height < 2 * tiles[0] ** 2:
            raise ValueError(
                "--width and --height must be multiples of one size of "
                f"{_TILES_PX[0]} to {_TILES_PX[-1]} px, and hold two such tiles, got "
                f"{width} x {height}."
            )
        return camera

    def _run(
        self, console: rich.console.Console, name: str, out: Path
    ) -> tuple[Found, list[str]]:
        """Run a paper's experiment; what it found, and its figures' files."""
        paper, camera = PAPERS[name], self._camera(name)
        sessions = paper.QUICK_SESSIONS if self.quick else self.sessions
        sessions = paper.SESSIONS if sessions is None else sessions
        console.out(
            f"{paper.TITLE}.\n{counted(sessions, 'session')}, {camera.width_px} x "
            f"{camera.height_px} px, {camera.fov_deg:g} deg, {camera.refresh_hz:g} Hz. "
            f"Finished batches are kept in {out}."
        )
        with resumable(), Display(console) as display:
            found = paper.run(
                camera,
                sessions,
                seed=self.seed,
                out=out,
                overwrite=self.overwrite,
                progress=display,
            )
        console.print(report.verdicts(found))
        if len(found.measures) > 1:
            console.print(report.by_measure(found))
        console.out(report.explanation(found))
        figures = {"claims": figure.draw(found)}
        figures |= _FIGURES.get(name, lambda found: {})(found)
        files = report.write_csv(found, out)
        files += [save(drawn, out / f"{k}.png") for k, drawn in figures.items()]
        names = [f"{k}.png" for k in figures]
        with written_atomically(out / "claims.md") as unfinished:
            unfinished.write_text(report.page(found, names), encoding="utf-8")
        console.out(f"Wrote {', '.join(map(str, [*files, out / 'claims.md']))}.")
        return found, names
