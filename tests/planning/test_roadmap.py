"""RoadmapPlanner inside OMPL: SimpleSetup, allocators, Benchmark, foreign validity checkers, repeated and cleared runs.

What leaks at exit or hangs can only be seen from outside, so those tests run a script in a process of its own.
"""

import subprocess
import sys
import textwrap

import numpy as np
import pytest
from ompl import base as ob
from ompl import geometric as og
from ompl import tools as ot

from driftplan.errors import PlannerError
from driftplan.model.noise import OdometryNoise
from driftplan.planning.ompl.collision import use_world
from driftplan.planning.ompl.objective import DriftObjective
from driftplan.planning.ompl.paths import predict_ompl_path
from driftplan.planning.ompl.roadmap_planner import RoadmapPlanner
from driftplan.planning.roadmap.growth import RoadmapSearch
from driftplan.planning.roadmap.prices import AdditiveCost
from driftplan.world.world import World
from driftplan.world.zones import Zone

NOISE = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3)
WALLS = [[(4, 2), (5, 2), (5, 9), (4, 9)], [(8, 0), (9, 0), (9, 6), (8, 6)], [(12, 4), (13, 4), (13, 10), (12, 10)]]
WORLD = World.from_polygons(WALLS, bounds=(0, 0, 16, 10), robot_radius=0.3)
START, GOAL = (1.0, 9.0), (15.0, 9.0)


pytestmark = pytest.mark.usefixtures("quiet")


def with_zone(polygon, noise):
    return World.from_polygons(WALLS, bounds=(0, 0, 16, 10), robot_radius=0.3, zones=[Zone(polygon, noise)])


class Batches:
    """A termination condition: so many batches of a planner, however long they take."""

    def __init__(self, planner, count):
        self.planner, self.count = planner, count

    def __call__(self):
        queries = self.planner._queries
        searches = [query.search for query in queries]
        return bool(searches) and all(search.is_optimal or search.batches >= self.count for search in searches)


def plane(world=WORLD, start=START, goal=GOAL, bounds=None):
    """A SimpleSetup over R^2 whose checkers ask the world."""
    space = ob.RealVectorStateSpace(2)
    xmin, ymin, xmax, ymax = bounds or world.bounds
    limits = ob.RealVectorBounds(2)
    for axis, (low, high) in enumerate(((xmin, xmax), (ymin, ymax))):
        limits.setLow(axis, low)
        limits.setHigh(axis, high)
    space.setBounds(limits)
    setup = og.SimpleSetup(space)
    si = setup.getSpaceInformation()
    use_world(si, world)
    a, b = si.allocState(), si.allocState()
    (a[0], a[1]), (b[0], b[1]) = start, goal
    setup.setStartAndGoalStates(a, b)
    return setup, si


def solve(setup, planner, batches=2, seconds=20.0):
    setup.setPlanner(planner)
    setup.setup()
    condition = ob.PlannerTerminationCondition(Batches(planner, batches))
    limit = ob.timedPlannerTerminationCondition(seconds)
    return setup.solve(ob.plannerOrTerminationCondition(condition, limit))


def waypoints(setup):
    states = setup.getProblemDefinition().getSolutionPath().getStates()
    return np.array([(q[0], q[1]) for q in states])


def searched(world, ends, noise, *, minimise="drift", batches, seed=0):
    search = RoadmapSearch(AdditiveCost(world, ends[1], noise, minimise), ends[0], seed=seed)
    while search.batches < batches and not search.is_optimal:
        search.grow()
    return search


def test_it_finds_in_ompl_the_path_that_the_plain_verb_finds():
    setup, si = plane()
    objective = DriftObjective(si, NOISE, GOAL)
    setup.setOptimizationObjective(objective)
    status = solve(setup, RoadmapPlanner(si, objective, WORLD, seed=3))
    assert status.getStatus() == ob.PlannerStatus.EXACT_SOLUTION
    plain = searched(WORLD, np.array([START, GOAL]), NOISE, batches=2, seed=3)
    np.testing.assert_array_equal(waypoints(setup), plain.path)
    path = setup.getSolutionPath()
    assert path.check()
    assert path.cost(objective).value() == pytest.approx(plain.additive_cost, rel=1e-12)


