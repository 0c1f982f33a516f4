"""A drone in a hall of racks, in R^3 and in SE(3): the same objective, with isotropic attitude noise."""

from __future__ import annotations

from typing import Any

from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from driftplan import BoxWorld, DriftObjective, OdometryNoise, predict_ompl_path, use_world

START, GOAL = (1.0, 1.0, 1.0), (19.0, 19.0, 6.0)
HALL = ((0.0, 0.0, 0.0), (20.0, 20.0, 8.0))
# What stands there, as vertices of its meshes: racks, each a box, and a tent.
RACKS = [[(x, y, 0.0), (x + 2.0, y + 7.0, 7.0)] for x in (4.0, 9.0, 14.0) for y in (2.0, 11.0)]
TENT = [(7.0, 9.0, 0.0), (7.0, 11.0, 0.0), (13.0, 9.0, 0.0), (13.0, 11.0, 0.0), (10.0, 10.0, 4.0)]


def plan(space: Any, world: BoxWorld, planner_type: Any, seconds: float) -> tuple[float, float]:
    """Length and rms drift at the goal, metres."""
    noise = OdometryNoise(heading_var_per_m=1e-4, distance_var_per_m=1e-4, lateral_var_per_m=1e-4)
    bounds = ob.RealVectorBounds(3)
    for axis in range(3):
        bounds.setLow(axis, HALL[0][axis])
        bounds.setHigh(axis, HALL[1][axis])
    space.setBounds(bounds)
    si = ob.SpaceInformation(space)
    use_world(si, world)  # every motion by one exact test
    si.setup()
    problem = ob.ProblemDefinition(si)
    first, last = si.allocState(), si.allocState()
    for state, position in ((first, START), (last, GOAL)):
        if hasattr(state, "setXYZ"):
            state.setXYZ(*position)
            state.rotation().setIdentity()
        else:
            state[0], state[1], state[2] = position
    problem.setStartAndGoalStates(first, last)
    problem.setOptimizationObjective(DriftObjective(si, noise, problem, world))
    planner = planner_type(si)
    planner.setProblemDefinition(problem)
    planner.setup()
    planner.solve(seconds)
    if not problem.hasExactSolution():
        raise SystemExit("no path found in time: allow more")
    path = problem.getSolutionPath()
    assert path.check()
    drift = predict_ompl_path(path, si, noise)
    return float(drift.distance[-1]), float(drift.end.rms)


def main(seconds: float = 2.0) -> None:
    """Plan in both spaces."""
    ou.setLogLevel(ou.LOG_NONE)
    world = BoxWorld.around([*RACKS, TENT], bounds=HALL, robot_radius=0.4)
    print(f"{len(world.boxes)} boxes; the straight way is free: {bool(world.segments_free(START, GOAL))}")
    for name, space, planner in (
        ("R^3", ob.RealVectorStateSpace(3), og.BITstar),
        ("SE(3)", ob.SE3StateSpace(), og.InformedRRTstar),
    ):
        length, rms = plan(space, world, planner, seconds)
        print(f"{name}: {length:.1f} m, rms drift {rms:.3f} m at the goal")


if __name__ == "__main__":
    main()
