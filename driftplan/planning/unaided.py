"""Paths for robots that read nothing on the way: of the roadmap or of OMPL's planners, polished, the best by the exact
drift at the goal."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from driftplan.arrays import Floats
from driftplan.errors import NoPathError
from driftplan.model.noise import OdometryNoise
from driftplan.planning.request import ROADMAP, PlanRequest, format_point
from driftplan.planning.roadmap.polish import polished
from driftplan.planning.roadmap.prices import AdditiveCost, Score, exact_drift, length_of
from driftplan.planning.roadmap.search import plan_on_roadmap
from driftplan.planning.status import Status
from driftplan.world.world import World
from driftplan.world.zones import Zone

_SHORTEST_SHARE = 0.2  # of the time, for the shortest route, whose polished form is a candidate too
_DETOUR_TRIALS = 5


class UnaidedPath(NamedTuple):
    """A path, why its search ended, and what is known of all others."""

    path: Floats
    status: Status
    bound: float | None  # of the paths of the roadmap, m² or m
    bound_heading_std: float = math.inf


class _Found(NamedTuple):
    """What one search came back with."""

    paths: tuple[Floats, ...]
    status: Status
    bound: float | None
    bound_heading_std: float = math.inf

    def with_path(self, path: Floats) -> UnaidedPath:
        return UnaidedPath(path, self.status, self.bound, self.bound_heading_std)


def shortest_path(request: PlanRequest) -> UnaidedPath:
    """The shortest path that the planner finds, yours included."""
    search = _UnaidedSearch(request)
    if search.is_there:
        return UnaidedPath(request.ends, Status.OPTIMAL, 0.0)
    found = search.run("length", request.time_limit)
    return found.with_path(min(search.some([*found.paths, *request.initial_paths]), key=length_of))


def least_drift_path(request: PlanRequest) -> tuple[UnaidedPath, UnaidedPath]:
    """The path of least exact drift at the goal within the detour, and the shortest one that it was measured by."""
    search = _UnaidedSearch(request)
    if search.is_there:
        here = UnaidedPath(request.ends, Status.OPTIMAL, 0.0)
        return here, here
    max_detour = request.reliance.max_detour
    brief = search.run("length", _SHORTEST_SHARE * request.time_limit)
    known = [*request.initial_paths, *brief.paths]
    shares = 1 if max_detour is None else 1 + _DETOUR_TRIALS
    each = (1 - _SHORTEST_SHARE) * request.time_limit / shares
    found = search.run("drift", each, known=known)
    pool = [*known, *found.paths]
    if request.planner != ROADMAP:  # which has polished what it was given
        pool += [search.polished(path) for path in brief.paths]
    shortest = min(search.some(pool), key=length_of)
    longest = math.inf if max_detour is None else max_detour * length_of(shortest)
    if all(length_of(path) > longest for path in found.paths):
        pool += search.within_detour(longest, each)
    fitting = [path for path in pool if length_of(path) <= longest * (1 + 1e-9)]
    return found.with_path(min(fitting, key=search.mean_square)), brief.with_path(shortest)


@dataclass(frozen=True, eq=False)
class _UnaidedSearch:
    """The searches for one request."""

    request: PlanRequest

    @property
    def is_there(self) -> bool:
        return bool((self.request.ends[0] == self.request.ends[1]).all())

    def some(self, pool: list[Floats]) -> list[Floats]:
        """The paths, if there are any."""
        request = self.request
        if not pool:
            counted = request.iterations
            within = f"{request.time_limit:g} s" if counted is None else f"{counted} iterations"
            start, goal = (format_point(end) for end in request.ends)
            raise NoPathError(
                f"{request.planner} found no path from {start} to {goal} within {within}, though free space connects "
                "them: allow more" + (f", or use planner={ROADMAP!r}" if request.planner != ROADMAP else "")
            )
        return pool

    def run(
        self, score: Score, time_limit: float, known: Sequence[Floats] | None = None, price_per_m: float = 0.0
    ) -> _Found:
        """The planner's best path, as it is and polished; no path if it found none in time.

        The roadmap begins with the ``known`` paths, by default the caller's; OMPL's planners cannot be told.
        """
        request = self.request
        world, noise = _dearer_by(request.world, request.noise, price_per_m)
        if request.planner == ROADMAP:
            try:
                result = plan_on_roadmap(
                    world,
                    request.ends,
                    noise,
                    minimise=score,
                    time_limit=time_limit,
                    batches=request.iterations,
                    seed=request.seed,
                    start_heading=request.reliance.start_heading,
                    known=request.initial_paths if known is None else known,
                )
            except NoPathError:
                return _Found((), Status.TIME_LIMIT, None)
            return _Found((result.path,), result.status, result.bound, result.bound_heading_std)
        from driftplan.planning.ompl.solve import solve

        began = time.perf_counter()
        raw = solve(
            world,
            request.ends[0],
            request.ends[1],
            noise if score == "drift" else None,
            planner=request.planner,
            time_limit=time_limit,
            iterations=request.iterations,
            seed=request.seed,
        )
        in_time = request.iterations is not None and time.perf_counter() - began < time_limit
        status = Status.ITERATIONS_DONE if in_time else Status.TIME_LIMIT
        if raw is None:
            return _Found((), status, None)
        cost = AdditiveCost(world, request.ends[1], noise, score)
        return _Found((raw, polished(cost, raw, request.reliance.start_heading)), status, None)

    def polished(self, path: Floats) -> Floats:
        request = self.request
        cost = AdditiveCost(request.world, request.ends[1], request.noise, "drift")
        return polished(cost, path, request.reliance.start_heading)

    def within_detour(self, longest: float, time_limit: float) -> list[Floats]:
        """Paths of low drift no longer than ``longest``: a price on length is raised until they fit, then refined.

        A price per metre is a distance variance per metre to the additive cost, here and in the zones. It finds the
        routes that are best for some price, which not every route that is best for its length is.
        """
        noise, ends = self.request.noise, self.request.ends
        straight = float(np.linalg.norm(ends[1] - ends[0]))
        low, high = 0.0, noise.heading_var_per_m * straight**2 + noise.distance_var_per_m + 1e-9
        fitting: list[Floats] = []
        for _ in range(_DETOUR_TRIALS):
            price = high if not fitting else math.sqrt(max(low, high * 1e-3) * high)
            paths = self.run("drift", time_limit, known=(), price_per_m=price).paths
            fits = [path for path in paths if length_of(path) <= longest]
            fitting += fits
            if fits:
                high = price
            else:
                low, high = price, (4 * price if not fitting else high)
        return fitting

    def mean_square(self, path: Floats) -> float:
        request = self.request
        end = exact_drift(request.world, path, request.noise, request.reliance.start_heading).end
        return float(end.rms) ** 2


def _dearer_by(world: World, noise: OdometryNoise, price_per_m: float) -> tuple[World, OdometryNoise]:
    """World and noise with a variance per metre added to every noise."""
    if price_per_m == 0:
        return world, noise

    def dearer(noise: OdometryNoise) -> OdometryNoise:
        return replace(noise, distance_var_per_m=noise.distance_var_per_m + price_per_m)

    zones = tuple(Zone(zone.polygon, dearer(zone.noise)) for zone in world.zones)
    return (replace(world, zones=zones) if zones else world), dearer(noise)
