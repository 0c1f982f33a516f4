"""DriftObjective: the algebra OMPL's header asks for, prices against quadrature along OMPL's own motions, and goals."""

from __future__ import annotations

from itertools import combinations, pairwise
from math import pi

import numpy as np
import pytest
import shapely
from ompl import base as ob
from ompl import geometric as og

from driftplan.errors import PlannerError
from driftplan.model.drift import predict_drift
from driftplan.model.noise import OdometryNoise
from driftplan.planning.cost import CostRates, bracket, edge_cost, geodesic_cost, turn_cost
from driftplan.planning.ompl.collision import use_world
from driftplan.planning.ompl.objective import DriftObjective
from driftplan.planning.ompl.paths import predict_ompl_path
from driftplan.planning.roadmap.prices import AdditiveCost
from driftplan.world.world import World
from driftplan.world.zones import Zone

NOISE = OdometryNoise(
    heading_var_per_m=1e-3,
    distance_var_per_m=4e-3,
    lateral_var_per_m=1e-3,
    heading_var_per_rad=3e-3,
    distance_var_per_rad=2e-3,
)
SPACES = {
    "plane": lambda: ob.RealVectorStateSpace(2),
    "se2": ob.SE2StateSpace,
    "dubins": lambda: ob.DubinsStateSpace(1.5),
    "symmetric_dubins": lambda: ob.DubinsStateSpace(1.5, True),
    "reeds_shepp": lambda: ob.ReedsSheppStateSpace(1.5),
    "space": lambda: ob.RealVectorStateSpace(3),
    "se3": ob.SE3StateSpace,
}
SPATIAL = ("space", "se3")
CURVED = ("dubins", "symmetric_dubins", "reeds_shepp")


def information(name):
    space = SPACES[name]()
    bounds = ob.RealVectorBounds(3 if name in SPATIAL else 2)
    bounds.setLow(-10)
    bounds.setHigh(10)
    space.setBounds(bounds)
    return ob.SpaceInformation(space)


def goal_of(name):
    return (3.0, -2.0, 1.0)[: 3 if name in SPATIAL else 2]


def random_state(si, name, rng):
    state = si.allocState()
    xyz = rng.normal(0, 4, 3).tolist()
    if name in ("plane", "space"):
        for k in range(3 if name == "space" else 2):
            state[k] = xyz[k]
    elif name == "se3":
        state.setXYZ(*xyz)
        state.rotation().setAxisAngle(*rng.normal(size=3).tolist(), float(rng.uniform(0, pi)))
    else:
        state.setXY(*xyz[:2])
        state.setYaw(float(rng.uniform(-pi, pi)))
    return state


def random_states(si, name, seed, count):
    rng = np.random.default_rng(seed)
    return [random_state(si, name, rng) for _ in range(count)]


def position(state, name):
    if name in ("plane", "space"):
        return np.array([state[k] for k in range(3 if name == "space" else 2)])
    return np.array([state.getX(), state.getY(), *([state.getZ()] if name == "se3" else [])])


# Laws


@pytest.mark.parametrize("name", SPACES)
def test_costs_add_up_from_zero_as_ompl_asks(name):
    si = information(name)
    objective = DriftObjective(si, NOISE, goal_of(name))
    a, b, *_ = random_states(si, name, 1, 2)
    cost, identity = objective.motionCost(a, b), objective.identityCost()
    assert identity.value() == 0
    assert objective.combineCosts(cost, identity).value() == cost.value()
    assert objective.combineCosts(identity, cost).value() == cost.value()
    assert objective.isCostBetterThan(cost, objective.combineCosts(cost, cost))
    assert objective.isCostBetterThan(identity, cost)
    assert not objective.isCostBetterThan(objective.combineCosts(cost, objective.motionCost(b, a)), cost)
    assert not objective.isCostBetterThan(cost, cost)
    assert objective.isCostEquivalentTo(cost, objective.motionCost(a, b))
    assert objective.isCostBetterThan(cost, objective.infiniteCost())
    assert objective.isFinite(cost)
    assert not objective.isSatisfied(cost)
    assert objective.stateCost(a).value() == 0
    assert objective.motionCost(a, a).value() == 0


