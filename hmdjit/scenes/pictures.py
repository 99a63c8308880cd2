"""Pictures as scenes: a flat photograph, a panorama all around."""

import os
import warnings
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float, UInt

from .. import _checks
from .._types import Scalar
from ..camera import Camera
from . import base, stored


class Photograph(base.AbstractFlatScene):
    """A flat picture, its centre straight ahead, read bilinearly in gamma.

    Beyond its edges it continues as its mirror image, so it fills any field of view.

    - `planes`: the picture as `of` and `read` keep it, `(channels, height, width)`.
    - `magnification`: display pixels per texel in the hold pose; above 0. With 1 and
      even sizes, the hold pose shows the picture's own texels.
    - `name`: what tables call it.
    """

    planes: stored.StoredPlanes
    magnification: Scalar = eqx.field(
        converter=_checks.number, default=1.0, kw_only=True
    )
    name: str = eqx.field(static=True, default="photograph", kw_only=True)

    def __check_init__(self):
        stored.check_planes(self.planes)
        _checks.in_range("magnification", self.magnification, 0, open_low=True)

    @classmethod
    def of(
        cls,
        picture: ArrayLike,
        *,
        name: str = "photograph",
        magnification: Scalar = 1.0,
    ) -> "Photograph":
        """Keep a picture.

        **Arguments:** `picture`: gamma, shape `(height, width)` or
        `(height, width, 3)`; uint8, uint16, or floating in `[0, 1]`.

        **Errors:** `ValueError` for any other shape, dtype or range.
        """
        return cls(
            stored.stored_planes(picture), magnification=magnification, name=name
        )

    @classmethod
    def read(
        cls,
        path: str | os.PathLike,
        *,
        name: str | None = None,
        magnification: Scalar = 1.0,
    ) -> "Photograph":
        """Read a PNG, JPEG or other file that Pillow can read.

        - Turned upright by its EXIF orientation, if that can be read.
        - Black lies behind transparent pixels, blended in gamma.
        - Embedded colour profiles (ICC) are not applied: codes are taken as sRGB.
        - Of an animation (GIF, APNG, WebP) or of several pages, the first.
        - 16-bit grey keeps its 16 bits; Pillow gives 16-bit colour in 8 bits. Floating,
          signed and 32-bit values have no stated range: they are refused.
        - At most 179 million pixels, twice Pillow's `MAX_IMAGE_PIXELS`.

        **Arguments:** `name`: by default the file's name without its ending.

        **Errors:** `FileNotFoundError`, `IsADirectoryError` or `ValueError` naming the
        file; `ImportError` without Pillow.
        """
        path = os.fspath(path)
        picture = _read_codes(path)
        name = name or _stem(path)
        return cls.of(picture, magnification=magnification, name=name)

    def plane_color(
        self, camera: Camera, x: base.Coordinate, y: base.Coordinate
    ) -> base.Colors:
        """Gamma colour at `(x, y)` of the plane z = -1, tangent units."""
        _, height, width = self.planes.shape
        texels_per_unit = jnp.asarray(camera.focal_px / self.magnification, x.dtype)
        column = x * texels_per_unit + (width - 1) / 2
        row = (height - 1) / 2 - y * texels_per_unit
        return stored.read_planes(
            self.planes, column, row, stored.mirror, stored.mirror
        )


class Panorama(base.AbstractScene):
    """An equirectangular picture all around, read bilinearly in gamma.

    Its centre column lies straight ahead, its top row straight up. Longitude wraps;
    beyond the centres of its first and last row, at the poles, that row is repeated.

    - `planes`: the picture as `of` and `read` keep it, `(channels, height, width)`,
      2:1 within 1 %.
    - `yaw_deg`: the hold pose looks this far to the left of the picture's centre, as a
      head does that yaws; deg.
    - `name`: what tables call it.
    """

    planes: stored.StoredPlanes
    yaw_deg: Scalar = eqx.field(converter=_checks.number, default=0.0, kw_only=True)
    name: str = eqx.field(static=True, default="panorama", kw_only=True)

    def __check_init__(self):
        stored.check_planes(self.planes)
        _checks.in_range("yaw_deg", self.yaw_deg)
        _, height, width = self.planes.shape
        if 100 * abs(width - 2 * height) > 2 * height:
            raise ValueError(
                "a panorama must be 2:1 (width:height) within 1 %, "
                f"got {width} x {height}."
            )

    @classmethod
    def of(
        cls,
        picture: ArrayLike,
        *,
        name: str = "panorama",
        yaw_deg: Scalar = 0.0,
    ) -> "Panorama":
        """Keep a picture.

        **Arguments:** `picture`: gamma, shape `(height, width)` or
        `(height, width, 3)`; uint8, uint16, or floating in `[0, 1]`.

        **Errors:** `ValueError` for any other shape, dtype or range.
        """
        return cls(stored.stored_planes(picture), yaw_deg=yaw_deg, name=name)

    @classmethod
    def read(
        cls,
        path: str | os.PathLike,
        *,
        name: str | None = None,
        yaw_deg: Scalar = 0.0,
    ) -> "Panorama":
        """Read a file, as `Photograph.read` does, and with the same errors."""
        path = os.fspath(path)
        picture = _read_codes(path)
        try:
            return cls.of(picture, yaw_deg=yaw_deg, name=name or _stem(path))
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None

    def color(self, camera: Camera, direction: base.Directions) -> base.Colors:
        """Gamma colour seen along a direction."""
        right, up, back = direction
        # At a pole the longitude is any, its gradient is not: keep atan2 away from it.
        is_pole = (right == 0) & (back == 0)
        right = jnp.where(is_pole, 0.0, right)
        forward = jnp.where(is_pole, 1.0, -back)
        across = jnp.where(is_pole, 0.0, jnp.hypot(right, forward))
        longitude = jnp.arctan2(right, forward)  # to the right of straight ahead
        latitude = jnp.arctan2(up, across)
        _, height, width = self.planes.shape
        turns = longitude / (2 * jnp.pi) - jnp.asarray(self.yaw_deg, up.dtype) / 360
        column = (turns + 0.5) * width - 0.5
        row = (0.5 - latitude / jnp.pi) * height - 0.5
        return stored.read_planes(self.planes, column, row, stored.repeat, stored.clamp)


