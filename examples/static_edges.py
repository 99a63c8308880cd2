"""No anti-aliasing, FXAA and SMAA on still edges: our order beside the thesis'.

The thesis' scenes could not be had: each row is a scene of the same kind, seen by its
camera (1280 x 700 px, 45 degrees high) at a few poses, the middle of the frame. As
there all colours are gamma, and pictures of 8 bits are held against the mean of 128
samples. Writes `static_edges.md`.

    python examples/static_edges.py --scenes pipe hairball --poses 4
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pages
import scipy.stats
from jaxtyping import Array

import hmdjit as hj
from hmdjit.frames.motion import Motion
from hmdjit.frames.neck import NeckModel
from hmdjit.frames.sources import AbstractSource
from hmdjit.metrics import mse, ssim_volume
from hmdjit.rendering import render
from hmdjit.scenes.solid_set import (
    arched_window,
    atrium,
    blinds,
    fence,
    flowers,
    hairball,
    pipe,
)
from hmdjit.techniques import FXAA, SMAA, AccumulationBuffer, NoAntialiasing

# The author's numbers, of none, FXAA and SMAA ultra with colour edges: MSE, then SSIM
# of the RGB volume. Source: MATLAB output (*_sobel_results.txt of pipe, regular and
# with_inclination, window_blind, window_arch, sponza, sponza_flowers, hard_test and
# hairball) kept with the code of Oliveros, "Temporal anti-aliasing improved with
# Sobel", 2018, whose tables 5.2 to 5.8 have it in three digits.
THESIS = {
    "pipe": ((8.607679, 3.572549, 1.277749), (0.998613, 0.999397, 0.999777)),
    "inclined pipe": ((16.112198, 6.470162, 2.809633), (0.997768, 0.999045, 0.999555)),
    "blinds": ((56.312608, 39.103469, 19.848787), (0.991854, 0.993947, 0.996865)),
    "arched window": (
        (96.044249, 70.485847, 35.133507),
        (0.986237, 0.989506, 0.994852),
    ),
    "atrium": ((13.458406, 8.290375, 8.609743), (0.987518, 0.991362, 0.991089)),
    "flowers": ((122.795114, 66.061608, 72.279098), (0.959202, 0.974811, 0.972488)),
    "hard edges": ((12.463234, 9.342434, 8.018837), (0.996765, 0.997162, 0.997839)),
    "hairball": ((44.367365, 21.100863, 25.378557), (0.961572, 0.977901, 0.974265)),
}
SCENES = {
    "pipe": lambda: pipe((6.0,)),
    "inclined pipe": lambda: pipe((-28.0,)),
    "blinds": blinds,
    "arched window": arched_window,
    "atrium": atrium,  # the thesis has Sponza
    "flowers": flowers,
    "hard edges": fence,  # the thesis has another view of Sponza
    "hairball": hairball,
}
NAMES = ("none", "FXAA", "SMAA")
TECHNIQUES = (NoAntialiasing(), FXAA(), SMAA("ultra", edges="color"))
REFERENCE = AccumulationBuffer(128, space="gamma")
CAMERA = hj.Camera(
    1280, 700, np.degrees(2 * math.atan(math.tan(math.radians(22.5)) * 1280 / 700)), 60
)
TURN_DEG = 3.0
"""How far poses lie around the first, about each axis, one standard deviation."""


@jax.jit
def shown(
    source: AbstractSource, region: hj.Region, motion: Motion
) -> tuple[list[Array], Array]:
    """Pictures of the techniques, and the reference, `(height, width, 3)`."""

    def resolved(technique: hj.techniques.AbstractSpatial) -> Array:
        samples_px = technique.sample_offsets_px[0]
        frame = render(source, CAMERA, region, motion, samples_px)
        return jnp.moveaxis(technique.resolve(frame), 0, -1)

    return [resolved(technique) for technique in TECHNIQUES], resolved(REFERENCE)


def measured(source: AbstractSource, side: int, poses: int) -> dict[str, np.ndarray]:
    """MSE and SSIM of each technique at each pose, `(poses, techniques)`."""
    region = hj.Region((1280 - side) // 2, (700 - side) // 2, side, side)
    turns = np.random.default_rng(0).normal(0, np.radians(TURN_DEG), (poses, 3))
    turns = jnp.asarray(turns, jnp.float32)
    motions = NeckModel().moved(Motion(turns, jnp.zeros_like(turns)))
    found: dict[str, list] = {"MSE": [], "SSIM": []}
    for k in range(poses):
        motion = jax.tree.map(lambda leaf, k=k: leaf[k], motions)
        pictures, reference = shown(source, region, motion)
        codes = [np.floor(255 * np.clip(p, 0, 1) + 0.5) for p in (*pictures, reference)]
        for name, measure in (("MSE", mse), ("SSIM", ssim_volume)):
            row = [float(measure(test, codes[-1])) for test in codes[:-1]]
            found[name].append(row)
    return {name: np.array(rows) for name, rows in found.items()}


def in_order(values: np.ndarray | tuple[float, ...], metric: str) -> list[str]:
    """Names, the best first."""
    signs = 1 if metric == "MSE" else -1
    return [NAMES[i] for i in np.argsort(signs * np.asarray(values))]


def verdict(rows: np.ndarray, theirs: list[str], metric: str) -> str:
    """Hold our poses against an order: by a t interval of each neighbours' difference.

    **Arguments:** `rows`: of the metric, `(poses, techniques)`.
    """
    ours = [rows[:, NAMES.index(name)] for name in theirs]
    steps = np.diff(ours, axis=0) * (1 if metric == "MSE" else -1)  # worse is more
    half = scipy.stats.t.ppf(0.975, len(rows) - 1) / math.sqrt(len(rows))
    middle, half = steps.mean(1), half * steps.std(1, ddof=1)
    if np.all(middle - half > 0):
        return "holds"
    return "does not hold" if np.any(middle + half < 0) else "cannot be told"


def main() -> None:
    """Measure, and write the page."""
    parser = pages.arguments(__file__, __doc__)
    parser.add_argument("--scenes", nargs="+", choices=THESIS, default=list(THESIS))
    parser.add_argument("--side", type=int, default=512, help="of what is measured, px")
    parser.add_argument("--poses", type=int, default=8)
    options = parser.parse_args()
    rows = []
    for name in options.scenes:
        found = measured(SCENES[name](), options.side, options.poses)
        for metric, values in zip(("MSE", "SSIM"), THESIS[name], strict=True):
            digits = ".2f" if metric == "MSE" else ".4f"
            means = found[metric].mean(0)
            order = in_order(values, metric)
            rows.append(
                (
                    name,
                    metric,
                    *(f"{value:{digits}}" for value in values),
                    *(f"{value:{digits}}" for value in means),
                    " > ".join(order),
                    verdict(found[metric], order, metric),
                )
            )
    head = ("scene", "metric")
    head += tuple(f"thesis {name}" for name in NAMES) + NAMES
    blocks = {"orders": pages.table((*head, "thesis' order", "here"), rows)}
    pages.write(__file__, blocks, options.out, is_measured=False)


if __name__ == "__main__":
    main()
