"""All techniques on the same heads: flicker against error, and whether jitter helps.

Simulates sessions of pictures and of solids, of each temporal technique with and
without jitter of the camera; then pairs of these over head presets and refresh rates.
Fills `all_techniques.md`, with a picture and a CSV of all pairs. What is interrupted
goes on when the same command is run again: finished sessions are kept in a folder.

    python examples/all_techniques.py --sessions 1000 --solid-sessions 100
"""

import csv
import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import jax
import numpy as np
import pages

import hmdjit as hj
from hmdjit.cli.definition import named_scenes
from hmdjit.estimates.intervals import Interval, mean_interval, ratio_interval
from hmdjit.figures import drawing
from hmdjit.studies.definition import StudyScene
from hmdjit.studies.measured_blocks import Tiles, WholeFrame
from hmdjit.technique_contract.base import AbstractTemporal

if TYPE_CHECKING:
    import xarray

OTHERS = ("none", "freeze", "msaa4", "fxaa39", "smaa", "ssaa2", "accumulation16")
OTHERS += ("ssaa4", "head_movement")
TEMPORAL = [
    id
    for id in hj.techniques.IDS
    if isinstance(hj.techniques.by_id(id), AbstractTemporal)
]
PICTURES, SOLIDS = ("coffee", "grass", "text", "noise"), ("moving_sphere", "pipe")
PRESETS = ("fixating", "seated", "free_viewing", "tracker_noise")
RATES_HZ = (60, 72, 90, 120)
CAMERA = hj.Camera(1024, 1024, 96.0, 60.0)
# Tiles of what moves would need halos as wide as it moves in a session.
SOLIDS_CAMERA = hj.Camera(192, 192, 23.5, 60.0)
METRICS = ("mtcd", "detail_loss")
PAIRS_AT_ONCE = 2


@dataclasses.dataclass(frozen=True)
class Cell:
    """A study that is to be run: scenes, head, rate and how many sessions."""

    scenes: Mapping[str, StudyScene]
    preset: str
    rate_hz: float
    sessions: int

    @property
    def is_solid(self) -> bool:
        """Whether its scenes are solids."""
        return not self.scenes.keys() <= hj.scenes.study_set().keys()

    def study(self, ids: Sequence[str]) -> hj.Study:
        """Return the study of some techniques."""
        camera = SOLIDS_CAMERA if self.is_solid else CAMERA
        size = camera.width_px, camera.height_px, float(camera.fov_deg)
        camera = hj.Camera(*size, self.rate_hz)
        return hj.Study(
            scenes=self.scenes,
            techniques=[hj.techniques.by_id(id) for id in ids],
            camera=camera,
            head=hj.HeadMotion.preset(self.preset),
            measure=WholeFrame() if self.is_solid else Tiles(),
            sessions=self.sessions,
            baseline=ids[0],
        )

    def run(self, ids: Sequence[str], folder: Path) -> "xarray.Dataset":
        """Run techniques, few of a kind together, and gather them all."""
        others = [id for id in ids if id in OTHERS]
        rest = [id for id in ids if id not in OTHERS]
        size = PAIRS_AT_ONCE
        groups = [others] if others else []
        groups += [rest[i : i + size] for i in range(0, len(rest), size)]
        keep = {"out": folder, "overwrite": True, "batch_size": 64}
        with ThreadPoolExecutor(2) as pool:  # one compiles while another runs
            list(pool.map(lambda group: self.study(group).run(0, **keep), groups))
        print(
            f"{', '.join(self.scenes)}: {self.preset}, {self.rate_hz:g} Hz", flush=True
        )
        return self.study(ids).run(0, **keep)


def of_sessions(data: "xarray.Dataset", metric: str, id: str) -> np.ndarray:
    """Values of a technique, mean over scenes, `(sessions,)`."""
    return data[metric].sel(technique=id).mean("scene").values.astype(float)


def jitter_ratios(data: "xarray.Dataset", id: str) -> list[Interval]:
    """MTCD and detail loss with jitter, over those without, paired by session."""
    names = with_and_without(id)
    pairs = [[of_sessions(data, m, name) for name in names] for m in METRICS]
    return [ratio_interval(*pair) for pair in pairs]


def with_and_without(id: str) -> tuple[str, str]:
    """Ids of a temporal technique, jittered and not."""
    return id, f"{id}_no_jitter"


def said(found: Interval, digits: int = 2) -> str:
    """Write a value and half of its interval."""
    if not np.isfinite(found.value):
        return "-"
    half = (found.high - found.low) / 2
    return f"{found.value:.{digits}f} ± {half:.{digits}f}"


def rows(parts: Mapping[str, "xarray.Dataset"], ids: Sequence[str]) -> Iterator[tuple]:
    """Yield a line of the table for each technique."""
    for id in ids:
        line = [f"`{id}`", hj.techniques.by_id(id).paper or "-"]
        for data in parts.values():
            line += [
                said(mean_interval(of_sessions(data, metric, id)), digits)
                for metric, digits in zip(METRICS, (2, 1), strict=True)
            ]
        yield tuple(line)


def verdict(ratios: Sequence[Interval]) -> str:
    """Say what intervals say of a ratio to 1, cell by cell."""
    less = sum(ratio.high < 1 for ratio in ratios)
    more = sum(ratio.low > 1 for ratio in ratios)
    return f"less in {less}, more in {more} of {len(ratios)}"


