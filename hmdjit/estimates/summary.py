"""What a study found: one row per technique and scene, and the pooled rows.

A study had a fixed number of sessions, or ran until a goal. Then its means are helped
by control variates, its scenes have numbers of sessions of their own, and intervals are
normal, as wide as the interim analysis that ended a scene asks for.
"""

import dataclasses
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .. import _checks, _files
from .cells import cells_of
from .decibels import AVERAGED, in_decibels
from .estimate import (
    NO_FLICKER,
    NO_PAIR,
    NO_SESSION,
    NOT_FINITE,
    Estimate,
    NanPolicy,
    combined,
    geometric_mean,
    none,
    pairing_gain,
    ratio,
)
from .intervals import (
    Z95,
    Interval,
    geometric_mean_ratio,
    interval_of,
    normal_interval,
    with_head,
)
from .planning import figure_of_merit, interim_level
from .rows import MeanAndError, SummaryRow

if TYPE_CHECKING:
    import xarray

POOLED = "all"
"""Scene of the rows that average over all scenes."""

GEOMETRIC_MEAN = "geometric mean"
"""Scene of the rows with the geometric mean of the per-scene ratios."""

ONE_SESSION = "one session has no interval"

_OLD_METRICS = ("mtcd", "detail_loss")  # of files that do not say


def summarize(dataset: "xarray.Dataset") -> list[SummaryRow]:
    """Reduce a study to one row per technique and scene, and the pooled rows.

    Scene `all` averages over scenes within each session that succeeded in all of them:
    its ratio is that of the scene-averaged means, Kim's figure. Scene `geometric mean`
    has a ratio only.

    **Arguments:** `dataset`: a study's result, its metrics over technique, scene and
    session; the attribute `metrics` names them, the first one is what ratios are of.
    Sessions that failed in a cell are NaN there. They are left out where the attribute
    `omit_failed` is 1; else they make all NaN that they enter. In a study with a goal
    one that failed for one technique is left out of all, in that scene, and those that
    were not simulated, by `simulated_sessions`, are no failures.

    **Returns:** the rows, technique by technique in the dataset's order.

    **Errors:** `ValueError` if the baseline is not among the techniques, or a scene is
    named like a pooled row.
    """
    table = _Table(dataset)
    return [row for place in range(len(table.techniques)) for row in table.rows(place)]


