"""RoadmapPlanner in OMPL: headings, a mix with length, several goals, a goal region, and beacons on the way."""

from __future__ import annotations

from typing import Any

from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from driftplan import (
    Beacon,
    BeaconKind,
    DriftObjective,
    OdometryNoise,
    RoadmapPlanner,
    World,
    bundled_map,
    load_world,
    predict_ompl_path,
    use_world,
)

NOISE = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0, heading_deg_per_full_turn=10.0)
START, GOAL = (51.0, 33.0), (23.5, 18.7)
OTHER_GOAL = (8.0, 2.5)


def setup_for(world: World, space: Any) -> og.SimpleSetup:
    """A problem on the map, in a space of the plane, with start and goal."""
    bounds = ob.RealVectorBounds(2)
    for axis in (0, 1):
        bounds.setLow(axis, world.bounds[axis])
        bounds.setHigh(axis, world.bounds[axis + 2])
    space.setBounds(bounds)
    setup = og.SimpleSetup(space)
    use_world(setup.getSpaceInformation(), world)
    setup.setStartAndGoalStates(state_at(setup, START), state_at(setup, GOAL))
    return setup


def state_at(setup: og.SimpleSetup, place: tuple[float, float], yaw: float = 0.0) -> Any:
    """A state of the plane, or a pose where states have headings."""
    state = setup.getSpaceInformation().allocState()
    if hasattr(state, "setYaw"):
        state.setXY(*place)
        state.setYaw(yaw)
    else:
        state[0], state[1] = place
    return state


def report(name: str, setup: og.SimpleSetup, planner: RoadmapPlanner, world: World, seconds: float) -> None:
    """Solve, and say how long the route is and how far the estimate will be off at its end."""
    setup.setPlanner(planner)
    if not setup.solve(seconds) or not setup.haveExactSolutionPath():
        raise SystemExit(f"{name}: no route found in time, allow more")
    route = planner.route()  # with beacons; else None
    drift: Any = (
        route.drift
        if route
        else predict_ompl_path(
            setup.getProblemDefinition().getSolutionPath(), setup.getSpaceInformation(), NOISE, world
        )
    )
    x, y = drift.xy[-1]
    said = f", {len(route.beacons)} beacons on the way" if route else ""
    print(
        f"{name:18} to ({x:.1f}, {y:.1f}): {float(drift.length):5.1f} m, rms drift {float(drift.end.rms):.3f} m{said}"
    )


class WithinTwoMetres(ob.GoalRegion):
    """All places no farther than two metres from the goal."""

    def distanceGoal(self, state: Any) -> float:
        return max(0.0, float(((state[0] - GOAL[0]) ** 2 + (state[1] - GOAL[1]) ** 2) ** 0.5) - 2.0)


def main(seconds: float = 2.0) -> None:
    """Five problems on one map."""
    ou.setLogLevel(ou.LOG_NONE)
    world = load_world(bundled_map("warehouse"), robot_radius=0.4)

    # SE(2): the robot turns on the spot at the start, at waypoints and at the goal, and turning costs heading.
    setup = setup_for(world, ob.SE2StateSpace())
    setup.setStartAndGoalStates(state_at(setup, START, 1.57), state_at(setup, GOAL, 3.14))
    objective = DriftObjective(setup.getSpaceInformation(), NOISE, setup, world)
    setup.setOptimizationObjective(objective)
    report("SE(2)", setup, RoadmapPlanner(setup.getSpaceInformation(), objective, world), world, seconds)

    # Drift and length, weighed against each other: m² of drift and metres.
    setup = setup_for(world, ob.RealVectorStateSpace(2))
    si = setup.getSpaceInformation()
    mix = ob.MultiOptimizationObjective(si)
    mix.addObjective(DriftObjective(si, NOISE, setup, world), 1.0)
    mix.addObjective(ob.PathLengthOptimizationObjective(si), 0.5)
    setup.setOptimizationObjective(mix)
    report("mix with length", setup, RoadmapPlanner(si, mix, world), world, seconds)

    # Several goals: the objective is made for any one of them; each is planned for with drift weighed by itself.
    setup = setup_for(world, ob.RealVectorStateSpace(2))
    si = setup.getSpaceInformation()
    goals = ob.GoalStates(si)
    for place in (GOAL, OTHER_GOAL):
        goals.addState(state_at(setup, place))
    setup.setGoal(goals)
    objective = DriftObjective(si, NOISE, GOAL, world)
    setup.setOptimizationObjective(objective)
    report("several goals", setup, RoadmapPlanner(si, objective, world), world, seconds)

    # A goal region: drift is weighed at one place in it, to which the path leads.
    setup = setup_for(world, ob.RealVectorStateSpace(2))
    si = setup.getSpaceInformation()
    setup.setGoal(WithinTwoMetres(si))
    objective = DriftObjective(si, NOISE, GOAL, world)
    setup.setOptimizationObjective(objective)
    report("goal region", setup, RoadmapPlanner(si, objective, world), world, seconds)

    # Beacons: the shortest route that never drifts more than 1.5 m, since it comes by them.
    setup = setup_for(world, ob.RealVectorStateSpace(2))
    si = setup.getSpaceInformation()
    sign = BeaconKind.landmark(range_m=3.0, position_std_m=0.05, heading_std=0.01)
    beacons = [Beacon(sign, *place) for place in ((50.0, 24.0), (46.0, 10.0), (35.0, 9.5), (24.0, 9.5))]
    objective = DriftObjective(si, NOISE, setup, world)
    setup.setOptimizationObjective(objective)
    asked = {"beacons": beacons, "max_drift": 1.5, "minimise": "length", "max_nodes": 300}
    report("beacons", setup, RoadmapPlanner(si, objective, world, **asked), world, 10 * seconds)


if __name__ == "__main__":
    main()
