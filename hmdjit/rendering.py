"""Rendering: a source, a camera, a region and a head pose give a frame."""

from collections.abc import Collection

from ._types import Rgb, WholeNumber
from .camera import Camera, Region
from .frames.displacement import GATHER, Reading
from .frames.frame import Frame
from .frames.motion import Motion
from .frames.sources import INSTEAD_OF_COLOR, AbstractSource, Places, View

COLOR = frozenset({"color"})


def render(
    source: AbstractSource,
    camera: Camera,
    region: Region,
    motion: Motion,
    samples_px: Places,
    *,
    frame: WholeNumber = 0,
    channels: Collection[str] = COLOR,
    reading: Reading = GATHER,
) -> Frame:
    """Frame of a region as the head sees it from a pose.

    **Arguments:**

    - `motion`: of the head at this frame, from the hold pose.
    - `samples_px`: sub-pixel samples, from the pixel centre, px; traced where they
      change from frame to frame.
    - `frame`: its number, from the hold pose on, where things move by themselves.
    - `channels`: what the frame holds, of what the source gives: no more is computed.
      `supersampled` or `multisampled` come in the place of the colour.
    """
    view = View(camera, region, motion, frame, reading)
    seen = source.seen(view, samples_px, channels)
    (color,) = (seen.pop(name) for name in (INSTEAD_OF_COLOR | COLOR) & set(channels))
    # Nobody computes what a technique does not read.
    steps = source.steps(view) if "velocity" in channels else None
    return Frame(color, camera, region, None, reading, seen, steps=steps)


def reference(
    source: AbstractSource,
    camera: Camera,
    region: Region,
    motion: Motion,
    reading: Reading = GATHER,
    *,
    frame: WholeNumber = 0,
) -> Rgb:
    """Return the picture without aliasing of a region, gamma, `(3, height, width)`.

    **Accuracy:** that of the source's `reference`.
    """
    return source.reference(View(camera, region, motion, frame, reading))
