"""RoadmapPlanner with beacons inside OMPL: SimpleSetup, Benchmark, foreign checkers, limits, stops, second starts."""

import subprocess
import sys
import textwrap

import numpy as np
import pytest
from ompl import base as ob
from ompl import geometric as og

import driftplan
from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.readings import drift_with_beacons
from driftplan.errors import PlannerError
from driftplan.model.noise import OdometryNoise
from driftplan.planning.ompl.collision import use_world
from driftplan.planning.ompl.objective import DriftObjective
from driftplan.planning.ompl.roadmap_planner import RoadmapPlanner
from driftplan.planning.request import DriftLimit, Planner
from driftplan.planning.routes import plan_route
from driftplan.world.world import World
from driftplan.world.zones import Zone

NOISE = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.1, after_m=10.0)
SIGN = BeaconKind.landmark(range_m=3.0, position_std_m=0.05, heading_std=0.01)
WORLD = World.from_polygons([[(25, 0), (27, 0), (27, 8), (25, 8)]], bounds=(0, 0, 60, 40), robot_radius=0.5)
START, GOAL = (3.0, 10.0), (57.0, 10.0)
SIGNS = [Beacon(SIGN, 18, 18), Beacon(SIGN, 30, 19), Beacon(SIGN, 42, 18)]
LIMIT = 2.0
FEW = {"max_nodes": 100}  # one batch, so that no clock decides anything


def planned(*where, max_drift=None, redundancy=1, min_capture=None, max_nodes=1000, **asked):
    """The shortest route unless something else is to be least."""
    limit = DriftLimit(max_drift, redundancy=redundancy, min_capture=min_capture)
    planner = Planner(max_nodes=max_nodes)
    return plan_route(*where, **{"minimise": "length", "max_drift": limit, "planner": planner, **asked})


pytestmark = pytest.mark.usefixtures("quiet")


def bounds(world):
    limits = ob.RealVectorBounds(2)
    xmin, ymin, xmax, ymax = world.bounds
    for axis, (low, high) in enumerate(((xmin, xmax), (ymin, ymax))):
        limits.setLow(axis, low)
        limits.setHigh(axis, high)
    return limits


def plane(world=WORLD, start=START, goal=GOAL, ask_world=True):
    """A SimpleSetup over R^2 whose checkers ask the world, or nobody yet."""
    space = ob.RealVectorStateSpace(2)
    space.setBounds(bounds(world))
    setup = og.SimpleSetup(space)
    si = setup.getSpaceInformation()
    if ask_world:
        use_world(si, world)
    a, b = si.allocState(), si.allocState()
    (a[0], a[1]), (b[0], b[1]) = start, goal
    setup.setStartAndGoalStates(a, b)
    return setup, si


def solve(setup, planner, seconds=300.0):
    setup.setPlanner(planner)
    setup.setup()
    return setup.solve(seconds)


def waypoints(setup):
    return np.array([(q[0], q[1]) for q in setup.getProblemDefinition().getSolutionPath().getStates()])


def greatest(path, beacons=SIGNS, noise=NOISE, world=WORLD):
    return float(drift_with_beacons(path, noise, beacons, world).profile(0.05).rms.max())


def test_it_is_the_planner_that_the_package_exports():
    assert driftplan.RoadmapPlanner is RoadmapPlanner


def test_the_shortest_route_within_a_limit_is_that_of_plan_route():
    setup, si = plane()
    objective = DriftObjective(si, NOISE, GOAL)
    setup.setOptimizationObjective(objective)
    planner = RoadmapPlanner(si, objective, WORLD, beacons=SIGNS, max_drift=LIMIT, minimise="length", seed=2, **FEW)
    status = solve(setup, planner)
    assert status.getStatus() == ob.PlannerStatus.EXACT_SOLUTION
    assert setup.getSolutionPath().check()
    path = waypoints(setup)
    assert greatest(path) <= LIMIT * (1 + 1e-6) < greatest(path, beacons=[])
    plain = planned(WORLD, START, GOAL, NOISE, beacons=SIGNS, max_drift=LIMIT, max_nodes=100, seed=2, time_limit=300.0)
    assert planner.route().length == pytest.approx(plain.length, rel=1e-3)  # bounds of a space are open to rounding
    assert planner.route().path.tolist() == path.tolist()
    assert planner.bound()[0] == pytest.approx(plain.bound)
    assert len(planner.roadmap()[0]) > 80


