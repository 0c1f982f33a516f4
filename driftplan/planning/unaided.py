"""Paths for robots that read nothing on the way: of the roadmap or of OMPL's planners, polished, the best by the exact
drift at the goal; and what no path can beat."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from driftplan.arrays import Floats
from driftplan.errors import NoPathError
from driftplan.model.noise import OdometryNoise
from driftplan.planning.request import ROADMAP, PlanRequest, format_point
from driftplan.planning.roadmap.growth import BATCHES_TO_FIND_ONE, KEPT_BATCH, RoadmapSearch
from driftplan.planning.roadmap.kept_graph import channel_route
from driftplan.planning.roadmap.polish import polished
from driftplan.planning.roadmap.prices import AdditiveCost, PartOfWorld, Score, Space, exact_drift, length_of
from driftplan.planning.status import Status
from driftplan.planning.taut_strings import LeastRoute, first_margin_m, taut_route, tight_least_route
from driftplan.world.world import World
from driftplan.world.zones import Zone, noises_on

_SEARCH_SHARE = 0.85  # of the time limit; the rest is for the bound
_SHORTEST_SHARE = 0.2  # of it, for OMPL's planner to find the shortest route, whose polished form is a candidate too
_GAP = 0.01  # of the additive cost, left between a route and what no route can beat, that is small enough
_IDLE_BATCHES = 2  # in a row, after which no more are needed; one if all corners are in the roadmap
_FEWEST_BATCHES = KEPT_BATCH + 2  # the one with the graph that is kept often brings nothing, and the next one does
_DETOUR_TRIALS = 5
_BATCHES_PER_TRIAL = 3
_PER_METRE = OdometryNoise(distance_var_per_m=1.0)  # its additive cost is the length


class Unaided(NamedTuple):
    """The path that is best for the request, the shortest one that the search came by, why the search ended, and what
    all routes are at least."""

    path: Floats
    shortest: Floats
    status: Status
    least: LeastRoute


def best_unaided(request: PlanRequest) -> Unaided:
    """The shortest path, or the one of least exact drift at the goal within the detour."""
    if (request.ends[0] == request.ends[1]).all():
        return Unaided(request.ends, request.ends, Status.OPTIMAL, LeastRoute(0.0, 0.0))
    search = _RoadmapPaths(request) if request.planner.name == ROADMAP else _OmplPaths(request)
    search.begin()
    detour = request.reliance.max_detour
    fitting: list[Floats] = []
    if request.minimise == "drift" and detour is not None and search.paths:
        search.grow(_BATCHES_PER_TRIAL)
        longest = detour * min(map(length_of, search.paths))
        if length_of(search.paths[0]) > longest:
            fitting = _within_detour(search, longest)
    status = search.grow()
    pool = [*request.initial_paths, *search.paths, *fitting]
    if not pool:
        counted = request.iterations
        within = f"{request.limit_s:g} s" if counted is None else f"{counted} iterations"
        start, goal = (format_point(end) for end in request.ends)
        raise NoPathError(
            f"{request.planner.name} found no path from {start} to {goal} within {within}, though free space connects "
            "them: allow more" + (f", or use planner={ROADMAP!r}" if request.planner.name != ROADMAP else "")
        )
    best = shortest = min(pool, key=length_of)
    if request.minimise == "drift":
        longest = math.inf if detour is None else detour * length_of(shortest) * (1 + 1e-9)
        given = request.noise, request.reliance.start_heading
        fitting = [path for path in pool if length_of(path) <= longest]
        best = min(fitting, key=lambda path: float(exact_drift(request.world, path, *given).end.rms))
    return Unaided(best, shortest, status, search.least or _least(request, best))


def _least(request: PlanRequest, path: Floats) -> LeastRoute:
    noise, world, gap = _PER_METRE if request.minimise == "length" else request.noise, request.world, _GAP
    if world.zones and request.minimise == "drift" and len(path) > 1:  # what zones cost beyond their best is left open
        cost = AdditiveCost(world, path[-1], noise).path(path)
        gap = max(gap, 1 - LeastRoute.of_path(path).cost(noises_on(world, noise)) / max(cost, 1e-300))
    return tight_least_route(world, path, noise, gap, left_s=request.left_s)


def _within_detour(search: _RoadmapPaths | _OmplPaths, longest: float) -> list[Floats]:
    """Paths of low drift no longer than ``longest``: a price on length is raised until they fit, then refined.

    A price per metre is a distance variance per metre to the additive cost, here and in the zones. It finds the
    routes that are best for some price, which not every route that is best for its length is.
    """
    noise, ends = search.request.noise, search.request.ends
    straight = float(np.linalg.norm(ends[1] - ends[0]))
    low, high = 0.0, noise.heading_var_per_m * straight**2 + noise.distance_var_per_m + 1e-9
    fitting: list[Floats] = []
    for _ in range(_DETOUR_TRIALS):
        price = high if not fitting else math.sqrt(max(low, high * 1e-3) * high)
        fits = [path for path in search.priced(price) if length_of(path) <= longest]
        fitting += fits
        if fits:
            high = price
        else:
            low, high = price, (4 * price if not fitting else high)
    return fitting


class _RoadmapPaths:
    """A search for the path of least drift and one for the shortest, batch by batch in turn; or the latter only."""

    def __init__(self, request: PlanRequest) -> None:
        self.request = request
        self.least: LeastRoute | None = None
        self._shared: Floats | None = None
        scores: tuple[Score, ...] = ("length",) if request.minimise == "length" else ("drift", "length")
        self._searches = [self._search(score, request.world, request.noise) for score in scores]

    @property
    def paths(self) -> list[Floats]:
        """The best for the request first."""
        return [search.path for search in self._searches if search.path is not None]

    def begin(self) -> None:
        """First routes: the caller's, one along the triangles of free space, which is had at once, and a taut string
        that keeps a margin; polished, or without a string the former."""
        world, ends = self.request.world, self.request.ends
        channel = channel_route(world, ends)
        for search in self._searches:
            stop = self._stop(search)
            if channel is not None:
                search.offer(channel)
            for path in self.request.initial_paths:
                search.consider(path, stop)
            string, by_length = None, search.pricing.minimise == "length"
            limited = self.request.time_limit is not None  # then first what a search does that has no time for a string
            if limited and channel is not None and not stop():
                search.consider(channel, stop)
            if (by_length or not world.zones) and not stop():  # a string does not know of zones
                given, left_s = (world, *ends, first_margin_m(world), search.path), partial(self._left_s, search)
                string = taut_route(*given, by_length=by_length, left_s=left_s)
            for path in (string, channel if by_length and string is None and not limited else None):
                if path is not None and not stop():
                    search.consider(path, stop)
        self._share()

    def grow(self, batches: int | None = None) -> Status:
        """Batches until there are so many, or until no more are needed."""
        first = self._searches[0]
        most = batches or self.request.iterations or math.inf
        while growing := [s for s in self._searches if s.batches < most and not self._is_done(s)]:
            for search in growing:
                search.grow(self._stop(search))
            self._share()
            if all(self._stop(search)() for search in growing):
                break
        if first.is_optimal:
            return Status.OPTIMAL
        if self.request.iterations is not None and first.batches >= most:
            return Status.BATCHES_DONE
        if not self._is_done(first):
            return Status.TIME_LIMIT
        return Status.BOUND_REACHED if self._is_near_bound(first) else Status.NOTHING_GAINED

    def priced(self, price_per_m: float) -> list[Floats]:
        """Of a roadmap of a few batches, with a price on length."""
        world = self.request.world
        dearer = PartOfWorld(world, world.bounds, _dearer_zones(world, price_per_m))
        search = self._search("drift", dearer, _dearer(self.request.noise, price_per_m))
        stop = self._stop(search)
        for path in self.paths[-1:]:
            search.consider(path, stop)
        while not (stop() or search.is_optimal or search.batches >= (self.request.iterations or _BATCHES_PER_TRIAL)):
            search.grow(stop)
        return [] if search.path is None else [search.path]

    def _share(self) -> None:
        """Tell the search for the least drift of the shortest path, if that is another one than before."""
        best, *other = self._searches
        for search in other:
            if search.path is not None and search.path is not self._shared:
                self._shared = search.path
                best.consider(search.path, self._stop(best))

    def _search(self, score: Score, space: Space, noise: OdometryNoise) -> RoadmapSearch:
        request = self.request
        cost = AdditiveCost(space, request.ends[1], noise, score)
        return RoadmapSearch(cost, request.ends[0], seed=request.seed, start_heading=request.reliance.start_heading)

    def _left_s(self, search: RoadmapSearch) -> float:
        """Seconds left, as far as that search is concerned: a path there must be."""
        if search.path is None and search.batches < BATCHES_TO_FIND_ONE:
            return math.inf
        return self.request.left_s(_SEARCH_SHARE) - search.reserve_s

    def _stop(self, search: RoadmapSearch) -> Callable[[], bool]:
        """Whether it is late for that search."""
        return lambda: self._left_s(search) < 0

    def _is_done(self, search: RoadmapSearch) -> bool:
        """Whether further batches would bring next to nothing, where that is what ends the search."""
        if search.is_optimal or self.request.iterations is not None:
            return search.is_optimal
        if search is not self._searches[0]:
            return search.idle_batches > 0
        if not self.request.until_done or search.batches < _FEWEST_BATCHES or not search.idle_batches:
            return False
        return search.idle_batches >= (1 if search.has_all_corners else _IDLE_BATCHES) or self._is_near_bound(search)

    def _is_near_bound(self, search: RoadmapSearch) -> bool:
        request, noises = self.request, search.pricing.noises
        if self.least is None:
            self.least = _least(request, self.paths[0])
        least = self.least.length if search.pricing.minimise == "length" else self.least.cost(noises)
        return search.additive_cost * (1 - _GAP) <= least


class _OmplPaths:
    """What a planner of OMPL finds, as it is and polished."""

    least: LeastRoute | None = None

    def __init__(self, request: PlanRequest) -> None:
        self.request = request
        self.paths: list[Floats] = []
        self._status = Status.TIME_LIMIT

    def begin(self) -> None:
        """One search, or one for the shortest path and one for the path of least drift."""
        request = self.request
        searches = 1 if request.reliance.max_detour is None else 1 + _DETOUR_TRIALS
        if request.minimise == "length":
            self.paths = self._solve("length", 1.0)
            return
        brief = self._solve("length", _SHORTEST_SHARE)
        found = self._solve("drift", 1 / searches)
        cost = AdditiveCost(request.world, request.ends[1], request.noise, "drift")
        better = (polished(cost, path, request.reliance.start_heading, self._late) for path in brief)
        self.paths = [*found, *brief, *better]

    def grow(self, _: int | None = None) -> Status:
        return self._status

    def priced(self, price_per_m: float) -> list[Floats]:
        return self._solve("drift", 1 / _DETOUR_TRIALS, price_per_m)

    def _late(self) -> bool:
        return self.request.left_s(_SEARCH_SHARE) < 0

    def _solve(self, score: Score, share: float, price_per_m: float = 0.0) -> list[Floats]:
        """The planner's best path in a share of the time that is left, and that polished; none if there was none."""
        from driftplan.planning.ompl.solve import solve

        request = self.request
        world, noise = request.world, _dearer(request.noise, price_per_m)
        if world.zones and price_per_m:
            world = replace(world, zones=_dearer_zones(world, price_per_m))
        keep_s = (1 - share) * max(request.left_s(_SEARCH_SHARE), 0.0)

        def stop() -> bool:
            return request.left_s(_SEARCH_SHARE) <= keep_s

        ends, objective = request.ends, noise if score == "drift" else None
        limits: dict[str, Any] = {"iterations": request.iterations, "seed": request.seed}
        raw = solve(world, ends[0], ends[1], objective, planner=request.planner.name, stop=stop, **limits)
        in_time = request.iterations is not None and not stop()
        self._status = Status.ITERATIONS_DONE if in_time else Status.TIME_LIMIT
        if raw is None:
            return []
        cost = AdditiveCost(world, request.ends[1], noise, score)
        return [polished(cost, raw, request.reliance.start_heading, self._late), raw]


def _dearer(noise: OdometryNoise, price_per_m: float) -> OdometryNoise:
    """Noise with a variance per metre added."""
    return replace(noise, distance_var_per_m=noise.distance_var_per_m + price_per_m)


def _dearer_zones(world: World, price_per_m: float) -> tuple[Zone, ...]:
    return tuple(replace(zone, noise=_dearer(zone.noise, price_per_m)) for zone in world.zones)
