"""The page of a study: question, answer, tables, figures, the flicker viewer."""

import json
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from ..estimates.summary import POOLED, summarize
from ..figures import drawing
from ..figures.techniques import Compared
from ..reports.study import caption, titled_tables, write_report
from ..reports.tables import WORDS, number, table
from ..studies import identity
from ..studies.definition import StudyDefinition
from . import markup
from .simulated import numbers
from .simulated import sections as simulated

if TYPE_CHECKING:
    import xarray

NAME = "report.html"
UNKNOWN = "no definition is beside the result, as of a study run from Python"
_SHARES = (0.05, 0.25, 0.5, 0.75, 0.95)
_TITLE = 4  # techniques that a title names
_GOAL = "tolerance or budget"  # says how many sessions there are, not what they show
_LONG = ("definition", "ran", "metrics", "title")  # attributes of no use to a reader


def write_page(
    dataset: "xarray.Dataset",
    folder: str | os.PathLike,
    study: StudyDefinition | None = None,
    *,
    scene: str | None = None,
    command: str = "",
    reason: str = UNKNOWN,
) -> list[Path]:
    """Write a study's report, and `report.html` beside it, with figures of its own.

    **Arguments:**

    - `study`: the definition of the result, from which a session is simulated anew;
      without it the page has neither maps nor viewer, and says why: the `reason`.
    - `scene`: which one is shown; by default that of median flicker.
    - `command`: what repeats the study.

    **Returns:** the paths.

    **Errors:** those of `summarize`; `ValueError` for a scene that is not the study's.
    """
    rows, folder = summarize(dataset), Path(folder)
    compared = Compared(dataset, rows)
    scene = _shown_scene(compared, scene)
    if study is not None and (others := _others(dataset, study)):
        study, reason = None, f"other than in the result: {', '.join(others)}"
    best = _best(compared)
    paths = write_report(dataset, folder)

    def keep(name: str, figure: Figure) -> bytes:
        paths.extend(drawing.save_both(figure, folder / f"{name}.png"))
        return (folder / f"{name}.png").read_bytes()

    sections: dict[str, list[str]] = {
        "Question and answer": [
            markup.paragraph(_question(dataset, compared)),
            markup.paragraph(" ".join(_answer(dataset, compared, best)), "answer"),
        ],
        "Techniques and scenes": [
            *(
                markup.table(t, name)
                for name, t in titled_tables(dataset, rows).items()
            ),
            *map(markup.paragraph, caption(dataset, rows)),
        ],
        "Sessions and scenes drawn": [
            markup.figure(one) for one in _figures(compared, folder)
        ],
    }
    if study is not None:
        seed = int(dataset.attrs["seed"])
        pair = compared.baseline, best or compared.techniques[-1]
        try:
            sections |= simulated(study, seed, scene, compared, pair, keep)
        # No fault of a scene or technique of one's own costs a study its report.
        except Exception as error:
            is_plain = isinstance(error, ValueError)
            kind = "" if is_plain else f"{type(error).__name__}: "
            study, reason = None, f"{kind}{error}".rstrip(".")
    if study is None:
        words = "Flicker maps, the viewer, spectra and heads are left out: "
        sections["Displayed frames"] = [markup.paragraph(f"{words}{reason}.")]
    sections["Identity"] = list(_identity(dataset, command))
    named = ", ".join(compared.techniques[:_TITLE])
    more = len(compared.techniques) - _TITLE
    title = f"Flicker of {named}{f' and {more} more' if more > 0 else ''}"
    content = markup.page(title, compared.footer, sections)
    return [*paths, markup.write(folder / NAME, content)]


