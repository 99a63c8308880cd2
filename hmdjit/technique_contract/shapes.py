"""The contract that every technique keeps, checked by shapes before anything runs."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, DTypeLike

from .. import _checks
from .._types import Scalar
from ..camera import Camera, Region
from ..frames.frame import CHANNELS, Frame
from ..frames.motion import Motion
from .base import AbstractTechnique

_CAMERA = Camera(33, 31, 4.0, 60.0)  # of two sides, so that none stands for the other


def blank_frame(
    technique: AbstractTechnique,
    camera: Camera,
    region: Region,
    dtype: DTypeLike,
    velocity_bounds: Array | None = None,
    nearest_m: Scalar = np.inf,
) -> Frame:
    """Return a black frame with all that a technique asks for.

    **Arguments:** `velocity_bounds`: how far things move in it, px, `(2, 2)`; None
    where that is the head's rotation alone, of which no channel tells; `nearest_m`: how
    far away all of it is, m.
    """
    table = technique.sample_offsets_px
    samples = table.shape[1]
    jitter_px = jnp.zeros(2, dtype) if samples == 1 and table.any() else None

    def blank(name: str) -> Array:
        planes, own = CHANNELS[name]
        size = (samples, planes, region.height, region.width)
        return jnp.full(size, nearest_m if name == "depth" else 0, own or dtype)

    without = {"color"} | ({"velocity"} if velocity_bounds is None else set())
    return Frame(
        blank("color"),
        camera,
        region,
        channels={name: blank(name) for name in technique.needs - without},
        velocity_bounds=velocity_bounds,
        jitter_px=jitter_px,
    )


def check_contract(technique: AbstractTechnique) -> None:
    """Raise unless a technique is one, and `init` and `step` fit each other.

    **Errors:** `ValueError` naming what must be, and what is.
    """
    check_declared(technique)
    if technique.needs == {"color"}:  # else no small frame stands for a scene
        _check_step(technique)


def check_declared(technique: AbstractTechnique) -> None:
    """Raise unless a technique is one, by what it says of itself."""
    if not isinstance(technique, AbstractTechnique):
        raise ValueError(
            f"technique must be an AbstractTechnique, got {technique!r}; "
            "hj.techniques.by_id gives those that have a name."
        )
    name, needs, table = technique.id, technique.needs, technique.sample_offsets_px
    if not isinstance(name, str):
        raise ValueError(f"id of a technique must be a string, got {name!r}.")
    for path, leaf in jax.tree_util.tree_leaves_with_path(technique):
        if not eqx.is_array_like(leaf):
            field = jax.tree_util.keystr(path).removeprefix(".")
            raise ValueError(
                f"{field} of {name} must be a number, an array or "
                f"eqx.field(static=True), got {leaf!r}."
            )
    if not isinstance(needs, frozenset) or not {"color"} <= needs:
        raise ValueError(
            f"needs of {name} must be a frozenset with 'color', got {needs!r}."
        )
    for channel in sorted(needs):
        _checks.one_of(f"needs of {name}", channel, CHANNELS)
    if not isinstance(table, np.ndarray) or table.ndim != 3 or table.shape[-1] != 2:
        raise ValueError(
            f"sample_offsets_px of {name} must be a NumPy array (period, samples, 2), "
            f"got {_words(table)}."
        )


def _check_step(technique: AbstractTechnique) -> None:
    name, size = technique.id, (3, _CAMERA.height_px, _CAMERA.width_px)
    kept = [jnp.result_type(x) for x in jax.tree.leaves(technique) if eqx.is_array(x)]
    floats = [dtype for dtype in kept if jnp.issubdtype(dtype, jnp.floating)]
    dtype = max([jnp.dtype(jnp.float32), *floats], key=lambda dtype: dtype.itemsize)
    frame = blank_frame(technique, _CAMERA, Region.whole(_CAMERA), dtype)
    still = jnp.zeros(3, dtype)
    state = jax.eval_shape(technique.init, frame)
    found = jax.eval_shape(technique.step, state, frame, Motion(still, still))
    if not isinstance(found, tuple) or len(found) != 2:
        raise ValueError(
            f"step of {name} must return (state, displayed), got {_words(found)}."
        )
    after, shown = found
    if getattr(shown, "shape", None) != size or shown.dtype != dtype:
        raise ValueError(
            f"step of {name} must display (3, height, width) of the frame's dtype, "
            f"{dtype} {size} here, got {_words(shown)}."
        )
    if _words(after) != _words(state):
        raise ValueError(
            f"step of {name} must return a state of the shapes and types of the one "
            f"before, {_words(state)}, got {_words(after)}."
        )


def _words(tree: object) -> str:
    """Say what a tree holds, arrays by their shapes."""
    if tree is None:
        return "None"
    shapes = [f"{np.result_type(x)} {np.shape(x)}" for x in jax.tree.leaves(tree)]
    is_array = isinstance(tree, jax.ShapeDtypeStruct | jax.Array | np.ndarray)
    return f"{'array' if is_array else type(tree).__name__} of {', '.join(shapes)}"
