"""Tables for people: columns by their headings, words to the left and numbers to the right.

The one place where text is lined up: printed results and the command line use it. Which unit a column has is said in
its heading.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import floor, isfinite, log10

NONE = "-"  # what a cell says that has no number


def table(columns: Mapping[str, Iterable[object]]) -> str:
    """Columns as wide as they need to be.

    Parameters
    ----------
    columns : mapping of heading to cells
        Cells are what `str` makes of them: `decimals` and `digits` make them of numbers.

    Examples
    --------
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

    Examples
    --------
    >>> decimals([1.234, float("inf")], 2)
    ['1.23', '-']
    """
    return [f"{value:.{places}f}" if isfinite(value) else NONE for value in values]


def numbers(rows: Iterable[Mapping[str, float]], places: int, *keys: str) -> dict[str, list[str]]:
    """Columns of a table from rows: ``length_m`` is headed "length m".

    Examples
    --------
    >>> numbers([{"length_m": 2.0}], 1, "length_m")
    {'length m': ['2.0']}
    """
    known = list(rows)
    return {key.replace("_", " "): decimals([row[key] for row in known], places) for key in keys}


def digits(*columns: Iterable[float], count: int = 4) -> list[list[str]]:
    """Columns of one unit with as many decimals as the greatest number needs to show ``count`` digits, at least two.

    Examples
    --------
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

    Examples
    --------
    >>> counted(1, "beacon"), counted(3, "beacon")
    ('1 beacon', '3 beacons')
    """
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _is_number(cell: str) -> bool:
    try:
        float(cell.rstrip("%").strip())
    except ValueError:
        return cell == NONE
    return True
