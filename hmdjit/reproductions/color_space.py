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

import itertools
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..camera import Camera
from ..estimates.intervals import Interval, mean_interval
from ..head_motion import HeadMotion
from ..metrics import MTCD, AbstractMetric, DetailLoss
from ..scenes.patterns import checkerboard, honeycomb
from ..studies.progress import Tell
from ..studies.study import Study
from ..techniques import SSAA, AbstractTechnique
from . import eye
from .claims import HOLDS, Claim, Found, Measured, above, every, within
from .color_pairs import ColorPair, most_different
from .two_colored import TwoColored

TITLE = "Anti-aliasing in linear against gamma-encoded colours (Maruszczuk et al.)"
CAMERA = Camera(width_px=1512, height_px=1680, fov_deg=110.0, refresh_hz=90.0)
SESSIONS, QUICK_SESSIONS = 200, 24

_BATCH = 40  # sessions that an interruption loses at most
_FRAMES, _EVERY = 8, 4  # of a session; of them two are held against the reference
_RAYS = 128  # in a pixel of the reference
_ABOUT = 0.25  # of what lies between best and worst: two that differ less are alike
_SQUARE_DEG, _CELL_DEG, _WALL_DEG = 2.0, 4.0, 0.4  # of the patterns, our choice
EDGES_PER_DEG = {
    "checkerboard": 2 / _SQUARE_DEG,
    "honeycomb": 4 * (_CELL_DEG - _WALL_DEG) / _CELL_DEG**2,
}
"""Length of the edges in a pattern, degrees per square degree."""
PATTERNS = tuple(EDGES_PER_DEG)

Values = Float[np.ndarray, "condition pattern pair session"]


class Measure(NamedTuple):
    """One way to hold what is shown against what should be.

    - `words`: what tables call it.
    - `sign`: 1 where more is worse, else -1.
    """

    metric: AbstractMetric
    words: str

    @property
    def sign(self) -> int:
        """Of how bad it is to have more of it."""
        return 1 if self.metric.less_is_better else -1


def conditions() -> dict[str, AbstractTechnique]:
    """Return what the paper compares, by its names."""
    return {
        f"{kind[0].upper()}{space[0].upper()}": SSAA(2, space, filter=kind)
        for kind in ("lanczos2", "box")
        for space in ("linear", "gamma")
    }


def measures(camera: Camera) -> list[Measure]:
    """Return what is measured; the first is what the verdicts are of."""
    seen = lambda sigma, id, is_to_scene=False: eye.SeenColorError(
        sigma_px=sigma, id=f"color_error_{id}", is_to_scene=is_to_scene
    )
    return [
        Measure(seen(eye.sigma_px(camera), "eye"), "colour error, eye"),
        Measure(seen(1.0, "1_px"), "colour error, 1 px"),
        Measure(seen(2.0, "2_px"), "colour error, 2 px"),
        Measure(seen(1.0, "to_scene", is_to_scene=True), "to scene, 1 px"),
        Measure(DetailLoss(), "squared error"),
        Measure(MTCD(), "flicker"),
    ]


def studies(
    camera: Camera, pairs: Sequence[ColorPair], sessions: int
) -> dict[str, Study]:
    """Return the experiment: each pattern in each pair of colours, seen exactly.

    Two studies, by what frames are held against: `pixels`, means over a pixel's square,
    and `scene`, the scene behind a blur.
    """
    patterns = {
        "checkerboard": checkerboard(_SQUARE_DEG),
        "honeycomb": honeycomb(_CELL_DEG, wall_deg=_WALL_DEG),
    }
    rgb = lambda code: np.asarray(code, np.float32) / 255
    found = {}
    for name, blur_px in (("pixels", 0.0), ("scene", 1.0)):
        mine = [m.metric for m in measures(camera) if _against(m.metric) == name]
        if not mine:
            continue
        found[name] = Study(
            scenes={
                f"{pattern}_{k + 1}": TwoColored(
                    scene, rgb(pair.first), rgb(pair.second), blur_px
                )
                for pattern, scene in patterns.items()
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
            metrics=mine,
            reference_samples=_RAYS,
            reference_every=_EVERY,
        )
    return found


def _against(metric: AbstractMetric) -> str:
    return "scene" if getattr(metric, "is_to_scene", False) else "pixels"


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
        measure: datasets[_against(measure.metric)][measure.metric.id].values
        for measure in measures(camera)
    }
    values = {measure: found.reshape(shape) for measure, found in values.items()}
    return Found(
        title=TITLE,
        about=_about(made["pixels"], camera),
        claims=[claim for item in values.items() for claim in claims_by(*item)],
        measured=[row for item in values.items() for row in measured(*item)],
        cases=PATTERNS,
        lines=_lines(values, pairs),
        tables={"color_pairs": [_hexes(pair) for pair in pairs]},
    )


