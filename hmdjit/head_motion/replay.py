"""Recorded heads, cut into windows: replay."""

import contextlib
from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float64

from .. import _checks
from ..quaternion import rebase
from .trace import Trace


class Replay(eqx.Module):
    """Recorded heads: each session is a window of a trace, at the trace's own rate.

    - `traces`: the recordings. Where the eye was counts only if all of them tell it.
    - `rate_hz`: replay at this rate instead, resampled by slerp; None is their own.
    """

    traces: tuple[Trace, ...] = eqx.field(converter=tuple)
    rate_hz: float | None = None

    def __check_init__(self):
        rates = [trace.rate_hz for trace in self.traces]  # wrong ones raise
        if rates and self.rate_hz is not None:
            _checks.in_range("rate_hz", self.rate_hz, 0, open_low=True)
        else:
            shared_rate_hz(self.traces, "; name a refresh rate to resample them")

    def __str__(self) -> str:
        subjects = {trace.subject for trace in self.traces}
        return (
            f"{len(self.traces)} recordings of {len(subjects)} subjects, replayed at "
            f"{self.refresh_hz:.4g} Hz"
        )

    @property
    def refresh_hz(self) -> float:
        """Frames per second of the replay; the median over traces of their own."""
        return self.rate_hz or shared_rate_hz(self.traces)

    @property
    def has_places(self) -> bool:
        """Whether all traces say where the eye is; else no one's places are used."""
        return all(trace.position_m is not None for trace in self.traces)

    def windows(
        self, frames: int
    ) -> tuple[Float64[np.ndarray, "windows frames components"], list[str]]:
        """Return all whole windows of the traces, re-based, and the subject of each.

        Windows are `(frames, 4)`, or `(frames, 7)` with positions.

        **Errors:** `ValueError` if no trace is as long as a window.
        """
        cut, is_placed = [], self.has_places
        for trace in self.traces:
            # A trace that is shorter than a window has none.
            with contextlib.suppress(ValueError):
                windows = trace.windows(frames, rate_hz=self.rate_hz)
                windows = windows if is_placed else windows[..., :4]
                cut.append((windows, trace.subject))
        if not cut:
            parts = [part.duration_s for trace in self.traces for part in trace.parts()]
            least_s, longest_s = (frames - 1) / self.refresh_hz, max(parts)
            raise ValueError(
                f"traces must last at least {frames} frames at {self.refresh_hz:.4g} "
                f"Hz without a gap, {least_s:.3g} s; the longest lasts "
                f"{_checks.apart(longest_s, least_s, spec='3g')} s."
            )
        windows = np.concatenate([block for block, _ in cut])
        subjects = [subject for block, subject in cut for _ in block]
        return np.stack([rebase(window) for window in windows]), subjects


def shared_rate_hz(traces: Sequence[Trace], advice: str = "") -> float:
    """Median frame rate of recordings, Hz; `ValueError` for none and mixed rates."""
    if not traces:
        raise ValueError("traces must name at least one recording, got none.")
    rates = [trace.rate_hz for trace in traces]
    median = float(np.median(rates))
    for trace, rate in zip(traces, rates, strict=True):
        if abs(rate / median - 1) > 0.02:
            raise ValueError(
                f"traces must share one rate within 2 %: {trace.name} has {rate:.2f} "
                f"Hz, the median is {median:.2f} Hz{advice}."
            )
    return median
