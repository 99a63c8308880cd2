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
from .claims import HOLDS, Claim, Measured, above, below, every, within

NAMES = ("no AA", "INSIDE's TAA", "TIDOAA", "TIDOAA, sub-cells")
REFERENCES = ("MSAA", "its samples, each shaded")
MEASURES = "squared error to MSAA", "squared error to supersampling"
UNIT = "code values of 255, squared"
_NONE, _OURS, _MSAA = 0, 2, 4  # in `(*NAMES, *REFERENCES)`
_ALIKE = 0.05  # of no AA's error: two that differ by less are alike
_COMPARABLE = 0.5  # of what MSAA removes: what removes more is comparable with it
_COMPARED_DEG = (1.0, 5.0)  # per frame
_BY_SPEED = "evaluation: squared error to MSAA by rotation speed"
_IN_WORDS = "evaluation, in words"
NOT_SIMULATED = (
    "Not simulated: frame times on their phones (the cost is a share of MSAA's, by ray "
    "casting), and what people said, whom nothing here stands for. The paper's "
    "baseline is not named as exactly as its own technique: INSIDE's filter stands in."
)

Errors = Float[np.ndarray, "technique session"]


def by_speed(errors: Mapping[float, Errors], truth: int) -> list[Claim]:
    """Judge error against rotation speed, deg per frame; `truth`: of `MEASURES`.

    What is removed is a paired difference over no AA's mean error at all speeds: where
    little is to be seen at one of them it is small, and never a ratio of two zeros.
    """
    speeds = sorted(errors)
    typical = np.mean([errors[s][_NONE] for s in speeds], axis=0)

    def removed(gaps: Mapping[float, np.ndarray]) -> tuple[float, Interval, str]:
        """Return where least is removed, what that is, and whether all are above 0."""
        found = {s: _over(gap, typical) for s, gap in gaps.items()}
        least = min(found, key=lambda s: found[s].value)
        return least, found[least], every([above(each) for each in found.values()])

    gaps = {s: errors[s][_NONE] - errors[s][_OURS] for s in speeds}
    low, high = _COMPARED_DEG
    beyond = {
        s: gaps[s] - _COMPARABLE * (errors[s][_NONE] - errors[s][_MSAA])
        for s in speeds
        if low <= s <= high
    }
    least, most_lost, is_better = removed(gaps)
    *_, is_never_worse = removed({s: gap + _ALIKE * typical for s, gap in gaps.items()})
    compared, farthest, is_comparable = removed(beyond)
    fastest = _over(gaps[speeds[-1]], typical)
    shares = {s: errors[s].mean(axis=1) / errors[s][_NONE].mean() for s in speeds}
    said = ", ".join(f"{shares[s][_OURS]:.3g} at {s:g}" for s in speeds)
    said = f"error over that of no AA, by deg per frame: {said}"
    if truth:
        said += f"; MSAA's {shares[compared][_MSAA]:.3g}"
    lost = [s for s in speeds if above(_over(gaps[s], typical)) != HOLDS]
    where = f"not at {', '.join(f'{s:g}' for s in lost)}; " if lost else ""
    removes = "share of no AA's error that it removes"

    def claim(
        words: str, quantity: str, found: Interval, verdict: str, reason: str
    ) -> Claim:
        said = words, MEASURES[truth], quantity, found, ""
        return Claim.of(*said, verdict, reason, _BY_SPEED)

    return [
        claim(
            "better than plain rendering at every speed",
            f"{removes}, at {least:g} deg per frame, where that is least",
            most_lost,
            is_better,
            f"{where}{said}",
        ),
        claim(
            "tends to plain rendering at high speed",
            f"{removes}, at {speeds[-1]:g} deg per frame",
            fastest,
            within(fastest, _ALIKE),
            f"alike is within {_ALIKE:g}; {said}",
        ),
        claim(
            "never worse than plain rendering",
            f"{removes}, at {least:g} deg per frame, where that is least",
            most_lost,
            is_never_worse,
            f"worse is below -{_ALIKE:g}; {said}",
        ),
        claim(
            "comparable with MSAA at 1 to 5 degrees per frame",
            f"{removes}, beyond half of MSAA's, at {compared:g} deg per frame, where "
            "that is least",
            farthest,
            is_comparable,
            f"comparable is what removes more than half of what MSAA does; {said}",
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
        _IN_WORDS,
    )


def beside(errors: Errors, truth: int) -> Claim:
    """Judge halos beside rigid things."""
    return _not_worse("rigid things have no halo", "beside them", errors, truth)


def behind(errors: Errors, truth: int) -> Claim:
    """Judge trails of what deforms."""
    claim = "what deforms leaves no trail"
    return _not_worse(claim, "where it just was", errors, truth)


def _not_worse(claim: str, where: str, errors: Errors, truth: int) -> Claim:
    share = _over(errors[_OURS], errors[_NONE])
    said = ", ".join(f"{n} {v.mean():.3g}" for n, v in zip(NAMES, errors, strict=False))
    return Claim.of(
        claim,
        MEASURES[truth],
        f"error over that of no AA, {where}",
        share,
        "",
        below(share, 1 + _ALIKE),
        f"less than {1 + _ALIKE:g} is none; {said} ({UNIT}, its part of the frame's)",
        _IN_WORDS,
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
        "evaluation: time of a frame",
    )


def _over(
    part: Float[np.ndarray, " session"], whole: Float[np.ndarray, " session"]
) -> Interval:
    """Ratio of means."""
    # Errors of less than a code value squared are errors, too.
    scale = 1 / max(float(whole.mean()), 1e-12)
    return ratio_interval(part * scale, whole * scale)


def measured(errors: Mapping[float, Errors], truth: int) -> list[Measured]:
    """Mean error of each condition at each speed; `truth`: of `MEASURES`."""
    return [
        Measured.mean(MEASURES[truth], f"{speed:g}", name, sessions, UNIT)
        for speed, each in sorted(errors.items())
        for name, sessions in zip((*NAMES, *REFERENCES), each, strict=True)
        if name != REFERENCES[truth]  # 0, as a reference to itself
    ]
