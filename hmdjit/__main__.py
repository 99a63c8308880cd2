"""`python -m hmdjit`, and the entry point of the command line."""

import _thread
import os
import signal
import sys
import threading
from typing import Any

from . import _stop


def main() -> None:
    """Run the command line; one line of error and exit code 2 for wrong input.

    Ctrl-C ends it with exit code 130 and one line, at once until the command runs; a
    second one while it winds up ends it at once too.
    """
    import jax

    # One host device per core: on a CPU, sessions then run side by side. It must be set
    # before JAX looks for devices. Each holds a copy of the texture, hence the limit.
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1
    jax.config.update("jax_num_cpu_devices", max(1, min(cores, 4)))
    try:
        from .cli.main import INTERRUPTED, run
    except ImportError as error:
        sys.exit(f"hmdjit: error: {error}; the command line needs `hmdjit[study]`.")
    is_heeded = signal.getsignal(signal.SIGINT) is _stop
    sys.unraisablehook = _swallowed
    try:
        if is_heeded:
            signal.signal(signal.SIGINT, _interrupt)
        code = run(sys.argv[1:])
    except KeyboardInterrupt:
        _stop()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        if is_heeded:
            signal.signal(signal.SIGINT, _stop)
    if code == INTERRUPTED:
        # XLA, interrupted while it compiles, crashes when Python takes it down.
        os._exit(code)
    sys.exit(code)


def _interrupt(*_: object) -> None:
    signal.signal(signal.SIGINT, _stop)
    raise KeyboardInterrupt


def _swallowed(ignored: Any) -> None:
    """Interrupt again, a little later: what garbage collection calls swallows it."""
    if not isinstance(ignored.exc_value, KeyboardInterrupt):
        return sys.__unraisablehook__(ignored)
    signal.signal(signal.SIGINT, _interrupt)
    threading.Timer(0.05, _send).start()


def _send() -> None:
    if hasattr(signal, "pthread_kill"):  # wakes what waits, too
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    else:
        _thread.interrupt_main()


if __name__ == "__main__":
    main()
