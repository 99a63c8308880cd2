"""The envelope's holes: what a texel that is no number reaches, in values and slopes.

Pixels that read such a texel show it, and means over them are no number; so are the
slopes of such means in numbers that all pixels share. In the picture itself a slope is
no number only at texels that those pixels read, and what is masked out has no say.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..camera import Camera, Region
from ..frames import resampling
from ..frames.displacement import Reading
from ..frames.frame import Frame
from ..frames.motion import Motion
from ..frames.sources import History
from ..techniques import HeadMovement
from .extremes import bad_leaves, techniques
from .measuring import Bound, Run, Worst

_Rng = np.random.Generator
_Found = tuple[float, str]
_Read = Callable[[Any, Any, Any], Any]

_BLOCK, _RIM = 12, 6  # px that are read, and px of the picture around them


def hidden_holes(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Count what is not finite of a step whose history is no number, masked out."""
    camera = Camera(5, 4, 96.0, 60.0)
    color = jnp.asarray(rng.random((1, 3, 4, 5)), dtype)
    holes = jnp.full((3, 4, 5), jnp.nan, dtype)
    worst = Worst()

    @jax.jit
    @jax.value_and_grad
    def brightness(arguments: tuple, holes: Any) -> Any:
        technique, camera, increment = arguments
        mask = jnp.zeros((4, 5), bool)
        frame = Frame(color, camera, Region.whole(camera), mask, Reading("plain"))
        motion = Motion(increment, increment)
        _, shown = technique.step(History.of(holes), frame, motion)
        return jnp.mean(shown**2)

    increment = 1e-2 * rng.normal(size=3)
    for name, members in techniques().items():
        for technique in members if name != "over SSAA" else []:
            given = (technique, camera, increment)
            given = jax.tree.map(lambda x: jnp.asarray(x, dtype), given)
            bad = bad_leaves(brightness(given, holes))
            worst.add(float(bad), name)
        if quick:
            break
    return worst.found


# --- reading ---


def by_gathers(picture: Any, dx: Any, dy: Any) -> Any:
    """Read the middle of a picture `(height, width, 1)`, moved by dx and dy texels."""
    index = _RIM + jnp.arange(_BLOCK, dtype=jnp.int32)
    moved = jnp.full((_BLOCK, _BLOCK), dx), jnp.full((_BLOCK, _BLOCK), dy)
    texels = resampling.texels(picture)
    return resampling.bilinear(texels, index[None], index[:, None], *moved)[0]


def by_slices(picture: Any, dx: Any, dy: Any) -> Any:
    """Read the same with slices."""
    first, place = jnp.int32(_RIM), jnp.stack([dx, dy])
    moved = jnp.full((_BLOCK, _BLOCK), dx), jnp.full((_BLOCK, _BLOCK), dy)
    # Texels from `floor(d - margin)` on: 3 each way for 1/2, 4 for 1.
    margin = jnp.where(dx > 0, 1.0, 0.5).astype(dx.dtype)
    span = jnp.stack([place - margin, place + margin])
    return resampling.bilinear_by_slices(
        resampling.texels(picture),
        first,
        first,
        (_BLOCK, _BLOCK),
        span,
        lambda: moved,
    )[0]


