"""The style of all tables, and how a value and its error are written in them."""

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from rich import box
from rich.table import Table
from rich.text import Text

WORDS, READY = "{}", "{:s}"
INTERVAL = "{:.3f} [{:.3f}, {:.3f}]"
_PLAIN = str.maketrans({"±": "+-", "–": "-", "²": "^2", "×": "x", "°": " deg"})
_PLAIN |= str.maketrans({"•": "*", "…": "...", "†": "+", "‡": "++", "’": "'"})


def table(
    columns: Mapping[str, str],
    rows: Iterable[Sequence[Any] | None],
    *,
    bold: Iterable[bool] = (),
    fold: bool = False,
    no_wrap: bool = True,
    utf: bool = True,
    padding: tuple[int, int] | tuple[int, int, int, int] = (0, 1, 0, 0),
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
        style: dict[str, Any] = {"no_wrap": no_wrap or place == 0}
        if fold and place == 0:
            style = {"overflow": "fold", "min_width": 8}
        justify = "left" if template == WORDS else "right"
        found.add_column(say(header), justify=justify, **style)
    styles = itertools.chain(bold, itertools.repeat(False))
    for row, is_bold in zip(rows, styles, strict=False):
        if row is None:
            found.add_section()
            continue
        cells = zip(columns.values(), row, strict=False)
        shown = [_cell(template, value, say) for template, value in cells]
        found.add_row(*shown, style="bold" if is_bold else "")
    return found


def _cell(template: str, value: Any, say: Callable[[str], str]) -> str | Text:
    if isinstance(value, Text):  # has a style of its own
        return value
    if value is None or isinstance(value, str):
        return "-" if value is None else say(value)
    return say(template.format(*value if isinstance(value, tuple) else (value,)))


def plain(text: str) -> str:
    """Replace what an encoding other than Unicode cannot show."""
    return text.translate(_PLAIN)


def spelled(error: UnicodeError) -> tuple[str, int]:
    """Spell what an encoding has no letter for: an error handler of `codecs`."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = plain(error.object[error.start : error.end])
    return text.encode("ascii", "backslashreplace").decode("ascii"), error.end


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


def with_errors(values: Sequence[float], half_widths: Sequence[float]) -> list[str]:
    """Write a column of values and half-widths, to as many digits as these warrant."""
    places = decimals(half_widths)
    pairs = zip(values, half_widths, strict=True)
    return [with_error(value, half_width, places) for value, half_width in pairs]


def decimals(half_widths: Sequence[float]) -> int:
    """Decimals that give a typical half-width of a column two digits."""
    positive = [half_width for half_width in half_widths if half_width > 0]
    if not positive:
        return 3
    return min(4, max(0, 1 - math.floor(math.log10(np.median(positive)))))
