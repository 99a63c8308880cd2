"""The command line's `hmdjit trade-off` and `hmdjit pick`."""

import dataclasses
import math
import os
import shlex
import time
from pathlib import Path
from typing import Annotated, Any

import rich.console
import tyro
from rich import box
from rich.table import Table

from . import _checks, techniques
from .studies import definition, settings, trade_off, trade_off_figure
from .studies import trade_off_measuring as measuring
from .studies.intervals import Z95
from .studies.monte_carlo import Study
from .studies.trade_off import Choice, Row

SCENE = "text"  # its hard edges show what textures do; photographs are their texels
TECHNIQUE = "head_movement"
_ALSO = ("none", "ssaa4")  # in the reference and the default setting
_CSV = Path("hmdjit-trade-off") / "trade_off.csv"
_SESSIONS, _QUICK_SESSIONS = 48, 24


def _shown(metavar: str, text: str) -> Any:
    return tyro.conf.arg(metavar=metavar, help=text, help_behavior_hint="")


@dataclasses.dataclass(frozen=True)
class TradeOffCommand:
    """Measure seconds against error for every knob, on this machine.

    Takes 2 to 3 minutes on two idle cores, most of them to compile. Looks at the page
    of text: its hard edges show what textures do to the numbers, which photographs,
    whose texels are the texture's, do not. One knob is turned at a time; bias is
    measured by paired differences to the reference (texture 4x, float64).
    """

    scene: Annotated[
        str | None, _shown("NAME", f"One of the eleven scenes (default: {SCENE}).")
    ] = None
    images: Annotated[
        Path | None, _shown("PATH", "A flat picture (PNG, JPEG) instead.")
    ] = None
    head: Annotated[
        str | None,
        _shown("NAME|TOML", f"Head model (default: {definition.HEAD})."),
    ] = None
    technique: Annotated[
        tuple[str, ...],
        _shown("ID...", f"Techniques to turn all knobs with (default: {TECHNIQUE})."),
    ] = (TECHNIQUE,)
    sessions: Annotated[
        int | None,
        _shown("N", f"Sessions of each setting (default: {_SESSIONS})."),
    ] = None
    seconds: Annotated[
        float, _shown("S", "Time at which total errors are told (default: 10).")
    ] = 10.0
    quick: Annotated[
        tyro.conf.FlagCreatePairsOff[bool],
        _shown("", f"The main knobs only, {_QUICK_SESSIONS} sessions: 45 seconds."),
    ] = False
    width: Annotated[
        int | None, _shown("PX", "Width of the frame (default: 1024).")
    ] = None
    height: Annotated[
        int | None, _shown("PX", "Height of the frame (default: 1024).")
    ] = None
    fov: Annotated[
        float | None, _shown("DEG", "Horizontal field of view (default: 96).")
    ] = None
    seed: Annotated[int, _shown("N", "Seed of all random draws (default: 0).")] = 0
    out: Annotated[
        Path, _shown("DIR", f"Folder for what is written (default: {_CSV.parent}).")
    ] = _CSV.parent


@dataclasses.dataclass(frozen=True)
class PickCommand:
    """Choose the cheapest setting within a tolerance, or the best within a budget.

    From what `hmdjit trade-off` measured here. Names the options of `hmdjit study`.
    """

    tolerance: Annotated[
        float | None,
        _shown("SHARE", "Largest error of the mean MTCD, e.g. 0.02; in (0, 1)."),
    ] = None
    budget: Annotated[
        str | None, _shown("TIME", "Time for one scene, e.g. 10s or 2min.")
    ] = None
    technique: Annotated[
        tuple[str, ...] | None,
        _shown("ID...", "Techniques to choose for (default: those with all knobs)."),
    ] = None
    table: Annotated[
        Path,
        tyro.conf.arg(
            name="from",
            metavar="CSV",
            help=f"Table of `hmdjit trade-off` (default: {_CSV}).",
            help_behavior_hint="",
        ),
    ] = _CSV


COMMANDS: dict[str, Any] = {"trade-off": TradeOffCommand, "pick": PickCommand}


