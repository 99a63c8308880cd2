"""MTCD of sessions and its derivatives in every number, by reverse mode.

A session's head path is drawn inside the differentiated function from the session's own
key, so numbers of the head act through the path; a study with the same seed has the
same sessions (in float32). Derivatives are pathwise: one pass gives a session's
derivatives with respect to all numbers. They leave out what jumps: pixels at the
frame's edge that lose or gain a past as their source crosses it, one row in a thousand.

What stays as it is:

- Textures are baked outside: the picture is fixed in display pixels. A wider field of
  view then means fewer pixels per degree, so that the same head moves the same picture
  less; a scene fixed in the world would change its detail in pixels too, which for hard
  edges has no derivative.
- Counts of frames: at a higher refresh rate a session is shorter.
- Which tiles are measured, and their halos.

Memory: sessions are mapped one by one, and a session's frames are computed again on the
way back, so reverse mode keeps the pictures of one session that go on from frame to
frame. For head movement, 22 frames and a halo of 16 px, 3.2 MB for a tile of 32 px and
7.2 MB for one of 64 (26.9 and 60.9 MB without computing frames again, and no faster).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .. import _checks
from .._types import RandomKey, Scalar
from ..camera import Camera
from ..frames.displacement import Reading
from ..frames.motion import Motion
from ..frames.sources import AbstractSource
from ..frames.texture import Texture
from ..head_motion import HeadMotion
from ..metrics import MTCD
from ..scenes.baking import bake
from ..scenes.base import AbstractScene
from ..simulation.session import session
from ..simulation.sharding import over_sessions, placed
from ..simulation.simulate import check_texture
from ..studies.failures import FailedSessionsError
from ..studies.measured_blocks import Measurement, Tiles
from ..studies.progress import Progress, Tell
from ..studies.runner import Runner, regions
from ..studies.sessions import Batch, Sessions, drawn_alike, session_keys, study_key
from ..studies.study import check_seed
from ..technique_contract.base import AbstractTechnique
from ..technique_contract.check import check_hints

_PLAIN = Reading("plain")  # other ways to read have the same derivatives, made of this


class Parameters(eqx.Module):
    """Everything whose numbers a ratio may depend on; names are paths in it."""

    head: HeadMotion
    camera: Camera
    technique: AbstractTechnique
    baseline: AbstractTechnique


@dataclass(frozen=True)
class SessionDerivatives:
    """MTCD of sessions, averaged over scenes, and its derivatives.

    - `names`, `values`: of the parameters.
    - `x`, `y`: MTCD of the technique and of the baseline, code values.
    - `dx`, `dy`: their derivatives, in code values over each parameter's unit.
    """

    names: tuple[str, ...]
    values: Float[np.ndarray, " parameters"]
    x: Float[np.ndarray, " sessions"]
    y: Float[np.ndarray, " sessions"]
    dx: Float[np.ndarray, "sessions parameters"]
    dy: Float[np.ndarray, "sessions parameters"]

    def select(self, chosen: slice) -> "SessionDerivatives":
        """Keep some of the sessions."""
        kept = {name: getattr(self, name)[chosen] for name in ("x", "y", "dx", "dy")}
        return replace(self, **kept)


def differentiate(
    scenes: Mapping[str, AbstractScene | Texture],
    parameters: Parameters,
    *,
    sessions: int,
    frames: int,
    warmup: int,
    seed: int,
    measure: Measurement | None = None,
    batch_size: int = 16,
    progress: Tell = lambda event: None,
) -> SessionDerivatives:
    """MTCD of each session and its derivatives; see `sensitivities`."""
    camera = parameters.camera
    _checks.whole("sessions", sessions, 2)
    _checks.whole("frames", frames, 2)
    _checks.whole("warmup", warmup, 0)
    _checks.whole("batch_size", batch_size, 1)
    check_seed(seed)
    if not isinstance(parameters.head, HeadMotion):
        raise ValueError(
            f"head must be a HeadMotion, got {type(parameters.head).__name__}: "
            "recorded paths have no parameters."
        )
    if not scenes:
        raise ValueError("scenes must name at least one scene, got none.")
    for name, scene in scenes.items():
        if isinstance(scene, Texture):
            check_texture(scene, camera)
        elif isinstance(scene, AbstractSource):
            raise ValueError(f"scene {name!r} must be a picture, got solids.")
    measure = Tiles.fitting(camera, 1) if measure is None else measure
    block = measure.block_size(camera)

    techniques = [parameters.technique, parameters.baseline]
    for technique in techniques:
        check_hints(technique)
    techniques = [technique.on_pictures() for technique in techniques]
    parameters = Parameters(parameters.head, camera, *techniques)
    names, values = _named(parameters)
    stored = [s.color_texels.dtype for s in scenes.values() if isinstance(s, Texture)]
    dtype = max((np.dtype(np.float32), *stored), key=lambda dtype: dtype.itemsize)
    numbers = _numbers(parameters, dtype)
    length = warmup + frames
    drawn = Sessions(
        seed, numbers.head, camera, measure, sessions, length, dtype=dtype
    ).batch(0, sessions)
    runner = Runner(camera, measure, techniques, warmup, batch_size, drawn)
    halos = [int(runner.halo([technique], drawn).max()) for technique in techniques]

    total, done = 2 * len(scenes) * sessions, 0
    found = []
    for name, scene in scenes.items():
        progress(Progress(done, total, f"{name}: baking", done))
        texture = scene if isinstance(scene, Texture) else bake(scene, camera)
        texture = placed(texture)
        for role, halo in zip(("technique", "baseline"), halos, strict=True):
            parts = []
            for start in range(0, sessions, batch_size):
                doing = f"{name}: {getattr(parameters, role).id}"
                progress(Progress(done, total, doing, done))
                index = np.arange(start, min(start + batch_size, sessions))
                parts.append(
                    _batch(
                        study_key(seed),
                        texture,
                        numbers,
                        index,
                        drawn,
                        min(batch_size, sessions),
                        role=role,
                        block=block,
                        halo=halo,
                        frames=frames,
                        warmup=warmup,
                    )
                )
                done += len(index)
            found.append(np.concatenate(parts))
    progress(Progress(done, total, "done", done))
    x = np.mean(found[0::2], axis=0)
    y = np.mean(found[1::2], axis=0)
    failed = ~np.isfinite(x + y).all(axis=1)
    if failed.any():
        raise FailedSessionsError(
            f"{failed.sum()} of {sessions} sessions gave no finite derivative: a head "
            "that leaves the texture's margin does; bake with a larger margin_deg."
        )
    return SessionDerivatives(names, values, x[:, 0], y[:, 0], x[:, 1:], y[:, 1:])


def _named(parameters: Parameters) -> tuple[tuple[str, ...], np.ndarray]:
    """Names and values of all numbers; those of an array are told apart by index."""
    names, values = [], []
    for path, leaf in jax.tree_util.tree_flatten_with_path(parameters)[0]:
        if eqx.is_inexact_array_like(leaf):
            name = jax.tree_util.keystr(path).removeprefix(".")
            for index, value in np.ndenumerate(np.asarray(leaf, float)):
                names.append(name + "".join(f"[{i}]" for i in index))
                values.append(float(value))
    return tuple(names), np.array(values)


def _numbers(parameters: Parameters, dtype: Any) -> Parameters:
    """Make arrays of all numbers."""
    numbers, rest = eqx.partition(parameters, eqx.is_inexact_array_like)
    numbers = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), numbers)
    return eqx.combine(numbers, rest)


def _batch(
    key: RandomKey,
    texture: Texture,
    parameters: Parameters,
    index: Int[np.ndarray, " sessions"],
    drawn: Batch,
    size: int,
    **static: Any,
) -> Float[np.ndarray, "sessions columns"]:
    """MTCD of some sessions, and next to it its derivatives."""
    padded = np.resize(index, size)  # to compile once
    with drawn_alike():
        value, gradient = over_sessions(
            _differentiated,
            (key, texture, parameters),
            (jnp.asarray(padded, jnp.int32), drawn.origins[padded]),
            **static,
        )
    leaves = [value, *jax.tree.leaves(gradient)]
    columns = [np.asarray(leaf, float).reshape(len(padded), -1) for leaf in leaves]
    return np.concatenate(columns, axis=1)[: len(index)]


def _differentiated(
    shared: tuple[RandomKey, Texture, Parameters],
    mine: tuple[Int[Array, ""], Int[Array, "blocks 2"]],
    *,
    role: str,
    block: tuple[int, int],
    halo: int,
    frames: int,
    warmup: int,
) -> tuple[Array, Parameters]:
    """MTCD of a session, and its gradient in each number."""
    (key, texture, parameters), (index, origins) = shared, mine
    session_key = session_keys(key, index).head
    numbers, rest = eqx.partition(parameters, eqx.is_inexact_array)

    def path(numbers: Parameters) -> Motion:
        head, rate_hz = numbers.head, numbers.camera.refresh_hz
        head = eqx.combine(head, rest.head)
        return Motion.of(head.sample(session_key, rate_hz, warmup + frames))

    # A path serves all blocks: it is drawn, and differentiated, once.
    motion, pull = jax.vjp(path, numbers)

    def one_block(origin: Int[Array, "2"]) -> tuple:
        def mtcd(numbers: Parameters, motion: Motion) -> Scalar:
            now = eqx.combine(numbers, rest)
            (found,) = session(
                texture,
                now.camera,
                (getattr(now, role),),
                motion,
                *regions(now.camera, origin, block, halo),
                warmup=warmup,
                reading=_PLAIN,
                metrics=(MTCD(),),
            )
            return jnp.asarray(found.mtcd)

        return jax.value_and_grad(mtcd, (0, 1))(numbers, motion)

    of_blocks = jax.lax.map(one_block, origins)
    mean = partial(jnp.mean, axis=0)
    value, (direct, of_motion) = jax.tree.map(mean, of_blocks)
    (through_path,) = pull(of_motion)
    return value, jax.tree.map(jnp.add, direct, through_path)
