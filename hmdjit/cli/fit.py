"""The command line's `hmdjit fit`."""

import dataclasses
import time
from pathlib import Path
from typing import Annotated, Any

import rich.console

from .. import _checks, scenes
from ..curve_fitting import CurveFit, CurveSpace, fit
from ..curve_fitting.fitting import LEAST_SESSIONS
from ..curve_fitting.space import FAMILIES, LOCALIZATIONS, MOST_SAMPLES
from ..figures import curve_fitting as figures
from ..reports import curve_fitting as report
from ..scenes.base import AbstractScene
from ..studies.identity import camera_words, frames_words
from ..studies.measured_blocks import Tiles
from ..studies.study import Study
from ..techniques import curve_file
from . import definition
from .options import Fov, Height, Seed, Width, files_beside, shown

SESSIONS = 64
HELD_OUT = ("checkerboard", "noise")
FLAT = "almost_uniform"
"""The one of the eleven scenes that has no flicker to remove."""

_NONE = "none"
_SECONDS_BETWEEN_LINES = 10.0


@dataclasses.dataclass(frozen=True)
class FitCommand:
    """Fit blending curves of head speed: least flicker at a loss of detail.

    Writes a curve that `--techniques head_movement:curve.toml` reads, a picture of it
    beside Kim et al.'s, and one of the front of flicker and detail that it is on. What
    it gains is told on sessions and on scenes that it was not fitted to. An interrupted
    fit goes on where it stopped when the same command is run again.
    """

    scenes: Annotated[
        tuple[str, ...] | None,
        shown(
            "NAME...",
            "Scenes to fit to (default: eight of the eleven; without "
            f"{' and '.join(HELD_OUT)}, which are held out, and {FLAT}, which has no "
            "flicker to remove).",
        ),
    ] = None
    held_out: Annotated[
        tuple[str, ...] | None,
        shown(
            "NAME...",
            "Scenes to judge on, or none (default: the rest of the eleven, without "
            f"{FLAT}).",
        ),
    ] = None
    head: Annotated[
        str | None, shown("NAME|TOML", f"Head model (default: {definition.HEAD}).")
    ] = None
    family: Annotated[
        str, shown("NAME", f"Ease curves: {', '.join(FAMILIES)} (default: kim).")
    ] = "kim"
    samples: Annotated[
        int, shown("N", f"Past samples, 1 to {MOST_SAMPLES} (default: 1).")
    ] = 1
    localization: Annotated[
        str,
        shown(
            "NAME",
            f"How colour difference counts: {', '.join(LOCALIZATIONS)} (default: "
            "linear).",
        ),
    ] = "linear"
    detail_loss: Annotated[
        float | None,
        shown(
            "X",
            "Largest detail loss, relative to no anti-aliasing (default: that of Kim "
            "et al.'s constants).",
        ),
    ] = None
    lag: Annotated[
        float, shown("WEIGHT", "Weight of the lag after a quick turn (default: 0).")
    ] = 0.0
    sessions: Annotated[
        int,
        shown(
            "N", f"Sessions, at least {LEAST_SESSIONS}, one tile (default: {SESSIONS})."
        ),
    ] = SESSIONS
    frames: Annotated[int | None, shown("N", "Measured frames (default: 10).")] = None
    warmup: Annotated[int | None, shown("N", "Frames before them (default: 12).")] = (
        None
    )
    refresh: Annotated[float | None, shown("HZ", "Refresh rate (default: 60).")] = None
    width: Width = None
    height: Height = None
    fov: Fov = None
    seed: Seed = 0
    out: Annotated[
        Path,
        shown("TOML", "File for the curve, pictures beside it (default: curve.toml)."),
    ] = Path("curve.toml")


COMMANDS: dict[str, Any] = {"fit": FitCommand}


def run(command: FitCommand, console: rich.console.Console) -> None:
    """Fit a curve; write it, draw it and say what it gains."""
    pictures = files_beside(command.out, ".toml", ".png", "-front.png")
    space = CurveSpace(command.family, command.samples, command.localization)
    _checks.whole("sessions", command.sessions, LEAST_SESSIONS)
    _checks.in_range("lag", command.lag, 0)
    if command.detail_loss is not None:
        _checks.in_range("detail-loss", command.detail_loss, 0, open_low=True)
    fitted_to, held_out = _scenes(command)
    study = _study(command, fitted_to)
    camera = study.display
    console.print(
        f"{len(study.scenes)} scenes x {study.sessions} sessions of {study.warmup} + "
        f"{study.frames} frames, {camera.width_px} x {camera.height_px} px, "
        f"{camera.fov_deg:g} deg, {camera.refresh_hz:.4g} Hz; head "
        f"{command.head or definition.HEAD}; {space.size} numbers to find.",
        highlight=False,
        soft_wrap=True,
    )
    journal = command.out.with_name(f".{command.out.name}.journal.json")
    try:
        with _Line(console) as tell:
            found = fit(
                study,
                space,
                detail_loss=command.detail_loss,
                lag_weight=command.lag,
                held_out=held_out,
                seed=command.seed,
                journal=journal,
                tell=tell,
            )
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            "stopped; finished searches are kept: run the same command to go on."
        ) from None
    about = _about(command, study, tuple(held_out))
    table = report.provenance(found, about, command.lag)
    # The curve comes last: where it is, its pictures are.
    footer = _footer(about)
    figures.write_curve(found, pictures[0], footer)
    figures.write_front(found, pictures[1], report.gain_sentence(found), footer)
    curve_file.write(command.out, found.technique, about={"fit": table})
    journal.unlink(missing_ok=True)
    _print(found, command, console)
    paths = ", ".join(map(str, (command.out, *pictures)))
    console.print(f"Wrote {paths}.", highlight=False, soft_wrap=True)


