"""What a benchmark ran on: processor, memory, system and versions."""

import datetime
import importlib.metadata
import os
import platform
import resource
import sys
from pathlib import Path

PACKAGES = (
    "jax",
    "jaxlib",
    "numpy",
    "scipy",
    "opencv-python-headless",
    "numba",
    "torch",
)


def _line(path: str, name: str) -> str | None:
    """Value of the first `name: value` line of a file under /proc, if there is one."""
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except OSError:
        return None
    values = (line.partition(":")[2].strip() for line in lines if line.startswith(name))
    return next(values, None)


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def cpus() -> list[int]:
    """Return the processors that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def description() -> dict[str, object]:
    """Hardware, system, versions, date, and how busy the machine is."""
    memory = _line("/proc/meminfo", "MemTotal")
    return {
        "cpu": _line("/proc/cpuinfo", "model name") or platform.processor(),
        "cores": len(cpus()),
        "memory_gib": memory and round(int(memory.split()[0]) / 2**20, 1),
        "load": os.getloadavg() if hasattr(os, "getloadavg") else None,
        "os": platform.platform(),
        "python": platform.python_version(),
        "versions": {package: _version(package) for package in PACKAGES},
        "dtype": "float32",
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }


def peak_mib() -> float:
    """Largest resident memory of this process so far.

    Linux counts the parent's memory at the start in `getrusage`, in VmHWM it does not.
    """
    high_water = _line("/proc/self/status", "VmHWM")
    if high_water is not None:
        return int(high_water.split()[0]) / 2**10
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)