def test_the_objective_of_the_problem_is_taken_when_none_is_given():
    setup, si = plane()
    setup.setOptimizationObjective(ob.PathLengthOptimizationObjective(si))
    solve(setup, RoadmapPlanner(si, world=WORLD))
    shortest = searched(WORLD, np.array([START, GOAL]), NOISE, minimise="length", batches=2)
    assert setup.getSolutionPath().length() == pytest.approx(shortest.cost, rel=1e-12)


def test_foreign_checkers_decide_where_there_is_no_world():
    class Disc(ob.StateValidityChecker):
        def isValid(self, state):
            return (state[0] - 5) ** 2 + (state[1] - 5) ** 2 > 4

    space = ob.RealVectorStateSpace(2)
    space.setBounds(0, 10)
    setup = og.SimpleSetup(space)
    si = setup.getSpaceInformation()
    setup.setStateValidityChecker(Disc(si))
    si.setStateValidityCheckingResolution(0.002)
    a, b = si.allocState(), si.allocState()
    a[0], a[1], b[0], b[1] = 1.0, 5.0, 9.0, 5.0
    setup.setStartAndGoalStates(a, b)
    setup.setOptimizationObjective(ob.PathLengthOptimizationObjective(si))
    solve(setup, RoadmapPlanner(si), batches=2, seconds=60.0)
    # Two tangents and the arc between them; a polygon about the disc is a little longer, and steps of 2 cm cut it.
    tangent, angle = np.sqrt(16 - 4), np.pi - 2 * np.arccos(2 / 4)
    assert setup.getSolutionPath().length() == pytest.approx(2 * tangent + 2 * angle, rel=3e-3)
    assert setup.getSolutionPath().check()


def test_solving_again_goes_on_and_clearing_starts_afresh():
    setup, si = plane()
    objective = DriftObjective(si, NOISE, GOAL)
    setup.setOptimizationObjective(objective)
    planner = RoadmapPlanner(si, objective, WORLD)
    solve(setup, planner, batches=1)
    first = waypoints(setup)
    cost = setup.getSolutionPath().cost(objective).value()
    nodes = len(planner.roadmap()[0])
    solve(setup, planner, batches=3)
    assert setup.getSolutionPath().cost(objective).value() <= cost
    assert setup.getProblemDefinition().getSolutionCount() == 1
    assert len(planner.roadmap()[0]) > nodes
    setup.clear()
    assert len(planner.roadmap()[0]) == 0
    solve(setup, planner, batches=1)
    np.testing.assert_array_equal(waypoints(setup), first)


def test_seconds_and_conditions_are_obeyed():
    setup, si = plane()
    setup.setOptimizationObjective(DriftObjective(si, NOISE, GOAL))
    planner = RoadmapPlanner(si, world=WORLD)
    planner.setProblemDefinition(setup.getProblemDefinition())
    planner.setup()
    assert planner.solve(ob.plannerAlwaysTerminatingCondition()).getStatus() == ob.PlannerStatus.TIMEOUT
    assert planner.solve(0.5).getStatus() == ob.PlannerStatus.EXACT_SOLUTION  # a number of seconds will do


def test_a_cost_threshold_ends_the_search():
    setup, si = plane()
    objective = DriftObjective(si, NOISE, GOAL)
    objective.set_error_threshold(5.0)
    setup.setOptimizationObjective(objective)
    planner = RoadmapPlanner(si, objective, WORLD)
    setup.setPlanner(planner)
    assert setup.solve(60.0)
    assert planner._queries[0].search.batches == 1