def read_picture(
    path: str | os.PathLike, *, opaque: bool = False
) -> Float[np.ndarray, "height width 3"]:
    """Read a file's gamma colours, as `Photograph.read` does, and with its errors.

    **Arguments:** `opaque`: take colours as they are stored, whatever alpha says: what
    engines write there is often no transparency.

    **Returns:** in `[0, 1]`, float32, shape `(height, width, 3)`.
    """
    codes = _read_codes(os.fspath(path), opaque=opaque)
    colors = (codes / np.iinfo(codes.dtype).max).astype(np.float32)
    height, width = colors.shape[:2]
    channels_last = colors.reshape(height, width, -1)
    return np.array(np.broadcast_to(channels_last, (height, width, 3)))


class _Refused(ValueError):
    """A picture is whole, but what its values mean is not known."""


def _stem(path: str) -> str:
    return os.path.splitext(os.path.basename(path))[0]


def _read_codes(
    path: str, *, opaque: bool = False
) -> UInt[np.ndarray, "height width *channels"]:
    """Gamma codes of a file, `(height, width)` or `(height, width, 3)`."""
    try:
        import PIL.Image
    except ImportError as error:
        raise ImportError(
            "Reading pictures needs Pillow: install `hmdjit[study]`."
        ) from error
    if os.path.isdir(path):
        raise IsADirectoryError(f"{path}: is a directory, not a picture.")
    if not os.path.exists(path):
        raise FileNotFoundError(f"{path}: no such file.")
    try:
        # Pillow warns of damaged metadata, and of half the size that it refuses. Of a
        # path it would map the file, and misread a turned TIFF.
        with warnings.catch_warnings(action="ignore"), open(path, "rb") as file:
            image = PIL.Image.open(file)
            _check_holds(image, os.fstat(file.fileno()).st_size)
            return _decoded(image, opaque)
    except PermissionError:
        raise
    except _Refused as error:
        raise ValueError(f"{path}: {error}.") from None
    except PIL.UnidentifiedImageError:
        raise ValueError(f"{path}: not a picture that Pillow can read.") from None
    except PIL.Image.DecompressionBombError as error:
        size, _, _ = str(error).partition(", could be")  # and the limit
        raise ValueError(f"{path}: too large: {size}.") from None
    # A damaged file makes Pillow's decoders raise almost anything.
    except Exception as error:
        raise ValueError(f"{path}: damaged or unreadable: {error}") from error


def _check_holds(image: Any, size_bytes: int) -> None:
    """Raise where a JPEG claims to be larger than it can: the rest would be grey."""
    width, height = image.size
    # A block of 8 x 8 px takes at least one bit.
    if image.format in ("JPEG", "MPO") and 8 * size_bytes < width // 8 * (height // 8):
        raise _Refused(f"claims {width} x {height} px, too many for {size_bytes} bytes")


def _decoded(image: Any, opaque: bool) -> UInt[np.ndarray, "height width *channels"]:
    if opaque:
        image.info.pop("transparency", None)
    elif image.format == "PNG" and "transparency" in image.info:
        _scale_transparency(image)
    upright = _upright(image)
    if upright.mode == "F":
        raise _Refused("its floating-point values have no stated range")
    if upright.mode.startswith("I"):
        _check_deep_grey(image)
        codes = np.array(upright, np.uint16)
        if (transparent := image.info.get("transparency")) is not None:
            codes[codes == transparent] = 0
        return codes
    if upright.has_transparency_data:
        codes = np.asarray(upright.convert("RGBA")).astype(np.uint32)
        alpha = 255 if opaque else codes[..., 3:]
        return ((codes[..., :3] * alpha + 127) // 255).astype(np.uint8)
    grey = upright.mode in ("1", "L")
    return np.asarray(upright.convert("L" if grey else "RGB"))


def _upright(image: Any) -> Any:
    """Turn a picture by its EXIF orientation, whatever else is damaged there."""
    from PIL import ImageOps

    image.load()
    try:
        image.getexif()  # is remembered
        # Else Pillow writes the other entries anew, and fails where one is damaged.
        for name in ("exif", "Raw profile type exif"):
            image.info.pop(name, None)
        return ImageOps.exif_transpose(image)
    except Exception:
        return image  # it has no orientation that can be read


def _scale_transparency(image: Any) -> None:
    """Bring a PNG's transparent colour from the file's bits to those of its pixels."""
    stored = image.tile[0][3]
    if stored == "RGB;16B":  # of which Pillow gives the upper 8 bits
        raise _Refused("has a transparent colour of 16 bits; save an alpha channel")
    image.info["transparency"] *= {"L;2": 85, "L;4": 17}.get(stored, 1)


def _check_deep_grey(image: Any) -> None:
    """Raise unless grey of more than 8 bits is of 16, unsigned, with black at 0."""
    is_known = image.format in ("PNG", "PPM", "JPEG2000")
    if image.format == "TIFF" and image.mode.startswith("I;16"):
        bits, photometric = (image.tag_v2.get(tag) for tag in (258, 262))
        is_known = bits == (16,) and photometric == 1
    if not is_known:
        raise _Refused(
            "its grey values have no stated range: they must have 8 or 16 bits, "
            "unsigned, with black at 0"
        )
