"""From what a user writes (a STUDY.toml, the command line) to a `Study`.

Both have the same keys; the command line overrides the file. Whatever is not said keeps
the default study: eleven scenes, five rows, 500 sessions, people who fixate.
"""

import dataclasses
import itertools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .. import _checks, _toml, scenes, techniques
from ..camera import Camera
from ..head_motion import HeadMotion, Trace, presets
from ..head_motion.replay import Replay
from ..scenes.base import AbstractScene
from ..studies.measured_blocks import CentralCrop, Tiles, WholeFrame
from ..studies.sequential import Goal
from ..studies.study import Study, check_seed
from ..techniques import HeadMovement, curve_file
from ..techniques.base import AbstractTechnique

TECHNIQUES = ("none", "msaa4", "head_movement", "freeze", "ssaa4")
HEAD = "fixating"  # people told to hold their gaze; the README says why


def _option(metavar: str, text: str, default: Any = None) -> Any:
    return dataclasses.field(
        default=default, metadata={"metavar": metavar, "help": text}
    )


@dataclasses.dataclass(frozen=True)
class Options:
    """What a study can be told; None, or False, keeps the default."""

    images: tuple[Path, ...] | None = _option(
        "PATH...", "Flat pictures (PNG, JPEG) instead of the eleven scenes."
    )
    panorama: tuple[Path, ...] | None = _option(
        "PATH...", "Equirectangular panoramas instead of the eleven scenes."
    )
    scenes: tuple[str, ...] | None = _option(
        "NAME...", "Some of the eleven scenes, by name."
    )
    trace: tuple[Path, ...] | None = _option(
        "CSV...", "Recorded heads (t_s,qw,qx,qy,qz) instead of the head model."
    )
    head: str | None = _option(
        "NAME|TOML",
        f"Head model: {', '.join(presets.tables())}, or a file as `hmdjit head fit` "
        f"writes it (default: {HEAD}).",
    )
    techniques: tuple[str, ...] | None = _option(
        "ID...",
        "Techniques; head_movement:FILE.toml has its numbers and curves from a file "
        f"(default: {' '.join(TECHNIQUES)}).",
    )
    baseline: str | None = _option(
        "ID", "The technique that ratios refer to (default: msaa4, else none)."
    )
    sessions: int | None = _option("N", "Viewing sessions (default: 500).")
    tolerance: float | None = _option(
        "X", "Run until every mean and ratio is known within X, e.g. 0.01 (95 %)."
    )
    budget: str | None = _option(
        "TIME", "Run for this long, e.g. 30s, 5m or 1h, and know what is known then."
    )
    frames: int | None = _option("N", "Measured frames, at least 2 (default: 10).")
    warmup: int | None = _option("N", "Frames before them (default: 12).")
    tiles: int | None = _option("N", "Tiles per session (default: 2).")
    tile_size: int | None = _option("PX", "Side of a tile (default: 64).")
    crop: int | None = _option(
        "PX", "Measure a central block instead: not a sample of the frame."
    )
    whole_frame: bool = _option("", "Measure every pixel instead.", default=False)
    width: int | None = _option("PX", "Width of the frame (default: 1024).")
    height: int | None = _option("PX", "Height of the frame (default: 1024).")
    fov: float | None = _option("DEG", "Horizontal field of view (default: 96).")
    refresh: float | None = _option(
        "HZ", "Refresh rate (default: 60, or the traces' own)."
    )
    oversampling: int | None = _option(
        "N", "Texels per display pixel and axis: 1, 2 or 4 (default: 2)."
    )
    margin: float | None = _option(
        "DEG", "How far a head may turn from where it started (default: 6)."
    )
    omit_failed: bool = _option(
        "",
        "Leave out sessions that fail, at most 1 % of them, instead of stopping.",
        default=False,
    )
    seed: int | None = _option("N", "Seed of all random draws (default: 0).")
    out: Path | None = _option(
        "DIR", "Folder for everything written (default: hmdjit-study)."
    )


# Options that exclude each other; those in one bracket go together.
_RIVALS = (
    (("tiles", "tile_size"), ("crop",), ("whole_frame",)),
    (("scenes",), ("images", "panorama")),
    (("head",), ("trace",)),
    (("sessions",), ("tolerance",), ("budget",)),
)


