"""Patterns drawn once and stored: noise, a page of text.

Both are flat. A size in degrees is one at the centre of the view, where the default
camera has 8.05 px/deg: a degree is pi / 180 tangent units of the image plane.
"""

import equinox as eqx
import numpy as np

from .. import _checks
from .._types import Scalar
from ..camera import Camera
from . import base, stored

_DEG_PER_UNIT = 180 / np.pi  # degrees at the centre in one tangent unit


class _Raster(base.AbstractFlatScene):
    planes: stored.StoredPlanes
    texels_per_deg: Scalar = eqx.field(converter=_checks.number)
    periodic: bool = eqx.field(static=True)
    name: str = eqx.field(static=True)

    def plane_color(
        self, camera: Camera, x: base.Coordinate, y: base.Coordinate
    ) -> base.Colors:
        del camera
        _, height, width = self.planes.shape
        per_unit = self.texels_per_deg * _DEG_PER_UNIT
        column = x * per_unit + (width - 1) / 2
        row = (height - 1) / 2 - y * per_unit
        fold = stored.repeat if self.periodic else stored.clamp
        return stored.read_planes(self.planes, column, row, fold, fold)


def power_law_noise(
    exponent: float = 1.0,
    seed: int = 0,
    *,
    deviation: float = 0.15,
    texels_per_deg: float = 8.0,
    size: int = 1024,
    name: str = "noise",
) -> base.AbstractScene:
    """Draw grey noise whose amplitude spectrum falls as `1 / frequency^exponent`.

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
    planes = stored.stored_planes(gamma.astype(np.float32))
    return _Raster(
        planes=planes, texels_per_deg=texels_per_deg, periodic=True, name=name
    )


_TEXT = (
    "A head that tries to hold still does not. It sways with the breath and the pulse, "
    "it drifts and is pulled back, and the tracker adds a tremor of its own. In a "
    "headset the picture follows every such step: each edge crosses a pixel, comes "
    "back, and crosses it again. Letters show it best, for they are all edges; "
    "0123456789 thin strokes (and thinner ones) that a grid of pixels may catch or "
    "miss. Whoever reads this page in a headset sees it shimmer. How much of that can "
    "be taken away, and what does it cost in sharpness?"
)


def page_of_text(
    line_deg: float = 2.5,
    *,
    page_deg: float = 124.0,
    texels_per_deg: int = 16,
    name: str = "text",
) -> base.AbstractScene:
    """Draw a page of black text on white, read bilinearly in gamma; white beyond it.

    The text is drawn once with the scalable font that Pillow brings. Another version of
    Pillow may draw it slightly differently.

    **Arguments:**

    - `line_deg`: from line to line, degrees at the centre; 2.5 is 20 px with the
      default camera. Above 0, at most a tenth of the page.
    - `page_deg`: width and height of the page, degrees at the centre; the default
      nearly fills the default camera's view (127).
    - `texels_per_deg`: resolution; whole, at least 1.

    **Errors:** `ImportError` without Pillow.
    """
    _checks.in_range("page_deg", page_deg, 0, open_low=True)
    _checks.in_range("line_deg", line_deg, 0, page_deg / 10, open_low=True)
    _checks.whole("texels_per_deg", texels_per_deg, 1)
    planes = stored.stored_planes(drawn_text(line_deg, page_deg, texels_per_deg))
    return _Raster(
        planes=planes, texels_per_deg=texels_per_deg, periodic=False, name=name
    )


def drawn_text(line: float, page: float, texels: int) -> np.ndarray:
    """Gamma codes of a page, uint8, `(side, side)`; `texels` per unit of length."""
    try:
        from PIL import Image, ImageDraw, ImageFont
    except ImportError as error:
        raise ImportError(
            "Drawing text needs Pillow: install `hmdjit[study]`."
        ) from error
    side = 2 * round(page * texels / 2)
    line = line * texels
    margin = line
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
