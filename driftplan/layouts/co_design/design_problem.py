"""The two halves of a co-design: the cheapest beacons for routes, and the shortest routes among beacons."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from driftplan.arrays import Bools, Floats
from driftplan.beacons.beacon import Beacon
from driftplan.errors import GoalError, InfeasibleError, NoPathError, StartError
from driftplan.layouts.co_design.design import Design, Trip
from driftplan.layouts.layout import Layout
from driftplan.layouts.place import place_beacons
from driftplan.layouts.scenario import ListedSites, Sites, beacons_in_range
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Estimator
from driftplan.planning.request import DriftLimit, Reliance, check_connected, checked_ends
from driftplan.planning.roadmap.beacon_search import BeaconSearch
from driftplan.planning.roadmap.prices import length_of
from driftplan.planning.status import Status
from driftplan.world.world import World

_MIN_PLACE_S = 5.0  # however little time is left
_LIMIT_ROUNDING = 1e-5  # relative: a layout keeps its limit to a little less


@dataclass(kw_only=True)
class DesignProblem:
    """Trips, sites and prices, the clock, and what is known of the trips."""

    world: World
    trips: tuple[Trip, ...]
    noise: OdometryNoise
    limits_m: tuple[float, ...]  # of every trip
    estimator: Estimator  # what robots do with a reading, also where there is none yet
    reliance: Reliance  # of a trip among the existing beacons, under the strictest limit
    sites: Sites  # where beacons may be, as given
    listed: ListedSites  # and one by one
    price_per_m: float
    max_nodes: int
    seed: int
    deadline: float  # when to stop, by the monotonic clock
    place_s: float  # seconds that one placement may take
    shortest: list[Floats] = field(default_factory=list)  # the shortest path of every trip
    longest_m: list[float] = field(default_factory=list)  # how long its route may be
    cut_short: bool = False  # whether the clock has cut anything short
    _routes: dict[tuple[object, ...], Floats | None] = field(default_factory=dict, init=False)  # by what was asked

    def late(self) -> bool:
        self.cut_short = self.cut_short or time.monotonic() > self.deadline
        return self.cut_short

    def metre_price(self, trip: int) -> float:
        """Of one metre of a trip's route, as often as it is driven."""
        return self.price_per_m * self.trips[trip].weight

    def design(self, paths: tuple[Floats, ...], layout: Layout) -> Design:
        """Beacons and routes with their cost."""
        driving_cost = sum(self.metre_price(k) * length_of(path) for k, path in enumerate(paths))
        return Design(layout=layout, paths=paths, driving_cost=driving_cost)

    def beacon_cost(self, beacons: Iterable[Beacon]) -> float:
        """Of sites that are built on."""
        ids, costs = [site.id for site in self.listed.new], self.listed.costs
        return sum(float(costs[ids.index(beacon.id)]) for beacon in beacons)

    def name(self, trip: int) -> str:
        asked = self.trips[trip]
        return f"trip {trip}" + (f" ({asked.name})" if asked.name else "")

    # Routes

    def shortest_path(self, trip: int) -> Floats:
        asked = self.trips[trip]
        try:
            ends = checked_ends(self.world, asked.start, asked.goal)
            if asked.start == asked.goal:
                raise ValueError(f"expected start and goal apart, got {asked.start} for both")
            check_connected(self.world, ends)
            return self.search(trip, ()).shortest
        except (StartError, GoalError, NoPathError, ValueError) as err:
            raise type(err)(f"{self.name(trip)}: {err}") from None

    def search(self, trip: int, beacons: Sequence[Beacon]) -> BeaconSearch:
        """The search for a route of a trip among beacons."""
        return BeaconSearch(
            self.world,
            self.world,
            np.array([self.trips[trip].start, self.trips[trip].goal]),
            self.noise,
            replace(self.reliance, beacons=tuple(beacons), max_drift=self.limits_m[trip], estimator=self.estimator),
            max_nodes=self.max_nodes,
            seed=self.seed,
            stop=self.late,
            shortest=self.shortest[trip] if self.shortest else None,
        )

    def route(self, trip: int, beacons: Sequence[Beacon], longest_m: float) -> Floats | None:
        """The shortest route of a trip among beacons that keeps the limit and is no longer than this.

        A quick search: most of what is asked for has no such route, and a neighbour overlooked is one of hundreds.
        Answers are kept, since neighbours of one design are mostly those of the next one too.
        """
        asked = trip, tuple(beacons), min(longest_m, self.longest_m[trip])
        if asked not in self._routes:
            search = self.search(trip, beacons)
            self._routes[asked] = search.shortest_within(self.limits_m[trip], asked[-1], thorough=False)
        return self._routes[asked]

    # Beacons

    def place(self, paths: Sequence[Floats]) -> Layout:
        """The cheapest beacons found for routes on which the readings that are sure enough keep the limits.

        A site whose reading turns out to be too unsure for a limit is done without.
        """
        sure = np.ones(len(self.listed.new), dtype=bool)
        while True:
            layout = self._place_at(paths, sure)
            unsure = self._unsure(paths, layout)
            if not unsure:
                return layout
            sure &= [site not in unsure for site in self.listed.new]

    def _place_at(self, paths: Sequence[Floats], sure: Bools) -> Layout:
        if not sure.any():
            raise InfeasibleError(f"no site is left whose readings are at least {self.reliance.min_capture:g} sure")
        new, groups = self.listed.new, zip(self.sites.groups, self.listed.members, strict=True)
        sites = Sites(
            points=[new[k] for k in np.flatnonzero(sure)],
            costs=self.listed.costs[sure],
            existing=self.listed.existing,
            groups=[replace(group, members=[new[k].id for k in members if sure[k]]) for group, members in groups],
            min_spacing_m=self.sites.min_spacing_m,
        )
        layout = place_beacons(
            self.world,
            list(paths),
            self.noise,
            DriftLimit(self.limits_m, redundancy=self.reliance.redundancy),
            sites,
            estimator=self.estimator,
            start_fix=self.reliance.start_fix,
            time_limit=max(min(self.deadline - time.monotonic(), self.place_s), _MIN_PLACE_S),
        )
        self.cut_short |= layout.status is Status.TIME_LIMIT
        return layout

    def in_range(self, path: Floats) -> list[Beacon]:
        """Sites that a path comes within range of."""
        return [self.listed.new[i] for i in beacons_in_range(self.world, path, self.listed.new)]

    def _unsure(self, paths: Sequence[Floats], layout: Layout) -> set[Beacon]:
        """New beacons with readings that are too unsure, on routes that do not keep the limit without those."""
        found: set[Beacon] = set()
        least = self.reliance.min_capture
        for k, path in enumerate(paths if least > 0 else ()):
            check, limit = self.search(k, (*layout.existing, *layout.beacons)).check, self.limits_m[k]
            if check.verdict(path, limit).worst <= limit * (1 + _LIMIT_ROUNDING):
                continue
            unsure = {c.beacon for c in check.captures(path) if c.probability < least} & set(layout.beacons)
            if not unsure:
                raise InfeasibleError(
                    f"{self.name(k)}: no layout keeps the drift under {limit:g} m with readings that are at least "
                    f"{least:g} sure"
                )
            found |= unsure
        return found
