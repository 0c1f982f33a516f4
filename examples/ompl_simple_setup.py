"""DriftObjective in a SimpleSetup of your own: a point robot in the plane, by OMPL's BIT* and by the roadmap planner.

For comparison OMPL's shortest path: the same script with another objective.
"""

from __future__ import annotations

from typing import Any

from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from driftplan import (
    DriftObjective,
    OdometryNoise,
    RoadmapPlanner,
    World,
    bundled_map,
    load_world,
    predict_ompl_path,
    use_world,
)

NOISE = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
START, GOAL = (51.0, 33.0), (23.5, 18.7)


def setup_for(world: World) -> og.SimpleSetup:
    """A plane as large as the map, start and goal; collisions are tested against the map, motions by one exact test."""
    space = ob.RealVectorStateSpace(2)
    bounds = ob.RealVectorBounds(2)
    for axis in (0, 1):
        bounds.setLow(axis, world.bounds[axis])
        bounds.setHigh(axis, world.bounds[axis + 2])
    space.setBounds(bounds)
    setup = og.SimpleSetup(space)
    si = setup.getSpaceInformation()
    use_world(si, world)
    first, last = si.allocState(), si.allocState()
    first[0], first[1] = START
    last[0], last[1] = GOAL
    setup.setStartAndGoalStates(first, last)
    return setup


def report(name: str, setup: og.SimpleSetup, world: World, seconds: float) -> None:
    """Solve, and say how long the route is and how far the estimate will be off at its end."""
    if not setup.solve(seconds) or not setup.haveExactSolutionPath():
        raise SystemExit(f"{name}: no route found in time, allow more")
    path = setup.getProblemDefinition().getSolutionPath()
    # Exact, where the objective is an additive upper bound: compare finished paths by this.
    drift: Any = predict_ompl_path(path, setup.getSpaceInformation(), NOISE, world)
    print(f"{name:22} {float(drift.length):6.1f} m, rms drift {float(drift.end.rms):.3f} m at the goal")


def main(seconds: float = 4.0) -> None:
    """Plan three times."""
    ou.setLogLevel(ou.LOG_ERROR)  # a warning about informed sampling is known and harmless
    world = load_world(bundled_map("warehouse"), robot_radius=0.4)

    setup = setup_for(world)
    si = setup.getSpaceInformation()
    setup.setOptimizationObjective(ob.PathLengthOptimizationObjective(si))
    setup.setPlanner(og.BITstar(si))
    report("BIT*, shortest", setup, world, seconds)

    setup = setup_for(world)
    si = setup.getSpaceInformation()
    setup.setOptimizationObjective(DriftObjective(si, NOISE, setup, world=world))
    setup.setPlanner(og.BITstar(si))
    report("BIT*, least drift", setup, world, seconds)

    setup = setup_for(world)
    si = setup.getSpaceInformation()
    objective = DriftObjective(si, NOISE, setup, world=world)
    objective.set_error_threshold(1.6)  # metres: good enough, stop there
    setup.setOptimizationObjective(objective)
    setup.setPlanner(RoadmapPlanner(si, objective, world=world))
    report("roadmap, least drift", setup, world, seconds)


if __name__ == "__main__":
    main()
