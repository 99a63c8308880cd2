"""How hmdjit's time and memory grow; one point per process.

`scaling.py KIND VALUE RUNS` prints a JSON line: work, compile time, run times, peak
memory. Kinds: `sessions` of a study of one tile of 64 px on one scene, `pixels` along
the side of whole frames, `frames` of 64 px; `study` is the default study on three of
its scenes.
"""

import json
import sys
import time

import ours
import task
from machine import cpus, peak_mib

from hmdjit.cli import definition

POINTS = {
    "sessions": (100, 316, 1_000, 3_162, 10_000, 31_623, 100_000),
    "pixels": (32, 64, 128, 256, 512, 1024, 2048),
    "frames": (2, 4, 10, 32, 100, 316, 1000),
    "study": (500,),
}
QUICK_POINTS = {
    "sessions": (32, 64),
    "pixels": (32, 64, 128),
    "frames": (2, 10, 32),
    "study": (16,),
}
SCENES = ("coffee", "text", "noise")

Timing = tuple[float, list[float]]
"""Compile time and run times, s."""


def _clock(run) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def _whole_frames(side: int, sessions: int, steps: int, runs: int) -> Timing:
    given = ours.arguments(task.make(side, sessions, steps))
    programs = []
    compile_s = _clock(lambda: programs.append(ours.compiled(given)))
    run = lambda: programs[0](given)
    run()
    return compile_s, [_clock(run) for _ in range(runs)]


def _study(options: definition.Options, runs: int) -> Timing:
    """Compile time is what the first run takes longer than the others."""
    study = definition.build(options)
    first = _clock(lambda: study.run(seed=0))
    seconds = [_clock(lambda: study.run(seed=0)) for _ in range(runs)]
    return first - min(seconds), seconds


def measure(kind: str, value: int, runs: int) -> tuple[int, Timing]:
    """Time a point; its work is in sessions, pixels of a frame, or frames."""
    if kind == "pixels":
        return value**2, _whole_frames(value, 2, task.STEPS, runs)
    if kind == "frames":
        return value, _whole_frames(64, 16, value - 1, runs)
    if kind == "sessions":
        options = definition.Options(
            scenes=("noise",), techniques=("head_movement",), tiles=1, sessions=value
        )
        return value, _study(options, runs)
    options = definition.Options(scenes=SCENES, sessions=value)
    rows = len(SCENES) * len(definition.TECHNIQUES)
    return value * rows, _study(options, runs)


if __name__ == "__main__":
    ours.use_all_cores()
    kind, value, runs = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    at_start = peak_mib()
    work, (compile_s, seconds) = measure(kind, value, runs)
    answer = {
        "value": value,
        "work": work,
        "cores": len(cpus()),
        "compile_s": compile_s,
        "seconds": seconds,
        "peak_mib": peak_mib(),
        "peak_mib_at_start": at_start,
    }
    print(json.dumps(answer))
