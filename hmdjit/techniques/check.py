"""Checks of techniques: how far they read, whether their hints are right, their laws.

All are made on small frames of random colours, where a wrong hint shows.
"""

import functools
from collections.abc import Iterator, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import _checks
from .._types import Samples
from ..camera import Camera, Region
from ..frames.displacement import AT_REST, GATHER, Reading
from ..frames.frame import Frame
from ..frames.motion import Motion
from .base import AbstractTechnique, State, mean_of_samples
from .contract import check_contract

_SIZE_PX = 33  # of the small frames; stencils up to 16 px fit
_TRIALS = 4
_TURNS_RAD = (0.0, 1e-4, 1e-3, 5e-3, 7e-3, 2e-2)  # per frame: up to 69 deg/s at 60 Hz
_TOLERANCE = 1e-4  # of the colour range, far above rounding in float32
_CAMERA = Camera(_SIZE_PX, _SIZE_PX, 4.0, 60.0)


def _is_trusted(technique: AbstractTechnique) -> bool:
    """Whether the package's own tests hold all of its hints."""
    parts = jax.tree.leaves(technique, is_leaf=lambda node: node is not technique)
    modules = [technique, *(part for part in parts if isinstance(part, eqx.Module))]
    return all(type(part).__module__.startswith("hmdjit.") for part in modules)


def _samples(technique: AbstractTechnique, seed: int) -> Samples:
    """Colours of a frame, one picture per sample that the technique asks for."""
    count = technique.sample_offsets_px.shape[1]
    shape = (count, 3, _SIZE_PX, _SIZE_PX)
    return jnp.asarray(np.random.default_rng(seed).random(shape), jnp.float32)


def _frame(color: Samples, reading: Reading = GATHER) -> Frame:
    return Frame(color, _CAMERA, Region.whole(_CAMERA), reading=reading)


def _turn(angle_rad: float) -> Motion:
    turn = jnp.array([0.6, -0.7, 0.4], jnp.float32) * jnp.float32(angle_rad)
    return Motion(turn, turn)


def _planes(tree: Any) -> Float[Array, "planes height width"]:
    """All that is kept or shown per pixel."""
    size = (_SIZE_PX, _SIZE_PX)
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
        return _found_stencil_px(technique)
    return _found_once(technique)


@functools.cache
def _found_once(technique: AbstractTechnique) -> int:
    return _found_stencil_px(technique)


def _found_stencil_px(technique: AbstractTechnique, *, of_history: bool = False) -> int:
    """Return what is found; `of_history`: by what is kept of a changed state alone."""
    if technique.needs - {"color"}:
        raise ValueError(
            f"stencil_radius_px of {technique.id} must be a whole number, for it needs "
            f"{', '.join(sorted(technique.needs - {'color'}))}, got None."
        )
    middle = _SIZE_PX // 2

    def step(state: State, frame: Frame, motion: Motion) -> Any:
        kept, shown = technique.step(state, frame, motion)
        return kept if of_history else (kept, shown)

    @jax.jit
    def after(state: State, color: Samples, motion: Motion) -> Array:
        return _planes(step(state, _frame(color), motion))

    still = _turn(0.0)
    at_rest = jax.jit(
        lambda state, color: _planes(step(state, _frame(color, AT_REST), still))
    )
    farthest = 0
    for seed, value in enumerate([np.nan, 0.0, 1.0, 0.5]):
        before = technique.init(_frame(_samples(technique, seed)))
        color = _samples(technique, seed + _TRIALS)
        spoiled = color.at[..., middle, middle].set(value)
        pairs = []
        if not of_history:
            pairs.append((at_rest(before, color), at_rest(before, spoiled)))
        for other in _states_changed_at(before, middle, value):
            pairs.append((at_rest(before, color), at_rest(other, color)))
        for turn in [] if of_history else map(_turn, _TURNS_RAD[1:]):
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
        if jnp.shape(leaf)[-2:] != (_SIZE_PX, _SIZE_PX):
            continue
        pixel = leaf[..., middle, middle]
        is_float = jnp.issubdtype(leaf.dtype, jnp.floating)
        new = jnp.full_like(pixel, value) if is_float else pixel == 0
        others = list(leaves)
        others[place] = leaf.at[..., middle, middle].set(new.astype(leaf.dtype))
        yield jax.tree.unflatten(tree, others)


def check_hints(technique: AbstractTechnique) -> None:
    """Raise if a technique of one's own breaks its contract, or a hint is wrong.

    **Errors:** `ValueError` naming the technique, the hint, and what was found.
    """
    leaves = jax.tree.leaves(technique)
    if _is_trusted(technique) or any(map(_checks.is_traced, leaves)):
        return
    is_array = [isinstance(leaf, jax.Array | np.ndarray) for leaf in leaves]
    with jax.ensure_compile_time_eval():
        (_check_hints if any(is_array) else _check_once)(technique)


@functools.cache
def _check_once(technique: AbstractTechnique) -> None:
    _check_hints(technique)


def forget_checks() -> None:
    """Check and look anew at techniques whose code may have changed."""
    for known in (_check_once, _found_once):
        known.cache_clear()


def _is_said(technique: AbstractTechnique, hint: str) -> bool:
    return getattr(type(technique), hint) is not getattr(AbstractTechnique, hint)


