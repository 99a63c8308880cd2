"""The claims of Maruszczuk et al., judged by what was measured.

Their four conditions are named by filter and space: LL, LG, BL and BG, of Lanczos (L)
or box (B), in linear light (L) or gamma (G). Intervals are over sessions, paired: all
conditions saw the same heads and tiles. Patterns and colours are fixed.
"""

import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..estimates.intervals import Interval, mean_interval
from ..metrics import AbstractMetric
from .claims import HOLDS, UNTOLD, Claim, Measured, above, every, within

NAMES: tuple[str, ...] = ("LL", "LG", "BL", "BG")
_ABOUT = 0.25  # of what lies between best and worst: two that differ less are alike
SQUARE_DEG, CELL_DEG, WALL_DEG = 2.0, 4.0, 0.4  # of the patterns, our choice
EDGES_PER_DEG = {
    "checkerboard": 2 / SQUARE_DEG,
    "honeycomb": 4 * (CELL_DEG - WALL_DEG) / CELL_DEG**2,
}
"""Length of the edges in a pattern, degrees per square degree."""
PATTERNS = tuple(EDGES_PER_DEG)

Values = Float[np.ndarray, "condition pattern pair session"]


class Measure(NamedTuple):
    """One way to hold what is shown against what should be.

    - `words`: what tables call it.
    - `study`: which one of `studies` has it.
    """

    metric: AbstractMetric
    words: str
    study: str = "upright"

    @property
    def sign(self) -> int:
        """Of how bad it is to have more of it."""
        return 1 if self.metric.less_is_better else -1

    @property
    def unit(self) -> str:
        """Of differences in how bad it is."""
        return self.metric.unit if self.sign == 1 else f"less {self.words}"


def claims_by(measure: Measure, values: Values) -> list[Claim]:
    """Judge the paper's claims by one measure.

    Patterns and pairs of colours are averaged over.
    """
    names, unit = NAMES, measure.unit
    worse = measure.sign * values
    of_session = dict(zip(names, worse.mean(axis=(1, 2)), strict=True))
    by_scene = dict(zip(names, worse.mean(axis=-1), strict=True))
    means = {name: float(each.mean()) for name, each in of_session.items()}
    said = ", ".join(f"{name} {measure.sign * means[name]:.3g}" for name in names)
    said += f" ({measure.metric.unit})"

    def judged(
        claim: str, quantity: str, found: Interval, verdict: str, reason: str
    ) -> Claim:
        numbers = claim, measure.words, quantity, found, unit
        return Claim.of(*numbers, verdict, reason, "results: comparisons of pairs, JOD")

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
        return judged(claim, quantity, gaps[rival], verdict, f"{reason}: {said}")

    spread = max(means.values()) - min(means.values())
    alike, margin = gap("LG", "BL"), _ABOUT * spread
    each = [worse[names.index("BG"), p] - worse[names.index("LL"), p] for p in (0, 1)]
    by_pattern = [part.mean(axis=0) for part in each]
    more = mean_interval(by_pattern[0] - by_pattern[1])
    # How much edge a pattern has is our choice: per edge the verdict must be the same.
    per_edge = [
        part / EDGES_PER_DEG[name]
        for name, part in zip(PATTERNS, by_pattern, strict=True)
    ]
    verdicts = {above(more), above(mean_interval(per_edge[0] - per_edge[1]))}
    is_there = every([above(mean_interval(part)) for part in by_pattern])
    verdict = verdicts.pop() if len(verdicts) == 1 and is_there == HOLDS else UNTOLD
    gaps = dict(zip(PATTERNS, (float(part.mean()) for part in each), strict=True))
    sizes = ", ".join(f"{pattern} {gap:.3g}" for pattern, gap in gaps.items())
    lengths = ", ".join(f"{gaps[p] / EDGES_PER_DEG[p]:.3g}" for p in PATTERNS)
    return [
        extreme("LL", 1, "LL is the best", "the best other, minus LL"),
        judged(
            "LG is about as good as BL",
            "LG minus BL",
            alike,
            within(alike, margin),
            f"alike is within {margin:.3g}, a quarter of worst minus best: {said}",
        ),
        extreme("BG", -1, "BG is the worst", "BG minus the worst other"),
        judged(
            "the checkerboard shows more of it than the honeycomb",
            "BG minus LL, of checkerboard minus honeycomb",
            more,
            verdict,
            f"BG minus LL: {sizes} ({unit}); per length of edge {lengths}. Told only "
            "if BG is worse on both, and with and without regard to how much edge a "
            "pattern has, which is our choice",
        ),
    ]


def measured(measure: Measure, values: Values) -> list[Measured]:
    """Mean of each condition in each pattern, and in each of its pairs of colours."""
    rows = []
    for name, of_condition in zip(NAMES, values, strict=True):
        for pattern, part in zip(PATTERNS, of_condition, strict=True):
            cases = {pattern: part.mean(axis=0)}
            cases |= {f"{pattern}_{k + 1}": pair for k, pair in enumerate(part)}
            for case, sessions in cases.items():
                unit = measure.metric.unit
                rows.append(Measured.mean(measure.words, case, name, sessions, unit))
    return rows


def order(measure: Measure, values: Values) -> str:
    """Put the conditions in order of preference, as LL > BL ~ LG > BG.

    The least error first; `~` stands between two whose difference may be 0. By
    Thurstone's model with equal spreads that is the order of their JOD, whatever one
    is worth.
    """
    worse = measure.sign * values.mean(axis=(1, 2))
    places = np.argsort(worse.mean(axis=-1), kind="stable")
    words = NAMES[places[0]]
    for better, place in itertools.pairwise(places):
        is_sure = above(mean_interval(worse[place] - worse[better])) == HOLDS
        words += (" > " if is_sure else " ~ ") + NAMES[place]
    return words
