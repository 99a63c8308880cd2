"""The look of all tables, and how a value and its error are written in them."""

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich import box
from rich.table import Table

WORDS, READY = "{}", "{:s}"
INTERVAL = "{:.3f} [{:.3f}, {:.3f}]"
_PLAIN = str.maketrans({"±": "+-", "–": "-", "²": "^2", "×": "x", "°": " deg"})


def table(
    columns: Mapping[str, str],
    rows: Iterable[Sequence[Any] | None],
    *,
    bold: Iterable[bool] = (),
    fold: bool = False,
    no_wrap: bool = True,
    utf: bool = True,
    padding: tuple[int, ...] = (0, 1, 0, 0),
) -> Table:
    """Lay out rows of numbers and words.

    **Arguments:**

    - `columns`: each header and the format of its cells, for a number or a tuple of
      numbers. Columns of `WORDS` stand on the left, all others on the right.
    - `rows`: cells, those beyond the columns left out; a string stands as it is, None
      as a dash. None for a row begins a section.
    - `bold`: which rows stand out.
    - `fold`: whether the first column may be broken into lines.
    - `no_wrap`: whether the others may not.
    - `utf`: whether the terminal can show `±` and the like.
    """
    say = str if utf else plain
    found = Table(box=box.SIMPLE_HEAD, padding=padding, show_edge=False)
    for place, (header, template) in enumerate(columns.items()):
        look: dict[str, Any] = {"no_wrap": no_wrap or place == 0}
        if fold and place == 0:
            look = {"overflow": "fold", "min_width": 8}
        justify = "left" if template == WORDS else "right"
        found.add_column(say(header), justify=justify, **look)
    for row, is_bold in itertools.zip_longest(rows, bold, fillvalue=False):
        if not row:
            found.add_section()
            continue
        cells = zip(columns.values(), row, strict=False)
        shown = [_cell(template, value, say) for template, value in cells]
        found.add_row(*shown, style="bold" if is_bold else "")
    return found


def _cell(template: str, value: Any, say: Any) -> Any:
    if value is None:
        return "-"
    if isinstance(value, str):
        return say(value)
    if not isinstance(value, float | int | tuple):
        return value  # has a style of its own
    return say(template.format(*value if isinstance(value, tuple) else (value,)))


def plain(text: str) -> str:
    """Replace what an encoding other than Unicode cannot show."""
    return text.translate(_PLAIN)


def number(value: float, decimals: int) -> str:
    """Write a number, NaN as a dash."""
    if math.isnan(value):
        return "–"
    return "0" if value == 0 else f"{value:.{decimals}f}"


def with_error(value: float, half_width: float, decimals: int) -> str:
    """Write a value and the half-width of its interval, where it has one."""
    if math.isnan(value) or math.isnan(half_width) or half_width == 0:
        return number(value, decimals)
    return f"{value:.{decimals}f} ±{half_width:.{decimals}f}"