def test_the_best_of_several_starts_is_taken():
    setup, si = plane()
    objective = DriftObjective(si, NOISE, GOAL)
    setup.setOptimizationObjective(objective)
    near = si.allocState()
    near[0], near[1] = 10.5, 8.0
    setup.getProblemDefinition().addStartState(near)
    solve(setup, RoadmapPlanner(si, objective, WORLD), batches=1)
    np.testing.assert_array_equal(waypoints(setup)[0], [10.5, 8.0])


@pytest.mark.parametrize("nearer", [0, 1])
def test_of_several_goals_the_one_with_the_least_drift_is_driven_to(nearer):
    """Each is planned for with drift weighed by the distance to itself, whichever the objective was made for."""
    goals = [GOAL, (2.0, 8.0)]
    setup, si = plane()
    states = ob.GoalStates(si)
    for x, y in goals:
        state = si.allocState()
        state[0], state[1] = x, y
        states.addState(state)
    setup.setGoal(states)
    objective = DriftObjective(si, NOISE, goals[nearer])
    setup.setOptimizationObjective(objective)
    planner = RoadmapPlanner(si, objective, WORLD)
    solve(setup, planner)
    costs = [searched(WORLD, np.array([START, goal]), NOISE, batches=2).cost for goal in goals]
    np.testing.assert_array_equal(waypoints(setup)[-1], goals[int(np.argmin(costs))])
    assert planner._best().search.cost == pytest.approx(min(costs), rel=1e-9)


class Disc(ob.GoalRegion):
    """All within a metre of the goal."""

    def distanceGoal(self, state):
        return max(0.0, float(np.hypot(state[0] - GOAL[0], state[1] - GOAL[1])) - 1.0)


def test_in_a_goal_region_the_path_leads_to_the_place_of_the_objective():
    inside, outside = (GOAL[0] - 0.5, GOAL[1]), (GOAL[0] - 1.5, GOAL[1])
    setup, si = plane()
    setup.setGoal(Disc(si))
    objective = DriftObjective(si, NOISE, inside)
    setup.setOptimizationObjective(objective)
    assert solve(setup, RoadmapPlanner(si, objective, WORLD))
    np.testing.assert_array_equal(waypoints(setup)[-1], inside)
    setup.clear()
    objective = DriftObjective(si, NOISE, outside)
    setup.setOptimizationObjective(objective)
    setup.setPlanner(RoadmapPlanner(si, objective, WORLD))
    with pytest.raises(PlannerError, match="which is not in it"):
        setup.solve(20.0)
    objective = ob.PathLengthOptimizationObjective(si)
    setup.setOptimizationObjective(objective)
    setup.setPlanner(RoadmapPlanner(si, objective, WORLD))
    with pytest.raises(PlannerError, match="expected goal states for the shortest path, got a Disc"):
        setup.solve(20.0)


def test_a_region_with_endlessly_many_goals_does_not_hang_it():
    setup, si = plane()
    everywhere = ob.GoalSpace(si)
    everywhere.setSpace(si.getStateSpace())
    setup.setGoal(everywhere)
    objective = DriftObjective(si, NOISE, GOAL)
    setup.setOptimizationObjective(objective)
    assert solve(setup, RoadmapPlanner(si, objective, WORLD), batches=1)
    np.testing.assert_array_equal(waypoints(setup)[-1], GOAL)


def test_ompls_mix_of_drift_and_length_is_planned_for_like_the_objectives_own():
    paths = []
    for mixed in (False, True):
        setup, si = plane()
        objective = DriftObjective(si, NOISE, GOAL, length_weight=0.0 if mixed else 0.5)
        if mixed:
            drift, objective = objective, ob.MultiOptimizationObjective(si)
            objective.addObjective(drift, 2.0)
            objective.addObjective(ob.PathLengthOptimizationObjective(si), 0.7)
            objective.addObjective(ob.PathLengthOptimizationObjective(si), 0.3)
        setup.setOptimizationObjective(objective)
        planner = RoadmapPlanner(si, world=WORLD)
        solve(setup, planner)
        paths.append(waypoints(setup))
        times = 2.0 if mixed else 1.0
        cost = setup.getSolutionPath().cost(objective).value()
        assert times * planner._best().search.additive_cost == pytest.approx(cost, rel=1e-9)
    np.testing.assert_array_equal(*paths)
    setup.clear()
    objective.setCostThreshold(ob.Cost(1.01 * cost))  # of the mix, not of its drift
    assert setup.solve(60.0)
    assert setup.getSolutionPath().cost(objective).value() <= 1.01 * cost


