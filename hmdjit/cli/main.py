"""The command line: one command per file, or here: `study` and `apply`."""

import dataclasses
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import rich.console
import rich.progress
import tyro

from .. import metrics, scenes, techniques
from ..camera import Camera
from ..head_motion import Trace
from ..head_motion.replay import Replay
from ..metrics.mtcd import CODE_VALUES
from ..reports import study as report
from ..simulation import apply as clips
from ..studies.failures import FailedSessionsError
from ..studies.progress import Progress
from ..studies.study import Study
from . import definition
from . import envelope as cli_envelope
from . import fit as cli_fit
from . import head as cli_head
from . import trade_off as cli_trade_off
from .options import check_can_write, shown

OK, FAILED, WRONG_INPUT, INTERRUPTED = 0, 1, 2, 130


def _study_fields() -> list[tuple[str, Any, Any]]:
    """List the options of a study as the command line presents them."""
    definition_file = Annotated[
        tyro.conf.Positional[Path | None],
        shown("[STUDY.toml]", "File with any of the options below as keys."),
    ]
    fields: list[tuple[str, Any, Any]] = [
        ("definition", definition_file, dataclasses.field(default=None))
    ]
    for field in dataclasses.fields(definition.Options):
        metavar, words = field.metadata["metavar"] or None, field.metadata["help"]
        kind = Annotated[field.type, shown(metavar, words)]
        if field.type is bool:
            kind = tyro.conf.FlagCreatePairsOff[kind]
        fields.append((field.name, kind, dataclasses.field(default=field.default)))
    return fields


StudyCommand = dataclasses.make_dataclass("StudyCommand", _study_fields(), frozen=True)
StudyCommand.__doc__ = """Simulate viewing sessions; report how much each technique
flickers.

Needs no arguments: eleven scenes, 500 sessions of people who fixate, no anti-aliasing,
MSAA 4x and head movement, the frozen picture as a control and SSAA as the reference. An
interrupted study goes on where it stopped when the same command is run again.
"""


@dataclasses.dataclass(frozen=True)
class ApplyCommand:
    """Run a technique on rendered frames: numbered PNGs in, displayed PNGs out."""

    technique: tyro.conf.Positional[str]
    """Technique id, e.g. head_movement."""
    frames_dir: tyro.conf.Positional[Path]
    """Folder of numbered PNG frames, one per pose."""
    poses: tyro.conf.Positional[Path]
    """CSV of head poses, t_s,qw,qx,qy,qz, one row per frame."""
    out: Path = Path("hmdjit-displayed")
    """Folder for the displayed frames."""
    fov: float = 96.0
    """Horizontal field of view the frames were rendered with, deg."""
    refresh: float | None = None
    """Refresh rate, Hz (default: the poses' own)."""


def run(arguments: Sequence[str]) -> int:
    """Run a command; returns the exit code."""
    commands: dict[str, Any] = {"study": StudyCommand, "apply": ApplyCommand}
    command: Any = tyro.extras.subcommand_cli_from_dict(
        commands
        | cli_fit.COMMANDS
        | {"head": cli_head.HeadCommand}
        | cli_trade_off.COMMANDS
        | cli_envelope.COMMANDS,
        prog="hmdjit",
        description="How much does the picture flicker when a head holds still?",
        args=list(arguments),
    )
    console = rich.console.Console(markup=False)
    try:
        if isinstance(command, ApplyCommand):
            return _apply(command, console)
        if isinstance(command, cli_fit.FitCommand):
            cli_fit.run(command, console)
            return OK
        if isinstance(command, cli_head.HeadCommand):
            cli_head.run(command.command, console)
            return OK
        if isinstance(command, cli_trade_off.TradeOffCommand):
            cli_trade_off.measure(command, console)
            return OK
        if isinstance(command, cli_trade_off.PickCommand):
            cli_trade_off.pick(command, console)
            return OK
        if isinstance(command, cli_envelope.EnvelopeCommand):
            return OK if cli_envelope.run(command, console) else FAILED
        return _study(command, console)
    except KeyboardInterrupt as stop:
        print(f"hmdjit: {str(stop) or 'stopped.'}", file=sys.stderr)
        return INTERRUPTED
    except (ValueError, ImportError) as error:
        return _complain(error, WRONG_INPUT)
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        return _complain(f"{place}{error.strerror or error}", WRONG_INPUT)
    except FailedSessionsError as error:
        return _complain(error, FAILED)


