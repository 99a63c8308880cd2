"""The claims of Oliveros' thesis, as orderings, judged by what was measured.

Intervals are over sessions, which look at a scene from other sides; techniques are
paired. Errors are mean squared ones, or what SSIM lacks of 1.
"""

import itertools
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .. import metrics
from ..estimates.estimate import mean_of, paired_means, ratio
from ..estimates.intervals import Interval, student_interval
from .claims import HOLDS, Claim, Measured, below, every, less, within

NAMES = ("no AA", "FXAA", "SMAA", "Uncharted TAA", "Master TAA")
NAMES += ("Uncharted TAA, normalised", "Master TAA, not normalised")
NAMES += ("Uncharted TAA, unsharpened", "Master TAA, unsharpened")
_NONE, _UNCHARTED, _MASTER, _NORMALISED, _UNSHARPENED = 0, 3, 4, 5, 7
UNIT = "code values of 255, squared"
BORDER_PX = 4  # beyond which techniques read what is not there
"""What is not measured: much of our small pictures, of the thesis' 1 %."""
_FIVE = 5  # of the names: those that the thesis compares
ALIKE = 0.1  # relative: errors that differ by less are alike, and change little
_MOST = 0.5  # share: more is most
_CHEAP = 2.0  # times a frame with Uncharted's: below, it does not cost much more
NOT_SIMULATED = (
    "Not simulated: milliseconds and memory of a GeForce GTX 1080; what its author saw "
    "in moving pictures (blinds and the arched window flicker less by Uncharted TAA); "
    "the models themselves, in whose places our scenes stand."
)
_NEARER = "Master TAA is nearer to the reference than Uncharted TAA"
_BEST = "the thesis' best of five has the least error"
_ORDER = "all five are in the thesis' order, or alike"


class Table(NamedTuple):
    """A table of the thesis.

    - `number`; `mse`: no AA, FXAA, SMAA, Uncharted and Master TAA; of ghosting the last
      two alone. `ssim`: of Uncharted and Master TAA.
    """

    number: str
    mse: tuple[float, ...]
    ssim: tuple[float, float]


STATIC = {
    "pipe": Table("5.2", (8.608, 3.573, 1.278, 14.602, 1.574), (0.996, 1.0)),
    "inclined pipe": Table("5.3", (16.112, 6.47, 2.81, 14.349, 2.664), (0.996, 0.999)),
    "blinds": Table("5.4", (96.044, 70.486, 35.134, 170.229, 32.115), (0.976, 0.995)),
    "arched window": Table(
        "5.5", (56.313, 39.103, 19.849, 76.483, 21.983), (0.989, 0.996)
    ),
    "atrium": Table("5.6", (13.458, 8.29, 8.61, 42.728, 3.972), (0.938, 0.991)),
    "flowers": Table("5.7", (122.795, 66.062, 72.279, 490.281, 36.162), (0.863, 0.985)),
    "hard edges": Table("5.8", (12.463, 9.342, 8.019, 31.385, 5.012), (0.989, 0.998)),
    "hairball shadow": Table(
        "5.10", (44.367, 21.101, 25.379, 88.976, 10.293), (0.934, 0.985)
    ),
    "hairball": Table(
        "5.11", (1294.649, 649.94, 847.702, 1444.095, 226.567), (0.785, 0.937)
    ),
}
GHOSTING = {
    "moving sphere": Table("5.9", (28.634, 19.501), (0.965, 0.990)),
    "turning shadow": Table("5.12", (81.887, 38.534), (0.913, 0.940)),
    "turning hairball": Table("5.13", (875.687, 671.202), (0.691, 0.722)),
}
ALL = STATIC | GHOSTING
SHARPENED = "atrium"  # where sharpening and the reference are looked at
_LAWN = (
    "FXAA and SMAA leave the lawn and the hills, textured finer than a pixel, as they "
    "are, which jittered frames average: "
)
_SHARPER = "sharpening adds to Master TAA's small error: "
_WHY = {
    (_ORDER, "pipe"): _SHARPER,
    (_BEST, "inclined pipe"): _SHARPER,
    (_ORDER, "inclined pipe"): "sharpening that is not normalised overshoots by more "
    "than edges are jagged: ",
    (_BEST, "arched window"): _LAWN,
    (_ORDER, "arched window"): _LAWN,
    (_ORDER, "hairball shadow"): "our shadow has hairs all over the picture: without "
    "AA it has far more error than the thesis': ",
    (f"{_NEARER}, by SSIM", "turning shadow"): "both smear a shadow that crosses a "
    "still floor, and sharpening that is not normalised gives back contrast: ",
}  # where ours is another: what the pictures and the unsharpened errors show


