"""The envelope's runs: past samples, long recursions, sessions against float64."""

import functools
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .. import camera as pinhole
from .. import camera_bounds, quaternion, scenes
from ..camera import Camera, Region
from ..frames.displacement import GATHER
from ..frames.frame import Frame
from ..frames.motion import Motion, rebased_motion
from ..frames.sources import History, Texture
from ..head_motion import HeadMotion
from ..reprojection import past_position
from ..simulation.session import Result, differentiable_session
from ..techniques import HeadMovement, NoAntialiasing
from ..theory import prediction as theory
from ..theory.picture_statistics import PictureStatistics
from . import oracles as exact
from .cases import ANGLES
from .heads import RATES_HZ, TIMES_S
from .measuring import Bound, Run, Worst
from .poses import IDENTITY, poses_of, product, unit

_Rng = np.random.Generator
mp = exact.mp
_Found = tuple[float, str]
_SINGLE = "float32"


# --- where the past is ---


def past_samples(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Past samples against many digits, from any hold pose, up to 20 deg off it."""
    display = Camera(1024, 1024, 96.0, 60.0)
    frame = Frame(jnp.zeros((1, 3, 1, 1), dtype), display, Region(0, 0, 1, 1))
    camera, fov = exact.Pinhole(1024, 1024), np.array(mp.mpf(96), object)

    @jax.jit
    def moved(increment: Any, x0: Any, y0: Any) -> Any:
        at = eqx.tree_at(lambda f: (f.region.x0, f.region.y0), frame, (x0, y0))
        dx, dy = past_position(at, increment, 0.0).px()
        return jnp.stack([dx[0, 0], dy[0, 0]])

    worst = Worst()
    for n in range(15 if quick else 120):
        hold = unit(rng.normal(size=4))
        size = 10 ** rng.uniform(-7, -1)
        away = poses_of(0.35 * rng.random() * unit(rng.normal(size=3)))
        turned = product(away, poses_of(size * unit(rng.normal(size=3))))
        poses = product(hold, np.stack([IDENTITY, away, turned]))
        increment = rebased_motion(poses, dtype).increment[2]
        numbers = [np.array([mp.mpf(x) for x in pose], object) for pose in poses[1:]]
        turn = exact.log(exact.relative(*numbers))
        for _ in range(2):
            x0, y0 = (int(i) for i in rng.choice([0, 100, 511, 1023], 2))
            ours = np.asarray(moved(increment, jnp.int32(x0), jnp.int32(y0)))
            place = [np.array(mp.mpf(i) + mp.mpf(1) / 2, object) for i in (x0, y0)]
            oracle = camera.displacement(fov, turn, *place)
            error = max(
                abs(float(a - mp.mpf(float(b))))
                for a, b in zip(oracle, ours, strict=True)
            )
            worst.add(error, f"{size!r} rad at pixel ({x0}, {y0}), draw {n}")
    return worst.found


def ranges(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """How far a displacement lies outside `displacement_range`, px: never."""
    worst = Worst()
    angles = [*ANGLES, *10 ** rng.uniform(-9, 0, 20)]
    region = Region(100, 0, 64, 48)
    corners = np.stack([[100.0, 164.0, 132.0, 100.5], [0.0, 48.0, 24.0, 47.5]])

    @jax.jit
    def both(fov: Any, rotation: Any) -> Any:
        display = Camera(640, 480, fov, 60.0)
        span = camera_bounds.displacement_range(display, region, rotation)
        moved = pinhole.displacement(display, rotation, *jnp.asarray(corners, dtype))
        return span, jnp.stack(moved[:2]), moved[2]

    for n, angle in enumerate(angles[:: 1 + quick]):
        fov, rotation = (
            (0.1, 16.0, 96.0, 170.0)[n % 4],
            angle * unit(rng.normal(size=3)),
        )
        span, moved, in_front = map(
            np.asarray, both(*(jnp.asarray(x, dtype) for x in (fov, rotation)))
        )
        beyond = np.maximum(span[0][:, None] - moved, moved - span[1][:, None])
        error = float(np.max(np.where(in_front, beyond, -np.inf), initial=0.0))
        worst.add(abs(error), f"{angle!r} rad at {fov} deg")
    return worst.found


# --- long runs ---


def composition(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Drift of the norm of a million poses, one composed from the other."""
    count = 100_000 if quick else 1_000_000
    turns = jnp.asarray(poses_of(1e-3 * rng.normal(size=(count, 3))), dtype)

    @jax.jit
    def composed(turns: Any) -> Any:
        advance = lambda q, turn: (quaternion.multiply(q, turn), None)
        start = jnp.asarray([1.0, 0, 0, 0], turns.dtype)
        return jax.lax.scan(advance, start, turns)[0]

    def log_size(q: Any) -> Any:
        return np.log1p(np.sum(np.square(np.asarray(q, np.float64)), -1) - 1) / 2

    # The turns' own lengths are off 1 by rounding: what they make of it is no drift.
    drift = log_size(composed(turns)) - math.fsum(log_size(turns))
    return abs(float(drift)), f"{count} compositions"


def still_path(rng: _Rng, frames: int, turn_rad: float) -> np.ndarray:
    """Rotation vectors of a head that wanders within some 20 turns."""
    noise = turn_rad * rng.normal(size=(frames, 3))
    path = np.zeros((frames, 3))
    for k in range(1, frames):
        path[k] = 0.995 * path[k - 1] + noise[k]
    return path


@functools.cache
def texture_of_noise() -> tuple[Camera, Texture]:
    """Return a small camera, and noise that is baked for it."""
    display = Camera(48, 48, 6.0, 60.0)
    scene = scenes.power_law_noise(size=64)
    return display, scenes.bake(scene, display, oversampling=1, margin_deg=6.0)


@functools.cache
def _session(warmup: int) -> Any:
    return jax.jit(differentiable_session(warmup, GATHER))


def _measured(path: np.ndarray, dtype: str, technique: Any, warmup: int = 0) -> Result:
    display, texture = texture_of_noise()
    texture = jax.tree.map(lambda x: x.astype(dtype), texture)
    region = Region(16, 16, 12, 12)
    motion = rebased_motion(poses_of(path), dtype)
    found = _session(warmup)(texture, display, technique, motion, region, region)
    return jax.tree.map(float, found)


def long_session(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Flicker and detail loss of half an hour against float64, relative."""
    frames = 5_000 if quick else 100_000
    path = still_path(rng, frames, 3e-4)
    ours = _measured(path, dtype, HeadMovement())
    oracle = _measured(path, "float64", HeadMovement())
    worst = Worst()
    for name in ("mtcd", "detail_loss"):
        expected = getattr(oracle, name)
        worst.add(abs(getattr(ours, name) / expected - 1), f"{name}, {frames} frames")
    return worst.found


def after_warmup(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """MTCD of two frames after a long warm-up against float64, relative."""
    warmup = 3_000 if quick else 100_000
    path = still_path(rng, warmup + 2, 3e-4)
    ours, oracle = (
        _measured(path, d, HeadMovement(), warmup).mtcd for d in (dtype, "float64")
    )
    return float(abs(ours / oracle - 1)), f"{warmup} frames of warm-up"


def memory(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Bytes that a session works with, per frame, beyond the path that it is given."""
    del rng, quick
    display, texture = texture_of_noise()
    texture = jax.tree.map(lambda x: x.astype(dtype), texture)
    region = Region(16, 16, 12, 12)
    sizes = []
    for frames in (1_000, 100_000):
        motion = Motion(*[jnp.zeros((frames, 3), dtype)] * 2)
        given = (texture, display, HeadMovement(), motion, region, region)
        compiled = _session(0).lower(*given).compile()
        sizes.append(compiled.memory_analysis().temp_size_in_bytes)
    return (sizes[1] - sizes[0]) / 99_000, f"{sizes[1]} bytes for 100000 frames"


def recursion(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Drift of a still scene's mean over 1e5 blends, against its own, relative."""
    frames = 5_000 if quick else 100_000
    display, technique = Camera(32, 24, 4.0, 60.0), HeadMovement(w_min=0.05, w_lb=0.05)
    grey = jnp.full((1, 3, 24, 32), 0.3, dtype)
    turns = jnp.asarray(1e-4 * rng.normal(size=(frames, 3)), dtype)

    @jax.jit
    def shown(grey: Any, turns: Any) -> Any:
        frame = Frame(grey, display, Region.whole(display))
        start = History.of(technique.init(frame).texels[0, 0] * 1.01)
        step = lambda state, r: (technique.step(state, frame, Motion(r, r))[0], None)
        return jax.lax.scan(step, start, turns)[0].texels

    found = np.asarray(shown(grey, turns), np.float64)
    error = np.max(np.abs(found / float(grey[0, 0, 0, 0]) - 1))
    return float(error), f"{frames} blends from a picture 1 % too bright"


# --- sessions ---


def small_motion(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """MTCD against float64, code values, from 1e-8 to 1e-2 rad per frame."""
    worst = Worst()
    for technique in (HeadMovement(), NoAntialiasing()):
        for size in (0.0, *10.0 ** np.arange(-8, -1.9, 2 if quick else 0.5)):
            path = np.clip(still_path(rng, 12, size), -0.06, 0.06)
            ours, oracle = (
                _measured(path, d, technique).mtcd for d in (dtype, "float64")
            )
            worst.add(
                float(abs(ours - oracle)), f"{technique.id} at {size!r} rad per frame"
            )
    return worst.found


def predictions(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """`theory.predict` against float64, relative."""
    display, texture = texture_of_noise()
    statistics = PictureStatistics.of(texture, display, cell_px=48)
    worst, predict = Worst(), jax.jit(theory.predict)
    for size in (*10.0 ** np.arange(-8, -1.9, 2 if quick else 1),):
        path = poses_of(still_path(rng, 12, size))
        found = []
        for d in (dtype, "float64"):
            cast = jax.tree.map(lambda x, d=d: jnp.asarray(x, d), statistics)
            motion = rebased_motion(path, d)
            found.append(float(predict(cast, display, HeadMovement(), motion)[0]))
        worst.add(abs(found[0] / found[1] - 1), f"{size!r} rad per frame")
    return worst.found


def baking(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Smooth scenes painted in a dtype against float64, code values."""
    del rng, quick
    display, worst = Camera(256, 16, 96.0, 60.0), Worst()
    for scene in (scenes.power_law_noise(size=64), scenes.almost_uniform()):
        painted = [
            np.asarray(
                scenes.bake(scene, display, oversampling=1, dtype=d).color, float
            )
            for d in (dtype, "float64")
        ]
        worst.add(255 * float(np.max(np.abs(painted[0] - painted[1]))), scene.name)
    return worst.found


def drawn_heads(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Poses that are no unit quaternions, at all rates and times."""
    worst = Worst()
    for frames in (1, 2, 50) if quick else (1, 2, 50, 100_000):
        draw = jax.jit(
            lambda key, head, rate, frames=frames: head.sample(
                key, rate, frames, dtype=dtype
            )
        )
        for n, (time, back) in enumerate((a, b) for a in TIMES_S for b in TIMES_S):
            rate, key = RATES_HZ[n % 5], jax.random.key(int(rng.integers(2**31)))
            numbers = [jnp.asarray(x, dtype) for x in (time, back, rate)]
            head = HeadMotion((1.0,) * 3, (numbers[0],) * 3, (0.01,) * 3, numbers[1])
            poses = np.asarray(draw(key, head, numbers[2]), float)
            bad = np.sum(~(np.abs(np.linalg.norm(poses, axis=1) - 1) < 1e-5))
            worst.add(float(bad), f"times {time:g}, {back:g} s at {rate:g} Hz")
            if n > 10 and (quick or frames > 50):
                break
    return worst.found


def _one(value: float) -> dict[str, Bound]:
    return {_SINGLE: Bound(value)}


def runs() -> list[Run]:
    """All of them."""
    none = {"float32": Bound(0.0), "float64": Bound(0.0)}
    half_hour = "1e5 frames: half an hour at 60 Hz"
    return [
        Run(
            "reprojection.past_position",
            "1e-7 to 0.1 rad per frame, any hold pose, up to 20 deg off it",
            past_samples,
            # What is asked for; 2.6e-5 px is found in float32.
            {"float32": Bound(1e-3), "float64": Bound(1e-11)},
            "px",
        ),
        Run(
            "camera.displacement_range",
            "0 to pi rad, 0.1 to 170 deg",
            ranges,
            none,
            "px",
        ),
        Run(
            "quaternion.multiply, composed",
            "1e6 in a row: drift of the length",
            composition,
            # Roundings add up, at most one eps each; poses are taken to 1 % of length.
            {"float32": Bound(0.01), "float64": Bound(1e6 * 2.0**-52)},
            "relative",
        ),
        Run(
            "blending, in a loop",
            "1e5 frames: drift of the mean",
            recursion,
            # A step of w times the rest is lost below half an ulp: eps / 2 w, twice.
            _one(2.0**-23 / 0.05),
            "relative",
        ),
        # Sums that are not compensated err by 2e-6.
        Run("simulate", half_hour, long_session, _one(3e-7), "relative"),
        Run(
            "simulate, memory",
            f"1e3 to {half_hour}",
            memory,
            # A few vectors per frame; a picture that were kept would have 1,728.
            _one(256.0),
            "bytes per frame",
            is_slow=True,
        ),
        Run(
            "simulate, warm-up",
            "1e5 frames of warm-up, 2 measured",
            after_warmup,
            _one(1e-4),
            "relative",
            is_slow=True,
        ),
        Run(
            "simulate, small motion",
            "0, 1e-8 to 1e-2 rad per frame",
            small_motion,
            _one(2e-5),
            "code values",
            is_slow=True,
        ),
        Run(
            "theory.predict",
            "1e-8 to 1e-2 rad per frame",
            predictions,
            _one(4e-6),
            "relative",
            is_slow=True,
        ),
        Run(
            "scenes.bake",
            "smooth scenes, 96 deg",
            baking,
            _one(0.02),
            "code values",
            is_slow=True,
        ),
        Run(
            "HeadMotion.sample",
            "1 to 10,000 Hz, times 1e-6 to 1e6 s, 1 to 1e5 frames",
            drawn_heads,
            none,
            "poses",
            is_slow=True,
        ),
    ]
