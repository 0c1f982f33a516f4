"""Tables of numbers from recordings: text with or without a header, plain or gzipped, and MATLAB 5 files."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import numpy as np

from driftplan.arrays import Bools, Floats, Ints
from driftplan.errors import TrajectoryError, naming
from driftplan.files import read_bytes, read_lines

_MAX_NUMBERS = 50_000_000
_NUMBERS_BEGIN = tuple("-0123456789")
_SAID_SHARE = 0.01  # of the rows: as many unusable ones are told,
MAX_DROPPED_SHARE = 0.2  # and more than so many refused
_UNITS_BY_SIZE: Mapping[float, Sequence[str]] = {
    1.0: ("", "-", "1", "s", "sec", "secs", "second", "seconds", "m", "metre", "metres", "meter", "meters"),
    60.0: ("min",),
    1e-3: ("ms", "msec", "mm"),
    1e-6: ("us", "usec", "µs", "um"),
    1e-9: ("ns", "nsec"),
    1e-2: ("cm",),
    1e3: ("km",),
    0.0254: ("in", "inch"),
    0.3048: ("ft", "feet"),
    np.pi / 180: ("deg", "degree", "degrees", "°"),
    2 * np.pi: ("rev", "turns"),
}
# from one mark to the next, never giving back: the time grows with the length of the line, whatever stands in it
_NAME_AND_UNIT = re.compile(r"(?<![^\[\],;])([^\[\],;]*+)\[([^\[\]]*+)\]")
_LENGTHS_AND_ANGLES = {unit: size for size, units in _UNITS_BY_SIZE.items() for unit in units}
UNITS = {
    **_LENGTHS_AND_ANGLES,
    **dict.fromkeys(("rad", "radian", "radians", "m/s", "rad/s", "mps"), 1.0),
    **{f"{unit}/s": _LENGTHS_AND_ANGLES[unit] for unit in ("mm", "cm", "km", "ft", "in", "deg", "degrees", "°", "rev")},
    "mrad": 1e-3,
    "mrad/s": 1e-3,
    "km/h": 1 / 3.6,
    "kmh": 1 / 3.6,
    "kph": 1 / 3.6,
    "mph": 0.44704,
    "rpm": 2 * np.pi / 60,
}


class Table(NamedTuple):
    """What a file holds."""

    values: Floats  # (n, k), in the file's units, see `named`
    names: tuple[str, ...] | None  # what the columns are called
    units: tuple[str, ...] | None = None  # and measured in, where the file says so
    names_are_a_comment: bool = False  # and so, perhaps, not names at all
    lines: Ints = np.zeros(0, dtype=int)  # (n,), which line of the file each row stands in, from 1
    notes: tuple[str, ...] = ()  # what was left out
    text: tuple[int, ...] = ()  # which columns of the file hold no numbers, and were left out


def read_table(
    path: str | os.PathLike[str], variable: str | None = None, *, min_rows: int = 2, recording: bool = False
) -> Table:
    """The numbers of one file.

    Parameters
    ----------
    path :
        ``.mat`` (MATLAB up to 7.2) or text: columns separated by blanks, tabs, commas or semicolons; gzipped if it ends
        in ``.gz``. Lines that begin with ``#`` or ``%`` are comments. Names of columns are taken from a first line that
        is not numbers, or from the last comment before the numbers if it names as many columns, as in
        ``# Time [s]  x [m]  y [m]``. Units stand in brackets.
    variable : name of the array in a MATLAB file
    recording : whether columns of text are left out, and up to a fifth of the rows where a value is missing or not
        finite, as exports of recordings have them. Otherwise these are refused.

    Raises TrajectoryError if the file cannot be read: the message names it, and the line or variable.
    """
    file = Path(path)
    with naming(file, TrajectoryError):
        if file.suffix.lower() == ".mat":
            values = _matlab(file, variable)
            table = Table(values, None, lines=np.arange(1, len(values) + 1))
        else:
            table = _text(file, recording)
    if not np.isfinite(table.values).all():
        raise TrajectoryError(f"{file}: expected finite numbers, got {table.values[~np.isfinite(table.values)][0]}")
    if len(table.values) < min_rows:
        raise TrajectoryError(f"{file}: expected at least {min_rows} rows of numbers, got {len(table.values)}")
    return table


def named(file: Path, table: Table, aliases: Mapping[str, Sequence[str]]) -> dict[str, Floats]:
    """Columns in SI units by the names in ``aliases`` under which the file's names for them are listed: as they are,
    else by their last words, as in ``pose.pose.position.x``.

    Raises TrajectoryError where a column has a unit that is not in `UNITS`: it lists them.
    """
    found = {}
    for name, k in columns_of(table.names or (), aliases).items():
        unit = table.units[k] if table.units else ""
        if unit not in UNITS:
            called = f" of column {table.names[k]!r}" if table.names else ""
            raise TrajectoryError(f"{file}: unknown unit [{unit}]{called}; known: {', '.join(filter(None, UNITS))}")
        found[name] = table.values[:, k] * UNITS[unit]
    return found


def columns_of(names: Sequence[str], aliases: Mapping[str, Sequence[str]]) -> dict[str, int]:
    """Which column each of the ``aliases`` stands for; the first where several do."""
    found: dict[str, int] = {}
    for wanted, others in aliases.items():
        exact = [k for k, name in enumerate(names) if name == wanted or name in others]
        # one word says too little: `covariance_x` is no x
        tails = tuple(f"_{other}" for other in others if "_" in other or other in ("stamp", "yaw"))
        candidates = [*exact, *(k for k, name in enumerate(names) if name.endswith(tails))]
        if candidates:
            found[wanted] = candidates[0]
    return found


def _matlab(file: Path, variable: str | None) -> Floats:
    from scipy.io import loadmat, whosmat

    content = BytesIO(read_bytes(file, TrajectoryError))
    try:
        held = {name: (shape, kind) for name, shape, kind in whosmat(content)}
        listed = ", ".join(f"{name} {'x'.join(map(str, shape))}" for name, (shape, _) in held.items()) or "nothing"
        if variable is None:
            raise TrajectoryError(f"{file}: say which variable of the MATLAB file to read; it holds {listed}")
        if variable not in held:
            raise TrajectoryError(f"{file}: expected a variable {variable!r}, found {listed}")
        shape, kind = held[variable]
        if len(shape) != 2 or kind in ("struct", "cell", "object", "char", "sparse", "function", "opaque", "unknown"):
            what = f"variable {variable!r} to be a matrix of numbers"
            raise TrajectoryError(f"{file}: expected {what}, got {kind} {shape}")
        if int(np.prod(shape)) > _MAX_NUMBERS:
            raise TrajectoryError(f"{file}: variable {variable!r} claims {shape} numbers, more than any recording")
        values = np.asarray(loadmat(content, variable_names=[variable])[variable], dtype=float)
    except NotImplementedError:
        raise TrajectoryError(f"{file}: a MATLAB 7.3 (HDF5) file: save it again with -v7, or as CSV") from None
    except (TrajectoryError, OSError):
        raise
    except Exception as err:  # scipy raises whatever a broken file leads it into
        raise TrajectoryError(f"{file}: not a readable MATLAB file ({type(err).__name__}: {err})") from err
    return values


def _text(file: Path, recording: bool) -> Table:
    lines = read_lines(file, TrajectoryError)
    first = next((k for k, line in enumerate(lines) if not _is_comment(line)), None)
    if first is None:
        raise TrajectoryError(f"{file}: expected lines of numbers, found none")
    header = None
    cells = _fields(lines[first])
    if not any(map(_is_number, cells)) if recording else not all(map(_is_number, cells)):
        header, first = lines[first], first + 1
    rows = [k for k in range(first, len(lines)) if lines[k][:1] in _NUMBERS_BEGIN or not _is_comment(lines[k])]
    if not rows:
        raise TrajectoryError(f"{file}: expected lines of numbers, found none after the header")
    cells = _fields(lines[rows[0]], all_cells=True)
    all_cells = recording and header is not None and len(cells) == len(_fields(header, all_cells=True))
    if not all_cells:
        cells = _fields(lines[rows[0]])
    width = len(cells)
    kept = [k for k, cell in enumerate(cells) if not recording or not cell or _is_number(cell)]
    values = _numbers(file, lines, rows, width, kept, recording, all_cells)
    if header is not None:
        pairs = _names(header, width, all_cells=all_cells)
        if pairs is None:
            raise TrajectoryError(f"{file}: expected a header of {width} names, got {header.strip()[:80]!r}")
    else:
        comments = [line for line in lines[: rows[0]] if line.strip()]
        pairs = _names(comments[-1].strip().lstrip("#% "), width) if comments else None
    names, units = (None if pairs is None else tuple(pairs[k][part] for k in kept) for part in (0, 1))
    text, is_a_comment = tuple(sorted(set(range(width)) - set(kept))), pairs is not None and header is None
    table = Table(values, names, units, is_a_comment, np.array(rows) + 1, text=text)
    return _without_missing(file, table) if recording else table


def _without_missing(file: Path, table: Table) -> Table:
    """The table without columns that are mostly empty (where names say which are left), and without rows in which a
    value is missing."""
    missing = ~np.isfinite(table.values)
    if table.names is not None and missing.any():
        full = np.flatnonzero(missing.mean(axis=0) <= MAX_DROPPED_SHARE)
        names, units = (tuple(words[k] for k in full) for words in (table.names, table.units or table.names))
        table = table._replace(values=table.values[:, full], names=names, units=units)
        missing = missing[:, full]
    bad: Bools = np.asarray(missing.any(axis=1))
    if not bad.any():
        return table
    line = int(table.lines[bad][0])
    if bad.mean() > MAX_DROPPED_SHARE:
        row = table.values[bad][0].tolist()
        where = f"{file}, line {line}"
        raise TrajectoryError(f"{where}: expected finite numbers, got {row}, and in {bad.sum()} lines in all")
    told = f"{bad.sum()} of {len(bad)} rows, the first in line {line}, miss a number, and were left out"
    notes = (*table.notes, told) if bad.mean() > _SAID_SHARE else table.notes
    return table._replace(values=table.values[~bad], lines=table.lines[~bad], notes=notes)


def _numbers(
    file: Path, lines: list[str], rows: list[int], width: int, kept: list[int], recording: bool, all_cells: bool
) -> Floats:
    """The numbers of some columns of some lines, (n, k): fast where all lines are alike, else line by line."""
    separator = next((mark for mark in ",;" if mark in lines[rows[0]]), None)
    # loadtxt takes no notice of columns that it was not asked for
    alike = (lines[k].count(separator) + 1 if separator else len(lines[k].split()) for k in rows)
    if all(columns == width for columns in alike):
        try:
            values = np.loadtxt((lines[k] for k in rows), float, None, separator, usecols=kept, ndmin=2)
        except ValueError:
            values = np.full((1, 1), np.nan)
        if np.isfinite(values).all():
            return values
    values = np.empty((len(rows), len(kept)))
    for row, k in enumerate(rows):
        cells = _fields(lines[k], all_cells=all_cells)
        if len(cells) != width:
            raise TrajectoryError(f"{file}, line {k + 1}: expected {width} columns, got {len(cells)}")
        if "," in lines[k] and ";" in lines[k]:
            raise TrajectoryError(
                f"{file}, line {k + 1}: comma and semicolon in one line can be read in two ways, got "
                f"{lines[k].strip()[:60]!r}: write decimal points, and one kind of separator"
            )
        try:
            values[row] = [float(cells[c]) if cells[c] or not recording else np.nan for c in kept]
        except ValueError:
            raise TrajectoryError(f"{file}, line {k + 1}: expected numbers, got {' '.join(cells)[:60]!r}") from None
        if not recording and not np.isfinite(values[row]).all():
            raise TrajectoryError(f"{file}, line {k + 1}: expected finite numbers, got {values[row].tolist()}")
    return values


def _fields(line: str, *, all_cells: bool = False) -> list[str]:
    """The cells of a line, without empty ones at its end unless all are wanted."""
    if "," in line or ";" in line:
        return [field.strip() for field in re.split("[,;]", line.strip() if all_cells else line.strip().rstrip(",;"))]
    return line.split()


def _names(header: str, width: int, *, all_cells: bool = False) -> list[tuple[str, str]] | None:
    """(name, unit) of every column, if the header has as many."""
    pairs = [(name.strip(" \t#%"), unit) for name, unit in _NAME_AND_UNIT.findall(header) if name.strip(" \t#%")]
    if len(pairs) != width:
        fields = _fields(header.lstrip("#% "), all_cells=all_cells)
        if len(fields) != width or all(map(_is_number, fields)):
            return None
        return [name_and_unit(field) for field in fields]
    return [name_and_unit(f"{name}[{unit}]") for name, unit in pairs]


def name_and_unit(field: str) -> tuple[str, str]:
    """Name and unit of a column, in small letters.

    >>> name_and_unit("Pose.Position.X [mm]")
    ('pose_position_x', 'mm')
    """
    name, bracket, unit = field.strip().strip("\"'").partition("[")
    if unit.find("]") == len(unit) - 1:
        unit = unit[:-1].strip().lower()
    else:
        name, unit = name + bracket + unit, ""
    return re.sub(r"\W+", "_", name.strip().strip("\"'").lower()).strip("_"), unit


def _is_comment(line: str) -> bool:
    return not line.strip() or line.lstrip().startswith(("#", "%"))


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
