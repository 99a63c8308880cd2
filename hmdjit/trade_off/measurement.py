"""Measuring a trade-off: each setting timed alone, on the same head paths.

Bias is the mean of paired differences to the reference fidelity, over the same
sessions:

- the same pixels, wherever the setting measures those of the reference;
- of the same fidelity on those pixels, where the setting measures other tiles or the
  whole frame: tiles are unbiased, so their mean has the bias of their fidelity;
- of the frame means, where the pixels are no sample of the same frame (a crop, another
  resolution): head paths are paired, pixels are not, and the error is larger.
"""

import contextlib
import math
import os
import platform
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from .. import _checks
from ..simulation.session import Result
from ..studies.identity import attributes
from ..studies.progress import Progress, Tell
from ..studies.study import Study, check_seed
from .bench import Bench
from .settings import REFERENCE, Case
from .trade_off import IDENTITY, Row

_AT_ONCE = 4  # programs compiled before they are timed


class _Measured(NamedTuple):
    case: Case
    result: Result
    seconds: float
    compile_s: float
    bake_s: float


def measure(
    study: Study,
    cases: Sequence[Case],
    *,
    seed: int = 0,
    sessions: int = 48,
    study_options: str = "",
    progress: Tell = lambda event: None,
) -> Iterator[Row]:
    """Measure cases of a study of one scene, and give a row as soon as it is known.

    **Arguments:**

    - `cases`: as `settings.cases` lists them: references first.
    - `sessions`: of each case, at least 2; of a case with many more pixels than the
      study's own setting, fewer, but at least 8.
    - `study_options`: options of `hmdjit study` that name scene, head and camera.
    - `progress`: called before anything that takes long.

    **Errors:** `ValueError` for a study of several scenes or a replay of less than two
    windows.
    """
    check_seed(seed)
    _checks.whole("sessions", sessions, 2)
    if len(study.scenes) != 1:
        raise ValueError(f"scenes must be one, got {len(study.scenes)}.")
    bench = Bench(study, seed, sessions)
    identity = _identity(study, seed, study_options)
    found: dict[tuple[str, str], _Measured] = {}  # by setting and technique
    for first in range(0, len(cases), _AT_ONCE):
        chunk = cases[first : first + _AT_ONCE]
        bench.forget_textures_but({case.setting.texture() for case in cases[first:]})
        names = ", ".join(dict.fromkeys(case.setting.name for case in chunk))
        progress(Progress(first, len(cases), f"compiling {names}", unit="cases"))
        programs = [bench.program(case) for case in chunk]
        compiled = bench.compiled(programs)
        for done, (program, first_s) in enumerate(
            zip(programs, compiled, strict=True), start=first
        ):
            case = program.case
            doing = f"timing {case.setting.name}: {case.technique.id}"
            progress(Progress(done, len(cases), doing, unit="cases"))
            result, seconds = bench.timed(program)
            compile_s = max(0.0, first_s - seconds)
            bake_s = bench.bake_s(case.setting)
            measured = _Measured(case, result, seconds, compile_s, bake_s)
            found[case.setting.name, case.technique.id] = measured
            yield _row(study, measured, found, identity)


def _row(
    study: Study,
    measured: _Measured,
    found: dict[tuple[str, str], _Measured],
    identity: dict[str, str],
) -> Row:
    case, result = measured.case, measured.result
    setting, reference = case.setting, found[REFERENCE, case.compared.id]
    count = len(result.mtcd)
    frame = _differences(result, reference.result)
    bias, bias_by = frame, "frame mean"
    if setting.samples_frame():
        if setting.measure == study.measure:
            bias_by = "same pixels"
        else:
            # The same fidelity on the study's own blocks, if that was measured.
            alike = setting.fidelity(), study.measure, case.technique
            for twin in found.values():
                held = twin.case.setting
                if (held.fidelity(), held.measure, twin.case.technique) == alike:
                    bias = _differences(twin.result, reference.result)
                    bias_by = "same pixels, other tiles"
    return Row(
        setting=setting.name,
        knob=setting.knob,
        technique=case.compared.id,
        dtype=setting.dtype,
        sessions=count,
        mtcd=float(np.mean(result.mtcd)),
        mtcd_sd=float(np.std(result.mtcd, ddof=1)),
        bias=bias[0][0],
        bias_se=bias[0][1],
        bias_by=bias_by,
        reference_mtcd=float(np.mean(reference.result.mtcd)),
        frame_difference=frame[0][0],
        frame_difference_se=frame[0][1],
        detail_loss=float(np.mean(result.detail_loss)),
        detail_loss_sd=float(np.std(result.detail_loss, ddof=1)),
        detail_loss_bias=bias[1][0],
        detail_loss_bias_se=bias[1][1],
        seconds=measured.seconds,
        s_per_session=measured.seconds / count,
        compile_s=measured.compile_s,
        bake_s=measured.bake_s,
        is_other_device=setting.is_other_device,
        setting_options=setting.study_options(study.display),
        python_fields=setting.python_fields(),
        identity=identity,
    )


def _differences(result: Result, reference: Result) -> list[tuple[float, float]]:
    """Mean paired difference of MTCD and detail loss, and its standard error."""
    pairs = ((result.mtcd, reference.mtcd), (result.detail_loss, reference.detail_loss))
    found = []
    for ours, theirs in pairs:
        count = min(len(ours), len(theirs))
        difference = np.asarray(ours[:count], float) - np.asarray(theirs[:count], float)
        error = float(np.std(difference, ddof=1)) / math.sqrt(count)
        found.append((float(np.mean(difference)), error))
    return found


def _identity(study: Study, seed: int, study_options: str) -> dict[str, str]:
    known = attributes(study, seed) | {
        "scene": next(iter(study.scenes)),
        "study_options": study_options,
        "processor": _processor(),
        "cores": os.cpu_count() or 1,
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else math.nan,
    }
    return {name: str(known[name]) for name in IDENTITY}


def _processor() -> str:
    """Return the processor's name, where the system tells it."""
    with contextlib.suppress(OSError), open("/proc/cpuinfo", encoding="utf-8") as file:
        for line in file:
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or "unknown"
