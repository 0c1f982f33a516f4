"""Tables of numbers from recordings: text with or without a header, plain or gzipped, and MATLAB 5 files."""

from __future__ import annotations

import gzip
import os
import re
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from driftplan.arrays import Floats
from driftplan.errors import TrajectoryError

_MOST_BYTES = 128 << 20  # of text, unpacked: a million steps take half of it
_BLOCK = 20_000  # lines
_MOST_NUMBERS = 200_000_000
_UNITS = {
    "ns": 1e-9,
    "us": 1e-6,
    "ms": 1e-3,
    "cm": 1e-2,
    "mm": 1e-3,
    "km": 1e3,
    "deg": np.pi / 180,
    "deg/s": np.pi / 180,
}


class Table(NamedTuple):
    """Values (n, k) in SI units, and what the columns are called where the file says so."""

    values: Floats
    names: tuple[str, ...] | None
    names_are_a_comment: bool = False  # and so, perhaps, not names at all


def read_table(path: str | os.PathLike[str], variable: str | None = None) -> Table:
    """The numbers of one file.

    Parameters
    ----------
    path :
        ``.mat`` (MATLAB up to 7.2) or text: columns separated by blanks, tabs, commas or semicolons; gzipped if it ends
        in ``.gz``. Lines that begin with ``#`` or ``%`` are comments. Names of columns are taken from a first line that
        is not numbers, or from the last comment before the numbers if it names as many columns, as in
        ``# Time [s]  x [m]  y [m]``. Units ns, us, ms, mm, cm, km, deg, deg/s in brackets are converted to SI.
    variable : str, optional
        Name of the array in a MATLAB file.

    Raises
    ------
    TrajectoryError
        If the file cannot be read: the message names it, and the line or variable.
    """
    file = Path(path)
    try:
        if file.suffix.lower() == ".mat":
            return Table(_matlab(file, variable), None)
        return _text(file)
    except OSError as err:
        reason = err.strerror or err
        raise TrajectoryError(f"{file}: {reason}") from err


def named(table: Table, aliases: Mapping[str, Sequence[str]]) -> dict[str, Floats]:
    """Columns by the names in ``aliases`` under which the file's names for them are listed."""
    found: dict[str, Floats] = {}
    for k, name in enumerate(table.names or ()):
        for wanted, others in aliases.items():
            if wanted not in found and (name == wanted or name in others):
                found[wanted] = table.values[:, k]
    return found


def _matlab(file: Path, variable: str | None) -> Floats:
    from scipy.io import loadmat, whosmat

    try:
        held = {name: (shape, kind) for name, shape, kind in whosmat(file)}
        listed = ", ".join(f"{name} {'x'.join(map(str, shape))}" for name, (shape, _) in held.items()) or "nothing"
        if variable is None:
            raise TrajectoryError(f"{file}: say which variable of the MATLAB file to read; it holds {listed}")
        if variable not in held:
            raise TrajectoryError(f"{file}: expected a variable {variable!r}, found {listed}")
        shape, kind = held[variable]
        if len(shape) != 2 or kind in ("struct", "cell", "object", "char", "sparse", "function", "opaque", "unknown"):
            raise TrajectoryError(
                f"{file}: expected variable {variable!r} to be a matrix of numbers, got {kind} {shape}"
            )
        if int(np.prod(shape)) > _MOST_NUMBERS:
            raise TrajectoryError(f"{file}: variable {variable!r} claims {shape} numbers, more than any recording")
        values = np.asarray(loadmat(file, variable_names=[variable])[variable], dtype=float)
    except NotImplementedError:
        raise TrajectoryError(f"{file}: a MATLAB 7.3 (HDF5) file: save it again with -v7, or as CSV") from None
    except (TrajectoryError, OSError):
        raise
    except Exception as err:  # scipy raises whatever a broken file leads it into
        raise TrajectoryError(f"{file}: not a readable MATLAB file ({type(err).__name__}: {err})") from err
    _check_rows(file, values)
    return values


