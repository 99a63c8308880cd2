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
from ..estimates.estimate import mean_of
from ..estimates.intervals import Interval, ratio_interval, student_interval
from .claims import Claim, Measured, above, below, every, less, within

NAMES = ("no AA", "FXAA", "SMAA", "Uncharted TAA", "Master TAA")
NAMES += ("Uncharted TAA, normalised", "Master TAA, not normalised")
NAMES += ("Uncharted TAA, unsharpened", "Master TAA, unsharpened")
_NONE, _UNCHARTED, _MASTER, _NORMALISED, _UNSHARPENED = 0, 3, 4, 5, 7
UNIT = "code values of 255, squared"
_LITTLE = 0.05  # relative: of what an error changes with the reference
_MOST = 0.5  # share: more is most
_CHEAP = 2.0  # times Uncharted's: below, it does not cost much more
NOT_SIMULATED = (
    "Not simulated: milliseconds and memory of a GeForce GTX 1080; what its author saw "
    "in moving pictures (blinds and the arched window flicker less by Uncharted TAA); "
    "the models themselves, in whose places our scenes stand."
)


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
    found = [_nearer(name, errors[name], "MSE") for name in ALL]
    for name in STATIC:
        found += [_best(name, errors[name].mse), _order(name, errors[name].mse)]
    found += [*_sharpened(errors[SHARPENED].mse), _of_samples(errors[SHARPENED])]
    return found + [_nearer(name, errors[name], "SSIM") for name in ALL]


def _measure(name: str, metric: str) -> str:
    return f"table {ALL[name].number} ({name}), {metric}"


def _over(one: np.ndarray, other: np.ndarray) -> Interval:
    """Ratio of two errors."""
    scale = 1 / max(float(other.mean()), 1e-12)  # small errors are errors, too
    return ratio_interval(one * scale, other * scale)


def _said(values: np.ndarray) -> str:
    five = zip(NAMES[: len(STATIC["pipe"].mse)], values, strict=False)
    return ", ".join(f"{name} {each.mean():.3g}" for name, each in five)


def _nearer(name: str, errors: Errors, metric: str) -> Claim:
    lacks = errors.mse if metric == "MSE" else 1 - errors.ssim
    ratio = _over(lacks[_MASTER], lacks[_UNCHARTED])
    table = ALL[name]
    theirs = table.mse[-2:] if metric == "MSE" else table.ssim
    shown = errors.mse if metric == "MSE" else errors.ssim
    return Claim.of(
        "Master TAA is nearer to the reference than Uncharted TAA",
        _measure(name, metric),
        "error of Master over that of Uncharted TAA",
        ratio,
        "",
        below(ratio, 1.0),
        f"the thesis has {theirs[1]:g} against {theirs[0]:g} ({metric}), ours are "
        f"{shown[_MASTER].mean():.3g} against {shown[_UNCHARTED].mean():.3g}",
        f"table {table.number}",
    )


def _best(name: str, mse: np.ndarray) -> Claim:
    table = STATIC[name]
    best = int(np.argmin(table.mse))
    others = {k: _over(mse[best], mse[k]) for k in range(len(table.mse)) if k != best}
    rival = max(others, key=lambda k: others[k].value)
    return Claim.of(
        "the thesis' best of five has the least error",
        _measure(name, "MSE"),
        f"error of {NAMES[best]} over that of {NAMES[rival]}, the least other",
        others[rival],
        "",
        every([below(ratio, 1.0) for ratio in others.values()]),
        f"the thesis' best is {NAMES[best]}; ours: {_said(mse)}",
        f"table {table.number}",
    )


def _order(name: str, mse: np.ndarray) -> Claim:
    table = STATIC[name]
    order = [int(k) for k in np.argsort(table.mse)]
    steps = {
        (one, other): _over(mse[one], mse[other])
        for one, other in itertools.pairwise(order)
    }
    pair = max(steps, key=lambda each: steps[each].value)
    return Claim.of(
        "all five are in the thesis' order",
        _measure(name, "MSE"),
        f"error of {NAMES[pair[0]]} over that of {NAMES[pair[1]]}, its next, where "
        "that is most",
        steps[pair],
        "",
        every([below(ratio, 1.0) for ratio in steps.values()]),
        f"the thesis: {' < '.join(NAMES[k] for k in order)}; ours: {_said(mse)}",
        f"table {table.number}",
    )


