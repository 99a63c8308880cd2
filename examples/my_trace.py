"""A head of one's own: a log of poses, whatever its columns are called, replayed.

The log here has Unity's axes, milliseconds and columns of its own; it is written first,
from a sample, for want of yours. Each session of the study is a window of it.

    python examples/my_trace.py

printed

    1801 poses of me at 90.0 Hz
    40 windows of 12 + 10 frames
    none 4.40, head movement 2.74 code values
    ratio 0.624, between these windows of one person only

A log in the usual form needs no options, on the command line either:

    hmdjit study --trace me.csv
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

import hmdjit as hj

SAMPLE = Path(__file__).parents[1] / "traces" / "seated_90hz.csv"
COLUMNS = ("time", "-", "qx", "qy", "qz", "qw")


def write_log(path: Path) -> None:
    """Write a log as an application in Unity might: left-handed, z forward."""
    trace = hj.Trace.read(SAMPLE)
    w, x, y, z = trace.world_from_head.T
    battery = np.full_like(w, 87)
    rows = np.column_stack([1000 * trace.t_s, battery, -x, -y, z, w])
    header = "clock,battery,rot0,rot1,rot2,rot3"
    np.savetxt(path, rows, "%.17g", ",", header=header, comments="")


def main() -> None:
    """Read the log, and compare techniques on its windows."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--sessions", type=int, default=40)
    sessions = parser.parse_args().sessions
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "me.csv"
        write_log(log)
        trace = hj.Trace.read(log, columns=COLUMNS, time_unit="ms", axes="unity")
    print(f"{len(trace.t_s)} poses of {trace.subject} at {trace.rate_hz:.1f} Hz")
    compared = [hj.techniques.by_id(id) for id in ("none", "head_movement")]
    scenes, head = {"noise": hj.scenes.by_name("noise")}, hj.Replay((trace,))
    study = hj.Study(scenes, compared, head=head, sessions=sessions, baseline="none")
    data = study.run(seed=0)
    none, blended = data["mtcd"].mean(["session", "scene"]).values
    print(f"{data.sizes['session']} windows of {study.warmup} + {study.frames} frames")
    print(f"none {none:.2f}, head movement {blended:.2f} code values")
    print(f"ratio {blended / none:.3f}, between these windows of one person only")


if __name__ == "__main__":
    main()
