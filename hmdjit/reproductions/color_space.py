"""Anti-aliasing in linear light against gamma, box against Lanczos filter.

Maruszczuk et al. showed people in a headset two patterns, anti-aliased from a buffer of
twice the size in each axis by a box (B) or a Lanczos filter (L), in linear light (L) or
in gamma (G), and asked which of two looked better: LL was best, LG about as good as BL,
BG worst, and the checkerboard showed more of it than the honeycomb.

Here nobody is asked. Their display, patterns in the four pairs of colours that differ
most, and heads that fixate are simulated; what the four show is held against the
picture without aliasing, and who sees less error is taken to prefer it (Thurstone's
model, with equal spreads). How much less they must see for how many JOD is not known
from the paper: only an order follows.
"""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..camera import Camera
from ..head_motion import HeadMotion
from ..metrics import MTCD, SSIM, DetailLoss
from ..scenes.patterns import checkerboard, honeycomb
from ..studies.progress import Tell
from ..studies.study import Study
from ..techniques import SSAA, AbstractTechnique
from . import eye
from .claims import Found
from .color_space_claims import (
    CELL_DEG,
    NAMES,
    PATTERNS,
    SQUARE_DEG,
    WALL_DEG,
    Measure,
    claims_by,
    measured,
    order,
)
from .two_colored import ColorPair, TwoColored, most_different

TITLE = "Anti-aliasing in linear against gamma-encoded colours (Maruszczuk et al.)"
CAMERA = Camera(width_px=1512, height_px=1680, fov_deg=110.0, refresh_hz=90.0)
SESSIONS, QUICK_SESSIONS = 120, 40

_BATCH = 40  # sessions that an interruption loses at most
_FRAMES, _EVERY = 8, 4  # of a session; of them two are held against the reference
_RAYS = 128  # in a pixel of the reference
_TILT_DEG = 10.0  # of patterns that are not upright
_SCENE_BLUR_PX = 1.0


def conditions() -> dict[str, AbstractTechnique]:
    """Return what the paper compares, by its names."""
    filters, spaces = {"L": "lanczos2", "B": "box"}, {"L": "linear", "G": "gamma"}
    return {n: SSAA(2, spaces[n[1]], filter=filters[n[0]]) for n in NAMES}


def measures(camera: Camera) -> list[Measure]:
    """Return what is measured; the first is what the verdicts are of."""
    seen = lambda sigma, id, **how: eye.SeenColorError(
        sigma_px=sigma, id=f"color_error_{id}", **how
    )
    sigma_px = eye.sigma_px(camera)
    of_eye = seen(sigma_px, "eye")
    squared = seen(sigma_px, "eye_squared", is_squared=True)
    to_scene = seen(_SCENE_BLUR_PX, "to_scene", is_to_scene=True)
    return [
        Measure(of_eye, "colour error, eye"),
        Measure(of_eye, f"eye, tilted {_TILT_DEG:g} deg", "tilted"),
        Measure(squared, "squared colour error, eye"),
        Measure(seen(1.0, "1_px"), "colour error, 1 px"),
        Measure(seen(2.0, "2_px"), "colour error, 2 px"),
        Measure(to_scene, f"to scene, {_SCENE_BLUR_PX:g} px", "scene"),
        Measure(SSIM(), "SSIM"),
        Measure(DetailLoss(), "squared error"),
        Measure(MTCD(), "flicker"),
    ]


NOT_SIMULATED = (
    "Not simulated: people, and how many JOD apart they put the four; only an order is."
)


def studies(
    camera: Camera, pairs: Sequence[ColorPair], sessions: int
) -> dict[str, Study]:
    """Return the experiment: each pattern in each pair of colours, seen exactly.

    Three studies: with patterns that are `upright` and `tilted`, held against means
    over a pixel's square; and upright, against the `scene` behind a blur.
    """
    patterns = checkerboard(SQUARE_DEG), honeycomb(CELL_DEG, wall_deg=WALL_DEG)
    rgb = lambda code: np.asarray(code, np.float32) / 255
    known = measures(camera)
    found = {}
    for name in dict.fromkeys(measure.study for measure in known):
        tilt_deg = _TILT_DEG if name == "tilted" else 0.0
        blur_px = _SCENE_BLUR_PX if name == "scene" else 0.0
        # Tilted ones measure all that upright ones do: it is one program.
        source = "upright" if name == "tilted" else name
        found[name] = Study(
            scenes={
                f"{pattern}_{k + 1}": TwoColored(
                    patterns, n, rgb(pair.first), rgb(pair.second), tilt_deg, blur_px
                )
                for n, pattern in enumerate(PATTERNS)
                for k, pair in enumerate(pairs)
            },
            techniques=list(conditions().values()),
            baseline=conditions()["BL"].id,
            head=HeadMotion.fixating(),
            neck=None,
            camera=camera,
            sessions=sessions,
            frames=_FRAMES,
            warmup=0,
            metrics=[m.metric for m in known if m.study == source],
            reference_samples=_RAYS,
            reference_every=_EVERY,
        )
    return found