def _scenes(command: FitCommand) -> tuple[tuple[str, ...], dict[str, AbstractScene]]:
    """Names of the scenes to fit to, and the scenes to judge on."""
    everything = scenes.study_set()
    flickering = [name for name in everything if name != FLAT]
    fitted_to = command.scenes
    if fitted_to is None:
        without = command.held_out or HELD_OUT
        fitted_to = tuple(
            name for name in flickering if name not in (*without, *HELD_OUT)
        )
    for name in fitted_to:
        _checks.one_of("scenes", name, everything)
    held_out = command.held_out
    if held_out is None:
        held_out = tuple(name for name in flickering if name not in fitted_to)
    elif held_out == (_NONE,):
        held_out = ()
    for name in held_out:
        _checks.one_of("held-out", name, [*flickering, _NONE])
        if name == _NONE or name in fitted_to:
            raise ValueError(
                f"held-out must be none, or other scenes than scenes, got {name}."
            )
    return fitted_to, {name: everything[name] for name in held_out}


def _study(command: FitCommand, names: tuple[str, ...]) -> Study:
    measure = Tiles(1, 32)
    return definition.build(
        definition.Options(
            scenes=names,
            head=command.head,
            sessions=command.sessions,
            frames=command.frames,
            warmup=command.warmup,
            tiles=measure.count,
            tile_size=measure.size_px,
            width=command.width,
            height=command.height,
            fov=command.fov,
            refresh=command.refresh,
            seed=command.seed,
        )
    )


def _about(
    command: FitCommand, study: Study, held_out: tuple[str, ...]
) -> dict[str, Any]:
    camera = study.display
    return {
        "scenes": list(study.scenes),
        "held_out": list(held_out),
        "head": command.head or definition.HEAD,
        "width_px": camera.width_px,
        "height_px": camera.height_px,
        "fov_deg": float(camera.fov_deg),
        "refresh_hz": float(camera.refresh_hz),
        "sessions": study.sessions,
        "frames": study.frames,
        "warmup": study.warmup,
        "seed": command.seed,
    }


def _footer(about: dict[str, Any]) -> str:
    return (
        f"Fitted to {', '.join(about['scenes'])}; head {about['head']}; camera "
        f"{camera_words(about)}; {about['sessions']} sessions of "
        f"{frames_words(about)}."
    )


def _print(found: CurveFit, command: FitCommand, console: rich.console.Console) -> None:
    say = lambda text: console.print(text, highlight=False, soft_wrap=True)
    console.print(report.numbers_table(found))
    say(f"Search: {found.why}; {found.steps} curves measured.")
    say(report.gain_sentence(found))
    for where, kept in (
        ("the scenes that were fitted to", found.kept),
        ("held-out scenes", found.kept_elsewhere),
    ):
        if kept:
            say(f"\nHeld-out sessions of {where}:")
            console.print(report.kept_table(kept))
            say(report.pair_sentence(kept))


class _Line:
    """Progress of a fit: one line on a terminal, a line now and then elsewhere."""

    def __init__(self, console: rich.console.Console):
        self._console, self._status = console, console.status("preparing")
        self._start = time.monotonic()
        self._last_line = -_SECONDS_BETWEEN_LINES

    def __enter__(self) -> "_Line":
        if self._console.is_terminal:
            self._status.__enter__()
        return self

    def __exit__(self, *exception: Any) -> None:
        if self._console.is_terminal:
            self._status.__exit__(*exception)

    def __call__(self, line: str) -> None:
        seconds = time.monotonic() - self._start
        words = f"{seconds:5.0f} s  {line}"
        if self._console.is_terminal:
            self._status.update(words)
        elif seconds - self._last_line > _SECONDS_BETWEEN_LINES:
            self._last_line = seconds
            print(f"  {words}", flush=True)
