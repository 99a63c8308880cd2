"""Draw all scenes in small: those of solids, and the pictures of the default study.

python examples/contact_sheet.py
python examples/contact_sheet.py --scenes hut coffee --side 384 --out two.png
"""

import argparse
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import hmdjit as hj
from hmdjit import color
from hmdjit.figures import drawing
from hmdjit.frames.motion import Motion
from hmdjit.frames.sources import AbstractSource
from hmdjit.rendering import render

SAMPLES = 4  # a side of each pixel
COLUMNS = 6


@jax.jit
def seen(source: AbstractSource, camera: hj.Camera) -> jax.Array:
    """Picture from the hold pose at frame 0, gamma, `(height, width, 3)`."""
    still = Motion(jnp.zeros(3), jnp.zeros(3))
    whole = hj.Region.whole(camera)
    frame = render(source, camera, whole, still, np.zeros((1, 2)))
    planes = color.decode(frame.color.reshape(3, camera.height_px, camera.width_px))
    blocks = planes.reshape(3, camera.height_px // SAMPLES, SAMPLES, -1, SAMPLES)
    return jnp.moveaxis(color.encode(blocks.mean((2, 4))), 0, 2)


@drawing.styled
def main() -> None:
    """Draw the sheet."""
    known = hj.scenes.solid_set()
    known |= {n: s for n, s in hj.scenes.study_set().items() if n not in known}
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    picture = Path(__file__).with_name("scenes.png")
    parser.add_argument(
        "--out", type=Path, default=picture, help="the picture to write"
    )
    names = {"nargs": "+", "choices": known, "default": list(known)}
    parser.add_argument("--scenes", **names, metavar="NAME", help="default: all")
    parser.add_argument("--side", type=int, default=144, help="of each, px")
    options = parser.parse_args()
    side = SAMPLES * options.side
    camera = hj.Camera(width_px=side, height_px=side, fov_deg=96.0, refresh_hz=60.0)
    columns = min(COLUMNS, len(options.scenes))
    rows = -(-len(options.scenes) // columns)
    size = options.side / drawing.DPI
    footer = "Each 96 degrees wide, at the first frame; 16 samples a pixel."
    figure, panels = drawing.panels(
        columns * (size + 0.06), rows * (size + 0.24), footer, rows, columns
    )
    for axes in panels.flat:
        axes.axis("off")
    for axes, name in zip(panels.flat, options.scenes, strict=False):
        scene = known[name]
        if not isinstance(scene, AbstractSource):
            scene = hj.scenes.bake(scene, camera, oversampling=1, margin_deg=0.0)
        axes.imshow(np.clip(seen(scene, camera), 0, 1), interpolation="none")
        title = name.replace("_", " ")
        axes.set_title(title, fontsize=drawing.NUMBER, loc="center", pad=3)
    print(f"Wrote {drawing.save(figure, options.out)}.")


if __name__ == "__main__":
    main()
