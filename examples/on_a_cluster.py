"""On a cluster: a study's batches go to any executor of `concurrent.futures`.

Here that is two processes of this machine. A cluster's offers the same interface:
`dask.distributed.Client(address).get_executor()`, `mpi4py.futures.MPIPoolExecutor()`,
`submitit.AutoExecutor(folder)`. Session i depends only on the study, the seed and i:
the numbers are the same bits as without. What was finished before an interruption is
found again in `out`.

    python examples/on_a_cluster.py

printed

    200 sessions: none 6.028, head movement 3.402
    same bits as here: True
"""

import argparse
import multiprocessing
import tempfile
from concurrent.futures import Executor, ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

import hmdjit as hj


def study(sessions: int) -> hj.Study:
    """Two techniques on one scene."""
    compared = [hj.techniques.by_id(id) for id in ("none", "head_movement")]
    scenes, head = {"noise": hj.scenes.by_name("noise")}, hj.HeadMotion.fixating()
    return hj.Study(scenes, compared, head=head, sessions=sessions, baseline="none")


def run(sessions: int, executor: Executor | None, folder: Path) -> Any:
    """Run the study in batches of a tenth; they lie in the folder when it is killed."""
    size = max(1, sessions // 10)
    options = {"out": folder, "batch_size": size, "executor": executor}
    return study(sessions).run(0, **options)


def main() -> None:
    """Run it in two processes and in this one, and compare."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--sessions", type=int, default=200)
    sessions = parser.parse_args().sessions
    # Not forked: JAX has threads.
    spawn = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with ProcessPoolExecutor(2, mp_context=spawn) as executor:
            there = run(sessions, executor, folder / "there")
        here = run(sessions, None, folder / "here")
    none, blended = there["mtcd"].mean(["session", "scene"]).values
    print(f"{sessions} sessions: none {none:.3f}, head movement {blended:.3f}")
    print(f"same bits as here: {np.array_equal(there['mtcd'], here['mtcd'])}")


if __name__ == "__main__":
    main()
