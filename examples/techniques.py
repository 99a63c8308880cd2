"""All techniques beside each other: what each needs, costs, removes and keeps.

Runs the default study with them, times a frame of each on one core, and fills the
table of `techniques.md` and that of the README. Needs an idle machine.

    python examples/techniques.py --sessions 500
"""

import functools
from collections.abc import Iterator, Sequence
from pathlib import Path

import pages

import hmdjit as hj
from hmdjit.cli import definition
from hmdjit.estimates.rows import SummaryRow
from hmdjit.estimates.summary import POOLED, summarize
from hmdjit.scenes.solid_set import fence
from hmdjit.technique_contract.base import AbstractTemporal
from hmdjit.trade_off import cost

README = Path(__file__).parents[1] / "README.md"
METRICS = ("mtcd", "detail_loss", "ssim")
COMPARED = ("none", "msaa4", "fxaa", "fxaa39", "mlaa", "smaa", "smaa_ultra")
COMPARED += ("head_movement", "head_movement+smaa", "ssaa2_gamma", "ssaa2")
COMPARED += ("ssaa2_lanczos2", "accumulation16", "ssaa4", "freeze")
TEMPORAL = tuple(
    id
    for id in hj.techniques.IDS
    if isinstance(hj.techniques.by_id(id), AbstractTemporal)
)
# It has no room.
NOT_IN_README = ("fxaa", "mlaa", "smaa_ultra", "head_movement+smaa", "inside_ycocg")
NOT_IN_README += ("ssaa2_gamma", "ssaa2_lanczos2", "fxaa39", "accumulation16")
BEST = 3


def short(rows: Sequence[SummaryRow]) -> list[SummaryRow]:
    """Leave out all but the temporal techniques that flicker least, and some more."""
    temporal = [row for row in rows if row.technique in TEMPORAL]
    best = sorted(temporal, key=lambda row: row.mean)[:BEST]
    left_out = {row.technique for row in temporal if row not in best}
    return [row for row in rows if row.technique not in {*left_out, *NOT_IN_README}]


def cells(row: SummaryRow, ns: float, channels_ns: float) -> Iterator[str]:
    """Say what a technique needs, costs, removes and keeps."""
    technique = hj.techniques.by_id(row.technique)
    _, samples, _ = technique.sample_offsets_px.shape
    yield f"`{row.technique}`"
    yield technique.paper or "-"
    yield ", ".join(sorted(technique.needs)) + f" x {samples}" * (samples > 1)
    yield f"{ns:.3g}"
    yield f"{channels_ns:.3g}"
    yield f"{row.mean:.2f} ± {(row.high - row.low) / 2:.2f}"
    yield f"{row.ratio:.3f} ± {(row.ratio_high - row.ratio_low) / 2:.3f}"
    loss, ssim = row.others["detail_loss"], row.others["ssim"]
    yield f"{loss.mean:.1f} ± {(loss.high - loss.low) / 2:.1f}"
    yield f"{ssim.mean:.4f}"


def main() -> None:
    """Measure, and fill both tables."""
    parser = pages.arguments(__file__, __doc__)
    parser.add_argument("--sessions", type=int, default=100)
    parser.add_argument("--scenes", nargs="+", default=list(hj.scenes.study_set()))
    parser.add_argument("--techniques", nargs="+", default=[*COMPARED, *TEMPORAL])
    parser.add_argument("--repeats", type=int, default=3, help="of each timing")
    parser.add_argument("--readme", type=Path, default=README, help="also filled")
    options = parser.parse_args()
    known = {id: hj.techniques.by_id(id) for id in options.techniques}
    picture, solids = hj.scenes.study_set()["coffee"], fence()
    times = cost.techniques_ns(known.values(), picture, options.repeats)
    of_channels = functools.cache(lambda needs: cost.channels_ns(solids, needs))
    ns = {
        id: (time, of_channels(known[id].needs))
        for id, time in zip(known, times, strict=True)
    }
    study = definition.build(
        definition.Options(
            scenes=tuple(options.scenes),
            techniques=tuple(known),
            metrics=METRICS,
            sessions=options.sessions,
        )
    )
    rows = [row for row in summarize(study.run(seed=0)) if row.scene == POOLED]
    head = ("technique", "paper", "needs", "ns per pixel", "ns of channels")
    head += ("MTCD, code values",)
    head += ("ratio to MSAA 4x", "detail loss, code values²", "SSIM")
    table, less = (
        pages.table(head, [tuple(cells(row, *ns[row.technique])) for row in chosen])
        for chosen in (rows, short(rows))
    )
    scope = f"{len(options.scenes)} scenes, {options.sessions} sessions:"
    pages.write(__file__, {"scope": scope, "techniques": table}, options.out)
    text = options.readme.read_text(encoding="utf-8")
    text = pages.filled(text, {"techniques": less}, some=True)
    options.readme.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
