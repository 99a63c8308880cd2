"""What a study found: one row per technique and scene, and the pooled rows."""

import dataclasses
import functools
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .. import _files
from ..studies.sampler import Cell
from .estimate import (
    Estimate,
    combined,
    figure_of_merit,
    geometric_mean,
    level_of_look,
    mean_of,
    no_ratio,
    pairing_gain,
    ratio,
)
from .intervals import GEOMETRIC_MEAN as GEOMETRIC_MEAN
from .intervals import NO_FLICKER, NO_PAIR, NO_SESSION, NOT_FINITE, Z95, NanPolicy
from .intervals import POOLED as POOLED
from .intervals import Interval as Interval
from .intervals import geometric_mean_ratio as geometric_mean_ratio
from .intervals import mean_interval as mean_interval
from .intervals import ratio_interval as ratio_interval

if TYPE_CHECKING:
    import xarray

ONE_SESSION = "one session has no interval"
SOME_NOT_FINITE = f"{NOT_FINITE} some sessions"
_NO_QUANTILES = (math.nan, math.nan, math.nan)


@dataclasses.dataclass(frozen=True)
class SummaryRow:
    """One technique in one scene; a line of `summary.csv`, columns in this order.

    MTCD in code values of 8 bits, detail loss in their square. `low` and `high` bound
    the mean, `q05`, `q50` and `q95` are quantiles of the sessions, `ratio` is to the
    baseline. `interval` says how intervals were made, `note` why a number is NaN. Of a
    study with a goal: `seconds` spent on the scene in this run, and
    `1 / (relative error^2 x seconds)`. `pairing_gain` is by how much sharing heads and
    tiles with the baseline divides the ratio's variance.
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
    seconds: float = math.nan
    figure_of_merit: float = math.nan
    pairing_gain: float = math.nan


def summarize(dataset: "xarray.Dataset") -> list[SummaryRow]:
    """Reduce a study to one row per technique and scene, and the pooled rows.

    Scene `all` averages over scenes within each session that succeeded in all of them:
    its ratio is that of the scene-averaged means, Kim's figure. Scene `geometric mean`
    has a ratio only.

    **Arguments:** `dataset`: a study's result, `mtcd` and `detail_loss` over technique,
    scene and session; sessions that failed in a cell are NaN there. They are left out
    where the attribute `omit_failed` is 1, as the study was told; else they make all
    NaN that they enter. In a study with a goal one that failed for one technique
    is left out of all, in that scene, and those that were not run, by `count`, are no
    failures.

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
    # Older files do not say; they left few sessions out.
    nan_policy: NanPolicy = (
        "omit" if dataset.attrs.get("omit_failed", 1) else "propagate"
    )
    clusters = None
    if "subject" in dataset.coords:
        clusters = dataset["subject"].values.astype(str)
    if "slope" in dataset:
        if nan_policy == "omit":
            mtcd, loss = _without_failed(dataset, mtcd, loss)
        return _until_rows(dataset, techniques, scenes, mtcd, loss, nan_policy)
    row_of = functools.partial(_row, clusters=clusters, nan_policy=nan_policy)
    reference = mtcd[techniques.index(baseline)]
    rows = []
    for technique, x, d in zip(techniques, mtcd, loss, strict=True):
        cells = [
            row_of(technique, scene, *cell)
            for scene, *cell in zip(scenes, x, reference, d, strict=True)
        ]
        means = (values.mean(axis=0) for values in (x, reference, d))
        pooled = row_of(technique, POOLED, *means)
        empty = [row.scene for row in cells if row.note in (NO_SESSION, NO_PAIR)]
        if empty:
            note = f"no session of {', '.join(empty)}"
            pooled = dataclasses.replace(pooled, note=note)
        ratio = geometric_mean_ratio(x, reference, clusters, nan_policy=nan_policy)
        having = sum(math.isfinite(row.ratio) for row in cells)
        note = "" if having == len(scenes) else f"over {having} of {len(scenes)} scenes"
        geometric = SummaryRow(
            technique=technique,
            scene=GEOMETRIC_MEAN,
            sessions=int(np.isfinite(x + reference).any(axis=0).sum()),
            ratio=ratio.value,
            ratio_low=ratio.low,
            ratio_high=ratio.high,
            interval=ratio.method,
            note=ratio.method if ratio.method.startswith(NOT_FINITE) else note,
        )
        rows += [*cells, pooled, geometric]
    return rows


