"""compare_routes: routes side by side, as a table; pareto_routes: what less drift costs in length, as a few routes that
differ enough to be worth showing."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import inf
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from driftplan.beacons.beacon import Beacon
from driftplan.errors import InfeasibleError
from driftplan.model.drift import Drift
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Estimator, Fix
from driftplan.planning.collision_chance import collision_chance
from driftplan.planning.request import ROADMAP, DriftLimit, Objective, Planner, PlanRequest, Reliance
from driftplan.planning.routes import Route, route_for
from driftplan.tables import NONE, Rows, decimals, digits, yes_no
from driftplan.world.world import World


@dataclass(frozen=True, kw_only=True)
class Comparison(Rows):
    """Routes side by side; printing it prints a table.

    Attributes
    ----------
    rows : one per route: name, length_m, rms_m, bias_m (its norm), radius95_m, all at the goal, planner (None for
        paths of your own), and estimator; how many beacons each counts on, where one does; collision_free, where
        a world was given; of collisions the chance, low, high and bound (`CollisionChance`), where asked for

    >>> from driftplan import OdometryNoise, predict_drift
    >>> drives = [predict_drift([(0, 0), end], OdometryNoise(distance_var_per_m=0.01)) for end in ((9, 0), (0, 25))]
    >>> [(row["name"], round(row["rms_m"], 2)) for row in compare_routes(drives, ["east", "north"]).rows]
    [('east', 0.3), ('north', 0.5)]
    """

    def columns(self) -> dict[str, Iterable[object]]:
        """What people read: headings and cells."""
        rows = self.rows
        rms, bias, radius = digits(*([row[key] for row in rows] for key in ("rms_m", "bias_m", "radius95_m")))
        columns: dict[str, Iterable[object]] = {
            "route": [row["name"] for row in rows],
            "length m": decimals([row["length_m"] for row in rows], 2),
            "rms m": rms,
            "bias m": bias,
            "radius95 m": radius,
        }
        least = min((row["rms_m"] for row in rows if row.get("collision_free", True)), default=0.0)
        if len(rows) > 1 and least > 0:
            columns["above least %"] = [f"{100 * (row['rms_m'] / least - 1):+.1f}" for row in rows]
        if all("beacons" in row for row in rows):
            columns["beacons"] = [str(row["beacons"]) for row in rows]
        if any(row["estimator"] == "filter" for row in rows):
            columns["estimator"] = [row["estimator"] for row in rows]
        columns["planner"] = [row["planner"] or NONE for row in rows]
        if all("collision_free" in row for row in rows):
            columns["collision-free"] = yes_no(row["collision_free"] for row in rows)
        if all("collision_probability" in row for row in rows):
            columns["touches a wall %"] = decimals([100 * row["collision_probability"] for row in rows], 1)
            columns["at most %"] = decimals([100 * row["collision_bound"] for row in rows], 1)
        return columns


def compare_routes(
    routes: Sequence[Route | Drift],
    names: Sequence[str] | None = None,
    *,
    world: World | None = None,
    collisions: World | None = None,
) -> Comparison:
    """Length and drift of routes, side by side.

    Parameters
    ----------
    routes : sequence of Route or Drift; a `Drift` is that of a path of your own
    names : default: what each minimises, "given" for paths of your own
    world : say of every route whether it is free of collisions there, so that paths through walls do not set the
        standard
    collisions : say of every route how likely a robot of that world touches a wall there (`collision_chance`)

    Raises
    ------
    ValueError : for no routes, or another number of names

    >>> from driftplan import OdometryNoise, World, plan_route
    >>> world = World.from_polygons([], bounds=(0, 0, 10, 10), robot_radius=0.5)
    >>> noise = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
    >>> route = plan_route(world, (2, 2), (8, 2), noise, time_limit=0.1)
    >>> print(compare_routes([route]))
    route  length m   rms m  bias m  radius95 m  planner
    drift      6.00  0.0608  0.0003      0.1057  roadmap
    """
    if not routes or not all(isinstance(route, (Route, Drift)) for route in routes):
        raise ValueError("expected at least one Route, as plan_route returns it, or Drift, as predict_drift does")
    if names is not None and len(names) != len(routes):
        raise ValueError(f"expected a name for each of {len(routes)} routes, got {len(names)}")
    rows = tuple(_row(route, names[k] if names else None, world, collisions) for k, route in enumerate(routes))
    planned = [route if isinstance(route, Route) else None for route in routes]
    if any(route is not None and route.captures for route in planned):
        for row, route in zip(rows, planned, strict=True):
            row["beacons"] = 0 if route is None else len(route.beacons)
    return Comparison(rows=rows)


def _row(route: Route | Drift, name: str | None, world: World | None, collisions: World | None) -> dict[str, Any]:
    drift, planned = (route, None) if isinstance(route, Drift) else (route.drift, route)
    end = drift.end
    row = {
        "name": name or (planned.minimise if planned else "given"),
        "length_m": float(drift.length),
        "rms_m": float(end.rms),
        "bias_m": float(end.bias_norm),
        "radius95_m": float(end.radius(0.95)),
        "planner": planned.planner if planned else None,
        "estimator": drift.estimator,
    }
    if world is not None:
        row["collision_free"] = bool(world.segments_free(drift.xy[:-1], drift.xy[1:]).all())
    if collisions is not None:
        chance = collision_chance(drift, collisions)
        row |= {f"collision_{key}": getattr(chance, key) for key in ("probability", "low", "high", "bound")}
    return row


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
        asked, limit_s = replace(request.reliance, max_drift=max_drift), share * max(request.left_s(), 0.1)
        timed = replace(request, time_limit=limit_s, began=time.monotonic())
        return route_for(replace(timed, reliance=asked, minimise=minimise))

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
    scores = np.array([(route.length, route.worst_guaranteed, route.rms) for route in routes])
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


def _thinned(routes: list[Route], difference: float, max_routes: int) -> tuple[Route, ...]:
    """Without those that are nearly the same as a shorter one; the steadiest always stays."""
    kept: list[Route] = []
    steadiest = min(routes, key=lambda route: route.worst_guaranteed)
    score = {route: np.array([route.length, route.worst_guaranteed, route.rms]) for route in routes}
    for route in routes:
        ratio = [np.abs(np.log(score[route] / np.maximum(score[other], 1e-300))).max() for other in kept]
        if route is steadiest or min(ratio, default=inf) >= difference:
            kept.append(route)
    while len(kept) > max_routes:  # the two most alike in worst drift become one
        gaps = np.abs(np.diff(np.log([max(route.worst_guaranteed, 1e-300) for route in kept])))
        k = int(np.argmin(gaps[:-1])) if len(gaps) > 1 else 0
        del kept[k + 1 if kept[k + 1] is not steadiest else k]
    return tuple(kept)