def _text(file: Path) -> Table:
    lines = _lines(file)
    first = next((k for k, line in enumerate(lines) if not _is_comment(line)), None)
    if first is None:
        raise TrajectoryError(f"{file}: expected lines of numbers, found none")
    header = None
    if not _are_numbers(_fields(lines[first])):
        header, first = lines[first], first + 1
    values = _numbers(file, lines, first)
    _check_rows(file, values)
    if header is not None:
        names = _names(header, values.shape[1])
        if names is None:
            raise TrajectoryError(f"{file}: expected a header of {values.shape[1]} names, got {header.strip()[:80]!r}")
    else:
        comments = [line for line in lines[:first] if line.strip()]
        names = _names(comments[-1].strip().lstrip("#% "), values.shape[1]) if comments else None
    if names is None:
        return Table(values, None)
    scale = np.array([_UNITS.get(unit, 1.0) for _, unit in names])
    return Table(values * scale, tuple(name for name, _ in names), names_are_a_comment=header is None)


def _numbers(file: Path, lines: list[str], first: int) -> Floats:
    """The numbers of all lines from ``first`` on, (n, width); block by block, since text takes much room."""
    parts: list[Floats] = []
    width = 0
    for begin in range(first, len(lines), _BLOCK):
        block = [
            (k, line) for k, line in enumerate(lines[begin : begin + _BLOCK], start=begin + 1) if not _is_comment(line)
        ]
        rows = [_fields(line) for _, line in block]
        width = width or (len(rows[0]) if rows else 0)
        for (number, _), row in zip(block, rows, strict=True):
            if len(row) != width:
                raise TrajectoryError(f"{file}, line {number}: expected {width} columns, got {len(row)}")
        try:
            values = np.array(rows, dtype=float).reshape(-1, width)
        except ValueError:
            number, row = next((n, row) for (n, _), row in zip(block, rows, strict=True) if not _are_numbers(row))
            raise TrajectoryError(f"{file}, line {number}: expected numbers, got {' '.join(row)[:60]!r}") from None
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if bad.size:
            number = block[bad[0]][0]
            raise TrajectoryError(f"{file}, line {number}: expected finite numbers, got {values[bad[0]].tolist()}")
        parts.append(values)
    if not sum(map(len, parts)):
        raise TrajectoryError(f"{file}: expected lines of numbers, found none after the header")
    return np.concatenate(parts)


def _lines(file: Path) -> list[str]:
    with file.open("rb") as stream:
        try:
            text = gzip.GzipFile(fileobj=stream) if file.suffix.lower() == ".gz" else stream
            raw = text.read(_MOST_BYTES + 1)
        except (gzip.BadGzipFile, zlib.error, EOFError) as err:
            raise TrajectoryError(f"{file}: broken gzip file ({err})") from err
    if len(raw) > _MOST_BYTES:
        raise TrajectoryError(f"{file}: more than {_MOST_BYTES >> 20} MB of text, more than any recording")
    if b"\x00" in raw[:4096]:
        raise TrajectoryError(f"{file}: expected text, found binary data")
    try:
        return raw.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as err:
        raise TrajectoryError(f"{file}: expected text, found binary data at byte {err.start}") from None


def _fields(line: str) -> list[str]:
    if "," in line or ";" in line:
        return [field.strip() for field in re.split("[,;]", line.strip().rstrip(",;"))]
    return line.split()


def _names(header: str, width: int) -> list[tuple[str, str]] | None:
    """(name, unit) of every column, if the header has as many."""
    pairs = re.findall(r"([A-Za-z_][^\[\],;]*?)\s*\[([^\]]*)\]", header)
    if len(pairs) != width:
        fields = _fields(header.lstrip("#% "))
        if len(fields) != width or _are_numbers(fields):
            return None
        pairs = [_name_and_unit(field) for field in fields]
    return [
        (re.sub(r"\W+", "_", name.strip().strip("\"'").lower()).strip("_"), unit.strip().lower())
        for name, unit in pairs
    ]


def _name_and_unit(field: str) -> tuple[str, str]:
    match = re.fullmatch(r"(.*?)\s*\[([^\]]*)\]", field)
    return (match[1], match[2]) if match else (field, "")


def _is_comment(line: str) -> bool:
    return not line.strip() or line.lstrip().startswith(("#", "%"))


def _are_numbers(fields: list[str]) -> bool:
    try:
        for field in fields:
            float(field)
    except ValueError:
        return False
    return True


def _check_rows(file: Path, values: Floats) -> None:
    if not np.isfinite(values).all():
        raise TrajectoryError(f"{file}: expected finite numbers, got {values[~np.isfinite(values)][0]}")
    if len(values) < 2:
        raise TrajectoryError(f"{file}: expected at least 2 rows of numbers, got {len(values)}")
