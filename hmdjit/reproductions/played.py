"""Techniques stepped side by side along a path, and what is measured of each frame."""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._types import Rgb, Scalar
from ..camera import Camera, Region
from ..frames.displacement import AT_REST
from ..frames.frame import Frame
from ..frames.motion import Motion
from ..frames.sources import AbstractSource, View
from ..simulation.session import fastest_reading
from ..simulation.views import Pattern, Renderer
from ..technique_contract.base import AbstractTechnique

START_EVERY = 48  # frames: all patterns of samples begin anew


class Moment(NamedTuple):
    """A frame as it is measured.

    - `shown`: by each technique, `(techniques, 3, height, width)`.
    - `render`: renders a pattern of samples of it.
    - `view`: from where it is seen.
    """

    shown: Float[Array, "techniques 3 height width"]
    render: Callable[[Pattern], Frame]
    view: View


def turning(start_rad: Scalar, step_rad: Scalar, frames: int) -> Motion:
    """Motion of a head that turns left at a steady rate, about the eye."""
    steps = jnp.arange(frames, dtype=jnp.float32)
    about = lambda yaw: jnp.stack([jnp.zeros_like(yaw), yaw, jnp.zeros_like(yaw)], 1)
    turned = jnp.where(steps > 0, step_rad, 0.0)
    return Motion(about(start_rad + step_rad * steps), about(turned))


def play(
    source: AbstractSource,
    camera: Camera,
    techniques: tuple[AbstractTechnique, ...],
    motion: Motion,
    start: Int[Array, ""],
    measure: Callable[[Any, Moment], tuple[Any, Any]],
    carry: Any = None,
    region: Region | None = None,
) -> Any:
    """Step techniques along a path; return what `measure` says of each frame.

    **Arguments:** `start`: number of the first frame, a multiple of `START_EVERY`: its
    time in frames; `measure`: of what it carried and a moment, both anew; `carry`: of
    before the first frame; `region`: the part of the camera frame, None is all.
    """
    region = Region.whole(camera) if region is None else region
    renderer = Renderer(source, camera, fastest_reading())
    patterns = [Pattern.of(technique, source.gives) for technique in techniques]

    def seen(k: Array, now: Motion) -> dict[Pattern, Frame]:
        return {p: renderer.frame(p, region, start + k, now) for p in set(patterns)}

    def step(carry: tuple, each: tuple, *, is_first: bool = False) -> tuple:
        (states, measured), (k, now) = carry, each
        frames = seen(k, now)
        if is_first:
            frames = {
                p: dataclasses.replace(frame, reading=AT_REST)
                for p, frame in frames.items()
            }
        pairs = [
            technique.step(state, frames[pattern], now)
            for technique, state, pattern in zip(
                techniques, states, patterns, strict=True
            )
        ]
        render = lambda pattern: renderer.frame(pattern, region, start + k, now)
        shown = jnp.stack([picture for _, picture in pairs])
        view = View(camera, region, now, start + k, renderer.reading)
        moment = Moment(shown, render, view)
        measured, found = measure(measured, moment)
        return ([state for state, _ in pairs], measured), found

    ks = jnp.arange(len(motion.offset), dtype=jnp.int32)
    first, *_ = jax.tree.map(lambda leaf: leaf[0], ((ks, motion),))
    frames = seen(*first)
    states = [
        t.init(frames[pattern]) for t, pattern in zip(techniques, patterns, strict=True)
    ]
    begun, found = step((states, carry), first, is_first=True)
    rest = jax.tree.map(lambda leaf: leaf[1:], (ks, motion))
    _, others = jax.lax.scan(step, begun, rest)
    join = lambda one, more: jnp.concatenate([one[None], more])
    return jax.tree.map(join, found, others)


def squared_error(
    shown: Float[Array, "*techniques 3 height width"], truth: Rgb
) -> Float[Array, "*techniques height width"]:
    """Mean over channels of squared differences, code values of 255 squared."""
    apart = 255.0 * (shown - jnp.broadcast_to(truth, shown.shape))
    return jnp.mean(apart**2, axis=-3)


def random_starts(
    seed: int, sessions: int, most_deg: float
) -> tuple[np.ndarray, np.ndarray]:
    """Draw where sessions look at first, rad, and their times, frames."""
    rng = np.random.default_rng([seed, sessions])
    yaw = np.radians(rng.uniform(-most_deg, most_deg, sessions))
    times = START_EVERY * rng.integers(0, 40, sessions)
    return yaw.astype(np.float32), times.astype(np.int32)
