"""What co_design is asked and answers: trips, from Python or from a file; designs of beacons and routes."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from driftplan.arrays import Floats, finite, positive
from driftplan.beacons.beacon import Beacon
from driftplan.errors import TrajectoryError
from driftplan.layouts.layout import Layout
from driftplan.planning.roadmap.prices import length_of
from driftplan.planning.routes import Route
from driftplan.planning.status import Status
from driftplan.tables import Tabular, decimals
from driftplan.world.log_tables import read_table

_COLUMNS = ("start_x", "start_y", "goal_x", "goal_y", "weight")
_NAMED = "start_x, start_y, goal_x, goal_y and perhaps weight"


@dataclass(frozen=True, slots=True)
class Trip:
    """A drive from start to goal, metres, and how often it is driven.

    >>> Trip((2, 5), (58, 5), weight=20, name="dock to press").weight
    20.0
    """

    start: tuple[float, float]
    goal: tuple[float, float]
    weight: float = 1.0
    name: str = ""

    def __post_init__(self) -> None:
        for end in ("start", "goal"):
            place = finite(f"{end} of a trip", getattr(self, end), "(x, y) in metres")
            if place.shape != (2,):
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


@dataclass(frozen=True, eq=False, kw_only=True)
class Design:
    """Beacons and routes, and what they cost.

    Attributes
    ----------
    layout : of the beacons on the routes; the limit holds on each
    paths : (n, 2) each, one per trip, metres
    driving_cost : weights times lengths times the price of a metre
    """

    layout: Layout
    paths: tuple[Floats, ...]
    driving_cost: float

    @property
    def beacons(self) -> tuple[Beacon, ...]:
        """The new ones."""
        return self.layout.beacons

    @property
    def beacon_cost(self) -> float:
        """Of the new ones."""
        return self.layout.cost

    @property
    def cost(self) -> float:
        """Of beacons and driving together."""
        return self.beacon_cost + self.driving_cost

    @property
    def lengths(self) -> tuple[float, ...]:
        """Metres, one per trip."""
        return tuple(length_of(path) for path in self.paths)


@dataclass(frozen=True, eq=False, kw_only=True)
class CoDesign(Design, Tabular):
    """Result of `driftplan.layouts.co_design.co_design.co_design`.

    Attributes
    ----------
    routes : the same paths with their drift, the beacons they count on and the probability of every pass
    baseline : shortest routes, then beacons; None where no beacons hold the limit on the shortest routes.
    rounds : passes over all neighbours, the last one without a gain unless ``status`` says otherwise
    tried : neighbours looked at
    history : cost of the best design, after every improvement

    >>> from driftplan import BeaconKind, OdometryNoise, World, co_design
    >>> hall = World.from_polygons([], bounds=(0, 0, 40, 4), robot_radius=0.5)
    >>> noise, sign = OdometryNoise(heading_var_per_m=2e-4), BeaconKind.landmark(2.0, 0.05, 0.01, cost=100.0)
    >>> found = co_design(hall, [((2, 2), (38, 2))], noise, 1.2, sign, price_per_m=1.0, max_nodes=20)
    >>> found.beacon_cost, found.driving_cost, found.cost
    (100.0, 36.0, 136.0)
    """

    trips: tuple[Trip, ...]
    routes: tuple[Route, ...]
    baseline: Design | None
    status: Status
    rounds: int
    tried: int
    history: tuple[float, ...]
    seconds: float

    @property
    def gain(self) -> float:
        """How much cheaper than `baseline`, never negative; infinite where there is no baseline."""
        return math.inf if self.baseline is None else self.baseline.cost - self.cost

    def to_dicts(self) -> list[dict[str, Any]]:
        """One row per trip, for JSON."""
        return [
            {
                "name": trip.name,
                "start_x_m": trip.start[0],
                "start_y_m": trip.start[1],
                "goal_x_m": trip.goal[0],
                "goal_y_m": trip.goal[1],
                "weight": trip.weight,
                "length_m": route.length,
                "shortest_length_m": route.shortest_length,
                "worst_drift_m": route.worst_drift,
                "beacons": [b.id for b in route.beacons],
            }
            for trip, route in zip(self.trips, self.routes, strict=True)
        ]

    def columns(self) -> dict[str, list[str]]:
        designs = [self] if self.baseline is None else [self.baseline, self]
        return {
            "": ["shortest routes, then beacons", "chosen together"][-len(designs) :],
            "beacons": [str(len(design.beacons)) for design in designs],
            "their cost": decimals([design.beacon_cost for design in designs], 2),
            "driving": decimals([design.driving_cost for design in designs], 2),
            "together": decimals([design.cost for design in designs], 2),
        }

    def words(self) -> str:
        missing = "" if self.baseline else "No layout keeps the limit on the shortest routes. "
        return missing + self.status.value
