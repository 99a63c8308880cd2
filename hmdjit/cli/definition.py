"""From what a user writes (a STUDY.toml, the command line) to a `Study`.

Both have the same keys; the command line overrides the file. Whatever is not said keeps
the default study: eleven scenes, five rows, 500 sessions, people who fixate.
"""

import dataclasses
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .. import _checks, _python_files, _toml, metrics, scenes, techniques
from ..camera import Camera
from ..head_motion import HeadMotion, presets
from ..head_motion.replay import Replay
from ..scenes.solids import Solids
from ..studies.definition import StudyScene
from ..studies.measured_blocks import CentralCrop, Measurement, Tiles, WholeFrame
from ..studies.sequential import Goal
from ..studies.study import Study, check_seed
from ..technique_contract.base import AbstractTechnique
from ..techniques import curve_file
from .options import HEAD as HEAD
from .options import TECHNIQUES, PoseLog, spoken
from .options import Options as Options

Tables = Mapping[str, Mapping[str, Any]]
"""Numbers of techniques by their ids: arguments of their classes."""

_OPTIONS = tuple(field.name for field in dataclasses.fields(Options))
# Options that exclude each other; those in one bracket go together.
_RIVALS = (
    (("tiles", "tile_size"), ("crop",), ("whole_frame",)),
    (("scenes",), ("images", "panorama")),
    (("head",), ("trace",)),
    (("sessions",), ("tolerance",), ("budget",), ("repeat",)),
    (("workers",), ("dask",)),
)


def read_toml(path: Path) -> tuple[Options, Tables]:
    """Read a STUDY.toml: the keys of `Options`, and tables named by techniques' ids.

    Relative paths in it are relative to the file.

    **Errors:** `ValueError` naming the file, and the key with the nearest known one.
    """
    return from_table(_toml.read(path), path)


def from_table(content: Mapping[str, Any], path: Path) -> tuple[Options, Tables]:
    """Read what a STUDY.toml holds, as `read_toml` does, and with its errors."""
    content, folder = dict(content), path.parent
    tables = {id: content.pop(id) for id in techniques.IDS if id in content}
    try:
        _checks.known_keys(content, [*_OPTIONS, *techniques.IDS])
        values = _toml.arguments(Options, content)
        numbers = {
            id: curve_file.parameters(techniques.by_id(id), table)
            for id, table in tables.items()
        }
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    values = placed(values, folder)
    return Options(**values), numbers


