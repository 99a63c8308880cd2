"""How recorded heads, the models fitted to them and the presets move and flicker.

Each preset is simulated at 60 Hz. Each set of recordings is replayed at its own rate,
beside the model that is fitted to it, drawn at the same frames: lost ones too, which
replays fill. Models fitted to half of a set's people are held against the other half. A
set's name is that in `SETS`, of the first part of its files' names, or that part.
Writes `heads.md` and a picture.

    python examples/heads.py --traces FOLDER --scenes coffee grass text noise
"""

import re
from collections.abc import Sequence
from pathlib import Path

import jax
import matplotlib
import numpy as np
import pages
from matplotlib import pyplot as plt

import hmdjit as hj
from hmdjit.estimates.intervals import Z95
from hmdjit.estimates.summary import POOLED, SummaryRow, summarize
from hmdjit.figures.drawing import save
from hmdjit.head_fitting import fitting, statistics

PRESETS = ("fixating", "seated", "free_viewing", "tracker_noise")
SETS = {"crom": "seated", "fix": "fixating", "nas": "free viewing"}
DRAWS = 4  # persons of the model for each recorded segment
JUDGED_DRAWS = 64  # the same, where a model is held against recordings
# What falls short is bold: speeds and wander in %, spectra in dB, excess kurtosis.
SPEED, WANDER, LONG_WANDER, SPECTRUM_DB, KURTOSIS = 10, 25, np.inf, 1.5, (2, 4)


def flicker(
    head: hj.HeadMotion | hj.Replay, scenes: Sequence[str], sessions: int
) -> list[SummaryRow]:
    """Rows of no anti-aliasing and of head movement, averaged over the scenes."""
    known = hj.scenes.study_set()
    study = hj.Study(
        scenes={name: known[name] for name in scenes or known},
        techniques=[hj.techniques.by_id("none"), hj.techniques.HeadMovement()],
        head=head,
        sessions=sessions,
        baseline="none",
    )
    rows = summarize(study.run(seed=0))
    return [row for row in rows if row.scene == POOLED]


def recorded_and_fitted(traces: Sequence[hj.Trace], order: int) -> dict[str, hj.Replay]:
    """Replay still recordings, and a fitted model at the same frames."""
    segments, rate_hz = fitting.still_data(traces)
    model = fitting.fit_heads(traces, order=order).head
    drawn = []
    for i, key in enumerate(jax.random.split(jax.random.key(0), DRAWS)):
        sessions = statistics.as_recorded(key, model, segments, rate_hz)
        for j, trace in enumerate(sessions):
            person = f"person {i} {j}"
            drawn.append(hj.Trace(trace.t_s, trace.world_from_head, subject=person))
    return {"replayed": hj.Replay(segments), "fitted": hj.Replay(drawn)}


def held_out(traces: Sequence[hj.Trace], order: int) -> list[list[str]]:
    """Fit to half of the people, judge on the others, both ways: two columns."""
    people = sorted({trace.subject for trace in traces})
    halves = [[t for t in traces if t.subject in people[i::2]] for i in (0, 1)]
    columns = []
    for fitted, judged in (halves, halves[::-1]):
        head = fitting.fit_heads(fitted, order=order).head
        segments, rate_hz = fitting.still_data(judged)
        key = jax.random.key(0)
        found = statistics.goodness(key, head, segments, rate_hz, draws=JUDGED_DRAWS)
        columns.append(cells(found))
    return columns


def cells(found: statistics.Goodness) -> list[str]:
    """Say how a model differs from recordings, in the order of `MEASURES`."""
    recorded, model = found.recorded, found.model
    off = lambda ours, theirs: 100 * (np.asarray(ours) / np.asarray(theirs) - 1)
    speeds = [
        off(model.speed_rms_deg_s, recorded.speed_rms_deg_s),
        off(model.speed_quantile(0.5), recorded.speed_quantile(0.5)),
        off(model.speed_quantile(0.95), recorded.speed_quantile(0.95)),
    ]
    limits = (WANDER, WANDER, LONG_WANDER)
    wander = off(model.wander_deg, recorded.wander_deg)
    bold = lambda text, is_bold: f"**{text}**" if is_bold else text
    percent = lambda x, limit: bold(f"{x:.0f}", abs(x) > limit)
    kurtosis = float(np.mean(model.kurtosis))
    low, high = KURTOSIS
    return [
        ", ".join(percent(speed, SPEED) for speed in speeds),
        *(
            "/".join(percent(x, limit) for x in row)
            for row, limit in zip(wander, limits, strict=True)
        ),
        "/".join(bold(f"{x:.1f}", x > SPECTRUM_DB) for x in found.spectrum_error_db),
        bold(f"{kurtosis:.1f}", not low <= kurtosis <= high)
        + f" ({np.mean(recorded.kurtosis):.1f})",
    ]