def test_for_a_robot_with_a_filter_it_reads_ranges_and_tells_the_drift_of_the_filter():
    radios = [Beacon(BeaconKind.range_only(range_m=15.0, range_std_m=0.1), x, 25) for x in (15, 45)]
    setup, si = plane()
    objective = DriftObjective(si, NOISE, GOAL)
    setup.setOptimizationObjective(objective)
    asked = {"beacons": radios, "max_drift": LIMIT, "minimise": "length", **FEW}
    assert solve(setup, RoadmapPlanner(si, objective, WORLD, estimator="filter", seed=2, **asked))
    drift = drift_with_beacons(waypoints(setup), NOISE, radios, WORLD, estimator="filter")
    assert drift.profile(0.05).rms.max() <= LIMIT * (1 + 1e-6) < greatest(waypoints(setup), beacons=[])
    with pytest.raises(ValueError, match="expected estimator='filter'"):
        RoadmapPlanner(si, objective, WORLD, **asked)


def test_a_drift_objective_asks_for_the_least_drift_at_the_goal_within_a_detour():
    beside, all_count = [Beacon(SIGN, 50, 22)], DriftLimit(min_capture=0.0)
    ends = []
    for detour in (1.02, 1.5):
        setup, si = plane()
        objective = DriftObjective(si, NOISE, GOAL)
        setup.setOptimizationObjective(objective)
        solve(
            setup, RoadmapPlanner(si, objective, WORLD, beacons=beside, max_detour=detour, max_drift=all_count, **FEW)
        )
        rms = drift_with_beacons(waypoints(setup), NOISE, beside, WORLD).end.rms
        ends.append((rms, setup.getSolutionPath().length()))
    assert ends[1][0] < 0.8 * ends[0][0]
    assert ends[0][1] < ends[1][1] <= 1.5 * 54.1


def test_length_objectives_are_told_the_noise():
    setup, si = plane()
    objective = ob.PathLengthOptimizationObjective(si)
    setup.setOptimizationObjective(objective)
    solve(setup, RoadmapPlanner(si, objective, WORLD, beacons=SIGNS, max_drift=LIMIT, noise=NOISE, **FEW))
    assert greatest(waypoints(setup)) <= LIMIT * (1 + 1e-6)
    assert setup.getSolutionPath().length() < 62


def test_foreign_checkers_decide_where_there_is_no_world():
    class Disc(ob.StateValidityChecker):
        def isValid(self, state):
            return (state[0] - 30) ** 2 + (state[1] - 12) ** 2 > 16

    setup, si = plane(ask_world=False)
    setup.setStateValidityChecker(Disc(si))
    objective = DriftObjective(si, NOISE, GOAL)
    setup.setOptimizationObjective(objective)
    solve(setup, RoadmapPlanner(si, objective, beacons=SIGNS, max_drift=LIMIT, minimise="length", **FEW))
    path = waypoints(setup)
    assert setup.getSolutionPath().check()
    assert greatest(path, world=None) <= LIMIT * (1 + 1e-6)
    assert (np.hypot(*(path - (30, 12)).T) > 4).all()


def test_poses_count_the_first_turn_and_zones_their_noise():
    turning = OdometryNoise(heading_var_per_m=2e-4, distance_var_per_m=1e-3, heading_var_per_rad=2e-3)
    wet = Zone([(8, 0), (16, 0), (16, 40), (8, 40)], turning.scaled(2.0))
    world = World.from_polygons([], bounds=(0, 0, 60, 40), robot_radius=0.5, zones=[wet])
    space = ob.SE2StateSpace()
    space.setBounds(bounds(world))
    setup = og.SimpleSetup(space)
    si = setup.getSpaceInformation()
    use_world(si, world)
    a, b = si.allocState(), si.allocState()
    for state, (x, y), yaw in ((a, START, 3.0), (b, GOAL, 0.5)):
        state.setXY(x, y)
        state.setYaw(yaw)
    setup.setStartAndGoalStates(a, b)
    objective = DriftObjective(si, turning, GOAL, world=world)
    setup.setOptimizationObjective(objective)
    planner = RoadmapPlanner(si, objective, world, beacons=SIGNS, max_drift=3.0, minimise="length", **FEW)
    assert solve(setup, planner)
    found = planner.route()
    plain = planned(world, (*START, 3.0), GOAL, turning, beacons=SIGNS, max_drift=3.0, max_nodes=100, time_limit=300.0)
    assert found.worst_drift == pytest.approx(plain.worst_drift, rel=0.05)
    ahead = planned(world, START, GOAL, turning, beacons=SIGNS, max_drift=3.0, max_nodes=100, time_limit=300.0)
    assert float(found.drift.at(8.0).rms) > 1.5 * float(ahead.drift.at(8.0).rms)  # before the first sign
    states = setup.getSolutionPath().getStates()
    assert (states[0].getYaw(), states[-1].getYaw()) == (pytest.approx(3.0), pytest.approx(0.5))