def placed(values: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Options whose relative paths are taken from a folder."""
    values = dict(values)
    for name in values.keys() & {"images", "panorama", "trace"}:
        values[name] = tuple(folder / file for file in values[name])
    for name in values.keys() & {"out", "repeat"}:
        values[name] = folder / values[name]
    if "head" in values and is_head_file(values["head"], folder):
        values["head"] = str(folder / values["head"])
    if "scenes" in values:
        placed = lambda name: str(folder / name) if _is_picture(name, folder) else name
        values["scenes"] = tuple(map(placed, values["scenes"]))
    if "techniques" in values:
        values["techniques"] = tuple(_beside(folder, id) for id in values["techniques"])
    return values


def _beside(folder: Path, id: str) -> str:
    """Technique's id, with the file that it names taken from a folder."""
    if _python_files.split(id.partition("+")[0]):
        return str(folder / id)
    family, colon, path = id.partition(":")
    return f"{family}:{folder / path}" if colon else id


def rivals(name: str) -> set[str]:
    """Name an option and all that would replace it."""
    groups = [{one for way in ways for one in way} for ways in _RIVALS]
    return {name}.union(*(group for group in groups if name in group))


def merged(low: Options, high: Options) -> Options:
    """Return `low`, overridden by what `high` says; a rival of that is dropped too."""
    said, kept = high.said(), low.said()
    for rivals in _RIVALS:
        names = {name for way in rivals for name in way}
        if said.keys() & names:
            kept = {name: value for name, value in kept.items() if name not in names}
    if "head" in said:  # how logs are read says nothing of it
        logs = [field.name for field in dataclasses.fields(PoseLog)]
        kept = {name: value for name, value in kept.items() if name not in logs}
    return Options(**kept | said)


def build(
    options: Options,
    tables: Tables | None = None,
    scenes: Mapping[str, StudyScene] | None = None,
) -> Study:
    """Make the study that some options describe.

    **Arguments:** `tables`: numbers of techniques, but for those in files of their own;
    `scenes`: those that the options name, if at hand.

    **Errors:** `ValueError` naming the option or the file, the range and the value.
    """
    said = options.said()
    for rivals in _RIVALS:
        ways = [names[0] for names in rivals if said.keys() & set(names)]
        if len(ways) > 1:
            raise ValueError(f"{spoken(*ways)} exclude each other: name one of them.")
    names = {"sessions", "frames", "warmup", "oversampling", "margin"}
    names |= {"reference_samples", "reference_every"}
    numbers = {key: said[key] for key in names & said.keys()}
    if options.no_neck:
        numbers["neck"] = None
    if options.metrics is not None:
        numbers["metrics"] = tuple(metrics.by_id(id) for id in options.metrics)
    if "margin" in numbers:
        numbers["margin_deg"] = numbers.pop("margin")
    check_seed(options.seed or 0)
    # Numbers are checked before files are read: wrong ones are reported at once.
    for name, low in (("sessions", 1), ("frames", 2), ("warmup", 0)):
        _checks.whole(name, numbers.get(name, low), low)
    units = {"width": "px", "height": "px", "fov": "deg", "refresh": "hz"}
    camera = Camera(
        **{f"{k}_{unit}": said[k] for k, unit in units.items() if k in said}
    )
    measure = _measure(options, camera)
    measure.block_size(camera)
    chosen = _techniques(options, tables or {})
    ids = [technique.id for technique in chosen]
    default = "msaa4" if "msaa4" in ids else "none" if "none" in ids else ids[0]
    return Study(
        scenes=_scenes(options) if scenes is None else scenes,
        techniques=chosen,
        head=_head(options),
        camera=camera,
        measure=measure,
        baseline=options.baseline or default,
        **numbers,
    )


def _measure(options: Options, camera: Camera) -> Measurement:
    if options.whole_frame:
        return WholeFrame()
    if options.crop is not None:
        return CentralCrop(options.crop)
    count = options.tiles or Tiles().count
    if options.tile_size is None:
        return Tiles.fitting(camera, count)
    return Tiles(count, options.tile_size)


def _techniques(options: Options, tables: Tables) -> list[AbstractTechnique]:
    chosen = [techniques.by_id(id) for id in options.techniques or TECHNIQUES]
    for name, numbers in tables.items():
        # What resolves samples is not of the table; what is read from a file has its
        # own numbers.
        places = [i for i, t in enumerate(chosen) if t.id.partition("+")[0] == name]
        if numbers and not places:
            raise ValueError(f"[{name}] is set, but no such technique is in the study.")
        for place in places:
            chosen[place] = dataclasses.replace(chosen[place], **numbers)
    return chosen


def _scenes(options: Options) -> dict[str, StudyScene]:
    files = [
        *((scenes.Photograph.read, path) for path in options.images or ()),
        *((scenes.Panorama.read, path) for path in options.panorama or ()),
    ]
    if not files:
        return _baked(options, named_scenes(options.scenes))
    chosen: dict[str, StudyScene] = {}
    for reader, path in files:
        if path.stem in chosen:
            raise ValueError(f"images must differ in name, got {path.stem} twice.")
        chosen[path.stem] = reader(path)
    return _baked(options, chosen)


def _baked(options: Options, chosen: dict[str, StudyScene]) -> dict[str, StudyScene]:
    """Make pictures of solids, if that is asked for."""
    if not options.baked:
        return chosen
    if not options.no_neck:
        raise ValueError("baked must go with --no-neck: what is baked has no depth.")
    return {
        name: scenes.Baked(solids=scene, name=name)
        if isinstance(scene, Solids)
        else scene
        for name, scene in chosen.items()
    }


def named_scenes(names: Sequence[str] | None = None) -> dict[str, StudyScene]:
    """Scenes by name, of pictures and of solids, or of picture files; else the default.

    **Errors:** `ValueError` for an unknown name, with the nearest, and for two scenes
    of one name.
    """
    if not names:
        return dict(scenes.study_set())
    chosen: dict[str, StudyScene] = {}
    for name in names:
        scene = scenes.by_name(name)
        short = name if name in scenes.NAMES else scene.name
        if short in chosen:
            raise ValueError(f"scenes must differ in name, got {short} twice.")
        chosen[short] = scene
    return chosen


def _is_picture(name: str, folder: Path = Path()) -> bool:
    """Whether a scene is named by a file in a folder; names come first."""
    is_file = bool(Path(name).suffix) or (folder / name).is_file()
    return is_file and name not in scenes.NAMES


def goal(options: Options, study: Study) -> Goal:
    """Read what the study is to run until; by default its number of sessions.

    **Errors:** `ValueError` naming the option and the value.
    """
    budget_s = None if options.budget is None else seconds(options.budget)
    repeat = None if options.repeat is None else ran(options.repeat)
    return study.goal(options.tolerance, budget_s, repeat)


def ran(path: Path) -> dict[str, list[int]]:
    """Read how many sessions and predicted paths of each scene a budget allowed.

    **Errors:** `ValueError` for a file that no study with a budget has written.
    """
    import xarray

    try:
        with xarray.open_dataset(path, engine="h5netcdf") as dataset:
            return json.loads(dataset.attrs["ran"])
    except (OSError, KeyError, ValueError):
        raise ValueError(
            f"repeat must be the result.nc of a study with a budget, got {path}."
        ) from None


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


def is_head_file(head: str | Path, folder: Path = Path()) -> bool:
    """Whether a head is named by a file in a folder; else by the name of a preset."""
    is_file = Path(head).suffix.lower() == ".toml" or (folder / head).is_file()
    return is_file and str(head) not in presets.tables()


def head_model(head: str) -> HeadMotion:
    """Head of a preset's name, or of a file that ends in .toml or exists.

    **Errors:** `ValueError` with the nearest preset, or naming the file and the key.
    """
    return HeadMotion.read(head) if is_head_file(head) else HeadMotion.preset(head)


def _head(options: Options) -> HeadMotion | Replay:
    if not options.trace:
        options.refuse("is of recorded heads: name a --trace.")
        return head_model(options.head or HEAD)
    traces = tuple(options.read_trace(path) for path in options.trace)
    return Replay(traces, rate_hz=options.refresh)