@pytest.mark.parametrize("name", [name for name in SPACES if name not in CURVED])
def test_the_cost_is_symmetric_where_the_objective_says_so(name):
    si = information(name)
    objective = DriftObjective(si, NOISE, goal_of(name))
    states = random_states(si, name, 2, 60)
    there = np.array([objective.motionCost(a, b).value() for a, b in zip(states[::2], states[1::2], strict=True)])
    back = np.array([objective.motionCost(b, a).value() for a, b in zip(states[::2], states[1::2], strict=True)])
    assert objective.isSymmetric()
    np.testing.assert_allclose(there, back, rtol=1e-9)


@pytest.mark.parametrize("name", CURVED)
def test_where_two_curves_are_equally_short_the_way_back_may_cost_something_else(name):
    si = information(name)
    objective = DriftObjective(si, NOISE, goal_of(name))
    lattice = [(x, y, k * pi / 2) for x in (0.0, 3.0) for y in (0.0, 3.0) for k in range(4)]
    ratios = []
    for p, q in combinations(lattice, 2):
        a, b = si.allocState(), si.allocState()
        a.setXY(*p[:2]), a.setYaw(p[2]), b.setXY(*q[:2]), b.setYaw(q[2])
        ratios.append(objective.motionCost(a, b).value() / objective.motionCost(b, a).value())
    assert (np.abs(np.array(ratios) - 1) > 1e-3).any()
    assert not objective.isSymmetric()


@pytest.mark.parametrize("name", ["dubins", "symmetric_dubins"])
@pytest.mark.parametrize("parts", [20, 300])
def test_the_parts_that_ompl_makes_of_a_curve_cost_what_the_whole_does(name, parts):
    """The states that OMPL interpolates have rounded headings: arcs in which nothing turns must not become circles."""
    si = information(name)
    si.setStateValidityChecker(ob.AllValidStateValidityChecker(si))
    si.setup()
    objective = DriftObjective(si, NOISE, goal_of(name))
    states = random_states(si, name, 11, 60)
    for a, b in zip(states[::2], states[1::2], strict=True):
        path = og.PathGeometric(si, a, b)
        length, cost = path.length(), path.cost(objective).value()
        path.interpolate(parts)
        assert path.length() == pytest.approx(length, rel=1e-5)
        assert path.cost(objective).value() == pytest.approx(cost, rel=1e-5)
        drift = predict_ompl_path(path, si, NOISE)
        assert float(drift.length) == pytest.approx(length, rel=1e-5)


def test_a_reeds_shepp_path_in_parts_costs_more_only_where_ompl_drives_farther():
    """OMPL itself drives detours between some states of its own curves, and says so in the path's length."""
    si = information("reeds_shepp")
    objective = DriftObjective(si, NOISE, goal_of("reeds_shepp"))
    states, same = random_states(si, "reeds_shepp", 12, 60), 0
    for a, b in zip(states[::2], states[1::2], strict=True):
        path = og.PathGeometric(si, a, b)
        length, cost = path.length(), path.cost(objective).value()
        path.interpolate(30)
        if path.length() == pytest.approx(length, rel=1e-6):
            same += 1
            assert path.cost(objective).value() == pytest.approx(cost, rel=1e-5)
        assert float(predict_ompl_path(path, si, NOISE).length) == pytest.approx(path.length(), rel=1e-6)
    assert same > 20


@pytest.mark.parametrize("name", SPACES)
def test_cutting_a_motion_in_two_changes_nothing(name):
    si = information(name)
    space = si.getStateSpace()
    objective = DriftObjective(si, NOISE, goal_of(name))
    between = si.allocState()
    states = random_states(si, name, 3, 80)
    differ = 0
    for a, b in zip(states[::2], states[1::2], strict=True):
        space.interpolate(a, b, 0.3, between)
        whole = objective.motionCost(a, b).value()
        halves = objective.motionCost(a, between).value() + objective.motionCost(between, b).value()
        # 1e-5: OMPL takes angles below about 1e-6 for zero.
        differ += abs(halves - whole) > 1e-5 * whole
    # A piece of a Reeds-Shepp curve has equally short rivals, and a piece of one driven in reverse by a symmetric
    # Dubins space may be shorter forwards.
    assert differ <= (10 if name in ("reeds_shepp", "symmetric_dubins") else 0)


