"""plan_route: the route on which a robot arrives with the least drift, or that keeps a limit on the way."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from numpy.typing import ArrayLike

from driftplan.arrays import Floats, instance
from driftplan.beacons.beacon import Beacon
from driftplan.beacons.readings import DetectionChance
from driftplan.errors import InfeasibleError
from driftplan.model.drift import Drift
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Estimator, Fix
from driftplan.model.worst import worst_rms
from driftplan.planning.bounds import least_end_drift, least_length, least_worst_drift
from driftplan.planning.collision_chance import CollisionChance, collision_chance
from driftplan.planning.request import ROADMAP, DriftLimit, Objective, Planner, PlanRequest, Reliance, check_connected
from driftplan.planning.roadmap.beacon_search import BeaconSearch
from driftplan.planning.roadmap.beacon_walks import ROUNDING
from driftplan.planning.roadmap.itinerary_check import why_infeasible
from driftplan.planning.roadmap.prices import exact_drift, length_of
from driftplan.planning.status import Status
from driftplan.planning.unaided import Unaided, best_unaided
from driftplan.tables import Tabular
from driftplan.world.world import World
from driftplan.world.zones import noises_on

_UNAIDED_SHARE = 0.3  # of the time limit, for the route that would be best without a limit
_SEARCH_SHARE = 0.75  # of it for all searches; the rest is for shortening what was found


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Route(Tabular):
    """A collision-free route and the drift along it.

    Attributes
    ----------
    path : (n, 2), waypoints in metres, world frame
    drift : exact along the path, with the noise of the zones it crosses and the readings of the beacons it counts on
    planner : which planner found it
    minimise : "drift", "length" or "worst_drift"
    status : why the search ended, a sentence for people
    bound : proven lower bound of what was minimised, metres: among the obstacles (`driftplan.planning.taut_strings`),
        with the noise of the best of the zones everywhere, and turns for nothing; with beacons or a limit taking no
        notice of obstacles, redundancy and min_capture. Zero where nothing is known, as of noise that is systematic.
    bound_heading_std : rad; it covers the routes whose heading error at the goal has a standard deviation of up to
        this. Infinite where it covers all routes.
    shortest : the shortest route that the same search came by, drift or not. None if this is a shortest one.
    beacons : those it counts on, in the order of their first reading
    captures : every pass of a beacon and the probability that it happens
    max_drift : the limit asked for, or None
    worst_drift : greatest rms drift anywhere on the way, metres, all beacons alive
    worst_guaranteed : the same with any one beacon dead where ``redundancy`` was 2
    labels : how many partial routes the search kept

    >>> hall = World.from_polygons([], bounds=(0, 0, 9, 9), robot_radius=0.5)
    >>> route = plan_route(hall, (1, 1), (8, 1), OdometryNoise(heading_var_per_m=1e-4), iterations=1)
    >>> route.path.tolist(), route.length, route.shortest.length
    ([[1.0, 1.0], [8.0, 1.0]], 7.0, 7.0)
    """

    path: Floats
    drift: Drift
    planner: str
    minimise: Objective
    status: Status
    bound: float
    bound_heading_std: float = math.inf
    shortest: Route | None = None
    beacons: tuple[Beacon, ...] = ()
    captures: tuple[DetectionChance, ...] = ()
    max_drift: float | None = None
    worst_drift: float
    worst_guaranteed: float
    labels: int = 0

    @property
    def bound_covers(self) -> str:
        """Of what ``bound`` is a bound, in words: "all routes", or which."""
        if math.isinf(self.bound_heading_std):
            return "all routes"
        return f"routes with headings off by at most {self.bound_heading_std:.2g} rad"

    @property
    def length(self) -> float:
        """Metres."""
        return float(self.drift.length)

    @property
    def rms(self) -> float:
        """rms drift at the goal, metres."""
        return float(self.drift.end.rms)

    @property
    def shortest_length(self) -> float:
        """Of the shortest route found, drift or not, metres."""
        return (self.shortest or self).length

    def collision_probability(
        self, world: World, *, runs: int = 1000, spacing_m: float | None = None, seed: int = 0
    ) -> CollisionChance:
        """How likely the robot touches a wall on its way, as `driftplan.collision_chance` says.

        Parameters
        ----------
        world : its walls block sight, its zones override ``noise`` where they are
        runs, spacing_m, seed : as for `driftplan.collision_chance`

        >>> wall = [(4, 0), (6, 0), (6, 7), (4, 7)]
        >>> wide, real = (World.from_polygons([wall], bounds=(0, 0, 10, 10), robot_radius=r) for r in (0.8, 0.5))
        >>> noise = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.1, after_m=10.0)
        >>> route = plan_route(wide, (2, 2), (8, 2), noise, time_limit=0.3)
        >>> 0.01 < route.collision_probability(real).probability < 0.2
        True
        """
        instance("world", world, World)
        return collision_chance(self.drift, world, runs=runs, spacing_m=spacing_m, seed=seed)

    @property
    def is_among_beacons(self) -> bool:
        """Whether beacons, a limit or the worst drift had a say in it."""
        return bool(self.captures) or self.max_drift is not None or self.minimise == "worst_drift"

    def __repr__(self) -> str:
        """What a person would want to know, not a page of waypoints."""
        counted = f", {len(self.beacons)} beacons" if self.captures else ""
        return (
            f"Route({self.length:.2f} m, rms {self.rms:.4g} m at the goal, least {self.minimise} of {self.planner}, "
            f"{len(self.path)} waypoints{counted}, {self.status.name.lower()})"
        )

    __str__ = __repr__

    def to_dicts(self) -> list[dict[str, Any]]:
        """The drift at every waypoint, a row each; `compare_routes` has a row per route."""
        return self.drift.to_dicts()

    def columns(self) -> Mapping[str, Iterable[object]]:
        """In notebooks: beside the shortest route, if that came along."""
        from driftplan.planning.comparison import compare_routes

        return compare_routes([self, self.shortest] if self.shortest is not None else [self]).columns()


def plan_route(
    world: World,
    start: ArrayLike,
    goal: ArrayLike,
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
    iterations: int | None = None,
    until: Callable[[], bool] | None = None,
    seed: int = 0,
) -> Route:
    """The collision-free route on which odometry drifts least, or the shortest one that keeps a limit.

    Without beacons and limits the planner minimises the additive upper bound of E|e|² (`driftplan.planning.cost`); what
    it finds is polished, and of all paths (as found, polished, the shortest route, that polished, and yours) the one
    with the least exact drift is returned. With beacons, a limit, or the worst drift to be least, a label search among
    the beacons does it (`driftplan.planning.roadmap.beacon_search`), and what is returned has been checked by the exact
    model: everywhere on the way, with every beacon dead that may be, and without beacons that the robot would probably
    miss.

    Parameters
    ----------
    world : its walls block sight, its zones override ``noise`` where they are
    start, goal : (2,) metres, world frame. A start with a heading, (3,), rad: then the first turn counts too.
    noise : with beacons or a limit, of the continuous kind (no ``step_m``)
    beacons : sequence of Beacon
    minimise : {"drift", "length", "worst_drift"}
        rms drift at the goal, length, or the greatest rms drift on the way (to within 2 %).
    max_drift : float or DriftLimit, optional
        Greatest rms drift anywhere on the way, metres; how many beacons may be dead, and how surely the others must be
        read, as `DriftLimit` says.
    max_detour : float, optional
        Greatest length as a multiple of the shortest route found, >= 1. Default: 1.5 with beacons unless length is
        minimised, else none.
    start_fix : uncertainty at the start; default: the start is known
    estimator : {"reset", "filter"}
        What the robot does with a reading, as for `driftplan.predict_drift`. Only with ``filter`` may beacons be of
        kinds that measure a range or a bearing.
    planner : its name, or with its options, as `Planner` says
    time_limit : float, optional
        Seconds for everything in the call. Default: until it is done, that is until the third batch of the roadmap or a
        later one brought next to nothing, and two in a row did, or the additive cost is within 1 % of what no route can
        beat, or all corners of obstacles are in the roadmap; at most 5, and as long as it takes with ``iterations``.
        What is done once for a world (growing the obstacles by the robot's radius, cutting free space into triangles)
        is not cut short. A longer search without max_detour comes by all paths that a shorter one comes by. Among
        beacons work is counted in labels and trials, which the time limit cuts short; saying why there is no route may
        take as long again.
    iterations : int, optional
        Ends every search without beacons after so many: batches of the roadmap (the second is the graph kept with the
        world, the others have ever more samples), or iterations of OMPL's planners. The same seed then gives the same
        route, to the last bit, whatever was asked of the world before.
    until : callable, optional
        Asked over and over, without arguments, whether to stop: a button, a deadline, a termination condition of OMPL.
        Then neither the five seconds of ``time_limit`` nor its "done" hold. It is asked every 20 to 50 ms while a
        roadmap grows; a search of the roadmap and the polishing of its path, together 0.1 s and more where it is large,
        are not cut in two. Once True, it has to stay so.
    seed : same seed, same samples; how many are drawn depends on the time, unless ``iterations`` says

    Raises
    ------
    StartError, GoalError : if start or goal is not in free space; the message names the nearest point that is
    NoPathError : if no route leads there: the message says what part of the map the start can reach
    InfeasibleError
        If no route of the roadmap keeps the limit (or none was found in time): the message says how near it gets, and
        why.
    PlannerError : for planners that cannot minimise drift, with the reason, and those that know of no beacons
    ValueError : for numbers that make no sense
    KeywordError : for keywords that there are not, with the nearest one

    >>> from driftplan.beacons.beacon import BeaconKind
    >>> world = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)
    >>> noise = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
    >>> route = plan_route(world, (2, 2), (8, 2), noise, time_limit=0.3)
    >>> 13 < route.length < 14.5, 0 < route.bound <= route.rms < 0.2
    (True, True)
    >>> sign = BeaconKind.landmark(range_m=3.0, position_std_m=0.05, heading_std=0.01)
    >>> hall = World.from_polygons([], bounds=(0, 0, 60, 30), robot_radius=0.5)
    >>> asked = {"max_drift": 1.8, "minimise": "length", "planner": Planner(max_nodes=200), "time_limit": 60}
    >>> found = plan_route(hall, (2, 5), (58, 5), noise.scaled(3.0), beacons=[Beacon(sign, 30, 11)], **asked)
    >>> len(found.beacons), 56 < found.length < 62, found.worst_drift <= 1.8
    (1, True, True)

    A robot with a filter makes something of radios that tell it how far away they are:

    >>> radios = [Beacon(BeaconKind.range_only(range_m=15.0, range_std_m=0.1), x, 20) for x in (20, 40)]
    >>> fused = plan_route(hall, (2, 5), (58, 5), noise.scaled(3.0), beacons=radios, estimator="filter", **asked)
    >>> len(fused.beacons), fused.worst_drift < 1.8, fused.drift.is_fused
    (2, True, True)
    """
    reliance = Reliance.of(beacons, max_drift, max_detour, start_fix, estimator)
    search = Planner.of(planner), time_limit, iterations, seed, until
    return route_for(PlanRequest(world, (start, goal), noise, reliance, minimise, *search))


def route_for(request: PlanRequest) -> Route:
    """The route that is asked for, as `plan_route` says."""
    check_connected(request.world, request.ends)
    if not request.needs_labels:
        return route_of(request, best_unaided(request))
    if (request.ends[0] == request.ends[1]).all():
        raise ValueError(f"expected start and goal apart, got {request.ends[0].tolist()} for both")
    known = request.initial_paths
    if not request.reliance.beacons and request.minimise == "drift":  # a limit that does not bind changes nothing
        brief = replace(request, share=_UNAIDED_SHARE)
        free = route_of(brief, best_unaided(brief))
        if free.worst_drift <= request.reliance.max_drift:
            return replace(free, max_drift=request.reliance.max_drift)
        known = (*known, free.path)
    return _route_among_beacons(request, known)


def route_along(search: BeaconSearch, path: Floats, minimise: Objective) -> Route:
    """The route along a path that ``search`` found, from the exact model, with its bound."""
    check, limit = search.check, search.reliance.max_drift
    drift, verdict = check.drift(path), check.verdict(path)
    given = search.ends, search.noises, search.reliance.bounding
    if minimise == "length":
        score, bound = float(drift.length), least_length(*given, limit if math.isfinite(limit) else None)
    elif minimise == "drift":
        score, bound = verdict.end, least_end_drift(*given, verdict.end)
    else:
        score, bound = verdict.worst, least_worst_drift(*given, verdict.worst)
    status = Status.SEARCH_DONE
    if score <= bound * (1 + ROUNDING):
        status = Status.OPTIMAL
    elif search.timed_out:
        status = Status.TIME_LIMIT
    elif search.exhausted:
        status = Status.LABELS_DONE
    shortest = None
    if path is not search.shortest and length_of(path) > length_of(search.shortest) * (1 + ROUNDING):
        shortest = route_along(search, search.shortest, "length")
    return Route(
        path=path,
        drift=drift,
        planner=ROADMAP,
        minimise=minimise,
        status=status,
        bound=min(bound, score),
        shortest=shortest,
        beacons=tuple(search.beacons[i] for i in check.met(path)),
        captures=tuple(check.captures(path)),
        max_drift=limit if math.isfinite(limit) else None,
        worst_drift=check.relying(redundancy=1).verdict(path).worst,
        worst_guaranteed=verdict.worst,
        labels=search.labels,
    )


def _route_among_beacons(request: PlanRequest, known: Sequence[Floats]) -> Route:
    def late(share: float = 1.0) -> bool:
        return request.left_s(share) < 0

    given = request.world, request.world, request.ends, request.noise, request.reliance
    nodes, seed = request.planner.max_nodes, request.seed
    search = BeaconSearch(
        *given, max_nodes=nodes, seed=seed, known=known, stop=lambda: late(_SEARCH_SHARE), stop_shortening=late
    )
    path = search.best(request.minimise)
    if path is None:
        search.stop = lambda: late(2.0)
        raise InfeasibleError(why_infeasible(search, request.reliance.max_drift, search.max_length(request.minimise)))
    return route_along(search, path, request.minimise)


def route_of(request: PlanRequest, found: Unaided) -> Route:
    """The route along the path that was found for a robot that reads nothing."""
    route = _dead_reckoned(request, request.minimise, found.path, found)
    if request.minimise == "length" or (request.ends[0] == request.ends[1]).all():
        return route
    return replace(route, shortest=_dead_reckoned(request, "length", found.shortest, found))


def _dead_reckoned(request: PlanRequest, minimise: Objective, path: Floats, found: Unaided) -> Route:
    """The route along a path on which nothing is read."""
    fixes = () if request.reliance.start_fix is None else (request.reliance.start_fix,)
    drift = exact_drift(request.world, path, request.noise, request.reliance.start_heading, fixes)
    score, bound, heading_std = float(drift.length), found.least.length, math.inf
    if minimise != "length":
        noises = noises_on(request.world, request.noise)
        mean_square, heading_std = found.least.bound(noises, float(drift.end.heading_std))
        score, bound = float(drift.end.rms), math.sqrt(mean_square)
    worst = worst_rms(drift)
    return Route(
        path=path,
        drift=drift,
        planner=request.planner.name,
        minimise=minimise,
        status=Status.OPTIMAL if score <= bound * (1 + ROUNDING) else found.status,
        bound=min(bound, score),
        bound_heading_std=heading_std,
        worst_drift=worst,
        worst_guaranteed=worst,
    )
