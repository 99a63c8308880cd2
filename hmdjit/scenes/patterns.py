"""Patterns given by formulas: checkerboard, honeycomb, zone plate, plain, one's own.

All are flat. A size in degrees is one at the centre of the view, where the default
camera has 8.05 px/deg: a degree is pi / 180 tangent units of the image plane.
"""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import _checks
from .._types import Scalar
from ..camera import Camera
from . import base

_DEG_PER_UNIT = 180 / np.pi  # degrees at the centre in one tangent unit
_NYQUIST_PER_DEG = 8.05 / 2  # of the default camera in the centre, cycles per degree


def _number() -> Any:
    return eqx.field(converter=_checks.number)


def _shade(share: base.Coordinate, dark: Scalar, light: Scalar) -> base.Colors:
    """Grey between dark (0) and light (1)."""
    grey = dark + (light - dark) * share
    return jnp.broadcast_to(grey.astype(share.dtype), (3, *share.shape))


def _check_shades(dark: Scalar, light: Scalar) -> None:
    _checks.in_range("dark", dark, 0, 1)
    _checks.in_range("light", light, 0, 1)


class _Checkerboard(base.AbstractFlatScene):
    square_deg: Scalar = _number()
    dark: Scalar = _number()
    light: Scalar = _number()
    name: str = eqx.field(static=True)

    def plane_color(
        self, camera: Camera, x: base.Coordinate, y: base.Coordinate
    ) -> base.Colors:
        del camera
        squares = _DEG_PER_UNIT / self.square_deg
        parity = jnp.floor(x * squares) + jnp.floor(y * squares)
        return _shade(jnp.mod(parity, 2), self.dark, self.light)


def checkerboard(
    square_deg: Scalar = 2.0,
    *,
    dark: Scalar = 0.0,
    light: Scalar = 1.0,
    name: str = "checkerboard",
) -> base.AbstractScene:
    """Squares whose corners meet straight ahead; dark to its upper right.

    **Arguments:**

    - `square_deg`: side of a square, degrees at the centre, above 0.
    - `dark`, `light`: the two greys, gamma, in `[0, 1]`.
    """
    _checks.in_range("square_deg", square_deg, 0, open_low=True)
    _check_shades(dark, light)
    return _Checkerboard(square_deg=square_deg, dark=dark, light=light, name=name)


class _Honeycomb(base.AbstractFlatScene):
    cell_deg: Scalar = _number()
    wall_deg: Scalar = _number()
    dark: Scalar = _number()
    light: Scalar = _number()
    name: str = eqx.field(static=True)

    def plane_color(
        self, camera: Camera, x: base.Coordinate, y: base.Coordinate
    ) -> base.Colors:
        del camera
        cells = _DEG_PER_UNIT / self.cell_deg
        x, y = x * cells, y * cells
        # The centres are two rectangular lattices of 1 x sqrt(3); take the nearer one.
        root = 3**0.5
        x0, y0 = x - jnp.round(x), y - root * jnp.round(y / root)
        x1 = x - jnp.floor(x) - 0.5
        y1 = y - root * (jnp.floor(y / root) + 0.5)
        first = x0**2 + y0**2 <= x1**2 + y1**2
        x, y = jnp.abs(jnp.where(first, x0, x1)), jnp.abs(jnp.where(first, y0, y1))
        # Distance from the centre along the normals of a cell's sides, 1/2 at a side.
        reach = jnp.maximum(x, 0.5 * x + 0.5 * root * y)
        inner = 0.5 - 0.5 * self.wall_deg / self.cell_deg
        is_cell = (reach < inner).astype(x.dtype)
        return _shade(is_cell, self.dark, self.light)


