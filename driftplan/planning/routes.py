"""plan_route: the route on which a robot arrives with the least drift."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from dataclasses import replace as changed
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats
from driftplan.errors import NoPathError
from driftplan.model.drift import Drift
from driftplan.model.noise import OdometryNoise
from driftplan.planning.bounds import DeadReckoningBound
from driftplan.planning.roadmap.polish import polished
from driftplan.planning.roadmap.prices import Pricing, exact_drift, noises_of
from driftplan.planning.roadmap.search import Status, check_connected, checked_ends, plan_on_roadmap, said
from driftplan.world.world import World
from driftplan.world.zones import Zone

Minimise = Literal["drift", "length"]
ROADMAP = "roadmap"
_SHARE_OF_SHORTEST = 0.2  # of the time, for the shortest route, whose polished form is a candidate too
_DETOUR_TRIALS = 5
_SEEDS = 2**31  # what OMPL takes, and one less
_SECONDS = 1.0  # of search, unless told otherwise
_NO_LIMIT_S = 1e8  # three years


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Route:
    """A collision-free route and the drift along it.

    Attributes
    ----------
    path : (n, 2) array
        Waypoints in metres, world frame.
    drift : Drift
        Exact along the path, with the noise of the zones it crosses.
    planner : str
        Which planner found it.
    minimise : {"drift", "length"}
        What it minimises.
    status : Status
        Why the search ended, a sentence for people.
    bound : float
        Proven lower bound of what was minimised: rms drift at the goal or length, in metres. Of the paths of the
        roadmap, when that found the route; else of all routes, taking no notice of obstacles.
    bound_covers : {"roadmap", "all routes"}
        Which of the two.
    shortest : Route or None
        The shortest route that the same search came by; this one has no more drift. None if this is a shortest one.
    """

    path: Floats
    drift: Drift
    planner: str
    minimise: Minimise
    status: Status
    bound: float
    bound_covers: Literal["roadmap", "all routes"]
    shortest: Route | None = None

    @property
    def length(self) -> float:
        """Metres."""
        return float(self.drift.length)

    @property
    def rms(self) -> float:
        """rms drift at the goal, metres."""
        return float(self.drift.end.rms)

    def __repr__(self) -> str:
        """What a person would want to know, not a page of waypoints."""
        return (
            f"{type(self).__name__}({self.length:.2f} m, rms {self.rms:.4g} m at the goal, least {self.minimise} of "
            f"{self.planner}, {len(self.path)} waypoints, {self.status.name.lower()})"
        )


def plan_route(
    world: World,
    start: ArrayLike,
    goal: ArrayLike,
    noise: OdometryNoise,
    *,
    minimise: Minimise = "drift",
    planner: str = ROADMAP,
    max_detour: float | None = None,
    candidates: Iterable[ArrayLike] = (),
    start_heading: float | None = None,
    time_limit: float | None = None,
    iterations: int | None = None,
    seed: int = 0,
) -> Route:
    """The collision-free route on which odometry drifts least by the time the robot is at the goal.

    The planner minimises the additive upper bound of E|e|² (`driftplan.planning.cost`); what it finds is polished, and
    of all candidates (as found, polished, the shortest route the same planner finds, that polished, and yours) the
    one with the least exact drift is returned.

    Parameters
    ----------
    world : World
        Its zones override ``noise`` where they are.
    start, goal : (2,)
        Metres, world frame.
    noise : OdometryNoise
    minimise : {"drift", "length"}
        rms drift at the goal, or length.
    planner : str
        "roadmap", or of OMPL "rrtstar", "informed_rrtstar", "sorrtstar", "bitstar".
    max_detour : float, optional
        Greatest length as a multiple of the shortest route found, >= 1.
    candidates : iterable of (n, 2)
        Other paths from start to goal to be considered; the route is never worse than the best of them. A path that
        collides is refused.
    start_heading : float, optional
        Heading at the start, rad: then the first turn counts too.
    time_limit : float, optional
        Seconds of search; default 1, and none with ``iterations``. While no path is known, four batches of the roadmap
        are completed in any case. Not counted: growing the obstacles by the robot's radius, once for a world, and
        polishing the paths of OMPL's planners.
    iterations : int, optional
        Ends every search after so many: batches of the roadmap (each has twice as many samples as the one before), or
        iterations of OMPL's planners. The same seed then gives the same route, to the last bit.
    seed : int
        Same seed, same samples; how many are drawn depends on the time, unless ``iterations`` says.

    Returns
    -------
    Route

    Raises
    ------
    StartError, GoalError
        If start or goal is not in free space; the message names the nearest point that is.
    NoPathError
        If no route leads there: the message says what part of the map the start can reach.
    PlannerError
        For planners that cannot minimise drift, with the reason.
    ValueError
        For numbers that make no sense.

    Examples
    --------
    >>> world = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)
    >>> noise = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
    >>> route = plan_route(world, (2, 2), (8, 2), noise, time_limit=0.3)
    >>> 13 < route.length < 14.5, 0 < route.bound <= route.rms < 0.2
    (True, True)
    """
    if minimise not in get_args(Minimise):
        raise ValueError(f"expected minimise one of {get_args(Minimise)}, got {minimise!r}")
    if max_detour is not None and not (math.isfinite(max_detour) and max_detour >= 1):
        raise ValueError(f"expected max_detour >= 1, got {max_detour!r}")
    if max_detour is not None and minimise == "length":
        raise ValueError("expected no max_detour with minimise='length', which makes none: got both")
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or not 0 <= seed < _SEEDS:
        raise ValueError(f"expected seed a whole number >= 0 and < {_SEEDS}, got {seed!r}")
    if iterations is not None and not (isinstance(iterations, (int, np.integer)) and iterations >= 1):
        raise ValueError(f"expected iterations a whole number >= 1, got {iterations!r}")
    if planner != ROADMAP:
        from driftplan.planning.ompl.solve import check_planner

        check_planner(planner, also=(ROADMAP,))
    seconds = time_limit if time_limit is not None else _SECONDS if iterations is None else _NO_LIMIT_S
    ends = checked_ends(world, start, goal, noise, minimise, seconds, None, start_heading)
    check_connected(world, ends)
    given = [_candidate(world, ends, path) for path in candidates]
    search = _Search(world, ends, noise, planner, start_heading, int(seed), iterations)
    if (ends[0] == ends[1]).all():
        return search.route(ends, minimise, _Found((ends,), Status.OPTIMAL, 0.0))
    if minimise == "length":
        found = search.run("length", world, seconds, candidates=given)
        pool = [*found.paths, *given]
        return search.route(min(search.some(pool, seconds), key=_length), "length", found)

    brief = search.run("length", world, _SHARE_OF_SHORTEST * seconds, candidates=given)
    known = [*given, *brief.paths]
    shares = 1 if max_detour is None else 1 + _DETOUR_TRIALS
    each = (1 - _SHARE_OF_SHORTEST) * seconds / shares
    found = search.run("drift", world, each, candidates=known)
    pool = [*known, *found.paths]
    if planner != ROADMAP:  # which has polished what it was given
        pool += [search.polish(path) for path in brief.paths]
    shortest = min(search.some(pool, seconds), key=_length)
    longest = math.inf if max_detour is None else max_detour * _length(shortest)
    if found.paths and all(_length(path) > longest for path in found.paths):
        pool += search.within_detour(longest, each)
    fitting = [path for path in pool if _length(path) <= longest * (1 + 1e-9)]
    route = search.route(min(fitting, key=search.mean_square), "drift", found)
    return changed(route, shortest=search.route(shortest, "length", brief))


class _Found(NamedTuple):
    """What one search came back with; the bound is of its roadmap, in m² or m."""

    paths: tuple[Floats, ...]
    status: Status
    bound: float | None


class _Search:
    """The searches of one call of `plan_route`."""

    def __init__(
        self,
        world: World,
        ends: Floats,
        noise: OdometryNoise,
        planner: str,
        start_heading: float | None,
        seed: int,
        iterations: int | None,
    ) -> None:
        self.world, self.ends, self.noise = world, ends, noise
        self.planner, self.start_heading, self.seed, self.iterations = planner, start_heading, seed, iterations

    def some(self, pool: list[Floats], time_limit: float) -> list[Floats]:
        """The paths, if there are any."""
        if not pool:
            within = f"{time_limit:g} s" if self.iterations is None else f"{self.iterations} iterations"
            raise NoPathError(
                f"{self.planner} found no path from {said(self.ends[0])} to {said(self.ends[1])} within {within}, "
                "though free space connects them: allow more"
                + (f", or use planner={ROADMAP!r}" if self.planner != ROADMAP else "")
            )
        return pool

    def run(
        self,
        minimise: Minimise,
        world: World,
        time_limit: float,
        noise: OdometryNoise | None = None,
        candidates: Sequence[Floats] = (),
    ) -> _Found:
        """The planner's best path, as it is and polished; no path if it found none in time.

        The roadmap begins with the ``candidates``; OMPL's planners cannot be told.
        """
        noise = noise or self.noise
        if self.planner == ROADMAP:
            try:
                result = plan_on_roadmap(
                    world,
                    self.ends[0],
                    self.ends[1],
                    noise,
                    minimise=minimise,
                    time_limit=time_limit,
                    batches=self.iterations,
                    seed=self.seed,
                    start_heading=self.start_heading,
                    candidates=candidates,
                )
            except NoPathError:
                return _Found((), Status.TIME_LIMIT, None)
            return _Found((result.path,), result.status, result.bound)
        from driftplan.planning.ompl.solve import solve

        priced = noise if minimise == "drift" else None
        began = time.perf_counter()
        raw = solve(
            world,
            self.ends[0],
            self.ends[1],
            priced,
            planner=self.planner,
            time_limit=time_limit,
            iterations=self.iterations,
            seed=self.seed,
        )
        in_time = self.iterations is not None and time.perf_counter() - began < time_limit
        status = Status.ITERATIONS_DONE if in_time else Status.TIME_LIMIT
        if raw is None:
            return _Found((), status, None)
        pricing = Pricing(world, self.ends[1], noise, minimise)
        return _Found((raw, polished(pricing, raw, self.start_heading)), status, None)

    def polish(self, path: Floats) -> Floats:
        return polished(Pricing(self.world, self.ends[1], self.noise, "drift"), path, self.start_heading)

    def within_detour(self, longest: float, time_limit: float) -> list[Floats]:
        """Paths of low drift no longer than ``longest``: a price on length is raised until they fit, then refined.

        A price per metre is a distance variance per metre to the additive cost, here and in the zones. It finds the
        routes that are best for some price, which not every route that is best for its length is.
        """
        straight = float(np.linalg.norm(self.ends[1] - self.ends[0]))
        low, high = 0.0, self.noise.heading_var_per_m * straight**2 + self.noise.distance_var_per_m + 1e-9
        fitting: list[Floats] = []
        for _ in range(_DETOUR_TRIALS):
            price = high if not fitting else math.sqrt(max(low, high * 1e-3) * high)
            zones = tuple(Zone(zone.polygon, _dearer(zone.noise, price)) for zone in self.world.zones)
            world = changed(self.world, zones=zones) if zones else self.world
            paths = self.run("drift", world, time_limit, noise=_dearer(self.noise, price)).paths
            fits = [path for path in paths if _length(path) <= longest]
            fitting += fits
            if fits:
                high = price
            else:
                low, high = price, (4 * price if not fitting else high)
        return fitting

    def mean_square(self, path: Floats) -> float:
        return float(exact_drift(self.world, path, self.noise, self.start_heading).end.rms ** 2)

    def route(self, path: Floats, minimise: Minimise, found: _Found) -> Route:
        drift = exact_drift(self.world, path, self.noise, self.start_heading)
        straight = float(np.linalg.norm(self.ends[1] - self.ends[0]))
        score = float(drift.length) if minimise == "length" else float(drift.end.rms) ** 2
        bound = found.bound
        if bound is None:
            unaided = DeadReckoningBound(noises_of(self.world, self.noise), (), score)
            bound = straight if minimise == "length" else min(float(unaided.square(np.asarray(straight))), score)
        bound = min(bound, score)  # a candidate may beat the roadmap
        return Route(
            path=path,
            drift=drift,
            planner=self.planner,
            minimise=minimise,
            status=found.status,
            bound=bound if minimise == "length" else math.sqrt(bound),
            bound_covers="all routes" if found.bound is None else "roadmap",
        )


def _candidate(world: World, ends: Floats, path: ArrayLike) -> Floats:
    """A path of the caller's, after it has been looked at."""
    points = np.asarray(path, dtype=float)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2 or not np.isfinite(points).all():
        raise ValueError(f"expected candidates of at least 2 finite waypoints, shape (n, 2), got shape {points.shape}")
    if not (np.allclose(points[0], ends[0]) and np.allclose(points[-1], ends[1])):
        raise ValueError(
            f"expected candidates from {said(ends[0])} to {said(ends[1])}, got one from {said(points[0])} to "
            f"{said(points[-1])}"
        )
    points = np.concatenate([ends[:1], points[1:-1], ends[1:]])  # to the last digit
    free = world.segments_free(points[:-1], points[1:])
    if not free.all():
        leg = int(np.argmin(free))
        raise ValueError(
            f"expected candidates free of collisions, got one that collides between {said(points[leg])} and "
            f"{said(points[leg + 1])}"
        )
    return points


def _dearer(noise: OdometryNoise, price_per_m: float) -> OdometryNoise:
    return changed(noise, distance_var_per_m=noise.distance_var_per_m + price_per_m)


def _length(path: Floats) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
