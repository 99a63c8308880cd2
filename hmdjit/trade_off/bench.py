"""A bench for settings: sessions, textures and programs of one scene, timed.

Textures are baked and programs compiled two at a time; programs are then run one after
the other, up to three times: the median is what a run takes.
"""

import contextlib
import math
import os
import statistics
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .. import camera_bounds
from ..camera import Camera, Region
from ..frames.sources import AbstractSource
from ..scenes.baking import bake
from ..scenes.solids import Baked, Solids
from ..simulation.session import Result
from ..simulation.sharding import placed
from ..studies.measured_blocks import Measurement
from ..studies.runner import Runner
from ..studies.sessions import Batch, Sessions
from ..studies.study import Study
from .settings import Case, Setting, default_setting

_PILOT_SESSIONS = 256
_RUNS = 3
_ENOUGH_S = 6.0  # what takes so long is not repeated
_FEW_SESSIONS = 8  # at least so many are measured, however many pixels they have


class Program(NamedTuple):
    """A case, with what runs it and the sessions that it measures."""

    case: Case
    runner: Runner
    batch: Batch


class Bench:
    """Sessions, textures and programs of one scene."""

    def __init__(self, study: Study, seed: int, sessions: int):
        self.study, self.seed = study, seed
        self.length = study.warmup + study.frames
        ((_, self.scene),) = study.scenes.items()
        self._lock = threading.Lock()
        self._textures: dict[tuple, Future[tuple[AbstractSource, float]]] = {}
        self._most = max(_PILOT_SESSIONS, sessions)
        drawn = self._drawn(default_setting(study))
        if drawn.size < 2:
            raise ValueError("a trade-off needs at least 2 sessions, the replay has 1.")
        self.sessions = min(sessions, drawn.size)
        self.margin_deg = _margin_deg(study.display, drawn)

    def _drawn(self, setting: Setting) -> Batch:
        """As many sessions as show what halos are needed."""
        sessions = Sessions(
            self.seed,
            self.study.head,
            setting.camera(self.study.display),
            setting.measure,
            self._most,
            self.length,
            has_places=not setting.is_baked,
            neck=self.study.neck,
        )
        return sessions.batch(0, sessions.count)

    def source(self, setting: Setting) -> AbstractSource:
        """Return what a setting renders, placed; whoever asks first bakes it."""
        with self._lock:
            future = self._textures.get(setting.texture())
            is_mine = future is None
            if future is None:
                future = self._textures[setting.texture()] = Future()
        if is_mine:
            try:
                future.set_result(self._bake(setting))
            except BaseException as error:
                future.set_exception(error)
                raise
        return future.result()[0]

    def bake_s(self, setting: Setting) -> float:
        """Seconds that baking took, compiling it included."""
        return self._textures[setting.texture()].result()[1]

    def forget_textures_but(self, needed: set[tuple]) -> None:
        """Free the memory of textures that are no longer needed."""
        for key in self._textures.keys() - needed:
            del self._textures[key]

    def _bake(self, setting: Setting) -> tuple[AbstractSource, float]:
        start = time.perf_counter()
        scene = self.scene
        if setting.is_baked and isinstance(scene, Solids):
            scene = Baked(solids=scene)
        with _precision(setting):
            if isinstance(scene, AbstractSource):
                there = jax.block_until_ready(placed(scene))
                return there, time.perf_counter() - start
            texture = bake(
                scene,
                setting.camera(self.study.display),
                oversampling=setting.oversampling,
                # No wider than these heads wander: it changes no texel.
                margin_deg=self.margin_deg,
                dtype=setting.dtype,
            )
            jax.block_until_ready(texture)
            seconds = time.perf_counter() - start
            return jax.block_until_ready(placed(texture)), seconds

    def _solids(self, setting: Setting) -> AbstractSource | None:
        """Return the scene where it is seen as it is."""
        if setting.is_baked or not isinstance(self.scene, AbstractSource):
            return None
        return self.scene

    def program(self, case: Case) -> Program:
        """Prepare a case: its halo is wide enough for all sessions."""
        setting, study = case.setting, self.study
        camera = setting.camera(study.display)
        drawn = self._drawn(setting)
        runner = Runner(
            camera,
            setting.measure,
            [case.technique],
            study.warmup,
            1,
            drawn,
            setting.reading,
            moving=self._solids(setting),
        )
        count = self._count(setting)
        runner.batch_size = count
        batch = drawn.select(np.arange(count))
        return Program(case, runner, batch)

    def _count(self, setting: Setting) -> int:
        usual = _pixels(self.study.measure, self.study.display)
        pixels = _pixels(setting.measure, setting.camera(self.study.display))
        fewer = max(_FEW_SESSIONS, 4 * self.sessions * usual // pixels)
        return min(self.sessions, fewer)

    def compiled(self, programs: Sequence[Program]) -> list[float]:
        """Run each program once, two at a time; seconds that each took."""

        def first_run(program: Program) -> float:
            self.source(program.case.setting)
            return self._run(program)[1]

        pool = ThreadPoolExecutor(min(2, os.cpu_count() or 1))
        try:
            return list(pool.map(first_run, programs))
        finally:
            # Whoever stops does not wait for what is still compiling.
            pool.shutdown(wait=False, cancel_futures=True)

    def timed(self, program: Program) -> tuple[Result, float]:
        """Return the result of a program, and the median of its seconds."""
        runs = [self._run(program)]
        while len(runs) < _RUNS and sum(seconds for _, seconds in runs) < _ENOUGH_S:
            runs.append(self._run(program))
        return runs[0][0], statistics.median(seconds for _, seconds in runs)

    def _run(self, program: Program) -> tuple[Result, float]:
        case, runner, batch = program
        source = self.source(case.setting)
        with _precision(case.setting):
            if case.setting.dtype == "float64":
                # The paths of float32, to the last bit.
                wide = lambda leaf: jnp.asarray(np.asarray(leaf, np.float64))
                batch = batch._replace(motion=jax.tree.map(wide, batch.motion))
            start = time.perf_counter()
            (result,) = runner.run([case.technique], source, batch)
        return result, time.perf_counter() - start


def _precision(setting: Setting) -> contextlib.AbstractContextManager:
    wide = setting.dtype == "float64"
    return jax.enable_x64(True) if wide else contextlib.nullcontext()


def _margin_deg(camera: Camera, batch: Batch) -> float:
    """Margin that a texture needs for some sessions, deg."""
    whole = Region.whole(camera)
    offsets = batch.motion.offset.reshape(-1, 3)
    bounds = jax.vmap(lambda r: camera_bounds.displacement_bound(camera, whole, r))(
        offsets
    )
    focal = float(camera.focal_px)
    edge = max(camera.width_px, camera.height_px) / 2 / focal
    # A pixel more: what is needed at one resolution is rounded up at another.
    beyond = edge + (float(jnp.max(bounds)) + 1) / focal
    return math.degrees(math.atan(beyond) - math.atan(edge))


def _pixels(measure: Measurement, camera: Camera) -> int:
    width, height = measure.block_size(camera)
    return measure.count * width * height
