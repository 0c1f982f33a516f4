"""How well `plan_route` keeps its time limit: on every map at hand, in the first call of a process and in a later one.

Its clock is replaced by the processor time of the process. Other load adds to that too, so each trip is made in three
processes, of which the best counts. What is printed is the greatest overrun of any trip, in seconds; a limit is kept
where that is at most 20 % of it and 0.1 s.

    python -m tests.benchmarks time_limits
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import shapely

from driftplan.errors import NoPathError
from driftplan.model.noise import OdometryNoise
from driftplan.planning.request import Planner
from driftplan.planning.routes import plan_route
from driftplan.world.mapfiles import bundled_map, load_world
from driftplan.world.world import World
from driftplan.world.zones import Zone
from tests.benchmarks import bench_trips

NOISE = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
DATA = Path(os.environ.get("DRIFTPLAN_DATA", Path(__file__).resolve().parents[2] / "../shared/data"))
OUTSIDE = {
    "depot": "nav2_depot/depot.yaml",
    "Berlin": "movingai/Berlin_1_256.map",
    "room-64": "movingai/room-64-64-8.map",
    "RMF office": "open_rmf/office.building.yaml",
}
LIMITS_S = tuple(map(float, os.environ.get("BENCH_LIMITS", "0.05 0.3 1 3").split()))
TRIPS = 3  # one only where the limit is a second or more
TRIED = 3
PROCESSES = multiprocessing.get_context("fork")
ASKED: dict[str, dict[str, Any]] = {
    "roadmap": {},
    "roadmap, max_detour": {"max_detour": 1.1},
    "BIT*": {"planner": Planner("bitstar")},
    "RRT*": {"planner": Planner("rrtstar")},
}


def maps() -> Iterator[tuple[str, World]]:
    """Bundled ones, and public ones where they are at hand."""
    for name in ("warehouse", "office"):
        yield name, load_world(bundled_map(name), robot_radius=0.3)
    for name, file in OUTSIDE.items():
        if (DATA / file).exists():
            yield name, load_world(DATA / file, robot_radius=0.3)


def zoned(count: int) -> World:
    """The bundled warehouse with a grid of zones."""
    world, side = load_world(bundled_map("warehouse"), robot_radius=0.3), int(np.ceil(np.sqrt(count)))
    x, y = np.divmod(np.arange(count), side) * np.array([[60 / side], [40 / side]])
    dearer = NOISE.scaled(2.0)
    boxes = shapely.box(x, y, x + 30 / side, y + 20 / side)
    return replace(world, zones=tuple(Zone(box, dearer) for box in boxes))


def trips_on(world: World, count: int, seed: int = 0) -> np.ndarray:
    """Starts and goals in the largest part of free space, (count, 2, 2)."""
    xmin, ymin, xmax, ymax = world.free_parts[0].bounds
    points = np.random.default_rng(seed).uniform((xmin, ymin), (xmax, ymax), (100 * count, 2))
    return points[world.free_part(points) == 0][: 2 * count].reshape(-1, 2, 2)


def overruns(world: World, asked: dict[str, Any], limit_s: float) -> tuple[float, float]:
    """Greatest overrun of any trip, seconds: of the first call in a process and on a world, and of a later one."""
    trips = enumerate(trips_on(world, TRIPS if limit_s < 1 else 1))
    tried = [[in_a_process(overrun, world, asked, limit_s, trip, k) for _ in range(TRIED)] for k, trip in trips]
    first, later = np.min(tried, axis=1).max(axis=0)
    return float(first), float(later)


def overrun(world: World, asked: dict[str, Any], limit_s: float, trip: np.ndarray, seed: int) -> tuple[float, float]:
    """Of the way there, which derives all of the world again, and of the way back."""
    fresh, spent = replace(world), []
    with patch.object(time, "monotonic", time.process_time), patch.object(time, "perf_counter", time.process_time):
        for start, goal in (trip, trip[::-1]):
            began = time.process_time()
            with suppress(NoPathError):  # of OMPL's planners, within so little time
                plan_route(fresh, start, goal, NOISE, time_limit=limit_s, seed=seed, **asked)
            spent.append(time.process_time() - began - limit_s)
    return spent[0], spent[1]


def in_a_process(function: Callable[..., Any], *args: Any) -> Any:
    """The value of a function called in a process of its own, in which nothing has been planned yet."""
    receive, send = PROCESSES.Pipe(duplex=False)
    process = PROCESSES.Process(target=lambda: send.send(function(*args)))
    process.start()
    value = receive.recv()
    process.join()
    return value


def main() -> None:
    for planner in os.environ.get("BENCH_PLANNERS", ";".join(ASKED)).split(";"):
        for name, world in (*maps(), ("1000 zones", zoned(1000)), ("5000 x 5000", bench_trips.load())):
            said = []
            for limit in LIMITS_S:
                worst = overruns(world, ASKED[planner], limit)
                allowed = 0.2 * limit + 0.1
                said.append(
                    f"{limit:g} s: " + " / ".join(f"{over:+.2f}{'' if over <= allowed else ' !'}" for over in worst)
                )
            print(f"{planner:20} {name:12} " + "   ".join(said))
            sys.stdout.flush()


if __name__ == "__main__":
    main()
