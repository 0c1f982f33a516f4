"""Tables for people: columns by their headings, words to the left and numbers to the right.

The one place where text is lined up: printed results and the command line use it. Which unit a column has is said in
its heading.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from html import escape
from math import floor, isfinite, log10
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas
    from numpy.typing import ArrayLike

NONE = "-"  # what a cell says that has no number


def table(columns: Mapping[str, Iterable[object]]) -> str:
    """Columns by their headings, as wide as they need to be. Cells are what `str` makes of them: `decimals` and
    `digits` make them of numbers.

    >>> print(table({"route": ["a", "shortest"], "m": decimals([12.5, 9.0], 1)}))
    route        m
    a         12.5
    shortest   9.0
    """
    cells = [[heading, *map(str, column)] for heading, column in columns.items()]
    lined = [
        [cell.ljust(width) if words else cell.rjust(width) for cell in column]
        for column, width, words in ((c, max(map(len, c)), not any(map(_is_number, c[1:]))) for c in cells)
    ]
    return "\n".join("  ".join(line).rstrip() for line in zip(*lined, strict=True))


def decimals(values: Iterable[float], places: int) -> list[str]:
    """Numbers with so many decimal places.

    >>> decimals([1.234, float("inf")], 2)
    ['1.23', '-']
    """
    return [f"{value:.{places}f}" if isfinite(value) else NONE for value in values]


def numbers(rows: Iterable[Mapping[str, float]], places: int, *keys: str) -> dict[str, list[str]]:
    """Columns of a table from rows: ``length_m`` is headed "length m".

    >>> numbers([{"length_m": 2.0}], 1, "length_m")
    {'length m': ['2.0']}
    """
    known = list(rows)
    return {key.replace("_", " "): decimals([row[key] for row in known], places) for key in keys}


def digits(*columns: Iterable[float], count: int = 4) -> list[list[str]]:
    """Columns of one unit with as many decimals as the greatest number needs to show ``count`` digits, at least two.

    >>> digits([0.01234, 0.5], [0.1, 0.2])
    [['0.0123', '0.5000'], ['0.1000', '0.2000']]
    """
    known = [list(column) for column in columns]
    greatest = max((abs(value) for column in known for value in column if isfinite(value)), default=0.0)
    places = max(count - 1 - floor(log10(greatest)), 2) if greatest > 0 else 2
    return [decimals(column, places) for column in known]


def yes_no(values: Iterable[object]) -> list[str]:
    """Truth values in words."""
    return ["yes" if value else "no" for value in values]


def counted(number: int, noun: str) -> str:
    """A number with its noun.

    >>> counted(1, "beacon"), counted(3, "beacon")
    ('1 beacon', '3 beacons')
    """
    return f"{number} {noun}{'' if number == 1 else 's'}"


def html_table(columns: Mapping[str, Iterable[object]], caption: str = "") -> str:
    """The same columns for notebooks, with a caption above them.

    >>> html_table({"tag": ["A<1>"]}).count("&lt;")
    1
    """
    cells = [[str(cell) for cell in column] for column in columns.values()]
    sides = ["right" if any(map(_is_number, column)) else "left" for column in cells]
    head = "".join(f'<th style="text-align:{s}">{escape(h)}</th>' for s, h in zip(sides, columns, strict=True))
    lines = (
        "".join(f'<td style="text-align:{s}">{escape(c)}</td>' for s, c in zip(sides, line, strict=True))
        for line in zip(*cells, strict=True)
    )
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    above = f'<caption style="text-align:left">{escape(caption)}</caption>' if caption else ""
    return f"<table>{above}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def rows_of(columns: Mapping[str, ArrayLike]) -> list[dict[str, Any]]:
    """Arrays of one size, by name, as rows of plain numbers.

    >>> rows_of({"x_m": [1.0, 2.0], "y_m": [3.0, 4.0]})
    [{'x_m': 1.0, 'y_m': 3.0}, {'x_m': 2.0, 'y_m': 4.0}]
    """
    import numpy as np

    rows = zip(*(np.ravel(column).tolist() for column in columns.values()), strict=True)
    return [dict(zip(columns, row, strict=True)) for row in rows]


class Tabular(ABC):
    """What is rows for programs, and a table for people in print and in notebooks."""

    __slots__ = ()

    @abstractmethod
    def to_dicts(self) -> list[dict[str, Any]]:
        """Rows, for JSON."""

    @abstractmethod
    def columns(self) -> Mapping[str, Iterable[object]]:
        """What people read: headings and cells."""

    def words(self) -> str:
        """What is said beside the table."""
        return ""

    def to_pandas(self) -> pandas.DataFrame:
        """The rows as a DataFrame; ImportError says how to get pandas."""
        try:
            import pandas
        except ImportError as err:
            raise ImportError("to_pandas() needs pandas: pip install pandas") from err
        return pandas.DataFrame(self.to_dicts())

    def __str__(self) -> str:
        return f"{table(self.columns())}\n{self.words()}".rstrip("\n")

    def _repr_html_(self) -> str:
        return html_table(self.columns(), self.words())


@dataclass(frozen=True, kw_only=True)
class Rows(Tabular):
    """Things side by side, one row each."""

    rows: tuple[dict[str, Any], ...]  # values by names that say their units

    def columns(self) -> dict[str, Iterable[object]]:
        """What people read: headings and cells."""
        return {heading: [row[heading] for row in self.rows] for heading in (self.rows[0] if self.rows else ())}

    def to_dicts(self) -> list[dict[str, Any]]:
        """Copies of the rows, for JSON."""
        return [dict(row) for row in self.rows]


def _is_number(cell: str) -> bool:
    try:
        float(cell.rstrip("%").strip())
    except ValueError:
        return cell == NONE
    return True
