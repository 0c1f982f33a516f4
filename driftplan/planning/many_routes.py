"""plan_routes: the routes of many trips through one world, on a graph that is made once, in parallel."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from math import inf
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats, listener, shaped, whole
from driftplan.beacons.beacon import Beacon
from driftplan.errors import DriftplanError
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Estimator, Fix
from driftplan.planning.request import ROADMAP, DriftLimit, Objective, Planner, PlanRequest, Reliance, checked_ends
from driftplan.planning.roadmap.growth import KEPT_BATCH, RoadmapSearch
from driftplan.planning.roadmap.kept_graph import KeptGraph
from driftplan.planning.roadmap.prices import AdditiveCost, Score, length_of
from driftplan.planning.routes import Route, route_for, route_of
from driftplan.planning.status import Status
from driftplan.planning.taut_strings import LeastRoute
from driftplan.planning.unaided import Unaided
from driftplan.world.world import World


def plan_routes(
    world: World,
    trips: Iterable[ArrayLike],
    noise: OdometryNoise,
    *,
    beacons: Sequence[Beacon] = (),
    minimise: Objective = "drift",
    max_drift: float | DriftLimit | None = None,
    max_detour: float | None = None,
    start_fix: Fix | None = None,
    estimator: Estimator = "reset",
    planner: str | Planner = ROADMAP,
    time_limit: float | None = None,
    seed: int = 0,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Route, ...]:
    """The routes of many trips through one world, planned in parallel.

    Corners, samples and the free motions between them do not depend on the goal: they are made once, kept with the
    world, and shared by all trips. A trip without beacons, limits and a time limit takes the best path of that graph,
    for the drift and for the length, polished, and of these the one of least exact drift. The others are planned one by
    one as by `plan_route`.

    Parameters
    ----------
    world, noise, beacons, minimise, max_drift, max_detour, start_fix, estimator, planner, seed
        As for `plan_route`.
    trips : iterable of (2, 2), start and goal of each, metres
    time_limit : seconds for each trip, to look for something better than the graph has
    workers : processes; 1: none but this one. Default: one per processor.
    progress : called with the number of trips done and that of all

    Returns
    -------
    tuple of Route
        In the order of the trips. What their ``bound`` proves takes no notice of obstacles.

    Raises
    ------
    DriftplanError
        As `plan_route`, with the number of the trip, counted from 0: ends that are not free or not connected before
        anything is planned.

    >>> world = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)
    >>> noise = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
    >>> there, back = plan_routes(world, [[(2, 2), (8, 2)], [(8, 2), (2, 2)]], noise, workers=1)
    >>> 13 < there.length < 14.5, 13 < back.length < 14.5
    (True, True)
    """
    told = listener("progress", progress, "with the number of trips done and that of all")
    ends = [shaped("a trip", trip, (2, 2)) for trip in trips]
    for k, trip in enumerate(ends):
        _numbered(k, lambda trip=trip: checked_ends(world, *trip, connected=True))  # type: ignore[misc]
    reliance = Reliance.of(beacons, max_drift, max_detour, start_fix, estimator)
    asked: dict[str, Any] = {"minimise": minimise, "time_limit": time_limit, "seed": seed}
    asked |= {"noise": noise, "reliance": reliance, "planner": Planner.of(planner)}
    plain = not beacons and reliance.max_drift == inf and max_detour is None and time_limit is None
    plain &= minimise != "worst_drift" and planner == ROADMAP
    if plain and ends:
        KeptGraph.of(world)  # before there are processes, so that those that are forked have it
    plan = partial(_planned, partial(PlanRequest, world, **asked), _kept_route if plain else route_for)
    workers = min(os.cpu_count() or 1 if workers is None else whole("workers", workers, least=1), max(len(ends), 1))
    if workers == 1:
        return _collected(map(plan, range(len(ends)), ends), len(ends), told)
    with ProcessPoolExecutor(workers, initializer=_take, initargs=(plan,)) as pool:
        try:
            return _collected(pool.map(_taken, range(len(ends)), ends), len(ends), told)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _collected(routes: Iterable[Route], count: int, told: Callable[[int, int], None]) -> tuple[Route, ...]:
    found = []
    for route in routes:
        found.append(route)
        told(len(found), count)
    return tuple(found)


def _kept_route(request: PlanRequest) -> Route:
    """The best route of the kept graph; where that has none, what `plan_route` finds."""
    world, noise, (start, goal) = request.world, request.noise, request.ends
    scores: tuple[Score, ...] = ("length",) if request.minimise == "length" else ("length", "drift")
    searches = [RoadmapSearch(AdditiveCost(world, goal, noise, s), start, batch=KEPT_BATCH) for s in scores]
    searches = searches if (start != goal).any() else []
    for search in searches:
        search.grow()
    paths = [search.path for search in searches if search.path is not None]
    if not paths:
        return route_for(request)
    shortest = min(paths, key=length_of)
    searches[-1].offer(shortest)
    best = searches[-1].path
    assert best is not None
    straight = float(np.linalg.norm(goal - start))
    return route_of(request, Unaided(best, shortest, Status.SEARCH_DONE, LeastRoute(straight**3 / 3, straight)))


def _numbered(k: int, call: Callable[[], Any]) -> Any:
    """What a call says about trip ``k``."""
    try:
        return call()
    except (DriftplanError, ValueError) as err:
        raise type(err)(f"trip {k}: {err}") from None


def _planned(
    asked: Callable[[Floats], PlanRequest], plan: Callable[[PlanRequest], Route], k: int, trip: Floats
) -> Route:
    route: Route = _numbered(k, lambda: plan(asked(trip)))
    return route


_PLAN: list[Callable[[int, Floats], Route]] = []  # of a worker


def _take(plan: Callable[[int, Floats], Route]) -> None:
    _PLAN[:] = [plan]


def _taken(k: int, trip: Floats) -> Route:
    return _PLAN[0](k, trip)
