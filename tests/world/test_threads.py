"""One world in several threads and processes. What goes wrong ends the process, so it happens in one of its own."""

import pickle
import subprocess
import sys

import numpy as np
import pytest

from driftplan import BeaconKind, OdometryNoise, Sites, World, bundled_map, load_world, place_beacons, plan_route

PREAMBLE = """
import multiprocessing, threading
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
import numpy as np
import driftplan as dp

def answers(world, rounds=1):
    rng = np.random.default_rng(0)
    for _ in range(rounds):
        a, b = rng.uniform(0, 24, (2, 400, 2))
        found = [world.segments_free(a, b), world.is_free(a), world.free_part(a), world.line_of_sight(a, b)]
        found += [world.zone_at(a), world.zone_pieces(a, b).zone, world.segment_free(3.1, 4.0, 9.0, 5.0)]
    return [np.asarray(part).tolist() for part in found]

def office():
    return dp.load_world(dp.bundled_map("office"), robot_radius=0.3)
"""
THREADS = """
world = office()
with ThreadPoolExecutor(4) as pool:  # a world that has derived nothing yet
    found = list(pool.map(lambda _: answers(world, 10), range(4)))
assert found == [answers(office(), 10)] * 4
print("same")
"""
PROCESSES = """
if __name__ == "__main__":
    world, stop = office(), threading.Event()
    expected = answers(world)
    busy = threading.Thread(target=lambda: [answers(world) for _ in iter(stop.is_set, True)])
    busy.start()  # what forks while a thread asks finds no lock held
    for method in ("fork", "spawn"):
        with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context(method)) as pool:
            assert list(pool.map(answers, [world] * 2)) == [expected] * 2, method
    stop.set()
    busy.join()
    print("same")
"""
FORKED = """
import os
from functools import cached_property
from driftplan.planning.ompl import solve
from driftplan.planning.roadmap import kept_graph
locks = [kept_graph._MAKING, solve._OMPLS_OWN]  # as if in a thread that makes a graph, solves, derives from a world
locks += [part.lock for part in vars(dp.World).values() if hasattr(part, "lock")]
held, done = threading.Event(), threading.Event()
world = dp.World.from_polygons([], bounds=(0, 0, 9, 9), robot_radius=0.3)
def making():
    held.set()
    done.wait()
    yield
graph = vars(world)["_kept_graph"] = making()
def hold():
    for lock in locks:
        lock.acquire()
    next(graph)
thread = threading.Thread(target=hold)
thread.start()
held.wait()
child = os.fork()
if not child:
    import faulthandler
    faulthandler.dump_traceback_later(60, exit=True)
    noise = dp.OdometryNoise(heading_var_per_m=1e-3)
    dp.plan_routes(world, [[(1, 1), (8, 8)]], noise, workers=1)
    dp.plan_route(world, (1, 1), (8, 8), noise, planner="bitstar", iterations=100)
    os._exit(0)
status = os.waitpid(child, 0)[1]
done.set()
assert status == 0
print("same")
"""
ROUTES = """
walls = [[(4, 0), (5, 0), (5, 7), (4, 7)], [(8, 3), (9, 3), (9, 10), (8, 10)]]
world = dp.World.from_polygons(walls, bounds=(0, 0, 13, 10), robot_radius=0.3)
noise = dp.OdometryNoise(heading_var_per_m=1e-3)
def plan(seed, planner):
    asked = {"iterations": 1000 if planner == "bitstar" else 1, "planner": planner, "seed": seed}
    return dp.plan_route(world, (1, 1), (12, 9), noise, **asked).path.tolist()
asked = ((0, 1, 0, 0, 1, 0), ("roadmap",) * 3 + ("bitstar",) * 3)  # OMPL's seed is the process's
with ThreadPoolExecutor(3) as pool:
    assert list(pool.map(plan, *asked)) == list(map(plan, *asked))
print("same")
"""


@pytest.mark.parametrize(
    "script", [THREADS, PROCESSES, FORKED, ROUTES], ids=["threads", "processes", "forked", "routes"]
)
def test_one_world_answers_many_at_once(script, tmp_path):
    file = tmp_path / "script.py"
    file.write_text(PREAMBLE + script)
    done = subprocess.run([sys.executable, "-W", "ignore", file], capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stdout.strip()) == (0, "same"), done.stderr[-2000:]


def test_worlds_routes_layouts_and_noises_can_be_sent_to_another_process():
    noise = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
    world = load_world(bundled_map("office"), robot_radius=0.3)
    route = plan_route(world, (2, 17), (32, 16.5), noise, iterations=1)
    layout = place_beacons(world, [route.path], noise, 0.5, Sites(BeaconKind.rfid(3.0, 0.1), spacing_m=3.0))
    for value in (noise, world, route, layout, World.from_polygons([], bounds=(0, 0, 4, 4), robot_radius=0.1)):
        copy = pickle.loads(pickle.dumps(value))
        assert type(copy) is type(value)
        assert repr(copy) == repr(value)
    again = pickle.loads(pickle.dumps(route))
    np.testing.assert_array_equal(again.path, route.path)
    assert again.rms == route.rms
