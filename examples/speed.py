"""How fast frames and head paths are simulated, beside other ways to do the same.

Frames: what `tests/benchmarks/run.py` measures, or has left in a JSON file. Paths: by
`lax.map` over the keys of sessions, in float32, on one core. Needs the `test` extra
and an idle machine. Writes `speed.md`.

    python examples/speed.py --json speed.json
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import pages

import hmdjit as hj

BENCHMARKS = Path(__file__).parents[1] / "tests" / "benchmarks" / "run.py"
COLUMNS = {  # side of the frame, px, and cores
    (64, 1): "64 px",
    (256, 1): "256 px",
    (1024, 1): "1024 px",
    (64, 2): "64 px, two cores",
    (256, 2): "256 px, two cores",
}
LABELS = {
    "hmdjit": "hmdjit",
    "hmdjit + mask": "with the mask outside the frame",
    "hmdjit + mask + fine": "and 2 texels per pixel",
    "hmdjit + mask + fine + loss": "and detail loss (what studies run)",
}
HEADS = {
    "A": hj.HeadMotion((1.1, 0.9, 0.9), (0.1, 0.12, 0.03), (0.004,) * 3),
    "B, with bursts": hj.HeadMotion.fixating(),
}
FRAMES = (1_000, 22)


def measured() -> list[dict[str, Any]]:
    """Run the benchmark of all rivals."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "speed.json"
        parts = [word for size in ("small", "mid", "big") for word in ("--only", size)]
        command = [sys.executable, str(BENCHMARKS), *parts, "--out", str(file)]
        subprocess.run(command, check=True)
        return json.loads(file.read_text(encoding="utf-8"))["rivals"]


def pipeline(entries: list[dict[str, Any]]) -> str:
    """Lay out ns per pixel and frame; ours first, with times as fast in brackets."""
    found = {(e["name"], e["side"], e["cores"]): e for e in entries}
    names = list(dict.fromkeys(entry["name"] for entry in entries))
    rivals = [name for name in names if name not in LABELS]

    def cell(name: str, column: tuple[int, int]) -> str:
        entry = found.get((name, *column))
        if entry is None:
            return ""
        nanoseconds = f"{entry['ns_per_pixel_frame']:.1f}"
        times = f" ({entry['times_as_fast']['value']:.1f} x)"
        return nanoseconds + times * (name in LABELS)

    rows = [
        [LABELS.get(name, name), *(cell(name, column) for column in COLUMNS)]
        for name in (*LABELS, *rivals)
    ]
    return pages.table(["", *COLUMNS.values()], rows)


def paths_per_second(head: hj.HeadMotion, frames: int, drawn: int) -> float:
    """Draw frames in sessions of a length, the best of 5 runs; frames per second."""

    @jax.jit
    def paths(head: hj.HeadMotion, keys: jax.Array) -> jax.Array:
        draw = lambda key: head.sample(key, 60.0, frames, dtype=jnp.float32)
        return jax.lax.map(draw, keys)

    keys = jax.random.split(jax.random.key(0), drawn // frames)
    jax.block_until_ready(paths(head, keys))  # compiles
    seconds = []
    for _ in range(5):
        start = time.perf_counter()
        jax.block_until_ready(paths(head, keys))
        seconds.append(time.perf_counter() - start)
    return len(keys) * frames / min(seconds)


def main() -> None:
    """Measure, and write the page."""
    parser = pages.arguments(__file__, __doc__)
    parser.add_argument("--json", type=Path, help="what the benchmark left")
    parser.add_argument("--drawn", type=int, default=500_000, help="frames of paths")
    options = parser.parse_args()
    if options.json is None:
        entries = measured()
    else:
        entries = json.loads(options.json.read_text(encoding="utf-8"))["rivals"]
    rows = [
        [
            name,
            *(f"{paths_per_second(head, n, options.drawn) / 1e6:.1f}" for n in FRAMES),
        ]
        for name, head in HEADS.items()
    ]
    head = ["model", *(f"sessions of {n:,} frames" for n in FRAMES)]
    blocks = {"pipeline": pipeline(entries), "paths": pages.table(head, rows)}
    pages.write(__file__, blocks, options.out)


if __name__ == "__main__":
    main()
