"""All techniques beside each other: what each needs, costs, removes and keeps.

Runs the default study with them, times a frame of each on one core, and fills the
table of `techniques.md` and that of the README. Needs an idle machine.

    python examples/techniques.py --sessions 500
"""

import time
from collections.abc import Iterator
from pathlib import Path

import jax
import pages

import hmdjit as hj
from hmdjit.cli import definition
from hmdjit.estimates.rows import SummaryRow
from hmdjit.estimates.summary import POOLED, summarize
from hmdjit.metrics import MTCD

README = Path(__file__).parents[1] / "README.md"
METRICS = ("mtcd", "detail_loss", "ssim")
PAPERS = {
    "none": "-",
    "msaa4": "Direct3D's pattern",
    "fxaa": "Lottes 2009",
    "fxaa39": "Lottes 2011, 3.11",
    "mlaa": "Reshetov 2009, Jimenez et al. 2011",
    "smaa": "Jimenez et al. 2012",
    "smaa_ultra": "Jimenez et al. 2012",
    "head_movement": "Kim et al.",
    "head_movement+smaa": "Kim et al., after SMAA",
    "ssaa2_gamma": "Maruszczuk et al., BG",
    "ssaa2": "Maruszczuk et al., BL",
    "ssaa2_lanczos2": "Maruszczuk et al., LL",
    "accumulation16": "Oliveros 2018",
    "ssaa4": "the reference",
    "freeze": "a control",
}
SIDE_PX, FRAMES = 512, 96  # so many that checks of the first do not count


def ns_per_pixel(technique: hj.techniques.AbstractTechnique, repeats: int) -> float:
    """Return how long a frame takes, rendered and measured by MTCD, on one core."""
    camera = hj.Camera(SIDE_PX, SIDE_PX, 48.0, 60.0)
    texture = hj.scenes.bake(hj.scenes.study_set()["coffee"], camera)
    poses = hj.HeadMotion.fixating().sample(jax.random.key(0), 60.0, FRAMES)
    seconds = []
    for _ in range(1 + repeats):  # the first compiles
        start = time.perf_counter()
        found = hj.simulate(texture, camera, technique, poses, metrics=(MTCD(),))
        found.mtcd.block_until_ready()
        seconds.append(time.perf_counter() - start)
    return 1e9 * min(seconds[1:]) / (FRAMES * SIDE_PX**2)


def cells(row: SummaryRow, ns: float) -> Iterator[str]:
    """Say what a technique needs, costs, removes and keeps."""
    technique = hj.techniques.by_id(row.technique)
    _, samples, _ = technique.sample_offsets_px.shape
    yield f"`{row.technique}`"
    yield PAPERS.get(row.technique, "-")
    yield ", ".join(sorted(technique.needs)) + f" x {samples}" * (samples > 1)
    yield f"{ns:.3g}"
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
    parser.add_argument("--techniques", nargs="+", default=list(PAPERS))
    parser.add_argument("--repeats", type=int, default=3, help="of each timing")
    parser.add_argument("--readme", type=Path, default=README, help="also filled")
    options = parser.parse_args()
    known = {id: hj.techniques.by_id(id) for id in options.techniques}
    ns = {id: ns_per_pixel(known[id], options.repeats) for id in known}
    study = definition.build(
        definition.Options(
            scenes=tuple(options.scenes),
            techniques=tuple(known),
            metrics=METRICS,
            sessions=options.sessions,
        )
    )
    rows = [row for row in summarize(study.run(seed=0)) if row.scene == POOLED]
    head = ("technique", "paper", "needs", "ns per pixel", "MTCD, code values")
    head += ("ratio to MSAA 4x", "detail loss, code values²", "SSIM")
    table = pages.table(head, [tuple(cells(row, ns[row.technique])) for row in rows])
    scope = f"{len(options.scenes)} scenes, {options.sessions} sessions:"
    pages.write(__file__, {"scope": scope, "techniques": table}, options.out)
    text = options.readme.read_text(encoding="utf-8")
    options.readme.write_text(pages.filled(text, {"techniques": table}), "utf-8")


if __name__ == "__main__":
    main()
