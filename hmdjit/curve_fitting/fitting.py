"""Fitting blending curves: as little flicker as a loss of detail allows.

What is minimised is the mean over sessions and scenes of

    (MTCD / MTCD of none)^2 + weight (detail loss / that of none)
                            + lag weight (lag / detail loss of none),

none being no anti-aliasing, its means taken scene by scene. Each weight gives a point
of the front between flicker and detail; a bound on the detail loss is met by the weight
that it takes. Sessions have common random numbers, so what is left to chance is which
sessions were drawn: `errors` says how much that is.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jaxtyping import Float

from .. import _checks
from ..estimates.estimate import MIN_BASELINE_MTCD
from ..frames.sources import Texture
from ..head_motion import HeadMotion
from ..scenes.baking import bake
from ..scenes.base import AbstractScene
from ..simulation.session import fastest_reading
from ..simulation.sharding import mesh, placed
from ..studies.identity import MODEL_VERSION
from ..studies.measured_blocks import Tiles
from ..studies.progress import Progress, Tell
from ..studies.runner import Runner
from ..studies.sessions import Batch, Sessions
from ..studies.store import fingerprint
from ..studies.study import Study
from ..techniques import SSAA, Freeze, HeadMovement, NoAntialiasing
from ..techniques.base import AbstractTechnique
from .errors import errors, newton_step
from .measuring import TURN_DEG, Viewing, turned, values, values_and_slopes
from .results import CurveFit, FrontPoint, Kept
from .search import Found, Journal, NoFitError, Numbers, least_squares
from .space import CurveSpace

FIRST_WEIGHT = 0.1
FRONT_WEIGHTS = (0.3, 1.0, 0.03, 0.01)
"""Weights of detail loss along the front, after the first, in the order of search."""

LEAST_SESSIONS = 16
HELD_OUT_START, HELD_OUT_SESSIONS = 1 << 28, 128

_HALO_PX = 16
_START_STEPS, _MOST_STEPS = 3, 6  # a last step is Newton's own
_BOUND_TOLERANCE = 2e-3  # by how much a bound on the detail loss may be passed
_TOLERANCE = 5e-3  # of a search, before Newton's step
_DIFFERENCE = 0.02  # step of the differences that give curvatures, logits


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
    - `progress`: called before each step.

    **Errors:** `NoFitError`, a `ValueError`, where no curve can be fitted.
    """
    fitter = _Fitter(study, space, lag_weight, seed, journal, progress)
    return fitter.fit(detail_loss, dict(held_out or {}))