def _check_hints(technique: AbstractTechnique) -> None:
    check_contract(technique)
    name = technique.id
    said = technique.stencil_radius_px
    is_seen = technique.needs == {"color"}  # else no small frame stands for a scene
    if not is_seen:
        return
    if said is not None and (found := _found_stencil_px(technique)) > said:
        raise ValueError(
            f"stencil_radius_px of {name} must be at least {found}, the distance at "
            f"which a pixel was seen to count, got {said}."
        )
    around = technique.history_radius_px
    if around is not None and jax.tree.leaves(
        technique.init(_frame(_samples(technique, 0)))
    ):
        found = _found_stencil_px(technique, of_history=True)
        if found > around:
            raise ValueError(
                f"history_radius_px of {name} must be at least {found}, the distance "
                f"at which a kept pixel was seen to count, got {around}."
            )
    if _is_said(technique, "history_gain") or _is_said(technique, "display_slope"):
        _check_gain(technique)
    alike = technique.on_pictures()
    if alike is technique and not technique.reads_supersampled:
        return
    tables = technique.sample_offsets_px, alike.sample_offsets_px
    if not np.array_equal(*tables):
        if _is_trusted(technique):  # MSAA shows a surface once per pixel
            return
        raise ValueError(
            f"on_pictures of {name} must read the same samples, got {alike.id}."
        )
    several = [_samples(technique, seed) for seed in range(3)]
    difference = np.abs(_shown(technique, several) - _shown(alike, several)).max()
    if difference > _TOLERANCE:
        raise ValueError(
            f"on_pictures of {name} must show the same, got {alike.id}, which differs "
            f"by {difference:.2g} of the colour range."
        )
    if technique.reads_supersampled:
        means = [mean_of_samples(samples, "linear")[None] for samples in several]
        difference = np.abs(_shown(technique, several) - _shown(technique, means)).max()
        if len(several[0]) != 16 or difference > _TOLERANCE:
            raise ValueError(
                f"reads_supersampled of {name} must be False: it does not show the "
                "mean of 16 samples in linear light."
            )


def _shown(technique: AbstractTechnique, colors: Sequence[Samples]) -> np.ndarray:
    """Display a few frames."""
    state, shown = technique.init(_frame(colors[0])), colors[0]
    for k, color in enumerate(colors):
        state, shown = technique.step(state, _frame(color), _turn(1e-3 * k))
    return np.asarray(shown)


def _check_gain(technique: AbstractTechnique) -> None:
    """Change histories a little and a lot; see how much of it remains."""
    name = technique.id
    if not jax.tree.leaves(technique.init(_frame(_samples(technique, 0)))):
        return

    @jax.jit
    def after(state: State, color: Samples, motion: Motion) -> tuple[Array, Array]:
        kept, shown = technique.step(state, _frame(color), motion)
        return _planes(kept), shown

    rng = np.random.default_rng(0)
    for seed in range(_TRIALS):
        color = _samples(technique, seed)
        past = technique.init(_frame(_samples(technique, seed + _TRIALS)))
        for angle in _TURNS_RAD:
            speed = np.degrees(angle * np.linalg.norm([0.6, -0.7, 0.4])) * 60.0
            gain = float(technique.history_gain(np.array([[speed]]))[0, 0])
            for size in (1e-2, 1.0):

                def moved(leaf: Array, size: float = size) -> Array:
                    if not jnp.issubdtype(leaf.dtype, jnp.floating):
                        return leaf
                    noise = rng.uniform(-1, 1, leaf.shape)
                    return jnp.clip(leaf + size * jnp.asarray(noise, leaf.dtype), 0, 1)

                other = jax.tree.map(moved, past)
                ours, shown = after(past, color, _turn(angle))
                theirs, displayed = after(other, color, _turn(angle))
                error = np.abs(np.asarray(_planes(other) - _planes(past))).max()
                kept = np.abs(np.asarray(ours - theirs)).max() / error
                seen = np.abs(np.asarray(shown - displayed)).max() / error
                for hint, found, most in (
                    ("history_gain", kept, gain),
                    ("display_slope", seen, gain * technique.display_slope),
                ):
                    if found > most + _TOLERANCE / size:
                        raise ValueError(
                            f"{hint} of {name} must be at least {found:.4g} at "
                            f"{speed:.3g} deg/s, what was seen to remain of an error "
                            f"in the history, got "
                            f"{_checks.apart(most, found, spec='4g')}."
                        )


def check(technique: AbstractTechnique) -> None:
    """Check a technique against the laws that all techniques here obey.

    It keeps the contract; a constant scene stays constant; a run that is split in two,
    its state carried over, is the same; its hints are right.

    **Errors:** `ValueError` naming the law that is broken, and by how much.
    """
    check_contract(technique)
    name = technique.id

    @jax.jit
    def run(state: State, colors: Array, motions: Motion) -> tuple[State, Array]:
        advance = lambda state, now: technique.step(state, _frame(now[0]), now[1])
        return jax.lax.scan(advance, state, (colors, motions))

    still = [_turn(angle) for angle in (0.0, 1e-4, 1e-3, 2e-3, 1e-4, 0.0)]
    motions = jax.tree.map(lambda *leaves: jnp.stack(leaves), *still)
    colors = jnp.stack([_samples(technique, seed) for seed in range(len(still))])
    grey = jnp.full_like(colors, 0.25)
    _, shown = run(technique.init(_frame(grey[0])), grey, motions)
    if (worst := float(jnp.abs(shown - 0.25).max())) > _TOLERANCE:
        raise ValueError(
            f"{name} must keep a constant scene, got a change of {worst:g}."
        )

    start = technique.init(_frame(colors[0]))
    half = len(still) // 2
    first, second = (
        jax.tree.map(lambda leaf, s=s: leaf[s], (colors, motions))
        for s in (slice(half), slice(half, None))
    )
    _, whole = run(start, colors, motions)
    state, one = run(start, *first)
    _, two = run(state, *second)
    if (worst := float(jnp.abs(jnp.concatenate([one, two]) - whole).max())) > 0:
        raise ValueError(
            f"{name} must show the same when a run is split in two, got a difference "
            f"of {worst:g}: what it needs from the past belongs in its state."
        )
    _check_hints(technique)
