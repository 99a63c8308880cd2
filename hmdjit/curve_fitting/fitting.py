"""Fitting blending curves: as little flicker as a loss of detail allows.

What is minimised is the mean over sessions and scenes of

    (MTCD / MTCD of none)^2 + weight (detail loss / that of none)
                            + lag weight (lag / detail loss of none),

none being no anti-aliasing, its means taken scene by scene. Each weight gives a point
of the front between flicker and detail; a bound on the detail loss is met by the weight
that it takes. Sessions have common random numbers, so what is left to chance is which
sessions were drawn: `errors` says how much that is.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .. import _checks
from ..estimates.estimate import MIN_BASELINE_MTCD
from ..head_motion import HeadMotion
from ..scenes.baking import bake
from ..scenes.base import AbstractScene
from ..scenes.solids import Solids
from ..simulation.session import fastest_reading
from ..simulation.sharding import mesh
from ..studies.identity import MODEL_VERSION
from ..studies.measured_blocks import Tiles
from ..studies.progress import Progress, Tell
from ..studies.runner import Runner
from ..studies.sessions import Batch, Sessions
from ..studies.store import fingerprint, without_version
from ..studies.study import Study
from ..technique_contract.base import AbstractTechnique
from ..techniques import SSAA, Freeze, HeadMovement, NoAntialiasing
from .front import FIRST_WEIGHT, FRONT_WEIGHTS, Front
from .problem import Problem
from .results import CurveFit, FrontPoint, Kept
from .search import NoFitError, Numbers
from .space import CurveSpace
from .viewing import TURN_DEG, Viewing, one_of, stacked, turned, values

LEAST_SESSIONS = 16
HELD_OUT_START, HELD_OUT_SESSIONS = 1 << 28, 128

_HALO_PX = 16
_PLAIN = (NoAntialiasing(), Freeze(), SSAA(4), HeadMovement())


def fit(
    study: Study,
    space: CurveSpace,
    *,
    detail_loss: float | None = None,
    lag_weight: float = 0.0,
    held_out: Mapping[str, AbstractScene] | None = None,
    seed: int = 0,
    journal: Path | None = None,
    progress: Tell = lambda event: None,
) -> CurveFit:
    """Fit a curve: the least flicker at no more than a given loss of detail.

    **Arguments:**

    - `study`: scenes, head, camera, sessions (at least 16), frames, warm-up and tiles
      (one per session); its techniques do not count.
    - `detail_loss`: relative to no anti-aliasing, mean over scenes, at most; None is
      that of Kim et al.'s constants on the same sessions. A bound beyond the front's
      end gives its end.
    - `lag_weight`: of the detail loss after a quick turn; 0 leaves it out.
    - `held_out`: scenes that are measured at the end but not fitted to.
    - `journal`: file in which finished searches are kept, to go on from; for the
      caller to remove once the result is safe.
    - `progress`: called before whatever takes long.

    **Errors:** `NoFitError`, a `ValueError`, where no curve can be fitted.
    """
    if without_version(study.scenes):  # what they compute with may have changed
        journal = None
        jax.clear_caches()
    sessions = _Measuring(study, space, lag_weight, seed, progress)
    bound = sessions.kim_detail_loss if detail_loss is None else detail_loss
    _checks.in_range("detail loss", bound, 0, open_low=True)
    key = fingerprint(
        [seed, lag_weight, space, study.sessions, study.frames, study.warmup],
        [study.display, study.head, study.measure, study.oversampling],
        [MODEL_VERSION, jax.__version__, jax.devices()[0].device_kind],
        [float(study.margin_deg), jnp.result_type(float).name],
        list(study.scenes.values()),
    )
    front = Front(sessions.problem, journal, key, progress)
    known = {FIRST_WEIGHT: front.first([np.asarray(start) for start in space.starts()])}
    known |= {weight: front.along(weight) for weight in FRONT_WEIGHTS}
    weight = front.within(bound)
    progress(Progress(doing="measuring how sure the curve is"))
    point, sure = front.polished(weight, bound)

    progress(Progress(doing="measuring held-out sessions"))
    technique = space.concrete(point)
    kept, none = sessions.held_out(technique)
    points = [
        FrontPoint(
            weight,
            space.concrete(known[weight].point),
            Kept.of(sessions.held_out_values(known[weight].point), none),
        )
        for weight in sorted(known)
    ]
    elsewhere = {}
    if held_out:
        sessions.look_at(held_out)
        elsewhere, _ = sessions.held_out(technique)
    return CurveFit(
        space,
        technique,
        weight,
        bound,
        np.asarray(space.natural(jnp.asarray(point))),
        sure,
        front.along(weight).why,
        front.steps,
        kept,
        elsewhere,
        points,
    )


class _Measuring:
    """The sessions and textures of one fit, and what techniques measure in them."""

    def __init__(
        self, study: Study, space: CurveSpace, lag_weight: float, seed: int, tell: Tell
    ):
        _checks.in_range("lag weight", lag_weight, 0)
        least = max(LEAST_SESSIONS, 2 * space.size)
        if study.sessions < least:
            raise NoFitError(
                f"sessions must be at least {least} to fit {space.size} numbers, "
                f"got {study.sessions}."
            )
        if not isinstance(study.head, HeadMotion):
            raise NoFitError("head must be a model, not recordings.")
        if not isinstance(study.measure, Tiles) or study.measure.count != 1:
            raise NoFitError("measure must be one tile per session to fit a curve.")
        pictures = {
            name: scene
            for name, scene in study.scenes.items()
            if isinstance(scene, AbstractScene) and not isinstance(scene, Solids)
        }
        if others := [name for name in study.scenes if name not in pictures]:
            raise NoFitError(
                f"scenes must be pictures to fit a curve, got {', '.join(others)}."
            )
        self._study, self._space, self._lag_weight = study, space, lag_weight
        self._tell = tell
        length = study.warmup + study.frames
        sessions = Sessions(
            seed, study.head, study.display, study.measure, HELD_OUT_START * 2, length
        )
        batch = sessions.batch(0, study.sessions)
        self._held_out = sessions.batch(HELD_OUT_START, HELD_OUT_SESSIONS)
        self._viewing = self._viewed(batch)
        self.look_at(pictures)
        none, kim = self._measured((_PLAIN[0], _PLAIN[-1]), batch)
        means = none.mean(axis=-1)
        for name, (mtcd, _) in zip(study.scenes, means, strict=True):
            if not mtcd > MIN_BASELINE_MTCD:
                raise NoFitError(
                    f"{name} flickers by {mtcd:.3g} code values without anti-aliasing, "
                    f"not more than {MIN_BASELINE_MTCD}: there is no flicker to remove."
                )
        self._none = means[:, None]
        self.kim_detail_loss = float(np.mean(kim[:, 1].mean(axis=-1) / means[:, 1]))

    def look_at(self, scenes: Mapping[str, AbstractScene]) -> None:
        """Bake scenes; their textures take the place of others."""
        baked = []
        for name, scene in scenes.items():
            self._tell(Progress(doing=f"baking {name}"))
            turn = TURN_DEG if self._lag_weight else 0.0
            texture = bake(
                scene,
                self._study.display,
                oversampling=self._study.oversampling,
                margin_deg=self._study.margin_deg + turn,
            )
            baked.append(texture)
        self._textures = stacked(baked)

    def problem(self, weight: float) -> Problem:
        """Return what is minimised; losses enter as roots: residuals are squared."""
        measures = 3 if self._lag_weight else 2
        weights = np.array([1.0, weight, self._lag_weight])[None, None, :measures]
        powers = np.array([1.0, 0.5, 0.5])[None, None, :measures]
        return Problem(
            self._space,
            self._textures,
            self._viewing,
            self._none[..., [0, 1, 1][:measures]],
            weights,
            powers,
            np.zeros((1, 1, 1)),
        )

    def held_out(self, fitted: AbstractTechnique) -> tuple[dict[str, Kept], np.ndarray]:
        """Return what techniques keep in held-out sessions, and what none measures."""
        measured = self._measured((*_PLAIN, fitted), self._held_out)
        ids = (*(technique.id for technique in _PLAIN), "fitted")
        kept = (Kept.of(each, measured[0]) for each in measured)
        return dict(zip(ids, kept, strict=True)), measured[0]

    def held_out_values(self, point: Numbers) -> Float[np.ndarray, "scenes 2 sessions"]:
        """MTCD and detail loss of a curve in held-out sessions."""
        viewing = self._viewed(self._held_out)
        at = jnp.asarray(point, viewing.motion.offset.dtype)
        found = values(self._space, at, self._textures, viewing)
        return np.moveaxis(np.asarray(found[..., :2], float), -1, 1)

    def _viewed(self, batch: Batch) -> Viewing:
        camera, warmup = self._study.display, self._study.warmup
        after = None
        if self._lag_weight:
            after = turned(batch, float(camera.refresh_hz), warmup).motion
        tile_px, _ = self._study.measure.block_size(camera)
        return Viewing(
            camera,
            jax.tree.map(jnp.asarray, batch.motion),
            jnp.asarray(batch.origins[:, 0]),
            after,
            warmup,
            tile_px,
            _HALO_PX,
            fastest_reading(),
            mesh(),
        )

    def _measured(
        self, techniques: Sequence[AbstractTechnique], batch: Batch
    ) -> Float[np.ndarray, "techniques scenes 2 sessions"]:
        """MTCD and detail loss in all scenes that there are textures of."""
        study = self._study
        runner = Runner(
            study.display, study.measure, techniques, study.warmup, batch.size, batch
        )
        scenes = range(len(self._textures.color_texels))
        by_scene = []
        for texture in (one_of(self._textures, scene) for scene in scenes):
            results = runner.run(techniques, texture, batch)
            by_scene.append([(r.mtcd, r.detail_loss) for r in results])
        found = np.swapaxes(by_scene, 0, 1)
        if not np.isfinite(found).all():
            raise NoFitError(
                "some sessions gave no finite number: a head that turns farther than "
                f"margin_deg = {study.margin_deg:g} from where it started does."
            )
        return found