def measure(command: TradeOffCommand, console: rich.console.Console) -> None:
    """Measure, print and draw a trade-off; an interruption keeps what is measured."""
    _checks.in_range("seconds", command.seconds, 0, open_low=True)
    sessions = command.sessions
    if sessions is None:
        sessions = _QUICK_SESSIONS if command.quick else _SESSIONS
    _checks.whole("sessions", sessions, 2)
    study, study_options = _study(command)
    single = settings.single_knobs(study)
    if command.quick:
        chosen = [one for one in single if one.name in settings.QUICK]
        also = []
    else:
        chosen = [*single, *settings.combinations(study)]
        also = [techniques.by_id(id) for id in _ALSO]
    cases, misfits = settings.cases(
        study, chosen, also=also, is_with_samples=not command.quick
    )
    file = command.out / _CSV.name
    _check_can_write(command.out)
    for name in misfits:
        console.print(f"Left out: {name} does not fit the camera.", highlight=False)
    console.print(
        f"Scene {next(iter(study.scenes))}: {len(cases)} settings and techniques x "
        f"{sessions} sessions, one after the other. Rows go to {file} as they come.",
        highlight=False,
        soft_wrap=True,
    )
    say, rows = _Lines(console), []
    try:
        for row in measuring.measure(
            study,
            cases,
            seed=command.seed,
            sessions=sessions,
            study_options=study_options,
            progress=say,
        ):
            rows.append(row)
            trade_off.write_csv(rows, file)
    except KeyboardInterrupt:
        kept = f"{len(rows)} rows are kept in {file}" if rows else "no row was finished"
        console.print(f"\nStopped: {kept}.", highlight=False, soft_wrap=True)
        raise
    console.print(table(rows, command.seconds))
    _say_what_it_means(console, rows)
    picture = trade_off_figure.write_figure(rows, file.with_suffix(".png"))
    console.print(f"Wrote {file} and {picture}.", highlight=False, soft_wrap=True)


def _study(command: TradeOffCommand) -> tuple[Study, str]:
    """Study of one scene, and the options that name it."""
    if command.scene is not None and command.images is not None:
        raise ValueError("scene and images exclude each other: name one of them.")
    options = definition.Options(
        images=None if command.images is None else (command.images,),
        scenes=None if command.images is not None else (command.scene or SCENE,),
        head=command.head,
        techniques=command.technique,
        baseline=command.technique[0] if command.technique else None,
        width=command.width,
        height=command.height,
        fov=command.fov,
        seed=command.seed,
    )
    picture = (
        ["--scenes", command.scene or SCENE]
        if command.images is None
        else ["--images", str(command.images)]
    )
    words = [*picture, "--head", command.head or definition.HEAD]
    if command.fov is not None:
        words += ["--fov", f"{command.fov:g}"]
    if command.seed:
        words += ["--seed", str(command.seed)]
    return definition.build(options), shlex.join(words)


def _check_can_write(folder: Path) -> None:
    existing = next(place for place in (folder, *folder.parents) if place.exists())
    if not existing.is_dir() or not os.access(existing, os.W_OK):
        raise ValueError(f"out must be a folder that can be written, got {folder}.")


class _Lines:
    """A line for each step that takes long, with the time since the start."""

    def __init__(self, console: rich.console.Console):
        self._console, self._start = console, time.monotonic()

    def __call__(self, event: measuring.Progress) -> None:
        seconds = time.monotonic() - self._start
        self._console.print(
            f"{seconds:5.0f} s  {event.done:2d} of {event.total}  {event.doing}",
            highlight=False,
            soft_wrap=True,
        )


