"""polish_ompl_path: what OMPL's simplifySolution does for length, done for drift."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from ompl import base as ob
from ompl import geometric as og

from driftplan.arrays import Floats
from driftplan.planning.ompl.collision import CurveMotionValidator, StraightMotionValidator
from driftplan.planning.ompl.roadmap_problem import ClippedWorld, box_of, target_of
from driftplan.planning.ompl.spaces import SpaceKind, space_kind
from driftplan.planning.roadmap.polish import polished
from driftplan.planning.roadmap.prices import AdditiveCost
from driftplan.world.world import World

_STATES = 40  # of a path's, between which shortcuts are tried


def polish_ompl_path(path: og.PathGeometric, objective: ob.OptimizationObjective, world: World) -> Any:
    """An OMPL path between the same two states that costs no more, and mostly less, than the one given.

    OMPL's own ``SimpleSetup.simplifySolution()`` makes paths short whatever the objective says: where a part of the
    floor is bad it can make the drift much larger. Here a path changes only where its cost falls. In R^2 its waypoints
    are moved and left out; in SE(2), Dubins and Reeds-Shepp spaces it takes the cheapest shortcuts between its states.

    Parameters
    ----------
    path : ompl.geometric.PathGeometric, in the plane; it is not changed
    objective : DriftObjective, PathLengthOptimizationObjective, or MultiOptimizationObjective of these
        Over the path's space.
    world : the polished path is free of collisions there if the path is

    Returns
    -------
    ompl.geometric.PathGeometric

    Raises
    ------
    PlannerError : for other objectives, and a world whose zones are not those of the objective
    ValueError : for a path of fewer than 2 states, and a space that is not of the plane

    >>> from ompl import base as ob
    >>> from driftplan import DriftObjective, OdometryNoise
    >>> world = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)
    >>> space = ob.RealVectorStateSpace(2)
    >>> space.setBounds(0, 10)
    >>> si = ob.SpaceInformation(space)
    >>> path, state = og.PathGeometric(si), si.allocState()
    >>> for state[0], state[1] in [(2.0, 2.0), (1.0, 8.0), (4.0, 9.0), (9.0, 9.0), (8.0, 2.0)]:
    ...     path.append(state)
    >>> objective = DriftObjective(si, OdometryNoise(heading_var_per_m=1e-3), (8.0, 2.0), world)
    >>> better = polish_ompl_path(path, objective, world)
    >>> better.cost(objective).value() < 0.7 * path.cost(objective).value()
    True
    """
    si = objective.getSpaceInformation()
    kind = space_kind(si.getStateSpace())
    if path.getStateCount() < 2:
        raise ValueError(f"expected a path of at least 2 states, got {path.getStateCount()}")
    target = target_of(objective)
    zones = target.zones(world)
    if kind is not SpaceKind.PLANE:
        better = _with_shortcuts(path, objective, world, kind)
    else:
        xy = np.array([(state[0], state[1]) for state in path.getStates()])
        xy = xy[np.concatenate([[True], (np.diff(xy, axis=0) != 0).any(axis=1)])]
        if len(xy) < 3:
            return og.PathGeometric(path)
        goal = xy[-1] if target.goal is None else np.array(target.goal)
        space = ClippedWorld(world, box_of(si.getStateSpace()), zones)
        better = _path_of(si, polished(AdditiveCost(space, goal, target.noise, target.minimise), xy))
    return better if better.cost(objective).value() < path.cost(objective).value() else og.PathGeometric(path)


def _path_of(si: Any, xy: Floats) -> Any:
    path, state = og.PathGeometric(si), si.allocState()
    for state[0], state[1] in xy.tolist():
        path.append(state)
    return path


def _with_shortcuts(path: Any, objective: Any, world: World, kind: SpaceKind) -> Any:
    """The cheapest path over some of the path's states, and states between them: Dijkstra's method along the path."""
    si = objective.getSpaceInformation()
    motions = (CurveMotionValidator if kind.is_curved else StraightMotionValidator)(si, world)
    fine = og.PathGeometric(path)
    fine.interpolate(max(_STATES, path.getStateCount()))
    states = list(fine.getStates())
    cost, came_from = [0.0] + [math.inf] * (len(states) - 1), [0] * len(states)
    for end in range(1, len(states)):
        cost[end] = cost[end - 1] + objective.motionCost(states[end - 1], states[end]).value()
        came_from[end] = end - 1
        for begin in range(end - 1):
            through = cost[begin] + objective.motionCost(states[begin], states[end]).value()
            if through < cost[end] and motions.checkMotion(states[begin], states[end]):
                cost[end], came_from[end] = through, begin
    kept = [len(states) - 1]
    while kept[-1] > 0:
        kept.append(came_from[kept[-1]])
    shorter = og.PathGeometric(si)
    for k in reversed(kept):
        shorter.append(states[k])
    return shorter
