"""A trade-off in words: the table that the command line prints."""

import math
from collections.abc import Sequence

from rich.text import Text

from ..estimates.intervals import Z95
from ..figures.trade_off import machine_words
from ..trade_off.trade_off import Row, front_of
from . import tables


def table(rows: Sequence[Row], seconds: float, width: int = 80) -> tables.Continued:
    """Lay out rows: what a setting costs, and how far off it is.

    **Arguments:** `seconds`: time at which total errors are compared; `width`: of the
    terminal, characters: narrow ones get fewer columns.
    """
    columns = {
        "setting": tables.WORDS,
        "MTCD": "{:.2f}",
        "bias, %": "{:+.2f} ±{:.2f}",
        "sd, %": "{:.0f}",
        "ms each": "{:.2f}",
        "s to 1 %": "{:.1f}",
        f"in {seconds:g} s, %": "{:.2f}",
    }
    if width >= 110:
        columns |= {"detail loss": "{:.0f}", "compile, s": "{:.1f}"}
    laid_out: list[Sequence | None] = []
    bold: list[bool] = []
    for technique in dict.fromkeys(row.technique for row in rows):
        mine = [row for row in rows if row.technique == technique]
        front = front_of(mine)
        laid_out += [None, [Text(technique, style="italic")]]
        laid_out += [_cells(row, seconds) for row in mine]
        bold += [False, False, *(row in front for row in mine)]
    return tables.table(columns, laid_out, bold=bold, no_wrap=False)


def _cells(row: Row, seconds: float) -> Sequence:
    mean = row.reference_mtcd or math.nan
    mark = " †" if row.is_other_device else " ‡" * (row.bias_by == "frame mean")
    return (
        f"  {row.setting}{mark}",
        row.mtcd,
        (100 * row.bias / mean, 100 * Z95 * row.bias_se / mean),
        100 * row.mtcd_sd / mean,
        1e3 * row.s_per_session,
        row.seconds_to(0.01),
        100 * row.error(seconds) if row.reference_mtcd else None,
        row.detail_loss,
        row.compile_s,
    )


def explanation(rows: Sequence[Row]) -> str:
    """Say what the table's words mean, and what it rests on."""
    identity = rows[0].identity
    words = [
        "Bold: on the Pareto front of seconds and |bias|. † another modelled device: "
        "its difference is no error. ‡ no sample of the frame's pixels: compared by "
        "frame means. Bias: paired, with 95 %. sd: between sessions. ms each: per "
        "session. s to 1 %: running time to a Monte Carlo standard error of 1 %; next "
        "to it, total error in a given time. Compiled two at a time, so compile times "
        "include waiting.",
        f"{machine_words(identity)}; JAX {identity['jax_version']}.",
    ]
    for row in rows:
        if row.setting == "whole frame" and row.frame_difference_se > 0:
            usual = ("default", row.technique)
            twin = next((r for r in rows if (r.knob, r.technique) == usual), None)
            if twin is not None:
                # Both are differences to the reference on tiles.
                gap = row.frame_difference - twin.frame_difference
                z = gap / math.hypot(row.frame_difference_se, twin.frame_difference_se)
                words.append(
                    f"Check of tiles, {row.technique}: whole frame minus tiles "
                    f"{100 * gap / row.reference_mtcd:+.1f} % over {row.sessions} "
                    f"sessions ({z:+.1f} standard errors)."
                )
    return "\n".join(words)