MEASURES = (
    "speed RMS, median, 95 %: off by, %",
    *(f"wander in {time_s:g} s, pitch/yaw/roll, %" for time_s in statistics.WANDER_S),
    "log-spectral error, dB",
    "excess kurtosis, model (recorded)",
)


def flicker_table(found: dict[str, list[SummaryRow]]) -> str:
    """Lay out what each head's flicker is."""
    rows = []
    for name, (plain, blended) in found.items():
        loss = blended.others["detail_loss"]
        spread = Z95 * loss.standard_error
        clusters = re.search(r"(\d+) subject", blended.interval)
        who = " drawn persons" if "fitted" in name else " people"
        rows.append(
            (
                name,
                f"{plain.mean:.2f}",
                f"{blended.ratio:.3f} "
                f"[{blended.ratio_low:.3f}, {blended.ratio_high:.3f}]",
                f"{blended.others['detail_loss'].mean:.1f} ± {spread:.1f}",
                clusters[1] + who if clusters else "sessions",
            )
        )
    ratio = "ratio, head movement / none"
    head = ("head", "MTCD, none", ratio, "detail loss", "intervals over")
    return pages.table(head, rows)


def draw(found: dict[str, list[SummaryRow]], path: Path) -> None:
    """Draw the ratio and the detail loss of each head."""
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(10, 0.6 + 0.45 * len(found)), sharey=True, layout="constrained"
    )
    for place, (name, (_, row)) in enumerate(found.items()):
        colour = "C1" if "replayed" in name else "C0" if "fitted" in name else "C7"
        bounds = [[row.ratio - row.ratio_low], [row.ratio_high - row.ratio]]
        left.errorbar(row.ratio, place, xerr=bounds, fmt="o", capsize=3, color=colour)
        loss = row.others["detail_loss"]
        spread = Z95 * loss.standard_error
        right.errorbar(loss.mean, place, xerr=spread, fmt="o", capsize=3, color=colour)
    left.set_yticks(range(len(found)), list(found))
    left.invert_yaxis()
    left.set_xlabel("MTCD ratio, head movement / none")
    right.set_xlabel("detail loss of head movement, code values²")
    figure.suptitle("Flicker of presets, of recorded heads and of the fitted models")
    save(figure, path, tight=False)


def main() -> None:
    """Fit, simulate, and write the page and its picture."""
    parser = pages.arguments(__file__, __doc__)
    parser.add_argument("--traces", type=Path, help="folder of SET_PERSON_*.csv")
    parser.add_argument("--order", type=int, default=2, help="resonances per axis")
    parser.add_argument("--presets", nargs="*", default=PRESETS)
    parser.add_argument("--scenes", nargs="*", default=())
    parser.add_argument("--sessions", type=int, default=300)
    options = parser.parse_args()

    sets: dict[str, list[hj.Trace]] = {}
    for file in sorted(options.traces.glob("*.csv")) if options.traces else ():
        part = file.name.split("_")[0]
        sets.setdefault(SETS.get(part) or part, []).append(hj.Trace.read(file))
    heads: dict[str, hj.HeadMotion | hj.Replay] = {
        f"preset {name}, 60 Hz": hj.HeadMotion.preset(name) for name in options.presets
    }
    columns: dict[str, list[str]] = {"": list(MEASURES)}
    for name, traces in sets.items():
        for kind, replay in recorded_and_fitted(traces, options.order).items():
            heads[f"{name} {kind}, {replay.refresh_hz:.0f} Hz"] = replay
        ways = (f"{name}, 1 to 2", f"{name}, 2 to 1")
        columns |= zip(ways, held_out(traces, options.order), strict=True)
    found = {
        name: flicker(head, options.scenes, options.sessions)
        for name, head in heads.items()
    }
    blocks = {
        "held_out": pages.table(list(columns), zip(*columns.values(), strict=True)),
        "flicker": flicker_table(found),
    }
    draw(found, options.out.with_suffix(".png"))
    pages.write(__file__, blocks, options.out)


if __name__ == "__main__":
    matplotlib.use("Agg")
    main()