def table(rows: list[Row], seconds: float) -> Table:
    """Lay out rows: what a setting costs, and how far off it is."""
    found = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    found.add_column("setting", overflow="fold")
    for header in (
        *("technique", "MTCD", "bias, %", "sd, %", "detail loss", "ms/session"),
        *("s to 1 %", f"error, % at {seconds:g} s", "compile, s"),
    ):
        found.add_column(header, justify="right")
    on_front = [
        row
        for technique in dict.fromkeys(row.technique for row in rows)
        for row in trade_off.front_of([r for r in rows if r.technique == technique])
    ]
    knob = rows[0].knob if rows else ""
    for row in rows:
        if row.knob != knob:
            knob = row.knob
        mean = row.reference_mtcd or math.nan
        mark = " †" if row.is_other_device else " ‡" * (row.bias_by == "frame mean")
        found.add_row(
            row.setting + mark,
            row.technique,
            f"{row.mtcd:.2f}",
            f"{100 * row.bias / mean:+.2f} ±{100 * Z95 * row.bias_se / mean:.2f}",
            f"{100 * row.mtcd_sd / mean:.0f}",
            f"{row.detail_loss:.0f}",
            f"{1e3 * row.s_per_session:.2f}",
            f"{row.seconds_to(0.01):.1f}",
            f"{100 * row.error(seconds):.2f}" if row.reference_mtcd else "-",
            f"{row.compile_s:.1f}",
            style="bold" if row in on_front else "",
        )
    return found


def _say_what_it_means(console: rich.console.Console, rows: list[Row]) -> None:
    identity = rows[0].identity
    words = [
        "Bold: on the Pareto front of seconds and |bias|. † another modelled device: "
        "its difference is no error. ‡ no sample of the frame's pixels: compared by "
        "frame means. Bias: paired, with 95 %. s to 1 %: running time to a Monte Carlo "
        "standard error of 1 %. Compiled two at a time, so compile times include "
        "waiting.",
        f"{identity.device}, {identity.cores} cores ({identity.processor}), load "
        f"{identity.load:.2g} before; JAX {identity.jax_version}.",
    ]
    for row in rows:
        if row.setting == "whole frame" and row.frame_difference_se > 0:
            twin = next(
                (
                    r
                    for r in rows
                    if (r.knob, r.technique) == ("default", row.technique)
                ),
                None,
            )
            if twin is not None:
                # Both are differences to the reference on tiles.
                gap = row.frame_difference - twin.frame_difference
                z = gap / math.hypot(row.frame_difference_se, twin.frame_difference_se)
                words.append(
                    f"Check of tiles, {row.technique}: whole frame minus tiles "
                    f"{100 * gap / row.reference_mtcd:+.1f} % over {row.sessions} "
                    f"sessions ({z:+.1f} standard errors)."
                )
    console.print("\n".join(words), highlight=False, soft_wrap=True, style="dim")


def pick(command: PickCommand, console: rich.console.Console) -> None:
    """Choose a setting, and print how to run it."""
    if (command.tolerance is None) == (command.budget is None):
        raise ValueError("name either --tolerance, e.g. 0.02, or --budget, e.g. 10s.")
    if command.tolerance is not None:
        _checks.in_range(
            "tolerance", command.tolerance, 0, 1, open_low=True, open_high=True
        )
    budget = None if command.budget is None else trade_off.parse_seconds(command.budget)
    rows = trade_off.read_csv(command.table)
    candidates = trade_off.candidates(rows, command.technique)
    if budget is not None:
        choice = trade_off.pick_budget(candidates, budget)
    else:
        assert command.tolerance is not None
        choice = trade_off.pick_tolerance(candidates, command.tolerance)
    _print_choice(choice, console)


def _print_choice(choice: Choice, console: rich.console.Console) -> None:
    first = choice.rows[0]
    compile_s = sum(row.compile_s for row in choice.rows) + first.bake_s
    say = lambda text: console.print(text, highlight=False, soft_wrap=True)
    say(f"Setting: {choice.setting} ({first.identity.scene}).")
    say(
        f"Sessions: {choice.sessions:,}. Expected: {choice.seconds:.3g} s of running "
        f"per scene, after about {compile_s:.0f} s to compile and bake; error below "
        f"{100 * choice.error:.2g} % of MTCD (95 %)."
    )
    for row in choice.rows:
        bias, error = (100 * x / row.reference_mtcd for x in (row.bias, row.bias_se))
        say(f"{row.technique}: bias {bias:+.3f} ± {Z95 * error:.3f} % of MTCD.")
    names = " ".join(row.technique for row in choice.rows)
    if first.python_fields:
        say(f"In Python only: {first.python_fields}; the rest as options:")
    say(
        f"hmdjit study {first.identity.study_options} {first.setting_options} "
        f"--techniques {names} --sessions {choice.sessions}"
    )
