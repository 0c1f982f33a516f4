"""Two hundred trips on a map of 5000 x 5000 cells, and how good the routes are against one search for each alone.

Times are processor seconds of this process and its children, and seconds on the wall; on a busy machine the latter say
little.

    python -m tests.benchmarks trips
"""

from __future__ import annotations

import os
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from driftplan.model.noise import OdometryNoise
from driftplan.planning.many_routes import plan_routes
from driftplan.planning.roadmap.growth import RoadmapSearch
from driftplan.planning.roadmap.prices import AdditiveCost
from driftplan.planning.routes import plan_route
from driftplan.world.mapfiles import load_world
from driftplan.world.world import World

NOISE = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
CELLS, CELL_M, ROOM = 5000, 0.05, 500  # along each side; cells along the side of a room
TRIPS, COMPARED = 200, 12
ALONE_S = (None, 20.0)  # time limits of the searches to compare with


def big_map() -> NDArray[np.uint8]:
    """Rooms with doors in their walls, and boxes strewn about: 254 is free, 0 occupied."""
    rng = np.random.default_rng(0)
    cells = np.full((CELLS, CELLS), 254, np.uint8)
    for _ in range(1500):
        width, height = rng.integers(10, 160, 2)
        x, y = rng.integers(0, CELLS - 160, 2)
        cells[y : y + height, x : x + width] = 0
    for k in range(ROOM, CELLS, ROOM):
        for walls in (cells, cells.T):
            walls[k : k + 8] = 0
            for door in rng.integers(50, CELLS - 150, 12):
                walls[k - 20 : k + 28, door : door + 100] = 254
    cells[:8] = cells[-8:] = 0
    cells[:, :8] = cells[:, -8:] = 0
    return cells


def load() -> World:
    with TemporaryDirectory() as folder:
        file = Path(folder) / "big.yaml"
        file.with_suffix(".pgm").write_bytes(b"P5\n%d %d\n255\n" % (CELLS, CELLS) + big_map().tobytes())
        file.write_text(
            f"image: big.pgm\nresolution: {CELL_M}\norigin: [0.0, 0.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\n"
            "free_thresh: 0.196\n"
        )
        return load_world(file, robot_radius=0.3)


def trips_through(world: World) -> NDArray[np.float64]:
    """Start and goal of each in the largest part of free space, (n, 2, 2)."""
    points = np.random.default_rng(1).uniform(0, CELLS * CELL_M, (20 * TRIPS, 2))
    return points[world.free_part(points) == 0][: 2 * TRIPS].reshape(-1, 2, 2)


def spent() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def two_batches(world: World, trips: NDArray[np.float64]) -> list[float]:
    """Seconds of processor for two batches of a roadmap, of which the graph of the world is the second, for each trip:
    what `RoadmapPlanner` does for a goal after another, cleared in between."""
    taken = []
    for start, goal in trips:
        began = time.process_time()
        search = RoadmapSearch(AdditiveCost(world, goal, NOISE), start)
        search.grow()
        search.grow()
        taken.append(time.process_time() - began)
    return taken


def main() -> None:
    from tests.benchmarks.bench_time_limits import maps, trips_on  # which imports this module

    world = load()
    trips = trips_through(world)  # the world is inflated for that
    for name, small in (*maps(), ("5000 x 5000", world)):
        small.free_parts  # noqa: B018  # inflated, the others too
        first, *later = two_batches(small, trips_on(small, COMPARED))
        print(f"two batches on {name}: {first:.2f} s of processor, then {np.median(later):.3f} s", flush=True)
    world = replace(world)
    trips = trips_through(world)
    busy = os.getloadavg()[0]
    began, processor = time.monotonic(), spent()
    routes = plan_routes(world, trips, NOISE)
    print(
        f"{len(routes)} trips, graph included: {time.monotonic() - began:.1f} s on the wall (load before: {busy:.1f}), "
        f"{spent() - processor:.1f} s of processor"
    )
    for limit in ALONE_S:
        processor, ratios = spent(), []
        for trip, route in zip(trips[:COMPARED], routes, strict=False):
            alone = plan_route(world, *trip, NOISE, time_limit=limit)
            ratios.append(route.rms / alone.rms)
        print(
            f"rms over that of plan_route(time_limit={limit}), {(spent() - processor) / COMPARED:.2f} s of processor "
            f"each: median {np.median(ratios):.4f}, least {min(ratios):.4f}, most {max(ratios):.4f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
