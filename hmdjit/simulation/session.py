"""One session: a scan over frames, metrics reduced on the fly. No frame is stored.

Unbatched, not jitted: `simulate` and studies compile it.
"""

import dataclasses
from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import camera_bounds, color, rendering
from .._types import Rgb, RotationVector, WholeNumber
from ..camera import Camera, Region
from ..frames.displacement import AT_REST, GATHER, SLICES, Reading
from ..frames.frame import Frame
from ..frames.motion import Motion
from ..frames.sources import Texture
from ..metrics.mtcd import CODE_VALUES
from ..techniques import SSAA
from ..techniques.base import AbstractTechnique, State
from . import blocks


class Result(eqx.Module):
    """What a session measures.

    - `mtcd`: flicker, mean temporal colour difference, code values (0 to 441.7).
    - `detail_loss`: mean squared error of the displayed frames against the SSAA(4)
      reference of the same pose, code values squared.
    """

    mtcd: Float[Array | np.ndarray, "*sessions"]
    detail_loss: Float[Array | np.ndarray, "*sessions"]


def session(
    texture: Texture,
    camera: Camera,
    technique: AbstractTechnique,
    motion: Motion,
    region: Region,
    measured: Region,
    *,
    warmup: int,
    reading: Reading = GATHER,
    detail_loss: bool = True,
) -> Result:
    """Simulate one session on one region; not jitted, unbatched.

    **Arguments:**

    - `motion`: of `warmup + frames` poses; the first offset is 0.
    - `region`: the pixels that are rendered and filtered.
    - `measured`: those that are measured; inside the region.
    - `warmup`: how many displayed frames are not measured; static.
    - `reading`: how sources are read; static.
    - `detail_loss`: whether to measure it (else it is 0); static.

    **Returns:** the measurements; NaN where the head leaves the texture's margin, for
    a clamped read would look like a calm picture, and where a number of the camera or
    of the technique is out of its range.
    """
    bounds = jax.vmap(lambda r: camera_bounds.displacement_bound(camera, region, r))(
        motion.offset
    )
    is_covered = jnp.all(bounds <= texture.margin_px)
    is_covered = is_covered & camera.is_valid & technique.is_valid
    table = technique.sample_offsets_px
    dtype = motion.offset.dtype
    is_reference = isinstance(technique, SSAA) and technique.reads_supersampled

    def frame_at(part: Region, offset: RotationVector, k: WholeNumber) -> Frame:
        # Rows of a table of one stay NumPy: a sample at the centre then costs nothing.
        samples = table[0] if len(table) == 1 else jnp.asarray(table)[k % len(table)]
        return rendering.render(
            texture,
            camera,
            part,
            offset,
            samples,
            supersampled=technique.reads_supersampled,
            reading=reading,
        )

    first = warmup if not technique.remembers else 0
    # The first measured frame has no measured frame before it.
    has_loss = detail_loss and not is_reference
    first_summed = warmup if has_loss else warmup + 1
    rim_px = blocks.RIM_PX if reading.sampler == "slices" else 0

    def init(part: Region) -> State:
        return technique.init(frame_at(part, motion.offset[first], first))

    state = jax.eval_shape(init, region)
    # A stencil would find no neighbours at a block's edge.
    is_local = technique.stencil_radius_px == 0 and blocks.is_cuttable(state)
    is_cut = reading.sampler == "slices" and is_local
    grid = blocks.cut(region) if is_cut else blocks.uncut(region)
    is_whole = grid.count == 1
    # Of a region in one piece only the measured part is kept of what is shown.
    shown_region = measured if is_whole else region

    def shown_block(
        state: State, block: Region, k: WholeNumber, now: Motion
    ) -> tuple[State, Rgb]:
        """State and display of a block.

        The first frame starts the history. That choice is also a boundary that XLA does
        not fuse across: it would blend anew for each use of the displayed picture.
        """
        frame = frame_at(block, now.offset, k)
        still = dataclasses.replace(frame, reading=AT_REST)

        def displayed(before: State, frame: Frame) -> tuple[State, Rgb | None]:
            new, shown = technique.step(before, frame, now)
            return new, None if technique.displays_history else shown

        new, shown = jax.lax.cond(
            k == first,
            lambda: displayed(technique.init(frame), still),
            lambda: displayed(state, frame),
        )
        return new, new.under(block) if shown is None else shown

    def sums(shown: Rgb, previous: Rgb, part: Region, offset: RotationVector) -> Array:
        """Distance to the frame before, and squared error, summed over pixels."""
        found = [color.distance(shown, previous)]
        if has_loss:
            reference = rendering.reference(texture, camera, part, offset, reading)
            found.append(color.squared_distance(shown, reference))
        if not _same_size(shown_region, measured):
            found = [jnp.where(part.is_in(measured), plane, 0) for plane in found]
        totals = [jnp.sum(plane) for plane in found]
        return jnp.stack([*totals, jnp.zeros((), dtype)][:2])

    def advance(carry: tuple, step: tuple) -> tuple[tuple, None]:
        state, previous, total = carry
        k, now = step
        is_counted = jnp.stack([k > warmup, k >= warmup])

        def on_block(n: Array, carry: tuple) -> tuple:
            new, latest, total = carry
            block = grid.block(n)
            mine, shown = shown_block(state, block, k, now)
            part = measured if is_whole else block
            shown = blocks.part_of(shown, block, part)

            if technique.displays_history:
                before = state.under(part)
            else:
                before = blocks.part_of(previous, shown_region, part)
            found = jax.lax.cond(
                k >= first_summed,
                lambda: sums(shown, before, part, now.offset),
                lambda: jnp.zeros(2, dtype),
            )
            total = _compensated(total, jnp.where(is_counted, found, 0))
            if is_whole:
                return blocks.kept(mine, region, rim_px), shown, total
            if not technique.displays_history:
                place = blocks.start(region, part)
                latest = jax.lax.dynamic_update_slice(latest, shown, place)
            return blocks.written(new, mine, block), latest, total

        if is_whole:
            new, latest, total = on_block(jnp.int32(0), (state, previous, total))
        else:
            blank = blocks.blank(state, region, rim_px)
            start = (blank, jnp.zeros_like(previous), total)
            new, latest, total = jax.lax.fori_loop(0, grid.count, on_block, start)
            new = blocks.rimmed(new)
        return (new, previous if technique.displays_history else latest, total), None

    size = (3, shown_region.height, shown_region.width)
    previous = jnp.zeros((0,) if technique.displays_history else size, dtype)
    state = blocks.blank(state, region, rim_px)

    frames = motion.offset.shape[0]
    steps = jnp.arange(first, frames, dtype=jnp.int32)
    motions = jax.tree.map(lambda leaf: leaf[first:], motion)
    start = (state, previous, jnp.zeros((2, 2), dtype))
    # Reverse mode then keeps of each frame only what goes on to the next one.
    is_plain = reading.sampler == "plain"
    step = jax.checkpoint(advance, prevent_cse=False) if is_plain else advance
    (_, _, (total, _)), _ = jax.lax.scan(step, start, (steps, motions))
    flicker, loss = total / (measured.width * measured.height)
    pairs = frames - warmup - 1
    nothing = jnp.where(is_covered, 0.0, jnp.nan).astype(dtype)
    return Result(
        CODE_VALUES * flicker / pairs + nothing,
        CODE_VALUES**2 * loss / (3 * (pairs + 1)) + nothing,
    )


