"""Runs of OMPL's planners: one in the plane, quietly, a world and two points in, waypoints out, and no OMPL object with
them; and CostConvergence, a termination condition for scripts of one's own, which OMPL has in C++ only."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import inf, isfinite
from threading import Lock
from typing import Any

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from driftplan.arrays import Floats, positive
from driftplan.errors import PlannerError
from driftplan.model.noise import OdometryNoise
from driftplan.planning.ompl.collision import use_world
from driftplan.planning.ompl.objective import DriftObjective
from driftplan.world.world import World

PLANNERS = {
    "rrtstar": og.RRTstar,
    "informed_rrtstar": og.InformedRRTstar,
    "sorrtstar": og.SORRTstar,
    "bitstar": og.BITstar,
}

_OMPLS_OWN = Lock()
_FEASIBLE_ONLY = "it stops at the first path and never asks what a path costs"
_DEADLOCK = "it prices paths in a thread that waits for ever for a Python objective"
_COST_AS_METRIC = "it takes the cost for the metric of its nearest-neighbour search, which drift is not"
_UNBOUND = "OMPL's Python package cannot create it"
_ABSENT = "OMPL's Python package does not have it"
REFUSED = {
    **dict.fromkeys(("prm", "prmstar"), _DEADLOCK),
    **dict.fromkeys(("rrt", "rrtconnect", "kpiece1", "bkpiece1", "lbkpiece1"), _FEASIBLE_ONLY),
    **dict.fromkeys(("est", "syclop", "syclopest", "sycloprrt"), _FEASIBLE_ONLY),  # of ompl.control
    **dict.fromkeys(("fmt", "bfmt"), _COST_AS_METRIC),
    "aorrtc": "it minimises length whatever the objective says",
    **dict.fromkeys(("sst", "pdst"), _UNBOUND),
    **dict.fromkeys(("abitstar", "aitstar", "blitstar", "eitstar", "eirmstar", "cforest", "rrtsharp"), _ABSENT),
    **dict.fromkeys(("rrtxstatic", "lbtrrt", "lazylbtrrt", "trrt", "bitrrt", "strrtstar", "vfrrt", "tsrrt"), _ABSENT),
    **dict.fromkeys(("lazyrrt", "prrt", "rlrt", "birlrt", "sbl", "psbl", "stride", "biest", "projest"), _ABSENT),
    **dict.fromkeys(("lazyprm", "lazyprmstar", "spars", "spars2", "xxl", "anytimepathshortening"), _ABSENT),
}
"""Planners of OMPL that cannot minimise drift, by name in small letters, and why."""


def check_planner(planner: str, also: tuple[str, ...] = ()) -> None:
    """Raise `PlannerError` unless the planner is one that can minimise drift; ``also`` names those known elsewhere."""
    known = (*also, *PLANNERS)
    if planner in known:
        return
    can = f"choose one of {', '.join(known)}"
    reason = REFUSED.get(str(planner).lower().replace("*", "star").replace("_", "").replace("-", ""))
    if reason is not None:
        raise PlannerError(f"planner {planner!r} cannot minimise drift: {reason}; {can}")
    raise PlannerError(f"unknown planner {planner!r}: {can}")


def solve(
    world: World,
    start: Floats,
    goal: Floats,
    noise: OdometryNoise | None,
    *,
    planner: str,
    stop: Callable[[], bool],
    seed: int,
    iterations: int | None = None,
) -> Floats | None:
    """Waypoints (n, 2) of the best path the planner found before ``stop``, asked in every iteration, said True; or
    None.

    With a noise it minimises `DriftObjective`, without one OMPL's path length. OMPL seeds its random numbers per
    process: the same seed gives the same samples, but how many are drawn depends on the time, unless the number of
    ``iterations`` ends the search.
    """
    turn = _OMPLS_OWN
    while not turn.acquire(timeout=0.02):  # another thread plans
        if stop():
            return None
    with _quiet(turn):
        ou.RNG.setSeed(seed + 1)  # OMPL refuses 0
        space = ob.RealVectorStateSpace(2)
        bounds = ob.RealVectorBounds(2)
        xmin, ymin, xmax, ymax = world.bounds
        for axis, (low, high) in enumerate(((xmin, xmax), (ymin, ymax))):
            bounds.setLow(axis, low)
            bounds.setHigh(axis, high)
        space.setBounds(bounds)
        si = ob.SpaceInformation(space)
        use_world(si, world)
        si.setup()
        a, b = si.allocState(), si.allocState()
        (a[0], a[1]), (b[0], b[1]) = start.tolist(), goal.tolist()
        pdef = ob.ProblemDefinition(si)
        pdef.setStartAndGoalStates(a, b)
        if noise is None:
            pdef.setOptimizationObjective(ob.PathLengthOptimizationObjective(si))
        else:
            pdef.setOptimizationObjective(DriftObjective(si, noise, goal, world=world))
        chosen = PLANNERS[planner](si)
        chosen.setProblemDefinition(pdef)
        chosen.setup()
        most = inf if iterations is None else iterations
        chosen.solve(ob.PlannerTerminationCondition(lambda: bool(stop()) or chosen.numIterations() >= most))
        if not pdef.hasExactSolution():
            return None
        states = pdef.getSolutionPath().getStates()
        path = np.array([(q[0], q[1]) for q in states])
        del states
    moves = np.concatenate([[True], (np.diff(path, axis=0) != 0).any(axis=1)])
    return np.asarray(path[moves])


@contextmanager
def _quiet(turn: Lock) -> Iterator[None]:
    """Without OMPL's talk on stdout and stderr, which like its seed is the process's: it is nobody else's turn."""
    level: Any = ou.getLogLevel()
    ou.setLogLevel(ou.LOG_NONE)
    try:
        yield
    finally:
        ou.setLogLevel(level)
        turn.release()


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
