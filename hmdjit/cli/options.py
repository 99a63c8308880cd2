"""Options that several commands share, those of a study above all."""

import dataclasses
import re
import typing
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import tyro

from ..head_motion import Trace, presets
from ..metrics import IDS as METRICS

OK, FAILED, WRONG_INPUT, INTERRUPTED = 0, 1, 2, 130
"""Exit codes; a bound that does not hold, and sessions that fail, have failed."""

TECHNIQUES = ("none", "msaa4", "head_movement", "freeze", "ssaa4")
HEAD = "fixating"  # people told to hold their gaze; the README says why


def shown(metavar: str | None, text: str) -> Any:
    """Present an option: its metavar, a sentence, and its default unless that does."""
    says_it = "(default" in text
    hint = lambda d: "" if says_it or d in ("None", "False") else f"(default: {d})"
    return tyro.conf.arg(metavar=metavar or None, help=text, help_behavior_hint=hint)


Head = Annotated[
    str | None,
    shown(
        "NAME|TOML",
        f"Head model: {', '.join(presets.tables())}, or a file as `hmdjit head fit` "
        f"writes it (default: {HEAD}).",
    ),
]
Frames = Annotated[int | None, shown("N", "Measured frames, at least 2 (default: 10).")]
Warmup = Annotated[int | None, shown("N", "Frames before them (default: 12).")]
Width = Annotated[int | None, shown("PX", "Width of the frame (default: 1024).")]
Height = Annotated[int | None, shown("PX", "Height of the frame (default: 1024).")]
Fov = Annotated[float | None, shown("DEG", "Horizontal field of view (default: 96).")]
Seed = Annotated[int, shown("N", "Seed of all random draws")]


