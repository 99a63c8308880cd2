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
from jaxtyping import Array, Float, Int

from . import _checks, blending, quaternion, resampling
from . import camera as pinhole
from ._types import Numbers, Scalar, WholeNumber
from .camera import Camera
from .frame import Motion, Texture
from .metrics.mtcd import CODE_VALUES
from .resampling import Texels
from .techniques import SSAA, Freeze, HeadMovement, NoAntialiasing
from .techniques.base import AbstractTechnique

DIRECTIONS = 8
"""Tabled directions, over half a circle: a picture differs as much there and back."""

# Multiples of these, modulo 1, fill a square evenly (Roberts' R2 sequence).
_R2 = (0.7548776662466927, 0.5698402909980532)

Cells = Int[Array, " cells"]
Vector = Float[Array, "2"]
Moves = Float[Array, "frames 2"]
Harmonics = Float[Array, "octaves harmonics"]
Squared = Callable[[Vector], Float[Array, ""]]


class PictureStatistics(eqx.Module):
    """How much a picture differs from itself displaced, in each cell of the frame.

    Let `D(u)` be the mean over a cell's pixels of the RGB distance between the picture
    and itself displaced by u, colours in `[0, 1]`. Cells go row by row, from the upper
    left one.

    - `slope_squared`: Fourier coefficients over the direction of u of `(D(u) / |u|)^2`,
      px^-2, for |u| of `finest_px`, twice, four times, ... that; shape
      `(cells, octaves, DIRECTIONS)`.
    - `finest_px`: up to this length D is proportional to it; px, above 0. Beyond the
      coarsest tabled length it is, too.
    - `cell_px`: side of a cell.
    - `supersampled`: whether of the texture's SSAA(4) reference.

    With one octave this is the small-motion limit: the mean length of the picture's
    gradient times u.
    """

    slope_squared: Float[Array, "cells octaves harmonics"]
    finest_px: Scalar = eqx.field(converter=_checks.number)
    cell_px: int = eqx.field(static=True)
    supersampled: bool = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        texture: Texture,
        camera: Camera,
        *,
        cell_px: int = 64,
        finest_px: float = 1 / 4,
        octaves: int = 6,
        supersampled: bool = False,
    ) -> "PictureStatistics":
        """Measure a baked scene, seen from the hold pose.

        **Arguments:**

        - `texture`: baked for this camera. Displacements beyond its margin clamp.
        - `cell_px`: must divide the camera's width and height; that of a study's tiles.
        - `finest_px`, `octaves`: the tabled lengths, px; up to 8 px by default, which a
          head of the fastest blended speed (25 deg/s) moves a picture at 60 Hz.
        - `supersampled`: measure the SSAA(4) reference, which SSAA(4) shows.

        **Errors:** `ValueError` for cells that do not divide the frame, and for lengths
        or numbers of octaves that are not positive.

        **Accuracy:** the picture is read as the simulation reads it, bilinearly, at one
        place of each pixel that differs from pixel to pixel: a moved head's pixels lie
        anywhere between texels. Between directions D^2 is interpolated by harmonics
        (exact where all gradients of a cell are parallel), between lengths linearly per
        octave.
        """
        _checks.whole("cell_px", cell_px, 1)
        _checks.whole("octaves", octaves, 1)
        _checks.in_range("finest_px", finest_px, 0, open_low=True)
        if camera.width_px % cell_px or camera.height_px % cell_px:
            raise ValueError(
                "cell_px must divide the camera frame "
                f"{camera.width_px} x {camera.height_px}, got {cell_px}."
            )
        slope_squared = _tabulate(
            texture.supersampled if supersampled else texture.color,
            camera,
            (texture.margin_px, texture.oversampling, cell_px, octaves),
            finest_px,
        )
        return cls(slope_squared, finest_px, cell_px, supersampled)

    def select(self, cells: Cells) -> "PictureStatistics":
        """Pick cells by their numbers, any of them any number of times."""
        return eqx.tree_at(lambda s: s.slope_squared, self, self.slope_squared[cells])

    def difference(self, displacement_px: Float[Array, "cells 2"]) -> Numbers:
        """`D(u)` of each cell for a displacement each, shape `(cells,)`.

        **Arguments:** `displacement_px`: u, px, x right and y down.

        **Accuracy:** even in u; at 0 it is 0 and its gradient is chosen as exactly 0.
        """
        squared = jax.vmap(_difference_squared, (0, None, 0))
        return _root(squared(self.slope_squared, self.finest_px, displacement_px))


