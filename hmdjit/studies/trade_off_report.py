"""A trade-off in words: the table that the command line prints."""

import math
from collections.abc import Sequence

from rich import box
from rich.table import Table

from .intervals import Z95
from .trade_off import Row, front_of


def table(rows: Sequence[Row], seconds: float) -> Table:
    """Lay out rows: what a setting costs, and how far off it is."""
    found = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    found.add_column("setting", overflow="fold")
    for header in (
        *("technique", "MTCD", "bias, %", "sd, %", "detail loss", "ms/session"),
        *("s to 1 %", f"error, % at {seconds:g} s", "compile, s"),
    ):
        found.add_column(header, justify="right")
    on_front = [
        row
        for technique in dict.fromkeys(row.technique for row in rows)
        for row in front_of([r for r in rows if r.technique == technique])
    ]
    knob = rows[0].knob if rows else ""
    for row in rows:
        if row.knob != knob:
            knob = row.knob
        mean = row.reference_mtcd or math.nan
        mark = " †" if row.is_other_device else " ‡" * (row.bias_by == "frame mean")
        found.add_row(
            row.setting + mark,
            row.technique,
            f"{row.mtcd:.2f}",
            f"{100 * row.bias / mean:+.2f} ±{100 * Z95 * row.bias_se / mean:.2f}",
            f"{100 * row.mtcd_sd / mean:.0f}",
            f"{row.detail_loss:.0f}",
            f"{1e3 * row.s_per_session:.2f}",
            f"{row.seconds_to(0.01):.1f}",
            f"{100 * row.error(seconds):.2f}" if row.reference_mtcd else "-",
            f"{row.compile_s:.1f}",
            style="bold" if row in on_front else "",
        )
    return found


def explanation(rows: Sequence[Row]) -> str:
    """Say what the table's words mean, and what it rests on."""
    identity = rows[0].identity
    words = [
        "Bold: on the Pareto front of seconds and |bias|. † another modelled device: "
        "its difference is no error. ‡ no sample of the frame's pixels: compared by "
        "frame means. Bias: paired, with 95 %. s to 1 %: running time to a Monte Carlo "
        "standard error of 1 %. Compiled two at a time, so compile times include "
        "waiting.",
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