def _without_failed(
    dataset: "xarray.Dataset", mtcd: np.ndarray, loss: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Take out of each scene the sessions that failed for some technique."""
    count = dataset["count"].transpose("technique", "scene").values
    was_run = np.arange(mtcd.shape[-1]) < count[..., None]
    failed = np.any(was_run & ~np.isfinite(mtcd + loss), axis=0)
    return np.where(failed, np.nan, mtcd), np.where(failed, np.nan, loss)


def _until_rows(
    dataset: "xarray.Dataset",
    techniques: list[str],
    scenes: list[str],
    mtcd: np.ndarray,
    loss: np.ndarray,
    nan_policy: NanPolicy,
) -> list[SummaryRow]:
    """Rows of a study that ran until its goal: estimates with control variates."""
    base = techniques.index(str(dataset.attrs["baseline"]))
    order = ("technique", "scene", ...)
    predicted = dataset["predicted"].transpose(*order).values.astype(float)
    paths = dataset["predicted_elsewhere"].transpose(*order).values.astype(float)
    slope = dataset["slope"].transpose("technique", "scene").values.astype(float)
    own_share = dataset["own_share"].transpose("technique", "scene").values
    count = dataset["count"].transpose("technique", "scene").values
    looks = [int(look) for look in dataset["look"].values]
    seconds = dataset["seconds"].values.astype(float)
    is_timed = "budget_s" in dataset.attrs
    z = [Z95 if is_timed else level_of_look(look) for look in looks]
    columns = (mtcd, loss, predicted, paths, slope, own_share, count)
    cells = [Cell(*(column[:, s] for column in columns)) for s in range(len(scenes))]
    estimates = [
        [cell.estimate(t, nan_policy) for cell in cells] for t in range(len(techniques))
    ]
    rows = []
    for t, technique in enumerate(techniques):
        losses = [loss[t, s, : count[t, s]] for s in range(len(scenes))]
        for s, scene in enumerate(scenes):
            done = mtcd[t, s][np.isfinite(mtcd[t, s])]
            low, median, high = _quantiles(done, own_share[t, s])
            if math.isnan(estimates[t][s].value):
                low, median, high = _NO_QUANTILES
            row = _until_row(
                technique, scene, estimates[t][s], estimates[base][s], z[s]
            )
            detail = mean_interval(losses[s], nan_policy=nan_policy)
            rows.append(
                dataclasses.replace(
                    row,
                    sessions=done.size,
                    q05=low,
                    q50=median,
                    q95=high,
                    detail_loss=detail.value,
                    detail_loss_standard_error=detail.standard_error,
                    seconds=float(seconds[s]),
                    figure_of_merit=figure_of_merit(estimates[t][s], float(seconds[s])),
                    pairing_gain=pairing_gain(estimates[t][s], estimates[base][s]),
                    note=row.note or _note_of_loss(detail.value),
                )
            )
        share = [1 / len(scenes)] * len(scenes)
        pooled, pooled_base = (combined(share, estimates[p]) for p in (t, base))
        row = _until_row(technique, POOLED, pooled, pooled_base, max(z))
        detail = combined(share, [mean_of(x, nan_policy=nan_policy) for x in losses])
        rows.append(
            dataclasses.replace(
                row,
                sessions=min(row.sessions for row in rows[-len(scenes) :]),
                detail_loss=detail.value,
                detail_loss_standard_error=detail.standard_error,
                seconds=float(seconds.sum()),
                pairing_gain=pairing_gain(pooled, pooled_base),
                figure_of_merit=figure_of_merit(pooled, float(seconds.sum())),
                note=row.note or _note_of_loss(detail.value),
            )
        )
        ratios = [
            ratio(x, y) for x, y in zip(estimates[t], estimates[base], strict=True)
        ]
        having = [r for r in ratios if r is not None and not r.value <= 0]
        if having:
            every = geometric_mean(having)
            found = every.interval(max(z), rows[-1].interval)
            everywhere = len(having) == len(scenes)
            note = "" if everywhere else f"over {len(having)} of {len(scenes)} scenes"
            note = SOME_NOT_FINITE if math.isnan(found.value) else note
        else:
            found, note = no_ratio(), "no scene has a positive ratio"
        rows.append(
            SummaryRow(
                technique=technique,
                scene=GEOMETRIC_MEAN,
                sessions=rows[-1].sessions,
                ratio=found.value,
                ratio_low=found.low,
                ratio_high=found.high,
                interval=found.method,
                note=note,
            )
        )
    return rows


def _note_of_loss(value: float) -> str:
    return f"detail loss {SOME_NOT_FINITE}" if math.isnan(value) else ""


def _until_row(
    technique: str, scene: str, mean: Estimate, baseline: Estimate, z: float
) -> SummaryRow:
    method = f"normal, {z:.2f} standard errors"
    found = mean.interval(z, method)
    paired = ratio(mean, baseline)
    against = no_ratio() if paired is None else paired.interval(z, method)
    note = NO_FLICKER if paired is None else ""
    if math.isnan(mean.value + baseline.value):
        note = SOME_NOT_FINITE
    return SummaryRow(
        technique=technique,
        scene=scene,
        sessions=0,
        mean=found.value,
        standard_error=found.standard_error,
        low=found.low,
        high=found.high,
        ratio=against.value,
        ratio_low=against.low,
        ratio_high=against.high,
        interval=method,
        note=note,
    )


def _quantiles(simulated: np.ndarray, own_share: float) -> tuple[float, ...]:
    """Quantiles of sessions, without the spread between a frame's tiles.

    **Arguments:** `own_share`: how much of the variance is the sessions' own; by its
    root quantiles are drawn towards the mean. NaN where nothing predicts it: then only
    a technique without any flicker has quantiles.
    """
    if simulated.size == 0 or (math.isnan(own_share) and simulated.any()):
        return _NO_QUANTILES
    mean = float(simulated.mean())
    share = 0.0 if math.isnan(own_share) else math.sqrt(own_share)
    found = np.quantile(simulated, [0.05, 0.5, 0.95])
    return tuple(max(mean + share * (float(q) - mean), 0.0) for q in found)


def _row(
    technique: str,
    scene: str,
    x: np.ndarray,
    baseline: np.ndarray,
    loss: np.ndarray,
    *,
    clusters: np.ndarray | None,
    nan_policy: NanPolicy,
) -> SummaryRow:
    mean = mean_interval(x, clusters, nan_policy=nan_policy)
    ratio = ratio_interval(x, baseline, clusters, nan_policy=nan_policy)
    detail = mean_interval(loss, clusters, nan_policy=nan_policy)
    both = (mean_of(values, nan_policy=nan_policy) for values in (x, baseline))
    gain = pairing_gain(*both)
    finite = x[np.isfinite(x)]
    paired = int(np.isfinite(x + baseline).sum())
    missing = [
        found.method for found in (mean, ratio, detail) if math.isnan(found.value)
    ]
    note = missing[0] if missing else ""
    if not missing and finite.size == 1:
        note = ONE_SESSION
    elif not missing and paired < finite.size:
        note = f"ratio over the {paired} sessions that succeeded in both"
    quantiles = _NO_QUANTILES
    if math.isfinite(mean.value):
        quantiles = np.quantile(finite, [0.05, 0.5, 0.95])
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
        pairing_gain=math.nan if clusters is not None else gain,
    )


def write_csv(rows: Sequence[SummaryRow], path: str | os.PathLike) -> Path:
    """Write rows as comma-separated values (RFC 4180), numbers to the last digit.

    **Returns:** the path. The file appears at once and whole.
    """
    return _files.write_csv(path, rows)