def _compensated(total: Array, term: Array) -> Array:
    """Add to a sum, `(2, ...)`, that keeps what rounding took from it (Kahan 1965).

    A session may have 1e5 frames, and a frame many blocks.
    """
    term = term - total[1]
    new = total[0] + term
    return jnp.stack([new, jax.lax.stop_gradient((new - total[0]) - term)])


def _same_size(one: Region, other: Region) -> bool:
    return (one.width, one.height) == (other.width, other.height)


def differentiable_session(warmup: int, reading: Reading) -> Callable[..., Result]:
    """Return `session` for these: fast, yet ready for `vmap` and `grad`.

    Slices must stay slices: under `jax.vmap` they would become gathers, hundreds of
    times as slow, so a batch runs one session after the other. Derivatives are those of
    the plain gather form, which also vectorises.
    """
    run = partial(session, warmup=warmup, reading=reading)
    if reading.sampler != "slices":
        return run
    plain = partial(run, reading=dataclasses.replace(reading, sampler="plain"))
    fast = jax.custom_jvp(jax.custom_batching.sequential_vmap(run))
    fast.defjvp(partial(jax.jvp, plain))
    return fast


def fastest_reading() -> Reading:
    """Return how sources are read fastest here: by slices on a CPU, else by gathers."""
    return SLICES if jax.default_backend() == "cpu" else GATHER