def _complain(error: object, code: int) -> int:
    print(f"hmdjit: error: {' '.join(str(error).split())}", file=sys.stderr)
    return code


def _study(command: Any, console: rich.console.Console) -> int:
    said = {
        field.name: getattr(command, field.name)
        for field in dataclasses.fields(definition.Options)
    }
    options, head_movement = definition.Options(), {}
    if command.definition is not None:
        options, head_movement = definition.read_toml(command.definition)
    options = definition.merged(options, definition.Options(**said))
    study = definition.build(options, head_movement)
    goal = definition.goal(options, study)
    out = options.out or Path("hmdjit-study")
    check_can_write(out)

    camera = study.display
    is_replay = isinstance(study.head, Replay)  # its windows are counted later
    sessions = f"{'at most ' if is_replay else ''}{study.sessions} sessions"
    if goal.tolerance is not None:
        sessions = (
            f"sessions until all is known within {100 * goal.tolerance:g} %, each"
        )
    elif goal.budget_s is not None:
        sessions = f"sessions for {goal.budget_s:g} s, each"
    head = "" if is_replay else f"{options.head or definition.HEAD}, "
    console.print(
        f"{len(study.scenes)} scenes x {len(study.techniques)} techniques x "
        f"{sessions} of {study.warmup} + {study.frames} frames, "
        f"{camera.width_px} x {camera.height_px} px, {camera.fov_deg:g} deg, "
        f"{camera.refresh_hz:.4g} Hz.\n"
        f"Head: {head}{study.head}.\n"
        "Compiling each technique when it first runs; finished batches are kept in "
        f"{out}.",
        highlight=False,
        soft_wrap=True,
    )
    try:
        with _Bar(console, study) as bar:
            dataset = study.run(
                options.seed or 0,
                out=out,
                progress=bar,
                tolerance=goal.tolerance,
                budget_s=goal.budget_s,
                omit_failed=options.omit_failed,
            )
    except KeyboardInterrupt:
        console.print(
            "\nStopped. Finished batches are kept: run the same command to go on.",
            highlight=False,
        )
        return INTERRUPTED
    written = report.write_report(dataset, out)
    report.print_table(dataset, console=console)
    paths = ", ".join(map(str, (out / "result.nc", *written)))
    console.print(f"Wrote {paths}.", soft_wrap=True)
    return OK


class _Bar:
    """Progress of a study: a bar on a terminal, a line now and then elsewhere."""

    _SECONDS_BETWEEN_LINES = 10.0

    def __init__(self, console: rich.console.Console, study: Study):
        self._console = console
        self._start = self._last_line = time.monotonic()
        self._bar = rich.progress.Progress(
            rich.progress.BarColumn(bar_width=30),
            rich.progress.MofNCompleteColumn(),
            rich.progress.TextColumn("{task.fields[rate]}", markup=False),
            rich.progress.TextColumn("{task.fields[left]}", markup=False),
            rich.progress.TextColumn("{task.description}", markup=False),
            console=console,
            disable=not console.is_terminal,
        )
        total = len(study.scenes) * len(study.techniques) * study.sessions
        self._task = self._bar.add_task("preparing", total=total, rate="", left="")

    def __enter__(self) -> "_Bar":
        self._bar.__enter__()
        return self

    def __exit__(self, *exception: Any) -> None:
        self._bar.__exit__(*exception)

    def __call__(self, event: Progress) -> None:
        if event.line:
            self._console.print(event.line, highlight=False, soft_wrap=True)
        now = time.monotonic()
        seconds = now - self._start
        rate, left = "", ""
        if event.fresh:
            speed = event.fresh / seconds
            rate = f"{speed:,.0f} sessions/s"
            left = f"{(event.total - event.done) / speed:,.0f} s left"
        self._bar.update(
            self._task,
            completed=event.done,
            total=event.total,
            description=event.doing,
            rate=rate,
            left=left,
        )
        is_due = now - self._last_line > self._SECONDS_BETWEEN_LINES
        if not self._console.is_terminal and is_due:
            self._last_line = now
            words = (f"{event.done} of {event.total}", rate, left, event.doing)
            print("  " + ", ".join(word for word in words if word), flush=True)