def honeycomb(
    cell_deg: Scalar = 4.0,
    *,
    wall_deg: Scalar = 0.4,
    dark: Scalar = 0.0,
    light: Scalar = 1.0,
    name: str = "honeycomb",
) -> base.AbstractScene:
    """Light hexagonal cells between thin dark walls, one cell straight ahead.

    **Arguments:**

    - `cell_deg`: from a wall's middle to the opposite wall's, degrees at the centre,
      above 0. The cells have two vertical walls each.
    - `wall_deg`: thickness of a wall, degrees at the centre, below `cell_deg`.
    - `dark`, `light`: greys of walls and cells, gamma, in `[0, 1]`.
    """
    _checks.in_range("cell_deg", cell_deg, 0, open_low=True)
    _checks.in_range(
        "wall_deg", wall_deg, 0, float(cell_deg), open_low=True, open_high=True
    )
    _check_shades(dark, light)
    return _Honeycomb(
        cell_deg=cell_deg, wall_deg=wall_deg, dark=dark, light=light, name=name
    )


class _ZonePlate(base.AbstractFlatScene):
    radius_deg: Scalar = _number()
    cycles_per_deg: Scalar = _number()
    contrast: Scalar = _number()
    name: str = eqx.field(static=True)

    def plane_color(
        self, camera: Camera, x: base.Coordinate, y: base.Coordinate
    ) -> base.Colors:
        del camera
        radius = jnp.tan(jnp.asarray(self.radius_deg / _DEG_PER_UNIT, x.dtype))
        per_unit = jnp.asarray(self.cycles_per_deg * _DEG_PER_UNIT, x.dtype)
        # Cycles at r are per_unit r^2 / (2 radius), so their density is per_unit there.
        # Whole cycles are dropped before the cosine, which would lose digits to them.
        cycles = per_unit / (2 * radius) * (x**2 + y**2)
        wave = jnp.cos(2 * jnp.pi * (cycles - jnp.round(cycles)))
        grey = 0.5 + 0.5 * jnp.asarray(self.contrast, x.dtype) * wave
        return jnp.broadcast_to(grey, (3, *grey.shape))


def zone_plate(
    radius_deg: Scalar = 40.0,
    *,
    cycles_per_deg: Scalar = _NYQUIST_PER_DEG,
    contrast: Scalar = 1.0,
    name: str = "zone_plate",
) -> base.AbstractScene:
    """Sinusoidal rings (in gamma) whose frequency grows with the distance.

    **Arguments:**

    - `radius_deg`: angle from the centre at which the rings reach `cycles_per_deg`, in
      `(0, 90)`.
    - `cycles_per_deg`: cycles per degree at the centre; the default is the Nyquist
      frequency of the default camera, half a cycle per display pixel.
    - `contrast`: in `[0, 1]`.

    **Source:** the test picture sin(x^2 + y^2) of Mitchell and Netravali,
    "Reconstruction Filters in Computer Graphics", SIGGRAPH 1988.
    """
    _checks.in_range("radius_deg", radius_deg, 0, 90, open_low=True, open_high=True)
    _checks.in_range("cycles_per_deg", cycles_per_deg, 0, open_low=True)
    _checks.in_range("contrast", contrast, 0, 1)
    return _ZonePlate(
        radius_deg=radius_deg,
        cycles_per_deg=cycles_per_deg,
        contrast=contrast,
        name=name,
    )


class _Gradient(base.AbstractFlatScene):
    low: Float[Array, "3"]
    high: Float[Array, "3"]
    name: str = eqx.field(static=True)

    def plane_color(
        self, camera: Camera, x: base.Coordinate, y: base.Coordinate
    ) -> base.Colors:
        del camera
        channels = (3, *(1,) * x.ndim)
        low = self.low.astype(x.dtype).reshape(channels)
        high = self.high.astype(x.dtype).reshape(channels)
        return low + (high - low) * (0.5 + 0.5 * jnp.tanh(y))[None]


def uniform(
    color: Sequence[float] = (0.5, 0.5, 0.5), *, name: str = "uniform"
) -> base.AbstractScene:
    """One colour everywhere.

    **Arguments:** `color`: gamma red, green, blue, each in `[0, 1]`.
    """
    rgb = _rgb("color", color)
    return _Gradient(low=rgb, high=rgb, name=name)


