"""What a study is: scenes, techniques, a head, a display, and how much of it."""

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING

import equinox as eqx

from .. import _checks
from ..camera import Camera
from ..estimates.intervals import GEOMETRIC_MEAN, POOLED
from ..head_motion import HeadMotion
from ..scenes.baking import check_baking
from ..scenes.base import AbstractScene
from ..techniques.base import AbstractTechnique
from .measured_blocks import Measurement, Tiles
from .progress import Tell
from .sampler import CHUNK
from .sequential import Goal
from .sessions import Head

if TYPE_CHECKING:
    import xarray


def check_seed(seed: int) -> None:
    """Raise unless a seed is one that does not wrap around."""
    _checks.whole("seed", seed, 0)
    _checks.in_range("seed", seed, 0, 2**32 - 1)


class Study(eqx.Module):
    """A Monte Carlo study of flicker.

    - `scenes`: by name.
    - `techniques`: compared on the same head paths and the same blocks.
    - `camera`: of the headset; a replay at its own rate replaces `refresh_hz`.
    - `head`: a model, from which each session draws a person and a path, or a `Replay`.
    - `sessions`: at least 1; a replay has at most as many as windows.
    - `frames`: displayed frames that are measured, at least 2.
    - `warmup`: displayed frames before them, at least 0.
    - `measure`: tiles (unbiased for the frame), the whole frame or a central crop.
    - `baseline`: id of the technique that ratios refer to.
    - `oversampling`: texels per display pixel and axis, 1, 2 or 4.
    - `margin_deg`: how far a head may turn from where it started.
    """

    scenes: Mapping[str, AbstractScene]
    techniques: tuple[AbstractTechnique, ...] = eqx.field(converter=tuple)
    head: Head
    camera: Camera = eqx.field(default_factory=Camera)
    sessions: int = 500
    frames: int = 10
    warmup: int = 12
    measure: Measurement = eqx.field(default_factory=Tiles)
    baseline: str = "msaa4"
    oversampling: int = 2
    margin_deg: float = 6.0

    def __check_init__(self):
        if not self.scenes:
            raise ValueError("scenes must name at least one scene, got none.")
        if not self.techniques:
            raise ValueError("techniques must name at least one technique, got none.")
        ids = [technique.id for technique in self.techniques]
        if len(set(ids)) < len(ids):
            raise ValueError(
                f"techniques must have distinct ids, got {', '.join(ids)}."
            )
        _checks.one_of("baseline", self.baseline, ids)
        _checks.whole("sessions", self.sessions, 1)
        _checks.whole("frames", self.frames, 2)
        _checks.whole("warmup", self.warmup, 0)
        self.measure.block_size(self.camera)
        check_baking(self.camera, self.oversampling, self.margin_deg)
        for name in self.scenes:
            if name in (POOLED, GEOMETRIC_MEAN):
                raise ValueError(f"scenes must not be named {name!r}: a pooled row is.")

    @property
    def display(self) -> Camera:
        """The camera, at the rate that heads are replayed at."""
        if isinstance(self.head, HeadMotion):
            return self.camera
        return eqx.tree_at(lambda c: c.refresh_hz, self.camera, self.head.refresh_hz)

    def run(
        self,
        seed: int = 0,
        *,
        out: str | os.PathLike | None = None,
        batch_size: int = 256,
        tolerance: float | None = None,
        budget_s: float | None = None,
        omit_failed: bool = False,
        progress: Tell = lambda event: None,
    ) -> "xarray.Dataset":
        """Run the study, or go on with it.

        **Arguments:**

        - `seed`: session i depends only on (study, seed, i).
        - `out`: folder for `batches/` and `result.nc`; None keeps nothing.
        - `batch_size`: sessions per dispatch and file; does not change a bit.
        - `tolerance`: instead of `sessions`, as many in each scene as bring the 95 %
          interval of every mean and ratio of MTCD within this relative half-width, or
          within 0.005 code values.
        - `budget_s`: instead, as many as these seconds allow, compiling included; at
          least 128 in each scene.
        - `omit_failed`: leave sessions that fail out of all means, at most 1 % of
          them. They are those of heads that move much, so that means are less
          (with a goal, MTCD less so: predictions know those heads).
        - `progress`: called before and after each batch.

        **Returns:** `mtcd` and `detail_loss` over technique, scene and session, NaN
        where a session failed, or was not needed of a technique in a scene; the
        attributes say what was run. With a goal, `results.summarize` makes the
        estimates.

        **Errors:** `FailedSessionsError` if sessions give no finite number, unless
        they are left out; `KeyboardInterrupt`. Both leave all finished batches in
        `out`, for the next run.
        """
        from .run import Run

        check_seed(seed)
        _checks.whole("batch_size", batch_size, 1)
        if tolerance is None and budget_s is None:
            size, goal = batch_size, None
        else:
            size, goal = CHUNK, self.goal(tolerance, budget_s)
        run = Run(self, seed, out, size, progress, omit_failed=omit_failed)
        return run.dataset() if goal is None else run.until(goal)

    def goal(self, tolerance: float | None, budget_s: float | None) -> Goal:
        """Check what a study is to run until.

        **Errors:** `ValueError` for both or wrong numbers, and for recorded heads.
        """
        if tolerance is not None and budget_s is not None:
            raise ValueError("tolerance and budget exclude each other: name one.")
        if tolerance is not None:
            _checks.in_range(
                "tolerance", tolerance, 0, 1, open_low=True, open_high=True
            )
        if budget_s is not None:
            _checks.in_range("budget, s", budget_s, 0, open_low=True)
        if not isinstance(self.head, HeadMotion):
            raise ValueError(
                "tolerance and budget need a head model: recorded heads have only so "
                "many windows."
            )
        return Goal(tolerance, budget_s)
