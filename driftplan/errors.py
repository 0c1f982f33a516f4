"""Exceptions driftplan raises on purpose, one per thing a caller can do about it.

A bad argument is a plain `ValueError`. What follows is for worlds, files and problems that say no.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

_MAX_MESSAGE = 800  # characters: a file may hold any text where something short is expected


class DriftplanError(Exception):
    """Root of the exceptions below, so that a script can catch them all."""


class _FileError(DriftplanError, ValueError):
    def __init__(self, message: str):
        long = len(message) > _MAX_MESSAGE
        super().__init__(f"{message[:_MAX_MESSAGE]} ... ({len(message)} characters)" if long else message)


class MapError(_FileError):
    """A map file cannot be read: the message names the file and the line or key at fault."""


class TrajectoryError(_FileError):
    """A trajectory or path file cannot be read: the message names the file and the line."""


class StudyError(_FileError):
    """A study cannot be used: the message names the file, the line and the key at fault."""


class StartError(DriftplanError):
    """The start is not in free space: the message names the nearest point that is."""


class GoalError(DriftplanError):
    """The goal is not in free space: the message names the nearest point that is."""


class NoPathError(DriftplanError):
    """No collision-free route leads from start to goal: the message says how far the start can reach."""


class PlannerError(DriftplanError, ValueError):
    """The planner cannot minimise drift, or is unknown: the message says why and which ones can."""


class Stretch(NamedTuple):
    """Part of a route, by its number: metres driven."""

    route: int
    from_m: float
    to_m: float


class InfeasibleError(DriftplanError):
    """No layout or itinerary keeps the limit: the message says where and by how much it fails.

    ``stretch`` is where, if that is one part of a route of `place_beacons`; else None.
    """

    def __init__(self, message: str, stretch: Stretch | None = None):
        super().__init__(message)
        self.stretch = stretch


class ArgumentError(DriftplanError, TypeError, ValueError):
    """An argument is an object of another kind: the message says which kind was expected."""


class KeywordError(ArgumentError):
    """A function has no such keyword: the message names the nearest that it has."""


@contextmanager
def naming(place: object, error: type[MapError] | type[TrajectoryError] | type[StudyError]) -> Iterator[None]:
    """What is refused inside is an ``error`` that names the place: a file, or a part of one."""
    try:
        yield
    except error:
        raise
    except OSError as err:
        raise error(f"{place}: cannot be read: {err.strerror or err}") from err
    except (ValueError, TypeError, OverflowError) as err:
        raise error(f"{place}: {err}") from err
