"""The two halves of a co-design: the cheapest beacons for routes, and the shortest routes among beacons."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats, finite
from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.passes import passes_of
from driftplan.beacons.readings import BeaconColumns
from driftplan.errors import GoalError, NoPathError, StartError
from driftplan.layouts.co_design.trips import Trip
from driftplan.layouts.layout import Layout
from driftplan.layouts.placement.candidates import allowed, grid_sites
from driftplan.layouts.placement.covering import Outcome
from driftplan.layouts.placement.place import place_beacons
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix
from driftplan.planning.itinerary.search import ItinerarySearch, length_of
from driftplan.planning.roadmap.search import check_connected, checked_ends
from driftplan.world.world import World

_LEAST_PLACE_S = 5.0  # however little time is left


@dataclass(kw_only=True)
class DesignProblem:
    """What is asked.

    Attributes
    ----------
    deadline : when to stop, by the monotonic clock
    place_s : seconds that one placement may take
    sites : where beacons may be
    shortest : the shortest path of every trip
    longest : how long its route may be, metres
    cut_short : whether the clock has cut anything short
    """

    world: World
    trips: tuple[Trip, ...]
    noise: OdometryNoise
    limit: float
    price_per_m: float
    existing: tuple[Beacon, ...]
    redundancy: int
    start_fix: Fix | None
    nodes: int
    seed: int
    deadline: float
    place_s: float
    sites: tuple[Beacon, ...] = ()
    shortest: list[Floats] = field(default_factory=list)
    longest: list[float] = field(default_factory=list)
    cut_short: bool = False  # by the clock

    def late(self) -> bool:
        self.cut_short = self.cut_short or time.monotonic() > self.deadline
        return self.cut_short

    def price(self, trip: int) -> float:
        """Of one metre of a trip's route."""
        return self.price_per_m * self.trips[trip].weight

    def driving(self, paths: Sequence[Floats]) -> float:
        return sum(self.price(k) * length_of(path) for k, path in enumerate(paths))

    def cost(self, paths: Sequence[Floats], layout: Layout) -> float:
        return layout.cost + self.driving(paths)

    def shortest_path(self, trip: int) -> Floats:
        asked = self.trips[trip]
        try:
            ends = checked_ends(self.world, asked.start, asked.goal, self.noise, "length", 1.0, None, None)
            if asked.start == asked.goal:
                raise ValueError(f"expected start and goal apart, got {asked.start} for both")
            check_connected(self.world, ends)
            return self._search(trip, (), None).shortest
        except (StartError, GoalError, NoPathError, ValueError) as err:
            raise type(err)(f"{self.name(trip)}: {err}") from None

    def name(self, trip: int) -> str:
        asked = self.trips[trip]
        return f"trip {trip}" + (f" ({asked.name})" if asked.name else "")

    def search(self, trip: int, beacons: Sequence[Beacon]) -> ItinerarySearch:
        """The search for a route of a trip among beacons."""
        return self._search(trip, tuple(beacons), self.shortest[trip])

    def _search(self, trip: int, beacons: tuple[Beacon, ...], known: Floats | None) -> ItinerarySearch:
        return ItinerarySearch(
            self.world,
            self.world,
            np.array([self.trips[trip].start, self.trips[trip].goal]),
            self.noise,
            beacons,
            redundancy=self.redundancy,
            min_capture=0.0,
            initial=self.start_fix,
            nodes=self.nodes,
            seed=self.seed,
            stop=self.late,
            shortest=known,
        )

    def route(self, trip: int, beacons: Sequence[Beacon], longest: float) -> Floats | None:
        """The shortest route of a trip among beacons that keeps the limit and is no longer than this."""
        return self.search(trip, beacons).shortest_within(self.limit, min(longest, self.longest[trip]))

    def met(self, paths: Sequence[Floats]) -> list[Beacon]:
        """Sites of which at least one path comes within range."""
        columns = BeaconColumns.of(self.sites)
        met = np.zeros(len(self.sites), dtype=bool)
        for path in paths:
            met[passes_of(path, columns.xy, columns.range_m, columns.must_see, self.world).beacon] = True
        return [site for site, useful in zip(self.sites, met.tolist(), strict=True) if useful]

    def place(self, paths: Sequence[Floats]) -> Layout:
        """The cheapest beacons for routes."""
        candidates = self.met(paths)
        layout = place_beacons(
            self.world,
            list(paths),
            self.noise,
            max_drift=self.limit,
            candidates=candidates or list(self.sites[:1]),
            existing=self.existing,
            redundancy=self.redundancy,
            start_fix=self.start_fix,
            time_limit=max(min(self.deadline - time.monotonic(), self.place_s), _LEAST_PLACE_S),
        )
        self.cut_short |= layout.status is Outcome.STOPPED_EARLY
        return layout


def sites_of(
    world: World,
    kind: Any,
    candidates: ArrayLike | None,
    spacing_m: float | None,
    forbidden: Sequence[Any],
    taken: set[str],
) -> tuple[Beacon, ...]:
    """Every kind at every place where a beacon may be, with ids."""
    kinds = [kind] if isinstance(kind, BeaconKind) else list(kind)
    if not kinds or not all(isinstance(one, BeaconKind) for one in kinds):
        raise ValueError(f"expected kind to be a BeaconKind or several, got {kind!r}")
    if candidates is None:
        points = grid_sites(world, min(k.range_m for k in kinds) if spacing_m is None else spacing_m)
    elif spacing_m is not None:
        raise ValueError("expected spacing_m only for generated candidates, got both candidates and spacing_m")
    else:
        points = finite("candidates", candidates)
        if points.ndim != 2 or points.shape[1] != 2:
            raise ValueError(f"expected candidates (n, 2) in metres, got shape {points.shape}")
    points = allowed(points, forbidden)
    if not len(points):
        raise ValueError("expected at least one candidate, got none")
    sites = []
    for number, (x, y) in enumerate(points.tolist(), start=1):
        for which, one in enumerate(kinds, start=1):
            name = f"S{number}" if len(kinds) == 1 else f"S{number}-{which}"
            sites.append(Beacon(one, x, y, id=name if name not in taken else f"{name}+"))
    return tuple(sites)
