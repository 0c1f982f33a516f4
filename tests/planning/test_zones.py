"""Bad floor: a planner drives round it, or crosses it near the goal, whichever is better. Both are better sometimes."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from driftplan.model.noise import OdometryNoise
from driftplan.planning.roadmap.prices import exact_drift
from driftplan.planning.routes import plan_route
from driftplan.world.world import World
from driftplan.world.zones import Zone

NOISE = OdometryNoise(heading_var_per_m=1e-4, distance_var_per_m=1e-4)
WET = OdometryNoise(heading_var_per_m=5e-2, distance_var_per_m=1e-4)
START, GOAL = (1.0, 5.0), (19.0, 5.0)

PLANNERS = [("roadmap", 3), ("bitstar", 8000), pytest.param("rrtstar", 1500, marks=pytest.mark.slow)]


def strip_at(x):
    """A strip of wet floor, 1 m wide, that leaves a way round in the north, some 9 m off the straight line."""
    wet = Zone(shapely.box(x, 0, x + 1, 14), WET)
    return World.from_polygons([], bounds=(0, 0, 20, 20), robot_radius=0.3, zones=[wet]), wet.polygon


def crosses(route, polygon):
    return shapely.LineString(route.path).intersection(polygon).length > 0.5


@pytest.mark.parametrize(("planner", "iterations"), PLANNERS)
def test_bad_floor_far_from_the_goal_is_driven_around(planner, iterations):
    """Crossing costs 0.05 rad²/m at a lever of 15 m, over 11 m²; the way round 1e-4 rad²/m times 30 m, some 0.5 m²."""
    world, polygon = strip_at(3.0)
    route = plan_route(world, START, GOAL, NOISE, planner=planner, iterations=iterations)
    assert not crosses(route, polygon)
    assert route.rms < 1.0
    assert exact_drift(world, np.array([START, GOAL]), NOISE).end.rms > 3.0


@pytest.mark.parametrize(("planner", "iterations"), PLANNERS)
def test_the_same_floor_near_the_goal_is_crossed(planner, iterations):
    """There the lever is 1 m, and crossing costs 0.05 m²; the way round costs more in heading kept wrong for longer."""
    world, polygon = strip_at(17.5)
    route = plan_route(world, START, GOAL, NOISE, planner=planner, iterations=iterations)
    assert crosses(route, polygon)
    round_it = np.array([START, (17.4, 14.1), (18.6, 14.1), GOAL])
    assert route.rms < exact_drift(world, round_it, NOISE).end.rms
    assert route.rms <= exact_drift(world, np.array([START, GOAL]), NOISE).end.rms * (1 + 1e-9)
