"""`python -m hmdjit`, and the entry point of the command line."""

import os
import sys


def main() -> None:
    """Run the command line; one line of error and exit code 2 for wrong input."""
    import jax

    # One host device per core: on a CPU, sessions then run side by side. It must be set
    # before JAX looks for devices. Each holds a copy of the texture, hence the limit.
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1
    jax.config.update("jax_num_cpu_devices", max(1, min(cores, 4)))
    try:
        from .cli.main import INTERRUPTED, run
    except ImportError as error:
        sys.exit(f"hmdjit: error: {error}; the command line needs `hmdjit[study]`.")
    code = run(sys.argv[1:])
    if code == INTERRUPTED:
        # XLA, interrupted while it compiles, crashes when Python takes it down.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


if __name__ == "__main__":
    main()
