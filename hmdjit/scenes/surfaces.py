"""What surfaces look like: one colour, a checkerboard, stripes, a picture; cut-outs.

A pattern is laid out in metres on a surface's own two coordinates: right and up from
the middle of a rectangle, around and along a cylinder, longitude and latitude times the
radius of a sphere.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from .. import _checks, color
from .._types import Numbers
from . import stored
from .stored import StoredPlanes

AnyArray = Array | np.ndarray
Gamma = tuple[float | int, float | int, float | int]
"""Red, green and blue in [0, 1]."""

UNIFORM, CHECKERBOARD, STRIPES, PICTURE = range(4)  # pictures count on from the last


class Surface(eqx.Module):
    """How a surface is painted, and where it has holes.

    - `first`, `second`: gamma colours of a pattern; of a picture the first tints it.
    - `pattern`: `uniform`, `checkerboard`, `stripes` (along up) or `picture`.
    - `cell_m`: width and height of a field, of a stripe and its gap, or of a picture,
      which repeats; m.
    - `picture`: gamma, `(height, width)` or `(height, width, 3)`.
    - `mask`: True where there is something, `(height, width)`, over a whole rectangle.
    """

    first: Gamma
    second: Gamma = (0.0, 0.0, 0.0)
    pattern: str = eqx.field(static=True, default="uniform")
    cell_m: tuple[float, float] = (1.0, 1.0)
    picture: StoredPlanes | None = None
    mask: Bool[np.ndarray, "height width"] | None = None

    def __check_init__(self):
        known = ("uniform", "checkerboard", "stripes", "picture")
        _checks.one_of("pattern", self.pattern, known)
        for name, value in (("first", self.first), ("second", self.second)):
            for part in value:
                _checks.in_range(f"{name} of a surface", float(part), 0, 1)
        for side in self.cell_m:
            _checks.in_range("cell_m of a surface", float(side), 0, open_low=True)
        if (self.picture is not None) != (self.pattern == "picture"):
            raise ValueError("picture of a surface must go with pattern='picture'.")

    def cut_out(self, mask: ArrayLike) -> "Surface":
        """Return the surface with holes where `mask` is False."""
        return eqx.tree_at(
            lambda surface: surface.mask,
            self,
            np.asarray(mask, bool),
            is_leaf=lambda leaf: leaf is None,
        )


def uniform(first: Gamma) -> Surface:
    """Paint in one gamma colour."""
    return Surface(first)


def checkerboard(first: Gamma, second: Gamma, cell_m: float) -> Surface:
    """Paint squares of two gamma colours."""
    return Surface(first, second, "checkerboard", (cell_m, cell_m))


def stripes(first: Gamma, second: Gamma, width_m: float, gap_m: float) -> Surface:
    """Paint bands of the first colour across up, with gaps of the second."""
    return Surface(first, second, "stripes", (width_m, gap_m))


def picture(picture: ArrayLike, width_m: float) -> Surface:
    """Hang a picture, gamma as `scenes.Photograph.of` takes it, in its own shape."""
    planes = stored.stored_planes(picture)
    _, height, width = planes.shape
    cell = (width_m, width_m * height / width)
    return Surface((1.0, 1.0, 1.0), pattern="picture", cell_m=cell, picture=planes)


class Paint(eqx.Module):
    """Rows of a table of primitives: their surfaces.

    - `kind`: of the pattern; from `PICTURE` on, which picture.
    - `first`, `second`: colours, linear light.
    - `cell_m`: see `Surface`.
    - `mask`: which mask cuts holes; -1 is none.

    A program that does not need one of them has None in its place.
    """

    kind: Int[AnyArray, "*rows"] | None
    first: Float[AnyArray, "*rows 3"]
    second: Float[AnyArray, "*rows 3"] | None
    cell_m: Float[AnyArray, "*rows 2"] | None
    mask: Int[AnyArray, "*rows"] | None

    def needed(self, kinds: Sequence[int], has_masks: bool) -> "Paint":
        """Leave out what patterns of these kinds do not read."""
        has_pattern = tuple(kinds) != (UNIFORM,)
        return Paint(
            self.kind if len(kinds) > 1 else None,
            self.first,
            self.second if has_pattern else None,
            self.cell_m if has_pattern else None,
            self.mask if has_masks else None,
        )


class Gallery:
    """Collects the pictures and masks of surfaces while a scene is put together."""

    def __init__(self):
        self.pictures: list[StoredPlanes] = []
        self.masks: list[np.ndarray] = []
        self.kinds: set[int] = set()
        self._paints: dict[int, tuple[Surface, Paint]] = {}  # by `id`, kept alive

    def paint(self, surface: Surface) -> Paint:
        """Make the row of a surface, once for all that have it."""
        if id(surface) not in self._paints:
            self._paints[id(surface)] = surface, self._row(surface)
        return self._paints[id(surface)][1]

    def _row(self, surface: Surface) -> Paint:
        kinds = {"uniform": UNIFORM, "checkerboard": CHECKERBOARD, "stripes": STRIPES}
        kind, mask = kinds.get(surface.pattern, PICTURE), -1
        if surface.picture is not None:
            kind += _place(self.pictures, surface.picture)
        if surface.mask is not None:
            mask = _place(self.masks, surface.mask)
        self.kinds.add(kind)
        first, second = map(linear, (surface.first, surface.second))
        return Paint(
            np.asarray(kind, np.int32),
            first,
            second,
            np.asarray(surface.cell_m, np.float64),
            np.asarray(mask, np.int32),
        )


def linear(gamma: Gamma) -> np.ndarray:
    """Decode a gamma colour."""
    single = color.decode(jnp.asarray(gamma, jnp.result_type(float)))
    return np.asarray(single, np.float64)


def _place(known: list, new: ArrayLike) -> int:
    for place, one in enumerate(known):
        if one is new:
            return place
    known.append(new)
    return len(known) - 1


def light(
    paint: Paint,
    place_m: tuple[Numbers, Numbers],
    kinds: Sequence[int],
    pictures: Sequence[StoredPlanes],
) -> Float[Array, "3 h w"]:
    """Albedo at places of one surface, linear light.

    **Arguments:** `kinds`: those that the scene has; no other one is compiled.
    """
    a, b = place_m
    size = jnp.broadcast_shapes(a.shape, b.shape)
    rgb = lambda vector: jnp.broadcast_to(
        vector.reshape(3, *(1,) * len(size)).astype(a.dtype), (3, *size)
    )
    width, height = (1.0, 1.0) if paint.cell_m is None else paint.cell_m

    def either(is_first: Bool[Array, "h w"]) -> Float[Array, "3 h w"]:
        return jnp.where(is_first[None], rgb(paint.first), rgb(paint.second))

    def fields() -> Float[Array, "3 h w"]:
        parity = jnp.floor(a / width) + jnp.floor(b / height)
        return either(jnp.broadcast_to(parity % 2 == 0, size))

    def bands() -> Float[Array, "3 h w"]:
        in_period = b - (width + height) * jnp.floor(b / (width + height))
        return either(jnp.broadcast_to(in_period < width, size))

    def hung(planes: StoredPlanes) -> Float[Array, "3 h w"]:
        _, rows, columns = planes.shape
        column = (a / width + 0.5) * columns - 0.5
        row = (0.5 - b / height) * rows - 0.5
        column, row = jnp.broadcast_arrays(column, row)
        gamma = stored.read_planes(planes, column, row, stored.repeat, stored.repeat)
        return color.decode(gamma) * rgb(paint.first)

    ways = {
        UNIFORM: lambda: rgb(paint.first),
        CHECKERBOARD: fields,
        STRIPES: bands,
        **{PICTURE + n: (lambda p=p: hung(p)) for n, p in enumerate(pictures)},
    }
    if (kind := paint.kind) is None:
        return ways[kinds[0]]()
    index = jnp.searchsorted(jnp.asarray(kinds, jnp.int32), jnp.asarray(kind))
    return jax.lax.switch(index, [ways[kind] for kind in kinds])


def is_solid(
    mask: Int[Array, ""],
    place: tuple[Numbers, Numbers],
    masks: Bool[Array, "masks height width"],
) -> Bool[Array, "h w"]:
    """Whether one surface has no hole at places in [-1, 1], right and up."""
    _, rows, columns = masks.shape
    column = jnp.clip((place[0] + 1) / 2 * columns, 0, columns - 1).astype(jnp.int32)
    row = jnp.clip((1 - place[1]) / 2 * rows, 0, rows - 1).astype(jnp.int32)

    def holes() -> Bool[Array, "h w"]:
        return masks[jnp.maximum(mask, 0), row, column]

    size = jnp.broadcast_shapes(row.shape, column.shape)
    return jax.lax.cond(mask >= 0, holes, lambda: jnp.ones(size, bool))
