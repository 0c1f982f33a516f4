"""What co_design answers: designs, of beacons and routes, and what they cost."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from driftplan.arrays import Floats
from driftplan.beacons.beacon import Beacon
from driftplan.layouts.co_design.trips import Trip
from driftplan.layouts.layout import Layout
from driftplan.planning.roadmap.prices import length_of
from driftplan.planning.routes import Route
from driftplan.planning.status import Status
from driftplan.tables import Tabular, decimals


@dataclass(frozen=True, eq=False, kw_only=True)
class Design:
    """Beacons and routes, and what they cost.

    Attributes
    ----------
    layout : of the beacons on the routes; the limit holds on each
    paths : tuple of (n, 2) arrays
        One per trip, metres.
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
    trips : tuple of Trip
    routes : the same paths with their drift, the beacons they count on and the probability of every pass
    baseline : shortest routes, then beacons; None where no beacons hold the limit on the shortest routes.
    status : Status
    rounds : passes over all neighbours, the last one without a gain unless ``status`` says otherwise
    tried : neighbours looked at
    history : cost of the best design, after every improvement
    seconds : float
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
                "start": trip.start,
                "goal": trip.goal,
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
