"""The style of all tables, and how a value and its error are written in them."""

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from rich import box
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions
from rich.table import Table
from rich.text import Text

Say = Callable[[str], str]
WORDS, READY = "{}", "{:s}"
_FOLDED, _LEAST = 14, 4  # characters of a first column that is broken into lines
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
    say: Say = str,
    padding: tuple[int, int] | tuple[int, int, int, int] = (0, 1, 0, 0),
) -> "Continued":
    """Lay out rows of numbers and words.

    **Arguments:**

    - `columns`: each header and the format of its cells, for a number or a tuple of
      numbers. Columns of `WORDS` stand on the left, all others on the right.
    - `rows`: cells, those beyond the columns left out; a string stands as it is, None
      as a dash. None for a row begins a section.
    - `bold`: which rows stand out.
    - `fold`: whether the first column may be broken into lines.
    - `no_wrap`: whether the others' headers may not.
    - `say`: how the terminal shows a text, as `spelling` finds it.
    """
    shown: list[tuple[list[str | Text], str] | None] = []
    styles = itertools.chain(bold, itertools.repeat(False))
    for row, is_bold in zip(rows, styles, strict=False):
        cells = zip(columns.values(), row or (), strict=False)
        look = "bold" if is_bold else ""
        shown.append(
            None if row is None else ([_cell(*one, say) for one in cells], look)
        )
    sides = ["left" if template == WORDS else "right" for template in columns.values()]
    return Continued([*map(say, columns)], sides, shown, fold, no_wrap, padding)


@dataclasses.dataclass(frozen=True)
class Continued:
    """A table; columns that a terminal is too narrow for stand in a further one.

    The words on the left are repeated. No number is cut.
    """

    columns: list[str]
    sides: list[Any]
    rows: list[tuple[list[str | Text], str] | None]
    fold: bool
    no_wrap: bool
    padding: Any

    def __rich_console__(
        self, console: Console, options: ConsoleOptions
    ) -> Iterator[Table | str]:
        """Show as many columns at once as fit, in one table or several."""
        room, wide = options.max_width, options.update(width=10**5)
        places = list(range(len(self.columns)))
        keys = [*itertools.takewhile(lambda k: self.sides[k] == "left", places)]
        keys = keys if len(keys) < len(places) else places[:1]
        width = lambda table: console.measure(table, options=wide).maximum
        needs = [self._need(k) for k in places]
        left = places[len(keys) :]
        while True:
            count = len(left)
            chosen = [*keys, *left[:count]]
            while count > 1 and width(self._table(chosen, needs)) > room:
                count -= 1
                chosen = [*keys, *left[:count]]
            whole = self._table(chosen)
            if width(whole) > room:
                spare = room - width(self._table(chosen, needs))
                least = [max(_LEAST, needs[0] + spare), *needs[1:]]
                whole = self._table(chosen, least)
            yield whole
            left = left[count:]
            if not left:
                return
            yield ""

    def _need(self, k: int) -> int:
        """Characters that a column needs: its cells whole, headers in words."""
        apart = str.splitlines if self.no_wrap else str.split
        headers = apart(self.columns[k]) or [""]
        cells = [str(row[0][k]) for row in self.rows if row and k < len(row[0])]
        need = max(map(cell_len, [*headers, *cells]))
        return min(need, _FOLDED) if k == 0 and self.fold else need

    def _table(self, chosen: list[int], widths: list[int] | None = None) -> Table:
        found = Table(box=box.SIMPLE_HEAD, padding=self.padding, show_edge=False)
        for k in chosen:
            found.add_column(
                self.columns[k],
                justify=self.sides[k],
                overflow="fold",
                no_wrap=widths is None and not (k == 0 and self.fold),
                width=None if widths is None else widths[k],
            )
        for row in self.rows:
            if row is None:
                found.add_section()
            else:
                cells, style = row
                found.add_row(
                    *(cells[k] for k in chosen if k < len(cells)), style=style
                )
        return found


def _cell(template: str, value: Any, say: Say) -> str | Text:
    if isinstance(value, Text):  # has a style of its own
        return value
    if value is None or isinstance(value, str):
        return "-" if value is None else say(value)
    return say(template.format(*value if isinstance(value, tuple) else (value,)))


def spelling(console: Console) -> Say:
    """How a terminal shows a text: letter by letter, or in those that it has."""
    encoding = console.encoding
    return str if encoding.lower().startswith("utf") else lambda x: plain(x, encoding)


def plain(text: str, encoding: str = "ascii") -> str:
    """Spell what an encoding other than Unicode may not have a letter for."""
    spelled_out = text.translate(_PLAIN).encode(encoding, "backslashreplace")
    return spelled_out.decode(encoding)


def spelled(error: UnicodeError) -> tuple[str, int]:
    """Spell what an encoding has no letter for: an error handler of `codecs`."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return plain(error.object[error.start : error.end]), error.end


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
