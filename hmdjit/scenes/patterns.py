"""Made-up scenes: checkerboard, honeycomb, zone plate, text, noise, plain ones.

All are flat. A size in degrees is one at the centre of the view, where the default
camera has 8.05 px/deg: a degree is pi / 180 tangent units of the image plane.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import _checks
from .._types import Scalar
from ..camera import Camera
from . import base

_DEG_PER_UNIT = 180 / np.pi  # degrees at the centre in one tangent unit
_NYQUIST_PER_DEG = 8.05 / 2  # of the default camera in the centre, cycles per degree


def _number(default: float) -> Scalar:
    return eqx.field(converter=_checks.number, default=default)


def _shade(share: base.Coordinate, dark: Scalar, light: Scalar) -> base.Colors:
    """Grey between dark (0) and light (1)."""
    grey = dark + (light - dark) * share
    return jnp.broadcast_to(grey.astype(share.dtype), (3, *share.shape))


def _check_shades(dark: Scalar, light: Scalar) -> None:
    _checks.in_range("dark", dark, 0, 1)
    _checks.in_range("light", light, 0, 1)


class _Checkerboard(base.AbstractFlatScene):
    square_deg: Scalar = _number(2.0)
    dark: Scalar = _number(0.0)
    light: Scalar = _number(1.0)
    name: str = eqx.field(static=True, default="checkerboard")

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
    return _Checkerboard(square_deg, dark, light, name)


class _Honeycomb(base.AbstractFlatScene):
    cell_deg: Scalar = _number(4.0)
    wall_deg: Scalar = _number(0.4)
    dark: Scalar = _number(0.0)
    light: Scalar = _number(1.0)
    name: str = eqx.field(static=True, default="honeycomb")

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
    return _Honeycomb(cell_deg, wall_deg, dark, light, name)


class _ZonePlate(base.AbstractFlatScene):
    radius_deg: Scalar = _number(40.0)
    cycles_per_deg: Scalar = _number(_NYQUIST_PER_DEG)
    contrast: Scalar = _number(1.0)
    name: str = eqx.field(static=True, default="zone plate")

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
    name: str = "zone plate",
) -> base.AbstractScene:
    """Sinusoidal rings (in gamma) whose frequency grows with the distance.

    **Arguments:**

    - `radius_deg`: angle from the centre at which the rings reach `cycles_per_deg`, in
      `(0, 90)`.
    - `cycles_per_deg`: cycles per degree at the centre; the default is the Nyquist
      frequency of the default camera, half a cycle per display pixel.
    - `contrast`: in `[0, 1]`.

    **Source:** F. Fresnel's plate, as used to test sampling; see e.g. Mitchell and
    Netravali, "Reconstruction Filters in Computer Graphics", SIGGRAPH 1988.
    """
    _checks.in_range("radius_deg", radius_deg, 0, 90, open_low=True, open_high=True)
    _checks.in_range("cycles_per_deg", cycles_per_deg, 0, open_low=True)
    _checks.in_range("contrast", contrast, 0, 1)
    return _ZonePlate(radius_deg, cycles_per_deg, contrast, name)


class _Gradient(base.AbstractFlatScene):
    low: Float[Array, "3"]
    high: Float[Array, "3"]
    name: str = eqx.field(static=True, default="uniform")

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
    return _Gradient(rgb, rgb, name)


def almost_uniform(
    *,
    low: Sequence[float] = (0.56, 0.70, 0.86),
    high: Sequence[float] = (0.53, 0.67, 0.84),
    name: str = "almost uniform",
) -> base.AbstractScene:
    """A shallow, smooth vertical gradient, like a clear sky.

    With the default colours and camera it spans about 6 code values over the frame, and
    one degree of pitch changes a pixel by less than 0.07 code values.

    **Arguments:** `low`, `high`: gamma colours that it tends to far below and far above
    the horizon, each value in `[0, 1]`; in between it follows `tanh(y)` on the plane.
    """
    return _Gradient(_rgb("low", low), _rgb("high", high), name)


def _rgb(field: str, color: Sequence[float]) -> Float[Array, "3"]:
    if len(color) != 3:
        raise ValueError(f"{field} must be three numbers in [0, 1], got {color!r}.")
    for channel, value in zip("red green blue".split(), color, strict=True):
        _checks.in_range(f"{field} ({channel})", float(value), 0, 1)
    return jnp.asarray(color, float)


class _Raster(base.AbstractFlatScene):
    planes: base.StoredPlanes
    texels_per_deg: Scalar = _number(8.0)
    periodic: bool = eqx.field(static=True, default=False)
    name: str = eqx.field(static=True, default="raster")

    def plane_color(
        self, camera: Camera, x: base.Coordinate, y: base.Coordinate
    ) -> base.Colors:
        del camera
        _, height, width = self.planes.shape
        per_unit = self.texels_per_deg * _DEG_PER_UNIT
        column = x * per_unit + (width - 1) / 2
        row = (height - 1) / 2 - y * per_unit
        fold = base.repeat if self.periodic else base.clamp
        return base.read_planes(self.planes, column, row, fold, fold)


def power_law_noise(
    exponent: float = 1.0,
    seed: int = 0,
    *,
    deviation: float = 0.15,
    texels_per_deg: float = 8.0,
    size: int = 1024,
    name: str = "noise",
) -> base.AbstractScene:
    """Grey noise whose amplitude spectrum falls as `1 / frequency^exponent`.

    A periodic raster, read bilinearly in gamma. Its mean is 0.5; what the few values
    beyond 0 and 1 exceed them by is cut off.

    **Arguments:**

    - `exponent`: 0 is white noise, 1 is like natural pictures; in `[0, 4]`.
    - `seed`: whole number of at least 0; the same seed is the same picture.
    - `deviation`: standard deviation before cutting, gamma, in `(0, 0.5]`.
    - `texels_per_deg`: resolution, texels per degree at the centre, above 0.
    - `size`: side of the period, texels, at least 2.
    """
    _checks.in_range("exponent", exponent, 0, 4)
    _checks.whole("seed", seed, 0)
    _checks.in_range("deviation", deviation, 0, 0.5, open_low=True)
    _checks.in_range("texels_per_deg", texels_per_deg, 0, open_low=True)
    _checks.whole("size", size, 2)
    white = np.random.default_rng(seed).standard_normal((size, size))
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None, :])
    frequency[0, 0] = np.inf  # no mean
    weight = np.where(np.isinf(frequency), 0.0, frequency ** -float(exponent))
    field = np.fft.irfft2(np.fft.rfft2(white) * weight, s=(size, size))
    gamma = np.clip(0.5 + deviation * field / field.std(), 0, 1)
    planes = base.stored_planes(gamma.astype(np.float32))
    return _Raster(planes, texels_per_deg, periodic=True, name=name)


_TEXT = (
    "A head that tries to hold still does not. It sways with the breath and the pulse, "
    "it drifts and is pulled back, and the tracker adds a tremor of its own. The picture "
    "in a headset follows every such step: each edge crosses a pixel, comes back, and "
    "crosses it again. Letters show it best, for they are all edges; 0123456789 thin "
    "strokes (and thinner serifs) that a grid of pixels can catch or miss. Whoever reads "
    "this page in a headset sees it shimmer. How much of that can be taken away, and "
    "what does it cost in sharpness? "
)


def page_of_text(
    line_deg: float = 2.5,
    *,
    page_deg: float = 132.0,
    texels_per_deg: int = 16,
    name: str = "text",
) -> base.AbstractScene:
    """A page of black text on white, read bilinearly in gamma; white beyond it.

    The text is drawn once with the scalable font that Pillow brings. Another version of
    Pillow may draw it slightly differently.

    **Arguments:**

    - `line_deg`: from line to line, degrees at the centre; 2.5 is 20 px with the default
      camera. Above 0, at most a tenth of the page.
    - `page_deg`: width and height of the page, degrees at the centre; the default covers
      the default camera's view (127).
    - `texels_per_deg`: resolution; whole, at least 1.

    **Errors:** `ImportError` without Pillow.
    """
    _checks.in_range("page_deg", page_deg, 0, open_low=True)
    _checks.in_range("line_deg", line_deg, 0, page_deg / 10, open_low=True)
    _checks.whole("texels_per_deg", texels_per_deg, 1)
    planes = base.stored_planes(_drawn_text(line_deg, page_deg, texels_per_deg))
    return _Raster(planes, float(texels_per_deg), periodic=False, name=name)


def _drawn_text(line_deg: float, page_deg: float, texels_per_deg: int) -> np.ndarray:
    """The page's gamma codes, uint8, shape `(side, side)`."""
    try:
        from PIL import Image, ImageDraw, ImageFont
    except ImportError as error:
        raise ImportError(
            "Drawing text needs Pillow: install `hmdjit[study]`."
        ) from error
    side = 2 * round(page_deg * texels_per_deg / 2)
    line = line_deg * texels_per_deg
    margin = 0.5 * line
    font = ImageFont.load_default(0.8 * line)
    image = Image.new("L", (side, side), 255)
    draw = ImageDraw.Draw(image)
    words = _TEXT.split()
    next_word = 0
    for top in np.arange(margin, side - margin - line, line):
        text = words[next_word % len(words)]
        next_word += 1
        while True:
            longer = f"{text} {words[next_word % len(words)]}"
            if draw.textlength(longer, font) > side - 2 * margin:
                break
            text, next_word = longer, next_word + 1
        draw.text((margin, round(top)), text, fill=0, font=font)
    return np.asarray(image)
