"""co_design: beacons and routes chosen together, so that what both cost is least.

Given the routes, `driftplan.layouts.place` finds the cheapest beacons; given the beacons,
`driftplan.planning.roadmap.beacon_search` finds the shortest routes that keep the limit. Alternating the two makes
nothing dearer, but from the shortest routes it does not move at all: no route gets shorter, and with these routes no
layout gets cheaper. So the search restarts from neighbours of the best design, and goes on alternating from there:

* some beacons are missing: one of them, two that one trip meets, or all those that one trip meets or that it alone
  needs; trips that relied on them look for routes among the rest, at most so much longer as that may pay;
* a trip takes its shortest route again;
* a trip rides on another's route: it looks for a route among all sites that the other one passes.

It ends where no neighbour leads to anything cheaper, at a local optimum. The first design, shortest routes and then
beacons, is what it is compared with.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats, listener, positive, whole
from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.errors import InfeasibleError
from driftplan.layouts.co_design.design import CoDesign, Design, Trip, trips_of
from driftplan.layouts.co_design.design_problem import DesignProblem
from driftplan.layouts.scenario import Sites
from driftplan.model.noise import OdometryNoise, check_continuous
from driftplan.model.readings import Estimator, Fix
from driftplan.planning.request import DEFAULT_DETOUR, DriftLimit, Reliance
from driftplan.planning.roadmap.beacon_walks import ROUNDING
from driftplan.planning.roadmap.prices import length_of
from driftplan.planning.routes import route_along
from driftplan.planning.status import Status
from driftplan.world.world import World
from driftplan.world.zones import noises_on

_MIN_GAIN = 1e-6  # least relative gain that counts
_DETOUR_COST_SHARE = 2.0  # detours may cost so many times what the missing beacons cost: placing again may save more
_PLACE_TIME_SHARE = 0.25  # of the time limit, for one placement at most


def co_design(
    world: World,
    trips: Sequence[Trip | tuple[ArrayLike, ArrayLike] | tuple[ArrayLike, ArrayLike, float]],
    noise: OdometryNoise,
    limit: float | Sequence[float] | DriftLimit,
    sites: BeaconKind | Sequence[BeaconKind] | Sites,
    *,
    price_per_m: float,
    max_detour: float = DEFAULT_DETOUR,
    estimator: Estimator = "reset",
    start_fix: Fix | None = None,
    max_nodes: int = 500,
    rounds: int = 10,
    time_limit: float = 120.0,
    seed: int = 0,
    progress: Callable[[float, float], None] | None = None,
) -> CoDesign:
    """The beacons and, for every trip, the route that keeps the drift under a limit, at the least cost of both.

    Minimised is the cost of new beacons plus ``price_per_m`` times the metres driven, every trip as often as its weight
    says. Alternates placing given routes and routing given beacons, with restarts from designs that lack some beacons,
    until none of them leads to anything cheaper. Never dearer than 'shortest routes, then place'
    (`CoDesign.baseline`). A local optimum, not a proven one.

    Parameters
    ----------
    world, noise, sites, estimator, start_fix : as for `place_beacons`
    trips : sequence of Trip, or of (start, goal) or (start, goal, weight)
    limit : on the rms, metres (one number or one per trip); or DriftLimit, with a ``redundancy`` of 1 or 2. It holds
        without readings less sure than its ``min_capture``; the chances are in ``routes[k].captures``. 0: all count,
        as in `place_beacons`.
    price_per_m : of driving one metre once, in the unit of the beacons' cost, > 0
    max_detour : no route is longer than this multiple of the shortest, >= 1
    max_nodes : of every roadmap, about
    rounds : passes over all neighbours, at most; 0: only the baseline, with its routes as short as its beacons allow
    time_limit : seconds; it only stops the search, and ``status`` then says so. The baseline is found in any case.
    seed : same seed, same design, unless the time limit was reached
    progress : called with seconds and cost when a cheaper design is found

    Raises
    ------
    InfeasibleError : if a trip cannot be driven within the limit, wherever the beacons are: the message names it, and
        says why
    StartError, GoalError, NoPathError : for the same reasons as `driftplan.plan_route`, naming the trip
    ValueError : for input that makes no sense

    Examples
    --------
    Two trips along parallel aisles share one aisle, and its beacon, when driving is cheap:

    >>> shelf = [(8, 4), (32, 4), (32, 8), (8, 8)]
    >>> world = World.from_polygons([shelf], bounds=(0, 0, 40, 12), robot_radius=0.5)
    >>> noise = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.05, after_m=10.0)
    >>> sign = BeaconKind.landmark(range_m=2.0, position_std_m=0.05, heading_std=0.01, cost=100.0)
    >>> trips, sites = [((2, 2), (38, 2)), ((2, 10), (38, 10))], Sites(sign, spacing_m=4.0)
    >>> limit = DriftLimit(1.2, min_capture=0.0)
    >>> found = co_design(world, trips, noise, limit, sites, price_per_m=1.0, max_nodes=120)
    >>> len(found.baseline.beacons), len(found.beacons), found.gain > 50
    (2, 1, True)
    """
    began, told = time.monotonic(), listener("progress", progress, "with seconds and cost")
    asked, allowed, driven = DriftLimit.of(limit), Sites.of(sites), trips_of(trips)
    if asked.max_drift is None:
        raise ValueError(f"expected a limit on the drift, got {asked}")
    limits_m = asked.per_route(len(driven))
    reliance = Reliance.of(allowed.existing, replace(asked, max_drift=min(limits_m)), max_detour, start_fix, estimator)
    check_continuous(noises_on(world, noise))
    whole("rounds", rounds, least=0)
    listed = allowed.listed(world)
    if not listed.new:
        raise ValueError("expected at least one site outside the forbidden areas, got none")
    problem = DesignProblem(
        world=world,
        trips=driven,
        noise=noise,
        limits_m=limits_m,
        reliance=reliance,
        estimator=estimator,
        sites=allowed,
        listed=listed,
        price_per_m=positive("price_per_m", price_per_m),
        max_nodes=whole("max_nodes", max_nodes, least=10),
        seed=whole("seed", seed, least=0),
        deadline=began + positive("time_limit", time_limit),
        place_s=max(_PLACE_TIME_SHARE * time_limit, 1.0),
    )
    problem.shortest = [problem.shortest_path(k) for k in range(len(driven))]
    problem.longest_m = [max_detour * length_of(path) * (1 + ROUNDING) for path in problem.shortest]
    return _DesignSearch(problem, began, told).run(rounds)


class _DesignSearch:
    """Alternation with restarts; the best design so far."""

    def __init__(self, problem: DesignProblem, began: float, told: Callable[[float, float], None]) -> None:
        self.problem, self.began, self.told = problem, began, told
        self.baseline: Design | None = None
        self.best: Design | None = None
        self.history: list[float] = []
        self.tried = 0
        self._begun: set[bytes] = set()  # routes that have been started from

    def run(self, rounds: int) -> CoDesign:
        best, done, gained, problem = self._start(), 0, True, self.problem
        while done < rounds and gained and not problem.cut_short:
            gained, done = self._pass(best), done + 1
            assert self.best is not None
            best = self.best
        status = Status.TIME_LIMIT if problem.cut_short else Status.ROUNDS_DONE if gained else Status.LOCAL_OPTIMUM
        everyone = (*best.layout.existing, *best.layout.beacons)
        routes = [route_along(problem.search(k, everyone), path, "length") for k, path in enumerate(best.paths)]
        return CoDesign(
            layout=best.layout,
            paths=best.paths,
            driving_cost=best.driving_cost,
            trips=problem.trips,
            routes=tuple(routes),
            baseline=self.baseline,
            status=status,
            rounds=done,
            tried=self.tried,
            history=tuple(self.history),
            seconds=time.monotonic() - self.began,
        )

    def _start(self) -> Design:
        """Shortest routes, then beacons; where none hold the limit on those, routes among beacons at all sites."""
        problem = self.problem
        shortest = tuple(problem.shortest)
        try:
            layout = problem.place(shortest)
        except InfeasibleError as err:
            on_shortest = str(err)
        else:
            self.baseline = problem.design(shortest, layout)
            self._offer(self.baseline)
            return self.baseline
        everywhere = (*problem.listed.existing, *problem.listed.new)
        paths = []
        for k in range(len(shortest)):
            path = problem.route(k, everywhere, math.inf)
            if path is None and problem.cut_short:
                raise InfeasibleError(
                    f"no layout keeps the limit on the shortest routes ({on_shortest}), and no other routes were found "
                    "in time: raise time_limit, or begin with a higher max_drift"
                )
            if path is None:
                raise InfeasibleError(
                    f"{problem.name(k)}: no route no longer than {problem.longest_m[k]:.4g} m keeps the drift under "
                    f"{problem.limits_m[k]:g} m, even with beacons at all {len(problem.listed.new)} sites; on the "
                    f"shortest routes: {on_shortest}"
                )
            paths.append(path)
        self._alternate(tuple(paths))
        if self.best is None:
            raise InfeasibleError(f"no layout keeps the limit on the routes found; on the shortest: {on_shortest}")
        return self.best

    def _pass(self, design: Design) -> bool:
        """Restart from every neighbour of the best design; whether one led to a cheaper design."""
        for paths in self._neighbours(design):
            if self.problem.late():
                break
            self.tried += 1
            if paths is not None and (key := b"".join(path.tobytes() for path in paths)) not in self._begun:
                self._begun.add(key)
                self._alternate(paths)
        return self.best is not None and self.best.cost < design.cost * (1 - _MIN_GAIN)

    def _neighbours(self, design: Design) -> Iterator[tuple[Floats, ...] | None]:
        """Routes to start from; None where a trip has none that could pay."""
        for missing in self._dispensable(design):
            yield self._without(design, missing)
        problem = self.problem
        for k, shortest in enumerate(problem.shortest):
            bases = [design.paths]
            if length_of(design.paths[k]) > length_of(shortest) * (1 + _MIN_GAIN):
                bases.append((*design.paths[:k], shortest, *design.paths[k + 1 :]))
                yield bases[-1]
            for base in bases:
                for rider in range(len(base)):
                    if rider != k:
                        yield self._riding(design, base, rider, k)

    def _dispensable(self, design: Design) -> list[frozenset[Beacon]]:
        """Beacons that might be done without, the sets that save most first; of equals in the seed's order."""
        problem, beacons = self.problem, design.layout.beacons
        order = {b: k for k, b in enumerate(beacons)}
        scenario = design.layout.scenario
        on_trip = [{beacons[i] for i in scenario.beacons_in_range(k, beacons)} for k in range(len(problem.trips))]
        sets = {frozenset([b]) for b in beacons}
        for k, here in enumerate(on_trip):
            elsewhere = set().union(*on_trip[:k], *on_trip[k + 1 :])
            sets |= {frozenset(here), frozenset(here - elsewhere), *map(frozenset, combinations(here, 2))}
        listed = sorted((s for s in sets if s), key=lambda s: sorted(order[b] for b in s))
        rng = np.random.default_rng(problem.seed)
        shuffled = [listed[k] for k in rng.permutation(len(listed)).tolist()]
        return sorted(shuffled, key=lambda s: -problem.beacon_cost(s))

    def _without(self, design: Design, missing: frozenset[Beacon]) -> tuple[Floats, ...] | None:
        """Routes without the missing beacons."""
        problem = self.problem
        left = [b for b in (*design.layout.existing, *design.layout.beacons) if b not in missing]
        spend = _DETOUR_COST_SHARE * problem.beacon_cost(missing)
        paths = list(design.paths)
        for k, path in enumerate(paths):
            limit = problem.limits_m[k]
            if problem.search(k, left).check.verdict(path, limit).worst <= limit:
                continue
            found = problem.route(k, left, length_of(path) + spend / problem.metre_price(k))
            if found is None:
                return None
            spend -= problem.metre_price(k) * max(length_of(found) - length_of(path), 0.0)
            paths[k] = found
        return tuple(paths)

    def _riding(self, design: Design, paths: Sequence[Floats], rider: int, host: int) -> tuple[Floats, ...] | None:
        """Routes in which one trip uses what is, or could be, on the route of another."""
        problem = self.problem
        layout = design.layout
        saved = problem.beacon_cost(layout.beacons[i] for i in layout.scenario.beacons_in_range(rider, layout.beacons))
        if saved == 0:
            return None
        longest_m = length_of(paths[rider]) + _DETOUR_COST_SHARE * saved / problem.metre_price(rider)
        found = problem.route(rider, (*layout.existing, *problem.in_range(paths[host])), longest_m)
        if found is None or np.array_equal(found, paths[rider]):
            return None
        return (*paths[:rider], found, *paths[rider + 1 :])

    def _alternate(self, paths: tuple[Floats, ...]) -> None:
        """Place, route, place, … from these routes on, as long as it gets cheaper."""
        problem = self.problem
        cost = math.inf
        while not problem.late() or self.best is None:
            try:
                layout = problem.place(paths)
            except InfeasibleError:  # beacons that routes read before may be no sites now
                return
            design = problem.design(paths, layout)
            self._offer(design)
            if design.cost >= cost * (1 - _MIN_GAIN):
                return
            cost = design.cost
            everyone = (*layout.existing, *layout.beacons)
            shorter = []
            for k, path in enumerate(paths):
                found = None
                if length_of(path) > length_of(problem.shortest[k]) * (1 + _MIN_GAIN):
                    found = problem.route(k, everyone, length_of(path))
                shorter.append(path if found is None or length_of(found) >= length_of(path) else found)
            if all(new is old for new, old in zip(shorter, paths, strict=True)):
                return
            paths = tuple(shorter)

    def _offer(self, design: Design) -> None:
        if self.best is not None and design.cost >= self.best.cost * (1 - _MIN_GAIN):
            return
        self.best = design
        self.history.append(design.cost)
        self.told(time.monotonic() - self.began, design.cost)