def test_where_no_route_keeps_the_limit_there_is_no_solution_and_a_reason():
    setup, si = plane()
    objective = DriftObjective(si, NOISE, GOAL)
    setup.setOptimizationObjective(objective)
    planner = RoadmapPlanner(si, objective, WORLD, beacons=SIGNS[:1], max_drift=0.4, **FEW)
    status = solve(setup, planner)
    assert status.getStatus() == ob.PlannerStatus.TIMEOUT
    assert not setup.haveSolutionPath()
    assert "keeps the drift under 0.4 m everywhere" in planner.why_not()
    assert planner.route() is None


def test_a_second_solve_goes_on_and_clear_starts_afresh():
    setup, si = plane()
    objective = DriftObjective(si, NOISE, GOAL)
    setup.setOptimizationObjective(objective)
    asked = {"beacons": SIGNS, "max_drift": LIMIT, "minimise": "length", "max_nodes": 500}
    planner = RoadmapPlanner(si, objective, WORLD, **asked)
    setup.setPlanner(planner)
    setup.setup()
    one_batch = ob.PlannerTerminationCondition(
        lambda: bool(planner._queries) and planner._queries[0].search.batches > 0
    )
    setup.solve(one_batch)
    first = waypoints(setup)
    setup.solve(300.0)
    assert planner._queries[0].search.batches == 2
    second = waypoints(setup)
    length = [np.linalg.norm(np.diff(path, axis=0), axis=1).sum() for path in (first, second)]
    assert length[1] <= length[0]
    planner.clear()
    assert planner.route() is None
    assert planner.roadmap()[0].shape == (0, 2)
    setup.solve(one_batch)
    np.testing.assert_array_equal(waypoints(setup), first)


def test_another_problem_is_planned_for_without_being_told_to_clear():
    _, si = plane()
    planner = RoadmapPlanner(si, world=WORLD)
    for goal in (GOAL, (GOAL[0] - 3.0, GOAL[1])):
        problem, start, end = ob.ProblemDefinition(si), si.allocState(), si.allocState()
        (start[0], start[1]), (end[0], end[1]) = START, goal
        problem.setStartAndGoalStates(start, end)
        problem.setOptimizationObjective(DriftObjective(si, NOISE, goal))
        planner.setProblemDefinition(problem)
        planner.setup()
        assert planner.solve(ob.PlannerTerminationCondition(lambda: len(planner.roadmap()[0]) > 100))
        last = problem.getSolutionPath().getStates()[-1]
        assert (last[0], last[1]) == goal
        assert tuple(planner.roadmap()[0][1]) == goal


@pytest.mark.parametrize("calls", [0, 3, 30])
def test_it_stops_when_told_to_with_a_valid_path_or_none(calls):
    setup, si = plane()
    objective = DriftObjective(si, NOISE, GOAL)
    setup.setOptimizationObjective(objective)
    planner = RoadmapPlanner(si, objective, WORLD, beacons=SIGNS, max_drift=LIMIT)
    setup.setPlanner(planner)
    setup.setup()
    asked = []
    status = setup.solve(ob.PlannerTerminationCondition(lambda: asked.append(1) or len(asked) > calls))
    if status:
        assert setup.getSolutionPath().check()
        assert greatest(waypoints(setup)) <= LIMIT * (1 + 1e-6)
    else:
        assert status.getStatus() == ob.PlannerStatus.TIMEOUT