def test_samples_stay_within_the_bounds_of_the_space():
    setup, si = plane(bounds=(0, 0, 16, 9.5))
    objective = DriftObjective(si, NOISE, GOAL)
    setup.setOptimizationObjective(objective)
    planner = RoadmapPlanner(si, objective, WORLD)
    solve(setup, planner)
    assert planner.roadmap()[0][:, 1].max() <= 9.5
    assert setup.getSolutionPath().check()


def test_a_price_on_length_shortens_the_path_and_zones_are_priced_as_the_objective_prices_them():
    world = with_zone([(5, 6), (8, 6), (8, 10), (5, 10)], OdometryNoise(heading_var_per_m=0.1))
    lengths = []
    for weight in (0.0, 10.0):
        setup, si = plane(world)
        objective = DriftObjective(si, NOISE, GOAL, world, length_weight=weight)
        setup.setOptimizationObjective(objective)
        planner = RoadmapPlanner(si, objective, world)
        solve(setup, planner)
        path = setup.getSolutionPath()
        assert planner._queries[0].search.additive_cost == pytest.approx(path.cost(objective).value(), rel=1e-9)
        lengths.append(path.length())
    assert lengths[1] < lengths[0]


def test_headings_are_turned_on_the_spot_in_se2_and_at_a_goal_of_any_heading_not_at_all():
    noise = OdometryNoise(heading_var_per_m=1e-4, heading_var_per_rad=2e-2)
    space = ob.SE2StateSpace()
    limits = ob.RealVectorBounds(2)
    limits.setLow(0)
    limits.setHigh(10)
    space.setBounds(limits)
    setup = og.SimpleSetup(space)
    si = setup.getSpaceInformation()
    world = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)
    use_world(si, world)
    a, b = si.allocState(), si.allocState()
    a.setXY(2, 2), a.setYaw(1.2), b.setXY(8, 2), b.setYaw(0.0)
    setup.setStartAndGoalStates(a, b)
    objective = DriftObjective(si, noise, (8.0, 2.0))
    setup.setOptimizationObjective(objective)
    planner = RoadmapPlanner(si, objective, world)
    solve(setup, planner)
    path = setup.getSolutionPath()
    assert path.check()
    search = planner._queries[0].search
    assert path.cost(objective).value() == pytest.approx(search.additive_cost, rel=1e-9)
    assert float(predict_ompl_path(path, si, noise).end.rms) ** 2 == pytest.approx(search.cost, rel=1e-9)
    yaws = [state.getYaw() for state in path.getStates()]
    assert (yaws[0], yaws[-1]) == (1.2, 0.0)

    class AnyHeading(ob.GoalRegion):
        def distanceGoal(self, state):
            return float(np.hypot(state.getX() - 8.0, state.getY() - 2.0))

    setup.clear()
    goal = AnyHeading(si)
    goal.setThreshold(1e-6)
    setup.setGoal(goal)
    solve(setup, RoadmapPlanner(si, objective, world))
    states = setup.getSolutionPath().getStates()
    before, last = states[-2], states[-1]
    assert (last.getX(), last.getY()) == (8.0, 2.0)
    course = np.arctan2(last.getY() - before.getY(), last.getX() - before.getX())
    assert last.getYaw() == pytest.approx(course)


