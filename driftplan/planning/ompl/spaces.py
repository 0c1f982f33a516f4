"""Which OMPL state spaces can be priced, how motions run in them, and how to read their states and goals."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from enum import Enum
from itertools import chain
from math import cos, isfinite, remainder, sin, tau
from typing import Any

from ompl import base as ob
from ompl import geometric as og

from driftplan.arrays import finite
from driftplan.planning.ompl.curves import (
    SAME_LENGTH,
    Curve,
    curve_length,
    dubins_curves,
    dubins_words,
    pose_along,
    reeds_shepp_curves,
)
from driftplan.world.box_world import BoxWorld
from driftplan.world.world import World

_NEAR = 1e-5  # turning radii and rad: of curves less different in length, or in an arc from none, OMPL takes either
_BEGUN = 1e-3  # turning radii: how the first arc runs shows there
_EQUAL = 1e-10  # turning radii: two curves as different as that in length may be 1e-5 apart
_PROBES = 0.21, 0.37, 0.61, 0.83  # of the way: where curves of one length are compared with OMPL's


class SpaceKind(Enum):
    """How a motion between two states runs."""

    PLANE = "R^2: straight"
    POSE = "SE(2): straight, the heading turns at a constant rate along the way"
    DUBINS = "Dubins: the shortest forward curve of bounded curvature"
    REEDS_SHEPP = "Reeds-Shepp: the shortest curve of bounded curvature, forwards and backwards"
    SPACE = "R^3: straight"
    FLIGHT = "SE(3): straight, the attitude turns at a constant rate along the way"

    @property
    def dimensions(self) -> int:
        """Of the positions: 2 or 3."""
        return 3 if self in (SpaceKind.SPACE, SpaceKind.FLIGHT) else 2

    @property
    def is_curved(self) -> bool:
        """Whether motions are curves of bounded curvature."""
        return self in (SpaceKind.DUBINS, SpaceKind.REEDS_SHEPP)


_KINDS: dict[type, SpaceKind] = {
    ob.SE2StateSpace: SpaceKind.POSE,
    ob.DubinsStateSpace: SpaceKind.DUBINS,
    ob.ReedsSheppStateSpace: SpaceKind.REEDS_SHEPP,
    ob.SE3StateSpace: SpaceKind.FLIGHT,
}


def space_kind(space: Any) -> SpaceKind:
    """How motions run in an OMPL state space; a ValueError for one whose motions have no closed-form drift here.

    >>> space_kind(ob.RealVectorStateSpace(2))
    <SpaceKind.PLANE: 'R^2: straight'>
    """
    if type(space) is ob.RealVectorStateSpace and space.getDimension() in (2, 3):
        return SpaceKind.PLANE if space.getDimension() == 2 else SpaceKind.SPACE
    if type(space) in _KINDS:
        return _KINDS[type(space)]
    name = type(space).__name__
    if isinstance(space, ob.RealVectorStateSpace):
        name += f" of dimension {space.getDimension()}"
    raise ValueError(
        "expected a state space of known motions (RealVectorStateSpace of 2 or 3 dimensions, SE2StateSpace, "
        f"DubinsStateSpace, ReedsSheppStateSpace or SE3StateSpace), got {name}"
    )


class CurveFinder:
    """The curve that OMPL drives between two states of a Dubins or Reeds-Shepp space, arc by arc.

    Several curves may be equally short (always so in Reeds-Shepp spaces for some poses); OMPL is asked for a point of
    its own, so that the curve priced is the curve driven.
    """

    def __init__(self, space: Any) -> None:
        self._space = space
        self._scratch = space.allocState()
        a, b = space.allocState(), space.allocState()
        a.setXY(0.0, 0.0), a.setYaw(0.0), b.setXY(1.0, 0.0), b.setYaw(0.0)
        self.turning_radius = 1.0 / space.getPath(a, b).length()  # metres; OMPL's lengths are in units of it
        self._is_reeds_shepp = space_kind(space) is SpaceKind.REEDS_SHEPP
        self._is_reversible = not self._is_reeds_shepp and space.hasSymmetricDistance()
        self._is_dubins = not self._is_reeds_shepp and not self._is_reversible

    def __call__(self, a: Any, b: Any) -> Curve:
        """The curve from state ``a`` to state ``b``; lengths in turning radii."""
        radius, scratch = self.turning_radius, self._scratch
        if self._is_dubins:
            words = dubins_words((b.getX() - a.getX()) / radius, (b.getY() - a.getY()) / radius, a.getYaw(), b.getYaw())
            words.sort()
            length, t, first, p, middle, q, last = words[0]
            near = _NEAR if len(words) > 1 and words[1][0] - length > _NEAR else tau
            if near < t < tau - near and near < q < tau - near:
                return [(t, first), (p, middle), (q, last)]
        length = self._space.distance(a, b) / radius
        if length == 0.0:
            return []
        x, y, yaw = a.getX(), a.getY(), a.getYaw()
        ends = (b.getX() - x) / radius, (b.getY() - y) / radius, yaw, b.getYaw()
        curves = []
        if self._is_reeds_shepp and length > _BEGUN:
            self._space.interpolate(a, b, _BEGUN / length, scratch)
            way = 1 if (scratch.getX() - x) * cos(yaw) + (scratch.getY() - y) * sin(yaw) > 0 else -1
            turned = way * remainder(scratch.getYaw() - yaw, tau)
            if abs(abs(turned) - _BEGUN) < 1e-3 * _BEGUN:
                begun = reeds_shepp_curves(*ends, length, (way, 1 if turned > 0 else -1))
                curves = [curve for curve in begun if abs(curve_length(curve) - length) < _EQUAL]
        if len(curves) == 1:
            return curves[0]
        places = [self._place(a, b, share) for share in _PROBES]
        for of_length in (length, None):
            curves = list(self._candidates(*ends, of_length))
            best = min(curves, key=lambda curve: _miss(curve, length, places), default=[])
            if _miss(best, length, places) < SAME_LENGTH:
                break
        return best

    def _place(self, a: Any, b: Any, share: float) -> tuple[float, float]:
        """Where OMPL is after a share of the way, seen from the start, in turning radii."""
        self._space.interpolate(a, b, share, self._scratch)
        yaw = a.getYaw()
        c, s = cos(yaw) / self.turning_radius, sin(yaw) / self.turning_radius
        dx, dy = self._scratch.getX() - a.getX(), self._scratch.getY() - a.getY()
        return c * dx + s * dy, c * dy - s * dx

    def _candidates(
        self, dx: float, dy: float, yaw_start: float, yaw_end: float, length: float | None
    ) -> Iterator[Curve]:
        if self._is_reeds_shepp:
            return reeds_shepp_curves(dx, dy, yaw_start, yaw_end, length)
        forwards = dubins_curves(dx, dy, yaw_start, yaw_end, length)
        if not self._is_reversible:
            return forwards
        # A symmetric Dubins space drives the way back in reverse where that is shorter.
        back = dubins_curves(-dx, -dy, yaw_end, yaw_start, length)
        return chain(forwards, ([(-part, sense) for part, sense in reversed(curve)] for curve in back))


def _miss(curve: Curve, length: float, places: Sequence[tuple[float, float]]) -> float:
    """How far a curve is from one of a given length that comes by these places on its way."""
    off = abs(curve_length(curve) - length)
    for share, (px, py) in zip(_PROBES, places, strict=True):
        x, y, _ = pose_along(curve, share * length)
        off = max(off, abs(x - px), abs(y - py))
    return off


def position_reader(kind: SpaceKind) -> Callable[[Any], tuple[float, ...]]:
    """A function that copies the position out of a state: (x, y) or (x, y, z), metres."""
    if kind in (SpaceKind.PLANE, SpaceKind.SPACE):
        return (lambda s: (s[0], s[1])) if kind is SpaceKind.PLANE else (lambda s: (s[0], s[1], s[2]))
    return (lambda s: (s.getX(), s.getY(), s.getZ())) if kind is SpaceKind.FLIGHT else lambda s: (s.getX(), s.getY())


def goal_position(goal: Any, kind: SpaceKind) -> tuple[float, ...]:
    """Where accuracy is wanted, one point in metres: of a point, a State, a GoalState, or GoalStates that differ in
    heading only. Drift is weighed by the distance to the goal, so another goal position is another objective, and no
    single additive cost fits several, or a region: a ValueError."""
    points = goal_points(goal, kind)
    if not points:
        raise ValueError("expected a goal at one position, got GoalStates without any state")
    point = points[0]
    if len(point) != kind.dimensions or not all(isfinite(v) for v in point):
        raise ValueError(f"expected goal to be {kind.dimensions} finite coordinates in metres, got {point}")
    if any(other != point for other in points):
        raise ValueError(
            f"expected goal states that share one position, got {len(set(points))} different ones: the cost of drift "
            "depends on which goal is reached, and no sum over motions knows that. Make one objective per goal and "
            "keep the route of least exact drift; RoadmapPlanner, given the objective of one goal, does so by itself"
        )
    return point


def followed_goal(goal: Any, kind: SpaceKind) -> Callable[[], tuple[float, ...]] | None:
    """What reads the place of an OMPL goal, or of the goal that a problem has by then; None for what stays as it is.

    Reading the state of one goal again takes 0.4 µs. It is never kept: setState() frees the one that was there.
    """
    if isinstance(goal, og.SimpleSetup):
        goal = goal.getProblemDefinition()
    problem = [goal] if isinstance(goal, ob.ProblemDefinition) else []
    if not problem and not isinstance(goal, ob.Goal):
        return None
    position = position_reader(kind)
    seen: Any = None
    is_one_state = False

    def read() -> tuple[float, ...]:
        nonlocal seen, is_one_state
        now = problem[0].getGoal() if problem else goal
        if now is not seen:
            seen, is_one_state = now, isinstance(now, ob.GoalState)
        return position(now.getState()) if is_one_state else goal_position(now, kind)

    return read


def goal_points(goal: Any, kind: SpaceKind) -> list[tuple[float, ...]]:
    """The positions that a goal as in `goal_position` names, metres."""
    read = position_reader(kind)
    if isinstance(goal, ob.State):
        return [read(goal)]
    if isinstance(goal, ob.GoalState):
        return [read(goal.getState())]
    if isinstance(goal, ob.GoalStates):
        return [read(goal.getState(i)) for i in range(goal.getStateCount())]
    if isinstance(goal, ob.Goal):
        raise ValueError(
            f"expected a goal at one position, got a {type(goal).__name__}: a region has no single place where "
            "accuracy is wanted. Give the point that matters, for instance the region's centre, as goal=(x, y): paths "
            "may end anywhere in the region"
        )
    try:
        return [tuple(float(v) for v in finite("goal", goal))]
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"expected goal to be a point in metres or an OMPL state or goal, got {goal!r}") from None


def check_world_of(world: World | BoxWorld | None, kind: SpaceKind) -> None:
    """Raise ValueError for a floor plan in a space of three dimensions, and for boxes in the plane."""
    if isinstance(world, World) and kind.dimensions == 3:
        raise ValueError(
            f"expected a BoxWorld, or no world in a space of three dimensions, got {world!r}: it is a floor plan, and "
            "its walls and zones have no height"
        )
    if isinstance(world, BoxWorld) and kind.dimensions == 2:
        raise ValueError("expected a World in a space of the plane, got a BoxWorld, which is for R^3 and SE(3)")
