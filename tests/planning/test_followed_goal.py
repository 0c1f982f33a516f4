"""A goal that changes: an objective made for the problem weighs drift where the goal is by then, and leaves nothing."""

import subprocess
import sys
import textwrap

import pytest
from ompl import base as ob
from ompl import geometric as og

from driftplan.model.noise import OdometryNoise
from driftplan.planning.ompl.collision import use_world
from driftplan.planning.ompl.objective import DriftObjective
from driftplan.planning.ompl.roadmap_planner import RoadmapPlanner
from driftplan.world.world import World

NOISE = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.1, after_m=10.0)
WORLD = World.from_polygons([[(8, 0), (10, 0), (10, 12), (8, 12)]], bounds=(0, 0, 30, 20), robot_radius=0.5)
START, GOALS = (3.0, 3.0), ((26.0, 4.0), (14.0, 17.0), (20.0, 10.0))
PLANNERS = {
    "RRT*": og.RRTstar,
    "informed RRT*": og.InformedRRTstar,
    "BIT*": og.BITstar,
    "roadmap": lambda si: RoadmapPlanner(si, world=WORLD),
}


pytestmark = pytest.mark.usefixtures("quiet")


def information(space=None):
    space = ob.RealVectorStateSpace(2) if space is None else space
    bounds = ob.RealVectorBounds(2)
    bounds.setLow(0)
    bounds.setHigh(30)
    space.setBounds(bounds)
    si = ob.SpaceInformation(space)
    use_world(si, WORLD)
    si.setup()
    return si


def at(si, xy, yaw=0.0):
    state = si.allocState()
    if hasattr(state, "setXY"):
        state.setXY(*xy), state.setYaw(yaw)
    else:
        state[0], state[1] = xy
    return state


@pytest.mark.parametrize("name", PLANNERS)
def test_a_planner_that_is_cleared_weighs_drift_at_its_new_goal(name):
    si = information()
    problem = ob.ProblemDefinition(si)
    problem.setStartAndGoalStates(at(si, START), at(si, GOALS[0]))
    objective = DriftObjective(si, NOISE, problem)
    problem.setOptimizationObjective(objective)
    planner = PLANNERS[name](si)
    planner.setProblemDefinition(problem)
    planner.setup()
    for goal in GOALS:
        planner.clear()
        problem.clearSolutionPaths()
        problem.setGoalState(at(si, goal))
        assert objective.goal == goal
        objective.setCostThreshold(objective.infiniteCost())  # the first path will do
        assert planner.solve(60.0)
        path = problem.getSolutionPath()
        assert (path.getStates()[-1][0], path.getStates()[-1][1]) == goal
        fresh = path.cost(DriftObjective(si, NOISE, goal)).value()
        assert path.cost(objective).value() == fresh
        assert planner.bestCost().value() == pytest.approx(fresh, rel=1e-9)


def test_the_roadmap_planner_takes_the_objective_of_its_problem_for_whatever_goal_comes():
    si = information()
    setup = og.SimpleSetup(si)
    setup.setStartAndGoalStates(at(si, START), at(si, GOALS[0]))
    objective = DriftObjective(si, NOISE, setup)
    setup.setOptimizationObjective(objective)
    planner = RoadmapPlanner(si, objective, WORLD)
    setup.setPlanner(planner)
    for goal in GOALS:
        setup.clear()
        setup.setGoalState(at(si, goal))
        assert setup.solve(ob.PlannerTerminationCondition(lambda: len(planner.roadmap()[0]) > 50))
        path = setup.getProblemDefinition().getSolutionPath()
        assert planner.bestCost().value() == pytest.approx(path.cost(DriftObjective(si, NOISE, goal)).value(), rel=1e-9)