@pytest.mark.parametrize("name", SPACES)
def test_the_heuristic_is_admissible_and_consistent(name):
    si = information(name)
    goal = goal_of(name)
    objective = DriftObjective(si, NOISE, goal)
    states = random_states(si, name, 4, 45)
    cost = np.array([[objective.motionCost(a, b).value() for b in states] for a in states])
    bound = np.array([[objective.motionCostHeuristic(a, b).value() for b in states] for a in states])
    assert (bound <= cost).all()
    assert (np.diag(bound) == 0).all()
    assert (bound[cost > 0] > 0).all()
    # h(a, c) <= cost(a, b) + h(b, c)
    assert (bound[:, None, :] <= (cost[:, :, None] + bound[None, :, :]) * (1 + 1e-12)).all()
    if name in ("plane", "space"):
        xyz = np.array([position(s, name) for s in states])
        np.testing.assert_allclose(bound, geodesic_cost(xyz[:, None], xyz[None], goal, NOISE), rtol=1e-10, atol=1e-15)


def test_the_heuristic_to_the_goal_is_the_cost_of_the_straight_run():
    si = information("plane")
    objective = DriftObjective(si, NOISE, (3.0, -2.0))
    goal = si.allocState()
    goal[0], goal[1] = 3.0, -2.0
    for state in random_states(si, "plane", 5, 20):
        expected = objective.motionCost(state, goal).value()
        assert objective.motionCostHeuristic(state, goal).value() == pytest.approx(expected, rel=1e-12)


# Oracles


@pytest.mark.parametrize("name", ["plane", "space"])
def test_straight_motions_cost_what_the_bulk_formula_says(name):
    si = information(name)
    objective = DriftObjective(si, NOISE, goal_of(name))
    states = random_states(si, name, 6, 60)
    xyz = np.array([position(s, name) for s in states])
    got = [objective.motionCost(a, b).value() for a, b in zip(states[::2], states[1::2], strict=True)]
    np.testing.assert_allclose(got, edge_cost(xyz[::2], xyz[1::2], goal_of(name), NOISE), rtol=1e-12)


def heading_change(a, b, name):
    if name == "se3":
        p, q = a.rotation(), b.rotation()
        return 2 * np.arccos(min(abs(p.x * q.x + p.y * q.y + p.z * q.z + p.w * q.w), 1.0))
    if name in ("plane", "space"):
        return 0.0
    return abs((b.getYaw() - a.getYaw() + pi) % (2 * pi) - pi)


@pytest.mark.parametrize("name", SPACES)
def test_a_motion_costs_the_sum_over_the_many_small_motions_that_ompl_makes_of_it(name):
    """The cost written naively: interpolate, add up rate times squared lever times length, and turns."""
    si = information(name)
    space = si.getStateSpace()
    goal = np.array(goal_of(name))
    objective = DriftObjective(si, NOISE, goal_of(name))
    rates = CostRates.of(NOISE, len(goal))
    states = random_states(si, name, 7, 40)
    count = 1500
    nodes = [si.allocState() for _ in range(count + 1)]
    for a, b in zip(states[::2], states[1::2], strict=True):
        for k, node in enumerate(nodes):
            space.interpolate(a, b, k / count, node)
        xyz = np.array([position(node, name) for node in nodes])
        turned = np.array([heading_change(p, q, name) for p, q in pairwise(nodes)])
        moved = np.linalg.norm(np.diff(xyz, axis=0), axis=1)
        squared = ((goal - (xyz[:-1] + xyz[1:]) / 2) ** 2).sum(axis=1)
        naive = (rates.heading * squared + rates.position) * moved
        naive += (rates.turn_heading * squared + rates.turn_position) * turned
        # Midpoint rule and chords: errors of (1/1500)²; at the joints of arcs of 1/1500.
        assert objective.motionCost(a, b).value() == pytest.approx(naive.sum(), rel=1e-3)