class Errors(NamedTuple):
    """Of a scene: `(techniques, sessions)` each, techniques as in `NAMES`.

    - `mse`, `ssim`: against 128 renders; `mse_16`: against 16.
    - `signal`: mean square of the reference.
    """

    mse: Float[np.ndarray, "technique session"]
    ssim: Float[np.ndarray, "technique session"]
    mse_16: Float[np.ndarray, "technique session"]
    signal: Float[np.ndarray, "technique session"]


def judge(errors: Mapping[str, Errors]) -> list[Claim]:
    """Judge all but cost; errors by the names of scenes."""
    found = [_nearer(name, errors[name].mse, ALL[name].mse[-2:]) for name in ALL]
    for name in STATIC:
        found += _of_five(name, errors[name].mse)
    found += [*_sharpened(errors[SHARPENED].mse), _of_samples(errors[SHARPENED])]
    return found + [
        _nearer(name, 1 - errors[name].ssim, ALL[name].ssim, ", by SSIM")
        for name in ALL
    ]


def _measure(name: str) -> str:
    return f"table {ALL[name].number} ({name})"


def _why(claim: str, name: str, verdict: str) -> str:
    return "" if verdict == HOLDS else _WHY.get((claim, name), "")


def _over(one: np.ndarray, other: np.ndarray) -> Interval:
    """Ratio of two errors, by Student's t: of what is dear there are few sessions."""
    scale = 1 / max(float(other.mean()), 1e-12)  # small errors are errors, too
    return student_interval(ratio(*paired_means(one * scale, other * scale)))


def _said(values: np.ndarray) -> str:
    shown = [*range(_FIVE), _UNSHARPENED, _UNSHARPENED + 1]
    return ", ".join(f"{NAMES[k]} {values[k].mean():.3g}" for k in shown)


def _nearer(
    name: str, lacks: np.ndarray, theirs: tuple[float, ...], by: str = ""
) -> Claim:
    found, claim = _over(lacks[_MASTER], lacks[_UNCHARTED]), _NEARER + by
    verdict = below(found, 1.0)
    shown = 1 - lacks if by else lacks
    return Claim.of(
        claim,
        _measure(name),
        f"{'what SSIM lacks of 1' if by else 'MSE'} of Master over that of Uncharted",
        found,
        "",
        verdict,
        f"{_why(claim, name, verdict)}the thesis has {theirs[1]:g} against "
        f"{theirs[0]:g}, ours are {shown[_MASTER].mean():.3g} against "
        f"{shown[_UNCHARTED].mean():.3g}; with one sharpening "
        f"{shown[_MASTER].mean():.3g} against {shown[_NORMALISED].mean():.3g}",
        f"table {ALL[name].number}",
    )


def _of_five(name: str, mse: np.ndarray) -> list[Claim]:
    order = [int(k) for k in np.argsort(STATIC[name].mse)]
    ranks = " < ".join(NAMES[k] for k in order)
    first, nexts = [(order[0], k) for k in order[1:]], [*itertools.pairwise(order)]
    found = []
    for claim, pairs, bound, which in (
        (_BEST, first, 1.0, "the least other"),
        (_ORDER, nexts, 1 + ALIKE, "its next, where that is most"),
    ):
        ratios = {pair: _over(*mse[[*pair]]) for pair in pairs}
        most = max(ratios, key=lambda pair: ratios[pair].value)
        one, other = (NAMES[k] for k in most)
        verdict = every([below(ratio, bound) for ratio in ratios.values()])
        found.append(
            Claim.of(
                claim,
                _measure(name),
                f"MSE of {one} over that of {other}, {which}",
                ratios[most],
                "",
                verdict,
                f"{_why(claim, name, verdict)}the thesis: {ranks}; ours: {_said(mse)}",
                f"table {STATIC[name].number}",
            )
        )
    return found