@pytest.mark.parametrize(
    "make",
    [lambda: ob.RealVectorStateSpace(2), ob.SE2StateSpace, lambda: ob.DubinsStateSpace(1.0)],
    ids=["plane", "SE(2)", "Dubins"],
)
@pytest.mark.parametrize("form", ["problem", "setup", "goal", "goals"])
def test_prices_and_bounds_are_those_of_an_objective_made_for_the_goal_of_the_moment(make, form):
    si = information(make())
    setup = og.SimpleSetup(si)
    a, b = at(si, START), at(si, (7.0, 14.0), 1.0)
    goal = ob.GoalStates(si) if form == "goals" else ob.GoalState(si)
    if form == "goals":
        goal.addState(at(si, GOALS[0]))
    else:
        goal.setState(at(si, GOALS[0]))
    setup.setGoal(goal)
    given = {"setup": setup, "problem": setup.getProblemDefinition()}.get(form, goal)
    objective = DriftObjective(si, NOISE, given)
    assert objective.is_following
    for k, place in enumerate(GOALS):
        if form == "goals":
            goal.clear()
            goal.addState(at(si, place, 2.0))
        elif form == "goal" or k == 1:
            goal.setState(at(si, place, 2.0))  # the same goal, elsewhere
        else:
            setup.setGoalState(at(si, place, 2.0))  # another goal
            goal = setup.getGoal()
        fresh = DriftObjective(si, NOISE, place)
        assert objective.goal == place
        assert objective.motionCost(a, b).value() == fresh.motionCost(a, b).value()
        assert objective.motionCostHeuristic(b, a).value() == fresh.motionCostHeuristic(b, a).value()
        objective.check_goal(setup.getGoal())


def test_a_place_and_a_state_stay():
    si = information()
    state = at(si, GOALS[0])
    for objective in (DriftObjective(si, NOISE, GOALS[0]), DriftObjective(si, NOISE, state)):
        state[0] = 1.0
        assert not objective.is_following
        assert objective.goal == GOALS[0]
        state[0] = GOALS[0][0]


def test_a_problem_without_a_goal_and_one_that_is_given_a_region_are_refused():
    si = information()
    problem = ob.ProblemDefinition(si)
    with pytest.raises(ValueError, match="goal"):
        DriftObjective(si, NOISE, problem)
    problem.setGoalState(at(si, GOALS[0]))
    objective = DriftObjective(si, NOISE, problem)

    class Everywhere(ob.GoalRegion):
        def distanceGoal(self, state):
            return 0.0

    region = Everywhere(si)
    problem.setGoal(region)
    with pytest.raises(ValueError, match="got a Everywhere: a region has no single place"):
        objective.motionCost(at(si, START), at(si, GOALS[0]))


def test_a_problem_and_the_objective_that_follows_it_leave_nothing_at_exit():
    script = """
        from ompl import base as ob, geometric as og, util as ou
        from driftplan import DriftObjective, OdometryNoise
        ou.setLogLevel(ou.LOG_NONE)
        space = ob.RealVectorStateSpace(2)
        bounds = ob.RealVectorBounds(2)
        bounds.setLow(0), bounds.setHigh(10)
        space.setBounds(bounds)
        si = ob.SpaceInformation(space)
        for _ in range(3):
            setup = og.SimpleSetup(si)
            a, b = si.allocState(), si.allocState()
            a[0], a[1], b[0], b[1] = 1.0, 1.0, 9.0, 9.0
            setup.setStartAndGoalStates(a, b)
            setup.setOptimizationObjective(DriftObjective(si, OdometryNoise(heading_var_per_m=1e-3), setup))
            setup.setPlanner(og.BITstar(si))
            print(bool(setup.solve(0.05)))
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True, timeout=120, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "True\n" * 3, "")


def test_a_goal_that_is_set_over_and_over_is_never_read_where_it_was():
    """OMPL frees a goal's state when it is given another one."""
    si = information()
    goal = ob.GoalState(si)
    goal.setState(at(si, START))
    objective, kept = DriftObjective(si, NOISE, goal), []
    for k in range(500):
        place = (1.0 + 0.01 * k, 2.0)
        goal.setState(at(si, place))
        kept.append(si.allocState())  # which may take the place of the one that was freed
        assert objective.goal == place