def _holed(rng: _Rng, quick: bool) -> Iterator[tuple[np.ndarray, float, float, str]]:
    """Pictures with a hole in their middle, and where they are read."""
    size = _BLOCK + 2 * _RIM
    for n in range(6 if quick else 40):
        dx, dy = rng.uniform(-2.2, 2.2, 2) if n else (0.0, 0.0)
        for hole in (np.nan, np.inf):
            picture = rng.random((size, size, 1))
            picture[size // 2, size // 2] = hole
            yield picture, float(dx), float(dy), f"{hole} read at {dx!r}, {dy!r}"


def _beyond(numbers: Any, x: float, y: float, reach: float) -> float:
    """How many that are not finite lie a reach or more from a place."""
    rows, columns = np.nonzero(~np.isfinite(np.asarray(numbers)))
    if not rows.size:
        return np.inf  # a hole that nothing shows is none
    is_near = (np.abs(rows - y) < reach) & (np.abs(columns - x) < reach)
    return float(np.sum(~is_near))


def pixels(read: _Read, reach: float, rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Pixels that a hole reaches beyond those that read it."""
    read, worst = jax.jit(read), Worst()
    for picture, dx, dy, where in _holed(rng, quick):
        found = read(*(jnp.asarray(x, dtype) for x in (picture, dx, dy)))
        worst.add(_beyond(found, _BLOCK / 2 - dx, _BLOCK / 2 - dy, reach), where)
    return worst.found


def slopes(read: _Read, reach: float, rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Texels that it reaches, in the slope of a mean, beyond what those pixels read."""
    mean = lambda picture, dx, dy: jnp.mean(read(picture, dx, dy) ** 2)
    by_picture, worst = jax.jit(jax.grad(mean)), Worst()
    middle = _BLOCK / 2 + _RIM
    for picture, dx, dy, where in _holed(rng, quick):
        found = by_picture(*(jnp.asarray(x, dtype) for x in (picture, dx, dy)))
        worst.add(_beyond(found[..., 0], middle, middle, reach), where)
    return worst.found


def slopes_of_steps(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Count the same of steps that blend the past in, by either picture."""
    camera = Camera(_BLOCK, _BLOCK, 8.0, 60.0)
    worst = Worst()

    @jax.jit
    def by_pictures(technique: HeadMovement, pictures: Any, increment: Any) -> Any:
        def brightness(color: Any, past: Any) -> Any:
            region, reading = Region.whole(camera), Reading("plain")
            frame = Frame(color[None], camera, region, None, reading)
            motion = Motion(increment, increment)
            _, shown = technique.step(History.of(past), frame, motion)
            return jnp.mean(shown**2)

        return jax.grad(brightness, (0, 1))(*pictures)

    for name, members in techniques().items():
        # Sixteen past samples are as two, but take long to compile.
        if name in ("over SSAA", "sixteen"):
            continue
        technique = jax.tree.map(lambda x: jnp.asarray(x, dtype), members[0])
        for n in range(4):
            pictures = rng.random((2, 3, _BLOCK, _BLOCK))
            hole, holed = (np.nan, np.inf)[n % 2], n // 2
            pictures[holed, 1, _BLOCK // 2, _BLOCK // 2] = hole
            # Less than a pixel: 1 px is 0.7 deg here.
            increment = jnp.asarray(rng.uniform(-5e-3, 5e-3, 3), dtype)
            found = by_pictures(technique, jnp.asarray(pictures, dtype), increment)
            bad = sum(
                _beyond(jnp.sum(slope, axis=0), _BLOCK / 2, _BLOCK / 2, 2.0)
                for slope in found
            )
            picture = ("the current picture", "the history")[holed]
            worst.add(bad, f"{name}: {hole} in {picture}")
        if quick:
            break
    return worst.found


def runs() -> list[Run]:
    """All of them."""
    none = {"float32": Bound(0.0), "float64": Bound(0.0)}
    single = {"float32": Bound(0.0)}
    gathers, slices = "resampling.bilinear", "resampling.bilinear_by_slices"
    beyond = "beyond what pixels that show it read"
    # At rest a texel of weight 0 is read as well, 1 from its pixel; slices read 4 x 4.
    reads = (
        (gathers, by_gathers, "2 x 2", 1 + 1e-6, 2.0),
        (slices, by_slices, "4 x 4", 2.0, 4.0),
    )
    found = [
        Run(
            "apply, gradients",
            "masked history of NaN",
            hidden_holes,
            single,
            "not finite",
        ),
        Run(
            "HeadMovement.step, gradient by picture, NaN or inf",
            beyond,
            slopes_of_steps,
            single,
            "texels",
            is_slow=True,
        ),
    ]
    for name, read, taps, of_pixels, of_texels in reads:
        values = partial(pixels, read, of_pixels)
        by_picture = partial(slopes, read, of_texels)
        found += [
            Run(
                f"{name}, NaN or inf",
                f"beyond its {taps} texels",
                values,
                none,
                "pixels",
            ),
            Run(
                f"{name}, gradient by picture, NaN or inf",
                beyond,
                by_picture,
                none,
                "texels",
                is_slow=name != gathers,
            ),
        ]
    return found