# Zones

WET = Zone([(-6, -6), (0, -6), (0, 3), (-6, 3)], OdometryNoise(heading_var_per_m=2e-2, heading_var_per_rad=1e-2))
GRIP = Zone(shapely.Point(-3, 0).buffer(2), OdometryNoise(heading_var_per_m=1e-5, distance_var_per_m=1e-4))
WORLD = World.from_polygons([], bounds=(-10, -10, 10, 10), robot_radius=0.2, zones=[WET, GRIP])


def test_motions_across_zones_cost_what_the_bulk_formula_says():
    si = information("plane")
    objective = DriftObjective(si, NOISE, (3.0, -2.0), WORLD)
    states = random_states(si, "plane", 8, 300)
    # along the border of a zone, through its corner, within, on the spot
    for (x0, y0), (x1, y1) in [((-6, -6), (-6, 3)), ((-7, -7), (1, 1)), ((-5, -5), (-4, -5)), ((-1, 1), (-1, 1))]:
        for x, y in ((x0, y0), (x1, y1)):
            state = si.allocState()
            state[0], state[1] = float(x), float(y)
            states.append(state)
    xy = np.array([position(s, "plane") for s in states])
    got = [objective.motionCost(a, b).value() for a, b in zip(states[::2], states[1::2], strict=True)]
    expected = AdditiveCost(WORLD, np.array([3.0, -2.0]), NOISE).edges(xy[::2], xy[1::2]).cost
    np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("name", ["se2", "dubins", "reeds_shepp"])
def test_zones_are_priced_where_the_motion_is(name):
    si = information(name)
    space = si.getStateSpace()
    goal = np.array([3.0, -2.0])
    objective = DriftObjective(si, NOISE, (3.0, -2.0), WORLD)
    rates = [CostRates.of(n) for n in (WET.noise, GRIP.noise, NOISE)]
    states = random_states(si, name, 9, 40)
    count = 3000
    nodes = [si.allocState() for _ in range(count + 1)]
    for a, b in zip(states[::2], states[1::2], strict=True):
        for k, node in enumerate(nodes):
            space.interpolate(a, b, k / count, node)
        xy = np.array([position(node, name) for node in nodes])
        turned = np.array([heading_change(p, q, name) for p, q in pairwise(nodes)])
        middle = (xy[:-1] + xy[1:]) / 2
        zone = WORLD.zone_at(middle)
        moved = np.linalg.norm(np.diff(xy, axis=0), axis=1)
        squared = ((goal - middle) ** 2).sum(axis=1)
        naive = 0.0
        for k in (-1, 0, 1):
            r, at = rates[k], zone == k
            naive += ((r.heading * squared + r.position) * moved)[at].sum()
            naive += ((r.turn_heading * squared + r.turn_position) * turned)[at].sum()
        # The naive sum places borders within half a step of up to 20 m / 3000: 3 mm of 0.02 rad²/m at levers of 10 m.
        assert objective.motionCost(a, b).value() == pytest.approx(naive, rel=2e-3, abs=6e-3)


@pytest.mark.parametrize("name", ["se2", "dubins", "reeds_shepp"])
def test_cutting_a_zone_in_two_changes_nothing(name):
    """Borders are found to the last digit: one within a zone, cut along any line, is not noticed."""
    halves = [
        Zone(shapely.intersection(WET.polygon, shapely.Polygon(half)), WET.noise)
        for half in ([(-9, -9), (-9, 9), (2, -9)], [(-9, 9), (2, -9), (2, 9)])
    ]
    cut = World.from_polygons([], bounds=WORLD.bounds, robot_radius=0.2, zones=[*halves, GRIP])
    si = information(name)
    one, other = (DriftObjective(si, NOISE, (3.0, -2.0), world) for world in (WORLD, cut))
    states = random_states(si, name, 16, 60)
    for a, b in zip(states[::2], states[1::2], strict=True):
        assert other.motionCost(a, b).value() == pytest.approx(one.motionCost(a, b).value(), rel=1e-9)


