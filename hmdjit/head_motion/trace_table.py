"""Rows of a head trace's file before they are numbers; tables (CSV and its kin)."""

import math
import re
from collections.abc import Sequence
from typing import NamedTuple

from .trace_columns import used

Columns = Sequence[str] | None


class DamagedError(ValueError):
    """Rows that cannot be used, what is wrong with each, and their kind."""

    def __init__(self, found: dict[int, str], kind: str):
        super().__init__(found[min(found)])
        self.rows, self.kind = set(found), kind


class Table(NamedTuple):
    """Rows of fields between commas; which are used, time first; their names.

    - `places`: where each row is in the file, as `line 7`.
    - `broken`: what is wrong with rows that have other fields than the header's.
    """

    file: str
    lines: list[str]
    places: list[str]
    used: list[int]
    names: list[str]
    broken: dict[int, str]

    def field(self, row: int, column: int) -> str:
        """Text of a used column."""
        return self.lines[row].split(",")[self.used[column]].strip()

    def where(self, row: int, column: int) -> str:
        """Say where a used column's field is in the file."""
        return f"{self.file}, {self.places[row]}, column {self.names[column]}"

    def without(self, rows: set[int]) -> "Table":
        """Leave rows out."""
        kept = [row for row in range(len(self.lines)) if row not in rows]
        return self._replace(
            lines=[self.lines[row] for row in kept],
            places=[self.places[row] for row in kept],
            broken={i: self.broken[r] for i, r in enumerate(kept) if r in self.broken},
        )


def parsed(file: str, lines: list[str], start: int, columns: Columns) -> Table:
    """Find the header, or take `columns` for it, and compare the rows' lengths."""
    lines = _with_commas(lines, start, columns)
    is_number = [is_finite(field) for field in lines[start].split(",")]
    header, where = start, f"{file}, option columns"
    if not columns:
        header -= start > 0 and all(is_number)  # `numpy.savetxt` comments it out
        columns = re.sub(r"^\s*#[#, ]*", "", lines[header]).split(",")
        where = f"{file}, line {header + 1}"
    names = [" ".join(name.split()) for name in columns]
    places = used(names, where)
    if header == start:
        header -= any(is_number[i] for i in places if i < len(is_number))
    rows = lines[header + 1 :]
    broken = {
        row: f"{file}, line {header + 2 + row}: must have {len(names)} fields like the "
        f"header, got {line.count(',') + 1}."
        for row, line in enumerate(rows)
        if line.count(",") != len(names) - 1
    }
    numbered = [f"line {row}" for row in range(header + 2, len(lines) + 1)]
    return Table(file, rows, numbered, places, [names[i] for i in places], broken)


def _with_commas(lines: list[str], start: int, columns: Columns) -> list[str]:
    """Put commas between fields, points into numbers, and take quotes off."""
    lines = [_unquoted(line) if '"' in line else line for line in lines]
    signs = [sign for sign in ";\t," if sign in lines[start]]
    if columns:  # numbers may hold decimal commas, so their count decides
        fit = lambda sign: len(lines[start].split(sign)) == len(columns)
        signs = [*filter(fit, [*signs, None]), *signs]
    separator = signs[0] if signs else None
    if separator == ",":
        return lines
    return [",".join(line.replace(",", ".").split(separator)) for line in lines]


def _unquoted(line: str) -> str:
    """Take the quotes off, and make what they protect neither separator nor comma."""
    plain = lambda match: re.sub(r"[;\s]", "_", match[1].strip()).replace(",", ".")
    return re.sub(r'"([^"]*)"', plain, line)


def is_finite(field: str) -> bool:
    """Whether a field is a finite number."""
    try:  # Python alone reads `1_000` and digits of other scripts as numbers.
        return "_" not in field and field.isascii() and math.isfinite(float(field))
    except ValueError:
        return False
