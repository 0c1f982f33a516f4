"""Collision as OMPL asks for it: validity of states and motions over a `World` or `BoxWorld`, by one test per motion.

The checkers hold the world and numbers, never the SpaceInformation: a motion validator that holds it would keep OMPL's
objects alive for ever, since the collector cannot see through OMPL's own references.
"""

from __future__ import annotations

from collections.abc import Callable
from math import ceil, cos, radians, sin, tan
from typing import Any

from ompl import base as ob

from driftplan.planning.ompl.curves import after_arc
from driftplan.planning.ompl.spaces import CurveFinder, check_world_of, position_reader, space_kind
from driftplan.world.box_world import BoxWorld
from driftplan.world.world import World

_PIECE_RAD = radians(10)


class FreeStateChecker(ob.StateValidityChecker):
    """A state is valid where the robot's centre may be."""

    def __init__(self, si: Any, world: World | BoxWorld) -> None:
        super().__init__(si)
        self._free, self._read = world.point_free, position_reader(space_kind(si.getStateSpace()))

    def isValid(self, state: Any) -> bool:
        return self._free(*self._read(state))


class StraightMotionValidator(ob.MotionValidator):
    """A straight motion is valid when the robot can move straight between its ends: exact, one test, no sampling."""

    def __init__(self, si: Any, world: World | BoxWorld) -> None:
        super().__init__(si)
        self._free, self._read = world.segment_free, position_reader(space_kind(si.getStateSpace()))

    def checkMotion(self, start: Any, end: Any) -> bool:
        return self._free(*self._read(start), *self._read(end))


class CurveMotionValidator(ob.MotionValidator):
    """A Dubins or Reeds-Shepp motion is valid when the robot's disc can follow its arcs: no sampling.

    Each arc is enclosed between its chords and its tangents, of 10 degrees each, and both must be free. Nothing as
    large as an obstacle grown by the robot's radius fits between them (for a robot that is a mere point, spikes
    thinner than 0.8 % of the turning radius could), so what passes is free; refused is at most what comes within 0.4 %
    of the turning radius of an obstacle.
    """

    def __init__(self, si: Any, world: World | BoxWorld) -> None:
        super().__init__(si)
        self._free: Callable[..., bool] = world.segment_free
        self._curve = CurveFinder(si.getStateSpace())

    def checkMotion(self, start: Any, end: Any) -> bool:
        radius, free = self._curve.turning_radius, self._free
        x, y, yaw = start.getX(), start.getY(), start.getYaw()
        for turns, sense in self._curve(start, end):
            length = turns * radius
            if sense == 0:
                there = after_arc(x, y, yaw, length, 0.0)
                if not free(x, y, there[0], there[1]):
                    return False
                x, y, yaw = there
                continue
            pieces = ceil(abs(turns) / _PIECE_RAD) or 1
            step = length / pieces
            tangent = radius * tan(0.5 * step / radius)
            for _ in range(pieces):
                to_x, to_y, to_yaw = after_arc(x, y, yaw, step, sense / radius)
                apex_x, apex_y = x + tangent * cos(yaw), y + tangent * sin(yaw)
                if not (free(x, y, to_x, to_y) and free(x, y, apex_x, apex_y) and free(apex_x, apex_y, to_x, to_y)):
                    return False
                x, y, yaw = to_x, to_y, to_yaw
        return True


def use_world(si: ob.SpaceInformation, world: World | BoxWorld) -> None:
    """Make an OMPL SpaceInformation check states and motions against ``world``.

    Parameters
    ----------
    si : ompl.base.SpaceInformation
        Over a state space of the plane: R^2, SE(2), Dubins or Reeds-Shepp; for boxes over R^3 or SE(3). The space's
        bounds are left as they are.
    world : World or BoxWorld

    Raises
    ------
    ValueError : if the space is none of these

    Examples
    --------
    >>> from ompl import base as ob
    >>> world = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)
    >>> space = ob.RealVectorStateSpace(2)
    >>> space.setBounds(0, 10)
    >>> si = ob.SpaceInformation(space)
    >>> use_world(si, world)
    >>> si.setup()
    >>> a, b = si.allocState(), si.allocState()
    >>> a[0], a[1], b[0], b[1] = 2.0, 2.0, 8.0, 2.0
    >>> si.isValid(a), si.checkMotion(a, b)
    (True, False)
    """
    kind = space_kind(si.getStateSpace())
    check_world_of(world, kind)
    motions = CurveMotionValidator if kind.is_curved else StraightMotionValidator
    si.setStateValidityChecker(FreeStateChecker(si, world))
    si.setMotionValidator(motions(si, world))
