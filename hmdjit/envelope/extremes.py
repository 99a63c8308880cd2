"""The envelope's extremes of whole sessions: gradients, and what is out of range.

Every technique's numbers at the ends of their ranges, pictures that are black, equal,
one pixel wide or far brighter than white, and heads at rest, at the fastest blended
speed up to rounding, and turned so far that nothing seen before is in view: all
gradients must be numbers. What is out of range must not spread.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .. import metrics, quaternion, scenes
from ..camera import Camera, Region
from ..frames.displacement import GATHER
from ..frames.motion import Motion
from ..head_motion import HeadMotion
from ..head_motion.parameters import Amplitude, Resonator
from ..simulation import apply as clips
from ..simulation.simulate import simulate
from ..techniques import SSAA, HeadMovement, NoAntialiasing
from ..theory import prediction as theory
from ..theory.picture_statistics import PictureStatistics
from .heads import RATES_HZ, TIMES_S
from .measuring import Bound, Run, Worst
from .poses import poses_of
from .runs import still_path, texture_of_noise

_Rng = np.random.Generator
_Found = tuple[float, str]

SIZES = ((4, 5), (1, 1), (1, 6), (6, 1))
"""Height and width of pictures, px."""

TURNS_RAD = (0.0, 1e-30, 1e-12, 1e-7, 1e-4, 1e-2, 1.0, np.pi / 2, np.pi - 1e-6, np.pi)

_AXIS = (0.1, 1.0, 0.0)
_LENGTH = np.hypot(0.1, 1.0)
_LEVELS = (0.0, 1e-30, 1e-8, 0.5, 1.0, 1e6)


def bad_leaves(tree: Any) -> int:
    """How many numbers of a pytree are not finite."""
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(tree)]
    return int(sum(np.sum(~np.isfinite(leaf)) for leaf in leaves))


def techniques() -> dict[str, list[HeadMovement]]:
    """Head movement with its numbers at their ends; one structure each."""
    numbers: list[dict[str, Any]] = [
        *({}, {"w_min": 0.0, "w_lb": 0.0}, {"w_min": 1.0, "w_lb": 1.0}),
        *({"w_min": 1.0, "w_lb": 0.0}, {"w_min": 0.3, "w_lb": 0.3}),
        *({"h_max_deg_s": 1e-20}, {"h_max_deg_s": 1e20}, {"h_max_deg_s": 1e-6}),
        *({"closeness": (0.0,)}, {"closeness": (1.0,)}, {"closeness": (1e-8,)}),
    ]
    sixteen: dict[str, Any] = {"closeness": (2 / 3,) * 16}
    distinct: dict[str, Any] = {"closeness": tuple(np.linspace(0, 1, 16).tolist())}
    none: dict[str, Any] = {"closeness": (0.0,) * 16}
    return {
        "one past sample": [HeadMovement(**kinds) for kinds in numbers],
        "sixteen": [HeadMovement(**kinds) for kinds in (sixteen, distinct, none)],
        "weights": [HeadMovement(closeness=(0.2, 0.7), weights=(1.0, 0.0))],
        "largest channel": [HeadMovement(difference="max_channel")],
        "same pixel": [HeadMovement(difference="same_pixel")],
        "linear light": [HeadMovement(space="linear")],
        "over SSAA": [HeadMovement(resolve=SSAA(2))],
    }


def _poses(turn_rad: Any) -> Any:
    """Two equal turns after the hold pose, about yaw and a little pitch."""
    step = quaternion.exp(jnp.stack([part * turn_rad for part in _AXIS]))
    first = jnp.zeros_like(step).at[0].set(1.0)
    return jnp.stack([first, step, quaternion.multiply(step, step)])


def _pictures(rng: _Rng, size: tuple[int, int]) -> Iterator[tuple[str, np.ndarray]]:
    shape = (3, *size, 3)
    for level in _LEVELS:
        yield f"equal frames of {level:g}", np.full(shape, level)
        yield f"frames up to {level:g}", level * rng.random(shape)


def clip_gradients(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Count what is not finite among values and gradients of `apply`'s MTCD."""
    worst = Worst()

    @jax.jit
    @jax.value_and_grad
    def flicker(arguments: tuple) -> Any:
        technique, camera, frames, turn_rad = arguments
        samples = technique.sample_offsets_px.shape[1]
        if samples > 1:
            frames = jnp.broadcast_to(frames[:, None], (3, samples, *frames.shape[1:]))
        return metrics.mtcd(clips.apply(technique, camera, frames, _poses(turn_rad)))

    for name, members in techniques().items():
        is_first = name == "one past sample"
        if quick and not is_first:
            break
        for size in SIZES[: None if is_first and not quick else 1]:
            for n, technique in enumerate(members):
                turns = TURNS_RAD if not quick else TURNS_RAD[n % 2 :: 2]
                for k, turn in enumerate(turns):
                    pictures = list(_pictures(rng, size))
                    said, frames = pictures[(7 * n + 5 * k) % len(pictures)]
                    fov = (0.1, 16.0, 96.0, 179.9)[(n + k) % 4]
                    speed = float(technique.h_max_deg_s)
                    if k % 3 == 2 and 1e-6 < speed < 1e6:  # at h_max, up to rounding
                        turn = np.deg2rad(speed / 60.0) / _LENGTH
                    camera = Camera(size[1], size[0], fov, 60.0)
                    given = jax.tree.map(
                        lambda x: jnp.asarray(x, dtype),
                        (technique, camera, frames, turn),
                    )
                    bad = bad_leaves(flicker(given))
                    place = f"{size[1]} x {size[0]} px, {fov} deg, {turn!r} rad"
                    worst.add(float(bad), f"{name} {n}: {said}, {place}")
    return worst.found


