"""DriftObjective in a SimpleSetup of your own: a point robot in the plane, OMPL's BIT*, three seconds."""

from __future__ import annotations

from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from driftplan import DriftObjective, OdometryNoise, bundled_map, load_world
from driftplan.planning.collision import use_world
from driftplan.planning.ompl_paths import predict_ompl_path


def main(seconds: float = 3.0) -> None:
    """Plan, and say what the route costs and how far the estimate will be off at its end."""
    ou.setLogLevel(ou.LOG_ERROR)  # a warning about informed sampling is known and harmless
    world = load_world(bundled_map("warehouse"), robot_radius=0.4)
    noise = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
    start, goal = (51.0, 33.0), (23.5, 18.7)

    space = ob.RealVectorStateSpace(2)
    bounds = ob.RealVectorBounds(2)
    for axis in (0, 1):
        bounds.setLow(axis, world.bounds[axis])
        bounds.setHigh(axis, world.bounds[axis + 2])
    space.setBounds(bounds)
    setup = og.SimpleSetup(space)
    si = setup.getSpaceInformation()
    use_world(si, world)  # validity of states, and of motions by one exact test

    first, last = si.allocState(), si.allocState()
    first[0], first[1] = start
    last[0], last[1] = goal
    setup.setStartAndGoalStates(first, last)
    setup.setOptimizationObjective(DriftObjective(si, noise, goal, world=world))
    setup.setPlanner(og.BITstar(si))
    if not setup.solve(seconds):
        raise SystemExit("no route found in time")
    path = setup.getProblemDefinition().getSolutionPath()
    drift = predict_ompl_path(path, si, noise, world)  # exact; the objective is its additive upper bound
    print(f"{float(drift.length):.1f} m, rms drift {float(drift.end.rms):.2f} m at the goal")


if __name__ == "__main__":
    main()
