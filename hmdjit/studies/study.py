"""A Monte Carlo study of flicker, as users define and run it."""

import os
from typing import TYPE_CHECKING

from .. import _checks
from ..head_motion import HeadMotion
from .definition import StudyDefinition, check_seed
from .progress import Tell
from .run import Run
from .sampler import CHUNK
from .sequential import Goal

if TYPE_CHECKING:
    import xarray


class Study(StudyDefinition):
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
    - `metrics`: what is measured; the first is the headline, which ratios are of.
    """

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
          within 0.005 code values, given the head: what a fitted one may be off by
          comes on top.
        - `budget_s`: instead, as many as these seconds allow, compiling included; at
          least 128 in each scene.
        - `omit_failed`: leave sessions that fail out of all means, at most 1 % of
          them. They are those of heads that move much, so that means are less
          (with a goal, MTCD less so: predictions know those heads).
        - `progress`: called before and after each batch.

        **Returns:** each metric over technique, scene and session, NaN where a session
        failed, or was not needed of a technique in a scene; the attributes say what was
        run. `estimates.summary.summarize` makes the estimates.

        **Errors:** `FailedSessionsError` if sessions give no finite number, unless
        they are left out; `KeyboardInterrupt`. Both leave all finished batches in
        `out`, for the next run.
        """
        check_seed(seed)
        _checks.whole("batch_size", batch_size, 1)
        if tolerance is None and budget_s is None:
            run = Run(self, seed, out, batch_size, progress, omit_failed=omit_failed)
            return run.dataset()
        goal = self.goal(tolerance, budget_s)
        run = Run(self, seed, out, CHUNK, progress, omit_failed=omit_failed)
        return run.until(goal)

    def goal(self, tolerance: float | None, budget_s: float | None) -> Goal:
        """Check what a study is to run until.

        **Errors:** `ValueError` for both or wrong numbers, for recorded heads, and for
        another headline than MTCD, which is what can be predicted.
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
        if self.metrics[0].id != "mtcd":
            raise ValueError(
                "tolerance and budget are of MTCD: metrics must begin with mtcd, got "
                f"{self.metrics[0].id}."
            )
        return Goal(tolerance, budget_s)
