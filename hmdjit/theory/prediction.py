"""What a session's MTCD should be, predicted from its head path without pixels.

To first order a technique shows the scene displaced: where the scene itself moves by
`u_k` from frame k-1 to k, head movement shows it moved by `v_k = u_k + e_k - e_{k-1}`
with the lag `e_k = (1 - A_k) (e_{k-1} - d u_k)`; for constant A that is the transfer
function `(1 - d) + d A / (1 - (1 - A) z^-1)`. A pair of frames then differs by
`D(v_k)`, the mean over pixels of what the scene differs from itself displaced by `v_k`,
which is tabled once per scene, in each cell of the frame.

Beyond first order, what is displayed is a sum of displaced pictures with the blending's
weights, and a signed sum of weights `c_i` at positions `z_i` (together 0) is as large
as `sqrt(-1/2 sum_ij c_i c_j D(z_i - z_j)^2)`. That is exact where D is a root mean
square (a variogram); here it is the mean of a distance.
"""

from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import _checks, quaternion
from .. import camera as pinhole
from .._types import Scalar, WholeNumber
from ..camera import Camera
from ..color import CODE_VALUES
from ..frames.motion import Motion
from ..technique_contract.base import AbstractTechnique
from ..technique_contract.small_motion import (
    AsRendered,
    RecursiveBlend,
    SmallMotion,
    Still,
)
from .picture_statistics import (
    Cells,
    Harmonics,
    PictureStatistics,
    Vector,
    difference_squared,
    root,
)

Moves = Float[Array, "frames 2"]
Squared = Callable[[Vector], Float[Array, ""]]