def read_toml(path: Path) -> tuple[Options, dict[str, Any]]:
    """Read a STUDY.toml: the keys of `Options` and a `[head_movement]` table.

    Relative paths in it are relative to the file. The table becomes arguments of
    `techniques.HeadMovement`.

    **Errors:** `ValueError` naming the file, and the key with the nearest known one.
    """
    content = _toml.read(path)
    table = content.pop("head_movement", {})
    kinds = {field.name: str(field.type) for field in dataclasses.fields(Options)}
    try:
        _checks.known_keys(content, kinds)
        parameters = curve_file.parameters(table)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    values = {
        key: _convert(path, key, kinds[key], value) for key, value in content.items()
    }
    if "head" in values and is_head_file(path.parent / values["head"]):
        values["head"] = str(path.parent / values["head"])
    if "techniques" in values:
        values["techniques"] = tuple(
            _beside(path.parent, id) for id in values["techniques"]
        )
    return Options(**values), parameters


def _beside(folder: Path, id: str) -> str:
    """Technique's id, with the file that it names taken from a folder."""
    family, colon, path = id.partition(":")
    return f"{family}:{folder / path}" if colon else id


def _convert(path: Path, key: str, kind: str, value: Any) -> Any:
    """Bring a TOML value to its option's type."""
    single, is_list = kind.removesuffix(" | None"), "tuple" in kind
    if is_list:
        value = [value] if isinstance(value, str) else value
        is_list_of_strings = isinstance(value, list) and all(
            isinstance(v, str) for v in value
        )
        if not is_list_of_strings or not value:
            raise ValueError(
                f"{path}: {key} must be a list of at least one string, got {value!r}."
            )
        return tuple(path.parent / v if "Path" in kind else v for v in value)
    types = {"int": int, "float": (int, float), "bool": bool, "str": str, "Path": str}
    name = next(name for name in types if name in single.split(".")[-1])
    # In Python a bool is an int, in TOML it is not.
    if not isinstance(value, types[name]) or isinstance(value, bool) != (
        name == "bool"
    ):
        raise ValueError(f"{path}: {key} must be of type {name}, got {value!r}.")
    if name == "Path":
        return path.parent / value
    return float(value) if name == "float" else value


def merged(low: Options, high: Options) -> Options:
    """Return `low`, overridden by what `high` says; a rival of that is dropped too."""
    said = _said(high)
    default = dataclasses.asdict(Options())
    for rivals in _RIVALS:
        names = {name: default[name] for name in itertools.chain(*rivals)}
        if said.keys() & names:
            low = dataclasses.replace(low, **names)
    return dataclasses.replace(low, **said)


def _said(options: Options) -> dict[str, Any]:
    said = dataclasses.asdict(options).items()
    return {k: value for k, value in said if value is not None and value is not False}


def build(options: Options, head_movement: Mapping[str, Any] | None = None) -> Study:
    """Make the study that some options describe.

    **Arguments:** `head_movement`: parameters of `techniques.HeadMovement`, for those
    that are not read from files.

    **Errors:** `ValueError` naming the option or the file, the range and the value.
    """
    names = {"sessions", "frames", "warmup", "oversampling"}
    numbers = {key: value for key, value in _said(options).items() if key in names}
    if options.margin is not None:
        numbers["margin_deg"] = options.margin
    _refuse_rivals(options)
    check_seed(options.seed or 0)
    # Numbers are checked before files are read: wrong ones are told at once.
    for name, low in (("sessions", 1), ("frames", 2), ("warmup", 0)):
        _checks.whole(name, numbers.get(name, low), low)
    camera = _camera(options)
    measure = _measure(options)
    measure.block_size(camera)
    chosen = _techniques(options, dict(head_movement or {}))
    ids = [technique.id for technique in chosen]
    default = "msaa4" if "msaa4" in ids else "none" if "none" in ids else ids[0]
    return Study(
        scenes=_scenes(options),
        techniques=chosen,
        head=_head(options),
        camera=camera,
        measure=measure,
        baseline=options.baseline or default,
        **numbers,
    )


