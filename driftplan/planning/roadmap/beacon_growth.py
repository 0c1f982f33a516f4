"""BeaconRouteGrowth: routes among beacons on ever larger roadmaps, from one start to one goal."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from driftplan.arrays import Floats
from driftplan.errors import NoPathError
from driftplan.model.noise import OdometryNoise
from driftplan.planning.request import Objective, Reliance
from driftplan.planning.roadmap.beacon_search import BeaconSearch
from driftplan.planning.roadmap.graph import Roadmap
from driftplan.planning.roadmap.itinerary_check import why_infeasible
from driftplan.planning.roadmap.prices import AdditiveCost, length_of
from driftplan.planning.routes import Route, route_along
from driftplan.planning.status import Status
from driftplan.world.world import World

_FIRST_NODES = 250  # of the first batch; every later one has twice as many


class BeaconRouteGrowth:
    """An anytime search, as `driftplan.planning.roadmap.growth.RoadmapSearch`: every batch is a search among beacons
    on a roadmap of twice as many nodes, and the best route of all stays."""

    def __init__(
        self,
        pricing: AdditiveCost,
        world: World | None,
        noise: OdometryNoise,
        start: Floats,
        minimise: Objective,
        reliance: Reliance,
        *,
        max_nodes: int,
        seed: int,
    ) -> None:
        self.ends = np.stack([start, pricing.goal])
        self.start_heading = reliance.start_heading
        self.pricing, self.world, self.noise = pricing, world, noise
        self.minimise, self.reliance = minimise, reliance
        self.max_nodes, self.seed = max_nodes, seed
        self.batches = 0
        self.route: Route | None = None
        self.path: Floats | None = None  # of the route
        self.cost = self.additive_cost = math.inf  # what is minimised: metres, or square metres of drift
        self.search: BeaconSearch | None = None  # the latest
        self._is_largest = False

    @property
    def is_optimal(self) -> bool:
        """Whether more batches would find nothing better."""
        return self._is_largest or (self.route is not None and self.route.status is Status.OPTIMAL)

    @property
    def roadmap(self) -> Roadmap:
        """The latest roadmap, of start and goal alone while nothing more was needed."""
        known = None if self.search is None else self.search.roadmap
        return known or Roadmap(self.pricing, self.ends[0])

    def grow(self, stop: Callable[[], bool]) -> None:
        """A route on a roadmap of twice as many nodes as before; the better one stays."""
        nodes = min(_FIRST_NODES << self.batches, self.max_nodes)
        given = self.pricing.space, self.world, self.ends, self.noise, self.reliance
        try:
            search = BeaconSearch(*given, max_nodes=nodes, seed=self.seed, stop=stop)
        except NoPathError:
            self._is_largest = True  # more nodes would help no more than the batches that were tried
            return
        self.search = search
        path = search.best(self.minimise)
        search.stop = search.stop_shortening = lambda: False  # a termination condition ends with its solve
        if path is not None:
            verdict = search.check.verdict(path)
            drift_m = verdict.end if self.minimise == "drift" else verdict.worst
            cost = length_of(path) if self.minimise == "length" else drift_m**2
            if cost < self.cost:
                self.cost = self.additive_cost = cost
                self.path, self.route = path, route_along(search, path, self.minimise)
        if not search.timed_out:
            self.batches += 1
            self._is_largest = nodes == self.max_nodes

    @property
    def bound(self) -> float:
        """Of what is minimised, over all routes; m² of drift, or m."""
        assert self.route is not None
        return self.route.bound if self.minimise == "length" else self.route.bound**2

    def why_not(self) -> str | None:
        """What stands in the way of a route."""
        if self.route is not None:
            return None
        if self.search is None:
            return "no path was found at all: the way may be too narrow for samples"
        return why_infeasible(self.search, self.reliance.max_drift, self.search.max_length(self.minimise))
