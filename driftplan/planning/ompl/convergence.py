"""CostConvergence: a termination condition for OMPL's planners that OMPL has in C++ only."""

from __future__ import annotations

import time
from math import inf, isfinite
from typing import Any

from driftplan.arrays import positive


class CostConvergence:
    """True once the best cost of a planner has fallen by less than a share of it for some seconds.

    The seconds begin with the first path. For planners that tell their ``bestCost()``: RRTstar, InformedRRTstar,
    SORRTstar, BITstar and `RoadmapPlanner`. Together with a time limit: ``ob.plannerOrTerminationCondition``.

    Parameters
    ----------
    planner : ompl.base.Planner
    share : of the cost, > 0
    seconds : > 0

    >>> from ompl import base as ob, geometric as og
    >>> space = ob.RealVectorStateSpace(2)
    >>> space.setBounds(0, 10)
    >>> setup = og.SimpleSetup(space)
    >>> setup.setStateValidityChecker(lambda state: True)
    >>> start, goal = setup.getSpaceInformation().allocState(), setup.getSpaceInformation().allocState()
    >>> start[0], start[1], goal[0], goal[1] = 2.0, 2.0, 8.0, 2.0
    >>> setup.setStartAndGoalStates(start, goal)
    >>> planner = og.RRTstar(setup.getSpaceInformation())
    >>> setup.setPlanner(planner)
    >>> from ompl import util as ou
    >>> ou.setLogLevel(ou.LOG_NONE)
    >>> settled = CostConvergence(planner, share=0.01, seconds=0.1)
    >>> bool(setup.solve(ob.PlannerTerminationCondition(settled))), settled()
    (True, True)
    """

    def __init__(self, planner: Any, *, share: float = 0.01, seconds: float = 1.0) -> None:
        self._planner = planner
        self._share, self._seconds = positive("share", share), positive("seconds", seconds)
        self._cost, self._since = inf, time.monotonic()

    def __call__(self) -> bool:
        cost, now = float(self._planner.bestCost().value()), time.monotonic()
        if not isfinite(self._cost) or cost < self._cost * (1 - self._share):
            self._cost, self._since = cost, now
        return now - self._since >= self._seconds
