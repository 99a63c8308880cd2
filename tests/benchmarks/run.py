"""Time hmdjit against its rivals, and how its time and memory grow.

    python tests/benchmarks/run.py [--quick] [--only NAME] --out FILE.json

needs the `test` extra and an idle machine; PyTorch joins if it is installed. `--only`
(may be repeated) names a part: `small`, `mid` or `big` (the rivals at that size), or
`sessions`, `pixels`, `frames` or `study` (hmdjit alone). `--quick` tries everything
with little work: its numbers mean nothing.

Each rival is a process of its own, held to one core and then to two. Their runs are
interleaved, and each is checked against a float64 oracle. Unit: ns per pixel and frame
of the whole pipeline: rendering, reprojection, blending and MTCD. Where one that could
use its cores got less of them, something else was running.
"""

import argparse
import importlib.util
import json
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import machine
import ours
import scaling
import task
from serving import Rival, start
from summaries import nanoseconds, slope, spread, table, times_as_fast

BASELINE = "OpenCV + NumPy"
OURS = "hmdjit"
RIVALS = {
    BASELINE: ("opencv_numpy.py",),
    "OpenCV + Numba": ("opencv_numba.py",),
    "Numba": ("numba_loop.py",),
    "SciPy + NumPy": ("scipy_numpy.py",),
    "PyTorch": ("torch_grid_sample.py",),
    "JAX, naive": ("jax_naive.py",),
    OURS: ("ours.py",),
}
# What hmdjit's own studies add to the task, one by one; the last is what they do.
ADDED = {
    f"{OURS} + {' + '.join(ours.ADDITIONS[:i])}": ("ours.py", *ours.ADDITIONS[:i])
    for i in range(1, len(ours.ADDITIONS) + 1)
}
ROUNDS, QUICK_ROUNDS = 9, 3
PAUSE_S = 0.2  # lets the threads of the last rival go to sleep
LONGEST_S = 300.0  # a point that would take longer per run ends its series

# Off by more than both, a rival is flagged: it does another task.
ABSOLUTE, RELATIVE = 1e-2, 1e-4


def compare(size: task.Size, cores: int, rounds: int) -> list[dict[str, Any]]:
    """Time all rivals on one task, in turns."""
    given = task.make(size.side, size.sessions)
    scripts = RIVALS | ADDED
    if importlib.util.find_spec("torch") is None:
        del scripts["PyTorch"]
    rivals = {name: Rival(command, cores) for name, command in scripts.items()}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "task.npz"
        given.save(path)
        prepared = {name: r.ask(f"prepare {path}") for name, r in rivals.items()}
    seconds: dict[str, list[float]] = {name: [] for name in rivals}
    cores_used: dict[str, list[float]] = {name: [] for name in rivals}
    for _ in range(rounds):
        for name, rival in rivals.items():
            time.sleep(PAUSE_S)
            wall_s, processor_s = rival.ask("time")
            seconds[name].append(wall_s)
            cores_used[name].append(processor_s / wall_s)
    measured = {name: rival.ask("values") for name, rival in rivals.items()}
    for rival in rivals.values():
        rival.end()

    exact = {
        masked: task.oracle(given, size.checked, masked=masked)
        for masked in (False, True)
    }
    entries = []
    for name, taken in seconds.items():
        expected = exact[name in ADDED]
        error = max(abs(measured[name][: size.checked] - expected))
        middle = spread(taken)
        entries.append(
            {
                "name": name,
                "cores": cores,
                **size._asdict(),
                "seconds": taken,
                **middle._asdict(),
                "ns_per_pixel_frame": nanoseconds(middle.median, given.pixel_frames),
                "times_as_fast": times_as_fast(taken, seconds[BASELINE])._asdict(),
                "cores_used": spread(cores_used[name]).median,
                "prepare_s": prepared[name][0],
                "mtcd": float(expected.mean()),
                "largest_error": float(error),
                "is_flagged": bool(
                    not error <= max(ABSOLUTE, RELATIVE * expected.mean())
                ),
            }
        )
    return entries


