"""A module imports only from the lines above its own: the order is written here."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

import hmdjit

PACKAGE = Path(hmdjit.__file__).parent

# Modules and folders, from the ground up; those on one line do not know each other.
# A line may name what is not written yet.
LINES = [
    ("_types", "_checks", "_files", "_version"),
    ("_toml", "_python_files"),
    ("quaternion",),
    ("camera",),
    ("camera_bounds",),
    ("color", "curves", "sample_patterns"),
    ("estimates",),
    ("head_motion",),
    ("head_fitting",),
    ("frames",),
    ("reprojection", "blending", "filters"),
    ("scenes",),
    ("rendering",),
    ("metrics",),
    ("technique_contract",),
    ("techniques",),
    ("simulation",),
    ("theory",),
    ("studies",),
    ("trade_off", "sensitivity"),
    ("curve_fitting",),
    ("envelope",),
    ("reproductions", "sweep"),
    ("hmdjit",),  # the names that `import hmdjit` offers
    ("figures",),
    ("reports",),
    ("pages",),
    ("cli",),
    ("__main__",),
]

# In a folder, members import the members of earlier steps; `*` is every other name.
FOLDERS = {
    "head_motion": [
        ("discretisation", "parameters", "trace_clock", "trace_columns"),
        ("components", "presets", "trace_notes", "trace_table"),
        ("trace_log",),
        ("trace_formats",),
        ("trace",),
        ("sampling", "laws"),
        ("process", "replay"),
    ],
    "head_fitting": [
        ("spectra",),
        ("statistics", "whittle"),
        ("moments", "scoring"),
        ("errors",),
        ("fitting",),
    ],
    "frames": [
        ("motion", "displacement", "resampling"),
        ("neck", "frame", "velocity"),
        ("sources",),
        ("texture",),
    ],
    "scenes": [
        ("base",),
        ("baking", "stored"),
        ("surfaces", "*"),
        ("primitives",),
        ("shapes", "ray_casting"),
        ("props", "solid_channels"),
        ("solids",),
        ("solid_set",),
        ("registry",),
    ],
    "filters": [
        ("neighborhood", "scattering"),
        ("edges",),
        ("*",),
        ("aliasing",),
    ],  # of what lies around a pixel
    "metrics": [("base",), ("pictures",), ("*",), ("observers", "registry")],
    "technique_contract": [
        ("small_motion",),
        ("base",),
        ("shapes", "stencil", "display_stages"),
        ("check",),
    ],
    "techniques": [("*",), ("curve_file",), ("registry",)],
    "simulation": [
        ("blocks", "sharding", "rendered", "pose_fit"),
        ("halo", "views", "apply"),
        ("session",),
        ("simulate",),
    ],
    "theory": [("picture_statistics",), ("prediction",), ("control_variates",)],
    "estimates": [
        ("columns", "rows"),
        ("estimate",),
        ("resampling", "planning"),
        ("intervals",),
        ("decibels",),
        ("cells",),
        ("summary",),
    ],
    "studies": [
        ("measured_blocks", "failures", "progress", "store"),
        ("sessions",),
        ("definition", "runner"),
        ("identity", "dataset", "sampler", "stage"),
        ("sequential", "executors"),
        ("run",),
        ("study",),
    ],
    "trade_off": [
        ("settings", "cost"),
        ("bench", "knobs"),
        ("trade_off",),
        ("measurement", "choice"),
    ],
    "sensitivity": [("derivatives",), ("sensitivity",)],
    "curve_fitting": [
        ("space", "search"),
        ("errors", "viewing"),
        ("problem", "results"),
        ("front", "recovery"),
        ("fitting",),
    ],
    "envelope": [
        ("engine",),
        ("exact_geometry",),
        ("arguments",),
        ("geometry", "curves", "heads", "estimates"),
        ("pictures",),
        ("table",),
    ],
    "reproductions": [
        ("claims", "eye", "two_colored", "kept", "played", "timing"),
        ("color_space_claims", "kim_map", "sobel_claims", "tidoaa_claims"),
        ("kim_claims",),
        ("*",),
    ],
    "sweep": [("dataset",), ("sweep",)],
    "figures": [("drawing",), ("techniques",), ("*",), ("study",)],
    "reports": [("tables",), ("*",)],
    "pages": [("displayed", "markup"), ("simulated",), ("*",)],
    "cli": [
        ("options", "progress"),
        ("definition", "frame_files"),
        ("frame_poses", "frame_channels", "kept"),
        ("*",),
        ("main",),
    ],
}

FORBIDDEN_NAMES = {"utils", "util", "helpers", "misc", "common", "core", "manager"}
STUDY_EXTRA = {"matplotlib", "xarray", "skimage", "tyro", "PIL", "rich", "h5netcdf"}


def module_name(path):
    """Dotted name inside the package; `hmdjit` is the package's own `__init__`."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    parts = parts[:-1] if parts[-1] == "__init__" else parts
    return ".".join(parts) or "hmdjit"


