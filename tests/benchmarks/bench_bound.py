"""The bound over all routes among the obstacles against the route found, and what zones cost when there are many.

Processor time of this process, so that other load counts little.

    python -m tests.benchmarks bound
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import shapely
from ompl import base as ob

from driftplan.model.noise import OdometryNoise
from driftplan.planning.ompl.objective import DriftObjective
from driftplan.planning.routes import plan_route
from driftplan.planning.taut_strings import LeastRoute, taut_route, tight_least_route
from driftplan.world.world import World
from driftplan.world.zones import Zone
from tests.benchmarks.bench_time_limits import maps, trips_on

NOISE = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
QUERIES = 12
EXACT = ("RMF office", "office")  # small enough for a visibility graph of all corners


def bounds_on(name: str, world: World) -> None:
    rows = []
    for start, goal in trips_on(world, QUERIES):
        route = plan_route(world, start, goal, NOISE, iterations=4)
        cost = LeastRoute.of_path(route.path).cost([NOISE])
        began = time.process_time()
        least = tight_least_route(world, route.path, NOISE)
        middle = time.process_time()
        first = taut_route(world, start, goal, 0.02)
        ended = time.process_time()
        string = np.nan if first is None else LeastRoute.of_path(first).cost([NOISE]) / cost
        rows.append((least.cost([NOISE]) / cost, route.rms / route.bound, middle - began, string, ended - middle))
    share, rms, seconds, string, to_route = np.array(rows).T
    print(
        f"{name:10}  bound/cost median {np.median(share):.4f}, least {share.min():.4f}, rms/bound median "
        f"{np.median(rms):.4f}, most {rms.max():.4f}; {np.median(seconds):.3f} s, most {seconds.max():.2f}; "
        f"string/cost median {np.nanmedian(string):.4f}, most {np.nanmax(string):.4f}, {np.median(to_route):.3f} s",
        flush=True,
    )


def lengths_on(name: str, world: World) -> None:
    """The shortest routes against those of extremitypathfinder, which are exact where they do not cross an obstacle."""
    try:
        from extremitypathfinder import PolygonEnvironment
    except ImportError:
        print("lengths: left out, `pip install extremitypathfinder` brings the reference")
        return
    room = shapely.orient_polygons(world.free_parts[0])
    exact, began = PolygonEnvironment(), time.process_time()
    exact.store(
        shapely.get_coordinates(room.exterior)[:-1], [shapely.get_coordinates(hole)[:-1] for hole in room.interiors]
    )
    prepared, found, bounds, wrong = time.process_time() - began, [], [], 0
    for start, goal in trips_on(world, QUERIES):
        path, length = exact.find_shortest_path(tuple(start), tuple(goal))
        if not shapely.covers(room.buffer(1e-6), shapely.LineString(path)):
            wrong += 1
            continue
        route = plan_route(world, start, goal, NOISE, minimise="length", iterations=4)
        found.append(route.length / length)
        bounds.append(route.bound / length)
    print(
        f"{name:10}  length/exact median {np.median(found):.6f}, most {max(found):.6f}; bound/exact median "
        f"{np.median(bounds):.5f}, {min(bounds):.5f} to {max(bounds):.6f}; exact prepared in {prepared:.1f} s; "
        f"{wrong} of its paths cross an obstacle",
        flush=True,
    )


def zone_price(count: int, reach_m: float) -> tuple[float, float]:
    """Microseconds per motion of up to ``reach_m`` along each axis, with so many zones on a floor of 100 x 100 m; and
    in how many pieces the zones cut it."""
    side = int(np.ceil(np.sqrt(count)))
    x, y = np.divmod(np.arange(count), side) * np.array([[100 / side]])
    zones = [Zone(shapely.box(a, b, a + 50 / side, b + 50 / side), NOISE) for a, b in zip(x, y, strict=True)]
    world = World.from_polygons([], bounds=(0, 0, 100, 100), robot_radius=0.1, zones=zones)
    si = ob.SpaceInformation(ob.RealVectorStateSpace(2))
    objective, rng, pairs = DriftObjective(si, NOISE, (99.0, 99.0), world), np.random.default_rng(1), []
    for _ in range(300):
        a, b = si.allocState(), si.allocState()
        a[0], a[1] = rng.uniform(5, 95, 2).tolist()
        b[0], b[1] = a[0] + float(rng.uniform(-reach_m, reach_m)), a[1] + float(rng.uniform(-reach_m, reach_m))
        pairs.append((a, b))
    best = np.inf
    for _ in range(5):
        began = time.process_time()
        for a, b in pairs:
            objective.motionCost(a, b)
        best = min(best, (time.process_time() - began) / len(pairs) * 1e6)
    ends = np.array([[(a[0], a[1]), (b[0], b[1])] for a, b in pairs])
    return float(best), len(world.zone_pieces(ends[:, 0], ends[:, 1]).segment) / len(pairs)


def main() -> None:
    for name, world in maps():
        bounds_on(name, replace(world, zones=()))
    for name in EXACT:
        lengths_on(name, dict(maps())[name])
    for reach in (1.0, 5.0, 100.0):
        (few, cut), (many, often) = zone_price(10, reach), zone_price(1000, reach)
        print(
            f"motions of {reach:g} m: {few:.1f} us with 10 zones, {many:.1f} us with 1000: {many / few:.1f} times; "
            f"{cut:.2f} and {often:.2f} pieces, {many / often / few * cut:.1f} times for each"
        )


if __name__ == "__main__":
    main()
