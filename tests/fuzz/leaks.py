"""Does one thing many times in a process of its own, and prints what it keeps: memory, open files, threads, processes.

``python -m tests.fuzz.leaks KIND COUNT``. Every call is another problem, on a world of its own or on one that all
share, so that what is kept with a world is noticed too. The first twentieth is for what is imported and cached once.
"""

from __future__ import annotations

import ctypes
import gc
import multiprocessing
import os
import resource
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np

import driftplan as d

GROWTH_MB = 6.0  # numpy keeps small blocks of every size it has met, allocators leave gaps: it ends at a few megabytes
NOISE = d.OdometryNoise(heading_var_per_m=1e-4, distance_var_per_m=1e-4)
WALLS = [[(4, 0), (5, 0), (5, 7), (4, 7)], [(8, 3), (9, 3), (9, 10), (8, 10)]]
TAG = d.BeaconKind.rfid(1.5, 0.1)
PATH = [(1, 1), (3, 8), (7, 8), (7, 2), (11, 2)]
TIMES = np.arange(40.0)


def _world() -> d.World:
    return d.World.from_polygons(WALLS, bounds=(0, 0, 13, 10), robot_radius=0.3)


SHARED = _world()


def plan(k: int, rng: np.random.Generator) -> None:
    """A route: on a world of its own or on one that is shared, of either of two planners, among beacons."""
    start, goal = (rng.uniform(0.5, 3), rng.uniform(1, 9)), (rng.uniform(10, 12), rng.uniform(1, 9))
    world, few = _world() if k % 2 else SHARED, d.Planner(max_nodes=20)
    if k % 20 == 0:
        d.plan_route(world, start, goal, NOISE, iterations=4000, planner="bitstar")
    elif k % 20 == 1:
        beacons = [d.Beacon(TAG, 6.0, 5.0)]
        d.plan_route(world, start, goal, NOISE, beacons=beacons, max_drift=5.0, iterations=1, planner=few)
    else:
        d.plan_route(world, start, goal, NOISE, iterations=1, planner=few)


def place(k: int, rng: np.random.Generator) -> None:
    """A layout for one estimator or the other, written and read back."""
    world, estimator = _world() if k % 4 < 2 else SHARED, ("reset", "filter")[k % 2]
    sites = d.Sites(TAG, spacing_m=2.0)
    layout = d.place_beacons(world, [PATH], NOISE, rng.uniform(0.2, 0.4), sites, estimator=estimator)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "tags.geojson"
        file.write_bytes(d.layout_geojson(layout))
        d.load_beacons(file)


def fit(k: int, rng: np.random.Generator) -> None:
    """A fit to a drive, every twentieth of which is read from files."""
    headings = rng.normal(0, 0.2, TIMES.size).cumsum()
    truth = np.stack([np.cos(headings), np.sin(headings)], axis=-1).cumsum(axis=0)
    headings = headings + rng.normal(0, 0.02, TIMES.size).cumsum()
    steps = rng.normal(1, 0.02, TIMES.size)[:, None] * np.stack([np.cos(headings), np.sin(headings)], axis=-1)
    poses = np.column_stack([steps.cumsum(axis=0), headings])
    if k % 20:
        d.fit_noise(d.OdometryLog.from_poses(poses), truth, resamples=100)
        return
    with tempfile.TemporaryDirectory() as folder:
        for name, columns, array in (("odometry", "x,y,heading", poses), ("truth", "x,y", truth)):
            rows = np.column_stack([TIMES, array])
            np.savetxt(Path(folder) / f"{name}.csv", rows, delimiter=",", header=f"time,{columns}", comments="")
        estimate, reference = (Path(folder) / f"{name}.csv" for name in ("odometry", "truth"))
        d.fit_noise(d.read_odometry(estimate), d.read_truth(reference), resamples=100)


KINDS: dict[str, Callable[[int, np.random.Generator], None]] = {"plan": plan, "place": place, "fit": fit}


def held() -> tuple[float, int, int]:
    """Memory in megabytes; open files; threads and child processes. What is free already goes back to the system: one
    call that needs much leaves gaps that are nothing kept."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    tasks = threading.active_count() + len(multiprocessing.active_children())
    return pages * resource.getpagesize() / 2**20, len(os.listdir("/proc/self/fd")), tasks


def main(kind: str, count: int) -> int:
    rng, warm = np.random.default_rng(0), count // 20
    before = held()
    for k in range(warm + count):
        if k == warm:
            before = held()
        KINDS[kind](k, rng)
    after = held()
    if after[0] - before[0] > GROWTH_MB or after[1:] != before[1:]:
        print(f"{kind} x {count}: (megabytes, open files, threads) were {before}, are {after}")
        return 1
    print(f"{kind} x {count}: {after[0] - before[0]:.1f} MB more", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], int(sys.argv[2])))