def test_the_bound_is_below_the_cost_and_unknown_before_there_is_a_path():
    setup, si = plane()
    objective = DriftObjective(si, NOISE.scaled(3.0), GOAL)
    setup.setOptimizationObjective(objective)
    planner = RoadmapPlanner(si, objective, WORLD)
    assert planner.bound() == (0.0, np.inf)
    setup.setPlanner(planner)
    assert setup.solve(0.3)
    assert 0.5 < planner.bound()[0] / planner._queries[0].search.cost <= 1


def test_an_allocator_and_the_benchmark_tool_take_it():
    setup, si = plane()
    objective = DriftObjective(si, NOISE, GOAL)
    setup.setOptimizationObjective(objective)
    setup.setPlannerAllocator(lambda si: RoadmapPlanner(si, world=WORLD))
    assert setup.solve(0.1)
    assert setup.getPlanner().getName() == "Roadmap"
    benchmark = ot.Benchmark(setup, "corridors")
    benchmark.addPlanner(RoadmapPlanner(si, objective, WORLD))
    benchmark.addPlannerAllocator(lambda si: RoadmapPlanner(si, world=WORLD, name="again"))
    found = []
    benchmark.setPostRunEvent(
        lambda planner, run: found.append(
            (
                planner.getProblemDefinition().getSolutionPath().cost(objective).value(),
                planner.bestCost().value(),
                len(planner.roadmap()[0]),
            )
        )
    )
    request = ot.Request()
    request.maxTime, request.runCount = 0.2, 2
    request.simplify = False  # which makes paths short, whatever they cost
    request.displayProgress = request.saveConsoleOutput = False  # it would write a file where the tests are run
    benchmark.benchmark(request)
    assert len(found) == 4
    for cost, best, nodes in found:
        assert best == pytest.approx(cost, rel=1e-9)
        assert nodes > 10


# Refusals


def test_objectives_that_cannot_be_priced_in_bulk_are_refused():
    class Own(DriftObjective):
        def motionCost(self, a, b):
            return ob.Cost(1.0)

    _, si = plane()
    drift, length = DriftObjective(si, NOISE, GOAL), ob.PathLengthOptimizationObjective(si)
    with pytest.raises(PlannerError, match="got StateCostIntegralObjective"):
        RoadmapPlanner(si, ob.StateCostIntegralObjective(si, True))
    with pytest.raises(PlannerError, match="got an empty one"):
        RoadmapPlanner(si, ob.MultiOptimizationObjective(si))
    for parts in ([(drift, 1.0), (drift, 1.0)], [(drift, -1.0)], [(length, 0.0)], [(Own(si, NOISE, GOAL), 1.0)]):
        mixed = ob.MultiOptimizationObjective(si)
        for part, weight in parts:
            mixed.addObjective(part, weight)
        with pytest.raises(PlannerError, match=r"of one DriftObjective and path lengths|a motionCost of its own"):
            RoadmapPlanner(si, mixed)
    with pytest.raises(PlannerError, match="got Own with a motionCost of its own"):
        RoadmapPlanner(si, Own(si, NOISE, GOAL))
    correlated = OdometryNoise(heading_var_per_m=1e-3, heading_distance_corr=0.5)
    with pytest.raises(PlannerError, match="length_weight=0"):
        RoadmapPlanner(si, DriftObjective(si, correlated, GOAL, length_weight=1.0))


def test_spaces_of_other_motions_are_refused():
    for space in (ob.DubinsStateSpace(1.0), ob.SE2StateSpace(), ob.RealVectorStateSpace(3)):
        with pytest.raises(PlannerError, match="expected RealVectorStateSpace"):
            RoadmapPlanner(ob.SpaceInformation(space))


def test_another_goal_than_the_objectives_is_refused():
    setup, si = plane()
    objective = DriftObjective(si, NOISE, (14.0, 9.0))
    setup.setOptimizationObjective(objective)
    setup.setPlanner(RoadmapPlanner(si, objective, WORLD))
    with pytest.raises(PlannerError, match="expected the problem's goal where the objective weighs drift"):
        setup.solve(1.0)


