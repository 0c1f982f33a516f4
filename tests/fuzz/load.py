"""Threads and processes, forked and spawned, ask one world everything at once; prints what differs from one alone.

``python -m tests.fuzz.load SECONDS``. What waits for ever says where, and ends.
"""

from __future__ import annotations

import faulthandler
import functools
import itertools
import multiprocessing
import random
import sys
import threading
import time
import traceback
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from typing import Any

import numpy as np

import driftplan as d
from tests.fuzz.leaks import NOISE, PATH, TAG, WALLS

THREADS = 4
ENDS = (((1, 1), (12, 9)), ((1, 9), (10.5, 2)), ((2.5, 5), (11, 5)))
BEACONS = [d.Beacon(TAG, 6.0, 5.0), d.Beacon(TAG, 7.0, 2.0)]
FEW = d.Planner(max_nodes=20)


def new_world() -> d.World:
    floor = d.Zone([(5, 0), (8, 0), (8, 4), (5, 4)], d.OdometryNoise(heading_var_per_m=1e-3))
    return d.World.from_polygons(WALLS, bounds=(0, 0, 13, 10), robot_radius=0.3, zones=[floor])


def segments(world: d.World, seed: int) -> Any:
    a, b = np.random.default_rng(seed).uniform(0, 10, (2, 300, 2))
    found = [world.segments_free(a, b), world.is_free(a), world.free_part(a), world.line_of_sight(a, b)]
    return [part.tolist() for part in (*found, world.zone_at(a), world.zone_pieces(a, b).zone)]


def route(world: d.World, seed: int) -> Any:
    found = d.plan_route(world, *ENDS[seed], NOISE, iterations=1, planner=FEW, seed=seed)
    return found.path.tolist(), found.rms, found.bound


def tree(world: d.World, seed: int) -> Any:
    return d.plan_route(world, *ENDS[seed], NOISE, iterations=2000, planner="bitstar", seed=seed).path.tolist()


def itinerary(world: d.World, seed: int) -> Any:
    asked: dict[str, Any] = {"beacons": BEACONS, "max_drift": 5.0, "iterations": 1, "planner": FEW}
    return d.plan_route(world, *ENDS[seed], NOISE, **asked).path.tolist()


def routes(world: d.World, seed: int, workers: int = 1) -> Any:
    return [found.path.tolist() for found in d.plan_routes(world, ENDS[seed:], NOISE, workers=workers)]


def prediction(world: d.World, seed: int) -> Any:
    estimator: Any = ("reset", "filter")[seed % 2]
    found = d.drift_with_beacons(PATH, NOISE, BEACONS, world=world, estimator=estimator)
    return found.rms.tolist(), found.cov.tolist()


def layout(world: d.World, seed: int) -> Any:
    estimator: Any = ("reset", "filter")[seed % 2]
    found = d.place_beacons(world, [PATH], NOISE, 0.4, d.Sites(TAG, spacing_m=2.0), estimator=estimator)
    return sorted((beacon.x, beacon.y) for beacon in found.beacons), found.worst_drift, found.proven


Ask = Callable[[d.World, int], Any]
ALL: tuple[Ask, ...] = (segments, route, tree, itinerary, routes, prediction, layout)
ASKED = tuple(itertools.product(ALL, range(len(ENDS))))


def answer(world: d.World, k: int) -> Any:
    ask, seed = ASKED[k]
    return ask(world, seed)


def main(seconds: float) -> int:
    faulthandler.dump_traceback_later(10 * seconds + 600, exit=True)
    expected = [answer(new_world(), k) for k in range(len(ASKED))]
    world, until, faults = new_world(), time.monotonic() + seconds, list[str]()
    count, stop = itertools.count(), threading.Event()

    def check(who: str, k: int, found: Any) -> None:
        next(count)
        if found != expected[k]:
            faults.append(f"{who}: {ASKED[k][0].__name__} {ASKED[k][1]} gives {str(found)[:300]}, not {expected[k]}")

    def ask_on(thread: int) -> None:
        rng = random.Random(thread)
        while not stop.is_set():
            k = rng.randrange(len(ASKED))
            check(f"thread {thread}", k, answer(world, k))

    with ThreadPoolExecutor(THREADS) as threads:
        asking = [threads.submit(ask_on, thread) for thread in range(THREADS)]
        try:
            for method in itertools.cycle(("fork", "spawn", "of its own")):
                if time.monotonic() > until or any(thread.done() for thread in asking):
                    break
                if method == "of its own":  # processes that a call starts itself
                    k = ASKED.index((routes, 0))
                    check(method, k, routes(world, 0, workers=2))
                    continue
                with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context(method)) as pool:
                    some = random.sample(range(len(ASKED)), 5)
                    for k, found in zip(some, pool.map(functools.partial(answer, world), some), strict=True):
                        check(method, k, found)
        finally:
            stop.set()
    for thread in asking:
        if (error := thread.exception()) is not None:
            faults.append("".join(traceback.format_exception(error)))
    print("\n".join(faults), end="")
    print(f"{next(count)} answers", file=sys.stderr)
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1])))