def test_what_a_checker_raises_comes_out_and_the_next_solve_works():
    class Moody(ob.StateValidityChecker):
        calls = 0

        def isValid(self, state):
            Moody.calls += 1
            if Moody.calls == 500:
                raise OverflowError("enough")
            return True

    setup, si = plane(ask_world=False)
    setup.setStateValidityChecker(Moody(si))
    objective = DriftObjective(si, NOISE, GOAL)
    setup.setOptimizationObjective(objective)
    planner = RoadmapPlanner(si, objective, beacons=SIGNS, max_drift=LIMIT, minimise="length", **FEW)
    with pytest.raises(OverflowError, match="enough"):
        solve(setup, planner)
    assert setup.solve(300.0)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"max_drift": -1.0}, "max_drift finite and > 0"),
        ({"beacons": ["A"]}, "Beacon objects"),
        ({"minimise": "time"}, "minimise one of"),
        ({"max_drift": DriftLimit(redundancy=3)}, "redundancy 1"),
        ({"max_drift": DriftLimit(1.0, confidence=0.9)}, "without a confidence"),
        ({"redundancy": 2}, r"did you mean max_drift=DriftLimit\(redundancy=…\)"),
        ({"beacons": SIGNS, "noise": "loud"}, "an OdometryNoise"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, said):
    _, si = plane()
    with pytest.raises(ValueError, match=said):
        driftplan.RoadmapPlanner(si, DriftObjective(si, NOISE, GOAL), WORLD, **options)


@pytest.mark.parametrize(
    ("objective", "options", "error", "said"),
    [
        (lambda si: ob.PathLengthOptimizationObjective(si), {}, ValueError, "noise=... together with"),
        (lambda si: DriftObjective(si, NOISE, GOAL), {"noise": NOISE}, ValueError, "noise only with"),
        (lambda si: DriftObjective(si, NOISE, GOAL, length_weight=0.1), {}, PlannerError, "length_weight=0"),
        (
            lambda si: DriftObjective(si, OdometryNoise.per_step(heading_std=0.1, distance_std=0.1, step_m=1.0), GOAL),
            {},
            ValueError,
            "continuous kind",
        ),
    ],
)
def test_objectives_that_do_not_say_enough_are_refused_when_planning_starts(objective, options, error, said):
    setup, si = plane()
    setup.setOptimizationObjective(objective(si))
    with pytest.raises(error, match=said):
        solve(setup, RoadmapPlanner(si, world=WORLD, beacons=SIGNS, **options))


@pytest.mark.parametrize("extra", ["", "planner.why_not()"])
@pytest.mark.slow
def test_ompls_benchmark_runs_it_and_nothing_leaks(extra):
    script = f"""
        from ompl import base as ob, geometric as og, tools as ot, util as ou
        from driftplan import Beacon, BeaconKind, DriftObjective, OdometryNoise, RoadmapPlanner, World
        from driftplan.planning.ompl.collision import use_world
        ou.setLogLevel(ou.LOG_NONE)
        world = World.from_polygons([], bounds=(0, 0, 60, 40), robot_radius=0.5)
        noise = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.1, after_m=10.0)
        sign = BeaconKind.landmark(range_m=3.0, position_std_m=0.05, heading_std=0.01)
        space = ob.RealVectorStateSpace(2)
        space.setBounds(0, 40)
        setup = og.SimpleSetup(space)
        si = setup.getSpaceInformation()
        use_world(si, world)
        start, goal = si.allocState(), si.allocState()
        start[0], start[1], goal[0], goal[1] = 3.0, 10.0, 37.0, 10.0
        setup.setStartAndGoalStates(start, goal)
        objective = DriftObjective(si, noise, goal)
        setup.setOptimizationObjective(objective)
        asked = dict(beacons=[Beacon(sign, 20, 16)], minimise="length", max_nodes=40)
        planner = RoadmapPlanner(si, objective, world, max_drift=1.5, **asked)
        benchmark = ot.Benchmark(setup, "beacons")
        benchmark.addPlanner(planner)
        hopeless = RoadmapPlanner(si, objective, world, max_drift=0.3, name="hopeless", **asked)
        benchmark.addPlanner(hopeless)
        request = ot.Request()
        request.maxTime, request.runCount = 60.0, 1
        request.displayProgress = request.saveConsoleOutput = False
        benchmark.benchmark(request)
        {extra}
        print("done", planner.route() is not None, hopeless.route() is None)
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert "done" in done.stdout
    assert "leak" not in done.stderr