@pytest.mark.parametrize("name", ["plane", "se2", "dubins", "reeds_shepp"])
def test_the_heuristic_stays_admissible_across_zones(name):
    si = information(name)
    objective = DriftObjective(si, NOISE, goal_of(name), WORLD)
    states = random_states(si, name, 10, 22)
    for a in states:
        for b in states:
            assert objective.motionCostHeuristic(a, b).value() <= objective.motionCost(a, b).value()


# Mixes and thresholds


def test_length_can_be_mixed_in():
    si = information("plane")
    plain, mixed = (DriftObjective(si, NOISE, (3.0, -2.0), length_weight=w) for w in (0.0, 0.25))
    a, b = random_states(si, "plane", 11, 2)
    length = si.distance(a, b)
    assert mixed.motionCost(a, b).value() == pytest.approx(plain.motionCost(a, b).value() + 0.25 * length, rel=1e-12)
    assert mixed.motionCostHeuristic(a, b).value() <= mixed.motionCost(a, b).value()


def test_ompls_own_mix_of_objectives_works():
    si = information("plane")
    drift = DriftObjective(si, NOISE, (3.0, -2.0))
    mix = ob.MultiOptimizationObjective(si)
    mix.addObjective(drift, 2.0)
    mix.addObjective(ob.PathLengthOptimizationObjective(si), 0.5)
    a, b = random_states(si, "plane", 12, 2)
    expected = 2 * drift.motionCost(a, b).value() + 0.5 * si.distance(a, b)
    assert mix.motionCost(a, b).value() == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("planner", [og.RRTstar, og.InformedRRTstar, og.SORRTstar, og.BITstar])
def test_planners_take_ompls_mix(planner):
    si = information("plane")
    use_world(si, World.from_polygons([], bounds=(-10, -10, 10, 10), robot_radius=0.1))
    si.setup()
    start, goal = si.allocState(), si.allocState()
    start[0], start[1], goal[0], goal[1] = -8.0, -8.0, 8.0, 8.0
    mix = ob.MultiOptimizationObjective(si)
    mix.addObjective(DriftObjective(si, NOISE, goal), 2.0)
    mix.addObjective(ob.PathLengthOptimizationObjective(si), 0.5)
    straight = mix.motionCost(start, goal).value()
    mix.setCostThreshold(ob.Cost(1.05 * straight))
    pdef = ob.ProblemDefinition(si)
    pdef.setStartAndGoalStates(start, goal)
    pdef.setOptimizationObjective(mix)
    chosen = planner(si)
    chosen.setProblemDefinition(pdef)
    chosen.setup()
    chosen.solve(60.0)
    assert straight * (1 - 1e-9) <= pdef.getSolutionPath().cost(mix).value() < 1.05 * straight


def test_a_planner_stops_when_the_error_is_small_enough():
    si = information("plane")
    si.setStateValidityChecker(lambda state: True)
    si.setup()
    start, goal = si.allocState(), si.allocState()
    start[0], start[1], goal[0], goal[1] = -8.0, -8.0, 8.0, 8.0
    pdef = ob.ProblemDefinition(si)
    pdef.setStartAndGoalStates(start, goal)
    objective = DriftObjective(si, NOISE, (8.0, 8.0))
    straight = objective.motionCost(start, goal).value() ** 0.5
    objective.set_error_threshold(1.05 * straight)
    pdef.setOptimizationObjective(objective)
    planner = og.RRTstar(si)
    planner.setProblemDefinition(pdef)
    planner.setup()
    planner.solve(60.0)
    assert pdef.hasOptimizedSolution()
    assert pdef.getSolutionPath().cost(objective).value() ** 0.5 < 1.05 * straight


