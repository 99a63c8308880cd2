"""The page of techniques on rendered frames: MTCD before and after, maps, a clip."""

import io
from collections.abc import Iterator, Mapping
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from .._files import written_atomically
from ..camera import Camera
from ..color import CODE_VALUES
from ..figures import displayed as figures
from ..figures import drawing
from ..figures.techniques import styles
from ..metrics import MTCD, DetailLoss
from ..metrics.base import Streamed
from ..reports.apply import measured_table
from ..studies import identity
from . import markup
from .simulated import flicker_maps, numbers, some

NAME, CLIP = "report.html", "before_after.webp"
_PART_PX, _VIEWER_PX, _PART_FRAMES = 256, 128, 48
Picture = Float[np.ndarray, "height width 3"]


@jax.jit
def _change(
    now: Float[Array, "height width 3"], before: Float[Array, "height width 3"]
) -> Float[Array, "height width"]:
    now, before = (jnp.moveaxis(picture, -1, 0) for picture in (now, before))
    return MTCD().per_pixel(now, before, None)


class Watched:
    """What a page shows of a clip that comes picture by picture.

    - `mtcd`, `loss`: of each pair of frames, and of each frame with a reference.
    - `part`: the centre of the first frames, 8 bits.
    """

    def __init__(self) -> None:
        self.mtcd: list[float] = []
        self.loss: list[float] = []
        self.part: list[UInt8[np.ndarray, "height width 3"]] = []
        self.latest: Picture | None = None
        self._sum = np.zeros(())

    def add(
        self,
        picture: Picture,
        rounded: UInt8[np.ndarray, "height width 3"],
        reference: Picture | None,
    ) -> None:
        """Take in the next picture, also as it is rounded for its file."""
        if self.latest is not None:
            change = np.asarray(_change(picture, self.latest), float)
            self.mtcd.append(float(change.mean()))
            self._sum = self._sum + change
        if reference is not None:
            one = Streamed(DetailLoss())
            one.add(picture, reference)
            self.loss.append(one.value)
        if len(self.part) < _PART_FRAMES:
            self.part.append(_centre(rounded, _PART_PX).copy())
        self.latest = picture

    @property
    def flicker(self) -> Float[np.ndarray, "height width"]:
        """MTCD of each pixel."""
        return self._sum / len(self.mtcd)


def write_page(
    folder: Path,
    clips: Mapping[str, Watched],
    rows: Mapping[str, Mapping[str, float]],
    camera: Camera,
    command: str,
    about: str,
) -> list[Path]:
    """Write `report.html` and a clip of before and after into a folder.

    **Arguments:** `clips`: the frames first, then each technique's; `rows`: what was
    measured of each; `command`: that was typed; `about`: what the numbers are.

    **Returns:** the paths.
    """
    before, *after = clips
    footer = (
        f"{camera.width_px} × {camera.height_px} px, "
        f"{float(camera.fov_deg):.4g}° wide, {float(camera.refresh_hz):.4g} Hz; "
        f"{identity.made_by()}."
    )
    rate_hz = float(camera.refresh_hz)
    parts = {
        name: np.stack([_centre(p, _VIEWER_PX) for p in clip.part]) / CODE_VALUES
        for name, clip in clips.items()
    }
    keep = lambda name, figure: drawing.png(figure)
    maps = {name: clip.flicker for name, clip in clips.items()}
    latest = {
        name: np.clip(clip.latest, 0, 1)
        for name, clip in clips.items()
        if clip.latest is not None
    }
    sections = {
        "Before and after": [
            *(markup.paragraph(words) for words in _answer(rows, before, after)),
            markup.table(measured_table(rows), "What was measured of each clip"),
            markup.paragraph(about),
        ],
        "Frame by frame": [markup.figure(one) for one in _by_frame(clips, footer)],
        "Where it flickers": [markup.figure(flicker_maps(latest, maps, footer, keep))],
        "Flicker viewer": [
            markup.viewer(parts, rate_hz, (before, after[0])),
            markup.paragraph(
                f"The central {_VIEWER_PX} px of the first {len(parts[before])} "
                f"measured frames; {CLIP} beside this page has {_PART_PX} px of them, "
                f"left {before}, right {after[0]}."
            ),
        ],
        "Identity": [
            markup.code(command),
            markup.paragraph(footer),
        ],
    }
    title = f"Flicker before and after {', '.join(after)}"
    return [
        _write_clip(folder / CLIP, clips[before].part, clips[after[0]].part, rate_hz),
        markup.write(folder / NAME, markup.page(title, footer, sections)),
    ]


def _answer(
    rows: Mapping[str, Mapping[str, float]], before: str, after: list[str]
) -> Iterator[str]:
    for name in after:
        row = rows[name]
        if "mtcd" not in row:
            continue
        yield (
            f"{name} takes MTCD from {rows[before]['mtcd']:.3g} to {row['mtcd']:.3g} "
            f"code values, {row['mtcd_ratio']:.3g} of what the frames have."
            if rows[before]["mtcd"] > 0
            else "MTCD 0 before: no flicker to remove."
        )


def _by_frame(clips: Mapping[str, Watched], footer: str) -> Iterator[markup.Picture]:
    before, *after = clips
    style = styles(before, after)
    measures = {
        "MTCD of a frame and the one before, code values": "mtcd",
        "detail loss of a frame, code values²": "loss",
    }
    for label, attribute in measures.items():
        values = {n: np.array(getattr(clip, attribute)) for n, clip in clips.items()}
        if not values[before].size:
            continue
        drawn = figures.by_frame(values, label, style, footer)
        means = "; ".join(f"{name} {each.mean():.3g}" for name, each in values.items())
        rows = [
            [str(k + 1), *(f"{each[k]:.3g}" for each in values.values())]
            for k in some(values[before].size)
        ]
        yield markup.Picture(
            drawing.png(drawn),
            f"A line per clip: {label}, frame by frame. Means: {means}.",
            label[0].upper() + label[1:],
            numbers(["frame", *clips], rows),
        )


def _centre(
    picture: UInt8[np.ndarray, "height width 3"], side: int
) -> UInt8[np.ndarray, "_ _ 3"]:
    height, width, _ = picture.shape
    top, left = (max(0, (size - side) // 2) for size in (height, width))
    return picture[top : top + side, left : left + side]


def _write_clip(
    path: Path, before: list[np.ndarray], after: list[np.ndarray], rate_hz: float
) -> Path:
    """Write two clips side by side as an animated WebP, without loss."""
    import PIL.Image

    first, *others = (
        PIL.Image.fromarray(np.concatenate(both, axis=1))
        for both in zip(before, after, strict=True)
    )
    # WebP has whole milliseconds.
    how = {"duration": max(1, round(1000 / rate_hz)), "loop": 0, "lossless": True}
    with io.BytesIO() as content:
        first.save(content, "WEBP", save_all=True, append_images=others, **how)
        with written_atomically(path) as unfinished:
            unfinished.write_bytes(content.getvalue())
    return path