def almost_uniform(
    *,
    low: Sequence[float] = (0.56, 0.70, 0.86),
    high: Sequence[float] = (0.53, 0.67, 0.84),
    name: str = "almost_uniform",
) -> base.AbstractScene:
    """Give a shallow, smooth vertical gradient, like a clear sky.

    With the default colours and camera it spans about 6 code values over the frame, and
    one degree of pitch changes a pixel by less than 0.07 code values.

    **Arguments:** `low`, `high`: gamma colours that it tends to far below and far above
    the horizon, each value in `[0, 1]`; in between it follows `tanh(y)` on the plane.
    """
    return _Gradient(low=_rgb("low", low), high=_rgb("high", high), name=name)


def _rgb(field: str, color: Sequence[float]) -> Float[Array, "3"]:
    if len(color) != 3:
        raise ValueError(f"{field} must be three numbers in [0, 1], got {color!r}.")
    for channel, value in zip(("red", "green", "blue"), color, strict=True):
        _checks.in_range(f"{field} ({channel})", float(value), 0, 1)
    return jnp.asarray(color, float)


_SEEN_DEG = 80.0  # half of the plane that the default camera and margin see, and more


class _Formula(base.AbstractFlatScene):
    function: Callable[[Any, Any], Any] = eqx.field(static=True)
    name: str = eqx.field(static=True)

    def plane_color(
        self, camera: Camera, x: base.Coordinate, y: base.Coordinate
    ) -> base.Colors:
        del camera

        def color(x: Array, y: Array) -> Array:
            found = self.function(x, y)
            planes = found if isinstance(found, tuple | list) else [found]
            planes = jnp.concatenate([jnp.ravel(jnp.asarray(p)) for p in planes])
            if planes.shape not in ((1,), (3,)):
                raise ValueError(f"it returned {planes.size} numbers")
            return jnp.broadcast_to(planes.astype(x.dtype), 3)

        flat = jax.vmap(color)(_DEG_PER_UNIT * x.ravel(), _DEG_PER_UNIT * y.ravel())
        return flat.T.reshape(3, *x.shape)


def from_function(
    f: Callable[[Any, Any], Any], *, name: str | None = None
) -> base.AbstractScene:
    """Return a scene that a plain function paints, in front of the head.

    Studies keep finished batches of it only if the function has a `version`, changed
    with all that it computes with: `f.version = 1`.

    **Arguments:**

    - `f`: `f(x, y)` of one point, right and up of straight ahead, degrees at the centre
      of the view, is grey or red, green and blue: a number or three, gamma, in
      `[0, 1]`. Written with `jax.numpy`, for it is compiled, and exact: without
      anti-aliasing.
    - `name`: what tables call it; by default the function's own.

    **Errors:** `ValueError` naming the point, if it does not return that within 80
    degrees; all that is baked is held to `[0, 1]` again.
    """
    called = name or getattr(f, "__name__", "function").strip("<>")
    must = f"function {called!r} must return a number or three in [0, 1]"
    scene = _Formula(function=f, name=called)
    # Odd, so that both axes and straight ahead are among the places.
    place = jnp.linspace(-_SEEN_DEG, _SEEN_DEG, 161)
    x, y = jnp.meshgrid(place, place)
    try:
        paint = lambda x, y: scene.plane_color(Camera(), x, y)
        colors = jax.jit(paint)(x / _DEG_PER_UNIT, y / _DEG_PER_UNIT)
    except Exception as error:
        reason = (str(error).splitlines() or [""])[0]
        raise ValueError(f"{must}, got {type(error).__name__}: {reason}") from error
    slack = 0.5 / 255  # as of all colours
    wrong = ~((colors >= -slack) & (colors <= 1 + slack)).all(0)  # also of NaN
    if wrong.any():
        i, j = np.argwhere(wrong)[0]
        raise ValueError(
            f"{must}, got {colors[:, i, j].tolist()} at ({x[i, j]:g}, {y[i, j]:g})."
        )
    return scene
