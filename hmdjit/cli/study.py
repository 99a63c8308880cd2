"""The command line's `hmdjit study`: the main job."""

import dataclasses
from pathlib import Path
from typing import Annotated

import rich.console
import tyro

from .._files import check_can_write
from ..head_motion import presets
from ..head_motion.replay import Replay
from ..pages import study as pages
from ..reports import study as report
from ..studies.executors import opened
from ..studies.identity import counted
from ..studies.measured_blocks import Tiles
from . import definition
from .kept import keep, repeated
from .options import HEAD, OK, Options, shown
from .progress import Display, resumable

_SMALL_PX = 24  # a halo is about as wide


@dataclasses.dataclass(frozen=True)
class StudyCommand(Options):
    """Simulate viewing sessions; report how much each technique flickers.

    Needs no arguments: eleven scenes, 500 sessions of people who fixate, no
    anti-aliasing, MSAA 4x and head movement, the frozen picture as a control and SSAA
    as the reference. An interrupted study goes on where it stopped when the same
    command is run again.

    For example: hmdjit study --scenes fence A.png --sessions 200
    """

    definition: Annotated[
        tyro.conf.Positional[Path | None],
        shown("[STUDY.toml]", "File with any of the options below as keys."),
    ] = None
    no_report: Annotated[
        bool, shown("", "Write no report.html: `hmdjit report DIR` does so later.")
    ] = False

    def run(self, console: rich.console.Console) -> int:
        """Run the study; write, draw and print what it found."""
        options, tables = Options(), {}
        if self.definition is not None:
            options, tables = definition.read_toml(self.definition)
        options = definition.merged(options, self)
        study = definition.build(options, tables)
        goal = definition.goal(options, study)
        out = options.out or Path("hmdjit-study")
        check_can_write(out)

        camera = study.display
        traces = study.head.traces if isinstance(study.head, Replay) else ()
        is_replay = bool(traces)  # its windows are counted later
        sessions = "at most " * is_replay + counted(study.sessions, "session")
        if goal.tolerance is not None:
            sessions = (
                f"sessions until all is known within {100 * goal.tolerance:g} %, each"
            )
        elif goal.budget_s is not None:
            sessions = f"sessions for {goal.budget_s:g} s, each"
        elif goal.repeat is not None:
            sessions = f"as many sessions as in {options.repeat}, each"
        for note in [note for trace in traces for note in trace.notes]:
            console.out(note)
        frame = f"{camera.width_px} x {camera.height_px} px"
        tiles = study.measure if options.tile_size is None else None
        if isinstance(tiles, Tiles) and tiles.size_px <= _SMALL_PX < camera.width_px:
            console.out(
                f"Tiles are of {tiles.size_px} px only, for no larger size divides "
                f"{frame}: the study is slow. Name another --width or --height, --crop "
                "or --whole-frame for larger blocks."
            )
        head = study.head
        if not isinstance(head, Replay):
            head = f"{options.head or HEAD}, {presets.words(head)}"
        console.out(
            f"{counted(len(study.scenes), 'scene')} x "
            f"{counted(len(study.techniques), 'technique')} x {sessions} of "
            f"{study.warmup} + {study.frames} frames, "
            f"{frame}, {camera.fov_deg:g} deg, "
            f"{camera.refresh_hz:.4g} Hz.\n"
            f"Head: {head}.\n"
            "Compiling each technique when it first runs; finished batches are kept in "
            f"{out}."
        )
        with (
            resumable(),
            opened(options.workers, options.dask) as executor,
            Display(console) as display,
        ):
            dataset = study.run(
                options.seed or 0,
                out=out,
                progress=display,
                tolerance=goal.tolerance,
                budget_s=goal.budget_s,
                repeat=goal.repeat,
                omit_failed=options.omit_failed,
                overwrite=options.overwrite,
                executor=executor,
            )
        report.print_table(dataset, console=console)
        written = [keep(options, self.definition, out)]
        if self.no_report:
            written += report.write_report(dataset, out)
        else:
            written += pages.write_page(dataset, out, study, command=repeated(out))
        console.out(f"Wrote {', '.join(map(str, (out / 'result.nc', *written)))}.")
        if goal.budget_s is not None:
            console.out(
                "How many sessions these are followed the clock: instead of --budget, "
                f"--repeat {out / 'result.nc'} runs as many again."
            )
        return OK
