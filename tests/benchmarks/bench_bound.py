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
from driftplan.world.mapfiles import bundled_map, load_world
from driftplan.world.world import World
from driftplan.world.zones import Zone

NOISE = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
QUERIES = 12


def bounds_on(name: str) -> None:
    world = replace(load_world(bundled_map(name), robot_radius=0.3), zones=())
    room, rng, rows = world.free_parts[0], np.random.default_rng(0), []
    while len(rows) < QUERIES:
        start, goal = rng.uniform(room.bounds[:2], room.bounds[2:], (2, 2))
        if not shapely.contains_xy(room, *np.array([start, goal]).T).all():
            continue
        route = plan_route(world, start, goal, NOISE, iterations=4)
        cost = LeastRoute.of_path(route.path).cost([NOISE])
        began = time.process_time()
        least = tight_least_route(world, route.path, NOISE)
        middle = time.process_time()
        first = taut_route(world, start, goal, 0.02)
        ended = time.process_time()
        string = np.nan if first is None else LeastRoute.of_path(first).cost([NOISE]) / cost
        rows.append((least.cost([NOISE]) / cost, middle - began, string, ended - middle))
    share, seconds, string, to_route = np.array(rows).T
    print(
        f"{name:10}  bound/route median {np.median(share):.4f}, least {share.min():.4f}, {np.median(seconds):.3f} s; "
        f"string/route median {np.nanmedian(string):.4f}, most {np.nanmax(string):.4f}, {np.median(to_route):.3f} s"
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
    for name in ("warehouse", "office"):
        bounds_on(name)
    for reach in (1.0, 5.0, 100.0):
        (few, cut), (many, often) = zone_price(10, reach), zone_price(1000, reach)
        print(
            f"motions of {reach:g} m: {few:.1f} us with 10 zones, {many:.1f} us with 1000: {many / few:.1f} times; "
            f"{cut:.2f} and {often:.2f} pieces, {many / often / few * cut:.1f} times for each"
        )


if __name__ == "__main__":
    main()
