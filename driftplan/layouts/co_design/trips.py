"""Trips: drives that are made again and again, in Python or from a text file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from driftplan.arrays import positive
from driftplan.errors import TrajectoryError
from driftplan.world.log_tables import read_table

_COLUMNS = ("start_x", "start_y", "goal_x", "goal_y", "weight")
_NAMED = "start_x, start_y, goal_x, goal_y and perhaps weight"


@dataclass(frozen=True, slots=True)
class Trip:
    """A drive from start to goal, metres, and how often it is driven.

    Examples
    --------
    >>> Trip((2, 5), (58, 5), weight=20, name="dock to press").weight
    20.0
    """

    start: tuple[float, float]
    goal: tuple[float, float]
    weight: float = 1.0
    name: str = ""

    def __post_init__(self) -> None:
        for end in ("start", "goal"):
            place = np.asarray(getattr(self, end), dtype=float)
            if place.shape != (2,) or not np.isfinite(place).all():
                raise ValueError(f"expected {end} (x, y) in metres, finite, got {getattr(self, end)!r}")
            object.__setattr__(self, end, (float(place[0]), float(place[1])))
        object.__setattr__(self, "weight", positive("weight", self.weight))


def load_trips(path: str | os.PathLike[str]) -> tuple[Trip, ...]:
    """Trips from a text of lines ``start_x, start_y, goal_x, goal_y`` and perhaps ``weight``, metres.

    Columns are separated by commas, semicolons or blanks; a header that names them in another order, and comments that
    begin with ``#``, are understood.

    Raises
    ------
    TrajectoryError : if the file cannot be read, has other columns or no trips: the message names it, and the line

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "trips.csv")
    ...     _ = file.write_text("start_x,start_y,goal_x,goal_y,weight\\n2,5,58,5,20\\n")
    ...     load_trips(file)
    (Trip(start=(2.0, 5.0), goal=(58.0, 5.0), weight=20.0, name=''),)
    """
    file = Path(path)
    table = read_table(file, min_rows=1)
    width = table.values.shape[1]
    names = table.names if table.names is not None and set(table.names) & set(_COLUMNS) else _COLUMNS[:width]
    if table.names is not None and not table.names_are_a_comment:
        names = table.names
    if len(names) != width or len(set(names)) < width or not set(_COLUMNS[:4]) <= set(names) <= set(_COLUMNS):
        got = ", ".join(table.names) if table.names else f"{width} columns"
        raise TrajectoryError(f"{file}, line {table.lines[0]}: expected the columns {_NAMED}, got {got}")
    trips = []
    for line, row in zip(table.lines.tolist(), table.values.tolist(), strict=True):
        value = dict(zip(names, row, strict=True))
        try:
            ends = (value["start_x"], value["start_y"]), (value["goal_x"], value["goal_y"])
            trips.append(Trip(*ends, value.get("weight", 1.0)))
        except ValueError as err:
            raise TrajectoryError(f"{file}, line {line}: {err}") from None
    return tuple(trips)


def trips_of(trips: Any) -> tuple[Trip, ...]:
    """A sequence of Trip, (start, goal) or (start, goal, weight) as trips; other things are refused."""
    if isinstance(trips, (Trip, str)) or not isinstance(trips, Sequence) or not len(trips):
        raise ValueError(f"expected trips to be a sequence of Trip or (start, goal, weight), got {trips!r}")
    return tuple(_trip(k, trip) for k, trip in enumerate(trips))


def _trip(number: int, trip: Any) -> Trip:
    if isinstance(trip, Trip):
        return trip
    try:
        start, goal, *weight = trip
        return Trip(start, goal, *weight)
    except (TypeError, ValueError) as err:
        raise ValueError(f"trip {number}: expected a Trip or (start, goal) or (start, goal, weight): {err}") from None