class _Fitter:
    """One fit: its sessions, textures and all points that were measured."""

    def __init__(
        self,
        study: Study,
        space: CurveSpace,
        lag_weight: float,
        seed: int,
        journal: Path | None,
        tell: Tell,
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
        self.study, self.space, self.lag_weight = study, space, lag_weight
        self.tell, self.seed = tell, seed
        camera, length = study.display, study.warmup + study.frames
        sessions = Sessions(
            seed, study.head, camera, study.measure, HELD_OUT_START * 2, length
        )
        self.batch = sessions.batch(0, study.sessions)
        self.held_out = sessions.batch(HELD_OUT_START, HELD_OUT_SESSIONS)
        self.plain = (NoAntialiasing(), Freeze(), SSAA(4), HeadMovement())
        self.viewing = self._viewing(self.batch, study.measure.size_px)
        self._journal = Journal(
            journal,
            fingerprint(
                [seed, lag_weight, space, study.sessions, study.frames, study.warmup],
                [study.display, study.head, study.measure, study.oversampling],
                [MODEL_VERSION, jax.__version__, jax.devices()[0].device_kind],
                [float(study.margin_deg), jnp.result_type(float).name],
                list(study.scenes.values()),
            ),
        )
        self.textures = [self._texture(n, scene) for n, scene in study.scenes.items()]
        self._measured: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}
        self.scales, self.kim_detail_loss = self._scales()

    def _viewing(self, batch: Batch, tile_px: int) -> Viewing:
        camera, warmup = self.study.display, self.study.warmup
        after = None
        if self.lag_weight:
            after = turned(batch, float(camera.refresh_hz), warmup).motion
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

    def _texture(self, name: str, scene: AbstractScene) -> Texture:
        self.tell(Progress(doing=f"baking {name}"))
        turn = TURN_DEG if self.lag_weight else 0.0
        texture = bake(
            scene,
            self.study.display,
            oversampling=self.study.oversampling,
            margin_deg=self.study.margin_deg + turn,
        )
        return placed(texture)

    def _scales(self) -> tuple[Float[np.ndarray, "scenes 2"], float]:
        """Mean MTCD and detail loss of none in each scene; detail loss of Kim et al."""
        none, kim = self._measure((self.plain[0], self.plain[-1]), self.batch)
        scales = none.mean(axis=-1)
        for name, (mtcd, _) in zip(self.study.scenes, scales, strict=True):
            if not mtcd > MIN_BASELINE_MTCD:
                raise NoFitError(
                    f"{name} flickers by {mtcd:.3g} code values without anti-aliasing, "
                    f"not more than {MIN_BASELINE_MTCD}: there is no flicker to remove."
                )
        return scales, float(np.mean(kim[:, 1].mean(axis=-1) / scales[:, 1]))

    def _measure(
        self, techniques: Sequence[AbstractTechnique], batch: Batch
    ) -> Float[np.ndarray, "techniques scenes 2 sessions"]:
        """MTCD and detail loss in all scenes that there are textures of."""
        study = self.study
        runner = Runner(
            study.display, study.measure, techniques, study.warmup, batch.size, batch
        )
        results = [[runner.run(t, s, batch) for s in self.textures] for t in techniques]
        found = np.array([[(r.mtcd, r.detail_loss) for r in row] for row in results])
        if not np.isfinite(found).all():
            raise NoFitError(
                "some sessions gave no finite number: a head that turns farther than "
                f"margin_deg = {study.margin_deg:g} from where it started does."
            )
        return found

    # --- measuring a point ---

    def _at(self, point: Numbers) -> Numbers:
        """Return a point in the precision of the sessions."""
        return np.asarray(point, self.viewing.motion.offset.dtype)

    def measured(self, point: Numbers) -> tuple[np.ndarray, np.ndarray]:
        """Relative measures and slopes, `(scenes, sessions, measures[, numbers])`."""
        point = self._at(point)
        name = point.tobytes()
        if name not in self._measured:
            found, slopes = [], []
            for texture, (mtcd, loss) in zip(self.textures, self.scales, strict=True):
                value, slope = values_and_slopes(
                    self.space, jnp.asarray(point), texture, self.viewing
                )
                unit = np.array([mtcd, loss, loss])[: value.shape[-1]]
                found.append(np.asarray(value, float) / unit)
                slopes.append(np.asarray(slope, float) / unit[:, None])
            self._measured[name] = np.stack(found), np.stack(slopes)
            mean = self._measured[name][0].mean(axis=(0, 1))
            lag = f", lag {mean[2]:.3f}" if len(mean) > 2 else ""
            doing = (
                f"step {len(self._measured)}: flicker {mean[0]:.3f}, "
                f"detail loss {mean[1]:.3f}{lag} of no anti-aliasing"
            )
            self.tell(Progress(doing=doing))
        return self._measured[name]

    def linearized(self, point: Numbers, weight: float) -> tuple[np.ndarray, ...]:
        """Residuals of each scene, session and measure, and their slopes.

        Flicker enters as it is, losses as their roots, for residuals are squared.
        """
        found, slopes = self.measured(point)
        losses = np.array([weight, self.lag_weight])[: found.shape[-1] - 1]
        is_used = losses > 0
        root = np.sqrt(np.maximum(losses * found[..., 1:], 1e-12))
        of_root = losses[:, None] / (2 * root[..., None]) * slopes[..., 1:, :]
        residuals = np.concatenate([found[..., :1], root[..., is_used]], axis=-1)
        of_all = np.concatenate([slopes[..., :1, :], of_root[..., is_used, :]], axis=-2)
        share = 1 / math.sqrt(found.shape[0] * found.shape[1])
        return share * residuals, share * of_all

    def detail_loss(self, point: Numbers) -> float:
        """Mean detail loss of a point on the sessions that are fitted to."""
        return float(self.measured(point)[0][..., 1].mean())

    def flicker(self, point: Numbers) -> float:
        """Mean flicker of a point on the sessions that are fitted to."""
        return float(self.measured(point)[0][..., 0].mean())

    # --- searching ---

    def search(self, weight: float, start: Numbers, most_steps: int) -> Found:
        """Best point for a weight; one that was found before is taken."""

        def linearize(point: Numbers) -> tuple[np.ndarray, np.ndarray]:
            residuals, slopes = self.linearized(point, weight)
            return residuals.reshape(-1), slopes.reshape(-1, slopes.shape[-1])

        return least_squares(
            linearize, start, tolerance=_TOLERANCE, most_steps=most_steps
        )

    def along_front(self, weight: float, known: dict[float, Found]) -> Found:
        """Best point for a weight, from the nearest of the front so far."""
        if weight in known:
            return known[weight]
        found = self._journal.find(weight)
        if found is None:
            near = min(known, key=lambda other: abs(math.log(other / weight)))
            found = self.search(weight, known[near].point, _MOST_STEPS)
            self._journal.keep(weight, found)
        known[weight] = found
        return found

    def first(self) -> Found:
        """Best point for the first weight, from the best of several starts."""
        found = self._journal.find(FIRST_WEIGHT)
        if found is None:
            starts = [np.asarray(start) for start in self.space.starts()]
            tried = [self.search(FIRST_WEIGHT, s, _START_STEPS) for s in starts]
            best = min(tried, key=lambda found: found.cost)
            found = self.search(FIRST_WEIGHT, best.point, 2 * _MOST_STEPS)
            self._journal.keep(FIRST_WEIGHT, found)
        return found

    def bounded(self, bound: float, known: dict[float, Found]) -> float:
        """Weight at which the detail loss is at its bound, or not far below."""

        def excess(log_weight: float) -> float:
            weight = float(f"{math.exp(log_weight):.6g}")  # known ones are found
            point = self.along_front(weight, known).point
            return math.log(self.detail_loss(point) / bound)

        losses = {w: self.detail_loss(known[w].point) for w in known}
        for weight in (3.0, 10.0, 30.0):
            if min(losses.values()) <= bound:
                break
            losses[weight] = self.detail_loss(self.along_front(weight, known).point)
        if min(losses.values()) > bound:
            raise NoFitError(
                f"detail loss must be at least {min(losses.values()):.3f} times that "
                f"of no anti-aliasing, the least that this family reaches, got "
                f"{bound:g}."
            )
        around = [
            pair
            for pair in itertools.pairwise(sorted(losses))
            if losses[pair[0]] > bound >= losses[pair[1]]
        ]
        if around:
            ends = [math.log(weight) for weight in around[0]]
            scipy.optimize.brentq(excess, *ends, xtol=0.02, maxiter=6, disp=False)
        allowed = bound * (1 + _BOUND_TOLERANCE)
        good = [w for w in known if self.detail_loss(known[w].point) <= allowed]
        return min(good, key=lambda w: self.flicker(known[w].point))

    # --- what came out ---

    def polished(self, point: Numbers, weight: float, bound: float) -> tuple:
        """Take Newton's step from a point; return the point and its `Errors`.

        Curvatures are differences of each session's gradient: where residuals do not
        vanish, Gauss and Newton's are too steep.
        """

        def gradients(at: Numbers) -> np.ndarray:
            residuals, slopes = self.linearized(at, weight)
            return 2 * np.einsum("csm,csmp->sp", residuals, slopes)

        def cost(at: Numbers) -> float:
            return float(np.sum(np.square(self.linearized(at, weight)[0])))

        here = gradients(point)
        columns = []
        for axis in np.eye(len(point)):
            columns.append((gradients(point + _DIFFERENCE * axis) - here) / _DIFFERENCE)
        curvatures = np.stack(columns, axis=-1)
        newton = point + newton_step(here, curvatures)
        if cost(newton) < cost(point) and self.detail_loss(newton) <= bound:
            point, here = newton, gradients(newton)
        return point, errors(self.space, point, here, curvatures)

    def of_front(
        self, points: Sequence[Numbers]
    ) -> list[Float[np.ndarray, "scenes 2 sessions"]]:
        """MTCD and detail loss of curves in held-out sessions."""
        viewing = self._viewing(self.held_out, self.viewing.tile_px)
        found = []
        for point in points:
            at = jnp.asarray(self._at(point))
            each = [values(self.space, at, t, viewing)[:, :2].T for t in self.textures]
            found.append(np.stack(each).astype(float))
        return found

    def fit(
        self, detail_loss: float | None, held_out: dict[str, AbstractScene]
    ) -> CurveFit:
        bound = self.kim_detail_loss if detail_loss is None else detail_loss
        _checks.in_range("detail loss", bound, 0, open_low=True)
        known = {FIRST_WEIGHT: self.first()}
        for weight in FRONT_WEIGHTS:
            self.along_front(weight, known)
        weight = self.bounded(bound, known)
        self.tell(Progress(doing="measuring how sure the curve is"))
        point, sure = self.polished(
            known[weight].point, weight, bound * (1 + _BOUND_TOLERANCE)
        )

        self.tell(Progress(doing="measuring held-out sessions"))
        technique = self.space.concrete(point)
        named = (*self.plain, technique)
        ids = (*(t.id for t in self.plain), "fitted")
        measured = self._measure(named, self.held_out)
        none = measured[0]
        kept = [Kept.of(each, none) for each in measured]
        weights = sorted((FIRST_WEIGHT, *FRONT_WEIGHTS))
        points = [known[w].point for w in weights]
        front = [
            FrontPoint(weight, self.space.concrete(point), Kept.of(each, none))
            for weight, point, each in zip(
                weights, points, self.of_front(points), strict=True
            )
        ]
        self.textures = [self._texture(n, scene) for n, scene in held_out.items()]
        elsewhere = []
        if held_out:
            measured = self._measure(named, self.held_out)
            elsewhere = [Kept.of(each, measured[0]) for each in measured]
        return CurveFit(
            self.space,
            technique,
            weight,
            bound,
            np.asarray(self.space.natural(jnp.asarray(point))),
            sure,
            known[weight].why,
            len(self._measured),
            dict(zip(ids, kept, strict=True)),
            dict(zip(ids, elsewhere, strict=bool(elsewhere))),
            front,
        )
