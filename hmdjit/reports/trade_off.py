"""A trade-off in words: the table that the command line prints."""

import math
from collections.abc import Sequence

from rich import box
from rich.table import Table

from ..estimates.intervals import Z95
from ..trade_off.trade_off import Row, front_of


def table(rows: Sequence[Row], seconds: float, width: int = 80) -> Table:
    """Lay out rows: what a setting costs, and how far off it is.

    **Arguments:** `seconds`: time at which total errors are told; `width`: of the
    terminal, characters: narrow ones are told less.
    """
    found = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    found.add_column("setting", no_wrap=True)
    is_wide = width >= 110
    headers = ["MTCD", "bias, %", "sd, %", "ms each", "s to 1 %"]
    headers += [f"in {seconds:g} s, %"]
    headers += ["detail loss", "compile, s"] * is_wide
    for header in headers:
        found.add_column(header, justify="right")
    on_front = [
        row
        for technique in dict.fromkeys(row.technique for row in rows)
        for row in front_of([r for r in rows if r.technique == technique])
    ]
    for technique in dict.fromkeys(row.technique for row in rows):
        found.add_section()
        found.add_row(technique, style="italic")
        for row in rows:
            if row.technique == technique:
                cells = _cells(row, seconds)[: len(headers) + 1]
                found.add_row(*cells, style="bold" if row in on_front else "")
    return found


def _cells(row: Row, seconds: float) -> list[str]:
    mean = row.reference_mtcd or math.nan
    mark = " †" if row.is_other_device else " ‡" * (row.bias_by == "frame mean")
    return [
        f"  {row.setting}{mark}",
        f"{row.mtcd:.2f}",
        f"{100 * row.bias / mean:+.2f} ±{100 * Z95 * row.bias_se / mean:.2f}",
        f"{100 * row.mtcd_sd / mean:.0f}",
        f"{1e3 * row.s_per_session:.2f}",
        f"{row.seconds_to(0.01):.1f}",
        f"{100 * row.error(seconds):.2f}" if row.reference_mtcd else "-",
        f"{row.detail_loss:.0f}",
        f"{row.compile_s:.1f}",
    ]


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
        f"{identity.device}, {identity.cores} cores ({identity.processor}), load "
        f"{identity.load:.2g} before; JAX {identity.jax_version}.",
    ]
    for row in rows:
        if row.setting == "whole frame" and row.frame_difference_se > 0:
            twin = next(
                (
                    r
                    for r in rows
                    if (r.knob, r.technique) == ("default", row.technique)
                ),
                None,
            )
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