def _sharpened(mse: np.ndarray) -> list[Claim]:
    left = _over(mse[_NORMALISED], mse[_UNCHARTED])
    gone = Interval(
        1 - left.value, 1 - left.high, 1 - left.low, left.standard_error, left.method
    )
    alike = _over(mse[_MASTER], mse[_NORMALISED])
    each = zip(NAMES, mse, strict=True)
    said = ", ".join(f"{name} {values.mean():.3g}" for name, values in each)
    source = "table 5.1"
    return [
        Claim.of(
            "sharpening that is not normalised is most of Uncharted TAA's error",
            _measure(SHARPENED, "MSE"),
            "share of its error that goes with normalised sharpening",
            gone,
            "",
            above(gone, _MOST),
            f"most is above {_MOST:g}, the thesis has 0.941 (149.3 and 8.8); ours: "
            f"{said}",
            source,
        ),
        Claim.of(
            "with one sharpening, Master TAA is still nearer than Uncharted TAA",
            _measure(SHARPENED, "MSE"),
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
        _measure(SHARPENED, "MSE"),
        f"error of {NAMES[most]} against 16 over that against 128, minus 1",
        changes[most],
        "",
        every([within(each, _LITTLE) for each in changes.values()]),
        f"little is within {_LITTLE:g}, the thesis has 0.014 and 0.044; ours: {said}",
        "table 4.1",
    )


def on_cost(seconds: Float[np.ndarray, "repeat technique"]) -> Claim:
    """Judge times of a step; techniques: Uncharted and Master TAA."""
    uncharted, master = seconds.T
    ratio = student_interval(mean_of(master / uncharted))
    return Claim.of(
        "Master TAA does not cost much more than Uncharted TAA",
        "time",
        "time of a step over that of Uncharted TAA",
        ratio,
        "",
        below(ratio, _CHEAP),
        f"much is {_CHEAP:g} times; {1e3 * master.mean():.3g} against "
        f"{1e3 * uncharted.mean():.3g} ms on this machine's CPU, without what renders "
        "its edges, albedo and models; no seed repeats it",
        "chapter 5",
    )


def measured(errors: Mapping[str, Errors]) -> list[Measured]:
    """All metrics of all pictures, by scene."""
    rows = []
    for name, each in errors.items():
        floor = np.maximum(each.mse, 1e-12)
        values = {
            "MSE": (each.mse, UNIT),
            "RMSD": (np.sqrt(each.mse), "code values of 255"),
            "PSNR": (10 * np.log10(255**2 / floor), "dB"),
            "SNR": (10 * np.log10(each.signal / floor), "dB"),
            "SSIM": (each.ssim, ""),
            "MSE to 16 renders": (each.mse_16, UNIT),
        }
        for metric, (of_all, unit) in values.items():
            for condition, sessions in zip(NAMES, of_all, strict=True):
                measure = _measure(name, metric)
                rows.append(Measured.mean(measure, name, condition, sessions, unit))
    return rows


def scored(pictures: np.ndarray) -> Float[np.ndarray, "metric technique"]:
    """Score what is shown in some frames, as in `Errors`, on average over these.

    **Arguments:** `pictures`: 8 bits, `(frames, pictures, height, width, 3)`: those of
    `NAMES`, and the means of 16 and of 128 renders.
    """
    count = len(NAMES)
    found = [
        [
            (
                metrics.mse(shown, frame[-1]),
                metrics.ssim_volume(shown, frame[-1]),
                metrics.mse(shown, frame[-2]),
                np.mean(frame[-1].astype(float) ** 2),
            )
            for shown in frame[:count]
        ]
        for frame in pictures
    ]
    return np.asarray(found, float).mean(axis=0).T