class _Table:
    """The cells of a study, and how its kind makes rows of them."""

    def __init__(self, dataset: "xarray.Dataset"):
        self.techniques = [str(t) for t in dataset["technique"].values]
        self.scenes = [str(s) for s in dataset["scene"].values]
        baseline = str(dataset.attrs.get("baseline", ""))
        _checks.one_of("baseline", baseline, self.techniques)
        for name in {POOLED, GEOMETRIC_MEAN}.intersection(self.scenes):
            raise ValueError(f"scene must not be named {name!r}: pooled rows are.")
        self.baseline = self.techniques.index(baseline)
        names = np.atleast_1d(dataset.attrs.get("metrics", _OLD_METRICS))
        self.metrics = [str(name) for name in names]
        self.decibels = [
            m for m in self.metrics if AVERAGED.items() <= dataset[m].attrs.items()
        ]
        # Older files do not say; they left few sessions out.
        is_left_out = dataset.attrs.get("omit_failed", 1)
        self.nan_policy: NanPolicy = "omit" if is_left_out else "propagate"
        self.cells = cells_of(dataset, self.metrics)
        self.head_clusters, self.head_words = 0, ""
        if "head_fit_error" in dataset.attrs:
            self.head_words = ", given the head"
            if math.isfinite(dataset.attrs["head_fit_error"]):
                self.head_clusters = int(dataset.attrs["head_fit_clusters"])
                self.head_words = f", head of {dataset.attrs['head_fit_over']}"
        # Of a study with a goal: the half-widths of its scenes' intervals.
        self.z, self.seconds = None, np.full(len(self.scenes), math.nan)
        if "control_slope" in dataset:
            analyses = dataset["interim_analyses"].values
            levels = [interim_level(int(count)) for count in analyses]
            self.z = np.array(levels)
            if not {"budget_s", "ran"}.isdisjoint(dataset.attrs):
                self.z[:] = Z95
            self.seconds = dataset["seconds"].values.astype(float)
            if is_left_out:
                for cell in self.cells:
                    cell.measured[..., cell.has_failed()] = math.nan

    def rows(self, technique: int) -> list[SummaryRow]:
        """Rows of a technique: its scenes, and those pooled."""
        rows = [self._row(technique, scene, [s]) for s, scene in enumerate(self.scenes)]
        pooled = self._row(technique, POOLED, range(len(self.scenes)))
        empty = [row.scene for row in rows if row.note in (NO_SESSION, NO_PAIR)]
        if empty:
            note = f"no session of {', '.join(empty)}"
            pooled = dataclasses.replace(pooled, note=note)
        return [*rows, pooled, self._geometric_mean(technique, rows)]

    def _means(
        self, techniques: Sequence[int], scenes: Sequence[int], metric: int = 0
    ) -> list[Estimate]:
        """Means of techniques over some scenes, paired.

        With a fixed number of sessions they are over those that succeeded for all of
        the techniques in all of the scenes.
        """
        cells, left_out = [self.cells[s] for s in scenes], None
        if self.z is None:
            values = np.stack([cell.measured[metric, techniques] for cell in cells])
            left_out = ~np.isfinite(values).all(axis=(0, 1))
        share = [1 / len(cells)] * len(cells)
        how = {"metric": metric, "left_out": left_out}
        every = lambda technique: [
            c.estimate(technique, self.nan_policy, **how) for c in cells
        ]
        return [combined(share, every(technique)) for technique in techniques]

    def _interval(self, estimate: Estimate, scenes: Sequence[int]) -> Interval:
        if self.z is None:
            return self._with_head(interval_of(estimate, "normal"), estimate)
        z = float(self.z[scenes].max())
        found = normal_interval(estimate, z, f"normal, {z:.2f} standard errors")
        return self._with_head(found, estimate)

    def _with_head(self, found: Interval, estimate: Estimate) -> Interval:
        """Add the error of the head's fit, or say that there is none."""
        if math.isnan(found.low):
            return found
        if self.head_clusters:
            found = with_head(found, estimate, self.head_clusters)
        return dataclasses.replace(found, method=found.method + self.head_words)

    def _row(self, technique: int, scene: str, scenes: Sequence[int]) -> SummaryRow:
        """Row of a technique over some scenes."""
        (mean,), (base,) = (
            self._means([r], scenes) for r in (technique, self.baseline)
        )
        against = ratio(*self._means([technique, self.baseline], scenes))
        others = {
            name: self._means([technique], scenes, metric)[0]
            for metric, name in enumerate(self.metrics[1:], start=1)
        }
        reasons = [mean.reason, against.reason]
        reasons += [f"{name} {x.reason}" for name, x in others.items() if x.reason]
        note = next(filter(None, reasons), "")
        if not note and mean.count == 1:
            note = ONE_SESSION
        elif not note and self.z is None and against.count < mean.count:
            note = f"ratio over the {against.count} sessions that succeeded in both"
        found = self._interval(mean, scenes)
        bounds = self._interval(against, scenes)
        q05, q50, q95 = self._quantiles(technique, scene, scenes, mean)
        seconds = float(self.seconds[scenes].sum())
        has_clusters = self.cells[0].clusters is not None
        return SummaryRow(
            technique=self.techniques[technique],
            scene=scene,
            sessions=mean.count,
            mean=found.value,
            standard_error=found.standard_error,
            low=found.low,
            high=found.high,
            q05=q05,
            q50=q50,
            q95=q95,
            ratio=bounds.value,
            ratio_low=bounds.low,
            ratio_high=bounds.high,
            others={name: self._other(name, x) for name, x in others.items()},
            interval=found.method,
            note=note,
            seconds=seconds,
            figure_of_merit=figure_of_merit(mean, seconds),
            pairing_gain=math.nan if has_clusters else pairing_gain(mean, base),
        )

    def _other(self, name: str, estimate: Estimate) -> MeanAndError:
        """Mean of a metric that is not the headline, and its bounds."""
        found = self._with_head(interval_of(estimate), estimate)
        if name in self.decibels:
            found = in_decibels(found)
        return MeanAndError(found.value, found.standard_error, found.low, found.high)

    def _quantiles(
        self, technique: int, scene: str, scenes: Sequence[int], mean: Estimate
    ) -> Sequence[float]:
        """Quantiles of sessions, without the spread between a frame's tiles.

        How much of the variance is the sessions' own is known of a scene; by its root
        quantiles are drawn towards the mean. NaN where nothing predicts it: then only a
        technique without any flicker has quantiles. Scenes pooled have none where each
        has sessions of its own.
        """
        values = np.mean([self.cells[s].measured[0, technique] for s in scenes], axis=0)
        values = values[np.isfinite(values)]
        between_session_share = self.cells[scenes[0]].between_session_share[technique]
        is_apart = self.z is not None and scene == POOLED
        is_unknown = math.isnan(between_session_share) and values.any()
        if mean.reason or is_apart or is_unknown:
            return [math.nan] * 3
        share = (
            0.0
            if math.isnan(between_session_share)
            else math.sqrt(between_session_share)
        )
        quantiles = np.quantile(values, [0.05, 0.5, 0.95])
        return ((1 - share) * values.mean() + share * quantiles).tolist()

    def _geometric_mean(self, technique: int, rows: Sequence[SummaryRow]) -> SummaryRow:
        """Row of the geometric mean of a technique's ratios in its scenes."""
        every = range(len(rows))
        ratios = [ratio(*self._means([technique, self.baseline], [s])) for s in every]
        # Helped by a control variate, an estimate may fall to 0 and below.
        ratios = [r for r in ratios if r.reason != NO_FLICKER and not r.value <= 0]
        mean = geometric_mean(ratios) if ratios else none(NO_FLICKER)
        if self.z is not None:
            known, count = len(ratios), min(row.sessions for row in rows)
            found = self._interval(mean, every)
        else:
            mtcd = np.stack([cell.measured[0] for cell in self.cells], axis=1)
            x, y = mtcd[technique], mtcd[self.baseline]
            clusters, policy = self.cells[0].clusters, self.nan_policy
            found = geometric_mean_ratio(x, y, clusters, nan_policy=policy)
            # Of a scene without any flicker it is exactly 0, whatever the head.
            found = self._with_head(found, mean if found.value else none(NO_FLICKER))
            known = sum(math.isfinite(row.ratio) for row in rows)
            count = int(np.isfinite(x + y).any(axis=0).sum())
        note = "" if known == len(rows) else f"over {known} of {len(rows)} scenes"
        if self.z is not None and not known:
            note = "no scene has a positive ratio"
        elif found.method.startswith(NOT_FINITE):
            note = found.method
        return SummaryRow(
            technique=self.techniques[technique],
            scene=GEOMETRIC_MEAN,
            sessions=count,
            ratio=found.value,
            ratio_low=found.low,
            ratio_high=found.high,
            others={name: MeanAndError() for name in self.metrics[1:]},
            interval=found.method,
            note=note,
        )


def write_csv(rows: Sequence[SummaryRow], path: str | os.PathLike) -> Path:
    """Write rows as CSV, whole or not at all."""
    return _files.write_csv(path, [row.columns() for row in rows])