def claims_by(measure: Measure, values: Values) -> list[Claim]:
    """Judge the paper's claims by one measure.

    Intervals are over sessions, paired: all conditions saw the same heads and tiles.
    Patterns and pairs of colours are fixed, and averaged over.
    """
    names, unit = list(conditions()), measure.metric.unit
    worse = measure.sign * values
    of_session = dict(zip(names, worse.mean(axis=(1, 2)), strict=True))
    by_scene = dict(zip(names, worse.mean(axis=-1), strict=True))
    means = {name: float(each.mean()) for name, each in of_session.items()}
    said = ", ".join(f"{name} {abs(means[name]):.3g}" for name in names) + f" {unit}"

    def gap(one: str, other: str) -> Interval:
        return mean_interval(of_session[one] - of_session[other])

    def extreme(name: str, sign: int, claim: str, quantity: str) -> Claim:
        """Judge whether a condition is the best (1) or the worst (-1) of all."""
        gaps = {
            n: gap(n, name) if sign == 1 else gap(name, n) for n in names if n != name
        }
        rival = min(gaps, key=lambda n: gaps[n].value)
        wins = sum(
            all(sign * (by_scene[n][at] - by_scene[name][at]) > 0 for n in gaps)
            for at in np.ndindex(by_scene[name].shape)
        )
        verdict = every([above(found) for found in gaps.values()])
        reason = f"nearest is {rival}; so in {wins} of {by_scene[name].size} scenes"
        return _claim(
            claim, measure, quantity, gaps[rival], verdict, f"{reason}: {said}"
        )

    spread = max(means.values()) - min(means.values())
    alike, margin = gap("LG", "BL"), _ABOUT * spread
    each = [worse[names.index("BG"), p] - worse[names.index("LL"), p] for p in (0, 1)]
    more = mean_interval(each[0].mean(axis=0) - each[1].mean(axis=0))
    gaps = dict(zip(PATTERNS, (float(part.mean()) for part in each), strict=True))
    sizes = ", ".join(f"{pattern} {gap:.3g}" for pattern, gap in gaps.items())
    lengths = ", ".join(f"{gaps[p] / EDGES_PER_DEG[p]:.3g}" for p in PATTERNS)
    return [
        extreme("LL", 1, "LL is the best", "the next best, minus LL"),
        _claim(
            "LG is about as good as BL",
            measure,
            "LG minus BL",
            alike,
            within(alike, margin),
            f"alike is within {margin:.3g}, a quarter of worst minus best: {said}",
        ),
        extreme("BG", -1, "BG is the worst", "BG minus the next worst"),
        _claim(
            "the checkerboard shows more of it than the honeycomb",
            measure,
            "BG minus LL, of checkerboard minus honeycomb",
            more,
            above(more),
            f"BG minus LL: {sizes} {unit}; per degree of edge in a square degree "
            f"{lengths}, and how much edge there is was our choice",
        ),
    ]


def _claim(
    claim: str,
    measure: Measure,
    quantity: str,
    found: Interval,
    verdict: str,
    reason: str,
) -> Claim:
    numbers = (found.value, found.low, found.high)
    return Claim(
        claim, measure.words, quantity, *numbers, measure.metric.unit, verdict, reason
    )


def measured(measure: Measure, values: Values) -> list[Measured]:
    """Mean of each condition in each pattern, and in each of its pairs of colours."""
    rows = []
    for name, of_condition in zip(conditions(), values, strict=True):
        for pattern, part in zip(PATTERNS, of_condition, strict=True):
            cases = {pattern: part.mean(axis=0)}
            cases |= {f"{pattern}_{k + 1}": pair for k, pair in enumerate(part)}
            for case, sessions in cases.items():
                found = mean_interval(sessions)
                numbers = (found.value, found.low, found.high)
                unit = measure.metric.unit
                rows.append(Measured(measure.words, case, name, *numbers, unit))
    return rows


def order(measure: Measure, values: Values) -> str:
    """Put the conditions in order of preference, as LL > BL ~ LG > BG.

    The least error first; `~` stands between two whose difference may be 0. By
    Thurstone's model with equal spreads that is the order of their JOD, whatever one
    is worth.
    """
    worse = measure.sign * values.mean(axis=(1, 2))
    names, places = list(conditions()), np.argsort(worse.mean(axis=-1), kind="stable")
    words = names[places[0]]
    for better, place in itertools.pairwise(places):
        is_sure = above(mean_interval(worse[place] - worse[better])) == HOLDS
        words += (" > " if is_sure else " ~ ") + names[place]
    return words


def _lines(values: Mapping[Measure, Values], pairs: Sequence[ColorPair]) -> list[str]:
    said = [
        f"Colours {k + 1}: {_hex(pair.first)} and {_hex(pair.second)}, half of each is "
        f"{_hex(pair.linear_mix)} in linear light, {_hex(pair.gamma_mix)} in gamma: "
        f"CIEDE2000 {pair.difference:.1f}."
        for k, pair in enumerate(pairs)
    ]
    orders = [f"{order(*item)} ({item[0].words})" for item in values.items()]
    return [
        *said,
        "The paper's order is LL > BL ~ LG > BG. Predicted orders of JOD (how much one "
        f"is worth is not known, so there are no numbers): {'; '.join(orders)}.",
    ]


def _about(made: Study, camera: Camera) -> str:
    sigma = eye.sigma_px(camera)
    arcmin = eye.ACUITY_ARCMIN
    return (
        f"{made.sessions} sessions of people who fixate, {made.measure}, {made.frames} "
        f"frames; patterns upright, colours by CIEDE2000 of half mixes. Colour error: "
        f"mean CIEDE2000 to {_RAYS} samples per pixel averaged in linear light, both "
        f"behind a Gaussian in linear light; the eye's is {arcmin:g} arcmin wide at "
        f"half height (60 px/deg), a standard deviation of {sigma:.3f} px in the "
        "centre, where a pixel is "
        f"{arcmin * eye.sigma_px(camera, 1.0) ** -1 / (2 * np.sqrt(2 * np.log(2))):.1f}"
        " arcmin. 95 % intervals over sessions, paired; patterns and colours are fixed."
    )


def _hex(code: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*code)


def _hexes(pair: ColorPair) -> dict[str, str | float]:
    *colors, difference = pair
    names = ColorPair._fields
    return {**dict(zip(names, map(_hex, colors), strict=False)), names[-1]: difference}
