"""OMPL's paths, in any space that can be priced: predict_ompl_path, the exact drift along one that a planner found;
polish_ompl_path, what OMPL's simplifySolution does for length, done for drift."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from math import atan2, hypot, inf, pi, remainder, tau
from typing import Any, NamedTuple

import numpy as np
from ompl import base as ob
from ompl import control as oc
from ompl import geometric as og

from driftplan.arrays import Floats
from driftplan.model.drift import Drift, predict_drift
from driftplan.model.noise import OdometryNoise
from driftplan.model.paths import Runs
from driftplan.model.spatial.drift import SpatialDrift, predict_flight_drift
from driftplan.planning.ompl.collision import CurveMotionValidator, StraightMotionValidator
from driftplan.planning.ompl.curves import after_arc
from driftplan.planning.ompl.motion_prices import attitude_step
from driftplan.planning.ompl.roadmap_problem import box_of, target_of
from driftplan.planning.ompl.spaces import CurveFinder, SpaceKind, check_world_of, position_reader, space_kind
from driftplan.planning.ompl.zone_lookup import ZoneLookup
from driftplan.planning.roadmap.polish import polished
from driftplan.planning.roadmap.prices import AdditiveCost, PartOfWorld
from driftplan.world.box_world import BoxWorld
from driftplan.world.world import World

_SILENT = OdometryNoise()
_STATES = 40  # of a path's, between which shortcuts are tried


class _Leg(NamedTuple):
    """A turn on the spot, then a run; as `Run`, with the noise of both."""

    turn: float
    length: float
    curvature: float
    noise: OdometryNoise


def predict_ompl_path(
    path: og.PathGeometric | oc.PathControl,
    si: ob.SpaceInformation,
    noise: OdometryNoise,
    world: World | BoxWorld | None = None,
) -> Drift | SpatialDrift:
    """The drift along an OMPL path, exact to second order: what decides between paths that a planner ranked.

    Parameters
    ----------
    path : ompl.geometric.PathGeometric or ompl.control.PathControl
        Motions run as OMPL interpolates them: straight, or along Dubins and Reeds-Shepp curves. In SE(2) the heading
        turns along the way, whatever the direction of travel; in R^2 the robot turns on the spot at the waypoints. Of
        controls all states count that their propagation passes.
    si : ompl.base.SpaceInformation, of the path, over a space that `DriftObjective` can price
    noise : in three dimensions as in `DriftObjective`: isotropic, white, without systematic errors
    world : its zones have noise of their own (plane only)

    Returns
    -------
    Drift, or SpatialDrift in three dimensions
        At the borders of the path's pieces: arcs, and stretches between zone borders.

    Raises
    ------
    ValueError : for a path of fewer than 2 states, a space that cannot be priced, and in three dimensions for zones and
        noise that has no meaning there

    >>> from ompl import base as ob, geometric as og
    >>> space = ob.DubinsStateSpace(1.0)
    >>> si = ob.SpaceInformation(space)
    >>> path, state = og.PathGeometric(si), si.allocState()
    >>> for x, y, yaw in [(0, 0, 0), (10, 0, 0)]:
    ...     state.setXY(x, y)
    ...     state.setYaw(yaw)
    ...     path.append(state)
    >>> drift = predict_ompl_path(path, si, OdometryNoise(heading_var_per_m=1e-3))
    >>> round(float(drift.length), 3), round(float(drift.end.rms), 4)
    (10.0, 0.5768)
    """
    if isinstance(path, oc.PathControl):
        path = path.asGeometric()
    space = si.getStateSpace()
    kind = space_kind(space)
    states = path.getStates()
    if len(states) < 2:
        raise ValueError(f"expected a path of at least 2 states, got {len(states)}")
    check_world_of(world, kind)
    zones = world.zones if isinstance(world, World) else ()
    positions = np.array([position_reader(kind)(state) for state in states])
    if kind.dimensions == 3:
        turns = None
        if kind is SpaceKind.FLIGHT:
            attitudes = [state.rotation() for state in states]
            turns = np.array([attitude_step(p, q) for p, q in pairwise(attitudes)])
        return _flight(positions, turns, noise)
    lookup = ZoneLookup(zones, [zone.noise for zone in zones], noise)
    if kind.is_curved:
        heading = float(states[0].getYaw())
        legs = list(_curved_legs(space, states, lookup))
    else:
        yaws = [state.getYaw() for state in states] if kind is SpaceKind.POSE else None
        heading = _first_course(positions)
        legs = list(_straight_legs(positions, yaws, lookup, heading))
    turns, lengths, curvatures = (np.array(column) for column in zip(*(leg[:3] for leg in legs), strict=True))
    start = np.asarray(complex(*positions[0]))
    return predict_drift(Runs(start, np.asarray(heading), turns, lengths, curvatures), [leg.noise for leg in legs])


def _flight(positions: Floats, turns: Floats | None, noise: OdometryNoise) -> SpatialDrift:
    """Straight runs in space, on which the attitude turns by ``turns`` (rad, one per run)."""
    if noise.is_systematic or noise.step_m is not None or noise.heading_distance_corr != 0:
        raise ValueError(
            f"expected white noise in three dimensions, got {noise!r}: for other noise build the steps and use "
            "driftplan.model.spatial.drift.predict_drift_3d"
        )
    lengths = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    rate = np.zeros(len(lengths))
    if noise.heading_var_per_rad > 0 or noise.distance_var_per_rad > 0:
        if turns is None:
            raise ValueError(f"expected no noise per radian in R^3, whose states have no attitude, got {noise!r}")
        if (turns[lengths == 0] > 0).any():
            raise ValueError("expected an attitude that turns on the way only: turning in place has no noise here")
        rate = turns / np.where(lengths > 0, lengths, 1.0)
    return predict_flight_drift(
        positions,
        rotation_var_per_m=noise.heading_var_per_m + noise.heading_var_per_rad * rate,
        distance_var_per_m=noise.distance_var_per_m + noise.distance_var_per_rad * rate,
        lateral_var_per_m=noise.lateral_var_per_m,
    )


def _straight_legs(
    positions: Floats, yaws: list[float] | None, lookup: ZoneLookup[OdometryNoise], course: float
) -> Iterator[_Leg]:
    """Legs of a path of straight motions; with ``yaws`` the heading turns along them, and the course is free."""
    yaw_steps = [remainder(b - a, tau) for a, b in pairwise(yaws)] if yaws else [0.0] * (len(positions) - 1)
    for (x0, y0), (x1, y1), turn in zip(positions[:-1].tolist(), positions[1:].tolist(), yaw_steps, strict=True):
        length = hypot(x1 - x0, y1 - y0)
        if length == 0:
            if turn != 0:  # on the spot: the noise of turning, then back without noise, since the course did not turn
                yield _Leg(turn, 0.0, 0.0, lookup.at(x0, y0))
                yield _Leg(-turn, 0.0, 0.0, _SILENT)
            continue
        bearing = atan2(y1 - y0, x1 - x0)
        corner = remainder(bearing - course, tau)
        for begin, end, noise in lookup.pieces(x0, y0, x1, y1):
            along = noise if yaws is None else _turning(noise, turn / length)
            yield _Leg(corner, (end - begin) * length, 0.0, along)
            corner = 0.0
        course = bearing


def _turning(noise: OdometryNoise, turn_per_m: float) -> OdometryNoise:
    """The noise of a run on which the heading turns while the course does not: per metre all of it."""
    rate = abs(turn_per_m)
    return replace(
        noise,
        heading_var_per_m=noise.heading_var_per_m + noise.heading_var_per_rad * rate,
        distance_var_per_m=noise.distance_var_per_m + noise.distance_var_per_rad * rate,
        heading_bias_per_m=noise.heading_bias_per_m + noise.heading_bias_per_rad * turn_per_m,
        heading_var_per_rad=0.0,
        distance_var_per_rad=0.0,
        heading_bias_per_rad=0.0,
    )


def _curved_legs(space: Any, states: Any, lookup: ZoneLookup[OdometryNoise]) -> Iterator[_Leg]:
    """Legs along curves. Driving backwards is driving forwards after half a turn that has no noise."""
    finder = CurveFinder(space)
    forwards = True
    for a, b in pairwise(states):
        x, y, yaw = a.getX(), a.getY(), a.getYaw()
        for turns, sense in finder(a, b):
            length, curvature = turns * finder.turning_radius, sense / finder.turning_radius
            if length == 0:
                continue
            if (length > 0) is not forwards:
                forwards = not forwards
                yield _Leg(pi, 0.0, 0.0, _SILENT)
            for _, _, _, part, noise in lookup.arc_pieces(x, y, yaw, length, curvature):
                yield _Leg(0.0, abs(part), curvature if forwards else -curvature, noise)
            x, y, yaw = after_arc(x, y, yaw, length, curvature)


def _first_course(positions: Floats) -> float:
    steps = np.diff(positions, axis=0)
    moving = steps[(steps != 0).any(axis=1)]
    return float(np.arctan2(moving[0, 1], moving[0, 0])) if len(moving) else 0.0


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
        space = PartOfWorld(world, box_of(si.getStateSpace()), zones)
        better, state = og.PathGeometric(si), si.allocState()
        for state[0], state[1] in polished(AdditiveCost(space, goal, target.noise, target.minimise), xy).tolist():
            better.append(state)
    return better if better.cost(objective).value() < path.cost(objective).value() else og.PathGeometric(path)


def _with_shortcuts(path: Any, objective: Any, world: World, kind: SpaceKind) -> Any:
    """The cheapest path over some of the path's states, and states between them: Dijkstra's method along the path."""
    si = objective.getSpaceInformation()
    motions = (CurveMotionValidator if kind.is_curved else StraightMotionValidator)(si, world)
    fine = og.PathGeometric(path)
    fine.interpolate(max(_STATES, path.getStateCount()))
    states = list(fine.getStates())
    cost, came_from = [0.0] + [inf] * (len(states) - 1), [0] * len(states)
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