def _apply(command: ApplyCommand, console: rich.console.Console) -> int:
    technique = techniques.by_id(command.technique)
    trace = Trace.read(command.poses)
    files = _numbered_frames(command.frames_dir)
    if len(files) != len(trace.t_s):
        raise ValueError(
            f"{command.poses}: must have one row per frame: {len(files)} frames in "
            f"{command.frames_dir}, {len(trace.t_s)} rows."
        )
    height, width, _ = scenes.pictures.read_picture(files[0]).shape
    rate = command.refresh if command.refresh is not None else trace.rate_hz
    camera = Camera(width, height, command.fov, rate)
    out = command.out
    check_can_write(out)
    if out.resolve() == command.frames_dir.resolve():
        raise ValueError(f"out must differ from the folder of the frames, got {out}.")

    before, after = metrics.StreamedMtcd(), metrics.StreamedMtcd()

    def pictures() -> Iterator[np.ndarray]:
        for file in rich.progress.track(files, technique.id, console=console):
            picture = scenes.pictures.read_picture(file)
            if picture.shape != (height, width, 3):
                raise ValueError(
                    f"{file}: must be {width} x {height} px as the first frame, got "
                    f"{picture.shape[1]} x {picture.shape[0]}."
                )
            before.add(picture)
            yield picture

    poses = trace.world_from_head
    displayed = clips.stream(technique, camera, pictures(), poses)
    # All frames or none: they move to their folder when the last one is done.
    with tempfile.TemporaryDirectory() as scratch:
        for file, picture in zip(files, displayed, strict=True):
            after.add(picture)
            _write_png(Path(scratch) / file.name, picture)
        out.mkdir(parents=True, exist_ok=True)
        for file in files:
            shutil.move(Path(scratch) / file.name, out / file.name)
    console.print(
        f"MTCD before {before.value:.3f}, after {after.value:.3f} code values "
        f"(ratio {after.value / before.value:.3f})"
        if before.value
        else "MTCD 0 before: no flicker to remove",
        highlight=False,
    )
    console.print(
        f"Wrote {len(files)} displayed frames to {out}.",
        highlight=False,
        soft_wrap=True,
    )
    return OK


def _numbered_frames(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise ValueError(f"{folder}: must be a folder of numbered PNG frames.")
    numbered = {}
    for file in folder.iterdir():
        digits = re.findall(r"\d+", file.stem)
        if file.suffix.lower() == ".png" and digits:
            number = int(digits[-1])
            if number in numbered:
                raise ValueError(f"{folder}: two frames have the number {number}.")
            numbered[number] = file
    if len(numbered) < 2:
        raise ValueError(
            f"{folder}: must hold at least 2 numbered PNG frames, has {len(numbered)}."
        )
    return [numbered[number] for number in sorted(numbered)]


def _write_png(path: Path, picture: np.ndarray) -> None:
    import PIL.Image

    codes = np.floor(CODE_VALUES * np.clip(picture, 0, 1) + 0.5).astype(np.uint8)
    PIL.Image.fromarray(codes).save(path, format="PNG")