def cell_numbers(camera: Camera, cell_px: int, origins: Int[Array, "cells 2"]) -> Cells:
    """Numbers of cells, of which any pixels are given, `(x0, y0)`."""
    column, row = origins[:, 0] // cell_px, origins[:, 1] // cell_px
    return row * (camera.width_px // cell_px) + column


def _root(squared: Numbers) -> Numbers:
    """Square root of what is not negative but for rounding; its gradient at 0 is 0."""
    is_positive = squared > 0
    # sqrt has an infinite slope at 0: keep 0 out of it, then put the value back.
    return jnp.where(is_positive, jnp.sqrt(jnp.where(is_positive, squared, 1.0)), 0.0)


def _difference_squared(
    slope_squared: Harmonics, finest_px: Scalar, displacement_px: Vector
) -> Float[Array, ""]:
    """`D(u)^2` in one cell."""
    octaves, harmonics = slope_squared.shape
    dx, dy = displacement_px[0], displacement_px[1]
    length_squared = dx**2 + dy**2
    is_zero = length_squared == 0
    safe = jnp.where(is_zero, 1.0, length_squared)
    cosine, sine = (dx**2 - dy**2) / safe, 2 * dx * dy / safe  # of twice the direction
    waves = [jnp.ones_like(dx)]
    c, s = cosine, sine
    while len(waves) < harmonics:
        waves += [c, s]
        c, s = c * cosine - s * sine, s * cosine + c * sine
    wave = jnp.stack(waves[:harmonics])
    octave = 0.5 * jnp.log2(safe / finest_px**2)
    node = jnp.arange(octaves, dtype=octave.dtype)
    share = jnp.maximum(1 - jnp.abs(jnp.clip(octave, 0, octaves - 1) - node), 0)
    return jnp.where(is_zero, 0.0, length_squared * (share @ (slope_squared @ wave)))


def _to_harmonics(dtype: jnp.dtype) -> Float[Array, "harmonics directions"]:
    """Matrix from values at `DIRECTIONS` to the waves 1, cos 2a, sin 2a, cos 4a, ..."""
    angle = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    orders = [(f, n) for n in range(1, DIRECTIONS // 2 + 1) for f in (np.cos, np.sin)]
    rows = [np.ones(DIRECTIONS)] + [2 * f(n * angle) for f, n in orders[:-1]]
    rows[-1] /= 2  # the shortest wave is seen at its crests only
    return jnp.asarray(np.stack(rows) / DIRECTIONS, dtype)


@partial(jax.jit, static_argnames="layout")
def _tabulate(
    texels: Texels, camera: Camera, layout: tuple[int, int, int, int], finest_px: Scalar
) -> Float[Array, "cells octaves harmonics"]:
    margin_px, scale, cell_px, octaves = layout
    width, height, dtype = camera.width_px, camera.height_px, texels.dtype
    column = jnp.arange(width, dtype=jnp.int32)[None, :]
    row = jnp.arange(height, dtype=jnp.int32)[:, None]
    i, j = column.astype(dtype), row.astype(dtype)
    # Places in a texel around its centre, from pixel to pixel.
    place_x = jnp.mod(_R2[0] * i + _R2[1] * j, 1.0) - 0.5
    place_y = jnp.mod(_R2[1] * i - _R2[0] * j, 1.0) - 0.5

    def read(x_px: Float[Array, ""], y_px: Float[Array, ""]) -> Array:
        left, top = scale * (column + margin_px), scale * (row + margin_px)
        dx, dy = place_x + scale * x_px, place_y + scale * y_px
        return resampling.bilinear(texels, left, top, dx, dy)

    def mean(plane: Array) -> Array:
        blocks = plane.reshape(height // cell_px, cell_px, width // cell_px, cell_px)
        return jnp.mean(blocks, (1, 3)).reshape(-1)

    unmoved = read(jnp.zeros((), dtype), jnp.zeros((), dtype))

    def slope(displacement: tuple) -> Float[Array, " cells"]:
        length, angle = displacement
        moved = read(length * jnp.cos(angle), length * jnp.sin(angle))
        distance = jnp.sqrt(jnp.sum((moved - unmoved) ** 2, axis=0))
        return mean(distance) / length

    lengths = finest_px * 2.0 ** jnp.arange(octaves, dtype=dtype)
    angles = jnp.asarray(np.pi * np.arange(DIRECTIONS) / DIRECTIONS, dtype)
    pairs = jnp.repeat(lengths, DIRECTIONS), jnp.tile(angles, octaves)
    slopes = jax.lax.map(slope, pairs).reshape(octaves, DIRECTIONS, -1)
    return jnp.einsum("hd,odc->coh", _to_harmonics(dtype), slopes**2)


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
    technique = technique.on_pictures()
    if isinstance(technique, NoAntialiasing | Freeze):
        return None
    if isinstance(technique, SSAA):
        if technique.reads_supersampled:
            return None
        return "only SSAA(4) in linear light is tabled"
    if not isinstance(technique, HeadMovement):
        return "it is no displacement of the scene"
    if technique.resolve is not None and not technique.reads_supersampled:
        return "of what it resolves, only SSAA(4) in linear light is tabled"
    if technique.difference == "max_channel" or technique.space == "linear":
        return "only RGB distances of gamma colours are tabled"
    return None


def has_theory(technique: AbstractTechnique) -> bool:
    """Whether `predict` knows a technique."""
    return _refusal(technique) is None


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
    if cells is None:
        cells = jnp.arange(statistics.slope_squared.shape[0], dtype=jnp.int32)
    else:
        statistics = statistics.select(cells)
    turn = motion.increment
    if isinstance(technique, Freeze):
        return jnp.zeros(cells.shape, turn.dtype)
    maps = _displacements(camera, statistics.cell_px, cells, turn.dtype)
    scene_moves = jnp.einsum("cij,kj->cki", maps, turn)
    if not isinstance(technique, HeadMovement):
        of_pairs = jax.vmap(statistics.difference, 1)
        return CODE_VALUES * jnp.mean(of_pairs(scene_moves[:, warmup + 1 :]), axis=0)
    speed_deg_s = jax.vmap(quaternion.angle)(turn) * camera.refresh_hz * (180 / np.pi)
    easing = blending.ease(speed_deg_s, technique.h_max_deg_s)

    closeness = _closeness(technique)
    measured = jnp.arange(warmup + 1, turn.shape[0], dtype=jnp.int32)

    def one_cell(slope_squared: Harmonics, moves: Moves) -> Float[Array, ""]:
        squared = partial(_difference_squared, slope_squared, statistics.finest_px)
        blends = _blending(technique, closeness, squared, moves, easing)

        def of_pair(k: WholeNumber) -> Float[Array, ""]:
            if memory == 0:
                return squared(moves[k] + blends.lag[k] - blends.lag[k - 1])
            return _of_blends(squared, closeness, memory, moves, blends, k)

        return CODE_VALUES * jnp.mean(_root(jax.vmap(of_pair)(measured)))

    return jax.vmap(one_cell)(statistics.slope_squared, scene_moves)


def _closeness(technique: HeadMovement) -> Scalar:
    """Mean closeness of the past samples, by their weights in equation (2)."""
    d = technique.closeness
    raw = d if technique.weights is None else technique.weights
    total = sum(raw)
    is_zero = total == 0  # all samples are at d = 0
    mean = sum(w * c for w, c in zip(raw, d, strict=True)) / jnp.where(
        is_zero, 1, total
    )
    return jnp.where(is_zero, 0.0, mean)


class _Blending(eqx.Module):
    """Weight A of the current picture and lag e, px, at a frame or along a session."""

    weight: Float[Array, "*frames"]
    lag: Float[Array, "*frames 2"]


def _blending(
    technique: HeadMovement,
    closeness: Scalar,
    squared: Squared,
    moves: Moves,
    easing: Float[Array, " frames"],
) -> _Blending:
    compared = 1.0 if technique.difference == "same_pixel" else closeness

    def advance(lag: Vector, now: tuple) -> tuple[Vector, _Blending]:
        move, easing = now
        difference = _root(squared(lag - compared * move)) / 3**0.5
        minimum = blending.localized_minimum(
            technique.w_min, technique.w_lb, jnp.minimum(difference, 1.0)
        )
        weight = blending.current_weight(minimum, easing)
        lag = (1 - weight) * (lag - closeness * move)
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
