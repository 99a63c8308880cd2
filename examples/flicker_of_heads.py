"""Compare the flicker of recorded heads with that of models, and of the presets.

How much does it matter for flicker which head is simulated?
Each preset is simulated at 60 Hz. Each set of recordings is replayed at its own rate,
beside the model that is fitted to it, drawn at the same frames: lost ones too, which
replays fill. A set's name is the first part of its files' names.

    python examples/flicker_of_heads.py --sessions 500 --out heads.png [TRACE.csv ...]
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import jax
import matplotlib
from matplotlib import pyplot as plt

import hmdjit as hj
from hmdjit.estimates.summary import POOLED, SummaryRow, summarize
from hmdjit.head_fitting import fitting, statistics

PRESETS = ("fixating", "seated", "free_viewing", "tracker_noise")
DRAWS = 4  # persons of the model for each recorded segment


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


def recorded_and_fitted(
    files: Sequence[Path],
) -> dict[str, hj.Replay]:
    """Replay still recordings, and a fitted model at the same frames."""
    traces = [hj.Trace.read(file) for file in files]
    segments, rate_hz = fitting.still_data(traces)
    model = hj.fit_heads(traces, order=2).head
    drawn = []
    for i, key in enumerate(jax.random.split(jax.random.key(0), DRAWS)):
        sessions = statistics.as_recorded(key, model, segments, rate_hz)
        for j, trace in enumerate(sessions):
            person = f"person {i} {j}"
            drawn.append(hj.Trace(trace.t_s, trace.world_from_head, subject=person))
    return {"replayed": hj.Replay(segments), "fitted": hj.Replay(drawn)}


def main() -> None:
    """Simulate, print the table and draw it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("traces", nargs="*", type=Path)
    parser.add_argument("--sessions", type=int, default=500)
    parser.add_argument("--scenes", nargs="*", default=())
    parser.add_argument("--out", default="flicker_of_heads.png")
    options = parser.parse_args()

    heads: dict[str, hj.HeadMotion | hj.Replay] = {
        f"preset {name}, 60 Hz": hj.HeadMotion.preset(name) for name in PRESETS
    }
    for name in sorted({file.name.split("_")[0] for file in options.traces}):
        files = [file for file in options.traces if file.name.startswith(f"{name}_")]
        for kind, replay in recorded_and_fitted(files).items():
            heads[f"{name} {kind}, {replay.refresh_hz:.0f} Hz"] = replay

    found = {}
    for name, head in heads.items():
        found[name] = flicker(head, options.scenes, options.sessions)
        plain, blended = found[name]
        spread = 1.96 * blended.detail_loss_standard_error
        print(
            f"{name:28} MTCD {plain.mean:.2f}, ratio {blended.ratio:.3f} "
            f"[{blended.ratio_low:.3f}, {blended.ratio_high:.3f}], detail loss "
            f"{blended.detail_loss:.1f} +- {spread:.1f} ({blended.interval})",
            flush=True,
        )

    figure, (left, right) = plt.subplots(
        1, 2, figsize=(10, 0.6 + 0.45 * len(found)), sharey=True, layout="constrained"
    )
    for place, (name, (_, row)) in enumerate(found.items()):
        colour = "C1" if "replayed" in name else "C0" if "fitted" in name else "C7"
        bounds = [[row.ratio - row.ratio_low], [row.ratio_high - row.ratio]]
        left.errorbar(row.ratio, place, xerr=bounds, fmt="o", capsize=3, color=colour)
        spread = 1.96 * row.detail_loss_standard_error
        right.errorbar(
            row.detail_loss, place, xerr=spread, fmt="o", capsize=3, color=colour
        )
    left.set_yticks(range(len(found)), list(found))
    left.invert_yaxis()
    left.set_xlabel("MTCD ratio, head movement / none")
    right.set_xlabel("detail loss of head movement, code values²")
    figure.suptitle("Flicker of presets, of recorded heads and of the fitted models")
    figure.savefig(options.out, dpi=150)


if __name__ == "__main__":
    matplotlib.use("Agg")
    main()