def rival_table(entries: list[dict[str, Any]]) -> str:
    """Lay out what `compare` found, in ns per pixel and frame."""
    rows = []
    for entry in entries:
        scale = entry["ns_per_pixel_frame"] / entry["median"]
        ratio = entry["times_as_fast"]
        rows.append(
            (
                entry["name"],
                f"{entry['cores_used']:.2f} of {entry['cores']}",
                f"{entry['side']} x {entry['sessions']}",
                f"{entry['ns_per_pixel_frame']:.2f}",
                f"{scale * entry['low']:.2f}-{scale * entry['high']:.2f}",
                f"{ratio['value']:.2f} [{ratio['low']:.2f}, {ratio['high']:.2f}]",
                f"{entry['prepare_s']:.1f}",
                f"{entry['largest_error']:.0e}" + " !" * entry["is_flagged"],
            )
        )
    head = ("rival", "cores", "px x sessions", "ns", "quartiles")
    return table((*head, "times as fast", "prepare s", "error"), rows)


def grow(kind: str, *, quick: bool) -> dict[str, Any]:
    """Time the points of a series, each in a process of its own."""
    points, cores = [], min(2, len(machine.cpus()))
    for value in (scaling.QUICK_POINTS if quick else scaling.POINTS)[kind]:
        runs = 1 if quick else 5
        if points:
            last = points[-1]
            growth = (value / last["value"]) ** (2 if kind == "pixels" else 1)
            expected_s = last["median"] * growth
            if expected_s > LONGEST_S:
                break
            runs = runs if expected_s < LONGEST_S / 10 else 1
        command = ["scaling.py", kind, str(value), str(runs)]
        process = start(command, cores)
        answer, _ = process.communicate()
        if process.returncode:
            raise subprocess.CalledProcessError(process.returncode, command)
        point = json.loads(answer)
        points.append(point | spread(point["seconds"])._asdict())
    series: dict[str, Any] = {"kind": kind, "points": points}
    if len(points) > 1:
        work, medians = ([p[key] for p in points] for key in ("work", "median"))
        series["slope"] = slope(work, medians)
        series["slope_of_the_last_three"] = slope(work[-3:], medians[-3:])
    return series


def growth_table(series: dict[str, Any]) -> str:
    """Lay out what `grow` found."""
    rows = [
        (
            f"{point['work']}",
            f"{point['median']:.4g}",
            f"{point['work'] / point['median']:.4g}",
            f"{point['compile_s']:.1f}",
            f"{point['peak_mib_at_start']:.0f}",
            f"{point['peak_mib']:.0f}",
        )
        for point in series["points"]
    ]
    kind = series["kind"]
    unit = "scene-technique-sessions" if kind == "study" else kind
    text = table((unit, "run s", "per s", "compile s", "MiB at start", "peak"), rows)
    if "slope" in series:
        last = series["slope_of_the_last_three"]
        text += f"\ntime grows as {unit}^{series['slope']:.2f}"
        text += f", over the last three points ^{last:.2f}"
    return text


def main() -> None:
    """Read the command line, run the parts, write and print what they found."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parts = (*task.SIZES, *scaling.POINTS)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", action="append", choices=parts, metavar="NAME")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.json")
    options = parser.parse_args()

    found = {"machine": machine.description(), "quick": options.quick}
    found |= {"rivals": [], "series": []}
    rounds = QUICK_ROUNDS if options.quick else ROUNDS
    for part in options.only or parts:
        if part in scaling.POINTS:
            series = grow(part, quick=options.quick)
            found["series"].append(series)
            print(growth_table(series), end="\n\n", flush=True)
        else:
            size = (task.QUICK if options.quick else task.SIZES)[part]
            for cores in range(1, min(2, len(machine.cpus())) + 1):
                entries = compare(size, cores, rounds)
                found["rivals"] += entries
                print(rival_table(entries), end="\n\n", flush=True)
        options.out.write_text(json.dumps(found, indent=1), encoding="utf-8")
    print(json.dumps(found["machine"], indent=1))


if __name__ == "__main__":
    main()
