"""How far around a pixel a technique reads, found on small frames of random colours."""

import functools
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._types import Samples
from ..camera import Camera, Region
from ..frames.displacement import AT_REST, GATHER, Reading
from ..frames.frame import Frame
from ..frames.motion import Motion
from .base import AbstractTechnique, State

SIZE_PX = 33  # of the small frames; stencils up to 16 px fit
TRIALS = 4
TURNS_RAD = (0.0, 1e-4, 1e-3, 5e-3, 7e-3, 2e-2)  # per frame: up to 69 deg/s at 60 Hz
_CAMERA = Camera(SIZE_PX, SIZE_PX, 4.0, 60.0)


def random_samples(technique: AbstractTechnique, seed: int) -> Samples:
    """Colours of a frame, one picture per sample that the technique asks for."""
    count = technique.sample_offsets_px.shape[1]
    shape = (count, 3, SIZE_PX, SIZE_PX)
    return jnp.asarray(np.random.default_rng(seed).random(shape), jnp.float32)


def frame_of(color: Samples, reading: Reading = GATHER) -> Frame:
    """Return a small frame of some colours."""
    return Frame(color, _CAMERA, Region.whole(_CAMERA), reading=reading)


def turn_of(angle_rad: float) -> Motion:
    """Return a turn by an angle, about no axis of the camera's."""
    turn = jnp.array([0.6, -0.7, 0.4], jnp.float32) * jnp.float32(angle_rad)
    return Motion(turn, turn)


def planes_of(tree: Any) -> Float[Array, "planes height width"]:
    """All that is kept or shown per pixel."""
    size = (SIZE_PX, SIZE_PX)
    leaves = [jnp.asarray(leaf) for leaf in jax.tree.leaves(tree)]
    kept = [leaf.reshape(-1, *size) for leaf in leaves if leaf.shape[-2:] == size]
    return jnp.concatenate([plane.astype(jnp.float32) for plane in kept])


def stencil_radius_px(technique: AbstractTechnique) -> int:
    """How far around a pixel a technique reads: its hint, or what is found.

    Found is the farthest pixel that changes when one pixel of the current frame or of
    the state changes, to NaN among others, on random colours and at rest.

    **Errors:** `ValueError` for a technique that needs channels beyond colour and does
    not say its stencil.
    """
    if technique.stencil_radius_px is not None:
        return technique.stencil_radius_px
    leaves = jax.tree.leaves(technique)
    if any(isinstance(leaf, jax.Array | np.ndarray) for leaf in leaves):
        return found_stencil_px(technique)
    return _found_once(technique)


@functools.cache
def _found_once(technique: AbstractTechnique) -> int:
    return found_stencil_px(technique)


def found_stencil_px(technique: AbstractTechnique, *, of_history: bool = False) -> int:
    """Return what is found; `of_history`: by what is kept of a changed state alone."""
    if technique.needs - {"color"}:
        raise ValueError(
            f"stencil_radius_px of {technique.id} must be a whole number, for it needs "
            f"{', '.join(sorted(technique.needs - {'color'}))}, got None."
        )
    middle = SIZE_PX // 2

    def step(state: State, frame: Frame, motion: Motion) -> Any:
        kept, shown = technique.step(state, frame, motion)
        return kept if of_history else (kept, shown)

    @jax.jit
    def after(state: State, color: Samples, motion: Motion) -> Array:
        return planes_of(step(state, frame_of(color), motion))

    still = turn_of(0.0)
    at_rest = jax.jit(
        lambda state, color: planes_of(step(state, frame_of(color, AT_REST), still))
    )
    farthest = 0
    for seed, value in enumerate([np.nan, 0.0, 1.0, 0.5]):
        before = technique.init(frame_of(random_samples(technique, seed)))
        color = random_samples(technique, seed + TRIALS)
        spoiled = color.at[..., middle, middle].set(value)
        pairs = []
        if not of_history:
            pairs.append((at_rest(before, color), at_rest(before, spoiled)))
        for other in _states_changed_at(before, middle, value):
            pairs.append((at_rest(before, color), at_rest(other, color)))
        for turn in [] if of_history else map(turn_of, TURNS_RAD[1:]):
            pairs.append((after(before, color, turn), after(before, spoiled, turn)))
        for usual, found in (map(np.asarray, pair) for pair in pairs):
            is_same = (found == usual) | (np.isnan(found) & np.isnan(usual))
            where = np.argwhere(~is_same)
            if len(where):
                farthest = max(farthest, int(np.abs(where[:, 1:] - middle).max()))
    return farthest


def _states_changed_at(state: State, middle: int, value: float) -> Iterator[State]:
    """Change one pixel of each plane of a state."""
    leaves, tree = jax.tree.flatten(state)
    for place, leaf in enumerate(leaves):
        if jnp.shape(leaf)[-2:] != (SIZE_PX, SIZE_PX):
            continue
        pixel = leaf[..., middle, middle]
        is_float = jnp.issubdtype(leaf.dtype, jnp.floating)
        new = jnp.full_like(pixel, value) if is_float else pixel == 0
        others = list(leaves)
        others[place] = leaf.at[..., middle, middle].set(new.astype(leaf.dtype))
        yield jax.tree.unflatten(tree, others)


def forget_stencils() -> None:
    """Look anew at techniques whose code may have changed."""
    _found_once.cache_clear()
