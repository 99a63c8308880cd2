"""The command line's `hmdjit doctor`: whether the installation is well."""

import dataclasses
import importlib.metadata
import json
import os
import platform
import re
import time
from typing import Annotated

import jax
import jax.numpy as jnp
import rich.console

from ..camera import Camera
from ..quaternion import exp, log
from ..studies.identity import made_by
from .options import FAILED, HEAD, OK, shown

_TURN = (1e-3, -2e-3, 5e-4)  # rad, as from frame to frame


@dataclasses.dataclass(frozen=True)
class DoctorCommand:
    """Say in ten lines what this installation has, lacks and takes for granted.

    Fails if a small compiled program gives a wrong number.

    For example: hmdjit doctor --json
    """

    json: Annotated[bool, shown("", "The same for machines.")] = False

    def run(self, console: rich.console.Console) -> int:
        """Look, and print."""
        start = time.perf_counter()
        turn = jnp.asarray(_TURN, jnp.float32)
        error = float(jnp.abs(jax.jit(lambda v: log(exp(v)))(turn) - turn).max())
        seconds, is_well = time.perf_counter() - start, error < 1e-9
        camera = Camera()
        found = {
            "hmdjit": made_by().removeprefix("hmdjit "),
            "python": f"{platform.python_version()}, {platform.platform()}",
            "jax": f"{jax.__version__}, {jax.default_backend()}",
            "devices": [
                f"{device.device_kind} {device.id}" for device in jax.devices()
            ],
            "dtype": str(jnp.result_type(float)),
            "cores": _cores(),
            "threads": _threads(),
            "extras": _extras(),
            "compilation cache": jax.config.values["jax_compilation_cache_dir"],
            "program": {"error": error, "seconds": round(seconds, 2), "well": is_well},
            "assumed": f"{camera.width_px} x {camera.height_px} px, "
            f"{camera.fov_deg:g} deg, {camera.refresh_hz:g} Hz; head {HEAD}; colours "
            "sRGB, gamma; poses those of rendering",
        }
        if self.json:
            print(json.dumps(found))
        else:
            for name, line in _lines(found).items():
                console.out(f"{name:18}{line}")
        return OK if is_well else FAILED


def _lines(found: dict) -> dict[str, str]:
    """Say it in words."""
    extras = [
        f"{extra} " + (f"lacks {' '.join(lacking)}" if lacking else "is complete")
        for extra, lacking in found["extras"].items()
    ]
    program = found["program"]
    words = "right" if program["well"] else "WRONG"
    cache = found["compilation cache"]
    threads = [f"{name}={value}" for name, value in found["threads"].items()]
    cores, devices = found["cores"], len(found["devices"])
    both = {"hmdjit": f"{found['hmdjit']}; Python {found['python']}"}
    rest = {name: line for name, line in found.items() if name not in ("python", *both)}
    return (
        both
        | rest
        | {
            "devices": f"{devices} x {found['devices'][0].rpartition(' ')[0]}",
            "dtype": f"{found['dtype']}; studies simulate in float32",
            "cores": f"{cores} to use; sessions run side by side on {devices} devices",
            "threads": ", ".join(threads) or "as JAX chooses",
            "extras": "; ".join(extras) or "not known: hmdjit is not installed by pip",
            "compilation cache": cache
            or "none: with JAX_COMPILATION_CACHE_DIR=FOLDER programs are compiled once",
            "program": f"{words}, off by {program['error']:.1g} rad, in "
            f"{program['seconds']:g} s with compiling",
        }
    )


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _threads() -> dict[str, str]:
    """Return what the environment says of threads."""
    names = ("XLA_FLAGS", "JAX_NUM_CPU_DEVICES", "OMP_NUM_THREADS")
    return {name: os.environ[name] for name in names if os.environ.get(name)}


def _extras() -> dict[str, list[str]]:
    """Name packages that are missing, by extra."""
    try:
        needs = importlib.metadata.requires("hmdjit") or []
    except importlib.metadata.PackageNotFoundError:
        return {}
    lacking: dict[str, list[str]] = {}
    for need in needs:
        extra, name = (
            re.search(r"extra == ['\"](\w+)", need),
            re.match(r"[\w.-]+", need),
        )
        if extra is None or name is None or name[0] == "hmdjit":
            continue
        missing = lacking.setdefault(extra[1], [])
        try:
            importlib.metadata.version(name[0])
        except importlib.metadata.PackageNotFoundError:
            missing.append(name[0])
    return lacking