@dataclasses.dataclass(frozen=True)
class PoseLog:
    """How logs of poses are read, by every command that reads them."""

    axes: Annotated[
        str | None, shown("NAME", "Axes of recorded heads: openxr (default) or unity.")
    ] = None
    time_unit: Annotated[
        str | None,
        shown("UNIT", "Their times: s, ms, us, ns (default: what the header says)."),
    ] = None
    columns: Annotated[
        tuple[str, ...] | None,
        shown("NAME...", "Names of their columns, - for others, instead of a header."),
    ] = None
    skip_damaged: Annotated[
        bool, shown("", "Leave out their damaged rows, at most 10 %, and count them.")
    ] = False
    skip_held: Annotated[
        bool, shown("", "Leave out their rows that repeat the pose before.")
    ] = False

    def refuse(self, why: str) -> None:
        """Raise if any of it is said, where there is no log."""
        for field in dataclasses.fields(PoseLog):
            if getattr(self, field.name):
                raise ValueError(f"{spoken(field.name)} {why}")

    def read_trace(self, path: Path) -> Trace:
        """Read a log of a rate that may be; the user must be told its `notes`."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # they are among the notes
            trace = Trace.read(
                path,
                columns=self.columns,
                time_unit=self.time_unit,
                axes=self.axes or "openxr",
                skip_damaged=self.skip_damaged,
                skip_held=self.skip_held,
            )
        trace.rate_hz  # noqa: B018  raises for a wrong unit of time
        return trace


@dataclasses.dataclass(frozen=True)
class _StudyOptions:
    """What can be said of a study but for how logs of poses are read."""

    images: Annotated[
        tuple[Path, ...] | None,
        shown("PATH...", "Flat pictures (PNG, JPEG) instead of scenes."),
    ] = None
    panorama: Annotated[
        tuple[Path, ...] | None,
        shown("PATH...", "Equirectangular panoramas instead of scenes."),
    ] = None
    scenes: Annotated[
        tuple[str, ...] | None,
        shown(
            "NAME...",
            "Scenes by name, pictures and solids (`hmdjit scenes` lists them), picture "
            "files, or your own, my_scene.py:scene (default: eleven pictures).",
        ),
    ] = None
    no_neck: Annotated[
        bool, shown("", "Turn heads about the eye before solids, not on a neck.")
    ] = False
    trace: Annotated[
        tuple[Path, ...] | None,
        shown("TRACE...", "Recorded heads (tables, pose logs), not the head model."),
    ] = None
    head: Head = None
    techniques: Annotated[
        tuple[str, ...] | None,
        shown(
            "ID...",
            "Techniques; head_movement:FILE.toml has its numbers and curves from a "
            "file, and my_taa.py:MyTAA is your own "
            f"(default: {' '.join(TECHNIQUES)}).",
        ),
    ] = None
    baseline: Annotated[
        str | None,
        shown("ID", "The technique that ratios refer to (default: msaa4, else none)."),
    ] = None
    metrics: Annotated[
        tuple[str, ...] | None,
        shown(
            "ID...",
            f"What is measured, of {', '.join(METRICS)}; ratios are of the first "
            "(default: mtcd detail_loss).",
        ),
    ] = None
    sessions: Annotated[int | None, shown("N", "Viewing sessions (default: 500).")] = (
        None
    )
    tolerance: Annotated[
        float | None,
        shown(
            "X", "Run until every mean and ratio is known within X, e.g. 0.01 (95 %)."
        ),
    ] = None
    budget: Annotated[
        str | None,
        shown(
            "TIME",
            "Run for this long, e.g. 30s, 5m or 1h, and know what is known then; how "
            "many sessions that is depends on the machine.",
        ),
    ] = None
    repeat: Annotated[
        Path | None,
        shown(
            "RESULT.nc", "Run exactly as many sessions as a budget did, by its result."
        ),
    ] = None
    frames: Frames = None
    warmup: Warmup = None
    tiles: Annotated[int | None, shown("N", "Tiles per session (default: 2).")] = None
    tile_size: Annotated[int | None, shown("PX", "Side of a tile (default: 64).")] = (
        None
    )
    crop: Annotated[
        int | None,
        shown("PX", "Measure a central block instead: not a sample of the frame."),
    ] = None
    whole_frame: Annotated[bool, shown("", "Measure every pixel instead.")] = False
    width: Width = None
    height: Height = None
    fov: Fov = None
    refresh: Annotated[
        float | None, shown("HZ", "Refresh rate (default: 60, or the traces' own).")
    ] = None
    oversampling: Annotated[
        int | None,
        shown("N", "Texels per display pixel and axis: 1, 2 or 4 (default: 2)."),
    ] = None
    margin: Annotated[
        float | None,
        shown("DEG", "How far a head may turn from where it started (default: 6)."),
    ] = None
    reference_samples: Annotated[
        int | None,
        shown(
            "N", "Rays per pixel of solids in detail loss's reference (default: 16)."
        ),
    ] = None
    reference_every: Annotated[
        int | None,
        shown("N", "Take it on the first of N measured frames of solids (default: 3)."),
    ] = None
    baked: Annotated[
        bool,
        shown("", "Bake solids, colours alone: for --no-neck, where nothing moves."),
    ] = False
    omit_failed: Annotated[
        bool,
        shown(
            "",
            "Leave out sessions that fail, at most 1 % of them, instead of stopping.",
        ),
    ] = False
    seed: Annotated[
        int | None, shown("N", "Seed of all random draws (default: 0).")
    ] = None
    out: Annotated[
        Path | None,
        shown("DIR", "Folder for everything written (default: hmdjit-study)."),
    ] = None
    workers: Annotated[
        int | None,
        shown("N", "Run batches in N processes of a CPU each (default: in this one)."),
    ] = None
    dask: Annotated[
        str | None,
        shown("ADDRESS", "Run batches on a Dask cluster, by its scheduler's address."),
    ] = None
    overwrite: Annotated[
        bool, shown("", "Replace what another study wrote into that folder.")
    ] = False


@dataclasses.dataclass(frozen=True)
class Options(PoseLog, _StudyOptions):
    """What can be said of a study; None, or False, keeps the default."""

    def said(self) -> dict[str, Any]:
        """Name what differs from the default."""
        values = {f.name: getattr(self, f.name) for f in dataclasses.fields(Options)}
        return {k: v for k, v in values.items() if v is not None and v is not False}


_FIELDS = {
    "width_px": "width",
    "height_px": "height",
    "fov_deg": "fov",
    "refresh_hz": "refresh",
    "margin_deg": "margin",
    "tiles count": "tiles",
    "tiles size_px": "tile_size",
    "crop size_px": "crop",
    "budget, s": "budget",
    "technique": "techniques",
    "head": "model",
}


def as_option(message: str, command: Any) -> str:
    """Name the command's option at the start of a message that names a field."""
    found = re.match(r"(.+?) (?=(must|need|are) )", message)
    if found is None or not dataclasses.is_dataclass(command):
        return message
    options, fields = set(_names(command)), found[1].split(" and ")
    names = [name.replace("-", "_") for name in fields]
    names = [n if n in options else _FIELDS.get(n, n) for n in names]
    is_known = options.issuperset(names)
    return f"{spoken(*names)} {message[found.end() :]}" if is_known else message


def spoken(*names: str) -> str:
    """Options as a user types them."""
    return " and ".join(f"--{name.replace('_', '-')}" for name in names)


def _names(command: Any) -> Iterator[str]:
    hints = typing.get_type_hints(type(command), include_extras=True)
    for field in dataclasses.fields(command):
        value = getattr(command, field.name)
        if dataclasses.is_dataclass(value):
            yield from _names(value)
        elif tyro.conf.Positional not in getattr(hints[field.name], "__metadata__", ()):
            yield field.name
