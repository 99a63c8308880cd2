"""What a study says of how far it is."""

from typing import NamedTuple


class Progress(NamedTuple):
    """What a study is doing, told before and after each batch.

    - `done`, `total`: session-scene-technique runs, those found on disk included.
    - `doing`: in words.
    - `fresh`: runs computed in this call, not found on disk.
    - `line`: something to print and keep, as a plan.
    """

    done: int
    total: int
    doing: str
    fresh: int
    line: str = ""
