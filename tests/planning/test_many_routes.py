"""plan_routes: the routes of many trips on one graph of the world, as good as those planned one by one."""

import numpy as np
import pytest

from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.errors import GoalError, NoPathError
from driftplan.model.drift import predict_drift
from driftplan.model.noise import OdometryNoise
from driftplan.planning.many_routes import plan_routes
from driftplan.planning.request import Planner
from driftplan.planning.routes import plan_route
from driftplan.world.mapfiles import bundled_map, load_world
from driftplan.world.world import World

NOISE = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0, heading_deg_per_full_turn=5.0)
WALL = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)
TRIPS = [[(2, 2), (8, 2)], [(8, 2), (2, 2)], [(2, 2), (2, 9)], [(8, 9), (8, 9)]]


@pytest.fixture(scope="module")
def warehouse():
    return load_world(bundled_map("warehouse"), robot_radius=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("minimise", ["drift", "length"])
def test_routes_are_safe_lead_where_they_should_and_are_hardly_worse_than_one_by_one(warehouse, minimise):
    rng = np.random.default_rng(3)
    points = rng.uniform((1, 1), (59, 39), (60, 2))
    points = points[warehouse.is_free(points)]
    trips = points[:10].reshape(5, 2, 2)
    routes = plan_routes(warehouse, trips, NOISE, minimise=minimise, workers=1)
    for trip, route in zip(trips, routes, strict=True):
        np.testing.assert_array_equal(route.path[[0, -1]], trip)
        assert warehouse.segments_free(route.path[:-1], route.path[1:]).all()
        assert route.bound <= (route.rms if minimise == "drift" else route.length)
        alone = plan_route(warehouse, *trip, NOISE, minimise=minimise, iterations=2)
        ratio = route.rms / alone.rms if minimise == "drift" else route.length / alone.length
        assert ratio < 1.03


def test_processes_find_what_one_process_finds_in_the_order_of_the_trips():
    told = []
    alone = plan_routes(WALL, TRIPS, NOISE, workers=1, progress=lambda *done: told.append(done))
    shared = plan_routes(WALL, TRIPS, NOISE, workers=2)
    for one, other in zip(alone, shared, strict=True):
        np.testing.assert_array_equal(one.path, other.path)
        assert one.rms == other.rms
    assert told == [(k, 4) for k in (1, 2, 3, 4)]
    assert [route.length for route in alone][2:] == [pytest.approx(7.0), 0.0]
    assert plan_routes(WALL, [], NOISE) == ()


def test_where_the_graph_does_not_lead_the_way_over_the_triangles_does():
    narrow = [[(9, -1), (11, -1), (11, 4.69), (9, 4.69)], [(9, 5.31), (11, 5.31), (11, 11), (9, 11)]]
    world = World.from_polygons(narrow, bounds=(0, 0, 20, 10), robot_radius=0.3)  # 2 cm of room on either side
    (route,) = plan_routes(world, [[(2, 8), (18, 2)]], NOISE, workers=1)
    assert world.segments_free(route.path[:-1], route.path[1:]).all()
    assert route.rms < 1.01 * plan_route(world, (2, 8), (18, 2), NOISE, iterations=1).rms


@pytest.mark.slow
def test_the_graph_leads_wherever_free_space_does(monkeypatch):
    monkeypatch.setattr("driftplan.planning.roadmap.growth.channel_route", lambda *_: pytest.fail("not by itself"))
    walls = [[(x, y), (x + 0.4, y), (x + 0.4, y + 38.2), (x, y + 38.2)] for x, y in ((10, -1), (20, 2.8), (30, 1.2))]
    pillars = [[(x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1)] for x in range(2, 38, 4) for y in range(3, 38, 5)]
    world = World.from_polygons([*walls, *pillars], bounds=(0, 0, 40, 40), robot_radius=0.55)  # doors of 1.2 m
    points = np.random.default_rng(0).uniform(1, 39, (200, 2))
    trips = points[world.free_part(points) == 0][:24].reshape(-1, 2, 2)
    for route in plan_routes(world, trips, NOISE, workers=1):
        assert world.segments_free(route.path[:-1], route.path[1:]).all()


def test_with_beacons_limits_or_time_a_trip_is_planned_as_alone():
    sign = [Beacon(BeaconKind.landmark(range_m=2.0, position_std_m=0.05, heading_std=0.01), 5, 9)]
    asked = {"beacons": sign, "minimise": "length", "planner": Planner(max_nodes=40)}
    (route,) = plan_routes(WALL, TRIPS[:1], NOISE, workers=1, **asked)
    alone = plan_route(WALL, *TRIPS[0], NOISE, **asked)
    np.testing.assert_array_equal(route.path, alone.path)
    assert route.beacons == alone.beacons == tuple(sign)


def test_what_is_wrong_with_a_trip_is_said_with_its_number_before_anything_is_planned():
    with pytest.raises(GoalError, match=r"trip 1: goal \(5, 5\) is not free"):
        plan_routes(WALL, [TRIPS[0], [(2, 2), (5, 5)]], NOISE, progress=lambda *_: pytest.fail("planned"))
    split = World.from_polygons([[(4, -1), (6, -1), (6, 11), (4, 11)]], bounds=(0, 0, 10, 10), robot_radius=0.5)
    with pytest.raises(NoPathError, match="trip 0: no path"):
        plan_routes(split, TRIPS[:1], NOISE)
    with pytest.raises(ValueError, match=r"a trip .*\(2, 2\)"):
        plan_routes(WALL, [[(2, 2)]], NOISE)
    with pytest.raises(ValueError, match="workers"):
        plan_routes(WALL, TRIPS, NOISE, workers=0)


def test_what_a_route_predicts_is_the_drift_along_it():
    (route,) = plan_routes(WALL, TRIPS[:1], NOISE, workers=1)
    assert route.rms == pytest.approx(float(predict_drift(route.path, NOISE).end.rms))