def _shown_scene(compared: Compared, scene: str | None) -> str:
    """Return the scene of median flicker, unless one is named."""
    if scene is not None and scene not in compared.scenes:
        known = ", ".join(compared.scenes)
        raise ValueError(f"scene must be one of {known}, got {scene!r}.")
    means = [compared.rows[compared.baseline, s].mean for s in compared.scenes]
    return scene or compared.scenes[int(np.argsort(means)[len(means) // 2])]


def _others(dataset: "xarray.Dataset", study: StudyDefinition) -> list[str]:
    """Name what a definition has that the result has not, or otherwise."""
    known = json.loads(dataset.attrs.get("definition", "{}"))
    now = identity.definition(study, int(dataset.attrs.get("seed", 0)), None)
    names = (known.keys() | now.keys()) - {_GOAL}
    return sorted(name for name in names if known.get(name) != now.get(name))


def _best(compared: Compared) -> str | None:
    """Name the technique of the best ratio, of those that show that a head moves."""
    pooled = {t: compared.rows[t, POOLED] for t in compared.others}
    ratios = {t: row.ratio for t, row in pooled.items() if row.mean > 0}
    known = {
        t: ratio
        for t, ratio in ratios.items()
        if t != compared.reference and math.isfinite(ratio)
    }
    sign = -1 if compared.more_is_better else 1
    return min(known, key=lambda t: sign * known[t]) if known else None


def _question(dataset: "xarray.Dataset", compared: Compared) -> str:
    known = dataset.attrs
    scenes = identity.counted(len(compared.scenes), "scene")
    what = "does the picture flicker" if compared.is_flicker else compared.headline
    return (
        f"When people wear a headset ({identity.camera_words(known)}; head: "
        f"{known.get('head', 'unknown')}) and look at {scenes}, how much {what}, which "
        "anti-aliasing technique leaves how much of it, and what does that cost in "
        "detail?"
    )


def _answer(
    dataset: "xarray.Dataset", compared: Compared, best: str | None
) -> Iterator[str]:
    base = compared.rows[compared.baseline, POOLED]
    sessions = identity.counted(base.sessions, "session")
    scenes = identity.counted(len(compared.scenes), "scene")
    yield (
        f"Displayed by {compared.baseline}, {compared.headline} is "
        f"{_bounded(base.mean, base.low, base.high)} {compared.unit}, the mean over "
        f"{scenes} and {sessions}."
    )
    if best is None:
        yield "No other technique has a ratio to it."
        return
    row = compared.rows[best, POOLED]
    ratio = _bounded(row.ratio, row.ratio_low, row.ratio_high)
    most, has = ("most", "has") if compared.more_is_better else ("least", "leaves")
    but = "but the reference"
    if compared.is_flicker:
        but = "that neither freeze the picture nor are the reference"
    told = f"the {most} of those compared {but}"
    if row.ratio_low <= 1 <= row.ratio_high and row.ratio_low < row.ratio_high:
        told += "; the interval holds 1, so no difference is shown"
    yield f"{best} {has} {ratio} of it, {told}."
    loss, before = (r.others.get("detail_loss") for r in (row, base))
    if loss is not None and before is not None:
        yield (
            f"Its detail loss is {_bounded(*_mean(loss))} code values², "
            f"{compared.baseline}'s {_bounded(*_mean(before))}."
        )
    elif compared.is_flicker:
        yield "Detail loss was not measured: read the ratio with care, for a frozen "
        yield "picture has none of either."


def _mean(one: Any) -> tuple[float, float, float]:
    return one.mean, one.low, one.high


def _bounded(value: float, low: float, high: float) -> str:
    """Write a value and its 95 % interval, where it has one."""
    if not low < high:
        return f"{value:.3g}"
    return f"{value:.3g} [{low:.3g}, {high:.3g}]"


def _figures(compared: Compared, folder: Path) -> Iterator[markup.Picture]:
    """Return the study's own figures, with words and numbers."""
    drawn = lambda name: (folder / f"{name}.png").read_bytes()
    headline, base = compared.headline, compared.baseline
    pooled = {t: compared.rows[t, POOLED] for t in compared.techniques}
    listed = lambda form: "; ".join(form(t, row) for t, row in pooled.items())
    ratio = lambda row: _bounded(row.ratio, row.ratio_low, row.ratio_high)
    ratios = listed(lambda t, row: f"{t} {ratio(row)}")
    every = list(dict.fromkeys(scene for _, scene in compared.rows))
    lines = [
        [scene, *(ratio(compared.rows[t, scene]) for t in compared.techniques)]
        for scene in every
    ]
    yield markup.Picture(
        drawn("ratios"),
        f"Points with intervals, a row per scene: {headline} as a share of {base}'s. "
        f"Over all scenes: {ratios}.",
        f"{headline} of each technique as a share of {base}'s, per scene, with 95 % "
        "intervals",
        numbers(["scene", *compared.techniques], lines),
    )
    sessions = compared.mtcd.mean(axis=1)
    quantiles = np.nanquantile(sessions, _SHARES, axis=1).T
    medians = [f"{t} {q[2]:.3g}" for t, q in zip(pooled, quantiles, strict=True)]
    yield markup.Picture(
        drawn("distributions"),
        f"Cumulative distribution over sessions of {headline}, mean over scenes, a "
        f"curve per technique. Medians: {'; '.join(medians)}.",
        f"Distribution of {headline} over sessions",
        numbers(
            ["technique", *(f"{100 * share:g} %" for share in _SHARES)],
            [[t, *map(_short, q)] for t, q in zip(pooled, quantiles, strict=True)],
        ),
    )
    flat = compared.mtcd.reshape(len(compared.techniques), -1)
    spread = [
        [np.nanmax(v), pooled[t].mean, np.nanmin(v)]
        for t, v in zip(pooled, flat, strict=True)
    ]
    yield markup.Picture(
        drawn("figure3"),
        f"Three bars per technique: the largest, mean and smallest {headline} of all "
        f"scenes and sessions. Means: {listed(lambda t, r: f'{t} {r.mean:.3g}')}.",
        f"Largest, mean and smallest {headline} over scenes and sessions",
        numbers(
            ["technique", "max", "mean", "min"],
            [[t, *map(_short, v)] for t, v in zip(pooled, spread, strict=True)],
        ),
    )
    if compared.is_flicker and "detail_loss" in compared.metrics:
        loss = lambda row: row.others["detail_loss"]
        both = [
            [t, _bounded(r.mean, r.low, r.high), _bounded(*_mean(loss(r)))]
            for t, r in pooled.items()
        ]
        points = "; ".join(f"{t}: {mtcd} and {lost}" for t, mtcd, lost in both)
        yield markup.Picture(
            drawn("flicker_detail"),
            f"A point per technique, flicker against detail loss: {points}.",
            "Flicker against lost detail: the best technique is low in both",
            numbers(["technique", "MTCD", "detail loss"], both),
        )


def _short(value: float) -> str:
    return number(value, 3) if abs(value) < 10 else f"{value:.3g}"


def _identity(dataset: "xarray.Dataset", command: str) -> Iterator[str]:
    if command:
        yield markup.paragraph("The same numbers come out of:")
        yield markup.code(command)
    rows = [
        [name.replace("_", " "), str(value)]
        for name, value in dataset.attrs.items()
        if name not in _LONG
    ]
    columns = {"what": WORDS, "value": WORDS}
    yield markup.table(table(columns, rows), "What the numbers rest on")
