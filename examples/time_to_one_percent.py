"""How long until one mean is known to 1 %: plain whole frames against `tolerance`.

For each scene, MTCD of head movement, 95 % interval within 1 %. Whole frames would take
hours: their time is extrapolated from a few sessions, as variance times seconds. The
other is run, pilot, statistics of the picture and all. Compiling and baking, which both
need, are not counted; the kernel is the same. Writes `time_to_one_percent.md`.

    python examples/time_to_one_percent.py --scenes coffee text --sessions 64
"""

import time

import jax
import numpy as np
import pages

import hmdjit as hj
from hmdjit.estimates.intervals import Z95
from hmdjit.estimates.summary import summarize
from hmdjit.studies.measured_blocks import Tiles, WholeFrame
from hmdjit.studies.progress import Progress

TOLERANCE = 0.01


def study(name: str, measure: Tiles | WholeFrame, sessions: int = 1) -> hj.Study:
    """Head movement alone, on one scene of the default study."""
    return hj.Study(
        scenes={name: hj.scenes.study_set()[name]},
        techniques=(hj.techniques.HeadMovement(),),
        baseline="head_movement",
        head=hj.HeadMotion.fixating(),
        measure=measure,
        sessions=sessions,
    )


def whole_frames(name: str, sessions: int) -> tuple[float, float]:
    """Seconds to 1 %, extrapolated, and the relative error of that."""
    running = []

    def clock(event: Progress) -> None:
        running.append((event.fresh, time.perf_counter()))

    batch = len(jax.devices())
    data = study(name, WholeFrame(), sessions).run(0, batch_size=batch, progress=clock)
    # From the end of the first batch, which compiles, to the end of the last.
    times = {}
    for fresh, now in running:
        times.setdefault(fresh, now)
    counts = sorted(times)[1:]
    seconds = (times[counts[-1]] - times[counts[0]]) / (counts[-1] - counts[0])
    mtcd = data["mtcd"].values.ravel()
    relative = mtcd.var(ddof=1) / mtcd.mean() ** 2
    needed = relative * (Z95 / TOLERANCE) ** 2
    # By resampling: how well so few sessions know their relative variance.
    rng = np.random.default_rng(0)
    draws = rng.choice(mtcd, (2000, mtcd.size))
    spread = np.std(np.log(draws.var(axis=1) / draws.mean(axis=1) ** 2))
    return needed * seconds, float(spread)


def until_sure(name: str) -> tuple[float, float]:
    """Seconds to 1 % with everything but compiling and baking; half-width reached."""
    goal = study(name, Tiles(1, 64))
    goal.run(1, tolerance=0.2)  # compiles
    marks = {}

    def clock(event: Progress) -> None:
        marks.setdefault(event.doing, time.perf_counter())

    data = goal.run(0, tolerance=TOLERANCE, progress=clock)
    end = time.perf_counter()
    (row,) = (row for row in summarize(data) if row.scene == name)
    return end - marks[f"{name}: statistics"], (row.high - row.low) / 2 / row.mean


def main() -> None:
    """Measure, and write the page."""
    jax.config.update("jax_num_cpu_devices", 2)
    parser = pages.arguments(__file__, __doc__)
    flickering = [name for name in hj.scenes.study_set() if name != "almost_uniform"]
    parser.add_argument("--scenes", nargs="+", default=flickering)
    parser.add_argument("--sessions", type=int, default=64)
    options = parser.parse_args()
    rows = []
    for name in options.scenes:
        seconds, reached = until_sure(name)
        plain, spread = whole_frames(name, options.sessions)
        ratio = plain / seconds
        low, high = (ratio * np.exp(z * spread) for z in (-Z95, Z95))
        cells = (
            f"{plain:,.0f}",
            f"{seconds:.1f}",
            f"{ratio:.0f} [{low:.0f}, {high:.0f}]",
        )
        rows.append((name, *cells, f"{100 * reached:.2f}"))
    head = ("scene", "whole frames, s", "`--tolerance 0.01`, s", "times as fast [95 %]")
    table = pages.table((*head, "half-width reached, %"), rows)
    pages.write(__file__, {"seconds": table}, options.out)


if __name__ == "__main__":
    main()