def run(
    camera: Camera,
    sessions: int,
    *,
    seed: int = 0,
    out: str | os.PathLike,
    overwrite: bool = False,
    progress: Tell = lambda event: None,
) -> Found:
    """Run the experiment, or go on with it.

    **Arguments:** `out`: folder where finished batches are kept; `overwrite`: whether
    results of another experiment in it are replaced.
    """
    pairs = most_different()
    made = studies(camera, pairs, sessions)
    datasets = {
        name: each.run(
            seed,
            out=Path(out) / name,
            batch_size=min(_BATCH, sessions),
            overwrite=overwrite,
            progress=progress,
        )
        for name, each in made.items()
    }
    shape = (len(conditions()), len(PATTERNS), len(pairs), sessions)
    values = {
        measure: datasets[measure.study][measure.metric.id].values
        for measure in measures(camera)
    }
    values = {measure: found.reshape(shape) for measure, found in values.items()}
    orders = [{"measure": m.words, "order": order(m, v)} for m, v in values.items()]
    return Found(
        title=TITLE,
        about=_about(made["upright"], camera),
        claims=[claim for item in values.items() for claim in claims_by(*item)],
        measured=[row for item in values.items() for row in measured(*item)],
        cases=PATTERNS,
        lines=_lines(orders, pairs),
        tables={"orders": orders, "color_pairs": [_hexes(pair) for pair in pairs]},
    )


def _lines(
    orders: Sequence[Mapping[str, str]], pairs: Sequence[ColorPair]
) -> list[str]:
    said = [
        f"Colours {k + 1}: {_hex(pair.first)} and {_hex(pair.second)}, half of each is "
        f"{_hex(pair.linear_mix)} in linear light, {_hex(pair.gamma_mix)} in gamma: "
        f"CIEDE2000 {pair.difference:.1f}."
        for k, pair in enumerate(pairs)
    ]
    return [
        *said,
        "Predicted order of JOD, the paper's being LL > BL ~ LG > BG (no numbers: how "
        "much error is worth one is not known):",
        *(f"  {row['order']}  by {row['measure']}" for row in orders),
        NOT_SIMULATED,
    ]


def _about(made: Study, camera: Camera) -> str:
    arcmin = 60 * 180 / np.pi / float(camera.focal_px)
    return (
        f"{made.sessions} sessions of people who fixate, {made.measure}, {made.frames} "
        f"frames; patterns upright or tilted by {_TILT_DEG:g} deg. Colour error: mean "
        f"CIEDE2000 to {_RAYS} samples over a pixel's square, averaged in linear "
        "light, both behind a Gaussian in linear light: the eye's, "
        f"{eye.ACUITY_ARCMIN:g} arcmin wide at half height (60 px/deg), has a standard "
        f"deviation of {eye.sigma_px(camera):.3f} px in the centre, where a pixel is "
        f"{arcmin:.1f} arcmin; others are wider, by what is said. That reference is "
        "what a box in linear light tends to, which favours BL by mean error; squares "
        "weigh edges more. To scene: of the scene behind that blur, without pixels. "
        f"One frame of {made.reference_every} is held against the reference. Lanczos: "
        "two lobes, exact taps. Checks of "
        f"{SQUARE_DEG:g} deg, cells of {CELL_DEG:g} with walls of {WALL_DEG:g} deg; "
        "colours from a grid of 9 levels, those of two pairs 20 CIEDE2000 apart: all "
        "choices of ours. Who sees less error is taken to prefer it. Intervals (95 %) "
        "are over sessions, paired; patterns and colours are fixed."
    )


def _hex(code: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*code)


def _hexes(pair: ColorPair) -> dict[str, str | float]:
    *colors, difference = pair
    names = ColorPair._fields
    return {**dict(zip(names, map(_hex, colors), strict=False)), names[-1]: difference}