PATHS = {module_name(path): path for path in PACKAGE.rglob("*.py")}
TREES = {name: ast.parse(path.read_text("utf-8")) for name, path in PATHS.items()}


def imported_modules(name, tree, known):
    """Modules of the package that a module imports, also inside functions."""
    is_package = name == "hmdjit" or name in FOLDERS
    here = [] if name == "hmdjit" else name.split(".")
    package = here if is_package else here[:-1]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            targets = [alias.name.split(".") for alias in node.names]
            targets = [parts[1:] for parts in targets if parts[0] == "hmdjit"]
        elif isinstance(node, ast.ImportFrom):
            base = node.module.split(".") if node.module else []
            if node.level:
                base = package[: len(package) - node.level + 1] + base
            elif base[0] == "hmdjit":
                base = base[1:]
            else:
                continue
            members = [[*base, alias.name] for alias in node.names]
            targets = [m if ".".join(m) in known else base for m in members]
        else:
            continue
        yield from (".".join(parts) or "hmdjit" for parts in targets)


def line_of(name):
    top = name.split(".")[0]
    for number, line in enumerate(LINES):
        if top in line:
            return number
    raise LookupError(f"{name} has no line: add it to LINES where its imports allow.")


def step_of(name):
    """Step of a module in its folder; the folder's own `__init__` comes last."""
    folder, _, member = name.partition(".")
    steps = FOLDERS[folder]
    if not member:
        return len(steps)
    for number, step in enumerate(steps):
        if member in step:
            return number
    for number, step in enumerate(steps):
        if "*" in step:
            return number
    raise LookupError(f"{name} has no step: add it to FOLDERS where its imports allow.")


def points_back(importer, imported):
    if importer.split(".")[0] == imported.split(".")[0]:
        return step_of(imported) < step_of(importer)
    return line_of(imported) < line_of(importer)


def wrong_imports(trees):
    pairs = {
        (name, imported)
        for name, tree in trees.items()
        for imported in imported_modules(name, tree, trees)
    }
    return {pair for pair in pairs if not points_back(*pair)}


def test_imports_point_backwards():
    wrong = wrong_imports(TREES)
    assert not wrong, f"(importer, imported): {sorted(wrong)}"


@pytest.mark.parametrize(
    ("importer", "line", "is_wrong"),
    [
        ("frames.frame", "from .. import camera as pinhole, quaternion", False),
        ("camera", "from .frames.frame import Frame", True),
        ("camera", "import hmdjit.frames", True),
        ("camera", "from hmdjit import frames", True),
        ("camera", "def late():\n    from . import frames", True),
        ("camera", "from . import __version__", True),
        ("techniques.spatial", "from ..technique_contract import base", False),
        ("techniques.spatial", "from . import freeze", True),
        ("techniques.spatial", "from .freeze import Freeze", True),
        ("techniques.spatial", "from ..techniques import Freeze", True),
        ("techniques.spatial", "from ..simulation import simulate", True),
        ("techniques", "from .spatial import SSAA", False),
        ("scenes.registry", "from . import patterns", False),
        ("scenes.patterns", "from . import registry", True),
        ("reports.study", "from ..estimates.summary import Interval", False),
        ("estimates.summary", "from ..reports.study import page", True),
        ("hmdjit", "from .studies.study import Study", False),
        ("hmdjit", "from .cli.main import run", True),
        ("cli", "import hmdjit", False),
    ],
)
def test_the_check_itself(importer, line, is_wrong):
    names = [
        "quaternion",
        "camera",
        "frames",
        "frames.frame",
        "technique_contract.base",
        "techniques.freeze",
    ]
    names += ["scenes.patterns", "scenes.registry"]
    trees = {name: ast.parse("") for name in names} | {importer: ast.parse(line)}
    assert bool(wrong_imports(trees)) == is_wrong


def test_annotations_are_not_postponed():
    # Postponed, they are strings, and shapes are no longer checked.
    def is_postponed(tree):
        lines = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
        return any(line.module == "__future__" for line in lines)

    assert not [name for name, tree in TREES.items() if is_postponed(tree)]


def test_no_module_is_named_after_nothing():
    words = {part for name in TREES for part in name.split(".")}
    assert not words & FORBIDDEN_NAMES


def test_folders_are_one_deep():
    assert all(name.count(".") <= 1 for name in TREES)


def test_importing_the_package_is_quick_and_needs_the_core_only():
    program = (
        "import json, sys, time\n"
        "import hmdjit\n"
        "loaded = sorted({name.split('.')[0] for name in sys.modules})\n"
        "print(json.dumps([time.process_time(), loaded]))\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", program],
        cwd=PACKAGE.parent,
        capture_output=True,
        text=True,
        check=True,
    )
    seconds, loaded = json.loads(run.stdout)
    assert not STUDY_EXTRA & set(loaded)
    # Processor time, with start-up; a loose bound: it notices a heavy import, no more.
    assert seconds < 5
