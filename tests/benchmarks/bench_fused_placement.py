"""place_beacons for robots that fuse their readings: how many beacons, the bound, the gap, the time.

The demo's rounds, a corridor, ten aisles, the routes of the warehouse of `bench_placement`, and routes through nav2's
depot (in ``../shared/data`` or the folder that DRIFTPLAN_DATA names; left out without it), with resets beside; the six
routes of the study example.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from driftplan import BeaconKind, OdometryNoise, Sites, bundled_map, load_world, place_beacons, run_study
from driftplan.layouts.scenario import grid_sites
from driftplan.report.commands.demo import ROUNDS
from tests.benchmarks.bench_placement import shelf_routes, sites_of, warehouse
from tests.benchmarks.bench_time_limits import DATA
from tests.layouts.test_placement_depot import routes_in

ROUGH = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
FINE = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
TAG, SHORT_TAG = BeaconKind.rfid(1.5, 0.1), BeaconKind.rfid(1.0, 0.1)
TIME_LIMIT_S = 60.0
STUDY = Path(__file__).resolve().parents[2] / "examples/beacon_layout_study.yaml"


def aisles(number: int, length_m: float) -> list[tuple[float, float]]:
    """Aisles 3 m apart, driven one after the other, there and back in turn."""
    return [point for k in range(number) for point in ((3.0 * k, 0.0), (3.0 * k, length_m))[:: 1 - 2 * (k % 2)]]


def cases() -> dict[str, tuple[Any, Any, OdometryNoise, float, Sites]]:
    hall = load_world(bundled_map("warehouse"), robot_radius=0.4)
    world, middles, cross = warehouse(1.0)
    routes = shelf_routes(60, middles, cross, np.random.default_rng(1))
    found = {
        "demo's rounds": (hall, ROUNDS, ROUGH, 0.8, Sites(TAG, spacing_m=1.5)),
        "corridor 500 m": (None, [(0, 0), (500, 0)], FINE, 0.3, Sites(SHORT_TAG, spacing_m=1.0)),
        "ten aisles": (None, aisles(10, 40.0), FINE, 0.3, Sites(SHORT_TAG, spacing_m=1.0)),
        "60 shelf routes": (world, routes, ROUGH, 0.8, Sites(TAG, points=sites_of(world, 1250))),
        "the same, 0.3 m": (world, routes, FINE, 0.3, Sites(TAG, points=sites_of(world, 1461))),
    }
    if (map_file := DATA / "nav2_depot/depot.yaml").exists():  # 1.86 km
        depot = load_world(map_file, robot_radius=0.25)
        routes, sites = routes_in(depot, 60, np.random.default_rng(4)), Sites(SHORT_TAG, points=grid_sites(depot, 0.56))
        found["60 depot routes"] = depot, routes, ROUGH, 0.3, sites
    return found


def main() -> None:
    """Print the table."""
    titles = ("case", "estimator", "sites", "beacons", "bound", "gap %", "wall s", "cpu s")
    print("".join(f"{title:>{width}}" for title, width in zip(titles, (16, 11, 7, 9, 7, 7, 8, 7), strict=True)))
    for name, case in cases().items():
        world, routes, noise, limit, sites = case
        for estimator in ("reset", "filter"):
            begin, cpu = time.perf_counter(), time.process_time()
            layout = place_beacons(world, routes, noise, limit, sites, estimator=estimator, time_limit=TIME_LIMIT_S)
            number = len(sites.listed(world, layout.scenario.routes).new)
            print(
                f"{name:>16} {estimator:>10} {number:6d} {len(layout.beacons):8d} {layout.lower_bound:6g} "
                f"{100 * layout.gap:6.1f} {time.perf_counter() - begin:7.1f} {time.process_time() - cpu:6.1f}",
                flush=True,
            )
    studied()


def studied() -> None:
    """The six routes of the study example at 0.5 m."""
    asked = yaml.safe_load(STUDY.read_text())
    del asked["vary"]
    begin, cpu = time.perf_counter(), time.process_time()
    (row,) = run_study({**asked, "limit_m": 0.5, "estimator": "filter", "time_limit_s": TIME_LIMIT_S}).to_dicts()
    took = f"{time.perf_counter() - begin:.1f} s, {time.process_time() - cpu:.1f} s of processor"
    print(f"six routes of the study example at 0.5 m: {row['beacons']}, at least {row['lower_bound']:g}; {took}")


if __name__ == "__main__":
    main()
