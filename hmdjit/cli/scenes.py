"""The command line's `hmdjit scenes`: what there is to be seen."""

import dataclasses

import rich.console

from ..scenes.solids import Solids
from ..studies.definition import StudyScene
from ..studies.identity import counted
from . import definition
from .options import OK


@dataclasses.dataclass(frozen=True)
class ScenesCommand:
    """List the scenes that have a name: what each is, and what it gives techniques.

    The first eleven are the default study's. A study takes any of them by `--scenes`.
    """

    def run(self, console: rich.console.Console) -> int:
        """Print a line for each scene."""
        known = definition.every_scene()
        for name, scene in known.items():
            kind, size, moves = _about(scene)
            gives = " ".join(sorted(scene.gives))
            console.out(f"{name:16} {kind:8} {size:26} {moves:6} gives {gives}")
        return OK


def _about(scene: StudyScene) -> tuple[str, str, str]:
    """Kind of a scene, how much is in it, and whether anything moves."""
    if not isinstance(scene, Solids):
        return "picture", "flat, infinitely far", "still"
    objects = counted(len(scene.classes) - 1, "object")
    primitives = counted(sum(len(table.object) for table in scene.tables), "primitive")
    return "solids", f"{objects}, {primitives}", "moves" if scene.moves else "still"