def _refuse_rivals(options: Options) -> None:
    said = _said(options).keys()
    for rivals in _RIVALS:
        ways = [names[0] for names in rivals if said & set(names)]
        if len(ways) > 1:
            raise ValueError(
                f"{' and '.join(ways)} exclude each other: name one of them."
            )


def _camera(options: Options) -> Camera:
    units = {"width": "px", "height": "px", "fov": "deg", "refresh": "hz"}
    said = _said(options)
    return Camera(**{f"{key}_{units[key]}": said[key] for key in units if key in said})


def _measure(options: Options) -> Tiles | WholeFrame | CentralCrop:
    if options.whole_frame:
        return WholeFrame()
    if options.crop is not None:
        return CentralCrop(options.crop)
    said = {"count": options.tiles, "size_px": options.tile_size}
    if options.tolerance is not None or options.budget is not None:
        # A path costs a two-hundredth of a tile: one tile each for more sessions.
        said["count"] = options.tiles or 1
    return Tiles(**{name: value for name, value in said.items() if value is not None})


def _techniques(
    options: Options, head_movement: dict[str, Any]
) -> list[AbstractTechnique]:
    chosen = [techniques.by_id(id) for id in options.techniques or TECHNIQUES]
    if not head_movement:
        return chosen
    if not any(isinstance(t, HeadMovement) and not t.label for t in chosen):
        raise ValueError(
            "[head_movement] is set, but no such technique is in the study."
        )
    try:
        HeadMovement(**head_movement)
    except (TypeError, ValueError) as error:
        raise ValueError(f"[head_movement] does not fit: {error}") from None
    return [
        HeadMovement(**head_movement, resolve=technique.resolve)
        if isinstance(technique, HeadMovement) and not technique.label
        else technique
        for technique in chosen
    ]


def _scenes(options: Options) -> dict[str, AbstractScene]:
    files = [
        (reader, path)
        for reader, paths in (
            (scenes.Photograph.read, options.images),
            (scenes.Panorama.read, options.panorama),
        )
        for path in paths or ()
    ]
    if files:
        chosen = {}
        for reader, path in files:
            if path.stem in chosen:
                raise ValueError(f"images must differ in name, got {path.stem} twice.")
            chosen[path.stem] = reader(path)
        return chosen
    everything = scenes.study_set()
    if options.scenes is None:
        return everything
    for name in options.scenes:
        _checks.one_of("scenes", name, everything)
    return {name: everything[name] for name in options.scenes}


def goal(options: Options, study: Study) -> Goal:
    """Read what the study is to run until; by default its number of sessions.

    **Errors:** `ValueError` naming the option and the value.
    """
    if options.tolerance is None and options.budget is None:
        return Goal()
    budget_s = None if options.budget is None else seconds(options.budget)
    return study.goal(options.tolerance, budget_s)


def seconds(text: str) -> float:
    """Seconds of a time like 90, 30s, 1.5m or 2h.

    **Errors:** `ValueError` for anything else.
    """
    found = re.fullmatch(r"(\d+\.?\d*|\.\d+)\s*(s|m|min|h)?", text.strip())
    if found is None or float(found[1]) == 0:
        raise ValueError(
            f"budget must be a time above 0, like 30s, 5m or 1h, got {text!r}."
        )
    unit = {None: 1, "s": 1, "m": 60, "min": 60, "h": 3600}[found[2]]
    return unit * float(found[1])


def is_head_file(head: str | Path) -> bool:
    """Whether a head is named by a file; else by the name of a preset."""
    return Path(head).suffix.lower() == ".toml" or Path(head).is_file()


def head_model(head: str) -> HeadMotion:
    """Head of a preset's name, or of a file that ends in .toml or exists.

    **Errors:** `ValueError` with the nearest preset, or naming the file and the key.
    """
    return HeadMotion.read(head) if is_head_file(head) else HeadMotion.preset(head)


def _head(options: Options) -> HeadMotion | Replay:
    if not options.trace:
        return head_model(options.head or HEAD)
    traces = tuple(Trace.read(path) for path in options.trace)
    return Replay(traces, rate_hz=options.refresh)
