"""Checks of techniques: whether their hints are right, and their laws.

All are made on the small frames of random colours of `stencil`, where a wrong hint
shows.
"""

import functools
from collections.abc import Iterator, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .. import _checks
from .._types import Samples
from ..frames.motion import Motion
from .base import AbstractTechnique, State, mean_of_samples
from .display_stages import Displayed
from .shapes import check_contract
from .stencil import (
    TRIALS,
    TURNS_RAD,
    forget_stencils,
    found_stencil_px,
    frame_of,
    planes_of,
    random_samples,
    turn_of,
)

_TOLERANCE = 1e-4  # of the colour range, far above rounding in float32


def _is_trusted(technique: AbstractTechnique) -> bool:
    """Whether the package's own tests hold all of its hints."""
    modules = [type(part).__module__ for part in _parts(technique)]
    return all(module.startswith("hmdjit.") for module in modules)


def _parts(module: eqx.Module) -> Iterator[eqx.Module]:
    """Yield a module, and all modules in it."""
    yield module
    for part in jax.tree.leaves(module, is_leaf=lambda node: node is not module):
        if isinstance(part, eqx.Module):
            yield from _parts(part)


def check_hints(technique: AbstractTechnique) -> None:
    """Raise if a technique of one's own breaks its contract, or a hint is wrong.

    **Errors:** `ValueError` naming the technique, the hint, and what was found.
    """
    if isinstance(technique, Displayed):
        check_hints(technique.technique)  # also where the stage needs what is not seen
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
    _check_once.cache_clear()
    forget_stencils()


def _is_said(technique: AbstractTechnique, hint: str) -> bool:
    return getattr(type(technique), hint) is not getattr(AbstractTechnique, hint)


def _check_hints(technique: AbstractTechnique) -> None:
    check_contract(technique)
    name = technique.id
    said = technique.stencil_radius_px
    is_seen = technique.needs == {"color"}  # else no small frame stands for a scene
    if not is_seen:
        return
    if said is not None and (found := found_stencil_px(technique)) > said:
        raise ValueError(
            f"stencil_radius_px of {name} must be at least {found}, the distance at "
            f"which a pixel was seen to count, got {said}."
        )
    around = technique.history_radius_px
    if around is not None and jax.tree.leaves(
        technique.init(frame_of(random_samples(technique, 0)))
    ):
        found = found_stencil_px(technique, of_history=True)
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
    several = [random_samples(technique, seed) for seed in range(3)]
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
    state, shown = technique.init(frame_of(colors[0])), colors[0]
    for k, color in enumerate(colors):
        state, shown = technique.step(state, frame_of(color), turn_of(1e-3 * k))
    return np.asarray(shown)


def _check_gain(technique: AbstractTechnique) -> None:
    """Change histories a little and a lot; see how much of it remains."""
    name = technique.id
    if not jax.tree.leaves(technique.init(frame_of(random_samples(technique, 0)))):
        return

    @jax.jit
    def after(state: State, color: Samples, motion: Motion) -> tuple[Array, Array]:
        kept, shown = technique.step(state, frame_of(color), motion)
        return planes_of(kept), shown

    rng = np.random.default_rng(0)
    for seed in range(TRIALS):
        color = random_samples(technique, seed)
        past = technique.init(frame_of(random_samples(technique, seed + TRIALS)))
        for angle in TURNS_RAD:
            speed = np.degrees(angle * np.linalg.norm([0.6, -0.7, 0.4])) * 60.0
            gain = float(technique.history_gain(np.array([[speed]]))[0, 0])
            for size in (1e-2, 1.0):

                def moved(leaf: Array, size: float = size) -> Array:
                    if not jnp.issubdtype(leaf.dtype, jnp.floating):
                        return leaf
                    noise = rng.uniform(-1, 1, leaf.shape)
                    return jnp.clip(leaf + size * jnp.asarray(noise, leaf.dtype), 0, 1)

                other = jax.tree.map(moved, past)
                ours, shown = after(past, color, turn_of(angle))
                theirs, displayed = after(other, color, turn_of(angle))
                error = np.abs(np.asarray(planes_of(other) - planes_of(past))).max()
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
        advance = lambda state, now: technique.step(state, frame_of(now[0]), now[1])
        return jax.lax.scan(advance, state, (colors, motions))

    still = [turn_of(angle) for angle in (0.0, 1e-4, 1e-3, 2e-3, 1e-4, 0.0)]
    motions = jax.tree.map(lambda *leaves: jnp.stack(leaves), *still)
    colors = jnp.stack([random_samples(technique, seed) for seed in range(len(still))])
    grey = jnp.full_like(colors, 0.25)
    _, shown = run(technique.init(frame_of(grey[0])), grey, motions)
    if (worst := float(jnp.abs(shown - 0.25).max())) > _TOLERANCE:
        raise ValueError(
            f"{name} must keep a constant scene, got a change of {worst:g}."
        )

    start = technique.init(frame_of(colors[0]))
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