def _displacements(
    camera: Camera, cell_px: int, cells: Cells, dtype: jnp.dtype
) -> Float[Array, "cells 2 3"]:
    """Displacement per rotation at the centres of cells, px/rad."""
    columns = camera.width_px // cell_px
    x = cell_px * ((cells % columns).astype(dtype) + 0.5)
    y = cell_px * ((cells // columns).astype(dtype) + 0.5)

    def moved(rotation: Float[Array, "3"]) -> Array:
        dx, dy, _ = pinhole.displacement(camera, rotation, x, y)
        return jnp.stack([dx, dy], axis=-1)

    return jax.jacfwd(moved)(jnp.zeros(3, dtype))


def _refusal(technique: AbstractTechnique) -> str | None:
    """Why a technique has no theory."""
    model = technique.small_motion()
    if model is None:
        return "it does not say how what it shows moves"
    if isinstance(model, RecursiveBlend) and model.approximation:
        return model.approximation
    is_several = technique.sample_offsets_px.shape[1] > 1
    if is_several and not technique.reads_supersampled:
        return "of several samples only SSAA(4) in linear light is tabled"
    return None


def has_theory(technique: AbstractTechnique) -> bool:
    """Whether `predict` knows a technique."""
    return _refusal(technique.on_pictures()) is None


def predict(
    statistics: PictureStatistics,
    camera: Camera,
    technique: AbstractTechnique,
    motion: Motion,
    *,
    warmup: int = 0,
    cells: Cells | None = None,
    memory: int = 4,
) -> Float[Array, " cells"]:
    """Predict the MTCD of one session in each cell of the frame.

    **Arguments:**

    - `statistics`: of the scene; of its reference for techniques that show that.
    - `motion`: of one session, `(warmup + frames, 3)` each; only increments count.
    - `warmup`: frames that are not measured, as in `simulate`.
    - `cells`: numbers of the cells that are asked for; None is all, row by row.
    - `memory`: how many past pictures of a blend are kept apart, those before them
      standing together at their mean displacement. 0 is first order, `D(v_k)`.

    **Returns:** code values, shape `(cells,)`; their mean is the frame's. Freeze has 0.

    **Errors:** `ValueError` for a technique without a theory (`has_theory`), for
    statistics of another picture than it shows, and as `simulate` for the warm-up.

    **Accuracy:** with `memory=0`, simulation over theory tends to 1 as the motion
    shrinks, on pictures that are smooth over a pixel. At the motion of people who hold
    still, the default is the better one by far: see `tests/test_theory.py`. Left out
    are the bilinear history's blur, how the displacement varies over a cell, how wander
    changes what a cell shows, the frame's edge, and of several past samples all but
    their mean closeness. The localised weight is a cell's, at its mean difference: that
    takes part of the effect, which is larger where the picture flickers more.
    Differentiable; at rest the gradient is exactly 0.

    **Source:** Kim et al., equations (1) to (5), to first order in the displacement.
    """
    _checks.whole("warmup", warmup, 0)
    _checks.whole("memory", memory, 0)
    if motion.increment.shape[0] - warmup < 2:
        raise ValueError(
            f"motion must hold at least 2 frames after warmup = {warmup}, "
            f"got {motion.increment.shape[0]} in all."
        )
    technique = technique.on_pictures()
    if (reason := _refusal(technique)) is not None:
        raise ValueError(f"{technique.id} has no small-motion theory: {reason}.")
    if technique.reads_supersampled != statistics.supersampled:
        raise ValueError(
            f"statistics must have supersampled={technique.reads_supersampled} for "
            f"{technique.id}, got {statistics.supersampled}."
        )
    return _predict(statistics, camera, technique, motion, cells, warmup, memory)


@partial(jax.jit, static_argnames=("warmup", "memory"))
def _predict(
    statistics: PictureStatistics,
    camera: Camera,
    technique: AbstractTechnique,
    motion: Motion,
    cells: Cells | None,
    warmup: int,
    memory: int,
) -> Float[Array, " cells"]:
    model = technique.small_motion()
    assert model is not None
    return predict_model(
        statistics, camera, model, motion, cells, warmup=warmup, memory=memory
    )


def predict_model(
    statistics: PictureStatistics,
    camera: Camera,
    model: SmallMotion,
    motion: Motion,
    cells: Cells | None,
    *,
    warmup: int,
    memory: int = 4,
) -> Float[Array, " cells"]:
    """Return `predict` of what moves like a model; not jitted, nothing is checked."""
    if cells is None:
        cells = jnp.arange(statistics.slope_squared.shape[0], dtype=jnp.int32)
    else:
        statistics = statistics.select(cells)
    turn = motion.increment
    if isinstance(model, Still):
        return jnp.zeros(cells.shape, turn.dtype)
    maps = _displacements(camera, statistics.cell_px, cells, turn.dtype)
    scene_moves = jnp.einsum("cij,kj->cki", maps, turn)
    if isinstance(model, AsRendered):
        of_pairs = jax.vmap(statistics.difference, 1)
        return CODE_VALUES * jnp.mean(of_pairs(scene_moves[:, warmup + 1 :]), axis=0)
    speed_deg_s = jax.vmap(quaternion.angle)(turn) * camera.refresh_hz * (180 / np.pi)
    easing = model.easing(speed_deg_s)
    measured = jnp.arange(warmup + 1, turn.shape[0], dtype=jnp.int32)

    def one_cell(slope_squared: Harmonics, moves: Moves) -> Float[Array, ""]:
        squared = partial(difference_squared, slope_squared, statistics.finest_px)
        blends = _blending(model, squared, moves, easing)

        def of_pair(k: WholeNumber) -> Float[Array, ""]:
            if memory == 0:
                return squared(moves[k] + blends.lag[k] - blends.lag[k - 1])
            return _of_blends(squared, model.closeness, memory, moves, blends, k)

        return CODE_VALUES * jnp.mean(root(jax.vmap(of_pair)(measured)))

    return jax.vmap(one_cell)(statistics.slope_squared, scene_moves)


class _Blending(eqx.Module):
    """Weight A of the current picture and lag e, px, at a frame or along a session."""

    weight: Float[Array, "*frames"]
    lag: Float[Array, "*frames 2"]


def _blending(
    model: RecursiveBlend,
    squared: Squared,
    moves: Moves,
    easing: Float[Array, " frames"],
) -> _Blending:
    def advance(lag: Vector, now: tuple) -> tuple[Vector, _Blending]:
        move, easing = now
        difference = root(squared(lag - model.compared * move)) / 3**0.5
        weight = model.weight(jnp.minimum(difference, 1.0), easing)
        lag = (1 - weight) * (lag - model.closeness * move)
        return lag, _Blending(weight, lag)

    start = jnp.zeros(2, moves.dtype)
    return jax.lax.scan(advance, start, (moves, easing))[1]


def _of_blends(
    squared: Squared,
    closeness: Scalar,
    memory: int,
    moves: Moves,
    blends: _Blending,
    k: WholeNumber,
) -> Float[Array, ""]:
    """Squared difference of frames k and k-1, both blends of displaced pictures.

    Picture j stands at `(1 - d) x_k + d x_j` in frame k: the pictures of frame k are
    those of frame k-1, all moved by `(1 - d) u_k`, and the current one.
    """
    frame = k - jnp.arange(memory + 2, dtype=jnp.int32)
    is_there = frame > 0  # frame 0 is all its own; there is nothing before it
    kept = jnp.maximum(frame, 0)
    weight = jnp.where(is_there, blends.weight[kept], 1.0)
    back = -jnp.cumsum(jnp.where(is_there[:, None], moves[kept], 0.0), axis=0)
    # Where the pictures of frames k, k-1, ... k-1-memory stand, from the first one on.
    # In the place of the last one stands all that is older, at its mean.
    place = closeness * jnp.concatenate([jnp.zeros_like(back[:1]), back[:-1]])
    place = place.at[-1].add(blends.lag[kept[-1]])
    one = jnp.ones(1, weight.dtype)
    remaining = jnp.concatenate([one, jnp.cumprod(1 - weight[1:-1])])
    share = remaining * jnp.concatenate([weight[1:-1], one])
    before = jnp.concatenate([jnp.zeros_like(one), share])
    after = jnp.concatenate([weight[:1], (1 - weight[0]) * share])

    moved = place + ((1 - closeness) * moves[k])[None]
    first, second = np.triu_indices(memory + 2, 1)
    across = (moved[:, None] - place[None]).reshape(-1, 2)
    within = place[first] - place[second]
    weights = [
        jnp.outer(after, before).reshape(-1),
        -after[first] * after[second] - before[first] * before[second],
    ]
    differences = jax.vmap(squared)(jnp.concatenate([across, within]))
    return jnp.concatenate(weights) @ differences
