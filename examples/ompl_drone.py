"""A drone among pillars, in R^3 and in SE(3): the same objective, with isotropic attitude noise."""

from __future__ import annotations

from typing import Any

from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from driftplan import DriftObjective, OdometryNoise, predict_ompl_path

START, GOAL = (1.0, 1.0, 1.0), (19.0, 19.0, 6.0)
PILLARS = [(6.0, 6.0), (10.0, 14.0), (14.0, 8.0), (10.0, 10.0)]  # of radius 2 m, as high as the hall
RADIUS_M = 2.0


class ClearOfPillars(ob.StateValidityChecker):
    """Validity from numbers only: nothing of OMPL is kept."""

    def isValid(self, state: Any) -> bool:
        x, y = (state.getX(), state.getY()) if hasattr(state, "getX") else (state[0], state[1])
        return all((x - px) ** 2 + (y - py) ** 2 > RADIUS_M**2 for px, py in PILLARS)


def plan(space: Any, seconds: float) -> tuple[float, float]:
    """Length and rms drift at the goal, metres."""
    noise = OdometryNoise(heading_var_per_m=1e-4, distance_var_per_m=1e-4, lateral_var_per_m=1e-4)
    bounds = ob.RealVectorBounds(3)
    for axis, high in enumerate((20.0, 20.0, 8.0)):
        bounds.setLow(axis, 0.0)
        bounds.setHigh(axis, high)
    space.setBounds(bounds)
    si = ob.SpaceInformation(space)
    si.setStateValidityChecker(ClearOfPillars(si))
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
    problem.setOptimizationObjective(DriftObjective(si, noise, GOAL))
    planner = og.InformedRRTstar(si)
    planner.setProblemDefinition(problem)
    planner.setup()
    planner.solve(seconds)
    if not problem.hasExactSolution():
        raise SystemExit("no path found in time: allow more")
    drift = predict_ompl_path(problem.getSolutionPath(), si, noise)
    return float(drift.distance[-1]), float(drift.end.rms)


def main(seconds: float = 2.0) -> None:
    """Plan in both spaces."""
    ou.setLogLevel(ou.LOG_NONE)
    for name, space in (("R^3", ob.RealVectorStateSpace(3)), ("SE(3)", ob.SE3StateSpace())):
        length, rms = plan(space, seconds)
        print(f"{name}: {length:.1f} m, rms drift {rms:.3f} m at the goal")


if __name__ == "__main__":
    main()