def test_zones_need_their_world():
    world = with_zone([(5, 6), (8, 6), (8, 10)], NOISE)
    setup, si = plane(world)
    objective = DriftObjective(si, NOISE, GOAL, world)
    setup.setOptimizationObjective(objective)
    setup.setPlanner(RoadmapPlanner(si, objective))
    with pytest.raises(PlannerError, match="expected the world whose 1 zones the objective prices"):
        setup.solve(1.0)


def test_an_error_in_a_foreign_checker_reaches_the_caller():
    class Broken(ob.StateValidityChecker):
        def isValid(self, state):
            if state[0] == 1.0:  # the start, which OMPL looks at first
                return True
            raise ZeroDivisionError("broken")

    setup, si = plane()
    setup.setStateValidityChecker(Broken(si))
    setup.setOptimizationObjective(ob.PathLengthOptimizationObjective(si))
    setup.setPlanner(RoadmapPlanner(si))
    with pytest.raises(ZeroDivisionError, match="broken"):
        setup.solve(5.0)


# Seen from outside


def run_script(body, seconds=60):
    script = textwrap.dedent(body)
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=seconds, check=False)


SCRIPT = """
import resource, signal, sys, threading, os
from ompl import base as ob, geometric as og, util as ou
from driftplan.model.noise import OdometryNoise
from driftplan.planning.ompl.collision import use_world
from driftplan.planning.ompl.objective import DriftObjective
from driftplan.planning.ompl.roadmap_planner import RoadmapPlanner
from driftplan.world.world import World

WORLD = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)

def build(world):
    space = ob.RealVectorStateSpace(2)
    space.setBounds(0, 10)
    setup = og.SimpleSetup(space)
    si = setup.getSpaceInformation()
    use_world(si, WORLD)
    a, b = si.allocState(), si.allocState()
    a[0], a[1], b[0], b[1] = 2.0, 2.0, 8.0, 2.0
    setup.setStartAndGoalStates(a, b)
    objective = DriftObjective(si, OdometryNoise(heading_var_per_m=1e-4), (8.0, 2.0))
    setup.setOptimizationObjective(objective)
    planner = RoadmapPlanner(si, objective, world)
    setup.setPlanner(planner)
    return setup, planner

ou.setLogLevel(ou.LOG_NONE)
"""


@pytest.mark.parametrize("world", ["WORLD", "None"])
def test_nothing_leaks_at_exit_even_from_a_script_with_globals(world):
    done = run_script(
        SCRIPT
        + textwrap.dedent(f"""
        setup, planner = build({world})
        assert setup.solve(0.5)
        path = setup.getProblemDefinition().getSolutionPath()
        print(path.getStateCount() > 2)
        """)
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "True\n", "")


def test_ctrl_c_stops_a_run_within_a_second():
    done = run_script(
        SCRIPT
        + textwrap.dedent("""
        import time
        signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may have it ignored in the background
        setup, planner = build(WORLD)
        threading.Timer(1.0, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
        began = time.monotonic()
        try:
            setup.solve(40.0)
        except KeyboardInterrupt:
            print("stopped", time.monotonic() - began < 4.0)  # generous: the machine may be busy
        """)
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "stopped True\n", "")


@pytest.mark.slow
def test_memory_does_not_grow_over_many_plans():
    done = run_script(
        SCRIPT
        + textwrap.dedent("""
        def plan():
            setup, planner = build(WORLD)
            setup.getProblemDefinition().getOptimizationObjective().setCostThreshold(ob.Cost(1e9))
            assert setup.solve(20.0)  # the first batch satisfies the objective

        for _ in range(20):
            plan()
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        for _ in range(100):
            plan()
        print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 8_000)  # kB
        """),
        seconds=200,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "True\n", "")