@drawing.styled
def draw(parts: Mapping[str, "xarray.Dataset"], path: Path, footer: str) -> None:
    """Draw MTCD against detail loss; jitter is filled, none of it hollow."""
    figure, (panels,) = drawing.panels(13, 6.2, footer, columns=len(parts))
    named = []
    for axes, (name, data) in zip(panels, parts.items(), strict=True):
        points, ends = [], {}
        for id in (str(id) for id in data["technique"].values if id != "freeze"):
            x, y = (
                mean_interval(of_sessions(data, metric, id)) for metric in METRICS[::-1]
            )
            family, colour = id.removesuffix("_no_jitter"), drawing.GREY
            if family in TEMPORAL:
                colour = drawing.COLOURS[TEMPORAL.index(family) % len(drawing.COLOURS)]
            inside = colour if family == id else "white"
            look = {"color": colour, "mfc": inside, "ms": 6, "lw": 1, "fmt": "o"}
            ranges = [(each.value, each.low, each.high) for each in (x, y)]
            drawing.errorbar(axes, *ranges, zorder=4, **look)
            ends.setdefault(family, []).append((x.value, y.value))
            if family == id:
                points.append((x.value, y.value, id, colour))
        for _, _, family, colour in points:
            axes.plot(*zip(*ends[family], strict=True), color=colour, lw=0.8, zorder=3)
        axes.grid(visible=True)
        axes.set(xlabel="detail loss, code values²", title=name)
        named.append((axes, points))
    panels[0].set_ylabel("MTCD, code values of 8 bits")
    for axes, points in named:
        drawing.label_points(figure, axes, points, fontsize=drawing.FINE)
    drawing.save(figure, path)


def grid_rows(
    grid: Mapping[tuple[str, float], "xarray.Dataset"], temporal: Sequence[str]
) -> Iterator[tuple]:
    """Yield a line for each preset, rate and technique: both ratios."""
    for (preset, rate_hz), data in grid.items():
        for id in temporal:
            yield preset, rate_hz, id, *jitter_ratios(data, id)


def main() -> None:
    """Simulate, and write the page."""
    jax.config.update("jax_num_cpu_devices", 2)
    parser = pages.arguments(__file__, __doc__)
    parser.add_argument("--sessions", type=int, default=1000, help="of pictures")
    parser.add_argument("--solid-sessions", type=int, default=100)
    parser.add_argument("--grid-sessions", type=int, default=200)
    parser.add_argument("--pictures", nargs="+", default=list(PICTURES))
    parser.add_argument("--solids", nargs="+", default=list(SOLIDS))
    parser.add_argument("--grid-scenes", nargs="+", default=["coffee", "text"])
    parser.add_argument("--presets", nargs="+", default=list(PRESETS))
    parser.add_argument("--rates", nargs="+", type=float, default=list(RATES_HZ))
    parser.add_argument("--temporal", nargs="+", default=TEMPORAL)
    parser.add_argument("--keep", type=Path, default=Path("all-techniques"))
    parser.add_argument("--quick", action="store_true", help="a few sessions of each")
    options = parser.parse_args()
    counts = [options.sessions, options.solid_sessions, options.grid_sessions]
    if options.quick:
        counts = [min(64, counts[0]), min(8, counts[1]), min(32, counts[2])]
    pairs = [name for id in options.temporal for name in with_and_without(id)]
    ids = [*OTHERS, *pairs]
    keep = options.keep
    pictures, solids, few = (
        named_scenes(names)
        for names in (options.pictures, options.solids, options.grid_scenes)
    )
    parts = {
        "pictures": Cell(pictures, "fixating", 60.0, counts[0]).run(
            ids, keep / "pictures"
        ),
        "solids": Cell(solids, "fixating", 60.0, counts[1]).run(ids, keep / "solids"),
    }
    grid = {
        (preset, rate): Cell(few, preset, rate, counts[2]).run(
            pairs, keep / f"{preset}-{rate:g}"
        )
        for preset in options.presets
        for rate in options.rates
    }
    found = list(grid_rows(grid, options.temporal))
    head = ("technique", "paper")
    head += tuple(
        f"{what}, {name}" for name in parts for what in ("MTCD", "detail loss")
    )
    lines = []
    for id in options.temporal:
        here = [row for row in found if row[2] == id]
        both = [ratio for data in parts.values() for ratio in jitter_ratios(data, id)]
        verdicts = [verdict([row[i] for row in here]) for i in (3, 4)]
        lines.append((f"`{id}`", *map(said, both), *verdicts))
    heads = [f"{what}, all heads and rates" for what in ("MTCD", "detail loss")]
    cells = [(p, f"{r:g}", f"`{i}`", said(m), said(d)) for p, r, i, m, d in found]
    scope = (
        f"Pictures ({', '.join(pictures)}): {counts[0]} sessions; solids "
        f"({', '.join(solids)}): {counts[1]}; heads and rates: {counts[2]} sessions of "
        f"{', '.join(few)}."
    )
    blocks = {
        "scope": scope,
        "techniques": pages.table(head, rows(parts, ids)),
        "jitter": pages.table(["technique", *head[2:], *heads], lines),
        "heads": pages.table(
            ("head", "Hz", "technique", "MTCD ratio", "detail loss ratio"), cells
        ),
    }
    footer = f"{scope} Filled: the camera jitters; hollow: it does not. 95 % intervals."
    draw(parts, options.out.with_suffix(".png"), footer)
    with options.out.with_suffix(".csv").open(
        "w", newline="", encoding="utf-8"
    ) as file:
        writer = csv.writer(file)
        names = [f"{m}_ratio{end}" for m in METRICS for end in ("", "_low", "_high")]
        writer.writerow(["head", "refresh_hz", "technique", *names])
        for *key, mtcd, loss in found:
            numbers = [(r.value, r.low, r.high) for r in (mtcd, loss)]
            writer.writerow([*key, *(f"{x:.6g}" for three in numbers for x in three)])
    pages.write(__file__, blocks, options.out)


if __name__ == "__main__":
    main()
