"""The claims of TIDOAA, judged by what was measured.

Intervals are over sessions, paired: all conditions saw the same paths.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from ..estimates.estimate import mean_of
from ..estimates.intervals import (
    Interval,
    mean_interval,
    ratio_interval,
    student_interval,
)
from .claims import HOLDS, Claim, Measured, above, below, every, less, within

NAMES = ("no AA", "INSIDE's TAA", "TIDOAA", "TIDOAA, sub-cells")
MEASURES = "squared error to MSAA", "squared error to supersampling"
UNIT = "code values of 255, squared"
_NONE, _OURS = 0, 2
_ALIKE = 0.05  # relative: two that differ less are alike
_COMPARABLE = 0.5  # of the error without: what has less is comparable with MSAA
_COMPARED_DEG = (1.0, 5.0)  # per frame
NOT_SIMULATED = (
    "Not simulated: frame times on their phones, and what people said. The paper's "
    "baseline is not named as exactly as its own technique: INSIDE's filter stands in."
)

Errors = Float[np.ndarray, "technique session"]


def by_speed(errors: Mapping[float, Errors], truth: int) -> list[Claim]:
    """Judge error against rotation speed, deg per frame; `truth`: of `MEASURES`."""
    speeds = sorted(errors)
    gaps = {s: mean_interval(errors[s][_NONE] - errors[s][_OURS]) for s in speeds}
    shares = {s: _share(errors[s]) for s in speeds}
    tightest = min(speeds, key=lambda s: gaps[s].value)
    said = ", ".join(f"{shares[s].value:.3g} at {s:g}" for s in speeds)
    said = f"error over that of no AA, by deg per frame: {said}"
    lost = [s for s in speeds if above(gaps[s]) != HOLDS]
    where = f"not at {', '.join(f'{s:g}' for s in lost)}; " if lost else ""
    fastest = shares[speeds[-1]]
    apart = less(fastest, 1.0)
    low, high = _COMPARED_DEG
    compared = {s: shares[s] for s in speeds if low <= s <= high}
    worst = max(compared, key=lambda s: compared[s].value)
    most = max(speeds, key=lambda s: shares[s].value)
    return [
        Claim.of(
            "better than plain rendering at every speed",
            MEASURES[truth],
            f"no AA minus TIDOAA, at {tightest:g} deg per frame, where that is least",
            gaps[tightest],
            UNIT,
            every([above(gap) for gap in gaps.values()]),
            f"{where}{said}",
        ),
        Claim.of(
            "tends to plain rendering at high speed",
            MEASURES[truth],
            f"error over that of no AA, minus 1, at {speeds[-1]:g} deg per frame",
            apart,
            "",
            within(apart, _ALIKE),
            f"alike is within {_ALIKE:g}; {said}",
        ),
        Claim.of(
            "never worse than plain rendering",
            MEASURES[truth],
            f"error over that of no AA, at {most:g} deg per frame, where it is most",
            shares[most],
            "",
            every([below(share, 1 + _ALIKE) for share in shares.values()]),
            f"worse is more than {_ALIKE:g} above 1; {said}",
        ),
        Claim.of(
            "comparable with MSAA at 1 to 5 degrees per frame",
            MEASURES[truth],
            f"error over that of no AA, at {worst:g} deg per frame, where it is most",
            compared[worst],
            "",
            every([below(share, _COMPARABLE) for share in compared.values()]),
            f"comparable is below {_COMPARABLE:g}: MSAA itself has 0; {said}",
        ),
    ]


def on_bars(kept: Errors) -> Claim:
    """Judge how many pixels of thin bars keep them."""
    gap = mean_interval(kept[_OURS] - kept[_NONE])
    said = ", ".join(f"{n} {v.mean():.3g}" for n, v in zip(NAMES, kept, strict=True))
    return Claim.of(
        "bars of a fence that plain rendering breaks are restored",
        "share of bar pixels",
        "share that keep the bar, TIDOAA minus no AA",
        gap,
        "",
        above(gap),
        said,
    )


def beside(errors: Errors, truth: int) -> Claim:
    """Judge halos beside rigid things."""
    return _not_worse("rigid things have no halo", "beside them", errors, truth)


def behind(errors: Errors, truth: int) -> Claim:
    """Judge trails of what deforms."""
    claim = "what deforms leaves no trail"
    return _not_worse(claim, "where it just was", errors, truth)


def _not_worse(claim: str, where: str, errors: Errors, truth: int) -> Claim:
    share = _share(errors)
    said = ", ".join(f"{n} {v.mean():.3g}" for n, v in zip(NAMES, errors, strict=True))
    return Claim.of(
        claim,
        MEASURES[truth],
        f"error over that of no AA, {where}",
        share,
        "",
        below(share, 1 + _ALIKE),
        f"less than {1 + _ALIKE:g} is none; {said} ({UNIT}, its part of the frame's)",
    )


def on_cost(seconds: Float[np.ndarray, "repeat technique"]) -> Claim:
    """Judge its time beside MSAA's; techniques: none, MSAA, TIDOAA."""
    plain, msaa, ours = seconds.T
    found = student_interval(mean_of(ours / msaa))
    each = ", ".join(
        f"{name} {1e3 * column.mean():.3g}"
        for name, column in (("no AA", plain), ("MSAA", msaa), ("TIDOAA", ours))
    )
    return Claim.of(
        "costs less than MSAA",
        "time",
        "time of a frame over that with MSAA",
        found,
        "",
        below(found, 1.0),
        f"{each} ms a frame by ray casting on this machine's CPU, where a sample "
        "costs as much as a pixel; no seed repeats it",
    )


def _share(errors: Errors) -> Interval:
    """Error of ours over that of no AA."""
    # Errors of less than a code value squared are errors, too.
    scale = 1 / max(float(errors[_NONE].mean()), 1e-12)
    return ratio_interval(errors[_OURS] * scale, errors[_NONE] * scale)


def measured(errors: Mapping[float, Errors], truth: int) -> list[Measured]:
    """Mean error of each condition at each speed; `truth`: of `MEASURES`."""
    return [
        Measured.mean(MEASURES[truth], f"{speed:g}", name, sessions, UNIT)
        for speed, each in sorted(errors.items())
        for name, sessions in zip(NAMES, each, strict=True)
    ]
