"""What a study, a fit or a measurement says of how far it is."""

from collections.abc import Callable
from typing import NamedTuple


class Progress(NamedTuple):
    """What is being done, sent before and after whatever takes long.

    - `done`, `total`: of `unit`, those on disk included. A total of 0 is not known.
    - `doing`: in words.
    - `fresh`: those of them simulated in this call.
    - `line`: something to print and keep, as a plan.
    - `unit`: of a study, a simulation is one session of one scene and technique.
    """

    done: int = 0
    total: int = 0
    doing: str = ""
    fresh: int = 0
    line: str = ""
    unit: str = "sessions"


Tell = Callable[[Progress], None]
"""Takes each event, to show it."""
