"""pareto_routes: what less drift costs in length, as a few routes that differ enough to be worth showing."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats
from driftplan.beacons.beacon import Beacon
from driftplan.errors import InfeasibleError
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Estimator, Fix
from driftplan.planning.request import ROADMAP, DriftLimit, Objective, Planner, PlanRequest, Reliance
from driftplan.planning.routes import Route, route_for
from driftplan.world.world import World


def pareto_routes(
    world: World,
    start: ArrayLike,
    goal: ArrayLike,
    noise: OdometryNoise,
    *,
    beacons: Sequence[Beacon],
    max_routes: int = 6,
    max_detour: float = 1.5,
    difference: float = 0.02,
    limit: DriftLimit | None = None,
    start_fix: Fix | None = None,
    estimator: Estimator = "reset",
    planner: str | Planner = ROADMAP,
    time_limit: float = 30.0,
    seed: int = 0,
) -> tuple[Route, ...]:
    """Routes of which none is better than another in length, worst drift and end drift at once.

    The shortest route, the one with the least worst drift, the one that ends with the least drift, and shortest routes
    for limits on the drift between (the ε-constraint method), as far as none is beaten by another. By length, the
    shortest first; `knee` says which is the best compromise.

    Parameters
    ----------
    world, start, goal, noise, beacons, start_fix, estimator, planner, seed : as for `driftplan.plan_route`
    limit : `DriftLimit` of all routes; without a ``max_drift``, how far they may count on beacons
    max_routes : at most so many routes, >= 3
    max_detour : no route is longer than this multiple of the shortest, >= 1
    difference : routes differ by at least this share in length, worst drift or end drift
    time_limit : seconds for all of them. Unless they run out (the `status` of a route says so) the same seed gives the
        same routes.

    >>> from driftplan.beacons.beacon import BeaconKind
    >>> world = World.from_polygons([], bounds=(0, 0, 60, 30), robot_radius=0.5)
    >>> noise = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.05, after_m=10.0)
    >>> sign = BeaconKind.landmark(range_m=3.0, position_std_m=0.05, heading_std=0.01)
    >>> signs = [Beacon(sign, 20, 14), Beacon(sign, 40, 14)]
    >>> asked = {"max_routes": 3, "planner": Planner(max_nodes=30), "time_limit": 60}
    >>> routes = pareto_routes(world, (2, 5), (58, 5), noise, beacons=signs, **asked)
    >>> len(routes) > 1, routes[0].length < routes[-1].length, routes[0].worst_drift > routes[-1].worst_drift
    (True, True, True)
    """
    if not (isinstance(max_routes, int) and max_routes >= 3):
        raise ValueError(f"expected max_routes a whole number >= 3, got {max_routes!r}")
    if not 0 <= difference < 1:
        raise ValueError(f"expected difference in [0, 1), got {difference!r}")
    reliance = Reliance.of(beacons, limit, max_detour, start_fix, estimator)
    search = Planner.of(planner), time_limit, None, seed
    request = PlanRequest(world, (start, goal), noise, reliance, "length", *search)

    def plan(share: float, minimise: Objective, max_drift: float = reliance.max_drift) -> Route:
        asked = replace(request.reliance, max_drift=max_drift)
        left_s = max(request.left_s(), 0.1)
        return route_for(
            replace(request, reliance=asked, minimise=minimise, time_limit=share * left_s, began=time.monotonic())
        )

    shortest, steady, surest = plan(0.2, "length"), plan(0.3, "worst_drift"), plan(0.3, "drift")
    found = [shortest, steady, surest]
    high, low = shortest.worst_guaranteed, steady.worst_guaranteed
    if low < high:
        limits = np.geomspace(high, low, max_routes)[1:-1].tolist()
        for k, max_m in enumerate(limits):
            if request.left_s() < 0:
                break
            try:
                found.append(plan(1 / (len(limits) - k), "length", max_m))
            except InfeasibleError:  # not within the roadmap, or not in time
                continue
    return _thinned(non_dominated(found), difference, max_routes)


def non_dominated(routes: Sequence[Route]) -> list[Route]:
    """Those that no other beats in length, worst drift and end drift at once; by length. Of equals the first."""
    scores = np.array([_scores(route) for route in routes])
    keep = []
    for k, mine in enumerate(scores):
        better = (scores <= mine).all(axis=1) & ((scores < mine).any(axis=1) | (np.arange(len(scores)) < k))
        if not better.any():
            keep.append(routes[k])
    return sorted(keep, key=lambda route: route.length)


def knee(routes: Sequence[Route]) -> int:
    """Index of the best compromise between length and worst drift.

    On logarithmic scales, stretched so that the routes span the unit square: the route that lies farthest below the
    diagonal from least length and greatest drift to greatest length and least drift, and so the one whose two scaled
    scores have the least sum. Where the routes differ in only one of the two there is no compromise: the first.
    """
    if not routes:
        raise ValueError("expected at least one route, got none")
    curve = np.log(np.maximum([[route.length, route.worst_guaranteed] for route in routes], 1e-300))
    span = np.ptp(curve, axis=0)
    if (span <= 0).any():
        return 0
    scaled = (curve - curve.min(axis=0)) / span
    return int(np.argmin(scaled.sum(axis=1)))


def _scores(route: Route) -> Floats:
    return np.array([route.length, route.worst_guaranteed, route.rms])


def _thinned(routes: list[Route], difference: float, max_routes: int) -> tuple[Route, ...]:
    """Without those that are nearly the same as a shorter one; the steadiest always stays."""
    kept: list[Route] = []
    steadiest = min(routes, key=lambda route: route.worst_guaranteed)
    for route in routes:
        ratio = [np.abs(np.log(_scores(route) / np.maximum(_scores(other), 1e-300))).max() for other in kept]
        if route is steadiest or min(ratio, default=math.inf) >= difference:
            kept.append(route)
    while len(kept) > max_routes:  # the two most alike in worst drift become one
        gaps = np.abs(np.diff(np.log([max(route.worst_guaranteed, 1e-300) for route in kept])))
        k = int(np.argmin(gaps[:-1])) if len(gaps) > 1 else 0
        del kept[k + 1 if kept[k + 1] is not steadiest else k]
    return tuple(kept)
