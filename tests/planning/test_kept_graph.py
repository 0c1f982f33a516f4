"""The graph kept with a world: one for all who ask, the same whoever asks first, and gone with the world."""

import gc
import pickle
import threading
import weakref
from dataclasses import replace

import numpy as np
import pytest
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.model.noise import OdometryNoise
from driftplan.planning.many_routes import plan_routes
from driftplan.planning.ompl.objective import DriftObjective
from driftplan.planning.ompl.roadmap_planner import RoadmapPlanner
from driftplan.planning.request import Planner
from driftplan.planning.roadmap import kept_graph
from driftplan.planning.roadmap.graph import Roadmap
from driftplan.planning.roadmap.kept_graph import KeptGraph
from driftplan.planning.roadmap.prices import AdditiveCost, PartOfWorld
from driftplan.planning.routes import plan_route
from driftplan.world.world import World
from driftplan.world.zones import Zone

NOISE = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
TURNING = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0, heading_deg_per_full_turn=5.0)
WALLS = [[(4, 2), (5, 2), (5, 9), (4, 9)], [(8, 0), (9, 0), (9, 6), (8, 6)], [(12, 4), (13, 4), (13, 10), (12, 10)]]
WET = Zone([(5, 6), (8, 6), (8, 10), (5, 10)], OdometryNoise(heading_var_per_m=0.01))
ENDS = (1.0, 9.0), (15.0, 9.0)
SIGN = BeaconKind.landmark(range_m=1.5, position_std_m=0.05, heading_std=0.01)
AMONG = {"beacons": [Beacon(SIGN, 6.5, 7)], "max_drift": 0.35, "minimise": "length", "planner": Planner(max_nodes=60)}


def walled(*zones):
    """A world of which nothing is known yet."""
    return World.from_polygons(WALLS, bounds=(0, 0, 16, 10), robot_radius=0.3, zones=zones)


@pytest.fixture
def made(monkeypatch):
    """The worlds of which a graph has been begun."""
    worlds, make = [], kept_graph._made
    monkeypatch.setattr(kept_graph, "_made", lambda world: worlds.append(world) or make(world))
    return worlds


def same(one, other):
    np.testing.assert_array_equal(one.xy, other.xy)
    np.testing.assert_array_equal(one.edges, other.edges)


def solved(world, ends, planner=None):
    """A path of `RoadmapPlanner`, after two batches, and the planner: a new one or that which is given."""
    ou.setLogLevel(ou.LOG_NONE)
    space = ob.RealVectorStateSpace(2)
    space.setBounds(0, 16)
    setup = og.SimpleSetup(planner.getSpaceInformation() if planner else ob.SpaceInformation(space))
    si = setup.getSpaceInformation()
    setup.setStateValidityChecker(lambda state: world.point_free(state[0], state[1]))
    start, goal = si.allocState(), si.allocState()
    (start[0], start[1]), (goal[0], goal[1]) = ends
    setup.setStartAndGoalStates(start, goal)
    setup.setOptimizationObjective(DriftObjective(si, NOISE, ends[1]))
    planner = planner or RoadmapPlanner(si, world=world)
    setup.setPlanner(planner)
    enough = ob.PlannerTerminationCondition(lambda: any(q.search.batches >= 2 for q in planner._queries))
    assert setup.solve(enough)
    return np.array([(q[0], q[1]) for q in setup.getSolutionPath().getStates()]), planner


@pytest.mark.parametrize(
    ("zones", "asked"),
    [
        ((), {"noise": NOISE, "iterations": 2}),
        ((), {"noise": TURNING, "iterations": 2}),
        ((), {"noise": NOISE, "iterations": 2, "minimise": "length"}),
        ((), {"noise": NOISE, "iterations": 2, "max_detour": 1.05}),
        ((WET,), {"noise": NOISE, "iterations": 2, "max_detour": 1.05}),
        ((), {"noise": NOISE.scaled(3.0), **AMONG}),
    ],
    ids=["drift", "turns", "length", "detour", "zones", "beacons"],
)
def test_a_route_is_the_same_on_a_world_that_was_never_asked_and_on_one_that_was(zones, asked, made):
    cold, warm = walled(*zones), walled(*zones)
    plan_routes(warm, [((1, 1), (15, 1)), ENDS[::-1]], TURNING, workers=1)
    plan_route(warm, *ENDS[::-1], NOISE, iterations=1)
    assert made == [warm]
    one, other = (plan_route(world, *ENDS, **asked) for world in (cold, warm))
    np.testing.assert_array_equal(one.path, other.path)
    assert one.rms == other.rms
    assert made == [warm, cold]  # nor for zones that a price on length makes worse


