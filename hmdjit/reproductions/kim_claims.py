"""The claims of Kim et al., judged by what was measured.

Intervals are over sessions, paired: all conditions saw the same heads and tiles.
Pictures and solids are fixed.
"""

import numpy as np
from jaxtyping import Float

from ..estimates.intervals import Interval, mean_interval, ratio_interval
from ..metrics import MTCD
from .claims import Claim, Measured, above, below, every, less, within
from .kim_map import Place

PAPERS_RATIO, ROUNDING = 0.56, 0.005
_ALIKE = 0.05  # relative: two that differ less are almost identical
MOST_SHARE = 0.1  # of a frame's time
_IN_WORDS = "results, in words"
TIMED, TIMED_PX = "atrium", 256
UNIT = MTCD().unit
NAMES = {"none": "no AA", "msaa4": "MSAA", "head_movement": "head movement"}
"""What the paper calls its three conditions."""

OURS, COMBINED = "head_movement", "head_movement+msaa4"
Values = dict[str, Float[np.ndarray, "scene session"]]
"""MTCD by technique."""


def claims_on_pictures(
    values: Values, names: list[str], places: list[Place]
) -> list[Claim]:
    """Judge figure 3: mean and least MTCD over pictures."""
    none, msaa, ours = (values[id] for id in NAMES)
    ratio = ratio_interval(ours.mean(axis=0), msaa.mean(axis=0))
    plain = ratio_interval(none.mean(axis=0), msaa.mean(axis=0))
    calmest = {id: int(values[id].mean(axis=1).argmin()) for id in NAMES}
    least = {id: values[id][place] for id, place in calmest.items()}
    of_least = least["msaa4"] - least[OURS]
    apart = ratio_interval(of_least, (msaa - ours).mean(axis=0))
    at = [names[calmest[id]] for id in ("msaa4", OURS)]
    sizes = [f"{least[id].mean():.3g}" for id in ("msaa4", OURS)]
    means_ = ", ".join(f"{NAMES[id]} {values[id].mean():.3g}" for id in NAMES)
    return [
        Claim.of(
            "MTCD is 56 % of that with MSAA, on average",
            "MTCD, pictures",
            "mean MTCD of head movement over MSAA's",
            ratio,
            "",
            within(less(ratio, PAPERS_RATIO), ROUNDING),
            f"{means_} code values; {_where(places)}",
            "figure 3",
        ),
        Claim.of(
            "without AA and with MSAA it is almost identical",
            "MTCD, pictures",
            "mean MTCD of no AA over MSAA's",
            plain,
            "",
            within(less(plain, 1.0), _ALIKE),
            f"alike is within {_ALIKE:g}; a picture has no edges of geometry",
            "figure 3",
        ),
        Claim.of(
            "the least MTCD of any picture is almost the same",
            "MTCD, pictures",
            "MSAA minus head movement on the calmest picture, over that of the means",
            apart,
            "",
            within(apart, MOST_SHARE),
            f"alike is within {MOST_SHARE:g}; {sizes[0]} ({at[0]}) and {sizes[1]} "
            f"({at[1]}) code values",
            "figure 3",
        ),
    ]


def claims_on_solids(values: Values) -> list[Claim]:
    """Judge what is said of MSAA and of both together, where there are edges."""
    pooled = {id: each.mean(axis=0) for id, each in values.items()}
    plain = ratio_interval(pooled["none"], pooled["msaa4"])
    gaps = {
        id: mean_interval(each - pooled[COMBINED])
        for id, each in pooled.items()
        if id != COMBINED
    }
    rival = min(gaps, key=lambda id: gaps[id].value)
    said = ", ".join(f"{id} {each.mean():.3g}" for id, each in pooled.items())
    return [
        Claim.of(
            "without AA and with MSAA it is almost identical",
            "MTCD, solids",
            "mean MTCD of no AA over MSAA's",
            plain,
            "",
            within(less(plain, 1.0), _ALIKE),
            "solids have edges, which MSAA smooths: theirs were pictures",
            "figure 3",
        ),
        Claim.of(
            "combined with MSAA it performs best",
            "MTCD, solids",
            f"the best other ({rival}) minus both together",
            gaps[rival],
            UNIT,
            every([above(gap) for gap in gaps.values()]),
            f"{said} ({UNIT})",
            _IN_WORDS,
        ),
    ]


def claim_on_cost(share: Interval) -> Claim:
    """Judge the time of a frame."""
    return Claim.of(
        "it takes less than 10 % of a frame",
        "time",
        f"time that it adds, over that of rendering {TIMED}",
        share,
        "",
        below(share, MOST_SHARE),
        f"{TIMED_PX} x {TIMED_PX} px, ray casting on this machine's CPU; what else "
        "that runs moves this figure, and no seed repeats it",
        _IN_WORDS,
    )


def _where(places: list[Place]) -> str:
    """Say where on the map the paper's ratio lies within the interval."""
    there = [p for p in places if p.low <= PAPERS_RATIO <= p.high]
    if not there:
        return "nowhere on the map is it 0.56"
    kinds = sorted({(p.correlation, p.px_per_frame) for p in there})
    words = ", ".join(f"{rho:g} at {px:g} px" for rho, px in kinds[:6])
    more = f" and {len(kinds) - 6} more" if len(kinds) > 6 else ""
    return (
        f"0.56 is within the interval at {len(there)} of {len(places)} places of the "
        "map (correlation of a frame's turn with the next, at px per frame: "
        f"{words}{more})"
    )


def figure_3(values: Values) -> list[Measured]:
    """Return the largest, mean and least MTCD over pictures, by condition."""
    rows = []
    for id, name in NAMES.items():
        by_scene = values[id].mean(axis=1)
        cases = {
            "max": values[id][by_scene.argmax()],
            "mean": values[id].mean(axis=0),
            "min": values[id][by_scene.argmin()],
        }
        for case, sessions in cases.items():
            rows.append(Measured.mean("MTCD, pictures", case, name, sessions, UNIT))
    return rows


def means(measure: str, values: Values) -> list[Measured]:
    """Mean over scenes, by condition."""
    return [
        Measured.mean(measure, "mean", id, each.mean(axis=0), UNIT)
        for id, each in values.items()
    ]
