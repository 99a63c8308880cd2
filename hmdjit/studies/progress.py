"""What a study, a fit or a measurement says of how far it is."""

from collections.abc import Callable
from typing import NamedTuple


class Progress(NamedTuple):
    """What is being done, sent before and after whatever takes long.

    - `done`, `total`: of a study, simulated sessions, one for each scene and technique,
      those found on disk included; of a trade-off, cases. A total of 0 is not known.
    - `doing`: in words.
    - `fresh`: those of them simulated in this call.
    - `line`: something to print and keep, as a plan.
    """

    done: int = 0
    total: int = 0
    doing: str = ""
    fresh: int = 0
    line: str = ""


Tell = Callable[[Progress], None]
"""Takes each event, to show it."""
