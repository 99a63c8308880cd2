"""The command line's `hmdjit fit`."""

import dataclasses
from pathlib import Path
from typing import Annotated, Any

import rich.console

from .. import _checks, scenes
from .._files import files_beside
from ..curve_fitting import CurveFit, CurveSpace, fit
from ..curve_fitting.fitting import LEAST_SESSIONS
from ..curve_fitting.space import FAMILIES, LOCALIZATIONS, MOST_SAMPLES
from ..figures import curve_fitting as figures
from ..figures.drawing import save
from ..reports import curve_fitting as report
from ..scenes.base import AbstractScene
from ..studies.identity import camera_words, counted, frames_words
from ..studies.measured_blocks import Tiles
from ..studies.study import Study
from ..techniques import curve_file
from . import definition
from .options import (
    OK,
    Fov,
    Frames,
    Head,
    Height,
    Seed,
    Warmup,
    Width,
    shown,
)
from .progress import Display, resumable

SESSIONS = 64
HELD_OUT = ("checkerboard", "noise")
FLAT = "almost_uniform"
"""The one of the eleven scenes that has no flicker to remove."""

_NONE, _TILE_PX = "none", 32


@dataclasses.dataclass(frozen=True)
class FitCommand:
    """Fit blending curves of head speed: least flicker at a loss of detail.

    Writes a curve that `--techniques head_movement:curve.toml` reads, a picture of it
    beside Kim et al.'s, and one of the front of flicker and detail that it is on. What
    it gains is measured on sessions and on scenes that it was not fitted to. An
    interrupted fit goes on where it stopped when the same command is run again.

    For example: hmdjit fit --family spline --head seated --out spline.toml
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
    head: Head = None
    family: Annotated[str, shown("NAME", f"Ease curves: {', '.join(FAMILIES)}")] = "kim"
    samples: Annotated[int, shown("N", f"Past samples, 1 to {MOST_SAMPLES}")] = 1
    localization: Annotated[
        str,
        shown("NAME", f"How colour difference counts: {', '.join(LOCALIZATIONS)}"),
    ] = "linear"
    detail_loss: Annotated[
        float | None,
        shown(
            "X",
            "Largest detail loss, relative to no anti-aliasing (default: that of Kim "
            "et al.'s constants).",
        ),
    ] = None
    lag: Annotated[float, shown("WEIGHT", "Weight of the lag after a quick turn")] = 0.0
    sessions: Annotated[
        int, shown("N", f"Sessions, at least {LEAST_SESSIONS}, one tile")
    ] = SESSIONS
    frames: Frames = None
    warmup: Warmup = None
    refresh: Annotated[float | None, shown("HZ", "Refresh rate (default: 60).")] = None
    width: Width = None
    height: Height = None
    fov: Fov = None
    seed: Seed = 0
    out: Annotated[Path, shown("TOML", "File for the curve, pictures beside it")] = (
        Path("curve.toml")
    )

    def run(self, console: rich.console.Console) -> int:
        """Fit a curve; write it, draw it and say what it gains."""
        pictures = files_beside(self.out, ".toml", ".png", "-front.png")
        space = CurveSpace(self.family, self.samples, self.localization)
        _checks.whole("sessions", self.sessions, LEAST_SESSIONS)
        _checks.in_range("lag", self.lag, 0)
        if self.detail_loss is not None:
            _checks.in_range("detail-loss", self.detail_loss, 0, open_low=True)
        fitted_to, held_out = _scenes(self)
        study = _study(self, fitted_to)
        about = _about(self, study, tuple(held_out))
        console.out(
            f"{counted(len(study.scenes), 'scene')} x "
            f"{counted(study.sessions, 'session')} of "
            f"{study.warmup} + {study.frames} frames, {about['width_px']} x "
            f"{about['height_px']} px, {about['fov_deg']:g} deg, "
            f"{about['refresh_hz']:.4g} Hz; head {about['head']}; {space.size} numbers "
            "to find."
        )
        journal = self.out.with_name(f".{self.out.name}.journal.json")
        with resumable("searches"), Display(console) as display:
            found = fit(
                study,
                space,
                detail_loss=self.detail_loss,
                lag_weight=self.lag,
                held_out=held_out,
                seed=self.seed,
                journal=journal,
                progress=display,
            )
        # The curve comes last: where it is, its pictures are.
        footer = _footer(about)
        gain = report.gain_sentence(found)
        save(figures.draw_curve(found, footer), pictures[0])
        save(figures.draw_front(found, gain, footer), pictures[1])
        table = report.provenance(found, about, self.lag)
        curve_file.write(self.out, found.technique, about={"fit": table})
        journal.unlink(missing_ok=True)
        _print(found, console)
        console.out(f"Wrote {', '.join(map(str, (self.out, *pictures)))}.")
        return OK


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
    shared = ("head", "sessions", "frames", "warmup", "width", "height", "fov")
    options = {name: getattr(command, name) for name in (*shared, "refresh", "seed")}
    study = definition.build(definition.Options(scenes=names, tiles=1, **options))
    tile = Tiles.fitting(study.camera, 1, _TILE_PX)
    return dataclasses.replace(study, measure=tile)


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
        f"Fitted to {', '.join(about['scenes'])}; head {about['head']}, taken as "
        f"known; camera {camera_words(about)}; {about['sessions']} sessions of "
        f"{frames_words(about)}."
    )


def _print(found: CurveFit, console: rich.console.Console) -> None:
    console.print(report.numbers_table(found))
    console.out(f"Search: {found.why}; {found.steps} curves measured.")
    console.out(report.gain_sentence(found))
    for where, kept in (
        ("the scenes that were fitted to", found.kept),
        ("held-out scenes", found.kept_elsewhere),
    ):
        if kept:
            console.out(f"\nHeld-out sessions of {where}:")
            console.print(report.kept_table(kept))
            console.out(report.pair_sentence(kept))