@pytest.mark.parametrize(
    "noise",
    [
        OdometryNoise(heading_var_per_m=1e-3, heading_bias_per_m=1e-3),
        OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3, heading_distance_corr=0.5),
        OdometryNoise.per_step(heading_std=0.1, distance_std=0.1, step_m=1.0),
    ],
)
def test_no_threshold_is_promised_where_the_cost_is_no_bound(noise):
    objective = DriftObjective(information("plane"), noise, (3.0, -2.0))
    with pytest.raises(ValueError, match="does not bound the error"):
        objective.set_error_threshold(1.0)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_thresholds_that_make_no_sense_are_refused(value):
    with pytest.raises(ValueError, match="threshold > 0 m"):
        DriftObjective(information("plane"), NOISE, (3.0, -2.0)).set_error_threshold(value)


def test_a_threshold_on_a_mix_is_refused():
    objective = DriftObjective(information("plane"), NOISE, (3.0, -2.0), length_weight=0.1)
    with pytest.raises(ValueError, match="length_weight=0"):
        objective.set_error_threshold(1.0)


def test_a_subclass_may_price_motions_its_own_way():
    class Doubled(DriftObjective):
        def motionCost(self, a, b):
            return ob.Cost(2 * super().motionCost(a, b).value())

    si = information("plane")
    a, b = random_states(si, "plane", 13, 2)
    objective = Doubled(si, NOISE, (3.0, -2.0))
    path = og.PathGeometric(si, a, b)
    plain = DriftObjective(si, NOISE, (3.0, -2.0))
    assert path.cost(objective).value() == 2 * path.cost(plain).value() > 0
    assert objective.motionCostHeuristic(a, b).value() == plain.motionCostHeuristic(a, b).value() > 0


def test_a_problem_with_another_goal_is_told_apart():
    si = information("se2")
    objective = DriftObjective(si, NOISE, (3.0, -2.0))
    here, elsewhere = si.allocState(), si.allocState()
    here.setXY(3.0, -2.0), here.setYaw(1.0), elsewhere.setXY(3.0, 2.0), elsewhere.setYaw(1.0)
    problem = ob.ProblemDefinition(si)
    problem.setStartAndGoalStates(elsewhere, here)
    objective.check_goal(problem.getGoal())
    problem.setGoalState(elsewhere)
    with pytest.raises(PlannerError, match=r"weighs drift, at \(3.0, -2.0\), got \[\(3.0, 2.0\)\]"):
        objective.check_goal(problem.getGoal())


# Goals


@pytest.mark.parametrize("name", SPACES)
def test_a_goal_may_be_a_point_a_state_or_a_goal_state(name):
    si = information(name)
    state, other, a = random_states(si, name, 14, 3)
    goal = ob.GoalState(si)
    goal.setState(state)
    goals = ob.GoalStates(si)
    goals.addState(state)
    if name not in ("plane", "space"):  # another attitude at the same place
        twin = si.allocState()
        si.copyState(twin, state)
        if name == "se3":
            twin.rotation().setIdentity()
        else:
            twin.setYaw(1.0)
        goals.addState(twin)
    point = tuple(position(state, name).tolist())
    costs = {DriftObjective(si, NOISE, g).motionCost(a, other).value() for g in (point, state, goal, goals)}
    assert len(costs) == 1


def test_several_goal_positions_and_goal_regions_are_refused():
    si = information("plane")
    goals = ob.GoalStates(si)
    with pytest.raises(ValueError, match="without any state"):
        DriftObjective(si, NOISE, goals)
    for state in random_states(si, "plane", 15, 2):
        goals.addState(state)
    with pytest.raises(ValueError, match=r"share one position, got 2 different ones: .* one objective per goal"):
        DriftObjective(si, NOISE, goals)

    class Disc(ob.GoalRegion):
        def distanceGoal(self, state):
            return 0.0

    with pytest.raises(ValueError, match=r"at one position, got a Disc: .* the region's centre"):
        DriftObjective(si, NOISE, Disc(si))


