"""RoadmapPlanner with beacons: itineraries as an OMPL planner, for SimpleSetup, planner allocators and Benchmark.

What OMPL wants of a planner is in `driftplan.planning.ompl.roadmap`; here is what grows when there are beacons.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, get_args

import numpy as np

from driftplan.arrays import Floats
from driftplan.beacons.beacon import Beacon
from driftplan.errors import NoPathError, PlannerError
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix
from driftplan.planning.bounds import Bound
from driftplan.planning.itinerary.itinerary import Itinerary, Objective, answer, best_path, check_options, longest_of
from driftplan.planning.itinerary.reasons import why_infeasible
from driftplan.planning.itinerary.search import ItinerarySearch
from driftplan.planning.ompl import roadmap as plain
from driftplan.planning.roadmap.graph import Roadmap
from driftplan.planning.roadmap.prices import Pricing
from driftplan.planning.roadmap.search import Status
from driftplan.world.world import World

_FIRST_NODES = 250  # of the first batch; every later one has twice as many


class RoadmapPlanner(plain.RoadmapPlanner):
    """Plans on a growing roadmap, as `driftplan.planning.ompl.roadmap.RoadmapPlanner`, and may count on beacons.

    With beacons or a ``max_drift`` the routes are those of `driftplan.planning.itinerary.itinerary.plan_itinerary`:
    every batch is an itinerary on a roadmap of twice as many nodes, and the best one of all is the solution. What is
    minimised is the exact rms drift at the goal under a `DriftObjective`, the length under a path length objective,
    unless ``minimise`` says otherwise. Where no route of the roadmap keeps the limit, ``solve`` reports a timeout and
    `why_not` says what stands in the way.

    Parameters
    ----------
    si, objective, world, seed, name :
        As there. Without a ``world`` nothing blocks the sight of beacons.
    beacons : sequence of Beacon
    max_drift : float, optional
        Greatest rms drift anywhere on the way, metres.
    minimise : {"length", "drift", "worst_drift"}, optional
    max_detour : float, optional
        Greatest length as a multiple of the shortest route's; default 1.5, and none when the length is minimised.
    redundancy, min_capture, initial :
        As for `plan_itinerary`.
    noise : OdometryNoise, optional
        Needed with a path length objective, which has none.
    most_nodes : int
        Of the largest roadmap, about.

    Raises
    ------
    PlannerError
        For state spaces and objectives that the roadmap cannot plan for; see there.
    ValueError
        For options that make no sense.

    Examples
    --------
    >>> from ompl import base as ob, geometric as og, util as ou
    >>> from driftplan import BeaconKind, DriftObjective
    >>> ou.setLogLevel(ou.LOG_NONE)
    >>> space = ob.RealVectorStateSpace(2)
    >>> space.setBounds(0, 60)
    >>> setup = og.SimpleSetup(space)
    >>> setup.setStateValidityChecker(lambda state: True)
    >>> si = setup.getSpaceInformation()
    >>> start, goal = si.allocState(), si.allocState()
    >>> start[0], start[1], goal[0], goal[1] = 2.0, 5.0, 58.0, 5.0
    >>> setup.setStartAndGoalStates(start, goal)
    >>> objective = DriftObjective(si, OdometryNoise.from_std(heading_deg=3.0, distance_m=0.05, after_m=10.0), goal)
    >>> setup.setOptimizationObjective(objective)
    >>> sign = BeaconKind.landmark(range_m=3.0, position_std_m=0.05, heading_std=0.01)
    >>> planner = RoadmapPlanner(
    ...     si, objective, beacons=[Beacon(sign, 30, 11)], max_drift=1.8, minimise="length", most_nodes=250
    ... )
    >>> setup.setPlanner(planner)
    >>> bool(setup.solve(20.0)), len(planner.itinerary().beacons), planner.itinerary().worst_drift <= 1.8
    (True, 1, True)
    """

    def __init__(
        self,
        si: Any,
        objective: Any = None,
        world: World | None = None,
        *,
        beacons: Sequence[Beacon] = (),
        max_drift: float | None = None,
        minimise: Objective | None = None,
        max_detour: float | None = None,
        redundancy: int = 1,
        min_capture: float = 0.9,
        initial: Fix | None = None,
        noise: OdometryNoise | None = None,
        most_nodes: int = 2000,
        seed: int = 0,
        name: str = "Roadmap",
    ) -> None:
        super().__init__(si, objective, world, seed=seed, name=name)
        self._plans_itineraries = bool(beacons) or max_drift is not None or minimise is not None
        self._minimise, self._noise = minimise, noise
        self._length_weight: float = getattr(objective, "length_weight", 0.0)
        self._options: dict[str, Any] = {
            "beacons": tuple(beacons),
            "max_drift": max_drift,
            "max_detour": max_detour,
            "redundancy": redundancy,
            "min_capture": min_capture,
            "initial": initial,
            "nodes": most_nodes,
            "seed": seed,
        }
        if not self._plans_itineraries:
            given = {"max_detour": max_detour, "noise": noise, "initial": initial}
            if idle := [option for option, value in given.items() if value is not None]:
                raise ValueError(f"expected beacons, max_drift or minimise together with {', '.join(idle)}, got none")
            return
        if minimise is not None and minimise not in get_args(Objective):
            raise ValueError(f"expected minimise one of {get_args(Objective)}, got {minimise!r}")
        if noise is not None and not isinstance(noise, OdometryNoise):
            raise ValueError(f"expected an OdometryNoise, got {noise!r}")
        check_options(minimise=minimise or "length", **self._options)

    def itinerary(self) -> Itinerary | None:
        """The best itinerary so far; None before there is one, and for plans without beacons."""
        search = self._best().search if self._queries else None
        return search.itinerary if isinstance(search, ItineraryGrowth) else None

    def why_not(self) -> str | None:
        """Why no route keeps the limit, in a sentence; None if one does, or nothing has been planned yet."""
        search = self._best().search if self._queries else None
        return search.why_not() if isinstance(search, ItineraryGrowth) else None

    def _search(self, pricing: Pricing, start: Floats, start_heading: float | None) -> plain.Growing:
        if not self._plans_itineraries:
            return super()._search(pricing, start, start_heading)
        by_length = pricing.minimise == "length"
        if by_length and self._noise is None:
            raise ValueError("expected noise=... together with a path length objective, which knows of none")
        if not by_length and self._noise is not None:
            raise ValueError("expected noise only with a path length objective: a DriftObjective has its own")
        weight = getattr(self.getProblemDefinition().getOptimizationObjective(), "length_weight", 0.0)
        if self._length_weight > 0 or weight > 0:
            raise PlannerError(
                "expected length_weight=0 with beacons or max_drift: max_detour is what keeps their routes short"
            )
        noise = self._noise if self._noise is not None else pricing.noise
        world = self._world
        if world is not None and not by_length and world.zones != pricing.space.zones:
            world = replace(world, zones=pricing.space.zones)  # as far as the objective prices them
        check_options(minimise="length", noises=(noise, *(() if world is None else [z.noise for z in world.zones])))
        minimise: Objective = self._minimise or ("length" if by_length else "drift")
        return ItineraryGrowth(pricing, world, noise, start, minimise, start_heading, **self._options)


def _never() -> bool:
    return False


class ItineraryGrowth:
    """Itineraries on ever larger roadmaps, from one start to one goal."""

    def __init__(
        self,
        pricing: Pricing,
        world: World | None,
        noise: OdometryNoise,
        start: Floats,
        minimise: Objective,
        start_heading: float | None,
        *,
        beacons: tuple[Beacon, ...],
        max_drift: float | None,
        max_detour: float | None,
        nodes: int,
        **options: Any,
    ) -> None:
        self.ends = np.stack([start, pricing.goal])
        self.start_heading, self.minimise = start_heading, minimise
        self.pricing, self.world, self.noise, self.beacons = pricing, world, noise, beacons
        self.max_drift, self.max_detour = max_drift, max_detour
        self.most_nodes, self.options = nodes, options
        self.batches = 0
        self.itinerary: Itinerary | None = None
        self.search: ItinerarySearch | None = None  # the latest
        self._is_largest = False

    @property
    def limit(self) -> float:
        return math.inf if self.max_drift is None else float(self.max_drift)

    @property
    def path(self) -> Floats | None:
        return None if self.itinerary is None else self.itinerary.path

    @property
    def cost(self) -> float:
        """What is minimised: metres, or square metres of drift."""
        return math.inf if self.itinerary is None else self._cost_of(self.itinerary)

    @property
    def additive_cost(self) -> float:
        return self.cost

    @property
    def is_optimal(self) -> bool:
        return self._is_largest or (self.itinerary is not None and self.itinerary.status is Status.OPTIMAL)

    @property
    def roadmap(self) -> Roadmap:
        """The latest roadmap, of start and goal alone while nothing more was needed."""
        known = None if self.search is None else self.search.roadmap
        return known or Roadmap(self.pricing, self.ends[0])

    def grow(self, stop: Callable[[], bool]) -> None:
        """An itinerary on a roadmap of twice as many nodes as before; the better one stays."""
        nodes = min(_FIRST_NODES << self.batches, self.most_nodes)
        try:
            search = ItinerarySearch(
                self.pricing.space,
                self.world,
                self.ends,
                self.noise,
                self.beacons,
                start_heading=self.start_heading,
                nodes=nodes,
                stop=stop,
                **self.options,
            )
        except NoPathError:
            self._is_largest = True  # more nodes would help no more than the batches that were tried
            return
        self.search = search
        path = best_path(search, self.minimise, self.limit, self._longest(search))
        search.stop = search.stop_shortening = _never  # a termination condition ends with its solve
        if path is not None:
            found = answer(search, path, self.minimise, self.max_drift, 0.0)
            if self._cost_of(found) < self.cost:
                self.itinerary = found
        if not search.timed_out:
            self.batches += 1
            self._is_largest = nodes == self.most_nodes

    def finish(self) -> Bound:
        """The bound on what was minimised, over all routes."""
        assert self.itinerary is not None
        bound = self.itinerary.bound
        return Bound(bound if self.minimise == "length" else bound**2, math.inf)

    def why_not(self) -> str | None:
        """What stands in the way of an itinerary."""
        if self.itinerary is not None:
            return None
        if self.search is None:
            return "no path was found at all: the way may be too narrow for samples"
        return why_infeasible(self.search, self.limit, self._longest(self.search))

    def _longest(self, search: ItinerarySearch) -> float:
        return longest_of(search, self.minimise, self.max_detour)

    def _cost_of(self, found: Itinerary) -> float:
        if self.minimise == "length":
            return found.length
        check = self.search.check if self.search is not None else None
        assert check is not None
        return (check.verdict(found.path).end if self.minimise == "drift" else found.worst_if_dead) ** 2
