"""Sensitivities in words: the table that a terminal shows."""

from rich.text import Text

from ..sensitivity.sensitivity import Sensitivities
from . import tables


def table(found: Sensitivities) -> tables.Continued:
    """Lay out one row per parameter; bold where the sign is sure."""
    rows = found.rows()
    columns = {
        "parameter p": tables.WORDS,
        "value": "{:.4g}",
        "d ln R / d ln p": "{:+.4f}{}",
        "95 %": "{:+.4f} to {:+.4f}",
        "sign": tables.WORDS,
    }
    per = ["" if row.per == "relative" else f" per {row.per}" for row in rows]
    cells = [
        (Text(row.name), row.value, (row.derivative, of), (row.low, row.high), row.sign)
        for row, of in zip(rows, per, strict=True)
    ]
    return tables.table(columns, cells, bold=[row.sign in ("+", "-") for row in rows])


def explanation(found: Sensitivities) -> str:
    """Say what the table's words mean, and what it rests on."""
    ratio = found.ratio
    return (
        f"R = {ratio.value:.4f} [{ratio.low:.4f}, {ratio.high:.4f}], {found.about}.\n"
        "d ln R / d ln p: by how many percent R changes if p grows by 1 %; `per`: "
        "d ln R / dp of a p that is not positive. Numbers per axis are pitch, yaw, "
        "roll. The picture is fixed in display pixels. 95 % intervals over sessions, "
        f"given the head ({found.method}), each parameter on its own; `unclear` "
        "contains 0."
    )
