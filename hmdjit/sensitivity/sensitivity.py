"""How a ratio of MTCD depends on each number of head, camera and technique.

The ratio `R = mean(x) / mean(y)` is over sessions i: x_i is the MTCD of a technique,
y_i that of the baseline, each averaged over scenes. How sessions are differentiated,
and what stays as it is (the picture is fixed in display pixels), says `derivatives`.

Intervals are those of every other ratio here. The estimate is a smooth function of four
means over sessions, of x, y and their derivatives: each session's influence on it gives
the delta method's interval, which from 50 sessions on costs nothing and does not depend
on a resampling's seed; fewer sessions are resampled (`intervals`).
"""

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .. import _files
from ..camera import Camera
from ..estimates.intervals import (
    Interval,
    log_ratio_derivative_interval,
    ratio_interval,
)
from ..frames.texture import Texture
from ..head_motion import HeadMotion
from ..scenes.base import AbstractScene
from ..studies.identity import head_words
from ..studies.measured_blocks import Measurement
from ..studies.progress import Tell
from ..technique_contract.base import AbstractTechnique
from ..techniques import NoAntialiasing
from .derivatives import Parameters, SessionDerivatives, differentiate


class Sensitivity(NamedTuple):
    """One parameter, a line of the table; see `Sensitivities`."""

    name: str
    value: float
    per: str
    derivative: float
    standard_error: float
    low: float
    high: float
    sign: str


@dataclasses.dataclass(frozen=True)
class Sensitivities:
    """Derivatives of the logarithm of a ratio, with 95 % intervals over sessions.

    Of a parameter p that is positive `derivative` is `d ln R / d ln p`: by how many
    percent R changes if p changes by one. Of one that is not, it is `d ln R / dp`.

    - `names`, `values`: paths of the parameters, as `head.speed_rms_deg_s[0]`.
    - `per`: `"relative"` where p is positive, else the unit of p, `"1"` if none.
    - `derivative`, `standard_error`, `low`, `high`: one number per parameter.
    - `signs`: `"+"` or `"-"`; `"unclear"` where the interval contains 0, and `"0"`
      where no session depends on the parameter at all.
    - `ratio`: R itself.
    - `method`: how the intervals were made.
    - `sessions`: what they were made from.
    - `about`: what was measured, in words.
    """

    names: tuple[str, ...]
    values: Float[np.ndarray, " parameters"]
    per: tuple[str, ...]
    derivative: Float[np.ndarray, " parameters"]
    standard_error: Float[np.ndarray, " parameters"]
    low: Float[np.ndarray, " parameters"]
    high: Float[np.ndarray, " parameters"]
    signs: tuple[str, ...]
    ratio: Interval
    method: str
    sessions: SessionDerivatives
    about: str = ""

    def rows(self) -> list[Sensitivity]:
        """One row per parameter, in the order of the fields of `Parameters`."""
        numbers = (self.derivative, self.standard_error, self.low, self.high)
        columns = (values.tolist() for values in numbers)
        named = (self.names, self.values.tolist(), self.per)
        return [
            Sensitivity(*row) for row in zip(*named, *columns, self.signs, strict=True)
        ]


def sensitivities(
    scenes: Mapping[str, AbstractScene | Texture],
    camera: Camera,
    technique: AbstractTechnique,
    head: HeadMotion,
    *,
    sessions: int = 64,
    frames: int = 10,
    warmup: int = 12,
    seed: int = 0,
    baseline: AbstractTechnique | None = None,
    measure: Measurement | None = None,
    batch_size: int = 16,
    progress: Tell = lambda event: None,
) -> Sensitivities:
    """Differentiate the ratio of a technique's MTCD to the baseline's.

    **Arguments:**

    - `scenes`: by name; MTCD is averaged over them. Scenes are baked in float32, with 6
      degrees of margin; the widest texture's dtype is that of the computation.
    - `sessions`: at least 2; each draws a person, a path and the measured blocks.
    - `frames`, `warmup`: displayed frames that are measured, and before them.
    - `baseline`: what the ratio refers to; None is no anti-aliasing, which on pictures
      is MSAA too.
    - `measure`: the measured blocks; None is one tile per session, of 64 px or the
      largest size below that divides the camera frame.
    - `batch_size`: sessions between two calls of `progress`.

    **Returns:** derivatives, signs and intervals for every floating number in head,
    camera, technique and baseline, found from their fields.

    **Errors:** `ValueError` for counts out of range, no scene, or a texture of another
    camera; `FailedSessionsError` where a number is not finite, as when a head leaves a
    texture's margin.

    **Accuracy:** intervals are over sessions, as of every ratio: by the delta method
    from 50 sessions on, below that by resampling sessions. In float32 derivatives are
    right to about 2e-7 of a session's largest one, as the law that no unit of time is
    special shows.
    """
    found = differentiate(
        scenes,
        Parameters(head, camera, technique, baseline or NoAntialiasing()),
        sessions=sessions,
        frames=frames,
        warmup=warmup,
        seed=seed,
        measure=measure,
        batch_size=batch_size,
        progress=progress,
    )
    about = (
        f"{technique.id} over {(baseline or NoAntialiasing()).id}, "
        f"{', '.join(scenes)}; {sessions} sessions of {frames} frames after {warmup}, "
        f"seed {seed}; {camera.width_px} x {camera.height_px} px, "
        f"{float(camera.fov_deg):g} deg, {float(camera.refresh_hz):g} Hz; "
        f"head: {head_words(head)}"
    )
    return dataclasses.replace(of_sessions(found), about=about)


def of_sessions(found: SessionDerivatives) -> Sensitivities:
    """Reduce sessions to derivatives of the logarithm of the ratio of their means."""
    is_positive = found.values > 0
    scale = np.where(is_positive, found.values, 1.0)
    intervals = [
        log_ratio_derivative_interval(found.x, found.y, dx, dy)
        for dx, dy in zip((scale * found.dx).T, (scale * found.dy).T, strict=True)
    ]
    moves = (found.dx != 0).any(axis=0) | (found.dy != 0).any(axis=0)
    column = lambda name: np.array([getattr(one, name) for one in intervals], float)
    return Sensitivities(
        found.names,
        found.values,
        tuple(
            "relative" if positive else _unit(name)
            for name, positive in zip(found.names, is_positive, strict=True)
        ),
        column("value"),
        column("standard_error"),
        column("low"),
        column("high"),
        tuple(map(_sign, intervals, moves.tolist())),
        ratio_interval(found.x, found.y),
        intervals[0].method,
        found,
    )


def _sign(interval: Interval, moves: bool) -> str:
    if not moves:
        return "0"
    return "+" if interval.low > 0 else "-" if interval.high < 0 else "unclear"


_UNITS = {"_deg_s": "deg/s", "_deg": "deg", "_hz": "Hz", "_px": "px", "_s": "s"}


def _unit(name: str) -> str:
    """Return a parameter's unit, which its field's name ends in."""
    field, *_ = name.rpartition(".")[-1].partition("[")
    return next((_UNITS[end] for end in _UNITS if field.endswith(end)), "1")


def write_csv(found: Sensitivities, path: str | os.PathLike) -> Path:
    """Write one line per parameter, numbers to the last digit; see `Sensitivities`.

    **Returns:** the path. The file appears at once and whole.
    """
    rows = [row._asdict() | {"about": found.about} for row in found.rows()]
    return _files.write_csv(path, rows)