def test_where_paths_end_elsewhere_the_cost_bounds_the_error_of_the_place_seen_from_there():
    """The place is where an errorless run from the end of the path leads, in the estimate as in truth."""
    si = information("plane")
    place = np.array([3.0, -2.0])
    noise = OdometryNoise(heading_var_per_m=2e-3, distance_var_per_m=1e-3)
    objective = DriftObjective(si, noise, tuple(place))
    rng = np.random.default_rng(3)
    for _ in range(20):
        xy = rng.uniform(-9, 9, (5, 2))
        states = [si.allocState() for _ in xy]
        for state, (x, y) in zip(states, xy.tolist(), strict=True):
            state[0], state[1] = x, y
        cost = sum(objective.motionCost(a, b).value() for a, b in pairwise(states))
        seen = predict_drift(np.concatenate([xy, [place]]), [noise] * 4 + [OdometryNoise()]).end
        assert float(bracket(seen.heading_std)) * cost <= float(seen.rms) ** 2 <= cost * (1 + 1e-12)


@pytest.mark.parametrize("planner", [og.RRTstar, og.InformedRRTstar])
def test_planners_reach_a_goal_region(planner):
    class Half(ob.GoalRegion):
        def distanceGoal(self, state):
            return max(0.0, 4.0 - state[0])

    si = information("plane")
    use_world(si, World.from_polygons([], bounds=(-10, -10, 10, 10), robot_radius=0.1))
    si.setup()
    start = si.allocState()
    start[0], start[1] = -8.0, 0.0
    pdef = ob.ProblemDefinition(si)
    pdef.addStartState(start)
    goal = Half(si)
    pdef.setGoal(goal)
    objective = DriftObjective(si, NOISE, (8.0, 0.0))
    objective.setCostThreshold(objective.infiniteCost())
    pdef.setOptimizationObjective(objective)
    chosen = planner(si)
    chosen.setProblemDefinition(pdef)
    chosen.setup()
    assert chosen.solve(60.0)
    assert pdef.hasExactSolution()
    path = pdef.getSolutionPath()
    assert path.getState(path.getStateCount() - 1)[0] >= 4.0


@pytest.mark.parametrize("goal", [(1.0,), (1.0, 2.0, 3.0), (np.nan, 1.0), (np.inf, 0.0), "here", None, [[1.0, 2.0]]])
def test_goals_that_are_no_points_are_refused(goal):
    with pytest.raises(ValueError, match="expected goal"):
        DriftObjective(information("plane"), NOISE, goal)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: ob.RealVectorStateSpace(1), "RealVectorStateSpace of dimension 1"),
        (lambda: ob.RealVectorStateSpace(6), "RealVectorStateSpace of dimension 6"),
        (ob.SO2StateSpace, "SO2StateSpace"),
        (lambda: ob.TrochoidStateSpace(1.0, 0.1, 0.2), "TrochoidStateSpace"),
        (lambda: ob.OwenStateSpace(1.0, 0.5), "OwenStateSpace"),
    ],
)
def test_spaces_of_unknown_motions_are_refused(make, said):
    with pytest.raises(ValueError, match=f"state space of known motions .* got {said}"):
        DriftObjective(ob.SpaceInformation(make()), NOISE, (0.0, 0.0))


def test_other_bad_input_is_refused():
    si = information("plane")
    with pytest.raises(ValueError, match="OdometryNoise"):
        DriftObjective(si, 0.1, (0.0, 0.0))
    for weight in (-1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="length_weight"):
            DriftObjective(si, NOISE, (0.0, 0.0), length_weight=weight)
    with pytest.raises(ValueError, match="no world in a space of three dimensions, got World"):
        DriftObjective(information("se3"), NOISE, (0.0, 0.0, 0.0), WORLD)


def test_a_turn_on_the_spot_costs_its_turn():
    si = information("se2")
    objective = DriftObjective(si, NOISE, (3.0, -2.0))
    a, b = si.allocState(), si.allocState()
    for state, yaw in ((a, 3.0), (b, -3.0)):
        state.setXY(1.0, 1.0)
        state.setYaw(yaw)
    expected = turn_cost([1.0, 1.0], 2 * pi - 6.0, [3.0, -2.0], NOISE)
    assert objective.motionCost(a, b).value() == pytest.approx(float(expected), rel=1e-12)