def session_gradients(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Count them of `simulate`, of 2 and 3 frames, at rest and in motion."""
    display = Camera(24, 20, 12.0, 60.0)
    scene = scenes.power_law_noise(size=32)
    texture = scenes.bake(scene, display, oversampling=1, dtype=jnp.dtype(dtype))
    worst = Worst()

    @eqx.filter_jit
    def found(arguments: tuple, texture: Any, frames: int) -> Any:
        def loss(arguments: tuple) -> Any:
            technique, camera, turn_rad = arguments
            poses = _poses(turn_rad)[:frames]
            region = Region(4, 4, 8, 8)
            result = simulate(
                texture, camera, technique, poses, region=region, reading=GATHER
            )
            return result.mtcd + result.detail_loss

        return jax.value_and_grad(loss)(arguments)

    for frames in (2, 3):
        members = techniques()["one past sample"]
        for n, technique in enumerate(members[:: 3 if quick else 1]):
            for turn in (0.0, 1e-30, 1e-12, 1e-7, 1e-4, 1e-2):
                given = jax.tree.map(
                    lambda x: jnp.asarray(x, dtype), (technique, display, turn)
                )
                bad = bad_leaves(found(given, texture, frames))
                where = f"numbers {n}, {frames} frames, {turn!r} rad"
                worst.add(float(bad), where)
    return worst.found


def prediction_gradients(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Count them of `theory.predict`, at rest and in motion, of any memory."""
    del rng
    display, texture = texture_of_noise()
    statistics = PictureStatistics.of(texture, display, cell_px=48)
    worst = Worst()

    @partial(jax.jit, static_argnames="memory")
    @jax.value_and_grad
    def flicker(arguments: tuple, memory: int) -> Any:
        statistics, technique, turn_rad = arguments
        motion = Motion.of(_poses(turn_rad))
        found = theory.predict(statistics, display, technique, motion, memory=memory)
        return jnp.mean(found)

    members = techniques()["one past sample"][:: 3 if quick else 1]
    for technique in (NoAntialiasing(), *members):
        for turn in TURNS_RAD:
            for memory in (0, 4):
                given = jax.tree.map(
                    lambda x: jnp.asarray(x, dtype), (statistics, technique, turn)
                )
                bad = bad_leaves(flicker(given, memory))
                worst.add(float(bad), f"{technique!r}, memory {memory}, {turn!r} rad")
    return worst.found


def _heads(quick: bool) -> Iterator[tuple[HeadMotion, float]]:
    """Heads at rest, slow, stiff, resonant, in bursts, and a rate each, Hz."""
    pairs = [(a, b) for a in TIMES_S for b in TIMES_S]
    for n, (time, back) in enumerate(pairs[:: 5 if quick else 1]):
        rate = RATES_HZ[n % 5]
        frequency = (3.0, rate / 2, rate, 1e-2)[n % 4]
        damping = (1.0, 1e-3, 2.0)[n % 3]
        for speed, noise in ((0.0, 0.0), (1.0, 0.0), (0.0, 0.01), (1e-30, 0.0)):
            swing = speed * (n // 4 % 2)  # half of the heads have no moving mode
            mode = Resonator((swing,) * 3, (frequency,) * 3, (damping,) * 3)
            bursts = Amplitude((0.0, 0.5)[n // 8 % 2], time)
            per_axis = (speed,) * 3, (time,) * 3, (noise,) * 3
            yield (
                HeadMotion(*per_axis, back, (0.2, 0.0)[n // 8 % 2], (mode,), bursts),
                rate,
            )


def _of_heads(score: Callable) -> Callable[[_Rng, str, bool], _Found]:
    """Count what is not finite of a head's score, at a rate and with a key."""

    def measure(rng: _Rng, dtype: str, quick: bool) -> _Found:
        del rng
        slopes, worst = jax.jit(jax.value_and_grad(score, (0, 1))), Worst()
        for n, (head, rate) in enumerate(_heads(quick)):
            given = jax.tree.map(lambda x: jnp.asarray(x, dtype), (head, rate))
            bad = bad_leaves(slopes(*given, jax.random.key(n)))
            worst.add(float(bad), f"{head!r} at {rate:g} Hz")
        return worst.found

    return measure


def _laws(head: HeadMotion, rate: Any, key: Any) -> Any:
    del key
    return (
        head.increment_rms_deg(rate)
        + jnp.sum(head.increment_covariance(1, rate))
        + jnp.sum(head.velocity_spectrum(rate / 3))
        + jnp.sum(head.sampled_velocity_spectrum(0 * rate, rate))
        + jnp.sum(head.structure_function(1e3 / rate))
        + jnp.sum(head.covariance(1e6 / rate))
    )


def _kurtosis(head: HeadMotion, rate: Any, key: Any) -> Any:
    del rate, key
    return jnp.sum(head.increment_kurtosis(60.0, memory_s=0.5))


def _drawn(head: HeadMotion, rate: Any, key: Any) -> Any:
    return jnp.sum(quaternion.increments(head.sample(key, rate, 6)) ** 2)


# --- sessions that are wrong ---


def bad_sessions(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Sessions of a batch that are NaN and should not be, or the other way round."""
    del quick
    display, texture = texture_of_noise()
    texture = jax.tree.map(lambda x: x.astype(dtype), texture)
    region = Region(16, 16, 12, 12)
    poses = jnp.asarray(np.stack([poses_of(still_path(rng, 4, 1e-3))] * 8), dtype)
    poses = poses.at[1, 2].set(jnp.nan).at[2, 1].multiply(1.5).at[3, 3].set(0.0)
    w_min = jnp.asarray([0.3, 0.3, 0.3, 0.3, 1.5, 0.3, 0.3, 0.3], dtype)
    h_max = jnp.asarray([25, 25, 25, 25, 25, -1, 25, 25], dtype)
    fov = jnp.asarray([6.0, 6, 6, 6, 6, 6, 180, 6], dtype)

    @jax.jit
    @jax.vmap
    def flicker(poses: Any, w_min: Any, h_max: Any, fov: Any) -> Any:
        technique = HeadMovement(w_min=w_min, h_max_deg_s=h_max)
        camera = eqx.tree_at(lambda c: c.fov_deg, display, fov)
        found = simulate(
            texture, camera, technique, poses, region=region, reading=GATHER
        )
        return found.mtcd

    is_nan = np.isnan(np.asarray(flicker(poses, w_min, h_max, fov)))
    expected = np.array([False, True, True, True, True, True, True, False])
    return float(np.sum(is_nan != expected)), f"NaN: {np.nonzero(is_nan)[0].tolist()}"


def runs() -> list[Run]:
    """All of them."""
    none = {"float32": Bound(0.0), "float64": Bound(0.0)}
    single = {"float32": Bound(0.0)}
    unit = "not finite"
    heads = "at rest, times 1e-6 to 1e6 s, modes to the rate, 1 to 10,000 Hz"
    return [
        Run(
            "apply, MTCD and gradients",
            "0 to pi rad, w and d 0 to 1, h_max 1e-20 to 1e20, 0.1 to 179.9 deg, "
            "0 to 1e6, 1 to 16 samples, 1 x 1 px",
            clip_gradients,
            single,
            unit,
        ),
        Run(
            "simulate, gradients",
            "0 to 0.01 rad",
            session_gradients,
            single,
            unit,
            is_slow=True,
        ),
        Run(
            "theory.predict, gradients",
            "0 to pi rad, w and d 0 to 1, h_max 1e-20 to 1e20",
            prediction_gradients,
            none,
            unit,
            is_slow=True,
        ),
        *(
            Run(name, heads, _of_heads(score), none, unit, is_slow=True)
            for name, score in (
                ("HeadMotion's laws, gradients", _laws),
                ("HeadMotion.increment_kurtosis, gradients", _kurtosis),
                ("HeadMotion.sample, gradients", _drawn),
            )
        ),
        Run(
            "simulate, in a batch",
            "bad poses, weights, speeds, views",
            bad_sessions,
            none,
            "sessions",
        ),
    ]
