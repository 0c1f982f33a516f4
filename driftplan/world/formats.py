"""Formats of files: the name of a file tells which of a kind's formats it has, and that who reads and writes it.

Every kind of thing has one table of them, `FORMATS`, beside its `load_...`: a new format is a module and a line there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from driftplan.errors import MapError


class Format(NamedTuple):
    """One format of one kind of thing."""

    name: str
    suffixes: tuple[str, ...]
    read: Callable[..., Any]
    write: Callable[..., dict[Path, bytes]] | None = None
    options: tuple[str, ...] = ()  # that its reader takes and others may not
    cell_size_m: float | None = None  # of what is written, unless given; None: not made of cells


class Mark(NamedTuple):
    """A thing that stands somewhere: as files know beacons that say nothing of what is measured."""

    name: str
    x: float
    y: float
    facing_deg: float | None = None


def format_of(path: Path, formats: Sequence[Format], what: str) -> Format:
    """The first format whose suffix the name has.

    >>> format_of(Path("a.B.txt"), [Format("B", (".b.txt",), open), Format("text", (".txt",), open)], "a text").name
    'B'
    """
    for form in formats:
        if path.name.lower().endswith(form.suffixes):
            return form
    known = ", ".join(f"{' or '.join(form.suffixes)} ({form.name})" for form in formats)
    raise MapError(f"{path}: expected {what} called {known}, got {path.suffix or 'no suffix'}")


def own_options(path: Path, form: Format, formats: Sequence[Format], given: Mapping[str, Any]) -> dict[str, Any]:
    """Those of the options that were given (are not None); one that this format does not have is refused."""
    said = {name: value for name, value in given.items() if value is not None}
    for name in said:
        if name not in form.options:
            owners = " and ".join(other.name for other in formats if name in other.options)
            raise ValueError(f"{name} is for {owners} files: {path.name} is one of {form.name}")
    return said