@pytest.mark.parametrize("clear", ["clear", "clearQuery"])
def test_a_cleared_planner_plans_to_another_goal_what_a_new_one_does_on_the_same_graph(made, clear):
    world = walled()
    _, planner = solved(world, ENDS)
    getattr(planner, clear)()
    assert len(planner.roadmap()[0]) == 0
    other = ENDS[0], (10.5, 1.0)
    again, _ = solved(world, other, planner)
    assert made == [world]
    np.testing.assert_array_equal(again, solved(walled(), other)[0])


def test_threads_make_it_once(made):
    world, graphs = walled(), []
    threads = [threading.Thread(target=lambda: graphs.append(KeptGraph.of(world))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert made == [world]
    assert all(graph is graphs[0] for graph in graphs)


def test_what_is_cut_short_goes_on_with_the_next_and_becomes_the_same(made):
    world, looks, tries = walled(), [], 0
    while (graph := KeptGraph.of(world, lambda: looks.append(1) or len(looks) % 2 == 0)) is None:
        tries += 1
    assert tries >= 2
    assert made == [world]
    same(graph, KeptGraph.of(walled()))


def test_what_an_interrupt_has_ended_is_made_anew(monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    world = walled()
    with monkeypatch.context() as patched:
        patched.setattr(kept_graph, "_add_passages", interrupted)
        with pytest.raises(KeyboardInterrupt):
            KeptGraph.of(world)
    same(KeptGraph.of(world), KeptGraph.of(walled()))


@pytest.mark.parametrize("steps", [1, 1000])
def test_it_goes_with_its_world_made_or_half_made_and_is_not_pickled(steps):
    world = walled()
    plain = len(pickle.dumps(world))
    KeptGraph.of(world, lambda looks=[]: looks.append(1) or len(looks) > steps)
    assert len(pickle.dumps(world)) == plain
    same(KeptGraph.of(pickle.loads(pickle.dumps(world))), KeptGraph.of(walled()))
    known = weakref.ref(world)
    del world
    gc.collect()
    assert known() is None


def test_a_part_of_a_world_takes_what_lies_in_it():
    world, ends = walled(), np.array([(1.0, 1.0), (15.0, 1.0)])
    whole = KeptGraph.of(world)
    for box, top in (((0, 0, 16, 10), 10), ((0, 0, 16, 6), 6)):
        roadmap = Roadmap(AdditiveCost(PartOfWorld(world, box, (WET,)), ends[1], NOISE, "length"), ends[0])
        whole.join(roadmap, np.inf)
        inside = whole.xy[:, 1] < top
        np.testing.assert_array_equal(roadmap.xy[2:], whole.xy[inside])
        within = roadmap.edges[(roadmap.edges > 1).all(axis=1)]
        np.testing.assert_array_equal(roadmap.xy[within], whole.xy[whole.edges[inside[whole.edges].all(axis=1)]])
        assert world.segments_free(*roadmap.xy[roadmap.edges.T]).all()


def test_a_world_too_small_for_samples_has_one_too():
    slit = World.from_polygons([[(0, 0.302), (9, 0.302), (9, 9), (0, 9)]], bounds=(0, 0, 9, 9), robot_radius=0.1499)
    route = plan_route(slit, (0.2, 0.1502), (8.8, 0.1502), NOISE, iterations=1)
    assert route.length == pytest.approx(8.6)
    assert len(KeptGraph.of(replace(slit)).xy) >= 2


SLITS = [(8, 2.5), (14, 5.0), (19, 7.5)]  # where a passage begins, and its middle: 2 cm wide for the robot's centre
NARROW = [[(x, -1), (x + 2, -1), (x + 2, y - 0.31), (x, y - 0.31)] for x, y in SLITS]
NARROW += [[(x, y + 0.31), (x + 2, y + 0.31), (x + 2, 11), (x, 11)] for x, y in SLITS]


def test_wherever_free_space_leads_there_are_routes_among_beacons_and_with_ompl():
    world = World.from_polygons(NARROW, bounds=(0, 0, 30, 10), robot_radius=0.3)
    asked = {**AMONG, "beacons": [Beacon(SIGN, 12.5, 5)], "max_drift": None}
    found = plan_route(world, (2, 8), (28, 2), NOISE, **asked)
    assert world.segments_free(found.path[:-1], found.path[1:]).all()
    shortest = plan_route(world, (2, 8), (28, 2), NOISE, minimise="length")
    assert found.shortest_length == pytest.approx(shortest.length, rel=2e-3)
    path, _ = solved(world, ((2.0, 8.0), (13.0, 2.0)))
    np.testing.assert_array_equal(path[-1], (13.0, 2.0))
