"""Report of techniques on rendered frames: what is measured, and its table."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Num
from rich.console import Console

from .. import metrics
from ..color import CODE_VALUES
from ..metrics.base import check_metrics
from ..studies.identity import metric_words
from . import tables

Metrics = tuple[metrics.AbstractMetric, ...]
Picture = Num[np.ndarray, "height width 3"]

_HEADERS = {
    "mtcd_ratio": "ratio",
    "mtcd_8_bit": "8-bit MTCD",
    "mtcd_8_bit_ratio": "8-bit ratio",
}
_ABOUT = {
    "mtcd": "MTCD in code values, of what is displayed, unquantised; 8-bit MTCD of the "
    "PNGs that it is rounded to.",
    "detail_loss": "Detail loss: mean squared error to the reference.",
}


def chosen_metrics(ids: Sequence[str] | None, reference: Path | None) -> Metrics:
    """Return what is measured: by default MTCD, and detail loss with a reference.

    **Errors:** `ValueError` for an unknown id, and where a reference is lacking.
    """
    if ids is None:
        return metrics.STANDARD if reference else metrics.STANDARD[:1]
    chosen = tuple(metrics.by_id(id) for id in ids)
    check_metrics(chosen)
    held = [metric.id for metric in chosen if metric.needs_reference]
    if held and reference is None:
        raise ValueError(
            "metrics must have a --reference, what frames are held against, for "
            f"{', '.join(held)}."
        )
    return chosen


class Measured:
    """What is measured of a clip that is displayed, and MTCD of its files."""

    def __init__(self, chosen: Metrics):
        self._clips = {metric.id: metrics.Streamed(metric) for metric in chosen}
        self._files = metrics.Streamed(metrics.MTCD())

    def add(
        self, picture: Picture, rounded: Picture, reference: Picture | None
    ) -> None:
        """Take in the next picture, also as it is rounded for its file."""
        for clip in self._clips.values():
            clip.add(picture, reference if clip.metric.needs_reference else None)
        if "mtcd" in self._clips:
            self._files.add(rounded.astype(np.float32) / CODE_VALUES)

    def values(self, before: "Measured") -> dict[str, float]:
        """Return the metrics, and MTCD's ratios to those of the frames before."""
        found = {}
        for id, clip in self._clips.items():
            found[id] = clip.value
            if id == "mtcd":
                found["mtcd_ratio"] = _ratio(clip, before._clips[id])
                found["mtcd_8_bit"] = self._files.value
                found["mtcd_8_bit_ratio"] = _ratio(self._files, before._files)
        return found

    def caption(self, reference: Path | None) -> str:
        """Say what the numbers are."""
        words = [_ABOUT.get(id, clip.metric.about) for id, clip in self._clips.items()]
        held = [f"The reference is {reference}."] if reference else []
        return " ".join([*words, *held])


def measured_table(
    rows: Mapping[str, Mapping[str, float]], say: tables.Say = str
) -> tables.Continued:
    """Lay out the values of each clip."""
    names = dict.fromkeys(column for row in rows.values() for column in row)
    header = {"technique": tables.WORDS}
    header |= {_HEADERS.get(n) or metric_words(n): tables.READY for n in names}
    lines = [
        [clip, *(tables.number(value, 3) for value in row.values())]
        for clip, row in rows.items()
    ]
    return tables.table(header, lines, say=say)


def print_table(rows: Mapping[str, Mapping[str, float]], console: Console) -> None:
    """Print the values of each clip."""
    console.print(measured_table(rows, tables.spelling(console)))


def _ratio(one: metrics.Streamed, other: metrics.Streamed) -> float:
    return one.value / other.value if other.value else math.nan
