"""Sensitivities in words: the table that a terminal shows."""

from rich import box
from rich.table import Table
from rich.text import Text

from ..sensitivity.sensitivity import Sensitivities


def table(found: Sensitivities) -> Table:
    """Lay out one row per parameter; bold where the sign is sure."""
    laid_out = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    laid_out.add_column("parameter p", no_wrap=True)
    for header in ("value", "d ln R / d ln p", "95 %"):
        laid_out.add_column(header, justify="right", no_wrap=True)
    laid_out.add_column("sign")
    for row in found.rows():
        is_relative = row.per == "relative"
        laid_out.add_row(
            Text(row.name),
            f"{row.value:.4g}",
            f"{row.derivative:+.4f}" + ("" if is_relative else f" per {row.per}"),
            f"{row.low:+.4f} to {row.high:+.4f}",
            row.sign,
            style="bold" if row.sign in ("+", "-") else "",
        )
    return laid_out


def explanation(found: Sensitivities) -> str:
    """Say what the table's words mean, and what it rests on."""
    ratio = found.ratio
    return (
        f"R = {ratio.value:.4f} [{ratio.low:.4f}, {ratio.high:.4f}], {found.about}.\n"
        "d ln R / d ln p: by how many percent R changes if p grows by 1 %; `per`: "
        "d ln R / dp of a p that is not positive. Numbers per axis are pitch, yaw, "
        "roll. The picture is fixed in display pixels. 95 % intervals over sessions "
        f"({found.method}), each parameter on its own; `unclear` contains 0."
    )
