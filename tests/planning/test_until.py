"""Searches that are told when to stop, and how limits that can be kept are told."""

import itertools
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ompl import base as ob
from ompl import geometric as og

from driftplan.errors import InfeasibleError, PlannerError
from driftplan.model.noise import OdometryNoise
from driftplan.planning.ompl import solve
from driftplan.planning.ompl.collision import use_world
from driftplan.planning.ompl.objective import DriftObjective
from driftplan.planning.ompl.roadmap_planner import RoadmapPlanner
from driftplan.planning.ompl.solve import CostConvergence
from driftplan.planning.request import Planner, format_least
from driftplan.planning.roadmap.kept_graph import KeptGraph
from driftplan.planning.routes import plan_route
from driftplan.planning.status import Status
from driftplan.world.world import World

NOISE = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.1, after_m=10.0)
WALL = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)


class Countdown:
    """Says True when it has been asked so many times."""

    def __init__(self, times):
        self.left = times

    def __call__(self):
        self.left -= 1
        return self.left < 0


@pytest.mark.parametrize("planner", ["roadmap", "rrtstar"])
def test_a_search_goes_on_until_it_is_told_to_stop(planner):
    until = Countdown(60)
    route = plan_route(WALL, (2, 2), (8, 2), NOISE, planner=planner, until=until)
    assert until.left < 0
    assert route.status is Status.TIME_LIMIT
    assert 13 < route.length < 16


def test_a_condition_of_ompl_may_say_when():
    condition = ob.PlannerTerminationCondition(Countdown(100))
    assert plan_route(WALL, (2, 2), (8, 2), NOISE, until=condition).status is Status.TIME_LIMIT


def test_a_search_among_beacons_is_told_too():
    route = plan_route(WALL, (2, 2), (8, 2), NOISE, minimise="worst_drift", until=Countdown(20))
    assert route.status is Status.TIME_LIMIT


def test_whoever_says_until_does_not_wait_for_anything_else():
    """Neither for the usual limit, nor for being done."""
    began = time.monotonic()
    plan_route(WALL, (2, 2), (8, 2), NOISE, until=lambda: time.monotonic() > began + 0.6)
    assert time.monotonic() >= began + 0.6


def test_what_cannot_be_asked_is_refused():
    with pytest.raises(ValueError, match="expected until to be called without arguments, got 3"):
        plan_route(WALL, (2, 2), (8, 2), NOISE, until=3)


class Falling:
    """A planner whose best cost is what it is told to be."""

    def __init__(self, *costs):
        self.costs = iter(costs)

    def bestCost(self):
        return ob.Cost(next(self.costs))


def test_the_cost_has_settled_when_it_has_hardly_fallen_for_a_while(monkeypatch):
    """By a clock that ticks once a look; the first path comes at the third."""
    ticks = itertools.count()
    monkeypatch.setattr(solve.time, "monotonic", lambda: float(next(ticks)))
    nan, inf = float("nan"), float("inf")
    settled = CostConvergence(Falling(nan, inf, inf, inf, 10.0, 9.0, 8.95, 8.94, 8.93), share=0.01, seconds=3.0)
    assert [settled() for _ in range(9)] == [False] * 8 + [True]


def test_options_of_convergence_that_make_no_sense_are_refused():
    for wrong in ({"share": 0.0}, {"seconds": float("nan")}):
        with pytest.raises(ValueError, match=f"expected {next(iter(wrong))}"):
            CostConvergence(Falling(), **wrong)


@pytest.mark.parametrize("which", ["Roadmap", "RRTstar"])
def test_planners_stop_when_their_cost_has_settled(which):
    setup, si = problem()
    objective = DriftObjective(si, NOISE, (8.0, 2.0))
    setup.setOptimizationObjective(objective)
    planner = RoadmapPlanner(si, objective, WALL) if which == "Roadmap" else og.RRTstar(si)
    setup.setPlanner(planner)
    settled = CostConvergence(planner, share=0.05, seconds=0.3)
    late = ob.timedPlannerTerminationCondition(60.0)
    assert setup.solve(ob.plannerOrTerminationCondition(late, ob.PlannerTerminationCondition(settled)))
    assert settled()
    assert not late()
    cost = setup.getSolutionPath().cost(objective).value()
    assert planner.bestCost().value() == pytest.approx(cost, rel=0.01)


def problem():
    space = ob.RealVectorStateSpace(2)
    space.setBounds(0, 10)
    setup = og.SimpleSetup(space)
    si = setup.getSpaceInformation()
    use_world(si, WALL)
    start, goal = si.allocState(), si.allocState()
    start[0], start[1], goal[0], goal[1] = 2.0, 2.0, 8.0, 2.0
    setup.setStartAndGoalStates(start, goal)
    return setup, si


def test_an_objective_that_is_not_the_problems_is_refused():
    setup, si = problem()
    setup.setPlanner(RoadmapPlanner(si, DriftObjective(si, NOISE, (8.0, 2.0)), WALL))
    for other in (DriftObjective(si, NOISE.scaled(2.0), (8.0, 2.0)), ob.PathLengthOptimizationObjective(si)):
        setup.setOptimizationObjective(other)
        with pytest.raises(PlannerError, match="objective to be that of the problem"):
            setup.solve(1.0)


def test_a_condition_is_asked_again_before_many_nodes_are_added():
    setup, si = problem()
    planner = RoadmapPlanner(si, ob.PathLengthOptimizationObjective(si), WALL)
    setup.setPlanner(planner)
    nodes = []

    def condition():
        nodes.append(len(planner.roadmap()[0]))
        return nodes[-1] > 400

    KeptGraph.of(WALL)  # which is made in steps, and taken in one
    setup.solve(ob.PlannerTerminationCondition(condition))
    assert np.sort(np.diff(nodes))[-2] <= 200


@given(st.floats(1e-9, 1e9))
def test_a_limit_that_can_be_kept_is_never_told_lower_than_it_is(metres):
    told = float(format_least(metres).removesuffix(" m"))
    assert metres <= told <= metres * 1.01


@pytest.mark.slow
def test_the_limit_that_is_told_to_be_keepable_can_be_kept():
    asked = {"minimise": "length", "planner": Planner(max_nodes=30), "time_limit": 600.0}
    with pytest.raises(InfeasibleError, match="can be kept") as caught:
        plan_route(WALL, (2, 2), (8, 2), NOISE, max_drift=0.1, **asked)
    told = float(str(caught.value).split("a limit of ")[1].split(" m")[0])
    assert plan_route(WALL, (2, 2), (8, 2), NOISE, max_drift=told, **asked).worst_drift <= told
