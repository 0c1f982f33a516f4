"""A car that cannot turn on the spot: lowest drift among Dubins curves, heading noise on the arcs included."""

from __future__ import annotations

from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from driftplan import DriftObjective, OdometryNoise, bundled_map, load_world, predict_ompl_path, use_world


def plan(space: ob.SE2StateSpace, seconds: float) -> tuple[float, float]:
    """Length and rms drift at the goal, metres, of the best path in a space of curves through the warehouse."""
    world = load_world(bundled_map("warehouse"), robot_radius=0.4)
    noise = OdometryNoise(heading_var_per_m=1e-4, distance_var_per_m=2.5e-4, heading_var_per_rad=5e-4)
    bounds = ob.RealVectorBounds(2)
    for axis in (0, 1):
        bounds.setLow(axis, world.bounds[axis])
        bounds.setHigh(axis, world.bounds[axis + 2])
    space.setBounds(bounds)
    si = ob.SpaceInformation(space)
    use_world(si, world)  # curves are tested arc by arc, not at sampled states
    si.setup()
    problem = ob.ProblemDefinition(si)
    first, last = si.allocState(), si.allocState()
    for state, (x, y, yaw) in ((first, (5.0, 20.0, 0.0)), (last, (25.0, 36.0, 0.0))):
        state.setXY(x, y)
        state.setYaw(yaw)
    problem.setStartAndGoalStates(first, last)
    problem.setOptimizationObjective(DriftObjective(si, noise, problem))
    planner = og.RRTstar(si)
    planner.setProblemDefinition(problem)
    planner.setup()
    planner.solve(seconds)
    if not problem.hasExactSolution():
        raise SystemExit("no path found in time: allow more")
    drift = predict_ompl_path(problem.getSolutionPath(), si, noise)
    return float(drift.length), float(drift.end.rms)


def main(seconds: float = 5.0) -> None:
    """Plan for a turning radius of 1 m."""
    ou.setLogLevel(ou.LOG_NONE)
    length, rms = plan(ob.DubinsStateSpace(1.0), seconds)
    print(f"Dubins car: {length:.1f} m, rms drift {rms:.2f} m at the goal")


if __name__ == "__main__":
    main()
