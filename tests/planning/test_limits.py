"""A limit on the drift: what does not bind changes nothing, and what some route was seen to keep is never called
impossible."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from driftplan import (
    Beacon,
    BeaconKind,
    InfeasibleError,
    OdometryNoise,
    World,
    bundled_map,
    load_world,
    plan_route,
)
from driftplan.planning import request
from driftplan.planning.request import DriftLimit, Planner
from driftplan.planning.roadmap import growth

ROOM = World.from_polygons([], bounds=(0, 0, 24, 12), robot_radius=0.3)
NOISE = OdometryNoise.from_std(heading_deg=3, distance_m=0.14, after_m=10)
ENDS = (3.5, 7.86), (21.6, 9.53)
COARSE = Beacon(BeaconKind.landmark(range_m=2.3, position_std_m=1.0, heading_std=0.1), 11.5, 7.25)
UNHURRIED = {"time_limit": 600.0, "planner": Planner(max_nodes=30)}


def scattered(seed):
    """A room with a wall, a few beacons of any quality, and two places far apart."""
    rng = np.random.default_rng(seed)
    kinds = [
        BeaconKind.rfid(range_m=1.2, position_std_m=0.1),
        BeaconKind.rfid(range_m=2.5, position_std_m=0.8),
        BeaconKind.landmark(range_m=2.3, position_std_m=1.0, heading_std=0.1),
        BeaconKind.landmark(range_m=3.0, position_std_m=0.2, heading_std=0.02, detection_probability=0.8),
    ]
    wall = (12, 0, 12.5, float(rng.uniform(2, 8)))
    corners = [wall[:2], (wall[2], wall[1]), wall[2:], (wall[0], wall[3])]
    world = World.from_polygons([corners], bounds=(0, 0, 24, 12), robot_radius=0.3)
    places = rng.uniform((0.5, 0.5), (23.5, 11.5), (5, 2))
    beacons = [Beacon(kinds[int(rng.integers(len(kinds)))], *place) for place in places.tolist()]
    ends = [(1.0, float(rng.uniform(1, 11))), (23.0, float(rng.uniform(1, 11)))]
    return world, ends, beacons


def test_a_limit_that_does_not_bind_does_not_make_the_route_worse():
    world = load_world(bundled_map("warehouse"), robot_radius=0.3)
    noise = OdometryNoise.from_std(heading_deg=1, distance_m=0.05, after_m=10.0, heading_deg_per_full_turn=10)
    asked = {"iterations": 1, "seed": 1}
    free = plan_route(world, (3, 3), (56, 36), noise, **asked)
    for limit in (1000.0, free.worst_drift * 1.001):
        bound = plan_route(world, (3, 3), (56, 36), noise, max_drift=limit, **asked)
        assert bound.rms <= free.rms * (1 + 1e-9)
        assert bound.worst_drift <= limit


@pytest.mark.parametrize(
    "minimise", ["length", *(pytest.param(name, marks=pytest.mark.slow) for name in ("drift", "worst_drift"))]
)
@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2))])
def test_with_beacons_too_a_limit_that_does_not_bind_changes_nothing(seed, minimise):
    world, ends, beacons = scattered(seed)
    asked = {"beacons": beacons, "minimise": minimise, **UNHURRIED}
    free = plan_route(world, *ends, NOISE, **asked)
    for limit in (1000.0, free.worst_drift * (1 + 1e-9)):
        np.testing.assert_allclose(plan_route(world, *ends, NOISE, max_drift=limit, **asked).path, free.path)


@pytest.mark.parametrize("min_capture", [0.0, 0.9])
def test_a_beacon_that_does_harm_is_driven_round(min_capture):
    asked = {"beacons": [COARSE], **UNHURRIED}
    any_drift, limit = DriftLimit(min_capture=min_capture), DriftLimit(1.0, min_capture=min_capture)
    steady = plan_route(ROOM, *ENDS, NOISE, minimise="worst_drift", max_drift=any_drift, **asked)
    assert steady.worst_drift < 0.8
    assert plan_route(ROOM, *ENDS, NOISE, minimise="length", max_drift=limit, **asked).worst_drift <= 1.0


SHORTENED = pytest.mark.xfail(reason="a walk of 1.6 times the shortest keeps it, and is then shortened to 1.18 times")


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=SHORTENED), 4, 5])
@pytest.mark.slow
def test_the_least_worst_drift_can_be_kept_and_two_per_cent_less_cannot(seed):
    world, ends, beacons = scattered(seed)
    asked = {"beacons": beacons, "max_detour": 1.5, **UNHURRIED}
    steady = plan_route(world, *ends, NOISE, minimise="worst_drift", **asked)
    kept = plan_route(world, *ends, NOISE, minimise="drift", max_drift=steady.worst_drift * (1 + 1e-9), **asked)
    assert kept.worst_drift <= steady.worst_drift * (1 + 1e-9)
    del asked["max_detour"]
    kept = plan_route(world, *ends, NOISE, minimise="length", max_drift=steady.worst_drift * (1 + 1e-9), **asked)
    assert kept.length <= steady.length * (1 + 1e-9)
    for minimise in ("drift", "length"):
        with pytest.raises(InfeasibleError):
            plan_route(world, *ends, NOISE, minimise=minimise, max_drift=0.98 * steady.worst_drift, **asked)


# Longer searches


@pytest.mark.slow
@pytest.mark.parametrize("asked", [{}, {"minimise": "length"}, {"start": (1, 9, 2.0)}], ids=str)
def test_a_longer_search_is_never_worse_than_a_shorter_one_with_the_same_seed(monkeypatch, asked):
    """By a clock that ticks when it is looked at, so that the machine has no say in where a search is cut short."""
    world = World.from_polygons(
        [[(4, 2), (5, 2), (5, 9), (4, 9)], [(8, 0), (9, 0), (9, 6), (8, 6)], [(12, 4), (13, 4), (13, 10), (12, 10)]],
        bounds=(0, 0, 16, 10),
        robot_radius=0.3,
    )
    noise = OdometryNoise.from_std(heading_deg=3, distance_m=0.05, after_m=10.0, heading_deg_per_full_turn=5)
    clock = SimpleNamespace(monotonic=itertools.count().__next__, perf_counter=lambda: 0.0)
    monkeypatch.setattr(request, "time", clock)
    monkeypatch.setattr(growth, "time", clock)
    asked = {"start": (1, 9), "goal": (15, 9), "noise": noise, **asked}
    found = [plan_route(world, time_limit=t, **asked) for t in (1, 3, 6, 10, 15, 20, 30, 60, 100, 150)]
    scores = [route.length if "minimise" in asked else route.rms for route in found]
    assert (np.diff(scores) <= 1e-12).all()
    assert scores[-1] < scores[0]
