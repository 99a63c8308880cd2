"""A Monte Carlo study of flicker, as users define and run it."""

import os
from collections.abc import Mapping, Sequence
from concurrent import futures
from typing import TYPE_CHECKING

import numpy as np

from .. import _checks
from ..head_motion import HeadMotion
from . import executors
from .definition import StudyDefinition, check_seed
from .progress import Tell
from .run import Run
from .sampler import CHUNK, LEAST_SESSIONS
from .sequential import Goal

if TYPE_CHECKING:
    import xarray


class Study(StudyDefinition):
    """A Monte Carlo study of flicker.

    - `scenes`: by name: pictures, which are baked, and sources such as solids, which
      are seen as they are.
    - `techniques`: compared on the same head paths and the same blocks.
    - `camera`: of the headset; a replay at its own rate replaces `refresh_hz`.
    - `head`: a model, from which each session draws a person and a path, or a `Replay`.
    - `sessions`: at least 1; a replay has at most as many as windows.
    - `frames`: displayed frames that are measured, at least 2.
    - `warmup`: displayed frames before them, at least 0.
    - `measure`: tiles (unbiased for the frame), the whole frame or a central crop;
      by default two tiles of 64 px, or the largest size below that divides the frame.
    - `baseline`: id of the technique that ratios refer to.
    - `oversampling`: texels per display pixel and axis, 1, 2 or 4.
    - `margin_deg`: how far a head may turn from where it started.
    - `metrics`: what is measured; the first is the headline, which ratios are of, and
      not in decibels. What reads neighbours, as SSIM does, reads none beyond its block.
    - `neck`: on which a head turns before solids, where its positions are not recorded;
      None turns it about the eye. Pictures have no depth, and know no positions.
    - `reference_samples`, `reference_every`: of solids, rays per pixel in the picture
      that detail loss is measured against, and of how many measured frames the first
      one is held against it. Its own noise adds to the loss: with 16 rays 5 % of one of
      10 code values squared (4 rays: 50 %); every third frame is as sure as all ten.
    - `shapes`: least sizes of what is compiled; a `Sweep` sets them.
    """

    def run(
        self,
        seed: int = 0,
        *,
        out: str | os.PathLike | None = None,
        batch_size: int = 256,
        tolerance: float | None = None,
        budget_s: float | None = None,
        repeat: Mapping[str, Sequence[int]] | None = None,
        omit_failed: bool = False,
        overwrite: bool = False,
        progress: Tell = lambda event: None,
        executor: futures.Executor | None = None,
        in_flight: int | None = None,
    ) -> "xarray.Dataset":
        """Run the study, or go on with it.

        **Arguments:**

        - `seed`: session i depends only on (study, seed, i).
        - `out`: folder for `batches/` and `result.nc`; None keeps nothing. Batches of
          a technique, scene or metric of one's own are kept if its class itself names a
          `version`, to be changed with all that it computes with.
        - `batch_size`: sessions per dispatch and file; does not change a bit.
        - `tolerance`: instead of `sessions`, as many in each scene as bring the 95 %
          interval of every mean and ratio of MTCD within this relative half-width, or
          within 0.005 code values, given the head: what a fitted one may be off by
          comes on top. How many depends on study, seed and tolerance only. Solids have
          no control variate: there it takes more.
        - `budget_s`: instead, as many as these seconds allow, compiling included; at
          least 128 in each scene. How many follows the clock.
        - `repeat`: instead, as many as a run with a budget had: sessions and predicted
          paths by scene, which its attribute `ran` has as JSON.
        - `omit_failed`: leave sessions that fail out of all means, at most 1 % of
          them. They are those of heads that move much, so that means are less
          (with a goal, MTCD less so: predictions know those heads).
        - `overwrite`: whether a `result.nc` of another study in `out` is replaced. One
          that this study contains always is.
        - `progress`: called before and after each batch.
        - `executor`: runs the batches elsewhere, as a `ProcessPoolExecutor`, Dask's or
          MPI's; None runs them here. Does not change a bit. Only this process writes.
        - `in_flight`: batches that an executor is given at a time; by default two for
          each worker, where it says how many it has, else 64.

        **Returns:** each metric over technique, scene and session, NaN where a session
        failed, or was not needed of a technique in a scene; the attributes say what was
        run. `estimates.summary.summarize` makes the estimates.

        **Errors:** `FailedSessionsError` if sessions give no finite number, unless
        they are left out; `LostWorkersError` if an executor's workers die again and
        again; `KeyboardInterrupt`. All leave all finished batches in
        `out`, for the next run. `ValueError` where a result of another study lies.
        """
        check_seed(seed)
        _checks.whole("batch_size", batch_size, 1)
        goal = self.goal(tolerance, budget_s, repeat)
        if executor is not None and goal != Goal():
            raise ValueError(
                "workers need a number of sessions: what a tolerance, a budget or "
                "repeat runs next follows from what was run."
            )
        if in_flight is None:
            in_flight = executors.in_flight(executor)
        _checks.whole("in_flight", in_flight, 1)
        size = batch_size if goal == Goal() else CHUNK
        run = Run(
            self,
            seed,
            out,
            size,
            progress,
            goal,
            omit_failed=omit_failed,
            overwrite=overwrite,
            executor=executor,
            in_flight=in_flight,
        )
        return run.dataset() if goal == Goal() else run.until()

    def goal(
        self,
        tolerance: float | None = None,
        budget_s: float | None = None,
        repeat: Mapping[str, Sequence[int]] | None = None,
    ) -> Goal:
        """Check what a study is to run until.

        **Errors:** `ValueError` for several or wrong numbers, for recorded heads, and
        for another headline than MTCD, which is what can be predicted.
        """
        goal = Goal(tolerance, budget_s, repeat)
        said = [wish for wish in (tolerance, budget_s, repeat) if wish is not None]
        if not said:
            return goal
        if len(said) > 1:
            raise ValueError(
                "tolerance, budget and repeat exclude each other: name one."
            )
        if tolerance is not None:
            _checks.in_range(
                "tolerance", tolerance, 0, 1, open_low=True, open_high=True
            )
        if budget_s is not None:
            _checks.in_range("budget, s", budget_s, 0, open_low=True)
        if repeat is not None:
            if not isinstance(repeat, Mapping):
                raise ValueError(f"repeat must be numbers by scene, got {repeat!r}.")
            if set(repeat) != set(self.scenes):
                raise ValueError(
                    "repeat must name the scenes of this study, "
                    f"{', '.join(self.scenes)}, got {', '.join(repeat) or 'none'}."
                )
            for name, numbers in repeat.items():
                if np.shape(numbers) != (2,):
                    raise ValueError(
                        f"repeat of {name} must be sessions and paths, got {numbers!r}."
                    )
                sessions, paths = numbers
                _checks.whole(f"repeat sessions of {name}", sessions, LEAST_SESSIONS)
                _checks.whole(f"repeat paths of {name}", paths, 0)
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
        return goal
