"""What a study found: one row per technique and scene, and the pooled rows."""

import csv
import dataclasses
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .._files import written_atomically
from .intervals import GEOMETRIC_MEAN as GEOMETRIC_MEAN
from .intervals import NO_PAIR, NO_SESSION
from .intervals import POOLED as POOLED
from .intervals import Interval as Interval
from .intervals import geometric_mean_ratio as geometric_mean_ratio
from .intervals import mean_interval as mean_interval
from .intervals import ratio_interval as ratio_interval

if TYPE_CHECKING:
    import xarray

ONE_SESSION = "one session has no interval"
_NO_QUANTILES = (math.nan, math.nan, math.nan)


@dataclasses.dataclass(frozen=True)
class SummaryRow:
    """One technique in one scene; a line of `summary.csv`, columns in this order.

    MTCD in code values of 8 bits, detail loss in their square. `low` and `high` bound
    the mean, `q05`, `q50` and `q95` are quantiles of the sessions, `ratio` is to the
    baseline. `interval` says how intervals were made, `note` why a number is NaN.
    """

    technique: str
    scene: str
    sessions: int
    mean: float = math.nan
    standard_error: float = math.nan
    low: float = math.nan
    high: float = math.nan
    q05: float = math.nan
    q50: float = math.nan
    q95: float = math.nan
    ratio: float = math.nan
    ratio_low: float = math.nan
    ratio_high: float = math.nan
    detail_loss: float = math.nan
    detail_loss_standard_error: float = math.nan
    interval: str = ""
    note: str = ""


COLUMNS = tuple(field.name for field in dataclasses.fields(SummaryRow))


def summarize(dataset: "xarray.Dataset") -> list[SummaryRow]:
    """Reduce a study to one row per technique and scene, and the pooled rows.

    Scene `all` averages over scenes within each session that succeeded in all of them:
    its ratio is that of the scene-averaged means, Kim's figure. Scene `geometric mean`
    has a ratio only.

    **Arguments:** `dataset`: a study's result, `mtcd` and `detail_loss` over technique,
    scene and session; sessions that failed in a cell are NaN there.

    **Returns:** the rows, technique by technique in the dataset's order.

    **Errors:** `ValueError` if the baseline is not among the techniques, or a scene is
    named like a pooled row.
    """
    techniques = [str(t) for t in dataset["technique"].values]
    scenes = [str(s) for s in dataset["scene"].values]
    baseline = str(dataset.attrs.get("baseline", ""))
    if baseline not in techniques:
        raise ValueError(
            f"baseline must be one of {', '.join(techniques)}, got {baseline!r}."
        )
    for scene in (POOLED, GEOMETRIC_MEAN):
        if scene in scenes:
            raise ValueError(f"scene must not be named {scene!r}: pooled rows are.")
    order = ("technique", "scene", "session")
    mtcd = dataset["mtcd"].transpose(*order).values.astype(float)
    loss = dataset["detail_loss"].transpose(*order).values.astype(float)
    clusters = None
    if "subject" in dataset.coords:
        clusters = dataset["subject"].values.astype(str)
    reference = mtcd[techniques.index(baseline)]
    rows = []
    for technique, x, d in zip(techniques, mtcd, loss, strict=True):
        cells = [
            _row(technique, scene, *cell, clusters=clusters)
            for scene, *cell in zip(scenes, x, reference, d, strict=True)
        ]
        means = (values.mean(axis=0) for values in (x, reference, d))
        pooled = _row(technique, POOLED, *means, clusters=clusters)
        empty = [row.scene for row in cells if row.note in (NO_SESSION, NO_PAIR)]
        if empty:
            note = f"no session of {', '.join(empty)}"
            pooled = dataclasses.replace(pooled, note=note)
        ratio = geometric_mean_ratio(x, reference, clusters)
        having = sum(math.isfinite(row.ratio) for row in cells)
        everywhere = having == len(scenes)
        geometric = SummaryRow(
            technique=technique,
            scene=GEOMETRIC_MEAN,
            sessions=int(np.isfinite(x + reference).any(axis=0).sum()),
            ratio=ratio.value,
            ratio_low=ratio.low,
            ratio_high=ratio.high,
            interval=ratio.method,
            note="" if everywhere else f"over {having} of {len(scenes)} scenes",
        )
        rows += [*cells, pooled, geometric]
    return rows


def _row(
    technique: str,
    scene: str,
    x: np.ndarray,
    baseline: np.ndarray,
    loss: np.ndarray,
    *,
    clusters: np.ndarray | None,
) -> SummaryRow:
    mean, ratio = mean_interval(x, clusters), ratio_interval(x, baseline, clusters)
    detail = mean_interval(loss, clusters)
    finite = x[np.isfinite(x)]
    paired = int(np.isfinite(x + baseline).sum())
    note = ""
    if math.isnan(mean.value) or math.isnan(ratio.value):
        note = mean.method if math.isnan(mean.value) else ratio.method
    elif finite.size == 1:
        note = ONE_SESSION
    elif paired < finite.size:
        note = f"ratio over the {paired} sessions that succeeded in both"
    quantiles = np.quantile(finite, [0.05, 0.5, 0.95]) if finite.size else _NO_QUANTILES
    q05, q50, q95 = (float(quantile) for quantile in quantiles)
    return SummaryRow(
        technique=technique,
        scene=scene,
        sessions=finite.size,
        mean=mean.value,
        standard_error=mean.standard_error,
        low=mean.low,
        high=mean.high,
        q05=q05,
        q50=q50,
        q95=q95,
        ratio=ratio.value,
        ratio_low=ratio.low,
        ratio_high=ratio.high,
        detail_loss=detail.value,
        detail_loss_standard_error=detail.standard_error,
        interval=mean.method,
        note=note,
    )


def write_csv(rows: Sequence[SummaryRow], path: str | os.PathLike) -> Path:
    """Write rows as comma-separated values (RFC 4180), numbers to the last digit.

    **Returns:** the path. The file appears at once and whole.
    """
    with (
        written_atomically(path) as unfinished,
        open(unfinished, "w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        writer.writerows(dataclasses.astuple(row) for row in rows)
    return Path(path)
