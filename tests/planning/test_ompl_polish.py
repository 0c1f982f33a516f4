"""Polished OMPL paths: the same ends, free, never dearer; where OMPL's own way of shortening is."""

import pytest
from ompl import base as ob
from ompl import geometric as og

from driftplan import DriftObjective, OdometryNoise, World, polish_ompl_path, predict_ompl_path
from driftplan.errors import PlannerError
from driftplan.planning.ompl.collision import use_world
from driftplan.world.zones import Zone

NOISE = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3)
BAD = Zone([(7, 2), (14, 2), (14, 10), (7, 10)], OdometryNoise(heading_var_per_m=2e-2, distance_var_per_m=1e-3))
WORLD = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 20, 10), robot_radius=0.2, zones=[BAD])
SPACES = {
    "plane": lambda: ob.RealVectorStateSpace(2),
    "se2": ob.SE2StateSpace,
    "dubins": lambda: ob.DubinsStateSpace(0.6),
    "reeds_shepp": lambda: ob.ReedsSheppStateSpace(0.6),
}
VIA = [(2, 2, 1.5), (2, 8, 0.8), (5, 9, 0.0), (6.6, 8, -1.5), (6.6, 1, -0.8), (9, 1, 0.0), (15, 1, 0.5), (18, 8, 1.5)]


def information(name):
    space, bounds = SPACES[name](), ob.RealVectorBounds(2)
    bounds.setLow(0)
    bounds.setHigh(0, 20)
    bounds.setHigh(1, 10)
    space.setBounds(bounds)
    si = ob.SpaceInformation(space)
    use_world(si, WORLD)
    si.setup()
    return si


def path_over(si, name, poses):
    path, state = og.PathGeometric(si), si.allocState()
    for x, y, yaw in poses:
        if name == "plane":
            state[0], state[1] = float(x), float(y)
        else:
            state.setXY(x, y)
            state.setYaw(yaw)
        path.append(state)
    return path


@pytest.mark.parametrize("name", SPACES)
def test_a_polished_path_is_free_has_the_same_ends_and_costs_less(name):
    si = information(name)
    path = path_over(si, name, VIA)
    assert path.check()
    objective = DriftObjective(si, NOISE, (18.0, 8.0), WORLD)
    before, length = path.cost(objective).value(), path.length()
    better = polish_ompl_path(path, objective, WORLD)
    assert better.check()
    assert (path.cost(objective).value(), path.length()) == (before, length)
    space = si.getStateSpace()
    for k, end in ((0, 0), (better.getStateCount() - 1, path.getStateCount() - 1)):
        assert space.distance(better.getState(k), path.getState(end)) < 1e-9
    assert better.cost(objective).value() < 0.95 * before
    rms = [float(predict_ompl_path(p, si, NOISE, WORLD).end.rms) for p in (path, better)]
    assert rms[1] < rms[0]
    again = polish_ompl_path(better, objective, WORLD)
    assert again.cost(objective).value() <= better.cost(objective).value()


def test_ompls_own_way_of_shortening_makes_drift_larger_across_bad_floor():
    """Why there is another: the same path, shortened by OMPL."""
    si = information("plane")
    objective = DriftObjective(si, NOISE, (18.0, 8.0), WORLD)
    path = path_over(si, "plane", VIA)
    better = polish_ompl_path(path, objective, WORLD).cost(objective).value()
    og.PathSimplifier(si).simplify(path, 1.0)
    assert path.check()
    assert path.cost(objective).value() > 1.5 * better


def test_lengths_are_polished_too_and_other_things_refused():
    si = information("plane")
    path = path_over(si, "plane", VIA)
    length = ob.PathLengthOptimizationObjective(si)
    assert polish_ompl_path(path, length, WORLD).length() < 0.8 * path.length()
    two = path_over(si, "plane", VIA[:2])
    assert polish_ompl_path(two, length, WORLD).length() == two.length()
    with pytest.raises(ValueError, match="at least 2 states, got 1"):
        polish_ompl_path(path_over(si, "plane", VIA[:1]), length, WORLD)
    plain = World.from_polygons([], bounds=(0, 0, 20, 10), robot_radius=0.2)
    drift = DriftObjective(si, NOISE, (18.0, 8.0), WORLD)
    with pytest.raises(PlannerError, match="expected the world whose 1 zones"):
        polish_ompl_path(path, drift, plain)