def _sharpened(mse: np.ndarray) -> list[Claim]:
    left = _over(mse[_NORMALISED], mse[_UNCHARTED])
    alike = _over(mse[_MASTER], mse[_NORMALISED])
    each = zip(NAMES, mse, strict=True)
    said = ", ".join(f"{name} {values.mean():.3g}" for name, values in each)
    source = "table 5.1"
    return [
        Claim.of(
            "sharpening that is not normalised is most of Uncharted TAA's error",
            _measure(SHARPENED),
            "share of its error that normalised sharpening leaves",
            left,
            "",
            below(left, 1 - _MOST),
            f"most is above {_MOST:g}, the thesis leaves 0.059 (149.3 and 8.8); ours: "
            f"{said}",
            source,
        ),
        Claim.of(
            "with one sharpening, Master TAA is still nearer than Uncharted TAA",
            _measure(SHARPENED),
            "error of Master over that of Uncharted TAA, both normalised",
            alike,
            "",
            below(alike, 1.0),
            "the thesis has 0.931 (8.224 against 8.835); without any sharpening ours "
            f"is {_over(mse[_UNSHARPENED + 1], mse[_UNSHARPENED]).value:.3g}",
            source,
        ),
    ]


def _of_samples(errors: Errors) -> Claim:
    changes = {
        k: less(_over(errors.mse_16[k], errors.mse[k]), 1.0) for k in (_NONE, _MASTER)
    }
    most = max(changes, key=lambda k: abs(changes[k].value))
    said = ", ".join(f"{NAMES[k]} {each.value:.3g}" for k, each in changes.items())
    return Claim.of(
        "16 renders in the place of 128 change errors little",
        _measure(SHARPENED),
        f"error of {NAMES[most]} against 16 over that against 128, minus 1",
        changes[most],
        "",
        every([within(each, ALIKE) for each in changes.values()]),
        f"little is within {ALIKE:g}, the thesis has 0.014 and 0.044; ours: {said}",
        "table 4.1",
    )


def on_cost(seconds: Float[np.ndarray, "repeat technique"]) -> Claim:
    """Judge times of a frame; techniques: Uncharted and Master TAA."""
    uncharted, master = seconds.T
    found = student_interval(mean_of(master / uncharted))
    return Claim.of(
        "Master TAA does not cost much more than Uncharted TAA",
        "time",
        "time of a frame over that with Uncharted TAA",
        found,
        "",
        below(found, _CHEAP),
        f"much is {_CHEAP:g} times; {1e3 * master.mean():.3g} against "
        f"{1e3 * uncharted.mean():.3g} ms a frame by ray casting on this machine's "
        "CPU, what they read included; no seed repeats it",
        "chapter 5",
    )


def measured(errors: Mapping[str, Errors]) -> list[Measured]:
    """All metrics of all pictures by scene; sharpening alone where it is looked at."""
    rows = []
    for name, each in errors.items():
        floor = np.maximum(each.mse, 1e-12)
        values = {
            "": (each.mse, UNIT),
            ", RMSD": (np.sqrt(each.mse), "code values of 255"),
            ", PSNR": (10 * np.log10(255**2 / floor), "dB"),
            ", SNR": (10 * np.log10(each.signal / floor), "dB"),
            ", SSIM": (each.ssim, ""),
            ", MSE to 16 renders": (each.mse_16, UNIT),
        }
        names = NAMES if name == SHARPENED else NAMES[:_FIVE]
        for metric, (of_all, unit) in values.items():
            measure = _measure(name) + metric
            rows += [
                Measured.mean(measure, name, condition, sessions, unit)
                for condition, sessions in zip(names, of_all, strict=False)
            ]
    return rows


def scored(pictures: np.ndarray) -> Float[np.ndarray, "metric technique"]:
    """Score what is shown, as in `Errors`, but at the border.

    **Arguments:** `pictures`: 8 bits, `(picture, height, width, 3)`: those of `NAMES`,
    and the means of 16 and of 128 renders.
    """
    inner = slice(BORDER_PX, -BORDER_PX)
    *shown, coarse, truth = pictures[:, inner, inner]
    signal = np.mean(truth.astype(float) ** 2)
    found = [
        (
            metrics.mse(each, truth),
            metrics.ssim_volume(each, truth),
            metrics.mse(each, coarse),
            signal,
        )
        for each in shown
    ]
    return np.asarray(found, float).T
