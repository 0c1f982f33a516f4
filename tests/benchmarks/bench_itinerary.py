"""Itineraries among 200 beacons on a roadmap of 1000 nodes; growth with beacons and nodes; co-design of four trips."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from driftplan import InfeasibleError, OdometryNoise, Trip, World, bundled_map, co_design, load_world
from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.planning.request import DriftLimit, Planner
from driftplan.planning.routes import Route, plan_route

BERLIN = Path(__file__).resolve().parents[2] / "../shared/data/movingai/Berlin_1_256.map"
NOISE = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.1, after_m=10.0)


def scattered(world: World, count: int, range_m: float) -> list[Beacon]:
    """Tags and, every fourth, a landmark, at random free places."""
    tag = BeaconKind.rfid(range_m=range_m, position_std_m=0.1)
    sign = BeaconKind.landmark(range_m=1.5 * range_m, position_std_m=0.05, heading_std=0.01)
    xmin, ymin, xmax, ymax = world.bounds
    points = np.random.default_rng(1).uniform((xmin, ymin), (xmax, ymax), (20 * count, 2))
    points = points[world.is_free(points)][:count]
    return [Beacon(sign if k % 4 == 0 else tag, *xy) for k, xy in enumerate(points)]


def timed(
    title: str, world: World, ends: np.ndarray, beacons: list[Beacon], max_nodes: int = 1000, **asked: object
) -> Route | None:
    began, cpu = time.perf_counter(), time.process_time()
    try:
        options = {"minimise": "length", "planner": Planner(max_nodes=max_nodes), **asked}
        found = plan_route(world, *ends, NOISE, beacons=beacons, **options)  # type: ignore[arg-type]
        said = (
            f"{found.length:7.2f} m (shortest {found.shortest_length:.2f}), worst {found.worst_drift:.3f} m, "
            f"end {found.rms:.3f} m, {len(found.beacons)} beacons, {found.labels} labels"
        )
    except InfeasibleError as err:
        found, said = None, str(err)[:100]
    took = f"{time.perf_counter() - began:5.2f} s, {time.process_time() - cpu:5.2f} s of processor"
    print(f"{title:42s} {took}: {said}", flush=True)
    return found


def main() -> None:
    warehouse = load_world(bundled_map("warehouse"), robot_radius=0.3)
    places: dict[str, tuple[World, np.ndarray, float, tuple[float, ...]]] = {
        "warehouse": (warehouse, np.array([(51.0, 33.0), (23.5, 18.7)]), 1.5, (0.4, 0.25))
    }
    if BERLIN.exists():
        berlin = load_world(BERLIN, robot_radius=0.3)
        ends = np.array([berlin.nearest_free((20.0, 20.0)), berlin.nearest_free((236.0, 236.0))])
        places["Berlin"] = (berlin, ends, 8.0, (6.0, 4.0))
    else:
        print("Berlin: map not there, left out")
    for name, (world, ends, range_m, limits) in places.items():
        beacons = scattered(world, 200, range_m)
        timed(f"{name}: 200 beacons, no limit", world, ends, beacons, max_nodes=1000)
        for limit in limits:
            timed(f"{name}: 200 beacons, limit {limit:.2f} m", world, ends, beacons, max_nodes=1000, max_drift=limit)
        limit = limits[0]
        longer, sturdy = {"time_limit": 60.0}, DriftLimit(limit, redundancy=2)  # so that it ends by itself
        timed(f"{name}: any one dead, limit {limit:.2f} m", world, ends, beacons, max_drift=sturdy, **longer)
        timed(f"{name}: least worst drift", world, ends, beacons, minimise="worst_drift", **longer)
        timed(f"{name}: least drift at the goal", world, ends, beacons, minimise="drift", **longer)
        timed(f"{name}: limit {limit:.2f} m, filter", world, ends, beacons, max_drift=limit, estimator="filter")
        for nodes in (100, 1000):
            fused = {"minimise": "worst_drift", "estimator": "filter", "max_nodes": nodes}
            timed(f"{name}: least worst drift, filter, {nodes} nodes", world, ends, beacons, **fused, **longer)
    world, ends, range_m, _ = places["warehouse"]
    for count in (25, 50, 100, 200, 400):
        timed(f"warehouse: {count} beacons, limit 1 m", world, ends, scattered(world, count, range_m), max_drift=1.0)
    for nodes in (250, 500, 1000, 2000, 4000):
        title = f"warehouse: 50 beacons, {nodes} nodes, limit 0.6 m"
        timed(title, world, ends, scattered(world, 50, range_m), max_drift=0.6, max_nodes=nodes, time_limit=60.0)
    designed(world)


def designed(world: World) -> None:
    """Four trips through the warehouse, beacons and routes chosen together."""
    marker = BeaconKind.landmark(range_m=2.0, position_std_m=0.05, heading_std=0.01, cost=100.0)
    trips = [
        Trip((3, 3), (56, 36), 1),
        Trip((3, 36), (56, 3), 3),
        Trip((3, 20), (55.5, 20), 2),
        Trip((51, 33), (23.5, 18.7), 4),
    ]
    began, cpu = time.perf_counter(), time.process_time()
    found = co_design(world, trips, NOISE, 0.6, marker, price_per_m=1.0, time_limit=600, max_nodes=250)
    took = f"{time.perf_counter() - began:5.2f} s, {time.process_time() - cpu:5.2f} s of processor"
    before = found.baseline.cost if found.baseline is not None else float("inf")
    print(f"{'warehouse: co-design of 4 trips':42s} {took}: cost {found.cost:.0f} instead of {before:.0f}", flush=True)


if __name__ == "__main__":
    main()
